//! The rules of the fleet, one by one, against a real broker. Needs `nats-server` in the PATH,
//! and reports if it is missing.
use std::{
    path::Path,
    sync::{Arc, atomic::Ordering},
};

use crate::support::{
    Broker, Daemon, Machine, Network, client, pause, settings, until, witness, work,
};
use bench_fleet::{
    Client, Credentials, FleetSettings, JobState, Needs, Place, Submission,
    client::Command,
    standing::OrderKind,
    view::{JobFilter, JobView},
};

/// A broker, and a client to it.
pub(crate) struct Lab {
    folder: tempfile::TempDir,
    pub(crate) broker: Broker,
    settings: FleetSettings,
    pub(crate) people: Client,
}

impl Lab {
    pub(crate) async fn open() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let broker = Broker::start(folder.path())?;
        let settings = settings(broker.address(), 1.5);
        let people = client(&settings).await;
        Some(Self {
            folder,
            broker,
            settings,
            people,
        })
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn machine(&self, name: &str, run_s: f64) -> Arc<Machine> {
        Machine::new(self.path(), name, run_s)
    }

    pub(crate) fn daemon(&self, machine: &Arc<Machine>) -> Daemon {
        Daemon::new(self.path(), &self.settings, vec![machine.clone()])
    }

    pub(crate) async fn job(&self, job: &str) -> JobView {
        let looking = self.people.seer("lab").await.unwrap();
        let filter = JobFilter {
            most: 1000,
            ..JobFilter::default()
        };
        let mut found = looking.seer.jobs(&filter).jobs.into_iter();
        found.find(|view| view.job.job == job).unwrap()
    }

    pub(crate) async fn is(&self, job: &str, state: JobState) {
        until(state.name(), 30.0, async || {
            self.job(job).await.job.state == state
        })
        .await;
    }

    pub(crate) async fn submit(&self, submission: &Submission) -> String {
        let jobs = self.people.submit(submission).await.unwrap();
        jobs.into_iter().next().unwrap()
    }

    /// Waits until a bench is known to the fleet.
    pub(crate) async fn knows(&self, name: &str) {
        until("a bench that signs on", 30.0, async || {
            let looking = self.people.seer("lab").await.unwrap();
            looking.seer.places().contains(&Place::new("north", name))
        })
        .await;
    }

    pub(crate) async fn say(&self, bench: &str, kind: OrderKind) -> bench_fleet::client::Outcome {
        let command = Command {
            kind,
            by: "ann".to_owned(),
            why: "to look at it".to_owned(),
        };
        let place = Place::new("north", bench);
        self.people.order(&place, &command).await.unwrap()
    }
}

fn ledger(machine: &Machine) -> String {
    std::fs::read_to_string(machine.folder.join("ledger")).unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_died_between_start_and_begin_goes_on_once_after_its_restart() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.2);
    machine.lets_begin(false);
    let mut daemon = lab.daemon(&machine);
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Started).await;
    daemon.kill();
    pause(4.0).await;
    assert_eq!(ledger(&machine).matches("begin work").count(), 0);
    // A second bench is always free, and does not take the started job.
    let other = lab.machine("b2", 0.2);
    let _other = lab.daemon(&other);
    lab.knows("b2").await;
    pause(3.0).await;
    assert!(lab.job(&job).await.is_lost || lab.job(&job).await.job.state == JobState::Started);
    machine.lets_begin(true);
    daemon.start();
    lab.is(&job, JobState::Done).await;
    let seen = witness(&[machine, other.clone()], "work");
    assert_eq!((seen.begins[&job], seen.ends), (1, 1));
    assert_eq!(ledger(&other), "");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_run_is_put_back_by_a_person_only_and_the_old_bench_tells_of_a_second_run() {
    let Some(lab) = Lab::open().await else { return };
    let (old, new) = (lab.machine("b1", 4.0), lab.machine("b2", 0.2));
    let mut daemon = lab.daemon(&old);
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Started).await;
    until("the run", 10.0, async || !old.going().is_empty()).await;
    // As long as its bench answers and has it, the job cannot be put back.
    let refused = lab.people.release_job(&job, "ann", "I think so").await;
    assert!(refused.unwrap_err().to_string().contains("stop it there"));
    daemon.kill();
    let _new = lab.daemon(&new);
    lab.knows("b2").await;
    lab.people
        .release_job(&job, "ann", "the machine burnt")
        .await
        .unwrap();
    lab.is(&job, JobState::Done).await;
    assert!(ledger(&new).contains(&format!("begin work-{job}-t2")));
    // The machine was not destroyed: its run reached its end, and that is reported.
    daemon.start();
    until("the conflict", 30.0, async || {
        lab.job(&job)
            .await
            .job
            .words
            .contains("north/b1 ran it too")
    })
    .await;
    assert_eq!(witness(&[old, new], "work").ends, 2);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_daemon_under_the_same_name_takes_nothing_until_the_first_is_gone() {
    let Some(lab) = Lab::open().await else { return };
    let first = lab.machine("b1", 0.1);
    let mut one = lab.daemon(&first);
    lab.knows("b1").await;
    let elsewhere = lab.path().join("elsewhere");
    let second = Machine::new(&elsewhere, "b1", 0.1);
    let _two = Daemon::new(&elsewhere, &lab.settings, vec![second.clone()]);
    pause(3.0).await;
    let jobs = lab.people.submit(&work("work", 5)).await.unwrap();
    for job in &jobs {
        lab.is(job, JobState::Done).await;
    }
    assert_eq!(ledger(&second).matches("begin").count(), 0);
    one.kill();
    let job = lab.submit(&work("more", 1)).await;
    lab.is(&job, JobState::Done).await;
    assert!(ledger(&second).contains("begin more"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn work_goes_where_it_fits_and_a_reason_is_reported_where_it_fits_nowhere() {
    let Some(lab) = Lab::open().await else { return };
    let (b1, b2) = (lab.machine("b1", 0.1), lab.machine("b2", 0.1));
    let daemons = [lab.daemon(&b1), lab.daemon(&b2)];
    lab.knows("b1").await;
    lab.knows("b2").await;
    let needs = |text: &str| serde_json::from_str::<Needs>(text).unwrap();
    let large = Submission {
        needs: needs(r#"{"current_a": 100}"#),
        ..work("large", 1)
    };
    let large = lab.submit(&large).await;
    let there = Submission {
        needs: needs(r#"{"bench": "b2", "temperature_c": 25, "fixture": "cell"}"#),
        ..work("there", 1)
    };
    let there = lab.submit(&there).await;
    // The check of b1 refuses it with a reason; b2 takes it.
    let checked = Submission {
        text: "not b1".to_owned(),
        ..work("checked", 3)
    };
    let checked = lab.people.submit(&checked).await.unwrap();
    for job in checked.iter().chain([&there]) {
        lab.is(job, JobState::Done).await;
        let holder = lab.job(job).await.job.holder.unwrap();
        assert_eq!(holder.place.bench, "b2");
    }
    let looking = lab.people.seer("lab").await.unwrap();
    let stranded = looking.seer.view().stranded;
    assert!(
        stranded[&large].contains("north/b1: current: expected at least 100 A, found 20 A"),
        "{stranded:?}"
    );
    lab.people.cancel(&large, "ann").await.unwrap();
    let refused = lab.people.cancel(&there, "ann").await.unwrap_err();
    assert!(refused.to_string().contains("expected a job that waits"));
    let campaign = Submission {
        campaign: Some("ageing".to_owned()),
        needs: needs(r#"{"current_a": 100}"#),
        ..work("large", 3)
    };
    let campaign = lab.people.submit(&campaign).await.unwrap();
    let other = lab
        .submit(&Submission {
            campaign: Some("other".to_owned()),
            ..work("o", 1)
        })
        .await;
    lab.is(&other, JobState::Done).await;
    let count = lab.people.cancel_campaign("ageing", "ann").await.unwrap();
    assert_eq!(count, 3);
    for job in &campaign {
        assert_eq!(lab.job(job).await.job.state, JobState::Cancelled);
    }
    for none in ["ageing", "other"] {
        assert_eq!(
            lab.people.cancel_campaign(none, "ann").await.unwrap(),
            0,
            "{none}"
        );
    }
    let unknown = lab.people.cancel("no such > job", "ann").await.unwrap_err();
    assert!(unknown.to_string().contains("expected a job of the fleet"));
    drop(daemons);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bench_that_can_take_nothing_now_refuses_no_job_for_good() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.1);
    machine.is_full.store(true, Ordering::SeqCst);
    let _daemon = lab.daemon(&machine);
    let job = lab.submit(&work("work", 1)).await;
    until("a job that was put back", 20.0, async || {
        let job = lab.job(&job).await.job;
        job.words == "north/b1 takes nothing now: no space left" && job.state == JobState::Queued
    })
    .await;
    assert!(lab.job(&job).await.job.refused.is_empty());
    machine.is_full.store(false, Ordering::SeqCst);
    lab.is(&job, JobState::Done).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_of_all_benches_ends_every_run_and_tells_who_was_not_heard() {
    let Some(lab) = Lab::open().await else { return };
    let machines = ["b1", "b2", "b3"].map(|name| lab.machine(name, 60.0));
    let mut daemons = machines.each_ref().map(|machine| lab.daemon(machine));
    for name in ["b1", "b2", "b3"] {
        lab.knows(name).await;
    }
    let jobs = lab.people.submit(&work("work", 3)).await.unwrap();
    for job in &jobs {
        lab.is(job, JobState::Started).await;
    }
    until("three runs", 10.0, async || {
        machines.iter().all(|machine| !machine.going().is_empty())
    })
    .await;
    daemons[2].kill();
    let third = [Place::new("north", "b3")];
    until("a bench that is silent", 20.0, async || {
        lab.people.look(&third).await.silent().len() == 1
    })
    .await;
    let stopped = lab.people.stop_all("ann", "smoke").await.unwrap();
    let outcomes: Vec<_> = stopped
        .iter()
        .map(|one| (one.bench.as_str(), one.kept, one.heard, one.verified))
        .collect();
    assert_eq!(
        outcomes,
        [
            ("b1", true, true, Some(true)),
            ("b2", true, true, Some(true)),
            ("b3", true, false, None)
        ]
    );
    assert!(machines[0].going().is_empty() && machines[1].going().is_empty());
    daemons[2].start();
    until("the stop that was heard late", 20.0, async || {
        machines[2].going().is_empty()
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hold_drain_stop_and_release_are_followed_once_and_outlive_a_restart() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 60.0);
    let mut daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    assert!(lab.say("b1", OrderKind::Drain).await.heard);
    let job = lab.submit(&work("work", 1)).await;
    pause(1.5).await;
    assert_eq!(lab.job(&job).await.job.state, JobState::Queued);
    assert!(ledger(&machine).contains("audit fleet: ann: fleet drain b1: to look at it: done"));
    lab.say("b1", OrderKind::Release).await;
    lab.is(&job, JobState::Started).await;
    until("the run", 10.0, async || !machine.going().is_empty()).await;
    let stopped = lab.say("b1", OrderKind::Stop).await;
    assert_eq!((stopped.heard, stopped.verified), (true, Some(true)));
    lab.is(&job, JobState::Failed).await;
    assert!(ledger(&machine).contains("audit fleet: ann: fleet stop b1: to look at it"));
    let stops = machine.stops.load(Ordering::SeqCst);
    let next = lab.submit(&work("next", 1)).await;
    daemon.kill();
    pause(0.5).await;
    daemon.start();
    pause(4.0).await;
    // A restart stops nothing a second time, and the bench stays held.
    assert_eq!(machine.stops.load(Ordering::SeqCst), stops);
    assert_eq!(lab.job(&next).await.job.state, JobState::Queued);
    machine.runs_take(0.1);
    lab.say("b1", OrderKind::Release).await;
    lab.is(&next, JobState::Done).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_that_was_said_while_a_daemon_was_away_ends_its_run_after_the_restart() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 60.0);
    let mut daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Started).await;
    until("the run", 10.0, async || !machine.going().is_empty()).await;
    daemon.kill();
    let stop = Command {
        kind: OrderKind::Stop,
        by: "ann".to_owned(),
        why: "smoke".to_owned(),
    };
    let place = Place::new("north", "b1");
    let outcome = lab.people.order(&place, &stop);
    let patience = std::time::Duration::from_secs(5);
    let _ = crate::support::clock().deadline(patience, outcome).await;
    assert_eq!(machine.stops.load(Ordering::SeqCst), 0);
    daemon.start();
    lab.is(&job, JobState::Failed).await;
    assert_eq!(machine.stops.load(Ordering::SeqCst), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bench_that_was_cut_off_follows_a_stop_late_and_spares_what_a_person_began() {
    let Some(lab) = Lab::open().await else { return };
    let network = Network::to(lab.broker.port).await;
    let beyond = settings(network.address(), 1.5);
    let (fleets, persons) = (lab.machine("b1", 60.0), lab.machine("b2", 60.0));
    let daemons = [&fleets, &persons].map(|machine| {
        let machines = vec![machine.clone()];
        Daemon::new(lab.path(), &beyond, machines)
    });
    lab.knows("b1").await;
    lab.knows("b2").await;
    let there = Submission {
        needs: serde_json::from_str(r#"{"bench": "b1"}"#).unwrap(),
        ..work("work", 1)
    };
    let job = lab.submit(&there).await;
    lab.is(&job, JobState::Started).await;
    until("the run", 10.0, async || !fleets.going().is_empty()).await;
    network.cut(true);
    persons.begin_by_hand("by-hand");
    let place = |bench| Place::new("north", bench);
    until("a bench that is silent", 20.0, async || {
        lab.people.look(&[place("b1")]).await.silent().len() == 1
    })
    .await;
    let stop = Command {
        kind: OrderKind::Stop,
        by: "ann".to_owned(),
        why: "smoke".to_owned(),
    };
    for bench in ["b1", "b2"] {
        let (place, command) = (place(bench), stop.clone());
        let outcome = lab.people.order(&place, &command);
        // The client must not wait two minutes for a reply that cannot arrive.
        let clock = crate::support::clock();
        let _ = clock
            .deadline(std::time::Duration::from_secs(5), outcome)
            .await;
    }
    network.cut(false);
    lab.is(&job, JobState::Failed).await;
    until("a bench that is held", 20.0, async || {
        use bench_fleet::LocalBench as _;
        persons.condition().unwrap().held.is_some()
    })
    .await;
    assert_eq!(fleets.stops.load(Ordering::SeqCst), 1);
    assert_eq!(persons.stops.load(Ordering::SeqCst), 0);
    assert_eq!(persons.going(), ["by-hand"]);
    drop(daemons);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_release_that_is_heard_with_a_later_stop_does_not_undo_it() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 60.0);
    let mut daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    daemon.kill();
    let place = [Place::new("north", "b1")];
    until("a bench that is silent", 20.0, async || {
        lab.people.look(&place).await.silent().len() == 1
    })
    .await;
    for kind in [OrderKind::Release, OrderKind::Stop] {
        lab.say("b1", kind).await;
    }
    daemon.start();
    until("both orders", 20.0, async || {
        ledger(&machine).contains("fleet release b1: to look at it: held again since")
    })
    .await;
    let text = ledger(&machine);
    let stop = text.find("fleet stop b1").unwrap();
    assert!(stop < text.find("fleet release b1").unwrap(), "{text}");
    use bench_fleet::LocalBench as _;
    assert!(machine.condition().unwrap().held.is_some());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_that_could_not_be_sent_does_not_arrive_later() {
    let Some(lab) = Lab::open().await else { return };
    let network = Network::to(lab.broker.port).await;
    let people = client(&settings(network.address(), 1.5)).await;
    let machine = lab.machine("b1", 60.0);
    let _daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    network.cut(true);
    let place = Place::new("north", "b1");
    until("a client that knows that it is cut off", 30.0, async || {
        people
            .look(std::slice::from_ref(&place))
            .await
            .silent()
            .len()
            == 1
            && !people.is_connected()
    })
    .await;
    let stop = Command {
        kind: OrderKind::Stop,
        by: "ann".to_owned(),
        why: "smoke".to_owned(),
    };
    let stopped = people.order(&place, &stop).await.unwrap();
    assert!(!stopped.heard && !stopped.kept, "{stopped:?}");
    network.cut(false);
    until("a client that is back", 30.0, async || {
        people.is_connected()
    })
    .await;
    pause(2.0).await;
    assert_eq!(machine.stops.load(Ordering::SeqCst), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bench_that_cannot_begin_gives_its_job_back() {
    let Some(lab) = Lab::open().await else { return };
    let (bad, good) = (lab.machine("b1", 0.1), lab.machine("b2", 0.1));
    bad.is_broken.store(true, Ordering::SeqCst);
    let mut daemons = vec![lab.daemon(&bad)];
    let job = lab.submit(&work("work", 1)).await;
    until("a job that was put back", 20.0, async || {
        let job = lab.job(&job).await.job;
        job.words == "it did not begin at north/b1: no queue" && job.state == JobState::Queued
    })
    .await;
    daemons.push(lab.daemon(&good));
    lab.is(&job, JobState::Done).await;
    assert_eq!(lab.job(&job).await.job.holder.unwrap().place.bench, "b2");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broker_with_tls_and_a_password_requires_both() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start_with_tls(folder.path()) else {
        return;
    };
    let plain = settings(format!("tls://127.0.0.1:{}", broker.port), 1.5);
    let trusting = FleetSettings {
        ca: Some(folder.path().join("ca.pem")),
        ..plain.clone()
    };
    let known = FleetSettings {
        credentials: Some(Credentials::read("north:secret\n").unwrap()),
        ..trusting.clone()
    };
    drop(client(&known).await);
    let stranger = FleetSettings {
        credentials: Some(Credentials::read("north:guess\n").unwrap()),
        ..trusting.clone()
    };
    let distrusting = FleetSettings {
        credentials: known.credentials.clone(),
        ..plain
    };
    for settings in [trusting, stranger, distrusting] {
        assert!(Client::connect(&settings).await.is_err(), "{settings:?}");
    }
    let machine = Machine::new(folder.path(), "b1", 0.1);
    let _daemon = Daemon::new(folder.path(), &known, vec![machine.clone()]);
    let people = client(&known).await;
    people.submit(&work("work", 1)).await.unwrap();
    until("the run", 30.0, async || {
        witness(std::slice::from_ref(&machine), "work").ends == 1
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_run_whose_reply_was_lost_is_not_begun_again() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.2);
    machine.loses_reply.store(true, Ordering::SeqCst);
    let _daemon = lab.daemon(&machine);
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Done).await;
    assert!(!machine.loses_reply.load(Ordering::SeqCst));
    let text = ledger(&machine);
    assert!(
        text.contains(&format!("fleet begin {job} as work-{job}: begun")),
        "{text}"
    );
    assert_eq!(witness(&[machine], "work").begins[&job], 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bench_whose_server_is_away_is_never_free_and_follows_orders_once_it_is_back() {
    let Some(lab) = Lab::open().await else { return };
    let machine = lab.machine("b1", 0.2);
    let _daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    machine.is_away.store(true, Ordering::SeqCst);
    let job = lab.submit(&work("work", 1)).await;
    let drained = lab.say("b1", OrderKind::Drain).await;
    let words = "no reply";
    assert_eq!(
        (drained.heard, drained.held.as_deref()),
        (true, Some(words))
    );
    let stopped = lab.say("b1", OrderKind::Stop).await;
    assert_eq!((stopped.heard, stopped.verified), (true, Some(false)));
    pause(1.0).await;
    assert_eq!(lab.job(&job).await.job.state, JobState::Queued);
    assert_eq!(ledger(&machine), "");
    machine.is_away.store(false, Ordering::SeqCst);
    until("both orders", 20.0, async || {
        let text = ledger(&machine);
        text.contains("fleet drain b1: to look at it: done")
            && text.contains("fleet stop b1: to look at it: heard through the broker: done")
    })
    .await;
    lab.say("b1", OrderKind::Release).await;
    lab.is(&job, JobState::Done).await;
}
