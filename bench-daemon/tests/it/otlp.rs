//! What arrives at a collector, and that nothing waits for one. Needs the feature `otlp`.

use std::net::TcpListener;

use crate::{
    collector::{Collector, Span},
    observe::{EXPERIMENT, metrics, ran, values},
    serve_support::{config, submit},
    support::{Ended, Files, command, poll},
};

#[test]
fn a_collector_receives_what_prometheus_receives() {
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
        let message = &ended.stderr;
        match name {
            "hangs" | "absent" => assert!(message.contains("spans were not taken"), "{message}"),
            "odd" => assert!(
                message.contains(
                    "note: telemetry is off: OTEL_EXPORTER_OTLP_ENDPOINT: expected an address"
                ),
                "{message}"
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
