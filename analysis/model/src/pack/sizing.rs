//! Simple-IR sizing of a pack: the power that it can deliver and accept within its voltage window
//! (thesis 2.1.2).
//!
//! Every cell is an ideal source OCV with one resistance r in series (equation 2.1), the pack S/P
//! of them (2.5, 2.6) plus the interconnect. Of the two voltages that give a power P, the one with
//! the smaller current counts: CCV = (OCV + √(OCV² − 4Pr))/2 (2.4). All results are closed forms of
//! it. Transients are left out, so the available power over short times is larger than these
//! results; `sop` includes transients.

use super::{Pack, PackError};
use serde::Serialize;
use std::ops::RangeInclusive;

/// Data that a pack is sized from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizingInput {
    /// Size and interconnect.
    pub pack: Pack,
    /// Open-circuit voltage of a cell, V, above zero.
    pub cell_ocv_v: f64,
    /// DC resistance of a cell, Ω, zero or more.
    pub dcir_ohm: f64,
    /// Lowest and highest voltage of a cell, V.
    pub window_v: (f64, f64),
    /// Bus voltage that the load needs per watt it draws, V/W, above zero; the red line of the
    /// thesis' figures 2.3 and 2.4.
    pub required_v_per_w: Option<f64>,
}

/// A point on the curve of CCV over power. Discharge is positive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OperatingPoint {
    /// Power at the pack's terminals, W.
    pub power_w: f64,
    /// Voltage at the pack's terminals, V.
    pub voltage_v: f64,
    /// Current of the pack, A.
    pub current_a: f64,
    /// Current of one cell, A.
    pub cell_current_a: f64,
    /// Heat in cells and interconnect, W.
    pub heat_w: f64,
}

/// Limits of a pack by the simple-IR model; JSON of `pack size`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sizing {
    /// Size and interconnect.
    #[serde(flatten)]
    pub pack: Pack,
    /// Open-circuit voltage of the pack, V.
    pub ocv_v: f64,
    /// Resistance of the pack with its interconnect, Ω.
    pub resistance_ohm: f64,
    /// Lowest voltage of the pack, V.
    pub v_min_v: f64,
    /// Highest voltage of the pack, V.
    pub v_max_v: f64,
    /// Largest discharge power within the window, W; `None` if the pack at rest lies below it.
    pub peak_power_w: Option<f64>,
    /// Power at which the voltage has fallen to the minimum of the load for that power, W.
    pub crossing_power_w: Option<f64>,
    /// Power at which charging reaches the upper voltage, W, zero or less.
    pub regen_power_w: Option<f64>,
    /// OCV²/4r: the most that any load could draw, at half the OCV, window or not, W.
    pub theoretical_maximum_w: f64,
    /// Limit that ends the discharge power: the lower voltage, or the theoretical maximum, which
    /// lies above it.
    pub peak_limited_by: Option<PeakLimit>,
    /// All of the largest discharge power.
    pub peak: Option<OperatingPoint>,
    /// All of the crossing.
    pub crossing: Option<OperatingPoint>,
    /// Whether the crossing lies within the window.
    pub crossing_within_window: Option<bool>,
    /// All of the largest charge power.
    pub regen: Option<OperatingPoint>,
    /// Reasons why values are missing, and notes on the others.
    pub notes: Vec<String>,
}

/// Limit that ends the discharge power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PeakLimit {
    /// The lower end of the voltage window.
    LowerVoltage,
    /// The top of the curve P(CCV) at half the OCV.
    TheoreticalMaximum,
}

impl Sizing {
    /// Sizes a pack.
    ///
    /// # Errors
    /// [`PackError`] for a pack that cannot be, no resistance at all, or voltages and slopes that
    /// make no sense.
    pub fn new(input: &SizingInput) -> Result<Self, PackError> {
        let ir = SimpleIr::new(input)?;
        let series = f64::from(input.pack.series);
        let window = (input.window_v.0 * series, input.window_v.1 * series);
        let mut sizing = Self {
            pack: input.pack,
            ocv_v: ir.ocv_v,
            resistance_ohm: ir.resistance_ohm,
            v_min_v: window.0,
            v_max_v: window.1,
            peak_power_w: None,
            crossing_power_w: None,
            regen_power_w: None,
            theoretical_maximum_w: ir.theoretical_maximum_w(),
            peak_limited_by: None,
            peak: None,
            crossing: None,
            crossing_within_window: None,
            regen: None,
            notes: Vec::new(),
        };
        sizing.set_window_powers(&ir);
        if let Some(slope) = input.required_v_per_w {
            sizing.set_crossing(&ir, slope);
        }
        sizing.peak_power_w = sizing.peak.map(|p| p.power_w);
        sizing.crossing_power_w = sizing.crossing.map(|p| p.power_w);
        sizing.regen_power_w = sizing.regen.map(|p| p.power_w);
        Ok(sizing)
    }

    fn set_window_powers(&mut self, ir: &SimpleIr) {
        let (ocv, low, high) = (self.ocv_v, self.v_min_v, self.v_max_v);
        if ocv < low {
            self.notes.push(format!(
                "no discharge power: the OCV of {ocv:.2} V is below the \
            window's lower end of {low:.2} V"
            ));
        } else if high < 0.5 * ocv {
            // The window lies on the branch of the larger current, which no sane load settles on.
            self.notes.push(format!(
                "no power: the window ends at {high:.2} V, below half the OCV of {ocv:.2} V"
            ));
            return;
        } else {
            let half = 0.5 * ocv;
            self.peak_limited_by = Some(if half > low {
                PeakLimit::TheoreticalMaximum
            } else {
                PeakLimit::LowerVoltage
            });
            self.peak = Some(ir.at_voltage(low.max(half)));
            if half > low {
                self.notes.push(format!(
                    "the peak is the theoretical maximum at half the OCV, \
                {half:.2} V; the window's lower end of {low:.2} V is never reached"
                ));
            }
        }
        if ocv > high {
            let least = ir.at_voltage(high).power_w;
            self.notes.push(format!(
                "no regeneration: the OCV of {ocv:.2} V is above the window's upper end of \
                {high:.2} V; at least {least:.0} W must be drawn"
            ));
        } else {
            self.regen = Some(ir.at_voltage(high));
        }
    }

    fn set_crossing(&mut self, ir: &SimpleIr, slope: f64) {
        // CCV = kP and P = CCV(OCV − CCV)/r give CCV = OCV − r/k; no square root is left.
        let voltage = self.ocv_v - self.resistance_ohm / slope;
        if voltage < 0.5 * self.ocv_v {
            self.notes.push(
                "no crossing: the voltage stays above what the load needs up to the \
            theoretical maximum"
                    .to_owned(),
            );
            return;
        }
        let within = (self.v_min_v..=self.v_max_v).contains(&voltage);
        if !within {
            self.notes.push(format!(
                "the crossing at {voltage:.2} V lies outside the window of {:.2} to {:.2} V",
                self.v_min_v, self.v_max_v
            ));
        }
        self.crossing_within_window = Some(within);
        self.crossing = Some(ir.at_voltage(voltage));
    }
}

/// A source with a resistance: a pack of identical cells in the simple-IR model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimpleIr {
    /// Open-circuit voltage of the pack, V.
    pub ocv_v: f64,
    /// Resistance of the pack, Ω, above zero.
    pub resistance_ohm: f64,
    parallel: f64,
}

impl SimpleIr {
    /// Creates the pack of an input (equations 2.5 and 2.6, plus the interconnect).
    ///
    /// # Errors
    /// As [`Sizing::new`].
    pub fn new(input: &SizingInput) -> Result<Self, PackError> {
        input.pack.check()?;
        let fail = |what, expected, met| {
            Err(PackError::Value {
                what,
                expected,
                met,
            })
        };
        if !(input.cell_ocv_v.is_finite() && input.cell_ocv_v > 0.0) {
            return fail("OCV of a cell", "a voltage above 0 V", input.cell_ocv_v);
        }
        if !(input.dcir_ohm.is_finite() && input.dcir_ohm >= 0.0) {
            return fail(
                "DC resistance of a cell",
                "zero or more in Ω",
                input.dcir_ohm,
            );
        }
        check_window(input.window_v.0..=input.window_v.1)?;
        if let Some(slope) = input
            .required_v_per_w
            .filter(|k| !(k.is_finite() && *k > 0.0))
        {
            return fail("required voltage per power", "a number above 0 V/W", slope);
        }
        let resistance_ohm = input.dcir_ohm * input.pack.ratio() + input.pack.interconnect_ohm;
        if resistance_ohm <= 0.0 {
            return fail(
                "resistance of the pack",
                "above 0 Ω, for without one any power is possible",
                resistance_ohm,
            );
        }
        let ocv_v = input.cell_ocv_v * f64::from(input.pack.series);
        Ok(Self {
            ocv_v,
            resistance_ohm,
            parallel: f64::from(input.pack.parallel),
        })
    }

    /// OCV²/4r, W.
    pub fn theoretical_maximum_w(&self) -> f64 {
        self.ocv_v * self.ocv_v / (4.0 * self.resistance_ohm)
    }

    /// Returns the voltage under a power, V (equation 2.4); none beyond the theoretical maximum.
    pub fn voltage_v(&self, power_w: f64) -> Option<f64> {
        let square = self.ocv_v * self.ocv_v - 4.0 * power_w * self.resistance_ohm;
        (square >= 0.0).then(|| 0.5 * (self.ocv_v + square.sqrt()))
    }

    /// Returns the operating point at a voltage (equations 2.2 and 2.3).
    pub fn at_voltage(&self, voltage_v: f64) -> OperatingPoint {
        let current_a = (self.ocv_v - voltage_v) / self.resistance_ohm;
        OperatingPoint {
            power_w: voltage_v * current_a,
            voltage_v,
            current_a,
            cell_current_a: current_a / self.parallel,
            heat_w: current_a * current_a * self.resistance_ohm,
        }
    }
}

/// Checks the voltage window of a cell.
///
/// # Errors
/// [`PackError::Window`] unless 0 ≤ lower < upper.
pub fn check_window(window_v: RangeInclusive<f64>) -> Result<(), PackError> {
    let (low_v, high_v) = window_v.into_inner();
    if low_v >= 0.0 && low_v < high_v && high_v.is_finite() {
        Ok(())
    } else {
        Err(PackError::Window { low_v, high_v })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn thesis(cell_ocv_v: f64) -> SizingInput {
        let pack = Pack::new(16, 3, 0.03).unwrap();
        SizingInput {
            pack,
            cell_ocv_v,
            dcir_ohm: 0.015,
            window_v: (2.5, 4.2),
            required_v_per_w: Some(0.0075),
        }
    }

    #[test]
    fn the_thesis_pack_of_figures_2_3_and_2_4() {
        // Rounded as in the text of the task: 6.40, 5.72, −5.86 kW and 8.73, 6.58, −1.95 kW.
        for (ocv, expected) in [(3.6, [6.40, 5.72, -5.86]), (4.0, [8.73, 6.58, -1.95])] {
            let s = Sizing::new(&thesis(ocv)).unwrap();
            let met = [s.peak_power_w, s.crossing_power_w, s.regen_power_w]
                .map(|p| (p.unwrap() / 10.0).round() / 100.0);
            assert_eq!(met, expected);
            assert_eq!(s.peak_limited_by, Some(PeakLimit::LowerVoltage));
            assert_eq!(
                (s.v_min_v, s.v_max_v, s.crossing_within_window),
                (40.0, 67.2, Some(true))
            );
            assert!(s.notes.is_empty(), "{:?}", s.notes);
        }
    }

    #[test]
    fn what_is_missing_has_its_reason() {
        let low = Sizing::new(&SizingInput {
            cell_ocv_v: 2.4,
            ..thesis(3.6)
        })
        .unwrap();
        assert_eq!((low.peak_power_w, low.regen.is_some()), (None, true));
        assert!(
            low.notes[0].starts_with("no discharge power: the OCV of 38.40 V is below"),
            "{:?}",
            low.notes
        );
        let high = Sizing::new(&SizingInput {
            cell_ocv_v: 4.3,
            ..thesis(3.6)
        })
        .unwrap();
        assert!(high.regen_power_w.is_none() && high.peak_power_w.is_some());
        // 67.2 V · (68.8 − 67.2) V / 0.11 Ω = 977 W.
        assert!(
            high.notes[0].contains("at least 977 W must be drawn"),
            "{:?}",
            high.notes
        );
        let wide = Sizing::new(&SizingInput {
            window_v: (1.0, 4.2),
            ..thesis(3.6)
        })
        .unwrap();
        assert_eq!(wide.peak_limited_by, Some(PeakLimit::TheoreticalMaximum));
        assert_eq!(wide.peak_power_w, Some(wide.theoretical_maximum_w));
        let modest = Sizing::new(&SizingInput {
            required_v_per_w: Some(0.003),
            ..thesis(3.6)
        })
        .unwrap();
        assert!(
            modest.crossing.is_none() && modest.notes[0].starts_with("no crossing"),
            "{:?}",
            modest.notes
        );
        let outside = Sizing::new(&SizingInput {
            required_v_per_w: Some(0.005),
            ..thesis(3.6)
        })
        .unwrap();
        assert_eq!(outside.crossing_within_window, Some(false));
        assert!(
            outside.notes[0].contains("at 35.60 V lies outside the window of 40.00 to 67.20 V"),
            "{:?}",
            outside.notes
        );
        let inverse = Sizing::new(&SizingInput {
            window_v: (1.0, 1.5),
            ..thesis(3.6)
        })
        .unwrap();
        assert!(
            inverse.peak.is_none()
                && inverse.regen.is_none()
                && inverse.notes[0].starts_with("no power"),
            "{:?}",
            inverse.notes
        );
    }

    #[test]
    fn refuses_what_makes_no_sense() {
        let ideal = Pack {
            interconnect_ohm: 0.0,
            ..thesis(3.6).pack
        };
        let cases = [
            (
                SizingInput {
                    dcir_ohm: 0.0,
                    pack: ideal,
                    ..thesis(3.6)
                },
                "resistance of the pack: expected above 0 Ω, for without one any power is \
                possible, met 0",
            ),
            (
                SizingInput {
                    dcir_ohm: f64::NAN,
                    ..thesis(3.6)
                },
                "DC resistance of a cell: expected zero or more in Ω, met NaN",
            ),
            (
                thesis(-1.0),
                "OCV of a cell: expected a voltage above 0 V, met -1",
            ),
            (
                SizingInput {
                    required_v_per_w: Some(0.0),
                    ..thesis(3.6)
                },
                "required voltage per power: expected a number above 0 V/W, met 0",
            ),
            (
                SizingInput {
                    window_v: (4.2, 2.5),
                    ..thesis(3.6)
                },
                "voltage window of a cell: expected 0 ≤ lower < upper in V, met 4.2 to 2.5",
            ),
        ];
        for (input, text) in cases {
            assert_eq!(Sizing::new(&input).unwrap_err().to_string(), text);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn the_points_lie_on_equation_2_4_and_energy_is_conserved(
            (ocv, dcir, busbar) in (2.6..4.15f64, 1e-3..0.1f64, 0.0..0.2f64),
            (series, parallel) in (1..30u32, 1..20u32),
            slope in 1e-4..0.1f64,
        ) {
            let pack = Pack::new(series, parallel, busbar).unwrap();
            let input = SizingInput {
                pack,
                cell_ocv_v: ocv,
                dcir_ohm: dcir,
                window_v: (2.5, 4.2),
                required_v_per_w: Some(slope),
            };
            let s = Sizing::new(&input).unwrap();
            let ir = SimpleIr::new(&input).unwrap();
            let points = [s.peak, s.crossing, s.regen];
            for p in points.into_iter().flatten() {
                let scale = s.theoretical_maximum_w;
                prop_assert!(
                    (ir.voltage_v(p.power_w * (1.0 - 1e-15)).unwrap() - p.voltage_v).abs()
                        < 1e-6 * s.ocv_v
                );
                prop_assert!((s.ocv_v * p.current_a - p.power_w - p.heat_w).abs() < 1e-9 * scale);
            }
            if let Some(p) = s.crossing {
                prop_assert!((p.voltage_v - slope * p.power_w).abs() < 1e-9 * s.ocv_v);
            }
            // No voltage of the window gives more than the peak.
            let best = (0..=1000).map(|k| {
                ir.at_voltage(
                    s.v_min_v + (s.ocv_v.min(s.v_max_v) - s.v_min_v) * f64::from(k) / 1000.0,
                )
                .power_w
            });
            prop_assert!(best.fold(0.0, f64::max) <= s.peak_power_w.unwrap() * (1.0 + 1e-12));
        }
    }
}
