//! Closed loop for a map: the points of an experiment, a map fitted to them, and the points that take
//! most off the predicted error of given loads per minute, until the error is small enough, the gain
//! is not worth its time, or the budget is spent.

use std::path::Path;

use analysis::{
    calibration::CommonError,
    forward::Profile,
    map::{Fitted, MapData, MapFit, MapOptions, Next as Chosen, fit_map, plan_next},
    ocv::OcvCurve,
    series::Role,
};
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{Experiment, MapPlace},
    plan::percent,
    procedure,
    support::terminal::remark,
};
use instruments::units::{Coulombs, Seconds};

use super::{
    map_result::{MapEnd, MapInvestigation, Round},
    played::{Bench, Ended, Means, Next, Planned, Played, Question, campaign, folder_name},
    rule::{Budget, End},
};
use crate::investigate::{
    cell_map::{
        base::Base,
        data::{add_folder, one_cell},
        loads::Demands,
        offers::Offers,
    },
    dataset::{Loaded, Reading, read_as},
};

/// Name of the schema of `investigation.json`.
const SCHEMA: &str = "eis-bench/map-investigation";
/// Most measurements of one run.
const MOST_OF_ROUND: usize = 6;
/// Last part of the name of the folder of a run.
const NAME: &str = "map";

/// What an investigation for a map is to reach.
#[derive(Debug, Clone)]
pub struct Aims {
    /// The loads.
    pub demands: Demands,
    /// Predicted error of their voltage at which it ends, one standard deviation, V.
    pub error_v: f64,
    /// Least fall of this error for an hour on the bench, V/h.
    pub least_v_per_h: f64,
}

/// Runs an investigation for a map, and writes `investigation.json`, `.md` and `.html`, the files of
/// the map, and a run folder per round. A later run that ended early ends the investigation, which is
/// written nevertheless.
///
/// # Errors
/// Before anything is energised: an experiment without `[map]`, loads that cannot be read, no point
/// that can be measured. Later: a first run that ended early, a map that cannot be fitted, a load
/// that the pack cannot supply, a folder that cannot be written.
pub fn investigate_map(
    experiment: &Experiment,
    means: &Means<'_>,
    aims: &Aims,
) -> Result<MapInvestigation, Failure> {
    let base = Base::of(experiment)?;
    let mut offers = Offers::of(&base)?;
    offers.forget(&base.map().places);
    offers.notes.iter().for_each(|note| remark!("note: {note}"));
    let profiles = aims.demands.read()?;
    let (mut bench, _) = Bench::first(experiment, means.out, means.budget)?;
    let first = campaign(means.out);
    let loaded = read_as(&first, Reading::default())?;
    let mut data = Measurements {
        cell: one_cell(&first, &loaded.set.runs, None)?,
        known: loaded.set.calibration,
        curve: means.ocv.clone(),
        data: MapData::default(),
    };
    data.add(&first, loaded)?;
    let mut question = MapQuestion {
        fit: data.fit()?,
        measured: data,
        offers,
        planned: None,
        rounds: vec![Round {
            folder: folder_name(&first),
            measured: in_words(&base.map().places),
            minutes: None,
            error_before_v: None,
            error_expected_v: None,
            error_after_v: None,
        }],
        goal: Goal {
            aims,
            profiles: &profiles,
            pace: bench.first_minutes / expected_minutes(experiment)?,
        },
        base,
        error_v: f64::NAN,
    };
    let (ended, failure) = bench.play(&mut question)?;
    let investigation = MapInvestigation {
        schema: SCHEMA,
        name: experiment.name.clone(),
        budget: means.budget,
        spent: bench.spent,
        rounds: question.rounds,
        ended: MapEnd {
            end: ended.end,
            end_text: ended.text,
            error_v: question.error_v,
            refused_points: bench.refused,
        },
        fit: question.fit,
        failure,
    };
    investigation.write(means.out, &means.ocv)?;
    Ok(investigation)
}

/// Time that the plan of an experiment expects, min.
fn expected_minutes(experiment: &Experiment) -> Result<f64, Failure> {
    let plan = procedure::plan(experiment).check(&experiment.cell.limits)?;
    Ok(plan.plan().expected_s() / Seconds(60.0))
}

/// What was measured so far.
struct Measurements {
    cell: String,
    /// Error that the correction of the first run leaves.
    known: Option<CommonError>,
    curve: OcvCurve,
    data: MapData,
}

impl Measurements {
    fn add(&mut self, folder: &Path, loaded: Loaded) -> Result<(), Failure> {
        add_folder(
            folder,
            Role::Train,
            &self.cell,
            loaded,
            &self.curve,
            &mut self.data,
        )
    }

    /// Adds a later run, whose names begin with that of its folder.
    fn add_later(&mut self, folder: &Path) -> Result<(), Failure> {
        let how = Reading {
            known: self.known,
            refused_points: false,
        };
        let (logs, spectra) = (self.data.logs.len(), self.data.spectra.len());
        self.add(folder, read_as(folder, how)?)?;
        let prefix = folder_name(folder);
        for log in &mut self.data.logs[logs..] {
            log.series.name = format!("{prefix}_{}", log.series.name);
        }
        for spectrum in &mut self.data.spectra[spectra..] {
            spectrum.name = format!("{prefix}_{}", spectrum.name);
        }
        Ok(())
    }

    fn fit(&self) -> Result<MapFit, Failure> {
        fit_map(&self.data, &self.curve, &MapOptions::default())
            .map_err(|error| Failure::Analysis(error.to_string()))
    }
}

/// What is to be reached, and at which pace.
struct Goal<'a> {
    aims: &'a Aims,
    profiles: &'a [Profile],
    /// Time that the last run took, over that which its plan expects: a plan counts the shortest rests.
    pace: f64,
}

/// The question of a map: what to measure next.
struct MapQuestion<'a> {
    base: Base,
    goal: Goal<'a>,
    measured: Measurements,
    /// Measurements that were not made so far.
    offers: Offers,
    fit: MapFit,
    /// The round that is played.
    planned: Option<PlannedRound>,
    rounds: Vec<Round>,
    /// Predicted error of the loads, V.
    error_v: f64,
}

/// A round before it is played.
struct PlannedRound {
    places: Vec<MapPlace>,
    error_expected_v: f64,
    /// Time that its plan expects, min.
    minutes: f64,
}

impl MapQuestion<'_> {
    /// The measurements that take most off the error, in the order of their choice.
    fn chosen(&mut self) -> Result<Vec<Chosen>, Failure> {
        let options = MapOptions::default();
        let fitted = Fitted {
            data: &self.measured.data,
            ocv: &self.measured.curve,
            options: &options,
            fit: &self.fit,
        };
        let demands = &self.goal.aims.demands;
        let of_base: Vec<f64> = self
            .base
            .map()
            .temperatures
            .iter()
            .map(|at| at.degc.value())
            .collect();
        let degc = if demands.at_degc.is_empty() {
            &of_base
        } else {
            &demands.at_degc
        };
        let loads = demands.loads(self.goal.profiles, degc, fitted)?;
        let plan = plan_next(fitted, &loads, &self.offers.choices, MOST_OF_ROUND)
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        self.error_v = plan.error_v;
        if let Some(last) = self.rounds.last_mut() {
            last.error_after_v = Some(plan.error_v);
            remark!("{}", last.line());
        }
        Ok(plan.next)
    }

    /// Keeps the measurements that are worth their time, up to the one that reaches the aim.
    fn worth(&self, chosen: Vec<Chosen>) -> Result<Vec<Chosen>, Ended> {
        let aims = self.goal.aims;
        let Some(first) = chosen.first() else {
            let text = "no further measurement lowers the error of the loads";
            return Err(Ended::without_runs(End::NoExperiment, text));
        };
        let minutes = |next: &Chosen| self.goal.pace * next.minutes;
        let gain_v = self.error_v - first.error_v;
        if 60.0 * gain_v < aims.least_v_per_h * minutes(first) {
            let text = format!(
                "the next {:.0} min would take off {} mV, less than {} mV per hour",
                minutes(first),
                crate::support::present::significant(1e3 * gain_v, 2),
                1e3 * aims.least_v_per_h
            );
            return Err(Ended::without_runs(End::GainBelowCost, text));
        }
        let mut kept: Vec<Chosen> = Vec::new();
        let mut before_v = self.error_v;
        for next in chosen {
            let pays = 60.0 * (before_v - next.error_v) >= aims.least_v_per_h * minutes(&next);
            if before_v <= aims.error_v || !pays {
                break;
            }
            before_v = next.error_v;
            kept.push(next);
        }
        Ok(kept)
    }

    /// Plans a run of chosen measurements, without the last ones that the budget does not pay.
    fn planned(&mut self, mut chosen: Vec<Chosen>, left: Budget) -> Result<Next, Failure> {
        let mut lack = String::new();
        while let Some(last) = chosen.last() {
            let error_expected_v = last.error_v;
            let places = self.base.in_order(&chosen);
            let mut experiment = self.base.at(&self.name(), &places)?;
            // The correction of the first run stays.
            experiment.fixture_check = None;
            let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
            let (extent, minutes) = (
                plan.plan().extent(),
                plan.plan().expected_s() / Seconds(60.0),
            );
            let price = Budget {
                minutes: self.goal.pace * minutes,
                charge_ah: (extent.into_coulomb + extent.out_coulomb) / Coulombs(3600.0),
            };
            if let Some(shortfall) = left.shortfall(price) {
                lack = shortfall;
                chosen.pop();
                continue;
            }
            let planned = Planned {
                name: NAME.to_owned(),
                description: in_words(&places).join("; "),
                experiment,
                charge_ah: price.charge_ah,
            };
            self.planned = Some(PlannedRound {
                places,
                error_expected_v,
                minutes,
            });
            return Ok(Next::Play(Box::new(planned)));
        }
        let text = format!("the budget is spent: the next measurement {lack}");
        Ok(Next::End(Ended::without_runs(End::Budget, text)))
    }

    fn name(&self) -> String {
        format!("{}-{}", self.base.experiment().name, self.rounds.len())
    }
}

impl Question for MapQuestion<'_> {
    fn next(&mut self, left: Budget) -> Result<Next, Failure> {
        let chosen = self.chosen()?;
        let limit_v = self.goal.aims.error_v;
        if self.error_v <= limit_v {
            let text = format!(
                "the error of the loads is {:.1} mV, below {} mV",
                1e3 * self.error_v,
                1e3 * limit_v
            );
            return Ok(Next::End(Ended::without_runs(End::ErrorReached, text)));
        }
        match self.worth(chosen) {
            Ok(chosen) => self.planned(chosen, left),
            Err(ended) => Ok(Next::End(ended)),
        }
    }

    fn take(&mut self, played: &Played<'_>) -> Result<(), Failure> {
        let planned = self
            .planned
            .take()
            .ok_or_else(|| Failure::Analysis("expected a planned round, found none".to_owned()))?;
        self.goal.pace = played.minutes / planned.minutes;
        self.measured.add_later(played.folder)?;
        self.offers.forget(&planned.places);
        self.rounds.push(Round {
            folder: folder_name(played.folder),
            measured: in_words(&planned.places),
            minutes: Some(played.minutes),
            error_before_v: Some(self.error_v),
            error_expected_v: Some(planned.error_expected_v),
            error_after_v: None,
        });
        self.fit = self.measured.fit()?;
        Ok(())
    }
}

/// Points in words.
fn in_words(places: &[MapPlace]) -> Vec<String> {
    let word = |place: &MapPlace| {
        let what = match (place.spectrum, place.pulses) {
            (true, true) => "spectrum and pulses",
            (true, false) => "spectrum",
            (false, _) => "pulses",
        };
        let (soc, degc) = (percent(place.soc), place.temperature_degc);
        format!("{soc} % at {degc} °C: {what}")
    };
    places.iter().map(word).collect()
}
