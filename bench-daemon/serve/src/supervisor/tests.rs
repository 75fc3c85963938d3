//! Tests of a run that starts at the time of a stop.

use std::{
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
};

use super::*;
use crate::{live::StopReport, queue::Wanted, settings::Settings};
use bench_evaluate::support::telemetry::Telemetry;

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A server with a run that waits. Inside a runtime.
fn waiting(data: &Path) -> (Server, Item) {
    std::fs::create_dir(data.join("jobs")).unwrap();
    let settings = Settings::load(&repository().join("configs/serve.toml")).unwrap();
    let settings = Settings {
        data: data.to_owned(),
        ..settings
    };
    let server = Server::open(settings, &Telemetry::default()).unwrap();
    let wanted = Wanted {
        kind: Kind::Run,
        experiment: "demo".to_owned(),
        bench: server.settings.benches[0].name.clone(),
        seed: None,
        expected_s: 60.0,
        by: "ann".to_owned(),
        unix_s: 1.0,
        traceparent: None,
    };
    let item = server
        .queue()
        .submit(&wanted, |id| format!("demo-{id}"))
        .unwrap();
    (server, item)
}

/// Starts a run on a bench whose stops are `now`, after the supervisor saw `seen`. Returns the
/// signal that ended its process, and the stop that is kept.
fn begun(seen: Option<f64>, now: Option<f64>) -> (Option<i32>, Option<f64>) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let _inside = runtime.enter();
    let data = tempfile::tempdir().unwrap();
    let (server, item) = waiting(data.path());
    let bench = server.settings.benches[0].clone();
    if let Some(unix_s) = now {
        server.stops().insert(
            bench.name.clone(),
            StopReport {
                unix_s,
                ..StopReport::default()
            },
        );
    }
    let post = SupervisedBench::new(&server, &bench).unwrap();
    let mut child = Command::new("sleep").arg("600").spawn().unwrap();
    post.begun(&server, &item, i32::try_from(child.id()).unwrap(), seen);
    // A process that received no request to end is killed here.
    let kept = server.stops().get(&bench.name).map(|stop| stop.unix_s);
    assert!(server.queue().in_work(&bench.name).is_some());
    if kept.is_none() {
        child.kill().unwrap();
    }
    (child.wait().unwrap().signal(), kept)
}

#[test]
fn a_run_that_was_being_begun_when_a_stop_came_is_ended_and_the_stop_goes_on() {
    assert_eq!(
        begun(None, Some(5.0)),
        (Some(Signal::SIGTERM as i32), Some(5.0))
    );
    assert_eq!(
        begun(Some(5.0), Some(6.0)),
        (Some(Signal::SIGTERM as i32), Some(6.0))
    );
    // The outcome of an earlier stop is no longer valid.
    assert_eq!(
        begun(Some(5.0), Some(5.0)),
        (Some(Signal::SIGKILL as i32), None)
    );
    assert_eq!(begun(None, None), (Some(Signal::SIGKILL as i32), None));
}

#[test]
fn a_run_that_a_process_of_before_has_begun_ends_as_that_one_did() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let _inside = runtime.enter();
    for is_there in [true, false] {
        let data = tempfile::tempdir().unwrap();
        let (server, item) = waiting(data.path());
        let folder = server.runs().join(&item.run);
        std::fs::create_dir_all(&folder).unwrap();
        if is_there {
            let first = repository().join("fixtures/data/upgrade/0.1.0/data/runs/demo-1");
            std::fs::copy(first.join(JOURNAL), folder.join(JOURNAL)).unwrap();
        }
        let mut post = SupervisedBench::new(&server, &server.settings.benches[0]).unwrap();
        let mut second = Command::new("sh").args(["-c", "exit 2"]).spawn().unwrap();
        let process = Process {
            pid: i32::try_from(second.id()).unwrap(),
            started_unix_s: clock::unix_time_s(),
        };
        server.queue().begun(item.id, process).unwrap();
        second.wait().unwrap();
        post.child = Some((item.id, second));
        post.reap(&server);
        let ended = server.jobs.latest().next().unwrap().ended.unwrap();
        assert_eq!(ended.finished, is_there, "{ended:?}");
        assert_eq!(server.queue().held(&item.bench).is_none(), is_there);
    }
}

#[test]
fn only_the_last_process_of_a_run_tells_why_it_ended() {
    let first = "eis-bench: the sweep fails\n";
    for (log, word) in [
        (first.to_owned(), Some("the sweep fails")),
        (format!("{first}{RESUMED}\n"), None),
        (format!("{first}{RESUMED}\npoint 1\n"), None),
        (
            format!("{first}{RESUMED}\neis-bench: the load is silent\nbye\n"),
            Some("the load is silent"),
        ),
    ] {
        assert_eq!(last_word(&log).as_deref(), word, "{log}");
    }
}

#[test]
fn a_finished_run_tells_of_the_points_that_its_gate_refused() {
    let refused = Failure::Refused { count: 3 }.to_string();
    for (ended, word, how) in [
        (Some("finished"), Some(refused.as_str()), refused.as_str()),
        (
            Some("finished"),
            Some("the report cannot be drawn"),
            "finished",
        ),
        (Some("finished"), None, "finished"),
        (
            Some("stopped on request"),
            Some("the sweep fails"),
            "stopped on request",
        ),
        (None, Some("the sweep fails"), "the sweep fails"),
        (None, None, "its process was killed or died"),
    ] {
        assert_eq!(
            how_it_ended(ended, word.map(str::to_owned)),
            how,
            "{ended:?} {word:?}"
        );
    }
}
