//! The model that is simulated: an ERM, its open-circuit voltage, and how many cells of it there
//! are.

use super::error::ForwardError;
use super::nonlinear::Laws;
use analysis_effects::augmented::Augmented;
use analysis_model::{
    map::{CellMap, Instant, TEMPERATURES_DEGC, Unmeasured},
    model::Erm,
    ocv::OcvCurve,
    pack::Pack,
};
use serde::Serialize;
use std::sync::Arc;

/// Open-circuit voltage of one cell.
#[derive(Debug, Clone, PartialEq)]
pub enum OcvSource {
    /// The same at every state of charge, V: for profiles too short to move it. The state of charge
    /// is then not known.
    Constant(f64),
    /// A curve over state of charge, with the capacity.
    Curve(OcvCurve),
}

/// A cell or a pack of equal cells, as seen from its terminals.
#[derive(Debug, Clone, PartialEq)]
pub struct SimModel {
    /// Series resistance (interconnect included) and RC branches at the terminals.
    pub erm: Erm,
    /// Open-circuit voltage of one cell.
    pub ocv: OcvSource,
    /// Number of cells; 1S1P for a cell.
    pub pack: Pack,
    /// Additions that no linear branch can represent; `erm` is then the model for small signals.
    pub(crate) laws: Option<Arc<Laws>>,
    /// Resistances over state of charge and temperature; `erm` is then one point of them.
    pub(crate) mapped: Option<Mapped>,
}

/// A map and the temperature around the cells.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mapped {
    pub(crate) map: Arc<CellMap>,
    /// Temperature of the surroundings, °C.
    pub(crate) ambient_degc: f64,
}

/// State of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SimState {
    /// State of charge, 0…1; without meaning and constant for [`OcvSource::Constant`].
    pub soc: f64,
    /// Voltages over the RC branches at the terminals, V, in the order of the model's branches,
    /// positive after a discharge.
    pub v_rc_v: Vec<f64>,
    /// Temperature of the cells, °C; `None` for a model that knows no temperature.
    pub temperature_degc: Option<f64>,
}

impl SimModel {
    /// One cell.
    ///
    /// # Errors
    /// As [`SimModel::pack`].
    pub fn cell(erm: &Erm, ocv: OcvSource) -> Result<Self, ForwardError> {
        Self::pack(
            erm,
            ocv,
            Pack {
                series: 1,
                parallel: 1,
                interconnect_ohm: 0.0,
            },
        )
    }

    /// Returns a pack of equal cells: ERM by [`Pack::erm`], OCV times S, capacity times P.
    ///
    /// # Errors
    /// [`ForwardError::Pack`] for a cell model or a pack that cannot be, [`ForwardError::Value`]
    /// for an OCV that is not positive or a curve that [`OcvCurve::validate`] refuses.
    pub fn pack(cell: &Erm, ocv: OcvSource, pack: Pack) -> Result<Self, ForwardError> {
        match &ocv {
            OcvSource::Constant(v) if !(v.is_finite() && *v > 0.0) => {
                return Err(ForwardError::Value {
                    what: "open-circuit voltage",
                    expected: "a positive number of volts",
                    met: *v,
                });
            }
            OcvSource::Curve(curve) if curve.validate().is_err() => {
                return Err(ForwardError::Value {
                    what: "open-circuit voltage",
                    expected: "a valid OCV curve; number of its knots follows",
                    met: curve.soc.len() as f64,
                });
            }
            _ => {}
        }
        Ok(Self {
            erm: pack.erm(cell)?,
            ocv,
            pack,
            laws: None,
            mapped: None,
        })
    }

    /// Creates a pack of equal cells whose resistances follow state of charge and temperature. A
    /// state without a temperature has that of the surroundings, `ambient_degc` (°C). `erm` is the
    /// map's model at half charge and that temperature.
    ///
    /// # Errors
    /// As [`SimModel::pack`]; [`ForwardError::Map`] for a map that [`CellMap::validate`] refuses.
    pub fn mapped(
        map: CellMap,
        ocv: OcvCurve,
        pack: Pack,
        ambient_degc: f64,
    ) -> Result<Self, ForwardError> {
        map.validate()
            .map_err(|error| ForwardError::Map(error.to_string()))?;
        if !TEMPERATURES_DEGC.contains(&ambient_degc) {
            return Err(ForwardError::Value {
                what: "temperature of the surroundings",
                expected: "-60 to 120 °C",
                met: ambient_degc,
            });
        }
        let model = Self::pack(
            &map.model_at(0.5, ambient_degc),
            OcvSource::Curve(ocv),
            pack,
        )?;
        Ok(Self {
            mapped: Some(Mapped {
                map: Arc::new(map),
                ambient_degc,
            }),
            ..model
        })
    }

    /// Returns the map of the cells, if the model has one.
    pub fn map(&self) -> Option<&CellMap> {
        self.mapped.as_ref().map(|mapped| &*mapped.map)
    }

    /// Creates a pack of equal cells with additions: those of the cell act, those of the bench are
    /// left out ([`Augmented::left_out`]). Linear branches become branches of the ERM; the other
    /// additions act in every cell while time passes, and start at rest.
    ///
    /// # Errors
    /// As [`SimModel::pack`]; [`ForwardError::Additions`] for a constant OCV if an addition needs
    /// the state of charge.
    pub fn augmented(cell: &Augmented, ocv: OcvSource, pack: Pack) -> Result<Self, ForwardError> {
        let (erm, laws) = Laws::of(cell)?;
        let model = Self::pack(&erm, ocv, pack)?;
        if let (Some(laws), OcvSource::Constant(_)) = (&laws, &model.ocv) {
            let expected = "a state of charge on the model's OCV curve";
            return Err(ForwardError::Additions {
                what: "open-circuit voltage that stays",
                expected,
                names: laws.names(),
            });
        }
        Ok(Self {
            laws: laws.map(Arc::new),
            ..model
        })
    }

    /// Returns names of the additions that no linear branch can represent, or `None` if there are
    /// none.
    pub fn laws(&self) -> Option<String> {
        self.laws.as_ref().map(|laws| laws.names())
    }

    /// Refuses the task if it supports linear branches only.
    pub(super) fn linear_only(&self, what: &'static str) -> Result<(), ForwardError> {
        let expected = "linear branches only";
        if self.mapped.is_some() {
            return Err(ForwardError::Additions {
                what,
                expected,
                names: "resistances over state of charge and temperature".to_owned(),
            });
        }
        self.laws().map_or(Ok(()), |names| {
            Err(ForwardError::Additions {
                what,
                expected,
                names,
            })
        })
    }

    /// Returns the same model with the DC resistance alone, without transients (simple-IR model).
    /// A map gives the resistance at this state of charge and the temperature of the surroundings.
    #[must_use]
    pub fn simple_ir(&self, soc: f64) -> Self {
        let r_ohm = match &self.mapped {
            None => self.erm.dc_resistance_ohm(),
            Some(mapped) => {
                let cell = mapped.map.model_at(soc, mapped.ambient_degc);
                cell.dc_resistance_ohm() * self.pack.ratio() + self.pack.interconnect_ohm
            }
        };
        Self {
            ocv: self.corrected_ocv(),
            erm: Erm {
                r_ohm,
                branches: Vec::new(),
            },
            laws: None,
            mapped: None,
            ..self.clone()
        }
    }

    /// Returns the curve with the correction of the map at the temperature of the surroundings; the
    /// curve itself if the corrected knots do not rise.
    fn corrected_ocv(&self) -> OcvSource {
        let (Some(mapped), OcvSource::Curve(curve)) = (&self.mapped, &self.ocv) else {
            return self.ocv.clone();
        };
        let corrected = mapped.map.corrected(curve, mapped.ambient_degc);
        OcvSource::Curve(corrected.unwrap_or_else(|| curve.clone()))
    }

    /// Returns the open-circuit voltage at the terminals, V, and its slope with SOC, V. A map adds
    /// its correction at the temperature of the surroundings to the voltage.
    pub fn ocv_v(&self, soc: f64) -> (f64, f64) {
        let (v, slope_v) = self.curve_v(soc);
        let correction_v = self.mapped.as_ref().map_or(0.0, |mapped| {
            let at = mapped.map.place(soc, mapped.ambient_degc);
            mapped.map.ocv_correction_v(&at, mapped.ambient_degc)
        });
        (v + f64::from(self.pack.series) * correction_v, slope_v)
    }

    /// Returns the voltage of the curve at the terminals, V, and its slope with SOC, V.
    pub(super) fn curve_v(&self, soc: f64) -> (f64, f64) {
        let series = f64::from(self.pack.series);
        match &self.ocv {
            OcvSource::Constant(v) => (series * v, 0.0),
            OcvSource::Curve(curve) => {
                let (v, slope) = curve.at(soc);
                (series * v, series * slope)
            }
        }
    }

    /// Returns the standard deviation of the mean voltage of a cell in a state, V, from that voltage, V, and
    /// the open-circuit voltage, V, and the current, A, at the terminals.
    pub(super) fn cell_sigma_v(
        &self,
        state: &SimState,
        cell_v: f64,
        ocv_v: f64,
        current_a: f64,
    ) -> Option<f64> {
        let map = self.map()?;
        let series = f64::from(self.pack.series);
        let degc = state.temperature_degc?;
        let at = map.place(state.soc, degc);
        let slope_v = self.curve_v(state.soc).1 / series;
        let own_v = map.sigma_v(&at, slope_v, ocv_v / series - cell_v)?;
        if !map.has_unmeasured() {
            return Some(own_v);
        }
        let now = Instant {
            soc: state.soc,
            temperature_degc: degc,
            current_a: current_a / f64::from(self.pack.parallel),
        };
        let branch_v = state.v_rc_v.iter().map(|v| v / series);
        let lasting = Unmeasured::new(map).advance(f64::INFINITY, now, branch_v);
        Some(own_v.hypot(lasting))
    }

    /// Returns the charge of the terminals between SOC 0 and 1, C; infinite for a constant OCV.
    pub fn capacity_coulomb(&self) -> f64 {
        match &self.ocv {
            OcvSource::Constant(_) => f64::INFINITY,
            OcvSource::Curve(curve) => curve.capacity_ah * 3600.0 * f64::from(self.pack.parallel),
        }
    }

    /// Returns the state after a long rest at a state of charge.
    ///
    /// # Errors
    /// [`ForwardError::Value`] unless the SOC is within 0…1.
    pub fn rest(&self, soc: f64) -> Result<SimState, ForwardError> {
        if !(0.0..=1.0).contains(&soc) {
            return Err(ForwardError::Value {
                what: "state of charge",
                expected: "a fraction from 0 to 1",
                met: soc,
            });
        }
        Ok(SimState {
            soc,
            v_rc_v: vec![0.0; self.erm.branches.len()],
            temperature_degc: None,
        })
    }

    /// Returns the state after a long rest at a cell's open-circuit voltage, V. A constant OCV has
    /// one state only, whatever the voltage.
    ///
    /// # Errors
    /// [`ForwardError::OcvRange`] for a voltage that the curve does not reach.
    pub fn rest_at(&self, ocv_cell_v: f64) -> Result<SimState, ForwardError> {
        match &self.ocv {
            OcvSource::Constant(_) => self.rest(0.5),
            OcvSource::Curve(curve) => {
                let series = f64::from(self.pack.series);
                let cell_v = |soc: f64| self.ocv_v(soc).0 / series;
                let (first, last) = (curve.soc[0], curve.soc[curve.soc.len() - 1]);
                let ends = (cell_v(first), cell_v(last));
                let soc = if self.mapped.is_none() {
                    curve.soc_at(ocv_cell_v)
                } else if (ends.0..=ends.1).contains(&ocv_cell_v) {
                    Some(bisected(first, last, |soc| cell_v(soc) < ocv_cell_v))
                } else {
                    None
                };
                self.rest(soc.ok_or(ForwardError::OcvRange {
                    low_v: ends.0,
                    high_v: ends.1,
                    met: ocv_cell_v,
                })?)
            }
        }
    }

    /// Returns the mean voltage of one cell, V, at a voltage and a current of the terminals: the
    /// interconnect is not the cells'.
    pub fn cell_v(&self, ccv_v: f64, current_a: f64) -> f64 {
        (ccv_v + current_a * self.pack.interconnect_ohm) / f64::from(self.pack.series)
    }

    /// Checks that a state belongs to the model.
    pub(super) fn check(&self, state: &SimState) -> Result<(), ForwardError> {
        let (expected, met) = (self.erm.branches.len(), state.v_rc_v.len());
        if expected != met {
            return Err(ForwardError::Branches { expected, met });
        }
        match std::iter::once(&state.soc)
            .chain(&state.v_rc_v)
            .find(|v| !v.is_finite())
        {
            Some(met) => Err(ForwardError::Value {
                what: "state",
                expected: "finite numbers",
                met: *met,
            }),
            None => Ok(()),
        }
    }
}

/// Returns the place between two at which a statement that holds at the first ends to hold.
fn bisected(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}
