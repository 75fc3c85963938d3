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
    config::{Experiment, MapPlace, MapProcedure},
    plan::{Plan, percent},
    procedure,
    support::terminal::remark,
};

use instruments::units::Coulombs;

use super::{
    map_result::{MapEnd, MapInvestigation, NAME, Round},
    played::{Bench, Ended, Means, Next, Planned, Played, Question, SoFar, campaign, folder_name},
    price,
    rule::{Budget, End},
    worth::{Aims, Step, Worth},
};
use crate::investigate::{
    cell_map::{
        base::Base,
        data::{add_folder, measured_places, one_cell},
        offers::{Offers, check_errors},
    },
    dataset::{Loaded, Reading, read_as},
};

/// Name of the schema of `investigation.json`.
const SCHEMA: &str = "eis-bench/map-investigation";
/// Most measurements of one run.
const MOST_OF_ROUND: usize = 6;

/// Runs an investigation for a map, and writes `investigation.json`, `.md` and `.html`, the files of
/// the map, and a run folder per round. The files are written before each round and at the end. A later
/// run that ended early and an error after the first run end the investigation, which is written
/// nevertheless.
///
/// # Errors
/// Before anything is energised: an experiment without `[map]`, loads that cannot be read, no point
/// that can be measured. Later: a first run that ended early, a folder that cannot be written.
pub fn investigate_map(
    experiment: &Experiment,
    means: &Means<'_>,
    aims: &Aims,
) -> Result<MapInvestigation, Failure> {
    let base = Base::of(experiment)?;
    let offers = Offers::of(&base)?;
    offers.notes.iter().for_each(|note| remark!("note: {note}"));
    let profiles = aims.demands.read()?;
    let (mut bench, _) = Bench::first(experiment, means.out, means.budget)?;
    let mut question = MapQuestion {
        fit: None,
        measured: Measurements {
            cell: String::new(),
            known: None,
            curve: means.ocv.clone(),
            data: MapData::default(),
        },
        offers,
        planned: None,
        rounds: Vec::new(),
        goal: Goal {
            aims,
            profiles: &profiles,
            means,
            pace: 1.0,
            below_full_coulomb: below_full_coulomb(base.map(), &base.map().places),
        },
        base,
        error_v: f64::NAN,
    };
    let (ended, failure) = bench.play(&mut question);
    let investigation = MapInvestigation {
        failure,
        ..question.investigation(&bench.so_far, Some(ended))
    };
    match (
        investigation.write(means.out, &means.ocv),
        investigation.failure,
    ) {
        (Ok(()), failure) => Ok(MapInvestigation {
            failure,
            ..investigation
        }),
        (Err(error), None) => Err(error),
        // The error of the bench comes first.
        (Err(error), Some(failure)) => {
            remark!("{error}");
            Err(failure)
        }
    }
}

/// The charge that a full charge after points returns, C: that below the last of them.
fn below_full_coulomb(map: &MapProcedure, places: &[MapPlace]) -> Coulombs {
    let soc = places.last().map_or(0.0, |place| place.soc);
    (1.0 - soc) * map.capacity_coulomb
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
    /// Reads the first run.
    fn begin(&mut self, folder: &Path) -> Result<(), Failure> {
        let loaded = read_as(folder, Reading::default())?;
        self.cell = one_cell(folder, &loaded.set.runs, None)?;
        self.known = loaded.set.calibration;
        self.add(folder, loaded)
    }

    fn add(&mut self, folder: &Path, loaded: Loaded) -> Result<(), Failure> {
        let notes = add_folder(
            folder,
            Role::Train,
            &self.cell,
            loaded,
            &self.curve,
            &mut self.data,
        )?;
        for note in notes {
            remark!("{}: {note}", folder.display());
        }
        Ok(())
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

/// What is to be reached, with which means, and what the last run shows of the price of the next.
struct Goal<'a> {
    aims: &'a Aims,
    profiles: &'a [Profile],
    means: &'a Means<'a>,
    /// Time that the last run took at its points, over that which its plan expects, at least 1: a plan
    /// counts the shortest rests.
    pace: f64,
    /// Charge that the cell lacks after the last run, C.
    below_full_coulomb: Coulombs,
}

/// The question of a map: what to measure next.
struct MapQuestion<'a> {
    base: Base,
    goal: Goal<'a>,
    measured: Measurements,
    /// Measurements that were not made so far.
    offers: Offers,
    /// The last map; none before the first fit.
    fit: Option<MapFit>,
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
    plan: Plan,
}

impl MapQuestion<'_> {
    /// The measurements that take most off the error, in the order of their choice.
    fn chosen(&mut self) -> Result<Vec<Chosen>, Failure> {
        let Some(fit) = &self.fit else {
            return Err(Failure::Analysis("expected a map, found none".to_owned()));
        };
        let options = MapOptions::default();
        let fitted = Fitted {
            data: &self.measured.data,
            ocv: &self.measured.curve,
            options: &options,
            fit,
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
        check_errors(&plan)?;
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
        let steps = chosen.iter().map(|next| Step {
            minutes: self.goal.pace * next.minutes,
            after_v: next.error_v,
        });
        let worth = Worth::of(&steps.collect::<Vec<_>>(), self.error_v, aims);
        if worth.count == 0 {
            let text = "no further measurement lowers the error of the loads";
            return Err(Ended::without_runs(End::NoExperiment, text));
        }
        if 60.0 * worth.gain_v < aims.least_v_per_h * worth.minutes {
            let text = format!(
                "the next {:.0} min would take off {} mV, less than {} mV per hour",
                worth.minutes,
                crate::support::present::significant(1e3 * worth.gain_v, 2),
                1e3 * aims.least_v_per_h
            );
            return Err(Ended::without_runs(End::GainBelowCost, text));
        }
        Ok(chosen.into_iter().take(worth.count).collect())
    }

    /// Plans a run of chosen measurements, without the last ones that the budget does not pay for.
    fn planned(&mut self, mut chosen: Vec<Chosen>, left: Budget) -> Result<Next, Failure> {
        let mut lack = String::new();
        while let Some(last) = chosen.last() {
            let error_expected_v = last.error_v;
            let places = self.base.in_order(&chosen);
            let experiment = self.base.at(&self.name(), &places)?;
            let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
            let expected = price::expected(plan.plan(), self.goal.below_full_coulomb);
            let price = Budget {
                minutes: self.goal.pace * expected.minutes,
                ..expected
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
                plan: plan.plan().clone(),
            });
            return Ok(Next::Play(Box::new(planned)));
        }
        let text = format!("the budget is spent: the next measurement {lack}");
        Ok(Next::End(Ended::without_runs(End::Budget, text)))
    }

    /// Reads the first run and fits a map to it.
    fn begin(&mut self) -> Result<(), Failure> {
        let first = campaign(self.goal.means.out);
        let map = self.base.map();
        let measured = measured_places(&first, map)?;
        self.goal.pace = price::pace(&procedure::plan(self.base.experiment()), &first);
        self.rounds.push(Round {
            folder: folder_name(&first),
            measured: in_words(&measured),
            minutes: None,
            error_before_v: None,
            error_expected_v: None,
            error_after_v: None,
        });
        self.offers.forget(&measured);
        self.measured.begin(&first)?;
        self.fit = Some(self.measured.fit()?);
        Ok(())
    }

    /// The investigation so far; without an end while it is in progress.
    fn investigation(&self, so_far: &SoFar, ended: Option<Ended>) -> MapInvestigation {
        let running = || "in progress".to_owned();
        MapInvestigation {
            schema: SCHEMA,
            name: self.base.experiment().name.clone(),
            budget: self.goal.means.budget,
            spent: so_far.spent,
            rounds: self.rounds.clone(),
            ended: MapEnd {
                end: ended.as_ref().map(|ended| ended.end),
                end_text: ended.map_or_else(running, |ended| ended.text),
                error_v: self.error_v,
                refused_points: so_far.refused,
            },
            fit: self.fit.clone(),
            failure: None,
        }
    }

    fn name(&self) -> String {
        format!("{}-{}", self.base.experiment().name, self.rounds.len())
    }
}

impl Question for MapQuestion<'_> {
    fn next(&mut self, left: Budget) -> Result<Next, Failure> {
        if self.fit.is_none() {
            self.begin()?;
        }
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
        let map = MapProcedure {
            places: planned.places,
            ..self.base.map().clone()
        };
        let measured = measured_places(played.folder, &map)?;
        self.goal.pace = price::pace(&planned.plan, played.folder);
        self.goal.below_full_coulomb = below_full_coulomb(&map, &map.places);
        self.rounds.push(Round {
            folder: folder_name(played.folder),
            measured: in_words(&measured),
            minutes: Some(played.minutes),
            error_before_v: Some(self.error_v),
            error_expected_v: Some(planned.error_expected_v),
            error_after_v: None,
        });
        if measured.is_empty() {
            let text = "expected a measurement at one of the points of the run, found none";
            return Err(Failure::Analysis(text.to_owned()));
        }
        self.offers.forget(&measured);
        self.measured.add_later(played.folder)?;
        self.fit = Some(self.measured.fit()?);
        Ok(())
    }

    fn moved_ah(&self, folder: &Path) -> Option<f64> {
        price::moved_ah(folder)
    }

    fn save(&self, so_far: &SoFar) -> Result<(), Failure> {
        let means = self.goal.means;
        self.investigation(so_far, None)
            .write(means.out, &means.ocv)
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
