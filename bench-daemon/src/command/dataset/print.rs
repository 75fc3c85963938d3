//! Table of what `dataset init` found and left out.

use analysis::diagnosis::Role;

use super::findings::{FileFinding, FileKind, Findings};
use crate::{
    investigate::proposal::{FoundLog, Load},
    support::terminal::say,
};

/// Prints files, loads, spectra and noise.
pub(super) fn findings(found: &Findings) {
    found.files.iter().for_each(file);
    for (number, log) in found.logs.iter().enumerate() {
        let count = log.loads.len();
        say!(
            "\n{}: {:.0} s, {count} load{}",
            log.name,
            log.lasting_s,
            if count == 1 { "" } else { "s" }
        );
        if log.loads.is_empty() {
            continue;
        }
        say!(
            "  {:>9} {:<9} {:>8} {:>8} {:>8} {:>8} {:>9} {:>7}  use",
            "start / s",
            "kind",
            "I / A",
            "t / s",
            "rest / s",
            "rest / V",
            "mV / min",
            "SOC"
        );
        for (place, load) in log.loads.iter().enumerate() {
            row(
                load,
                &used(
                    found,
                    log,
                    Position {
                        log: number,
                        load: place,
                    },
                ),
            );
        }
    }
    if !found.spectra.is_empty() {
        say!("");
    }
    for spectrum in &found.spectra {
        let used = match &spectrum.refusal {
            Some(reason) => format!("left out: {reason}"),
            None if spectrum.assumed.is_empty() => "train".to_owned(),
            None => format!(
                "train; ASSUMED as at the first run: {}",
                spectrum.assumed.join(", ")
            ),
        };
        say!("{}: {} points: {used}", spectrum.name, spectrum.points);
    }
    noise(found);
}

fn file(file: &FileFinding) {
    let kind = match file.kind {
        Some(FileKind::Spectra) => "spectra",
        Some(FileKind::Log) => "log",
        None => "NOT READ",
    };
    say!("{}: {kind}: {}", file.file, file.text);
}

/// Position of a load among all logs.
#[derive(Clone, Copy)]
struct Position {
    log: usize,
    load: usize,
}

fn used(found: &Findings, log: &FoundLog, at: Position) -> String {
    if let Some(reason) = &log.loads[at.load].refusal {
        return format!("left out: {reason}");
    }
    let run = found
        .runs
        .iter()
        .find(|run| run.log == at.log && run.load == at.load);
    run.map_or_else(String::new, |run| {
        let role = match run.role {
            Role::Train => "train",
            Role::HeldOut => "held out",
        };
        if run.repeat_group == run.name {
            format!("{}, {role}", run.name)
        } else {
            format!("{}, {role}, repeats {}", run.name, run.repeat_group)
        }
    })
}

fn row(load: &Load, used: &str) {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
    say!(
        "  {:>9.1} {:<9} {:>8.3} {:>8.1} {:>8} {:>8} {:>9} {:>7}  {used}",
        load.start_s,
        load.kind.word(),
        load.current_a,
        load.duration_s,
        or_dash(load.rest.map(|rest| format!("{:.1}", rest.duration_s))),
        or_dash(load.rest.map(|rest| format!("{:.4}", rest.voltage_v))),
        or_dash(
            load.rest
                .map(|rest| format!("{:+.2}", rest.slope_mv_per_min()))
        ),
        or_dash(load.soc.map(|soc| format!("{soc:.4}"))),
    );
}

fn noise(found: &Findings) {
    if found.logs.is_empty() {
        return;
    }
    let bench = &found.bench;
    let value = |value: Option<f64>, unit: &str| {
        value.map_or_else(
            || "not told by the data".to_owned(),
            |value| format!("{:.2} m{unit}", 1e3 * value),
        )
    };
    say!(
        "\nvoltage: noise {}, code step {}; current: noise {}, code step {}",
        value(bench.voltage_noise_v, "V"),
        value(bench.voltage_resolution_v, "V"),
        value(bench.current_noise_a, "A"),
        value(bench.current_resolution_a, "A")
    );
}
