//! A stop that cannot be starved: a thousand sockets that connect, send nothing and reconnect,
//! three hundred listeners, and a client that sends its head byte by byte; the stop of a run is
//! still verified.
//!
//! `EIS_BENCH_STOPS=100` stops this number of runs instead of the single one in continuous
//! integration, and prints the duration of each stop.

use std::{
    io::{Read, Write},
    net::TcpStream,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use instruments::clock::unix_time_s;

use crate::{
    serve_support::{Served, config, submit, token},
    support::{EXPERIMENT, Files, Ports, poll},
};

const SILENT: usize = 1000;
const LISTENERS: usize = 300;

#[expect(clippy::disallowed_methods, reason = "the load comes in its own time")]
fn sleep(seconds: f64) {
    std::thread::sleep(Duration::from_secs_f64(seconds.max(0.0)));
}

/// Opens sockets that send nothing; those that the server closes reconnect at once.
fn silent(address: &str, over: &AtomicBool) {
    let mut sockets: Vec<TcpStream> = Vec::new();
    while !over.load(Ordering::Relaxed) {
        sockets.retain_mut(|socket| {
            // A socket that still waits would block: it is there.
            socket.read(&mut [0; 64]).is_err()
        });
        while sockets.len() < SILENT / 4 {
            let Ok(socket) = TcpStream::connect(address) else {
                break;
            };
            socket.set_nonblocking(true).unwrap();
            sockets.push(socket);
        }
        sleep(0.02);
    }
}

/// Ends the endless clients, even if the test panics: otherwise it would wait for them.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A head that comes a byte at a time.
fn slow(address: &str, over: &AtomicBool) {
    while !over.load(Ordering::Relaxed) {
        let Ok(mut socket) = TcpStream::connect(address) else {
            continue;
        };
        for byte in b"GET /api/v1/benches HTTP/1.1\r\nHost: localhost\r\n" {
            if over.load(Ordering::Relaxed) || socket.write_all(&[*byte]).is_err() {
                break;
            }
            sleep(0.1);
        }
    }
}

/// How often it is stopped.
pub(crate) fn stops() -> usize {
    std::env::var("EIS_BENCH_STOPS").map_or(1, |stops| stops.parse().unwrap())
}

/// Stops a run the given number of times while other clients keep the server busy; `stop` receives
/// the time until the stop was verified, s.
pub(crate) fn stop_beside_load(
    what: &str,
    prepare: impl FnOnce(&Served),
    stop: impl Fn(&Served) -> f64,
) {
    let files = Files::short(14)
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"2 Hz\"")
        .without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 1.0, 1);
    config(&files, "[limits]\nrequests_per_s = 1000\nburst = 4000");
    let served = Served::start(&files);
    prepare(&served);
    let over = AtomicBool::new(false);
    let mut took: Vec<f64> = Vec::new();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| silent(&served.address, &over));
        }
        scope.spawn(|| slow(&served.address, &over));
        let _ends = Ends(&over);
        let listeners: Vec<_> = (0..LISTENERS).map(|_| served.listen("")).collect();
        for _ in 0..stops() {
            submit(&served, r#"{"experiment":"demo"}"#);
            poll("a current", || {
                (ports.world.lock().unwrap().truth_current_a() != 0.0).then_some(())
            });
            took.push(stop(&served));
            assert_eq!(ports.world.lock().unwrap().truth_current_a(), 0.0);
            served.post("/benches/demo/release", "").expect(200);
        }
        drop(listeners);
    });
    took.sort_by(f64::total_cmp);
    println!(
        "{what}: {} stops verified: {:.2} s in the middle, {:.2} s at most",
        took.len(),
        took[took.len() / 2],
        took[took.len() - 1]
    );
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
}

#[test]
#[ignore = "drill"]
fn a_stop_is_heard_beside_silent_sockets_listeners_and_a_slow_client() {
    stop_beside_load(
        "by the API",
        |_| (),
        |served| {
            let asked_s = unix_time_s();
            let report = served.post("/benches/demo/stop", "").expect(200).json();
            let took_s = unix_time_s() - asked_s;
            assert_eq!(
                (&report["verified"], &report["over"]),
                (&true.into(), &true.into()),
                "{report}"
            );
            took_s
        },
    );
}

#[test]
#[ignore = "drill"]
fn every_bench_is_stopped_at_once_and_a_revoked_token_hears_nothing_more() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let (watcher, starter) = (
        token(&files, "watcher", "read"),
        token(&files, "starter", "energise,read"),
    );
    let mut events = served.listen(&format!("Authorization: Bearer {watcher}\r\n"));
    assert_eq!(events.next().unwrap().1, "hello");
    served
        .ask(
            "POST",
            "/api/v1/queue",
            (&starter, r#"{"experiment":"demo"}"#),
        )
        .expect(201);
    poll("a current", || {
        (ports.world.lock().unwrap().truth_current_a() != 0.0).then_some(())
    });
    let config = files.path("serve.toml");
    crate::support::program(&[
        "token".as_ref(),
        "revoke".as_ref(),
        config.as_os_str(),
        "watcher".as_ref(),
    ])
    .expect_code(0);
    // The received events were sent before; then the stream ends on its own while events continue.
    assert!(events.count() < 200);
    let reports = served
        .ask("POST", "/api/v1/stop", (&starter, ""))
        .expect(200)
        .json();
    assert_eq!(
        (reports.as_array().unwrap().len(), &reports[0]["verified"]),
        (1, &true.into()),
        "{reports}"
    );
    ports.assert_outputs_off();
}

#[test]
fn tokens_made_at_the_same_time_are_all_kept_and_files_are_private() {
    use std::os::unix::fs::PermissionsExt;
    let files = Files::short(2);
    config(&files, "");
    std::fs::create_dir_all(files.path("data")).unwrap();
    std::thread::scope(|scope| {
        for number in 0..20 {
            let files = &files;
            scope.spawn(move || token(files, &format!("t{number}"), "read"));
        }
    });
    let config = files.path("serve.toml");
    let listed = crate::support::program(&["token".as_ref(), "list".as_ref(), config.as_os_str()]);
    assert_eq!(
        listed
            .stdout
            .lines()
            .filter(|line| line.starts_with('t'))
            .count(),
        20,
        "{}",
        listed.stdout
    );
    let mode = |name: &str| {
        std::fs::metadata(files.path("data").join(name))
            .unwrap()
            .permissions()
            .mode()
            & 0o777
    };
    assert_eq!(mode("tokens.json"), 0o600);
    let served = Served::start(&files);
    assert_eq!(mode("audit.jsonl") & !0o640, 0);
    drop(served);
    std::fs::set_permissions(
        files.path("data/audit.jsonl"),
        std::fs::Permissions::from_mode(0o666),
    )
    .unwrap();
    let refused = crate::support::program(&["serve".as_ref(), config.as_os_str()]);
    assert!(
        refused.code != Some(0)
            && refused
                .stderr
                .contains("expected a file that not everybody may write"),
        "{}",
        refused.stderr
    );
}

#[test]
#[ignore = "drill"]
fn a_stop_has_its_files_where_the_system_grants_few_and_silent_sockets_take_what_they_get() {
    let files = Files::short(14)
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"2 Hz\"")
        .without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 1.0, 1);
    config(&files, "");
    let served = Served::start_after(&files, "ulimit -n 300");
    submit(&served, r#"{"experiment":"demo"}"#);
    poll("a current", || {
        (ports.world.lock().unwrap().truth_current_a() != 0.0).then_some(())
    });
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| silent(&served.address, &over));
        }
        let _ends = Ends(&over);
        sleep(1.5);
        let asked_s = unix_time_s();
        let report = served.post("/benches/demo/stop", "").expect(200).json();
        let took_s = unix_time_s() - asked_s;
        assert_eq!(
            (&report["verified"], &report["over"]),
            (&true.into(), &true.into()),
            "{report}"
        );
        println!("beside silent sockets and with 300 files: verified within {took_s:.2} s");
    });
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn who_listened_without_a_token_hears_nothing_more_once_there_is_one() {
    let files = Files::short(2);
    config(&files, "");
    let served = Served::start(&files);
    let mut events = served.listen("");
    assert_eq!(events.next().unwrap().1, "hello");
    let operator = token(&files, "ann", "operate");
    for number in 0..50 {
        let body = format!("{{\"why\":\"{number}\"}}");
        served
            .ask("POST", "/api/v1/benches/demo/hold", (&operator, &body))
            .expect(200);
    }
    let heard: Vec<String> = events.map(|event| event.2.to_string()).collect();
    assert!(
        !heard.iter().any(|text| text.contains("49 (ann)")),
        "{heard:?}"
    );
}

#[test]
fn what_is_written_without_a_umask_is_private_all_the_same() {
    use std::os::unix::fs::PermissionsExt;
    let files = Files::short(2);
    config(&files, "");
    let served = Served::start_after(&files, "umask 0");
    served.post("/benches/demo/hold", "").expect(200);
    served.post("/benches/demo/release", "").expect(200);
    let mode = |name: &str| {
        std::fs::metadata(files.path("data").join(name))
            .unwrap()
            .permissions()
            .mode()
            & 0o777
    };
    assert_eq!(
        (mode("audit.jsonl"), mode("audit.head.json")),
        (0o640, 0o640)
    );
    let head: serde_json::Value =
        serde_json::from_str(&crate::serve_support::data(&files, "audit.head.json")).unwrap();
    assert_eq!(head["lines"], 2, "each deed is in the head");
}
