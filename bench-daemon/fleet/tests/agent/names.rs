//! Names of metrics in the dashboard, the alerts and the documentation, and the reference page of the
//! command line.

use std::collections::BTreeSet;

use crate::{
    files::{Files, root},
    processes::{Broker, Site, fleet_program, poll},
};

/// Prefix of the metrics of an agent.
const PREFIX: &str = "eis_bench_fleet_";

/// Returns the names of metrics of an agent in a text.
fn named(text: &str) -> BTreeSet<String> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.split(|c: char| !is_word(c))
        .filter(|word| word.starts_with(PREFIX) && word.len() > PREFIX.len())
        .map(str::to_owned)
        .collect()
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn dashboard_alerts_and_documentation_name_what_an_agent_measures() {
    let folder = tempfile::tempdir().unwrap();
    let Some(mut broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::tiny(), &broker, "north");
    let metrics = || {
        let answer = north.agent.ask("GET /metrics", "", "").expect(200);
        String::from_utf8(answer.body).unwrap()
    };
    let wanted = "eis_bench_fleet_benches{fleet=\"lab\",state=\"idle\"} 1";
    let text = poll("a count", || {
        Some(metrics()).filter(|text| text.contains(wanted))
    });
    for row in [
        "eis_bench_fleet_connected{fleet=\"lab\"} 1",
        "eis_bench_fleet_jobs{fleet=\"lab\",state=\"lost\"} 0",
        "eis_bench_fleet_stranded_jobs{fleet=\"lab\"} 0",
    ] {
        assert!(text.lines().any(|line| line == row), "{row}: {text}");
    }
    let there = named(&text);
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
    // Without the broker, earlier counts would be stale.
    broker.kill();
    poll("that the broker is away", || {
        let text = metrics();
        let rows: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
        (rows == ["eis_bench_fleet_connected{fleet=\"lab\"} 0"]).then_some(())
    });
}

/// Returns the help of a command.
fn help(command: &[&str]) -> String {
    let output = std::process::Command::new(fleet_program())
        .args(command)
        .arg("--help")
        .env("COLUMNS", "100")
        .output()
        .unwrap();
    assert!(output.status.success(), "{command:?}");
    let help = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    lines.join("\n").trim_end().to_owned()
}

#[test]
fn the_reference_of_the_command_line_is_the_help_of_the_program() {
    let whole = help(&[]);
    let (_, listed) = whole.split_once("\nCommands:\n").unwrap();
    let listed = listed.lines().take_while(|line| line.starts_with(' '));
    let named = listed.filter_map(|line| line.strip_prefix("  "));
    let named = named.filter(|line| line.starts_with(|c: char| c.is_ascii_lowercase()));
    let names = named.filter_map(|line| line.split_whitespace().next());
    let mut text = "# Command line of eis-fleet\n\nThis page is made from the source code by a test; do \
        not edit it.\n`EIS_BENCH_WRITE_REFERENCE=1 cargo test -p bench-fleet --test agent names` writes \
        it.\n\n`eis-fleet COMMAND --help` prints the same.\n"
        .to_owned();
    let mut section = |command: &str, help: &str| {
        text.push_str(&format!("\n## `{command}`\n\n```text\n{help}\n```\n"));
    };
    section("eis-fleet", &whole);
    for name in names.filter(|name| *name != "help") {
        section(&format!("eis-fleet {name}"), &help(&[name]));
    }
    let path = root().join("docs/reference-fleet.md");
    if std::env::var_os("EIS_BENCH_WRITE_REFERENCE").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == text,
        "docs/reference-fleet.md is not what the program prints (EIS_BENCH_WRITE_REFERENCE=1 writes it)"
    );
}
