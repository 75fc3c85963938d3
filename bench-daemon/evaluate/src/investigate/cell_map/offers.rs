//! What the bench of an experiment can measure at which point, and how long that takes.

use analysis::map::{Choices, Measurement, NextPlan, Offer, PulsePart, Signal};
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{Experiment, MapPlace},
    plan::{MapPoint, Plan, Purpose, Stage, Step, TracePlan, percent},
    procedure,
};
use instruments::units::Seconds;

use super::base::Base;

/// Measurements to choose from, and the points that are left out.
#[derive(Debug, Clone)]
pub struct Offers {
    /// The measurements.
    pub choices: Choices,
    /// Why points are left out, as sentences.
    pub notes: Vec<String>,
}

impl Offers {
    /// Finds what an experiment can measure at each of its temperatures: at every 10 % of charge
    /// between its own points, and at the charges of these.
    ///
    /// # Errors
    /// No point that the limits of cell and bench allow; a base whose text cannot take other points.
    pub fn of(base: &Base) -> Result<Self, Failure> {
        let map = base.map();
        base.at("next", &map.places)?;
        let mut offers = Self {
            choices: Choices {
                offers: Vec::new(),
                rest_min: 0.0,
                temperature_min: 0.0,
                travel_a: map.legs.discharge_a.value(),
            },
            notes: Vec::new(),
        };
        for at in &map.temperatures {
            for soc in socs(base) {
                offers.add(base, soc, at.degc.value());
            }
        }
        if offers.choices.offers.is_empty() {
            return Err(Failure::Usage(format!(
                "expected a point that the limits of cell and bench allow, found none: {}",
                offers.notes.join("; ")
            )));
        }
        Ok(offers)
    }

    /// Leaves out the measurements of points that were made: another one at the same place has the same
    /// error of the model.
    pub fn forget(&mut self, places: &[MapPlace]) {
        self.choices.offers.retain(|offer| {
            let is_here = |place: &&MapPlace| place.is_at(offer.soc, offer.temperature_degc);
            let is_made = |place: &MapPlace| match offer.measurement() {
                Measurement::Spectrum => place.spectrum,
                Measurement::Pulses => place.pulses,
            };
            !places.iter().filter(is_here).any(is_made)
        });
    }

    /// Adds what can be measured at a point.
    fn add(&mut self, base: &Base, soc: f64, temperature_degc: f64) {
        let place = MapPlace {
            soc,
            temperature_degc,
            spectrum: base.map().places.iter().any(|place| place.spectrum),
            pulses: base.map().pulses.is_some(),
        };
        match planned(base, &place) {
            Ok(plan) => self.take(&plan),
            Err(reason) => self.notes.push(format!(
                "{} % at {temperature_degc} °C is left out: {reason}",
                percent(soc)
            )),
        }
    }

    /// Takes the measurements of a plan of one point.
    fn take(&mut self, plan: &Plan) {
        let mut temperature_s = Seconds(0.0);
        for stage in &plan.stages {
            match (stage.purpose, stage.point()) {
                (Purpose::Temperature | Purpose::SocReset, _) => {
                    temperature_s += stage.expected_s();
                }
                (Purpose::MapPoint, _) => {
                    let rests = stage.steps.iter();
                    let rests = rests.filter(|step| matches!(step, Step::Rest { .. }));
                    self.choices.rest_min =
                        rests.map(Step::expected_s).sum::<Seconds>() / Seconds(60.0);
                }
                (_, Some(point)) => self.choices.offers.extend(offer(stage, &point)),
                (_, None) => {}
            }
        }
        self.choices.temperature_min = temperature_s / Seconds(60.0);
    }
}

/// Refuses a choice whose predicted errors are not finite.
///
/// # Errors
/// The first such error, with its measurement.
pub fn check_errors(plan: &NextPlan) -> Result<(), Failure> {
    let refuse = |error_v: f64, when: String| {
        Err(Failure::Analysis(format!(
            "expected a finite error of the loads{when}, found {error_v} V: the data do not determine \
            the map"
        )))
    };
    if !plan.error_v.is_finite() {
        return refuse(plan.error_v, String::new());
    }
    let wrong = plan.next.iter().find(|next| !next.error_v.is_finite());
    wrong.map_or(Ok(()), |next| {
        let (soc, degc) = (percent(next.soc), next.temperature_degc);
        refuse(
            next.error_v,
            format!(" after a measurement at {soc} % and {degc} °C"),
        )
    })
}

/// States of charge to choose from, rising: those of the experiment, and every 10 % between its lowest and
/// its highest, for which its `resistance_max` was chosen.
fn socs(base: &Base) -> Vec<f64> {
    let own = || base.map().places.iter().map(|place| place.soc);
    let (low, high) = (own().fold(1.0, f64::min), own().fold(0.0, f64::max));
    let between = Choices::SOC
        .into_iter()
        .filter(|soc| (low..=high).contains(soc));
    let mut socs: Vec<f64> = between.chain(own()).collect();
    socs.sort_by(f64::total_cmp);
    // Of 70 % and 0.7, one is left.
    socs.dedup_by_key(|soc| percent(*soc));
    socs
}

/// The plan of one point, checked.
fn planned(base: &Base, place: &MapPlace) -> Result<Plan, String> {
    let experiment: Experiment = base
        .at("next", &[*place])
        .map_err(|error| error.to_string())?;
    let plan = procedure::plan(&experiment);
    let checked = plan.check(&experiment.cell.limits);
    checked
        .map(|checked| checked.plan().clone())
        .map_err(|error| error.to_string())
}

/// What a stage measures at a point.
fn offer(stage: &Stage, point: &MapPoint) -> Option<Offer> {
    let mut freqs_hz = Vec::new();
    let mut parts = Vec::new();
    for step in &stage.steps {
        match step {
            Step::Sine { freq_hz, .. } => freqs_hz.push(freq_hz.value()),
            Step::Multisine(band) => {
                let lines = band.design.harmonics.iter();
                freqs_hz.extend(lines.map(|line| *line as f64 * band.base_hz.value()));
            }
            Step::Trace(trace) => parts.extend(parts_of(trace)),
            _ => {}
        }
    }
    let signal = match (freqs_hz.is_empty(), parts.is_empty()) {
        (false, _) => Signal::Spectrum { freqs_hz },
        (true, false) => Signal::Pulses(parts),
        (true, true) => return None,
    };
    Some(Offer {
        soc: point.soc,
        temperature_degc: point.temperature_degc.value(),
        signal,
        minutes: stage.expected_s() / Seconds(60.0),
    })
}

/// The currents of a trace one after the other; a discharge is positive here.
fn parts_of(trace: &TracePlan) -> impl Iterator<Item = PulsePart> {
    let ends_s = trace.levels.iter().skip(1).map(|level| level.at_s);
    let ends_s = ends_s.chain([trace.length_s()]);
    trace
        .levels
        .iter()
        .zip(ends_s)
        .map(|(level, end_s)| PulsePart {
            current_a: 0.0 - level.current_a.value(),
            duration_s: (end_s - level.at_s).value(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::config::load_experiment;
    use std::path::Path;

    #[test]
    fn points_are_offered_within_the_charges_of_the_experiment_only() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let base = Base::of(&load_experiment(&file, None).unwrap()).unwrap();
        let offered: Vec<f64> = socs(&base).into_iter().map(percent).collect();
        assert_eq!(offered, [20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0]);
    }

    #[test]
    fn an_error_that_is_not_finite_is_refused() {
        let plan = |error_v| NextPlan {
            error_v,
            next: Vec::new(),
        };
        assert!(check_errors(&plan(0.01)).is_ok());
        let refused = check_errors(&plan(f64::NAN)).unwrap_err().to_string();
        assert!(
            refused.contains("expected a finite error of the loads, found NaN V"),
            "{refused}"
        );
    }
}
