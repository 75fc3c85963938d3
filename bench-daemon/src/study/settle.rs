//! Plays the recommended experiments of a diagnosis on the same hidden truth, one after the other,
//! and diagnoses again after each.

use analysis::diagnosis::{
    BaseModel, BenchLimits, DataSet, DiagnosisOptions, Fixture, Outcome, Planned, PlannedRun,
    Verdict, gate,
};
use fixtures::hidden::{self, Case, PlanKind, RunPlan, Spec, Trace};

use super::convert;

/// What a user would state of the simulated bench: the currents of its campaign, and ten times its
/// highest frequency.
const LIMITS: BenchLimits = BenchLimits {
    discharge_a: 100.0,
    charge_a: 40.0,
    highest_hz: 3000.0,
    shunt_ohm: None,
};

/// The options of every diagnosis of the study.
pub fn options() -> DiagnosisOptions {
    DiagnosisOptions {
        limits: Some(LIMITS),
        ..DiagnosisOptions::default()
    }
}

/// The diagnoses after each recommended experiment, until one is neither ambiguous nor unexplained,
/// nothing is recommended, or `most` were played.
///
/// # Errors
/// A set that cannot be used.
pub fn settle(
    spec: &Spec,
    (set, most): (&DataSet, usize),
    model: &BaseModel,
    outcome: &Outcome,
) -> anyhow::Result<Vec<Outcome>> {
    let mut more = set.clone();
    let mut after: Vec<Outcome> = Vec::new();
    while after.len() < most {
        let last = after.last().unwrap_or(outcome);
        if !matches!(
            last.diagnosis.verdict,
            Verdict::Ambiguous | Verdict::Unexplained
        ) || last.next_runs.is_empty()
        {
            break;
        }
        measure(spec, &last.next_runs, &mut more);
        after.push(gate::diagnose_gated(&more, Vec::new(), model, &options())?);
    }
    Ok(after)
}

/// What the same planned runs say of the same cell on the same bench where nothing is hidden.
///
/// # Errors
/// A set that cannot be used.
pub fn placebo(spec: &Spec, runs: &[PlannedRun]) -> anyhow::Result<Outcome> {
    let spec = Spec {
        hidden: Vec::new(),
        ..spec.clone()
    };
    let case = Case::new(&spec);
    let mut set = convert::data_set(&case);
    let model = convert::model(&set, &case.base)?;
    measure(&spec, runs, &mut set);
    Ok(gate::diagnose_gated(&set, Vec::new(), &model, &options())?)
}

/// Adds planned runs, all their repeats measured, to a set.
fn measure(spec: &Spec, runs: &[PlannedRun], set: &mut DataSet) {
    for run in runs {
        set.runs.extend(
            (0..run.repeat).map(|nth| convert::run(&hidden::follow_up(spec, &plan(run, nth)))),
        );
    }
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
        Planned::Eis {
            freq_hz,
            amplitude_a,
        } => PlanKind::Eis {
            freq_hz: freq_hz.iter().rev().copied().collect(),
            amplitude_a: *amplitude_a,
        },
    };
    RunPlan {
        name: format!("{}_{}", run.name, run.order as usize + nth),
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
