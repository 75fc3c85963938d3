//! Time and charge of the runs of a map: those that a plan expects, and those that a run has taken.

use std::{collections::BTreeMap, path::Path};

use analysis::run_folder::{READINGS, ReadingRow};
use bench_core::journal::{self, Entry, Line};
use bench_plan::plan::{Flow, Leg, Plan, Purpose, Stage, Step};

use super::rule::Budget;
use instruments::units::{Amps, Coulombs, Seconds};

/// Longest time between two readings of one current, s: after a longer one, the run was interrupted.
const LONGEST_GAP_S: f64 = 60.0;
/// Phases of readings without a direct current.
const WITHOUT_CHARGE: [&str; 4] = ["idle", "rest", "sine", "multisine"];

/// Returns time and charge that the plan of a map takes. Each full charge returns what the point before
/// it has left out, the first one `below_full_coulomb`.
pub(super) fn expected(plan: &Plan, mut below_full_coulomb: Coulombs) -> Budget {
    let extent = plan.extent();
    let mut seconds = plan.expected_s();
    let mut coulomb = extent.into_coulomb + extent.out_coulomb;
    for stage in &plan.stages {
        for step in &stage.steps {
            if let Some(current_a) = current_of_full_charge(step) {
                // A plan alone does not know how empty the cell is.
                let supposed_s = step.expected_s();
                seconds += below_full_coulomb / current_a - supposed_s;
                coulomb += below_full_coulomb - current_a * supposed_s;
            }
        }
        if let (Purpose::MapPoint, Some(point)) = (stage.purpose, stage.point()) {
            below_full_coulomb = point.below_full_coulomb;
        }
    }
    Budget {
        minutes: seconds / Seconds(60.0),
        charge_ah: coulomb / Coulombs(3600.0),
    }
}

/// The current of a charge until the cell is full, A.
fn current_of_full_charge(step: &Step) -> Option<Amps> {
    match step {
        Step::Leg(Leg {
            flow:
                Flow::Charge {
                    current_a,
                    charge_coulomb: None,
                    ..
                },
            ..
        }) => Some(*current_a),
        _ => None,
    }
}

/// Returns the time that a run took at its points over that which its plan expects, at least 1; 1 for a
/// run without points. Full charges, temperatures and controls do not count: they depend on where the
/// cell was and on persons.
pub(super) fn pace(plan: &Plan, folder: &Path) -> f64 {
    journal::read(folder).map_or(1.0, |read| pace_of(plan, &read.lines))
}

fn pace_of(plan: &Plan, lines: &[Line]) -> f64 {
    let (mut begun, mut taken_s) = (BTreeMap::new(), BTreeMap::new());
    for line in lines {
        match line.entry {
            Entry::Stage { stage } => {
                begun.insert(stage, line.time_s);
            }
            Entry::StageDone { stage } => {
                if let Some(begin_s) = begun.get(&stage) {
                    taken_s.insert(stage, line.time_s - *begin_s);
                }
            }
            _ => {}
        }
    }
    let (mut measured_s, mut expected_s) = (Seconds(0.0), Seconds(0.0));
    for (number, stage) in plan
        .stages
        .iter()
        .enumerate()
        .filter(|(_, one)| is_at_point(one))
    {
        if let Some(seconds) = taken_s.get(&number) {
            measured_s += *seconds;
            expected_s += stage.expected_s();
        }
    }
    if expected_s > Seconds(0.0) {
        f64::max(1.0, measured_s / expected_s)
    } else {
        1.0
    }
}

fn is_at_point(stage: &Stage) -> bool {
    let on_the_way = matches!(stage.purpose, Purpose::Temperature | Purpose::SocReset);
    stage.point().is_some() && !on_the_way
}

/// Returns the charge that direct currents of a run have moved in both directions, by its readings, Ah;
/// `None` if it has no readings.
pub(super) fn moved_ah(folder: &Path) -> Option<f64> {
    let text = std::fs::read_to_string(folder.join(READINGS)).ok()?;
    Some(moved_coulomb(&text) / 3600.0)
}

fn moved_coulomb(table: &str) -> f64 {
    let rows = table.lines().skip(1).filter_map(ReadingRow::parse);
    let mut before: Option<(ReadingRow, f64)> = None;
    let mut coulomb = 0.0;
    for row in rows {
        let Some(current_a) = row.current_a else {
            continue;
        };
        if let Some((last, last_a)) = before
            && last.phase == row.phase
            && !WITHOUT_CHARGE.contains(&row.phase)
        {
            let span_s = row.time_s - last.time_s;
            if (0.0..=LONGEST_GAP_S).contains(&span_s) {
                coulomb += 0.5 * (last_a.abs() + current_a.abs()) * span_s;
            }
        }
        before = Some((row, current_a));
    }
    coulomb
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::{config::load_experiment, procedure};

    #[test]
    fn a_full_charge_returns_what_the_point_before_it_has_left_out() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let experiment = load_experiment(&file, None).unwrap();
        let map = experiment.map.as_ref().unwrap();
        let plan = procedure::plan(&experiment);
        let (from_half, from_full) = (
            expected(&plan, 0.5 * map.capacity_coulomb),
            expected(&plan, Coulombs(0.0)),
        );
        let half_ah = map.capacity_coulomb.value() / 7200.0;
        assert!((from_half.charge_ah - from_full.charge_ah - half_ah).abs() < 1e-9);
        let minutes = 60.0 * half_ah / map.legs.charge_a.value();
        assert!((from_half.minutes - from_full.minutes - minutes).abs() < 1e-6);
        // 80 % out at each of two temperatures and once in again, and pulses.
        let legs_ah = 3.0 * 0.8 * map.capacity_coulomb.value() / 3600.0;
        let pulses_ah = from_full.charge_ah - legs_ah;
        assert!((0.0..1.0).contains(&pulses_ah), "{pulses_ah}");
    }

    #[test]
    fn the_pace_is_that_of_the_points_and_at_least_one() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let plan = procedure::plan(&load_experiment(&file, None).unwrap());
        let pace = |at_points: f64, elsewhere: f64| {
            let (mut lines, mut time_s) = (Vec::new(), Seconds(0.0));
            for (stage, one) in plan.stages.iter().enumerate() {
                let factor = if is_at_point(one) {
                    at_points
                } else {
                    elsewhere
                };
                for entry in [Entry::Stage { stage }, Entry::StageDone { stage }] {
                    lines.push(Line {
                        number: 1,
                        time_s,
                        entry,
                    });
                    time_s += factor * one.expected_s();
                }
            }
            pace_of(&plan, &lines)
        };
        assert!((pace(1.5, 9.0) - 1.5).abs() < 1e-9);
        assert_eq!(pace(0.5, 9.0), 1.0);
        assert_eq!(pace_of(&plan, &[]), 1.0);
    }

    #[test]
    fn the_charge_of_direct_currents_counts_in_both_directions() {
        let table = "time_s,phase,voltage_v,current_a,temperature_c\n0,idle,3.7,0,\n1,charge,3.7,2,\n\
            11,charge,3.8,2,\n12,discharge,3.6,-3,\n22,discharge,3.5,,\n32,discharge,3.5,-3,\n\
            500,discharge,3.5,-3,\n501,sine,3.7,1,\n520,sine,3.7,-1,\n";
        assert!((moved_coulomb(table) - 80.0).abs() < 1e-9);
    }
}
