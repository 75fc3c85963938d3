//! Prints what `dataset init` found and left out.

use analysis::diagnosis::Role;

use super::findings::{FileFinding, FileKind, Findings};
use bench_evaluate::investigate::proposal::{FoundLog, Load};
use bench_plan::support::terminal::say;

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
        log.notes.iter().for_each(|note| say!("  {note}"));
        if log.loads.is_empty() {
            continue;
        }
        say!(
            "  {:>9} {:<9} {:>8} {:>8} {:>8} {:>8} {:>9} {:>7} {:>7}  use",
            "start / s",
            "kind",
            "I / A",
            "t / s",
            "rest / s",
            "rest / V",
            "mV / min",
            "SOC",
            "R1 / mΩ"
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
            None if found.missing.iter().any(|one| one.run == spectrum.name) => {
                "train; keys are missing".to_owned()
            }
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
        "  {:>9.1} {:<9} {:>8.3} {:>8.1} {:>8} {:>8} {:>9} {:>7} {:>7}  {used}",
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
        or_dash(load.soc.map(|soc| format!("{:.4}", soc.value))),
        or_dash(
            load.resistance_1s_ohm
                .map(|ohm| format!("{:.3}", 1e3 * ohm))
        ),
    );
}

fn noise(found: &Findings) {
    if found.logs.is_empty() {
        return;
    }
    if let Some(curve) = &found.curve {
        let (low, high) = (curve.soc.first(), curve.soc.last());
        let percent = |soc: Option<&f64>| 100.0 * soc.copied().unwrap_or(f64::NAN);
        say!(
            "\ncurve of the open-circuit voltage: through {} rest voltages, {:.1} % to {:.1} % SOC",
            curve.soc.len(),
            percent(low),
            percent(high)
        );
    }
    if let Some(model) = &found.model {
        let branch = model.branch.map_or_else(String::new, |one| {
            format!("; {:.3} mΩ, {:.2} s", 1e3 * one.r_ohm, one.tau_s)
        });
        let ohm = 1e3 * model.r_ohm;
        say!(
            "model to start from, read off {}: {ohm:.3} mΩ{branch}",
            model.run
        );
    }
    let bench = &found.bench;
    let value = |value: Option<f64>, unit: &str| {
        value.map_or_else(
            || "not determined by the data".to_owned(),
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
