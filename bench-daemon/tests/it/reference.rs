//! The reference pages of `docs`: every key of every file that a user types, every command with
//! its arguments, and the exit codes. They are generated from the sources and from the help of the
//! program. A test fails if a page differs; with the variable `EIS_BENCH_WRITE_REFERENCE` it
//! writes the page.

mod commands;
mod page;
mod ranges;
mod schema;
mod sources;

use std::{
    fs,
    path::{Path, PathBuf},
};

use analysis::diagnosis::thresholds::markdown;

use page::Part;
use sources::Library;

/// If set, the pages are written instead of compared.
const WRITE: &str = "EIS_BENCH_WRITE_REFERENCE";

/// Sources that hold the structures of the files, and the types that these refer to.
const SOURCES: [&str; 30] = [
    "bench-daemon/evaluate/src/campaign/file.rs",
    "bench-daemon/plan/src/config/identity.rs",
    "bench-daemon/plan/src/config/raw.rs",
    "bench-daemon/plan/src/config/raw_bench.rs",
    "bench-daemon/plan/src/config/raw_map.rs",
    "bench-daemon/plan/src/config/raw_multisine.rs",
    "bench-daemon/plan/src/config/raw_ocv_soc.rs",
    "bench-daemon/plan/src/config/raw_pulses.rs",
    "bench-daemon/plan/src/config/raw_quality.rs",
    "bench-daemon/plan/src/config/section.rs",
    "bench-daemon/plan/src/config/interlock.rs",
    "bench-daemon/plan/src/config/limits.rs",
    "bench-daemon/plan/src/config/mod.rs",
    "bench-daemon/plan/src/plan.rs",
    "bench-daemon/fleet/src/config.rs",
    "bench-daemon/serve/src/settings.rs",
    "bench-daemon/serve/src/targets.rs",
    "bench-daemon/evaluate/src/investigate/dataset/raw.rs",
    "fixtures/src/scenario.rs",
    "fixtures/src/scenario/effects.rs",
    "fixtures/src/scenario/faults.rs",
    "fixtures/src/scenario/specimens.rs",
    "instruments/domain/src/fixture.rs",
    "instruments/mock/src/faults.rs",
    "analysis/diagnosis/src/data.rs",
    "analysis/signal/src/history.rs",
    "analysis/effects/src/augmented/play.rs",
    "analysis/files/src/dataset/index.rs",
    "analysis/signal/src/calibration.rs",
    "analysis/signal/src/series.rs",
];

const MADE: &str = "This page is made from the source code by a test; do not edit it.\n\
    `EIS_BENCH_WRITE_REFERENCE=1 cargo test -p bench-daemon --test it reference` writes it.\n";

const KEYS: &str = "*Needed* says `yes`, or the default of a key, or `no` and what happens where \
    the key is left out.\n\
    A key that no table lists is an error.\n";

/// The shortest data set: its files are those of `fixtures/data/cells/panasonic_18650pf_25C`.
const DATA_SET: &str = r#"The shortest data set has a spectrum, a record to fit and one to predict.
In a copy of `fixtures/data/cells/panasonic_18650pf_25C`, `eis-bench diagnose FOLDER` reads this file:

```toml
name = "NCR18650PF"
model = "model_3rc.json"
ocv = "ocv.json"

[[runs]]
file = "eis_07.csv"
kind = "eis"
ocv_v = 3.6635
temperature_c = 26.8
from_hz = 0.1
to_hz = 300

[[runs]]
name = "4C"
file = "pulses.bdf.csv"
kind = "time"
ocv_v = 3.6564
from_s = 49041.8
to_s = 49171.9

[[runs]]
name = "2C"
file = "pulses.bdf.csv"
kind = "time"
ocv_v = 3.6609
from_s = 47831.7
to_s = 47961.8
role = "held_out"
```

[`eis-bench dataset init`](dataset.md) writes such a file from the logs of a cycler.

"#;

/// The text before the table of the thresholds.
const THRESHOLDS: &str = "These numbers decide in a [diagnosis](diagnosis.md), in the order of the workflow.\n\
    `eis-bench effects --thresholds` prints them, with `--json` as JSON.\n\
    Most are conventions; [some were varied](thresholds.md), and the [study](study.md) measures their joint \
    effect.\n\n\
    A source is a *quantile* of a distribution, a *derivation*, a *study* with its seed, a *citation*, or a \
    *convention*: set by judgement, with what supports it.\n\
    The unit 1 is a ratio, a probability or a χ²; σ is a standard deviation.\n\
    Names in code font are thresholds, modules of the code or pages.\n";

/// Returns the root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .unwrap()
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Compares a page with its expected text, or writes it.
fn hold(name: &str, expected: &str) {
    let path = root().join("docs").join(name);
    if std::env::var_os(WRITE).is_some() {
        fs::write(&path, expected).unwrap();
        return;
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let mut lines = found.lines().zip(expected.lines()).enumerate();
    if let Some((at, (found, expected))) = lines.find(|(_, (a, b))| a != b) {
        panic!(
            "docs/{name}:{}: the page is not what the sources say ({WRITE}=1 writes it):\n\
            found    {found}\nexpected {expected}",
            at + 1
        );
    }
    assert!(
        found == expected,
        "docs/{name} is shorter or longer than the sources say ({WRITE}=1 writes it)"
    );
}

#[test]
fn the_reference_of_the_configuration_is_what_the_sources_say() {
    let library = Library::read(&SOURCES);
    let parts = [
        Part {
            name: "Experiment",
            about: "An experiment file says what is done with which cell on which bench: \
                `configs/experiments/`.\n[Procedures](procedures.md) explains its sections.",
            top: library.structure("raw.rs", "Experiment"),
        },
        Part {
            name: "Cell",
            about: "A cell file describes a cell and what may be done to it: `configs/cells/`.\n\
                [Safety](safety.md) explains the interlock.",
            top: library.structure("raw.rs", "Cell"),
        },
        Part {
            name: "Bench",
            about: "A bench file describes instruments, wiring and controls: `configs/benches/`.\n\
                [Bring-up](bring-up.md#models-that-are-known) lists the models, \
                [transports](transports.md) the addresses.",
            top: library.structure("raw_bench.rs", "Bench"),
        },
        Part {
            name: "Server",
            about: "The file of [`eis-bench serve`](serve.md): `configs/serve.toml`.",
            top: library.structure("settings.rs", "Raw"),
        },
        Part {
            name: "Agent",
            about: "The file of [`eis-fleet agent`](fleet.md), which connects the benches of a server to \
                a fleet.",
            top: library.structure("fleet/src/config.rs", "RawAgent"),
        },
        Part {
            name: "Campaign",
            about: "The file of [`eis-bench campaign`](campaign.md#over-several-benches): which cells \
                are measured on which benches.",
            top: library.structure("campaign/file.rs", "Raw"),
        },
        Part {
            name: "Scenario",
            about: "A scenario describes what is true of a simulated bench: `configs/scenarios/`.\n\
                A file states only what it changes of the bench of the thesis.\n\
                An effect or a fault that is left out is not simulated.",
            top: library.structure("scenario.rs", "Scenario"),
        },
    ];
    let mut text = format!(
        "# Keys of the configuration files\n\n{MADE}\n{KEYS}\n{}",
        page::quantities(&library)
    );
    for part in &parts {
        text.push_str(&page::part(&library, part));
        let name = part.name.to_lowercase();
        hold(
            &format!("schema/{name}.json"),
            &schema::schema(&library, part),
        );
    }
    hold("reference-config.md", &text);
}

#[test]
fn the_reference_of_a_data_set_is_what_the_sources_say() {
    let library = Library::read(&SOURCES);
    let part = Part {
        name: "Data set",
        about: "`dataset.toml` makes a folder a data set for `eis-bench diagnose`: \
            `configs/datasets/`.\n[File formats](formats.md) lists the files that it may name.\n\
            A mistake in it is an error; a file that is there but damaged makes the data invalid.",
        top: library.structure("dataset/raw.rs", "File"),
    };
    let text = format!(
        "# Keys of `dataset.toml`\n\n{DATA_SET}{MADE}\n{KEYS}{}",
        page::part(&library, &part)
    );
    hold("reference-dataset.md", &text);
    hold("schema/dataset.json", &schema::schema(&library, &part));
}

#[test]
fn the_reference_of_the_thresholds_is_their_registry() {
    let text = format!(
        "# Thresholds of the diagnosis\n\n{MADE}\n{THRESHOLDS}\n{}",
        markdown()
    );
    hold("reference-thresholds.md", &text);
}

#[test]
fn the_reference_of_the_command_line_is_the_help_of_the_program() {
    hold("reference-cli.md", &commands::page(MADE));
}
