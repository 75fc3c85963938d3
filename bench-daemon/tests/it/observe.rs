//! Metrics, dashboard, alerts and documentation use the same names, and settings of telemetry are
//! checked.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use analysis::run_folder::archive_status::ArchiveStatus;

use crate::{
    serve_support::{Served, config, submit},
    support::{Files, poll, program},
};

pub(crate) const EXPERIMENT: &str = r#"{"experiment":"demo","seed":5}"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap()
}

pub(crate) fn metrics(served: &Served) -> String {
    let answer = served.ask("GET", "/metrics", ("", "")).expect(200);
    String::from_utf8(answer.body).unwrap()
}

/// Values of metrics by name with labels, as Prometheus writes them.
pub(crate) type Values = BTreeMap<String, f64>;

pub(crate) fn values(text: &str) -> Values {
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
        // Those of a fleet are the agent's.
        .filter(|word| word.starts_with("eis_bench_") && !word.starts_with("eis_bench_fleet_"))
        .map(str::to_owned)
        .collect()
}

/// Starts a server that has run the short demo, which measures controls.
pub(crate) fn ran(files: &Files, environment: &[(&str, &str)]) -> (Served, String) {
    let served = Served::start_with(files, environment);
    let run = submit(&served, EXPERIMENT);
    assert_eq!(served.ended(&run)["finished"], true);
    (served, run)
}

#[test]
fn dashboard_alerts_and_documentation_name_what_is_measured() {
    let files = Files::short(3);
    config(&files, "");
    let archive = ArchiveStatus {
        archived: 1,
        last_verified_unix_s: Some(1.0),
        ..ArchiveStatus::default()
    };
    let path = ArchiveStatus::path(&files.path("data"));
    fs::create_dir_all(files.path("data")).unwrap();
    fs::write(path, serde_json::to_vec(&archive).unwrap()).unwrap();
    let (served, _) = ran(&files, &[]);
    let wanted = [
        "eis_bench_control_impedance_ohms{",
        "eis_bench_archive_runs{state=\"archived\"} 1",
        "eis_bench_archive_last_verified_timestamp_seconds ",
    ];
    let text = poll("controls and archive", || {
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
        assert!(has_values || is_of_a_run, "{name}: {text}");
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

#[test]
#[cfg(not(feature = "otlp"))]
fn a_program_without_otlp_refuses_a_collector_and_says_how_to_get_it() {
    let files = Files::short(3);
    let file = config(&files, "[telemetry]\notlp = \"http://127.0.0.1:9\"");
    let ended = program(&["serve".as_ref(), file.as_os_str()]);
    let text = ended.expect_code(2).message();
    assert!(
        text.contains("telemetry.otlp") && text.contains("cargo build --features otlp"),
        "{text}"
    );
}
