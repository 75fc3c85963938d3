//! The table of the points of a map, which grows with the run, and the stages that bring the cell back
//! to a point.

use instruments::units::Celsius;

use analysis::run_folder::{self, MAP_POINTS, MapPoint as Row};

use bench_core::{
    executor::Executor,
    record::{Event, Recorder},
    safety::failure::Failure,
};
use bench_plan::{
    config::MapProcedure,
    plan::{CampaignRun, Plan, Purpose, percent},
};

/// Stages of a plan that a stage of a map depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Way {
    /// The full charge, and the temperature before it.
    full: (usize, usize),
    /// The discharge to the point, and the temperature before it.
    point: (usize, usize),
}

/// Where the cell stands, as seen from a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standing {
    /// Its charge beyond that of the point, C.
    pub(super) beyond_coulomb: f64,
    /// Distance within which it counts as being there, C.
    pub(super) within_coulomb: f64,
    /// The stage whose temperature is held.
    pub(super) held: Option<usize>,
}

impl Way {
    /// Returns the way to the point of a stage; `None` if it belongs to none.
    pub(super) fn to(plan: &Plan, number: usize) -> Option<Self> {
        let run = plan.stages.get(number)?.run()?;
        plan.stages.get(number)?.point()?;
        let last = |purpose: Purpose, up_to: usize| {
            let stages = plan.stages.get(..up_to)?;
            stages.iter().rposition(|stage| stage.purpose == purpose)
        };
        let of_point = |stage: &bench_plan::plan::Stage| {
            stage.purpose == Purpose::MapPoint && stage.run() == Some(run)
        };
        let point = plan.stages.iter().position(of_point)?;
        let full = last(Purpose::SocReset, point)?;
        Some(Self {
            full: (last(Purpose::Temperature, full)?, full),
            point: (last(Purpose::Temperature, point)?, point),
        })
    }

    /// Returns the stages to execute before a stage, which has this number and purpose.
    pub(super) fn before(&self, number: usize, purpose: Purpose, at: &Standing) -> Vec<usize> {
        let Standing {
            beyond_coulomb,
            within_coulomb,
            mut held,
        } = *at;
        let mut stages = Vec::new();
        let mut hold = |stages: &mut Vec<usize>, temperature: usize| {
            if held.replace(temperature) != Some(temperature) {
                stages.push(temperature);
            }
        };
        match purpose {
            Purpose::Temperature => {}
            Purpose::SocReset => hold(&mut stages, self.full.0),
            _ => {
                let empty = beyond_coulomb < -within_coulomb;
                if empty {
                    hold(&mut stages, self.full.0);
                    stages.push(self.full.1);
                }
                hold(&mut stages, self.point.0);
                let moved = empty || beyond_coulomb > within_coulomb;
                if moved && number != self.point.1 {
                    stages.push(self.point.1);
                }
            }
        }
        stages
    }
}

/// The table of the points.
pub(super) struct MapTable<'a> {
    map: &'a MapProcedure,
    rows: Vec<Row>,
}

impl<'a> MapTable<'a> {
    /// Continues the table of a run folder, if there is one.
    pub(super) fn of(map: &'a MapProcedure, recorder: &Recorder) -> Result<Self, Failure> {
        let rows = if recorder.path(MAP_POINTS).exists() {
            run_folder::read_map_points(recorder.folder())
                .map_err(|error| Failure::Analysis(error.to_string()))?
        } else {
            Vec::new()
        };
        Ok(Self { map, rows })
    }

    /// Adds a point at which the cell has come to rest, or replaces it, and states the difference of
    /// the counted charge from the OCV curve.
    pub(super) fn reach(
        &mut self,
        run: &CampaignRun,
        executor: &mut Executor<'_>,
    ) -> Result<(), Failure> {
        let Some((ocv_v, temperature_degc)) = executor.at_rest() else {
            let text = format!("{}no rest is recorded: the point has no row", run.prefix());
            executor.rig.recorder.warning(&text);
            return Ok(());
        };
        let charge_coulomb = executor.charge_coulomb();
        let row = Row {
            number: run.number,
            soc: 1.0 + charge_coulomb / self.map.capacity_coulomb,
            soc_by_ocv: self.map.ocv.soc_at(ocv_v.0),
            temperature_degc: temperature_degc.map(Celsius::value),
            ocv_v: ocv_v.0,
            charge_coulomb: charge_coulomb.0,
            spectrum: None,
            series: Vec::new(),
        };
        let text = format!("{}{}", run.prefix(), in_words(&row, self.map));
        executor.rig.recorder.event(Event::Check, &text)?;
        self.rows.retain(|known| known.number != row.number);
        self.rows.push(row);
        self.rows.sort_by_key(|row| row.number);
        self.write(executor.rig.recorder)
    }

    /// Writes the table with the files that the index has by now.
    pub(super) fn write(&mut self, recorder: &Recorder) -> Result<(), Failure> {
        let index = recorder.index();
        for row in &mut self.rows {
            let swept = index
                .sweeps
                .iter()
                .find(|sweep| sweep.fixture == "cell" && sweep.repeat == row.number);
            let traces = index.traces.iter();
            row.spectrum = swept.map(|sweep| recorder.path(&sweep.file));
            row.series = traces
                .filter(|trace| trace.repeat == row.number)
                .map(|trace| recorder.path(&trace.file))
                .collect();
        }
        let text = run_folder::map_points_csv(recorder.folder(), &self.rows);
        Ok(recorder.text(MAP_POINTS, &text)?)
    }
}

/// States charge and voltage of a point, and their difference from the OCV curve.
fn in_words(row: &Row, map: &MapProcedure) -> String {
    let expected_v = map.ocv.voltage_v(row.soc.clamp(0.0, 1.0));
    let by_curve = row.soc_by_ocv.map_or_else(
        || ", beyond the ends of the OCV curve".to_owned(),
        |soc| {
            format!(
                "; the OCV curve has {:.2} % there: {:+.2} %, {:+.1} mV",
                100.0 * soc,
                100.0 * (soc - row.soc),
                1.0e3 * (row.ocv_v - expected_v)
            )
        },
    );
    format!(
        "{:.2} % by counting, {:.4} V at rest{by_curve} (at most {} % either way)",
        100.0 * row.soc,
        row.ocv_v,
        percent(map.acceptance.0)
    )
}

/// Returns one line for the summary.
pub(super) fn summary(recorder: &Recorder, map: &MapProcedure) -> Option<String> {
    let rows = run_folder::read_map_points(recorder.folder()).ok()?;
    let worst = rows
        .iter()
        .filter_map(|row| Some((row, row.soc_by_ocv? - row.soc)))
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let worst = worst.map_or_else(String::new, |(row, off)| {
        format!(
            "; counted charge and OCV curve differ most at point {}, by {:+.2} %",
            row.number,
            100.0 * off
        )
    });
    let planned = map.runs().count();
    Some(format!(
        "map: {} of {planned} points in {MAP_POINTS}{worst}",
        rows.len()
    ))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use bench_plan::{config::load_experiment, procedure};

    /// 0 temperature, 1 full charge, 2 temperature, 3 first point, 4 sweep, 5 pulses, 6 second point …
    #[test]
    fn the_way_to_a_point_is_as_long_as_the_charge_requires() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let experiment = load_experiment(&file, None).unwrap();
        let plan = procedure::plan(&experiment);
        let first = plan
            .stages
            .iter()
            .position(|stage| stage.point().is_some())
            .unwrap();
        assert_eq!(Way::to(&plan, first.wrapping_sub(1)), None);
        let (full, warm, own) = (first + 1, first + 2, first + 6);
        let way = Way::to(&plan, own + 2).unwrap();
        assert_eq!(way, Way::to(&plan, own).unwrap());
        assert_eq!(plan.stages[own + 2].purpose, Purpose::Trace);
        let before = |number: usize, beyond_coulomb: f64, held: usize| {
            let at = Standing {
                beyond_coulomb,
                within_coulomb: 100.0,
                held: Some(held),
            };
            way.before(number, plan.stages[number].purpose, &at)
        };
        // As in a run that nothing has disturbed.
        assert_eq!(before(own + 2, 0.0, warm), [0; 0]);
        assert_eq!(before(own, 4000.0, warm), [0; 0]);
        // The full charge was repeated: the cell is full, and at the temperature of the charge.
        assert_eq!(before(own + 2, 4860.0, first), [warm, own]);
        assert_eq!(before(own, 4860.0, first), [warm]);
        // The cell has less than the point asks for.
        let whole = [first, full, warm, own];
        assert_eq!(before(own + 2, -500.0, warm), whole);
        assert_eq!(before(own, -500.0, warm), whole[..3]);
        assert_eq!(before(full, -500.0, warm), [first]);
    }
}
