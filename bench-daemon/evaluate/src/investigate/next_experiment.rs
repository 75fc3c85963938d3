//! Writes the recommended run of a diagnosis as an experiment file that the daemon reads. Settings
//! outside the limits of cell or bench are refused when it is read.
use std::fmt::Write as _;

use analysis::{
    diagnosis::{Fixture, NextExperiment, Planned, PlannedRun},
    ocv::OcvCurve,
};

/// Currents of the reset of the state of charge: out and in, A.
const RESET_A: (f64, f64) = (5.0, 3.0);
/// How far the discharge of the reset goes below the voltage at rest, V.
const RESET_BELOW_V: f64 = 0.15;
/// How far the voltage at rest may be off when currents begin, V.
const START_WITHIN_V: f64 = 0.08;
/// Maximum resistance of leads and contacts in addition to that of the cell, Ω.
const LEADS_OHM: f64 = 5e-3;
/// Shortest current that the daemon accepts, s.
const SHORTEST_S: f64 = 0.5;

/// Bench, cell and data of the run.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The bench's file, as seen from the experiment's.
    pub bench: &'a str,
    /// The cell's file, as seen from the experiment's.
    pub cell: &'a str,
    /// The curve of the cell: voltages at rest.
    pub ocv: &'a OcvCurve,
    /// The cell's resistance to a long current, Ω.
    pub resistance_ohm: f64,
}

/// The experiment file of a recommended run. A file has one place for a sweep: of several planned
/// sweeps the first is written.
pub fn experiment_file(
    next: &NextExperiment,
    runs: &[PlannedRun],
    setting: &Setting<'_>,
) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "# {}: {}.", next.name, next.description);
    if !next.separates.is_empty() {
        let _ = writeln!(out, "# It is to separate: {}.", next.separates.join(", "));
    }
    let _ = writeln!(
        out,
        "# Expected separation {:.1} standard deviations (now {:.1}); {:.0} min, {:.2} Ah.",
        next.separation_sigma, next.separation_now_sigma, next.duration_min, next.charge_ah
    );
    let _ = writeln!(
        out,
        "name = {:?}\nbench = {:?}\ncell = {:?}\nseed = 1",
        next.name, setting.bench, setting.cell
    );
    if let Some(run) = runs
        .iter()
        .find(|run| matches!(run.fixture, Fixture::Cell(_)))
    {
        out.push_str(&circumstances(run, setting));
    }
    if let Some(run) = runs
        .iter()
        .find(|run| matches!(run.what, Planned::Eis { .. }))
    {
        out.push_str(&sweep(run, setting));
    }
    runs.iter()
        .for_each(|run| out.push_str(&trace(run, setting)));
    out
}

/// Temperature and state of charge of a run on the cell.
fn circumstances(run: &PlannedRun, setting: &Setting<'_>) -> String {
    let rest_v = setting.ocv.voltage_v(run.soc);
    let [until_v, charged_v, greatest_v] = [
        rest_v - RESET_A.0 * setting.resistance_ohm - RESET_BELOW_V,
        rest_v + RESET_A.1 * setting.resistance_ohm,
        setting.ocv.voltage_v(1.0),
    ];
    format!(
        "\n[temperature]\nsetpoint = \"{:.1} °C\"\nwithin = \"0.2 K\"\ntimeout = \"120 min\"\n\
         \n# To {:.0} % state of charge: {rest_v:.3} V at rest.\n[soc_reset]\n\
         discharge_current = \"{} A\"\ndischarge_until = \"{until_v:.3} V\"\n\
         charge_current = \"{} A\"\ncharge_voltage = \"{greatest_v:.2} V\"\n\
         charge_until = \"{charged_v:.3} V\"\nrest_min = \"5 min\"\n\
         rest_max = \"60 min\"\nrest_slope = \"0.1 mV/min\"\nmax_duration = \"2 h\"\n",
        run.temperature_degc,
        100.0 * run.soc,
        RESET_A.0,
        RESET_A.1,
    )
}

fn sweep(run: &PlannedRun, setting: &Setting<'_>) -> String {
    let Planned::Eis {
        freq_hz,
        amplitude_a,
        bias_a,
    } = &run.what
    else {
        return String::new();
    };
    let frequencies: Vec<String> = freq_hz.iter().map(|f| format!("\"{f:.6} Hz\"")).collect();
    let place = match run.fixture {
        Fixture::Shunt(ohm) => format!(
            "# The bench's shunt is swept; {:.1} mΩ are expected.\nfixture = \"shunt\"\n",
            1e3 * ohm
        ),
        _ => format!("rest_first = \"{:.0} s\"\n", run.settle_s),
    };
    let bias = if *bias_a == 0.0 {
        "periods_on_screen = 2\nextra_wait = \"20 s\"\n".to_owned()
    } else {
        // Files count charging positive. The fastest points come first: they move the least charge.
        format!(
            "periods_on_screen = 4\nextra_wait = \"1 s\"\norder = \"descending\"\n\
            bias = [\"{:.3} A\"]\nresistance_max = \"{:.0} mΩ\"\n",
            0.0 - bias_a,
            resistance_max_mohm(setting)
        )
    };
    format!(
        "\n[eis]\nfrequencies = [{}]\namplitude = \"{amplitude_a:.3} A\"\nperiods = 2\n{bias}\
        repeat = {}\n{place}",
        frequencies.join(", "),
        run.repeat
    )
}

/// Returns the greatest resistance that a run expects, leads included, mΩ.
fn resistance_max_mohm(setting: &Setting<'_>) -> f64 {
    (1e3 * (1.5 * setting.resistance_ohm + LEADS_OHM)).ceil()
}

fn trace(run: &PlannedRun, setting: &Setting<'_>) -> String {
    let Planned::Trace(segments) = &run.what else {
        return String::new();
    };
    let rest_v = setting.ocv.voltage_v(run.soc);
    let mut out = format!(
        "\n[[traces]]\nname = {:?}\nrepeat_group = {:?}\nrepeat = {}\nrest_first = \"{:.0} s\"\n\
        start_voltage = [\"{:.3} V\", \"{:.3} V\"]\n\
         resistance_max = \"{:.0} mΩ\"\nsegments = [\n",
        run.name,
        run.repeat_group,
        run.repeat,
        run.settle_s,
        rest_v - START_WITHIN_V,
        rest_v + START_WITHIN_V,
        resistance_max_mohm(setting),
    );
    for (span_s, amps) in timed(segments) {
        // Files count charging positive; zero stays free of a sign.
        let _ = writeln!(
            out,
            "    {{ current = \"{:.3} A\", duration = \"{span_s:.3} s\" }},",
            0.0 - amps
        );
    }
    out.push_str("]\n");
    out
}

/// Joins currents that are too short for the daemon to the following ones; the charge is kept.
fn timed(segments: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = Vec::new();
    for (span_s, amps) in segments {
        match all.last_mut().filter(|last| last.0 < SHORTEST_S) {
            Some(last) => {
                *last = (
                    last.0 + span_s,
                    (last.0 * last.1 + span_s * amps) / (last.0 + span_s),
                );
            }
            None => all.push((*span_s, *amps)),
        }
    }
    if all.last().is_some_and(|last| last.0 < SHORTEST_S) && all.len() > 1 {
        all.pop();
    }
    all
}

#[cfg(test)]
mod tests {
    use instruments::units::{Amps, Celsius, Ohms, Seconds, Volts};
    use std::path::Path;

    use super::*;
    use bench_plan::{config::load_experiment, procedure};

    fn ocv() -> OcvCurve {
        OcvCurve::monotone(
            4.5,
            vec![0.0, 0.2, 0.5, 0.8, 1.0],
            vec![2.9, 3.45, 3.68, 3.98, 4.19],
        )
        .unwrap()
    }

    fn run(fixture: Fixture, what: Planned) -> PlannedRun {
        PlannedRun {
            name: "planned".to_owned(),
            fixture,
            soc: 0.5,
            temperature_degc: 25.0,
            repeat: 3,
            repeat_group: "group".to_owned(),
            order: 20,
            settle_s: 600.0,
            start_s: 1e5,
            what,
        }
    }

    fn cell() -> Fixture {
        Fixture::Cell("cell".to_owned())
    }

    fn written(runs: &[PlannedRun]) -> String {
        let next = NextExperiment {
            name: "the_run",
            description: "what is done".to_owned(),
            separates: vec!["inductance", "time_skew"],
            separation_sigma: 12.34,
            separation_now_sigma: 0.5,
            settles: true,
            duration_min: 42.0,
            charge_ah: 1.25,
        };
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let (bench, cell) = (
            configs.join("benches/investigate.toml"),
            configs.join("cells/p45b.toml"),
        );
        let setting = Setting {
            bench: bench.to_str().unwrap(),
            cell: cell.to_str().unwrap(),
            ocv: &ocv(),
            resistance_ohm: 17e-3,
        };
        experiment_file(&next, runs, &setting)
    }

    fn read_back(runs: &[PlannedRun]) -> bench_plan::config::Experiment {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("next_experiment.toml");
        let text = written(runs);
        std::fs::write(&path, &text).unwrap();
        let experiment = load_experiment(&path, None).unwrap_or_else(|e| panic!("{e}\n{text}"));
        procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .unwrap_or_else(|e| panic!("{e}\n{text}"));
        experiment
    }

    #[test]
    fn a_trace_comes_back_with_charging_positive() {
        let segments = vec![(2.0, 0.0), (0.5, 18.0), (0.6923, -13.0), (300.0, 0.0)];
        let experiment = read_back(&[run(cell(), Planned::Trace(segments))]);
        assert!(
            experiment.eis.is_none()
                && experiment
                    .temperature
                    .is_some_and(|t| t.setpoint_degc == Celsius(25.0))
        );
        let [trace] = experiment.traces.as_slice() else {
            panic!("one trace")
        };
        assert_eq!(
            (trace.repeat, trace.rest_s, trace.repeat_group.as_str()),
            (3, Seconds(600.0), "group")
        );
        let back: Vec<(f64, f64)> = trace
            .segments
            .iter()
            .map(|s| (s.duration_s.value(), s.current_a.value()))
            .collect();
        assert_eq!(
            back,
            [(2.0, 0.0), (0.5, -18.0), (0.692, 13.0), (300.0, 0.0)]
        );
        assert!(
            (trace.start_v.0 - Volts(3.6)).abs() < Volts(1e-9)
                && (trace.resistance_max_ohm - Ohms(31e-3)).abs() < Ohms(1e-9)
        );
    }

    #[test]
    fn sweeps_come_back_for_cell_and_shunt() {
        let what = Planned::Eis {
            freq_hz: vec![0.1, 1.0, 10.0, 50.0, 100.0, 300.0],
            amplitude_a: 5.0,
            bias_a: 0.0,
        };
        let mut elsewhere = run(cell(), what.clone());
        (elsewhere.soc, elsewhere.temperature_degc) = (0.7, 35.0);
        let on_cell = read_back(&[elsewhere]);
        let eis = on_cell.eis.unwrap();
        assert_eq!(
            (eis.repeat, eis.amplitude_a, eis.rest_s, eis.freqs_hz.len()),
            (3, Amps(5.0), Seconds(600.0), 6)
        );
        assert!(
            on_cell
                .temperature
                .is_some_and(|t| t.setpoint_degc == Celsius(35.0))
        );
        let reset = on_cell.soc_reset.unwrap();
        let rest_v = ocv().voltage_v(0.7);
        assert!(
            reset.charge_until_v > Volts(rest_v)
                && reset.charge_until_v < Volts(rest_v + 0.1)
                && reset.discharge_until_v < Volts(rest_v)
        );
        let on_shunt = read_back(&[run(Fixture::Shunt(10e-3), what)]);
        assert_eq!(
            on_shunt.eis.unwrap().fixture,
            instruments::fixture::Fixture::Shunt
        );
        assert!(
            on_shunt.temperature.is_none()
                && on_shunt.soc_reset.is_none()
                && on_shunt.traces.is_empty()
        );
    }

    #[test]
    fn a_direct_current_under_a_sweep_comes_back_with_its_sign() {
        let what = Planned::Eis {
            freq_hz: vec![1.0, 3.0, 10.0, 30.0, 100.0, 300.0],
            amplitude_a: 1.0,
            bias_a: 2.5,
        };
        let bias = read_back(&[run(cell(), what)]).eis.unwrap().bias.unwrap();
        // A discharge is negative in a file.
        assert_eq!(bias.levels_a, [Amps(-2.5)]);
        assert!((bias.resistance_ohm - Ohms(31e-3)).abs() < Ohms(1e-9));
    }

    #[test]
    fn the_head_says_what_it_is_for() {
        let text = written(&[run(cell(), Planned::Trace(vec![(600.0, 0.0)]))]);
        assert!(text.starts_with(
            "# the_run: what is done.\n# It is to separate: inductance, time_skew.\n# Expected \
             separation 12.3 standard deviations (now 0.5); 42 min, 1.25 Ah.\nname = \"the_run\"\n"
        ));
    }

    #[test]
    fn currents_too_short_are_joined_and_keep_their_charge() {
        let joined = timed(&[
            (0.2, 10.0),
            (0.2, -10.0),
            (0.4, 5.0),
            (2.0, 1.0),
            (0.1, 3.0),
        ]);
        assert_eq!(joined.len(), 2);
        assert!(
            (joined[0].0 - 0.8).abs() < 1e-12 && (joined[0].0 * joined[0].1 - 2.0).abs() < 1e-12
        );
        assert_eq!(joined[1], (2.0, 1.0));
    }
}
