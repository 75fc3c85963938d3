//! Telemetry: what arrives at a collector, that nothing waits for a collector, and that dashboard,
//! alerts and documentation use existing names.

use std::{
    collections::BTreeSet,
    fs,
    net::TcpListener,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    archive::ARCHIVE,
    collector::{Collector, Span, Values},
    fleet::Broker,
    serve_support::{Served, config, submit},
    support::{Ended, Files, command, poll, program},
};

const EXPERIMENT: &str = r#"{"experiment":"demo","seed":5}"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap()
}

fn metrics(served: &Served) -> String {
    let answer = served.ask("GET", "/metrics", ("", "")).expect(200);
    String::from_utf8(answer.body).unwrap()
}

fn values(text: &str) -> Values {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let (name, value) = line.rsplit_once(' ').unwrap();
            (name.to_owned(), value.parse().unwrap())
        })
        .collect()
}

/// Returns the names of metrics in a text.
fn named(text: &str) -> BTreeSet<String> {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.split(|c: char| !word(c))
        .filter(|word| word.starts_with("eis_bench_"))
        .map(str::to_owned)
        .collect()
}

/// Starts a server that has run the short demo, which measures controls.
fn ran(files: &Files, environment: &[(&str, &str)]) -> (Served, String) {
    let served = Served::start_with(files, environment);
    let run = submit(&served, EXPERIMENT);
    assert_eq!(served.ended(&run)["finished"], true);
    (served, run)
}

#[test]
fn dashboard_alerts_and_documentation_name_what_is_measured() {
    let files = Files::short(3);
    let broker = Broker::start(&files.path("nats"));
    // Without a broker there is still a fleet, but it receives nothing.
    let nobody = "nats://127.0.0.1:9".to_owned();
    let address = broker
        .as_ref()
        .map_or(nobody, |found| found.address.clone());
    let fleet = format!("[fleet]\nname = \"lab\"\nsite = \"north\"\nserver = {address:?}");
    config(&files, &format!("{ARCHIVE}\n{fleet}"));
    let (served, _) = ran(&files, &[]);
    let mut wanted = vec![
        "eis_bench_control_impedance_ohms{",
        "eis_bench_archive_runs{state=\"archived\"} 1",
        "eis_bench_archive_last_verified_timestamp_seconds ",
    ];
    if broker.is_some() {
        wanted.push("eis_bench_fleet_benches{fleet=\"lab\",state=\"idle\"} 1");
    }
    let text = poll("controls, archive and fleet", || {
        let text = metrics(&served);
        wanted.iter().all(|row| text.contains(row)).then_some(text)
    });
    // Each metric has values, so that a name and its labels are seen as they are.
    for line in text.lines().filter(|line| line.starts_with("# TYPE ")) {
        let name = line.split(' ').nth(2).unwrap();
        let has_values = text
            .lines()
            .any(|line| line.split(['{', ' ']).next() == Some(name));
        let is_of_a_run = ["_run_", "_cell_"].iter().any(|part| name.contains(part));
        let is_of_a_fleet = broker.is_none() && name.contains("_fleet_");
        assert!(has_values || is_of_a_run || is_of_a_fleet, "{name}: {text}");
    }
    let types = text.lines().filter_map(|line| line.strip_prefix("# TYPE "));
    let there: BTreeSet<String> = types
        .map(|line| line.split(' ').next().unwrap().to_owned())
        .collect();
    for path in [
        "packaging/grafana/eis-bench.json",
        "packaging/prometheus/alerts.yml",
        "packaging/prometheus/alerts.test.yml",
        "docs/observe.md",
    ] {
        let unknown: Vec<_> = named(&read(path)).difference(&there).cloned().collect();
        assert_eq!(unknown, [""; 0], "{path}");
    }
    let documented = named(&read("docs/observe.md"));
    let missing: Vec<_> = there.difference(&documented).collect();
    assert_eq!(missing, [""; 0], "docs/observe.md");
    // No metric of an unfinished run remains.
    let now = values(&text);
    for (name, value) in [
        ("eis_bench_runs_finished_total{bench=\"demo\"}", 1.0),
        ("eis_bench_runs_failed_total{bench=\"demo\"}", 0.0),
        ("eis_bench_trips_total{bench=\"demo\"}", 0.0),
        ("eis_bench_state{bench=\"demo\",state=\"idle\"}", 1.0),
        ("eis_bench_outputs_verified{bench=\"demo\"}", 1.0),
        ("eis_bench_archive_trouble", 0.0),
        (
            "eis_bench_fleet_connected{fleet=\"lab\"}",
            f64::from(broker.is_some()),
        ),
        (
            "eis_bench_control_certified_ohms{bench=\"demo\",control=\"fake_cell\"}",
            3.75e-3,
        ),
    ] {
        assert_eq!(now.get(name), Some(&value), "{name}: {text}");
    }
    // The simulated harness reads the shunt a few percent wrong, and the correction removes this.
    let deviation = |kind: &str, control: &str, reading: &str| {
        let labels = format!("{{bench=\"demo\",control=\"{control}\",reading=\"{reading}\"}}");
        now[&format!("eis_bench_control_deviation_{kind}{labels}")].abs()
    };
    let as_read = deviation("ratio", "fake_cell", "as_read");
    let corrected = deviation("ratio", "fake_cell", "corrected");
    assert!(
        (0.001..0.15).contains(&as_read) && corrected < 0.01 && corrected < as_read,
        "{as_read}, {corrected}"
    );
    assert!(
        deviation("sigmas", "fake_cell", "corrected") < 5.0,
        "{text}"
    );
}

#[test]
fn every_alert_has_its_part_in_the_runbook() {
    let (alerts, page) = (
        read("packaging/prometheus/alerts.yml"),
        read("docs/observe.md"),
    );
    let tests = read("packaging/prometheus/alerts.test.yml");
    let names: Vec<&str> = alerts
        .lines()
        .filter_map(|line| line.trim().strip_prefix("- alert: "))
        .collect();
    assert!(names.len() > 10, "{names:?}");
    for name in names {
        let link = format!(
            "runbook_url: /usr/share/doc/eis-bench/docs/observe.md#{}",
            name.to_lowercase()
        );
        assert!(alerts.contains(&link), "{link}");
        let title = format!("### {name}");
        assert!(
            page.lines().any(|line| line == title),
            "docs/observe.md: {title}"
        );
        assert!(
            tests.contains(&format!("alertname=\"{name}\"")),
            "no test of {name}"
        );
    }
}

/// Needs `promtool`, which is in Debian's package `prometheus`; skipped if it is absent.
#[test]
fn promtool_finds_the_rules_right() {
    let folder = root().join("packaging/prometheus");
    for arguments in [
        ["check", "rules", "alerts.yml"],
        ["test", "rules", "alerts.test.yml"],
        ["check", "config", "prometheus.yml"],
    ] {
        let done = Command::new("promtool")
            .args(arguments)
            .current_dir(&folder)
            .output();
        let Ok(done) = done else {
            return;
        };
        let text = String::from_utf8_lossy(&done.stderr) + String::from_utf8_lossy(&done.stdout);
        assert!(done.status.success(), "{arguments:?}: {text}");
    }
}

#[test]
fn a_collector_is_told_what_prometheus_is_told() {
    let files = Files::short(3);
    let collector = Collector::start();
    config(
        &files,
        &format!("[telemetry]\notlp = {:?}", collector.address),
    );
    let (served, _) = ran(&files, &[("OTEL_METRIC_EXPORT_INTERVAL", "200")]);
    let settled = |text: &String| {
        text.contains("eis_bench_control_impedance_ohms{")
            && text.contains("eis_bench_state{bench=\"demo\",state=\"idle\"} 1")
    };
    let before = poll("rest", || Some(metrics(&served)).filter(settled));
    let number = collector.arrived.lock().unwrap().metrics.len();
    // The present one may have been read before.
    let sent = poll("metrics", || {
        collector
            .arrived
            .lock()
            .unwrap()
            .metrics
            .get(number + 1)
            .cloned()
    });
    let (before, after) = (values(&before), values(&metrics(&served)));
    let names = |values: &Values| values.keys().cloned().collect::<BTreeSet<_>>();
    assert_eq!(names(&sent), names(&before));
    // A request for metrics is a connection.
    let still: Vec<_> = before
        .iter()
        .filter(|(name, value)| after.get(*name) == Some(*value))
        .filter(|(name, _)| *name != "eis_bench_http_connections")
        .collect();
    assert!(still.len() > 40, "{still:?}");
    for (name, value) in still {
        assert_eq!(sent.get(name), Some(value), "{name}");
    }
    let arrived = collector.arrived.lock().unwrap();
    assert_eq!(arrived.resource["service.name"], "eis-bench");
}

/// Returns the spans with a name; there must be at least one.
fn of<'a>(spans: &'a [Span], name: &str) -> Vec<&'a Span> {
    let found: Vec<&Span> = spans.iter().filter(|span| span.name == name).collect();
    assert!(!found.is_empty(), "no span {name:?}: {spans:#?}");
    found
}

#[test]
fn a_request_the_wait_and_the_run_are_one_trace() {
    let files = Files::short(3);
    let collector = Collector::start();
    config(
        &files,
        &format!("[telemetry]\notlp = {:?}", collector.address),
    );
    let served = Served::start_with(&files, &[("OTEL_BSP_SCHEDULE_DELAY", "100")]);
    let (trace, caller) = ("4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7");
    let request = format!(
        "POST /api/v1/queue HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\
        traceparent: 00-{trace}-{caller}-01\r\nContent-Type: application/json\r\n\
        Content-Length: {}\r\n\r\n{EXPERIMENT}",
        served.address,
        EXPERIMENT.len()
    );
    let answer = served.raw(request.as_bytes()).expect(201).json();
    let run = answer["run"].as_str().unwrap().to_owned();
    assert_eq!(served.ended(&run)["finished"], true);
    let spans = poll("the whole trace", || {
        let spans = collector.spans();
        let there = |name: &str| spans.iter().any(|span| span.name == name);
        (there("run") && there("run process")).then_some(spans)
    });
    assert!(spans.iter().all(|span| span.trace == trace), "{spans:#?}");
    let submitted = of(&spans, "POST /api/v1/queue")[0];
    assert_eq!(submitted.parent, caller);
    assert_eq!(submitted.attributes["http.response.status_code"], "201");
    for name in ["wait in queue", "run process", "run"] {
        let span = of(&spans, name)[0];
        assert_eq!(span.parent, submitted.id, "{name}");
        assert_eq!(span.attributes["eis_bench.run"], run, "{name}");
        assert_eq!(span.attributes["eis_bench.bench"], "demo", "{name}");
    }
    let of_run = of(&spans, "run")[0];
    assert_eq!(of_run.attributes["eis_bench.cell"], "Molicel P45B");
    let stages: Vec<&str> = of(&spans, "stage")
        .iter()
        .map(|stage| {
            assert_eq!(stage.parent, of_run.id);
            stage.id.as_str()
        })
        .collect();
    let points = of(&spans, "point");
    // Three of each control, and three of the cell.
    assert_eq!(points.len(), 9, "{points:#?}");
    for point in points {
        assert!(stages.contains(&point.parent.as_str()), "{point:?}");
        assert!(
            point.attributes["eis_bench.freq_hz"]
                .parse::<f64>()
                .unwrap()
                > 0.0
        );
        assert!(
            point.attributes["eis_bench.bench_duration_s"]
                .parse::<f64>()
                .unwrap()
                > 0.0
        );
    }
}

fn run_to(files: &Files, out: &str, environment: &[(&str, &str)]) -> Ended {
    let (experiment, out) = (files.experiment(), files.path(out));
    let mut command = command(&[
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    command.envs(environment.iter().copied());
    Ended::of(command.output().unwrap())
}

#[test]
fn a_run_is_the_same_whatever_a_collector_does() {
    let files = Files::short(3);
    run_to(&files, "plain", &[]).expect_code(0);
    let plain = files.text("plain/SHA256SUMS");
    let takes = Collector::start();
    // No process accepts connections: the sender waits for an answer that never arrives.
    let hangs = TcpListener::bind("127.0.0.1:0").unwrap();
    let hanging = format!("http://{}", hangs.local_addr().unwrap());
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let absent = format!("http://{}", free.local_addr().unwrap());
    drop(free);
    let odd = "http://collector.example:4318";
    for (name, address) in [
        ("takes", takes.address.as_str()),
        ("hangs", &hanging),
        ("absent", &absent),
        ("odd", odd),
    ] {
        let environment = [
            ("OTEL_EXPORTER_OTLP_ENDPOINT", address),
            ("EIS_BENCH_TRACES", "exchanges"),
        ];
        let ended = run_to(&files, name, &environment);
        ended.expect_code(0);
        assert_eq!(files.text(&format!("{name}/SHA256SUMS")), plain, "{name}");
        let told = &ended.stderr;
        match name {
            "hangs" | "absent" => assert!(told.contains("spans were not taken"), "{told}"),
            "odd" => assert!(
                told.contains(
                    "note: telemetry is off: OTEL_EXPORTER_OTLP_ENDPOINT: expected an address"
                ),
                "{told}"
            ),
            _ => {}
        }
    }
    assert!(takes.spans().iter().any(|span| span.name == "exchange"));
}

#[test]
fn a_run_that_fails_is_an_error_in_its_trace_and_disabled_means_off() {
    let files = Files::short(3).edit(
        "experiments/demo.toml",
        "magnitude = \"3 %\"",
        "magnitude = \"0.01 %\"",
    );
    let collector = Collector::start();
    let endpoint = ("OTEL_EXPORTER_OTLP_ENDPOINT", collector.address.as_str());
    run_to(&files, "off", &[endpoint, ("OTEL_SDK_DISABLED", "true")]).expect_code(4);
    assert!(collector.spans().is_empty());
    run_to(&files, "on", &[endpoint]).expect_code(4);
    let spans = poll("the run", || {
        let spans = collector.spans();
        let is_there = spans.iter().any(|span| span.name == "run");
        is_there.then_some(spans)
    });
    let run = of(&spans, "run")[0];
    assert_eq!(
        (run.status, run.attributes["error.type"].as_str()),
        (2, "4"),
        "{run:?}"
    );
}

#[test]
fn an_address_that_must_not_be_used_is_refused() {
    let files = Files::short(3);
    let file = config(
        &files,
        "[telemetry]\notlp = \"http://collector.example:4318\"",
    );
    let ended = program(&["serve".as_ref(), file.as_os_str()]);
    let text = ended.expect_code(2).message();
    assert!(
        text.contains("telemetry.otlp") && text.contains("expected an address https://HOST/PATH"),
        "{text}"
    );
}
