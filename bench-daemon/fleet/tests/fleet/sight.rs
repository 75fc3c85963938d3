//! The whole fleet as a daemon sees it, and the removal of old records. Needs `nats-server` in
//! the PATH, and reports if it is missing.
use async_nats::jetstream;
use bench_fleet::{Fleet, JobState, Place, client::Ages};
use futures_util::TryStreamExt;

use crate::{
    protocol::Lab,
    support::{pause, until, work},
};

/// Returns the number of subscribers to heartbeats, as the broker counts them.
async fn followers(lab: &Lab) -> usize {
    let client = async_nats::connect(lab.broker.address()).await.unwrap();
    let context = jetstream::new(client);
    let stream = context.get_stream("KV_eis-lab-benches").await.unwrap();
    // The broker keeps inactive consumers for a while.
    let consumers: Vec<_> = stream.consumers().try_collect().await.unwrap();
    consumers.iter().filter(|one| one.push_bound).count()
}

/// Returns the state of a bench, as a daemon shows it on request.
async fn state(fleet: &Fleet, bench: &str) -> Option<&'static str> {
    let view = fleet.seer().await.ok()?.view();
    let found = view.benches.iter().find(|one| one.place.bench == bench);
    found.map(|bench| bench.state_name())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_tells_of_the_whole_fleet_and_follows_it_only_while_somebody_looks() {
    let Some(lab) = Lab::open().await else { return };
    let (b1, b2) = (lab.machine("b1", 0.1), lab.machine("b2", 60.0));
    let (first, mut second) = (lab.daemon(&b1), lab.daemon(&b2));
    lab.knows("b1").await;
    lab.knows("b2").await;
    let at = |bench: &str, name: &str| bench_fleet::Submission {
        needs: bench_fleet::Needs {
            bench: Some(bench.to_owned()),
            ..bench_fleet::Needs::default()
        },
        ..work(name, 1)
    };
    let there = at("b2", "long");
    let lost = lab.submit(&there).await;
    let done = lab.submit(&at("b1", "work")).await;
    lab.is(&lost, JobState::Started).await;
    lab.is(&done, JobState::Done).await;
    second.kill();
    let next = lab.submit(&there).await;
    let fleet = first.fleet.clone().unwrap();
    // Without a watching user, counts come from heartbeats that are read from time to time.
    until("a count with the lost job", 60.0, async || {
        let tally = fleet.tally();
        tally.is_some_and(|tally| tally.jobs.lost == 1 && tally.stranded == 1)
    })
    .await;
    let tally = fleet.tally().unwrap();
    assert_eq!((tally.benches["idle"], tally.benches["silent"]), (1, 1));
    let count = |state| tally.jobs.of(state);
    assert_eq!((count(JobState::Done), count(JobState::Started)), (1, 0));
    until("nobody who follows", 60.0, async || {
        followers(&lab).await == 0
    })
    .await;
    // A new watcher sees silent benches at once, and the job that is over.
    assert_eq!(state(&fleet, "b1").await, Some("idle"));
    assert_eq!(state(&fleet, "b2").await, Some("silent"));
    assert!(followers(&lab).await > 0);
    let view = fleet.seer().await.unwrap().view();
    assert_eq!((view.jobs.of(JobState::Done), view.jobs.lost), (1, 1));
    assert!(
        view.stranded[&next].contains("north/b2: it is silent"),
        "{view:?}"
    );
    second.start();
    until("a bench that is back", 30.0, async || {
        state(&fleet, "b2").await == Some("running")
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "drill"]
async fn a_minute_after_the_last_look_heartbeats_are_not_followed() {
    let Some(lab) = Lab::open().await else { return };
    let b1 = lab.machine("b1", 0.1);
    let daemon = lab.daemon(&b1);
    lab.knows("b1").await;
    let fleet = daemon.fleet.clone().unwrap();
    assert_eq!(state(&fleet, "b1").await, Some("idle"));
    pause(40.0).await;
    assert!(followers(&lab).await > 0);
    until("nobody who follows", 90.0, async || {
        followers(&lab).await == 0
    })
    .await;
    assert_eq!(state(&fleet, "b1").await, Some("idle"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bench_that_is_gone_is_forgotten_and_may_come_back() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.1);
    let mut daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    let (b1, none) = (Place::new("north", "b1"), Place::new("north", "b9"));
    let refused = lab.people.forget_bench(&b1).await.unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("expected a bench that is gone"),
        "{refused}"
    );
    let unknown = lab.people.forget_bench(&none).await.unwrap_err();
    assert!(
        unknown.to_string().contains("expected a bench SITE/BENCH"),
        "{unknown}"
    );
    daemon.kill();
    until("a bench that is forgotten", 30.0, async || {
        lab.people.forget_bench(&b1).await.is_ok()
    })
    .await;
    let stopped = lab.people.stop_all("ann", "smoke").await.unwrap();
    assert!(stopped.is_empty(), "{stopped:?}");
    daemon.start();
    lab.knows("b1").await;
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Done).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_over_is_forgotten_with_its_text_and_the_same_can_be_submitted_again() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.1);
    let _daemon = lab.daemon(&machine);
    let done = lab.submit(&work("work", 1)).await;
    lab.is(&done, JobState::Done).await;
    let waits = bench_fleet::Submission {
        text: "name = \"waits\"".to_owned(),
        needs: serde_json::from_str(r#"{"bench": "b9"}"#).unwrap(),
        ..work("waits", 1)
    };
    let waits = lab.submit(&waits).await;
    let forget = async |jobs_s, texts_s| {
        let forgotten = lab.people.forget(Ages { jobs_s, texts_s }).await.unwrap();
        (forgotten.jobs, forgotten.texts)
    };
    assert_eq!(forget(3600.0, 3600.0).await, (0, 0));
    // A text may be older than its jobs: it stays until it is old, too.
    assert_eq!(forget(0.0, 3600.0).await, (1, 0));
    assert_eq!(forget(0.0, 0.0).await, (0, 1));
    assert_eq!(lab.job(&waits).await.job.state, JobState::Queued);
    let again = lab.submit(&work("work", 1)).await;
    lab.is(&again, JobState::Done).await;
}
