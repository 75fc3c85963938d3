//! The start of a run and a stop at the same time.

use std::{os::unix::process::ExitStatusExt, path::PathBuf};

use super::*;
use crate::{
    serve::{live::StopReport, queue::Wanted, settings::Settings},
    support::telemetry::Telemetry,
};

/// A run is begun on a bench whose stops are `now`, after the supervisor saw `seen`: what ended its
/// process, and which stop is kept.
fn begun(seen: Option<f64>, now: Option<f64>) -> (Option<i32>, Option<f64>) {
    let data = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let _inside = runtime.enter();
    std::fs::create_dir(data.path().join("jobs")).unwrap();
    let settings =
        Settings::load(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../configs/serve.toml"))
            .unwrap();
    let settings = Settings {
        data: data.path().to_owned(),
        ..settings
    };
    let server = Server::open(settings, &Telemetry::default()).unwrap();
    let bench = server.settings.benches[0].clone();
    let wanted = Wanted {
        kind: Kind::Run,
        experiment: "demo".to_owned(),
        bench: bench.name.clone(),
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
    // Whoever was not asked to end is killed here.
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
    // What an earlier stop has shown is no longer so.
    assert_eq!(
        begun(Some(5.0), Some(5.0)),
        (Some(Signal::SIGKILL as i32), None)
    );
    assert_eq!(begun(None, None), (Some(Signal::SIGKILL as i32), None));
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
