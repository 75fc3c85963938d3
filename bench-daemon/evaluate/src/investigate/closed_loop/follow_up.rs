//! Creates an experiment on the same bench and cell from planned runs. The controls are not
//! measured again: the correction stays.

use analysis::{
    diagnosis::{DataSet, Fixture, Planned, PlannedRun, Run, RunData, Start},
    ocv::OcvCurve,
    series::Role,
};
use instruments::{
    fixture,
    units::{Amps, Celsius, Hertz, Seconds, Volts},
};

use bench_plan::{
    config::{Eis, EisBias, Experiment, Order, Segment, Trace, check_frames},
    plan::Through,
    procedure,
};

/// State of charge by which the cell may be elsewhere without being brought back.
const SOC_NEAR: f64 = 0.05;
/// Temperature by which the cell may be elsewhere, K.
const NEAR_K: f64 = 2.0;
/// Tolerance between the controls in the jig and those of the plan, as a fraction.
const CONTROL_NEAR: f64 = 0.05;
/// Open-circuit voltages around the planned one at which a trace may begin, V.
const START_WITHIN_V: f64 = 0.06;
/// Shortest segment, s.
const SHORTEST_S: f64 = 0.5;
/// Frequencies below this are swept with few periods, Hz: each takes minutes.
const SLOW_HZ: f64 = 0.05;
/// Number of periods that are waited for, and number that are recorded: a screen may be two and a
/// half times as long as requested, and must fill.
const SLOW_PERIODS: (f64, f64) = (6.0, 2.5);

/// Start of a planned run: the campaign, and the state in which it left the cell.
#[derive(Debug, Clone)]
pub(super) struct Site {
    first: Experiment,
    ocv: OcvCurve,
    /// Temperature (°C) and state of charge of the first run.
    begin: (f64, f64),
    /// State of charge after the last.
    now_soc: f64,
}

impl Site {
    /// Errors describe what the campaign lacks.
    pub(super) fn new(first: &Experiment, set: &DataSet, ocv: &OcvCurve) -> Result<Self, String> {
        let soc = |run: &Run| {
            if let Start::Ocv(v) = run.start {
                ocv.soc_at(v).unwrap_or(f64::NAN)
            } else {
                f64::NAN
            }
        };
        let cells = || {
            set.runs
                .iter()
                .filter(|run| matches!(run.fixture, Fixture::Cell(_)))
        };
        let (Some(begin), Some(last)) = (
            cells().min_by_key(|run| run.order),
            cells().max_by_key(|run| run.order),
        ) else {
            return Err("the cell was never measured".to_owned());
        };
        let drawn_coulomb = if let RunData::Time(record) = &last.data {
            record.series.charge_coulomb().last().copied()
        } else {
            None
        };
        let now_soc = soc(last) - drawn_coulomb.unwrap_or(0.0) / (3600.0 * ocv.capacity_ah);
        Ok(Self {
            first: first.clone(),
            ocv: ocv.clone(),
            begin: (begin.temperature_degc, soc(begin)),
            now_soc,
        })
    }

    /// Returns the experiment that executes planned runs, and its time on the bench, min. Errors
    /// describe what bench, cell or campaign lack.
    pub(super) fn experiment(&self, runs: &[PlannedRun]) -> Result<(Experiment, f64), String> {
        let Some(leading) = runs.first() else {
            return Err("expected a planned run, found none".to_owned());
        };
        self.can_follow_each_other(runs)?;
        let first = &self.first;
        let mut experiment = Experiment {
            name: format!("{}-{}", first.name, leading.name),
            fixture_check: None,
            soc_reset: None,
            eis: None,
            traces: Vec::new(),
            ..first.clone()
        };
        if matches!(leading.fixture, Fixture::Cell(_)) {
            self.bring(&mut experiment, leading)?;
        } else {
            experiment.temperature = None;
        }
        for run in runs {
            match &run.what {
                Planned::Trace(segments) => {
                    experiment
                        .traces
                        .push(trace(first, run, &self.ocv, segments)?);
                }
                Planned::Eis { .. } => experiment.eis = Some(sweep(first, run)?),
            }
        }
        let plan = procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .map_err(|error| error.to_string())?;
        let minutes = plan.plan().expected_s() / 60.0;
        Ok((experiment, minutes.0))
    }

    /// Checks whether runs can be executed in turn in one experiment: all have the same object in
    /// the jig, at most one is a sweep, and none may leave the cell in another state.
    fn can_follow_each_other(&self, runs: &[PlannedRun]) -> Result<(), String> {
        if runs.windows(2).any(|w| w[0].fixture != w[1].fixture) {
            return Err("its runs want different things in the jig".to_owned());
        }
        if runs
            .iter()
            .filter(|run| matches!(run.what, Planned::Eis { .. }))
            .count()
            > 1
        {
            return Err("an experiment has place for one sweep".to_owned());
        }
        let capacity_coulomb = 3600.0 * self.ocv.capacity_ah;
        let stays = |run: &PlannedRun| moved_coulomb(run).abs() < 0.01 * capacity_coulomb;
        if runs.len() > 1 && !runs.iter().all(stays) {
            return Err(
                "one of its runs leaves the cell at another charge than the others begin at"
                    .to_owned(),
            );
        }
        Ok(())
    }

    /// Brings the cell to another temperature or state of charge, if planned.
    fn bring(&self, experiment: &mut Experiment, run: &PlannedRun) -> Result<(), String> {
        let (begin_coulomb, begin_soc) = self.begin;
        if (run.temperature_degc - begin_coulomb).abs() > NEAR_K {
            let held = experiment
                .temperature
                .as_mut()
                .ok_or("the campaign holds no temperature")?;
            held.setpoint_degc = Celsius(run.temperature_degc);
        }
        if (run.soc - self.now_soc).abs() > SOC_NEAR {
            // The reset ends at the campaign's state of charge: its voltages are moved by as much
            // as the open-circuit voltage is to move.
            let mut reset = self
                .first
                .soc_reset
                .ok_or("the campaign has no reset of the state of charge")?;
            let shift_v = self.ocv.voltage_v(run.soc) - self.ocv.voltage_v(begin_soc);
            reset.discharge_until_v += Volts(shift_v);
            reset.charge_until_v += Volts(shift_v);
            experiment.soc_reset = Some(reset);
        }
        Ok(())
    }
}

/// Charge that all repeats of a run take out of the cell, C.
fn moved_coulomb(run: &PlannedRun) -> f64 {
    let Planned::Trace(segments) = &run.what else {
        return 0.0;
    };
    segments
        .iter()
        .map(|(span_s, amps)| span_s * amps)
        .sum::<f64>()
        * run.repeat as f64
}

fn sweep(first: &Experiment, run: &PlannedRun) -> Result<Eis, String> {
    let Planned::Eis {
        freq_hz,
        amplitude_a,
        bias_a,
    } = &run.what
    else {
        return Err("expected a sweep, found a trace".to_owned());
    };
    let mut eis = first.eis.clone().ok_or("the campaign sweeps nothing")?;
    eis.fixture = fixture(first, &run.fixture)?;
    (eis.repeat, eis.rest_s) = (run.repeat, Seconds(run.settle_s.min(600.0)));
    (eis.amplitude_a, eis.steps_a) = (Amps(*amplitude_a), vec![Amps(*amplitude_a)]);
    eis.bias = (*bias_a != 0.0).then(|| bias(first, *bias_a)).transpose()?;
    if eis.bias.is_some() {
        // As a file with a bias must be; the fastest points, which move the least charge, come first.
        (eis.compensate_drift, eis.order) = (false, Order::Descending);
        if let Some(quality) = &mut eis.quality {
            quality.again = 0;
        }
    }
    if freq_hz.first().is_some_and(|f| *f < SLOW_HZ) {
        (eis.periods, eis.periods_on_screen) = SLOW_PERIODS;
    }
    eis.freqs_hz = freq_hz.iter().copied().map(Hertz).collect();
    check_frames(&first.bench, &eis)?;
    Ok(eis)
}

/// Returns the direct current under a planned sweep; its charge is bounded as in a file without
/// `bias_charge`.
fn bias(first: &Experiment, bias_a: f64) -> Result<EisBias, String> {
    let like = first
        .traces
        .first()
        .ok_or("the campaign has no trace to take the greatest resistance from")?;
    let capacity_coulomb = first.cell.capacity_coulomb;
    Ok(EisBias {
        // An experiment counts charging positive.
        levels_a: vec![Amps(0.0 - bias_a)],
        most_coulomb: EisBias::CHARGE * capacity_coulomb,
        resistance_ohm: like.resistance_max_ohm,
        settle_s: EisBias::SETTLE_S,
        capacity_coulomb,
    })
}

fn trace(
    first: &Experiment,
    run: &PlannedRun,
    ocv: &OcvCurve,
    segments: &[(f64, f64)],
) -> Result<Trace, String> {
    let like = first
        .traces
        .first()
        .ok_or("the campaign has no trace to take its sampling from")?;
    let limits = &first.cell.limits;
    // Every repeat begins at the end of the previous one.
    let moved_coulomb: f64 = segments
        .iter()
        .map(|(span_s, amps)| span_s * amps)
        .sum::<f64>()
        * run.repeat.saturating_sub(1) as f64;
    let (begin_v, end_v) = (
        ocv.voltage_v(run.soc),
        ocv.voltage_v(run.soc - moved_coulomb / (3600.0 * ocv.capacity_ah)),
    );
    let segment = |(span_s, amps): &(f64, f64)| Segment {
        current_a: Amps(0.0 - amps),
        duration_s: Seconds(span_s.max(SHORTEST_S)),
        power_w: None,
    };
    Ok(Trace {
        name: run.name.clone(),
        role: Role::Train,
        repeat_group: run.repeat_group.clone(),
        repeat: run.repeat,
        rest_s: Seconds(run.settle_s.min(600.0)),
        start_v: (
            Volts((begin_v.min(end_v) - START_WITHIN_V).max(limits.min_v.0)),
            Volts((begin_v.max(end_v) + START_WITHIN_V).min(limits.max_v.0)),
        ),
        segments: segments.iter().map(segment).collect(),
        through: Through::Bipolar,
        averaged: None,
        ..like.clone()
    })
}

/// The fixture of the bench that a planned one is.
fn fixture(first: &Experiment, planned: &Fixture) -> Result<fixture::Fixture, String> {
    match planned {
        Fixture::Cell(_) => Ok(fixture::Fixture::Cell),
        Fixture::Shunt(ohm) => {
            let have_ohm = first.bench.wiring.shunt.r_ohm;
            let fits = (have_ohm / ohm - 1.0).abs() < CONTROL_NEAR;
            fits.then_some(fixture::Fixture::Shunt).ok_or_else(|| {
                format!(
                    "it wants a shunt of {:.1} mΩ, the bench's has {:.2} mΩ",
                    1e3 * ohm,
                    1e3 * have_ohm
                )
            })
        }
        Fixture::FakeCell(_) => {
            Err("a sweep of the fake cell does not belong to the cell's data".to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use bench_plan::{config::load_experiment, plan::Step};

    /// Returns amplitude and direct current of each point of a planned sweep.
    fn driven(amplitude_a: f64, bias_a: f64) -> Vec<(f64, f64)> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../configs/experiments/investigate.toml");
        let first = load_experiment(&file, None).unwrap();
        let run = PlannedRun {
            name: "other".to_owned(),
            fixture: Fixture::Cell("cell".to_owned()),
            soc: 0.5,
            temperature_degc: 25.0,
            repeat: 2,
            repeat_group: "other".to_owned(),
            order: 20,
            settle_s: 600.0,
            start_s: 1e5,
            what: Planned::Eis {
                freq_hz: vec![1.0, 10.0],
                amplitude_a,
                bias_a,
            },
        };
        let eis = sweep(&first, &run).unwrap();
        let experiment = Experiment {
            fixture_check: None,
            soc_reset: None,
            traces: Vec::new(),
            eis: Some(eis),
            ..first
        };
        let plan = procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .unwrap();
        let mut driven = Vec::new();
        for stage in &plan.plan().stages {
            for (at, step) in stage.steps.iter().enumerate() {
                if let Step::Sine { amplitude_a, .. } = step {
                    driven.push((amplitude_a.value(), stage.bias_at(at).value()));
                }
            }
        }
        driven
    }

    #[test]
    fn a_planned_sweep_is_driven_as_planned_and_not_as_the_campaign() {
        assert_eq!(driven(4.5, 0.0), [(4.5, 0.0); 4]);
    }

    #[test]
    fn a_discharge_under_a_planned_sweep_is_negative_on_the_bench() {
        assert_eq!(driven(1.0, 2.0), [(1.0, -2.0); 4]);
    }
}
