//! Predictions of the base model for every run.

use super::super::current_filter::{Filter, shared};
use super::super::data::{DataSet, Fixture, Run, RunData, Start};
use super::super::prepare::BaseModel;
use analysis_effects::{
    augmented::{Grid, Player},
    contract::{Base, Facts, Record},
};
use num_complex::Complex64;

/// Predictions of the base model for a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Series resistance and resistance at zero frequency of the cell, Ω: a step of current meets
    /// something between.
    pub resistance_ohm: (f64, f64),
    /// One per run, in the order of the set.
    pub runs: Vec<Prediction>,
    /// Filter that the logger puts on the current of the records.
    pub filter: Option<Filter>,
}

/// Prediction for one run.
#[derive(Debug, Clone, PartialEq)]
pub enum Prediction {
    /// Impedance of every point, Ω.
    Impedance(Vec<Complex64>),
    /// Voltage of every sample, V, and the drop of the open-circuit voltage per discharged coulomb
    /// at the start, V.
    Voltage(Vec<f64>, f64),
    /// Nothing: the run's numbers cannot be simulated.
    None,
}

impl Expected {
    /// Creates the predictions of a model, and the filter that they show.
    pub fn new(set: &DataSet, model: &BaseModel) -> Self {
        Self {
            filter: shared(set, model),
            ..Self::without_filter(set, model)
        }
    }

    /// Returns the predictions alone: no filter is looked for.
    pub(crate) fn without_filter(set: &DataSet, model: &BaseModel) -> Self {
        let base = Base {
            erm: model.erm.clone(),
            ocv: model.ocv.clone(),
            facts: Facts::NONE,
        };
        let mut player = Player::default();
        let runs = set
            .runs
            .iter()
            .map(|run| prediction(run, &base, &mut player))
            .collect();
        Self {
            resistance_ohm: (model.erm.r_ohm, model.erm.dc_resistance_ohm()),
            runs,
            filter: None,
        }
    }
}

fn prediction(run: &Run, base: &Base, player: &mut Player) -> Prediction {
    let control_ohm = match run.fixture {
        Fixture::Cell(_) => None,
        Fixture::Shunt(ohm) | Fixture::FakeCell(ohm) => Some(ohm),
    };
    match &run.data {
        RunData::Eis(sweep) => {
            let at = |freq_hz: f64| {
                control_ohm.map_or_else(|| base.erm.impedance(freq_hz), Complex64::from)
            };
            Prediction::Impedance(sweep.points.iter().map(|point| at(point.freq_hz)).collect())
        }
        RunData::Time(record) if record.series.validate().is_err() => Prediction::None,
        RunData::Time(record) => {
            let series = &record.series;
            if let Some(ohm) = control_ohm {
                return Prediction::Voltage(
                    series.current_a.iter().map(|i| -ohm * i).collect(),
                    0.0,
                );
            }
            let soc = match run.start {
                Start::Soc(soc) => soc,
                Start::Ocv(ocv_v) => {
                    base.ocv
                        .soc_at(ocv_v)
                        .unwrap_or(if ocv_v < base.ocv.voltage_v(0.5) {
                            0.0
                        } else {
                            1.0
                        })
                }
            };
            let played = Record {
                time_s: &series.time_s,
                current_a: &series.current_a,
                soc,
                temperature_degc: run.temperature_degc,
                order: f64::from(run.order),
                start_s: run.start_s,
                is_cell: true,
                before: &[],
            };
            let mut voltage_v = Vec::with_capacity(series.len());
            player.play(
                base,
                &[],
                &played,
                &Grid::new(&series.time_s, record.between),
                1,
                &mut voltage_v,
            );
            let per_c_v = base.ocv.slope_v(soc) / (3600.0 * base.ocv.capacity_ah);
            if voltage_v.iter().all(|v| v.is_finite()) {
                Prediction::Voltage(voltage_v, per_c_v)
            } else {
                Prediction::None
            }
        }
    }
}
