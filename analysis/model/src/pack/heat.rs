//! Adiabatic temperature rise: all heat of a cell stays in it, ΔT = Q/(m·c_p).
//!
//! The worst case for events of seconds. Only Joule heat is counted: the reversible heat
//! i·T·dOCV/dT is not, for the entropy coefficient is not measured here.

use super::PackError;
use serde::Serialize;

/// Mass and specific heat of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ThermalMass {
    /// Mass of a cell, kg.
    pub mass_kg: f64,
    /// Specific heat of a cell, J/(kg·K).
    pub specific_heat_j_per_kg_k: f64,
}

impl ThermalMass {
    /// A 21700 cell: 70 g is the maximum of the P45B's data sheet; published specific heats of such
    /// cells lie between 900 and 1000 J/(kg·K), and that of the P45B is not known to us.
    pub const P45B: Self = Self {
        mass_kg: 0.070,
        specific_heat_j_per_kg_k: 950.0,
    };

    /// Checks that both are positive.
    ///
    /// # Errors
    /// [`PackError::Value`] for the first that is not.
    pub fn check(&self) -> Result<(), PackError> {
        for (what, met) in [
            ("mass of a cell in kg", self.mass_kg),
            (
                "specific heat of a cell in J/(kg·K)",
                self.specific_heat_j_per_kg_k,
            ),
        ] {
            if !(met.is_finite() && met > 0.0) {
                return Err(PackError::Value {
                    what,
                    expected: "a number above 0",
                    met,
                });
            }
        }
        Ok(())
    }

    /// Returns the temperature rise by an amount of heat, K.
    pub fn rise_k(&self, heat_j: f64) -> f64 {
        heat_j / (self.mass_kg * self.specific_heat_j_per_kg_k)
    }
}

/// A power that is held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldPower {
    /// Power at the pack's terminals, discharge positive, W.
    pub power_w: f64,
    /// Time that it is held, s.
    pub duration_s: f64,
}

/// State of a cell in the simple-IR model while a constant power is held.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Hold {
    /// Power at the pack's terminals, discharge positive, W.
    pub power_w: f64,
    /// How long it is held, s.
    pub duration_s: f64,
    /// Voltage of the pack, V.
    pub voltage_v: f64,
    /// Whether that voltage lies within the window.
    pub within_window: bool,
    /// Current of a cell, A.
    pub cell_current_a: f64,
    /// Joule heat in one cell, J.
    pub cell_heat_j: f64,
    /// Temperature rise of a cell if no heat leaves it, K.
    pub temperature_rise_k: f64,
    /// Thermal data that the rise was computed with.
    #[serde(flatten)]
    pub thermal: ThermalMass,
}

impl Hold {
    /// Creates the hold of a power for a duration.
    ///
    /// # Errors
    /// [`PackError`] as [`super::SimpleIr::new`], and for a power that the pack cannot deliver or
    /// an invalid duration.
    pub fn new(
        input: &super::SizingInput,
        held: HeldPower,
        thermal: ThermalMass,
    ) -> Result<Self, PackError> {
        let HeldPower {
            power_w,
            duration_s,
        } = held;
        thermal.check()?;
        let ir = super::SimpleIr::new(input)?;
        if !(duration_s.is_finite() && duration_s >= 0.0) {
            return Err(PackError::Value {
                what: "time for which the power is held",
                expected: "zero or more in s",
                met: duration_s,
            });
        }
        if !power_w.is_finite() {
            return Err(PackError::Value {
                what: "power that is held",
                expected: "a number in W",
                met: power_w,
            });
        }
        let most_w = ir.theoretical_maximum_w();
        let voltage_v = ir
            .voltage_v(power_w)
            .ok_or(PackError::Infeasible { power_w, most_w })?;
        let cell_current_a = ir.at_voltage(voltage_v).cell_current_a;
        let cell_heat_j = cell_current_a * cell_current_a * input.dcir_ohm * duration_s;
        let series = f64::from(input.pack.series);
        let within_window =
            (input.window_v.0 * series..=input.window_v.1 * series).contains(&voltage_v);
        let temperature_rise_k = thermal.rise_k(cell_heat_j);
        Ok(Self {
            power_w,
            duration_s,
            voltage_v,
            within_window,
            cell_current_a,
            cell_heat_j,
            temperature_rise_k,
            thermal,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::{Pack, SizingInput};

    fn input() -> SizingInput {
        let pack = Pack::new(16, 3, 0.03).unwrap();
        SizingInput {
            pack,
            cell_ocv_v: 3.6,
            dcir_ohm: 0.015,
            window_v: (2.5, 4.2),
            required_v_per_w: None,
        }
    }

    fn held(power_w: f64, duration_s: f64) -> HeldPower {
        HeldPower {
            power_w,
            duration_s,
        }
    }

    #[test]
    fn four_kilowatts_for_ten_seconds_by_hand() {
        let hold = Hold::new(&input(), held(4000.0, 10.0), ThermalMass::P45B).unwrap();
        // √(57.6² − 4·4000·0.11) = 39.4685; CCV 48.5342 V; 82.416 A; 27.472 A a cell; 27.472²
        // · 0.015 · 10 = 113.21 J; / 66.5 J/K = 1.702 K.
        assert!(
            (hold.voltage_v - 48.5342).abs() < 1e-3 && (hold.cell_current_a - 27.472).abs() < 1e-3,
            "{hold:?}"
        );
        assert!(
            (hold.cell_heat_j - 113.21).abs() < 0.02
                && (hold.temperature_rise_k - 1.702).abs() < 1e-3,
            "{hold:?}"
        );
        assert!(hold.within_window);
        // Energy: the output of the cells less the delivered energy is the heat of 48 cells and of
        // the interconnect.
        let current = 3.0 * hold.cell_current_a;
        let lost = 10.0 * (57.6 * current - 4000.0);
        assert!((lost - 48.0 * hold.cell_heat_j - 10.0 * current * current * 0.03).abs() < 1e-6);
    }

    #[test]
    fn refuses_what_cannot_be_held() {
        let cases = [
            (
                (9000.0, 1.0),
                "power of 9000 W: expected at most 7540.4 W, OCV²/4r",
            ),
            (
                (100.0, -1.0),
                "time for which the power is held: expected zero or more in s, met -1",
            ),
            (
                (f64::NAN, 1.0),
                "power that is held: expected a number in W, met NaN",
            ),
        ];
        for (case, text) in cases {
            assert_eq!(
                Hold::new(&input(), held(case.0, case.1), ThermalMass::P45B)
                    .unwrap_err()
                    .to_string(),
                text
            );
        }
        let light = ThermalMass {
            mass_kg: 0.0,
            ..ThermalMass::P45B
        };
        let text = "mass of a cell in kg: expected a number above 0, met 0";
        assert_eq!(
            Hold::new(&input(), held(100.0, 1.0), light)
                .unwrap_err()
                .to_string(),
            text
        );
    }
}
