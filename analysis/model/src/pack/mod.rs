//! Maps a cell to a pack of S cells in series, P in parallel (thesis 3.3.4).
//!
//! All cells are assumed identical, so Z_pack = S/P · Z_cell (equation 3.3), which resistances
//! times S/P and capacitances times P/S fulfil (equations 3.4, 3.6, 3.10; the proof there is for
//! one RC circuit, the law holds branch by branch). [`Sizing`] contains the capability of a pack by
//! the simple-IR model. `forward::pack::scatter` drops the assumption of identical cells. OCV and
//! capacity of a pack are in `forward::SimModel`.

mod heat;
mod ranking;
mod sizing;

pub use heat::{HeldPower, Hold, ThermalMass};
pub use ranking::{CellKind, PowerLimit, RankedPack, Requirements, rank_packs};
pub use sizing::{OperatingPoint, PeakLimit, SimpleIr, Sizing, SizingInput, check_window};

use crate::map::MapError;
use crate::model::{Erm, ModelError, RcBranch};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Size of a pack and the resistance of what connects its cells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pack {
    /// Cells in series, at least 1.
    pub series: u32,
    /// Cells in parallel, at least 1.
    pub parallel: u32,
    /// Resistance of busbars, wires and connectors over the whole pack, Ω, zero or more.
    pub interconnect_ohm: f64,
}

/// Reason why a cell cannot be mapped to a pack.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PackError {
    /// A pack without cells.
    #[error("pack: expected at least 1 cell in series and 1 in parallel, met {series}S{parallel}P")]
    Empty {
        /// Cells in series.
        series: u32,
        /// Cells in parallel.
        parallel: u32,
    },
    /// The interconnect is not a valid resistance.
    #[error("pack: expected an interconnect resistance of zero or more in Ω, met {met}")]
    Interconnect {
        /// The value met.
        met: f64,
    },
    /// A cell model that is not valid.
    #[error(transparent)]
    Cell(#[from] ModelError),
    /// A map that cannot be.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A number that makes no sense.
    #[error("{what}: expected {expected}, met {met}")]
    Value {
        /// Name of the value.
        what: &'static str,
        /// Allowed values, as text.
        expected: &'static str,
        /// The value met.
        met: f64,
    },
    /// The voltage window is invalid.
    #[error("voltage window of a cell: expected 0 ≤ lower < upper in V, met {low_v} to {high_v}")]
    Window {
        /// Lower end, V.
        low_v: f64,
        /// Upper end, V.
        high_v: f64,
    },
    /// More than any load could draw.
    #[error("power of {power_w} W: expected at most {most_w:.1} W, OCV²/4r")]
    Infeasible {
        /// The power met, W.
        power_w: f64,
        /// The most possible, W.
        most_w: f64,
    },
}

impl Pack {
    /// The thesis' pack: 16S3P, ideal interconnect.
    pub const THESIS: Self = Self {
        series: 16,
        parallel: 3,
        interconnect_ohm: 0.0,
    };

    /// Returns the number of its cells.
    pub fn cells(&self) -> f64 {
        f64::from(self.series) * f64::from(self.parallel)
    }

    /// Creates a pack.
    ///
    /// # Errors
    /// [`PackError`] for a pack without cells or an interconnect that is negative or not finite.
    pub fn new(series: u32, parallel: u32, interconnect_ohm: f64) -> Result<Self, PackError> {
        let pack = Self {
            series,
            parallel,
            interconnect_ohm,
        };
        pack.check()?;
        Ok(pack)
    }

    /// S/P: how much larger the pack's impedance is than the cell's, interconnect apart.
    pub fn ratio(&self) -> f64 {
        f64::from(self.series) / f64::from(self.parallel)
    }

    /// Returns the pack's model from the cell's: R·S/P plus interconnect, Rₖ·S/P, Cₖ·P/S. Time
    /// constants stay.
    ///
    /// ```
    /// use analysis_model::{model::{Erm, RcBranch}, pack::Pack};
    ///
    /// let cell = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 300.0 }] };
    /// let pack = Pack::new(16, 4, 0.002)?;
    /// let erm = pack.erm(&cell)?;
    /// assert!((erm.r_ohm - (4.0 * 0.015 + 0.002)).abs() < 1e-12);
    /// assert!((erm.branches[0].r_ohm - 0.04).abs() < 1e-12);
    /// assert!((erm.time_constants_s()[0] - 3.0).abs() < 1e-12);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`PackError`] for a pack that cannot be or a cell model that is not valid.
    pub fn erm(&self, cell: &Erm) -> Result<Erm, PackError> {
        self.check()?;
        cell.validate()?;
        let ratio = self.ratio();
        let branches = cell
            .branches
            .iter()
            .map(|b| RcBranch {
                r_ohm: b.r_ohm * ratio,
                c_f: b.c_f / ratio,
            })
            .collect();
        Ok(Erm {
            r_ohm: cell.r_ohm * ratio + self.interconnect_ohm,
            branches,
        })
    }

    /// Returns the pack's impedance from a cell's measured one, Ω (equation 3.3 plus the
    /// interconnect).
    pub fn impedance(&self, cell_ohm: Complex64) -> Complex64 {
        cell_ohm * self.ratio() + self.interconnect_ohm
    }

    /// Returns the pack as engineers write it: `16S3P`.
    pub fn name(&self) -> String {
        format!("{}S{}P", self.series, self.parallel)
    }

    /// Checks that counts and resistances are usable.
    ///
    /// # Errors
    /// [`PackError`] for a count of zero, a number that is not finite or a negative resistance.
    pub fn check(&self) -> Result<(), PackError> {
        let Self {
            series,
            parallel,
            interconnect_ohm,
        } = *self;
        if series == 0 || parallel == 0 {
            return Err(PackError::Empty { series, parallel });
        }
        if !(interconnect_ohm.is_finite() && interconnect_ohm >= 0.0) {
            return Err(PackError::Interconnect {
                met: interconnect_ohm,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_thesis_pack_by_hand() {
        let cell = Erm {
            r_ohm: 0.006,
            branches: vec![RcBranch {
                r_ohm: 0.003,
                c_f: 160.0,
            }],
        };
        let pack = Pack::THESIS.erm(&cell).unwrap();
        // 0.006 · 16/3, 0.003 · 16/3, 160 · 3/16.
        assert!(
            (pack.r_ohm - 0.032).abs() < 1e-15 && (pack.branches[0].r_ohm - 0.016).abs() < 1e-15
        );
        assert!((pack.branches[0].c_f - 30.0).abs() < 1e-12);
        assert_eq!(Pack::THESIS.name(), "16S3P");
    }

    #[test]
    fn refuses_what_cannot_be() {
        let cases = [
            (
                Pack::new(0, 3, 0.0),
                "pack: expected at least 1 cell in series and 1 in parallel, met 0S3P",
            ),
            (
                Pack::new(16, 0, 0.0),
                "pack: expected at least 1 cell in series and 1 in parallel, met 16S0P",
            ),
            (
                Pack::new(16, 3, -0.001),
                "pack: expected an interconnect resistance of zero or more in Ω, met -0.001",
            ),
            (
                Pack::new(16, 3, f64::NAN),
                "pack: expected an interconnect resistance of zero or more in Ω, met NaN",
            ),
        ];
        for (result, message) in cases {
            assert_eq!(result.unwrap_err().to_string(), message);
        }
        let dead = Erm {
            r_ohm: -1.0,
            branches: Vec::new(),
        };
        assert_eq!(
            Pack::THESIS.erm(&dead).unwrap_err().to_string(),
            "R of the ERM: expected a positive finite number in Ω, met -1"
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn impedance_scales_by_s_over_p_for_any_number_of_branches(
            r_ohm in 1e-4..0.1f64,
            branches in prop::collection::vec((1e-5..0.1f64, 1e-2..1e4f64), 0..8),
            (series, parallel) in (1..200u32, 1..200u32),
            log_f in -4.0..5.0f64,
        ) {
            let branches = branches.into_iter().map(|(r_ohm, c_f)| RcBranch { r_ohm, c_f }).collect();
            let cell = Erm { r_ohm, branches };
            let pack = Pack::new(series, parallel, 0.0).unwrap();
            let freq_hz = 10f64.powf(log_f);
            // S/P in this order by hand, not through `ratio`.
            let expected = cell.impedance(freq_hz) * f64::from(series) / f64::from(parallel);
            let met = pack.erm(&cell).unwrap().impedance(freq_hz);
            prop_assert!((met - expected).norm() < 1e-12 * expected.norm());
            let wired = Pack { interconnect_ohm: 0.01, ..pack };
            let difference = wired.erm(&cell).unwrap().impedance(freq_hz) - met;
            prop_assert!((difference - 0.01).norm() < 1e-12 * met.norm().max(0.01));
            prop_assert!((wired.impedance(cell.impedance(freq_hz)) - met - 0.01).norm() < 1e-12 * met.norm().max(0.01));
        }
    }
}
