//! Choice of a cell and of a pack's size: every cell of a list in every size, ranked by simple IR.

use super::{
    OperatingPoint, Pack, PackError, PeakLimit, SimpleIr, Sizing, SizingInput, check_window,
};
use serde::Serialize;
use std::ops::RangeInclusive;

/// Most packs that one ranking compares.
const MOST_PACKS: usize = 1_000_000;

/// A kind of cell, from its data sheet or from a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct CellKind {
    /// Name.
    pub name: String,
    /// Capacity, Ah.
    pub capacity_ah: f64,
    /// Open-circuit voltage at which packs are compared, V.
    pub ocv_v: f64,
    /// DC resistance, Ω.
    pub dcir_ohm: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Lowest and highest voltage, V.
    pub window_v: (f64, f64),
    /// Largest discharge current, A; infinite if none is stated.
    pub discharge_max_a: f64,
}

/// Requirements on a pack.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Requirements {
    /// Resistance of busbars, wires and connectors over the whole pack, Ω.
    pub interconnect_ohm: f64,
    /// Power that the pack must deliver, W.
    pub power_w: Option<f64>,
    /// Largest mass of all cells, kg.
    pub cells_kg: Option<f64>,
    /// Lowest and highest voltage at the pack's terminals, V.
    pub bus_v: Option<(f64, f64)>,
}

/// Limit of the power of a pack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PowerLimit {
    /// The lowest voltage of the cell, or of the bus.
    LowerVoltage,
    /// Half the OCV, where no load gets more.
    TheoreticalMaximum,
    /// The largest discharge current of the cell.
    Current,
}

/// A pack of one kind of cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RankedPack {
    /// Name of the cell.
    pub cell: String,
    /// Size and interconnect.
    #[serde(flatten)]
    pub pack: Pack,
    /// Mass of all cells, kg.
    pub cells_kg: f64,
    /// Capacity times OCV of all cells, Wh.
    pub energy_wh: f64,
    /// Largest discharge power within voltage and current, W.
    pub peak_power_w: f64,
    /// What limits it.
    pub limited_by: PowerLimit,
    /// Distance of a cell's voltage from its lower limit, or from that of the bus, under the required
    /// power, V.
    pub margin_v: Option<f64>,
    /// Distance of a cell's current from its limit under the required power, A.
    pub margin_a: Option<f64>,
    /// Requirements that the pack does not meet, in words; empty if it meets all.
    pub unmet: Vec<String>,
}

impl RankedPack {
    /// Returns the power per mass of the cells, W/kg.
    pub fn power_per_mass(&self) -> f64 {
        self.peak_power_w / self.cells_kg
    }
}

/// Ranks every cell in every size. Packs that meet all requirements come first: the lightest first
/// if a power is required, the strongest first otherwise.
///
/// ```
/// use analysis_model::pack::{CellKind, Requirements, rank_packs};
///
/// let cell = CellKind {
///     name: "P45B".to_owned(),
///     capacity_ah: 4.5,
///     ocv_v: 3.6,
///     dcir_ohm: 0.015,
///     mass_kg: 0.07,
///     window_v: (2.5, 4.2),
///     discharge_max_a: 45.0,
/// };
/// let needs = Requirements { power_w: Some(5000.0), ..Requirements::default() };
/// let ranked = rank_packs(&[cell], 16..=16, 1..=4, &needs)?;
/// assert_eq!((ranked[0].pack.series, ranked[0].pack.parallel), (16, 3));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PackError`] for a cell or a size that makes no sense, and for more than a million packs.
pub fn rank_packs(
    cells: &[CellKind],
    series: RangeInclusive<u32>,
    parallel: RangeInclusive<u32>,
    needs: &Requirements,
) -> Result<Vec<RankedPack>, PackError> {
    let count = |range: &RangeInclusive<u32>| range.clone().count();
    let packs = count(&series)
        .saturating_mul(count(&parallel))
        .saturating_mul(cells.len());
    if packs > MOST_PACKS {
        return Err(PackError::Value {
            what: "number of packs",
            expected: "at most 1 000 000",
            met: packs as f64,
        });
    }
    let mut ranked = Vec::with_capacity(packs);
    for cell in cells {
        cell.check()?;
        for series in series.clone() {
            for parallel in parallel.clone() {
                let pack = Pack::new(series, parallel, needs.interconnect_ohm)?;
                ranked.push(cell.in_pack(pack, needs)?);
            }
        }
    }
    ranked.sort_by(|a, b| {
        let order = a.unmet.len().cmp(&b.unmet.len());
        let by_mass = a.cells_kg.total_cmp(&b.cells_kg);
        let by_power = b.peak_power_w.total_cmp(&a.peak_power_w);
        order.then(match needs.power_w {
            Some(_) => by_mass.then(by_power),
            None => by_power.then(by_mass),
        })
    });
    Ok(ranked)
}

impl CellKind {
    fn check(&self) -> Result<(), PackError> {
        for (what, met) in [
            ("capacity of a cell in Ah", self.capacity_ah),
            ("mass of a cell in kg", self.mass_kg),
            (
                "largest discharge current of a cell in A",
                self.discharge_max_a,
            ),
        ] {
            if met.is_nan() || met <= 0.0 {
                return Err(PackError::Value {
                    what,
                    expected: "a number above 0",
                    met,
                });
            }
        }
        check_window(self.window_v.0..=self.window_v.1)
    }

    fn in_pack(&self, pack: Pack, needs: &Requirements) -> Result<RankedPack, PackError> {
        let bus_low_v = needs.bus_v.map_or(0.0, |(low, _)| low);
        let per_cell_v = bus_low_v / f64::from(pack.series);
        let input = SizingInput {
            pack,
            cell_ocv_v: self.ocv_v,
            dcir_ohm: self.dcir_ohm,
            window_v: (self.window_v.0.max(per_cell_v), self.window_v.1),
            required_v_per_w: None,
        };
        let mut ranked = RankedPack {
            cell: self.name.clone(),
            pack,
            cells_kg: pack.cells() * self.mass_kg,
            energy_wh: pack.cells() * self.capacity_ah * self.ocv_v,
            peak_power_w: 0.0,
            limited_by: PowerLimit::LowerVoltage,
            margin_v: None,
            margin_a: None,
            unmet: Vec::new(),
        };
        // A bus whose lower end lies above the cell's upper limit leaves no window at all.
        if input.window_v.0 >= input.window_v.1 {
            ranked.unmet.push(format!("cannot reach {bus_low_v:.1} V"));
            return Ok(ranked);
        }
        let ir = SimpleIr::new(&input)?;
        match self.peak(&ir, &Sizing::new(&input)?) {
            Some((peak, limit)) => {
                (ranked.peak_power_w, ranked.limited_by) = (peak.power_w, limit);
            }
            None => ranked
                .unmet
                .push("at rest below its lower limit".to_owned()),
        }
        self.judge(&mut ranked, &ir, needs);
        Ok(ranked)
    }

    /// Returns the largest discharge power, and its limit.
    fn peak(&self, ir: &SimpleIr, sizing: &Sizing) -> Option<(OperatingPoint, PowerLimit)> {
        let peak = sizing.peak?;
        if peak.cell_current_a > self.discharge_max_a {
            let current_a = self.discharge_max_a * f64::from(sizing.pack.parallel);
            let point = ir.at_voltage(ir.ocv_v - current_a * ir.resistance_ohm);
            return Some((point, PowerLimit::Current));
        }
        let limit = match sizing.peak_limited_by {
            Some(PeakLimit::TheoreticalMaximum) => PowerLimit::TheoreticalMaximum,
            _ => PowerLimit::LowerVoltage,
        };
        Some((peak, limit))
    }

    fn judge(&self, ranked: &mut RankedPack, ir: &SimpleIr, needs: &Requirements) {
        if let Some(power_w) = needs.power_w {
            if let Some(voltage_v) = ir.voltage_v(power_w) {
                let point = ir.at_voltage(voltage_v);
                let cell_v = self.ocv_v - point.cell_current_a * self.dcir_ohm;
                let bus_low_v = needs.bus_v.map_or(0.0, |(low, _)| low);
                let bus_margin_v = (voltage_v - bus_low_v) / f64::from(ranked.pack.series);
                ranked.margin_v = Some(bus_margin_v.min(cell_v - self.window_v.0));
                ranked.margin_a = Some(self.discharge_max_a - point.cell_current_a)
                    .filter(|margin| margin.is_finite());
            }
            if ranked.peak_power_w < power_w {
                let missing_w = power_w - ranked.peak_power_w;
                ranked.unmet.push(format!("{missing_w:.0} W too weak"));
            }
        }
        if let Some(most_kg) = needs.cells_kg.filter(|most| ranked.cells_kg > *most) {
            let over_kg = ranked.cells_kg - most_kg;
            ranked.unmet.push(format!("{over_kg:.2} kg too heavy"));
        }
        if let Some((_, high)) = needs.bus_v {
            let full_v = self.window_v.1 * f64::from(ranked.pack.series);
            if full_v > high {
                ranked.unmet.push(format!("full at {full_v:.1} V"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn p45b() -> CellKind {
        CellKind {
            name: "P45B".to_owned(),
            capacity_ah: 4.5,
            ocv_v: 3.6,
            dcir_ohm: 0.015,
            mass_kg: 0.07,
            window_v: (2.5, 4.2),
            discharge_max_a: f64::INFINITY,
        }
    }

    #[test]
    fn the_pack_of_the_thesis_stands_as_it_is_sized() {
        let needs = Requirements {
            interconnect_ohm: 0.03,
            ..Requirements::default()
        };
        let ranked = rank_packs(&[p45b()], 16..=16, 3..=3, &needs).unwrap();
        let pack = &ranked[0];
        // 40 V · (57.6 − 40) V / 110 mΩ, 48 · 4.5 Ah · 3.6 V, 48 · 70 g.
        assert!((pack.peak_power_w - 6400.0).abs() < 1e-9, "{pack:?}");
        assert!((pack.energy_wh - 777.6).abs() < 1e-9 && (pack.cells_kg - 3.36).abs() < 1e-9);
        assert!((pack.power_per_mass() - 6400.0 / 3.36).abs() < 1e-9);
        // The current limit of the data sheet, 45 A per cell, binds before the voltage.
        let limited = CellKind {
            discharge_max_a: 45.0,
            ..p45b()
        };
        let ranked = rank_packs(&[limited], 16..=16, 3..=3, &needs).unwrap();
        let peak_w = 135.0 * (57.6 - 135.0 * 0.11);
        assert!((ranked[0].peak_power_w - peak_w).abs() < 1e-9, "{ranked:?}");
        assert_eq!(ranked[0].limited_by, PowerLimit::Current);
    }

    #[test]
    fn what_meets_the_requirements_comes_first_and_the_rest_says_why_not() {
        let strong = CellKind {
            name: "half".to_owned(),
            dcir_ohm: 0.0075,
            ..p45b()
        };
        let needs = Requirements {
            interconnect_ohm: 0.03,
            power_w: Some(6000.0),
            cells_kg: Some(4.0),
            bus_v: Some((40.0, 68.0)),
        };
        let ranked = rank_packs(&[p45b(), strong], 14..=18, 2..=4, &needs).unwrap();
        let fit: Vec<String> = ranked
            .iter()
            .filter(|one| one.unmet.is_empty())
            .map(|one| format!("{} {}S{}P", one.cell, one.pack.series, one.pack.parallel))
            .collect();
        // 2P of the half resistance is the lightest; P45B itself needs 16S3P.
        assert_eq!(fit[0], "half 15S2P", "{fit:?}");
        assert!(fit.contains(&"P45B 16S3P".to_owned()), "{fit:?}");
        let met = |name: &str| {
            let found = ranked
                .iter()
                .find(|one| format!("{} {}", one.cell, one.pack.name()) == name);
            found.unwrap().clone()
        };
        let heavy = met("P45B 16S4P");
        assert_eq!(heavy.unmet, ["0.48 kg too heavy"], "{heavy:?}");
        assert_eq!(met("P45B 18S3P").unmet, ["full at 75.6 V"]);
        assert!(met("P45B 14S2P").unmet[0].ends_with(" W too weak"));
        let margin = met("P45B 16S3P");
        // The bus at 40 V binds before the cell at 2.5 V.
        let point_v = 0.5 * (57.6 + (57.6_f64.powi(2) - 4.0 * 6000.0 * 0.11).sqrt());
        assert!((margin.margin_v.unwrap() - (point_v - 40.0) / 16.0).abs() < 1e-9);
        assert_eq!(margin.margin_a, None);
    }

    #[test]
    fn cells_and_sizes_that_make_no_sense_are_refused() {
        let needs = Requirements::default();
        for (cell, what) in [
            (
                CellKind {
                    mass_kg: 0.0,
                    ..p45b()
                },
                "mass of a cell in kg",
            ),
            (
                CellKind {
                    capacity_ah: f64::NAN,
                    ..p45b()
                },
                "capacity of a cell in Ah",
            ),
            (
                CellKind {
                    dcir_ohm: -1.0,
                    ..p45b()
                },
                "DC resistance of a cell",
            ),
            (
                CellKind {
                    window_v: (4.2, 2.5),
                    ..p45b()
                },
                "voltage window of a cell",
            ),
        ] {
            let error = rank_packs(&[cell], 1..=1, 1..=1, &needs)
                .unwrap_err()
                .to_string();
            assert!(error.starts_with(what), "{error}");
        }
        let error = rank_packs(&[p45b()], 1..=2000, 1..=2000, &needs).unwrap_err();
        assert!(error.to_string().starts_with("number of packs"), "{error}");
        assert!(rank_packs(&[p45b()], 0..=1, 1..=1, &needs).is_err());
        let bus = Requirements {
            bus_v: Some((40.0, 68.0)),
            ..needs
        };
        let ranked = rank_packs(&[p45b()], 4..=4, 1..=1, &bus).unwrap();
        assert_eq!(ranked[0].unmet[0], "cannot reach 40.0 V", "{ranked:?}");
        // 40 V are 3.64 V for each of 11 cells, above their OCV.
        let ranked = rank_packs(&[p45b()], 11..=11, 1..=1, &bus).unwrap();
        assert_eq!(
            ranked[0].unmet[0], "at rest below its lower limit",
            "{ranked:?}"
        );
    }
}
