//! Plays the recommended experiment of a diagnosis on the same hidden truth, and diagnoses again.

use analysis::diagnosis::{BaseModel, BenchLimits, DataSet, DiagnosisOptions, Fixture, Outcome, Planned, PlannedRun, diagnose};
use fixtures::hidden::{self, PlanKind, RunPlan, Spec, Trace};

use super::convert;

/// What a user would state of the simulated bench: the currents of its campaign, and ten times its highest frequency.
const LIMITS: BenchLimits = BenchLimits { discharge_a: 100.0, charge_a: 40.0, highest_hz: 3000.0, shunt_ohm: None };

/// The options of every diagnosis of the study.
pub fn options() -> DiagnosisOptions {
    DiagnosisOptions { limits: Some(LIMITS), ..DiagnosisOptions::default() }
}

/// The diagnosis with the recommended runs among the training runs; none where nothing was recommended.
///
/// # Errors
/// A set that cannot be used.
pub fn settle(spec: &Spec, set: &DataSet, model: &BaseModel, outcome: &Outcome) -> anyhow::Result<Option<Outcome>> {
    if outcome.next_runs.is_empty() {
        return Ok(None);
    }
    let mut more = set.clone();
    for run in &outcome.next_runs {
        more.runs.extend((0..run.repeat).map(|nth| convert::run(&hidden::follow_up(spec, &plan(run, nth)))));
    }
    Ok(Some(diagnose(&more, model, &options())?))
}

/// One repeat of a planned run, counted from 0, as the simulated bench is asked for it.
fn plan(run: &PlannedRun, nth: usize) -> RunPlan {
    let fixture = match run.fixture {
        Fixture::Cell(_) => hidden::Fixture::Cell,
        Fixture::Shunt(ohm) => hidden::Fixture::Shunt { ohm },
        Fixture::FakeCell(ohm) => hidden::Fixture::FakeCell { ohm },
    };
    let kind = match &run.what {
        Planned::Trace(segments) => PlanKind::Time(Trace::of_segments(segments)),
        // Sweeps begin at the greatest frequency.
        Planned::Eis { freq_hz, amplitude_a } => {
            PlanKind::Eis { freq_hz: freq_hz.iter().rev().copied().collect(), amplitude_a: *amplitude_a }
        }
    };
    RunPlan {
        name: format!("{}_after_{}", run.name, nth + 1),
        kind,
        fixture,
        temperature_c: run.temperature_c,
        start_soc: run.soc,
        repeat_group: run.repeat_group.clone(),
        order: run.order as usize + nth,
        start_s: run.repeat_start_s(nth),
        held_out: false,
    }
}
