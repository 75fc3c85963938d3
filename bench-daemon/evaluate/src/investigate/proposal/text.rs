//! `dataset.toml` of a proposal, with a comment on every choice.

use analysis::{
    diagnosis::Role,
    loads::{Estimate, Load, SocFrom},
};
use serde_json::json;

use super::{
    missing,
    runs::{FoundLog, FoundSpectrum, Place, ProposedRun},
    thresholds::BASE_LEVEL_V,
};

/// Names of a data set that cannot be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Named {
    /// Name of the data set.
    pub name: String,
    /// Name of the cell.
    pub cell: String,
    /// Path of the OCV curve from the folder of the data set.
    pub ocv: Option<String>,
    /// Files that the command writes beside the data set.
    pub own: OwnFiles,
    /// Direction that the logs count as positive, if the user stated it.
    pub current_positive: Option<&'static str>,
    /// Shortest rest before a load, s.
    pub rest_s: f64,
}

/// Files that the command writes beside the data set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OwnFiles {
    /// Name of the curve through the rest voltages.
    pub ocv: Option<String>,
    /// Name of the model to start from.
    pub model: Option<String>,
}

/// What is written into `dataset.toml`.
#[derive(Debug, Clone, Copy)]
pub struct Proposal<'a> {
    /// Logs.
    pub logs: &'a [FoundLog],
    /// Runs of their loads.
    pub runs: &'a [ProposedRun],
    /// Spectra.
    pub spectra: &'a [FoundSpectrum],
    /// Noise and codes.
    pub bench: &'a Estimate,
}

/// A proposal as the text of `dataset.toml`. Every number of a JSON text is one of TOML.
pub fn dataset_text(named: &Named, proposal: &Proposal<'_>) -> String {
    let Proposal {
        logs,
        runs,
        spectra,
        bench,
    } = *proposal;
    let mut text = head(named);
    text += &bench_text(bench);
    text += &notes(logs);
    for (order, run) in runs.iter().enumerate() {
        text += &run_text(named, logs, run, order);
    }
    for (number, spectrum) in spectra.iter().enumerate() {
        text += &spectrum_text(named, spectrum, runs.len() + number);
    }
    text += &left_out(logs);
    text
}

/// Remarks on the logs.
fn notes(logs: &[FoundLog]) -> String {
    let of = |log: &FoundLog| -> String {
        let each = log.notes.iter();
        each.map(|note| format!("# {}: {note}.\n", log.name))
            .collect()
    };
    let all: String = logs.iter().map(of).collect();
    if all.is_empty() {
        all
    } else {
        format!(
            "\n# What the files say beside current and voltage, and what contradicts it.\n{all}"
        )
    }
}

/// Comments in the place of the keys that a run lacks.
fn missing_lines(run: &str, place: &Place) -> impl Iterator<Item = String> {
    missing::of_place(run, place)
        .into_iter()
        .map(|one| format!("# {} =  # FILL IN: {}", one.key, one.text))
}

fn head(named: &Named) -> String {
    let mut text = format!(
        "\
# Proposed by `eis-bench dataset init`. Every choice below may be changed.
# Runs: each begins in the rest before its load and ends with the rest after it, or where the run
# after it begins. The rest before it is logged for {} s at least, and its voltage stands still.
# Repeats: pulses of equal current, duration, temperature and state share a `repeat_group`.
# Split: at each state of charge and in each direction the pulses of the largest and of a middle
# current are held out. At least two currents train; of three only the largest is held out, of two
# none.
# Of several drive cycles the last one is held out. Long discharges and spectra train.
# Times between logs are not known: each log begins where the one before it ends.
name = {}
",
        named.rest_s,
        json!(named.name)
    );
    text += &match (&named.ocv, &named.own.ocv) {
        (Some(path), _) => format!("ocv = {}\n", json!(path)),
        (None, Some(own)) => format!(
            "# The curve through the rest voltages of the runs at their states of charge.\nocv = {}\n",
            json!(own)
        ),
        (None, None) => "\
# ocv =  # FILL IN unless the model holds an OCV curve or `diagnose` gets --ocv: the path of a curve;
# `eis-bench ocv` makes one from a slow discharge.
"
        .to_owned(),
    };
    text + &match &named.own.model {
        Some(own) => format!(
            "# A model to start from, read off one load, for there is no spectrum: the diagnosis fits it\n\
             # again. `--model` takes its place.\nmodel = {}\n",
            json!(own)
        ),
        None => "# The model of the cell: `eis-bench diagnose` takes it as `--model`.\n".to_owned(),
    }
}

/// Why a key of `[bench]` may be missing.
const NOT_DETERMINED: &str = "the data do not determine it; the diagnosis assumes it";

/// Keys that a single campaign of a cycler never determines.
const NEVER_KNOWN: [&str; 7] = [
    "voltage_offset_v",
    "voltage_drift_v",
    "voltage_drift_s",
    "resistance_rel",
    "current_gain_rel",
    "current_offset_a",
    "eis_noise_rel",
];

fn bench_text(bench: &Estimate) -> String {
    let scatter = |hidden: bool, of: &str| {
        if hidden {
            format!("hidden by the codes: the most that it can be; seen in {of}")
        } else {
            format!("scatter in {of}")
        }
    };
    let codes = "step between codes".to_owned();
    let entries = [
        (
            "voltage_noise_v",
            bench.voltage_noise_v,
            scatter(bench.voltage_noise_hidden, "the rests"),
        ),
        (
            "voltage_resolution_v",
            bench.voltage_resolution_v,
            codes.clone(),
        ),
        (
            "current_noise_a",
            bench.current_noise_a,
            scatter(bench.current_noise_hidden, "constant currents"),
        ),
        ("current_resolution_a", bench.current_resolution_a, codes),
    ];
    let mut text =
        "\n# Errors of the bench, as far as the logs determine them.\n[bench]\n".to_owned();
    for (key, value, meaning) in entries {
        text += &match value {
            Some(value) => format!("{key} = {value:.1e}  # {meaning}\n"),
            None => format!("# {key}: {NOT_DETERMINED}\n"),
        };
    }
    for key in NEVER_KNOWN {
        text += &format!("# {key}: {NOT_DETERMINED}\n");
    }
    text
}

/// A time rounded to milliseconds, away from a sample that it must not lose.
fn milliseconds(time_s: f64, up: bool) -> f64 {
    let whole = 1e3 * time_s;
    (if up { whole.ceil() } else { whole.floor() }) / 1e3
}

fn run_text(named: &Named, logs: &[FoundLog], run: &ProposedRun, order: usize) -> String {
    let log = &logs[run.log];
    let load = &log.loads[run.load];
    let mut lines = vec![
        String::new(),
        format!("# Load: {}.", load_words(load)),
        format!("# {}.", rest_words(load)),
        format!("# {}.", state_words(load)),
        format!("# Role: {}.", run.reason),
        "[[runs]]".to_owned(),
        format!("name = {}", json!(run.name)),
        format!("file = {}", json!(log.file)),
        "kind = \"time\"".to_owned(),
        format!("cell = {}", json!(named.cell)),
    ];
    if let Some(temperature) = &log.temperature {
        let (celsius, source) = (temperature.celsius, &temperature.source);
        lines.push(format!("temperature_c = {celsius:?}  # {source}"));
    }
    lines.extend(start_line(load));
    lines.extend(missing_lines(&run.name, &run.place));
    if let Some(positive) = named.current_positive {
        lines.push(format!("current_positive = {}", json!(positive)));
    }
    let [from_s, to_s] = [
        milliseconds(load.from_s, false),
        milliseconds(load.to_s, true),
    ];
    lines.extend([format!("from_s = {from_s:?}"), format!("to_s = {to_s:?}")]);
    if let Some(base) = load.base {
        let compare_from_s = milliseconds(base.compare_from_s, false);
        lines.push(format!("compare_from_s = {compare_from_s:?}"));
        lines.push(format!(
            "level_sigma_v = {BASE_LEVEL_V:?}  # no rest determines the level"
        ));
    }
    lines.extend([
        format!("repeat_group = {}", json!(run.repeat_group)),
        format!("order = {order}"),
        format!("start_s = {:?}", milliseconds(run.start_s, false)),
    ]);
    if run.role == Role::HeldOut {
        lines.push("role = \"held_out\"".to_owned());
    }
    lines.join("\n") + "\n"
}

/// The key of the state at the start.
fn start_line(load: &Load) -> Option<String> {
    let by_rest = load
        .soc
        .is_none_or(|soc| soc.from == SocFrom::RestVoltage && soc.value > 0.0 && soc.value < 1.0);
    match (load.rest_v().filter(|_| by_rest), load.soc) {
        (Some(ocv_v), _) => Some(format!("ocv_v = {ocv_v:.5}")),
        (None, Some(soc)) => Some(format!("soc = {:.5}", soc.value)),
        (None, None) => None,
    }
}

fn load_words(load: &Load) -> String {
    let direction = if load.current_a < 0.0 {
        "charge"
    } else {
        "discharge"
    };
    format!(
        "{} of {:.3} A ({direction}) for {:.1} s from {:.1} s on",
        load.kind.word(),
        load.current_a.abs(),
        load.duration_s,
        load.start_s
    )
}

fn rest_words(load: &Load) -> String {
    let resistance = load.resistance_1s_ohm.map_or_else(String::new, |ohm| {
        format!("; {:.4} mΩ after 1 s", 1e3 * ohm)
    });
    let after = format!("{:.0} s of rest after it{resistance}", load.rest_after_s);
    match load.rest {
        Some(rest) => format!(
            "Rest before it: {:.1} s logged, {:.4} V, {:+.2} ± {:.2} mV per minute; {after}",
            rest.duration_s,
            rest.voltage_v,
            rest.slope_mv_per_min(),
            6e4 * rest.slope_sigma_v_per_s
        ),
        None => match load.base {
            Some(base) => format!(
                "It stands on {:.3} A, which flows all the time: played from {:.1} s on, compared from \
                 {:.1} s on{resistance}",
                base.current_a, load.from_s, base.compare_from_s
            ),
            None => format!("No rest before it; {after}"),
        },
    }
}

fn state_words(load: &Load) -> String {
    let celsius = match load.temperature_degc {
        Some(celsius) => format!("{celsius:.1} °C logged"),
        None => "no temperature logged".to_owned(),
    };
    let Some(soc) = load.soc else {
        return format!("State by the rest voltage, {celsius}");
    };
    let how = match soc.from {
        SocFrom::Counted => "counted charge",
        SocFrom::Column => "the column of the log",
        SocFrom::RestVoltage => "rest voltage and curve",
    };
    format!("{:.2} % SOC by {how}, {celsius}", 1e2 * soc.value)
}

fn spectrum_text(named: &Named, spectrum: &FoundSpectrum, order: usize) -> String {
    let place = &spectrum.place;
    let mut lines = vec![
        "[[runs]]".to_owned(),
        format!("name = {}", json!(spectrum.name)),
        format!("file = {}", json!(spectrum.file)),
        "kind = \"eis\"".to_owned(),
        format!("cell = {}", json!(named.cell)),
    ];
    if let Some(among) = &spectrum.among {
        lines.push(format!("spectrum = {}", json!(among)));
    }
    lines.extend(
        place
            .temperature_degc
            .map(|celsius| format!("temperature_c = {celsius:?}")),
    );
    lines.extend(match (place.soc, place.ocv_v) {
        (_, Some(ocv_v)) => Some(format!("ocv_v = {ocv_v:?}")),
        (Some(soc), None) => Some(format!("soc = {soc:?}")),
        (None, None) => None,
    });
    lines.extend(missing_lines(&spectrum.name, place));
    lines.extend(spectrum.from_hz.map(|hz| format!("from_hz = {hz:?}")));
    lines.extend(spectrum.to_hz.map(|hz| format!("to_hz = {hz:?}")));
    lines.push(format!("order = {order}"));
    let mut notes = vec![format!("Spectrum of {} points.", spectrum.points)];
    if !spectrum.assumed.is_empty() {
        notes.push(format!(
            "ASSUMED, because the file does not state it: {} as at the first run in time.",
            spectrum.assumed.join(", ")
        ));
    }
    if spectrum.from_hz.is_none() {
        notes.push(
            "No `from_hz`: all low frequencies count. It should be that of the fit of the model."
                .to_owned(),
        );
    }
    if spectrum.inductive {
        notes.push("Points above `to_hz` are inductive, which the model is not.".to_owned());
    }
    notes.push("It is listed last: its time in the campaign is not known.".to_owned());
    let used = match &spectrum.refusal {
        Some(reason) => {
            notes.push(format!("Left out: {reason}."));
            false
        }
        None => true,
    };
    let notes: String = notes.iter().map(|note| format!("# {note}\n")).collect();
    let mark = if used { "" } else { "# " };
    let lines: String = lines.iter().map(|line| format!("{mark}{line}\n")).collect();
    format!("\n{notes}{lines}")
}

fn left_out(logs: &[FoundLog]) -> String {
    let mut text = String::new();
    for log in logs {
        for load in &log.loads {
            let Some(reason) = &load.refusal else {
                continue;
            };
            text += &format!(
                "\n# Left out: {reason}.\n# Load: {}.\n# [[runs]]\n# file = {}\n# kind = \"time\"\n\
                # from_s = {:?}\n# to_s = {:?}\n",
                load_words(load),
                json!(log.file),
                milliseconds(load.from_s, false),
                milliseconds(load.to_s, true)
            );
        }
    }
    text
}
