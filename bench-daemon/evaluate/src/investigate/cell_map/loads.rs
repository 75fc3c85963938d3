//! The current of a cell under the loads of a pack, as a map predicts it.

use std::path::PathBuf;

use analysis::{
    formats::{ReadOptions, read_profile},
    forward::{Demand, Interpolation, Profile, SimModel, SimOptions, Simulation, simulate},
    map::{CellMap, Fitted, Load},
    pack::Pack,
};
use bench_core::safety::failure::Failure;

/// States of charge at which each load starts.
const STARTS: [f64; 3] = [0.9, 0.5, 0.2];
/// Shortest load, s: a shorter profile is repeated.
const LEAST_LOAD_S: f64 = 600.0;
/// Longest time between two rows of a load, s.
const LONGEST_ROW_S: f64 = 30.0;
/// Duration of a step of the current, s.
const STEP_S: f64 = 1e-4;
/// Time over which the demand is averaged for the simulation, s: the branches that are faster hold a
/// small part of the voltage, and each row gets its own current from it.
const WINDOW_S: f64 = 0.05;

/// Loads for which a map is to be good.
#[derive(Debug, Clone)]
pub struct Demands {
    /// Profiles as `simulate` reads them.
    pub under: Vec<PathBuf>,
    /// Temperatures of the cell at which they flow, °C; empty for those of the map.
    pub at_degc: Vec<f64>,
    /// Cells in series of the pack that they are for.
    pub series: u32,
    /// Cells in parallel.
    pub parallel: u32,
}

impl Demands {
    /// Reads the profiles, each repeated for ten minutes.
    ///
    /// # Errors
    /// A profile that cannot be read.
    pub fn read(&self) -> Result<Vec<Profile>, Failure> {
        let options = ReadOptions {
            demand: None,
            interpolation: Interpolation::Hold,
            charge_positive: false,
        };
        let profiles = self.under.iter().map(|path| read_profile(path, &options));
        profiles
            .map(|read| read.map(|profile| repeated(&profile)))
            .collect::<Result<_, _>>()
            .map_err(|error| Failure::Usage(error.to_string()))
    }

    /// Returns the currents of a cell under the profiles, from each state of charge at the start and
    /// at each temperature, °C.
    ///
    /// # Errors
    /// A load that the pack cannot supply.
    pub fn loads(
        &self,
        profiles: &[Profile],
        temperatures_degc: &[f64],
        fitted: Fitted,
    ) -> Result<Vec<Load>, Failure> {
        let pack = Pack::new(self.series, self.parallel, 0.0)
            .map_err(|error| Failure::Usage(error.to_string()))?;
        let mut loads = Vec::new();
        for profile in profiles {
            let coarse = averaged(profile);
            for ambient_degc in temperatures_degc {
                for soc in STARTS {
                    let start = Start {
                        fitted,
                        pack,
                        ambient_degc: *ambient_degc,
                        soc,
                    };
                    loads.push(start.load(profile, &coarse)?);
                }
            }
        }
        Ok(loads)
    }
}

/// Repeats a profile until it lasts for a while.
fn repeated(profile: &Profile) -> Profile {
    let rows = profile.time_s.len();
    let duration_s = profile.duration_s();
    let count = (LEAST_LOAD_S / duration_s).ceil().max(1.0) as usize;
    let mut long = profile.clone();
    for k in 1..count {
        // The last row of a profile only ends it.
        long.time_s.pop();
        long.value.pop();
        let from_s = duration_s * k as f64;
        long.time_s
            .extend(profile.time_s.iter().map(|t| from_s + t));
        long.value.extend(&profile.value[..rows]);
    }
    long
}

/// Averages a demand that holds between its rows over windows of whole rows; of a resistance, its inverse,
/// which the power follows.
fn averaged(profile: &Profile) -> Profile {
    let mut coarse = Profile {
        time_s: Vec::new(),
        value: Vec::new(),
        ..profile.clone()
    };
    let (Some(first_s), Some(last_s)) = (profile.time_s.first(), profile.time_s.last()) else {
        return coarse;
    };
    let counted = |value: f64| match profile.demand {
        Demand::Resistance => 1.0 / value,
        Demand::Current | Demand::Power => value,
    };
    let (mut from_s, mut sum) = (*first_s, 0.0);
    for (times_s, value) in profile.time_s.windows(2).zip(&profile.value) {
        sum += counted(*value) * (times_s[1] - times_s[0]);
        let span_s = times_s[1] - from_s;
        if span_s >= WINDOW_S || times_s[1] == *last_s {
            coarse.time_s.push(from_s);
            coarse.value.push(counted(sum / span_s));
            (from_s, sum) = (times_s[1], 0.0);
        }
    }
    coarse.time_s.push(*last_s);
    coarse
        .value
        .push(profile.value.last().copied().unwrap_or(0.0));
    coarse
}

/// The state in which a load begins.
struct Start<'a> {
    fitted: Fitted<'a>,
    pack: Pack,
    ambient_degc: f64,
    soc: f64,
}

impl Start<'_> {
    /// Returns the current of a cell under a profile: the voltage behind the series resistance is that
    /// of a simulation of the averaged profile.
    fn load(&self, profile: &Profile, coarse: &Profile) -> Result<Load, Failure> {
        let fail = |error: &dyn std::fmt::Display| {
            Failure::Usage(format!("--under {}: {error}", profile.name))
        };
        let (map, curve) = (self.fitted.fit.map.clone(), self.fitted.ocv.clone());
        let model = SimModel::mapped(map, curve, self.pack, self.ambient_degc)
            .map_err(|error| fail(&error))?;
        let start = model.rest(self.soc).map_err(|error| fail(&error))?;
        let options = SimOptions {
            max_step_s: LONGEST_ROW_S,
            ..SimOptions::default()
        };
        let run = simulate(&model, &start, coarse, &options).map_err(|error| fail(&error))?;
        let current = run.summary.feasible.then(|| self.current(profile, &run));
        current.flatten().ok_or_else(|| {
            fail(&format!(
                "expected a load that the pack can supply from {:.0} % of charge at {} °C, found more \
                power; check --series and --parallel",
                100.0 * self.soc,
                self.ambient_degc
            ))
        })
    }

    /// Returns the current of a cell at each row; `None` if a row has more power than the pack.
    fn current(&self, profile: &Profile, run: &Simulation) -> Option<Load> {
        let behind = Behind::of(self, run);
        let mut load = Load {
            name: profile.name.clone(),
            time_s: Vec::new(),
            current_a: Vec::new(),
            soc: self.soc,
            temperature_degc: self.ambient_degc,
        };
        let mut before = None;
        let mut row = 0;
        for (times_s, demand) in profile.time_s.windows(2).zip(&profile.value) {
            let ends = [(times_s[0], before != Some(*demand)), (times_s[1], true)];
            before = Some(*demand);
            for (time_s, _) in ends.into_iter().filter(|(_, shown)| *shown) {
                let Some((e_v, r_ohm)) = behind.at(time_s, &mut row) else {
                    return Some(load);
                };
                let current_a = answer(profile.demand, *demand, e_v, r_ohm)?;
                // The second of two rows at one time is the other side of a step.
                let last_s = load.time_s.last().copied().unwrap_or(f64::NEG_INFINITY);
                let time_s = if time_s > last_s {
                    time_s
                } else {
                    last_s + STEP_S
                };
                load.time_s.push(time_s);
                load.current_a
                    .push(current_a / f64::from(self.pack.parallel));
            }
        }
        Some(load)
    }
}

/// Returns the current of a voltage behind a resistance under a demand, A; `None` if the power is not
/// available.
fn answer(demand: Demand, value: f64, e_v: f64, r_ohm: f64) -> Option<f64> {
    match demand {
        Demand::Current => Some(value),
        Demand::Resistance => Some(e_v / (r_ohm + value)),
        Demand::Power => {
            // The smaller solution of (E − R·I)·I = P, without the difference of near numbers.
            let root = e_v * e_v - 4.0 * r_ohm * value;
            (root >= 0.0).then(|| 2.0 * value / (e_v + root.sqrt()))
        }
    }
}

/// The voltage behind the series resistance of a pack over time, V, and that resistance, Ω.
struct Behind {
    time_s: Vec<f64>,
    e_v: Vec<f64>,
    r_ohm: Vec<f64>,
}

impl Behind {
    /// That of a simulation, up to the time at which the cell is empty.
    fn of(start: &Start, run: &Simulation) -> Self {
        let (trace, map): (_, &CellMap) = (&run.trace, &start.fitted.fit.map);
        let count = trace.soc.iter().take_while(|soc| **soc > 0.0).count();
        let ohm = |soc: &f64| {
            let place = map.place(*soc, start.ambient_degc);
            start.pack.ratio() * map.resistance_ohm(&map.series, &place)
        };
        let r_ohm: Vec<f64> = trace.soc[..count].iter().map(ohm).collect();
        let voltages = trace.ccv_v.iter().zip(&trace.current_a).zip(&r_ohm);
        Self {
            time_s: trace.time_s[..count].to_vec(),
            e_v: voltages.map(|((v, i), r)| v + r * i).collect(),
            r_ohm,
        }
    }

    /// Returns voltage and resistance at a time, which is not before that of the `row`, which follows
    /// it; `None` after the end.
    fn at(&self, time_s: f64, row: &mut usize) -> Option<(f64, f64)> {
        while *row + 1 < self.time_s.len() && self.time_s[*row + 1] < time_s {
            *row += 1;
        }
        let (from_s, to_s) = (*self.time_s.get(*row)?, *self.time_s.get(*row + 1)?);
        if time_s > to_s + STEP_S {
            return None;
        }
        let share = if to_s > from_s {
            ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0)
        } else {
            1.0
        };
        let between = |list: &[f64]| list[*row] + share * (list[*row + 1] - list[*row]);
        Some((between(&self.e_v), between(&self.r_ohm)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_averaged_demand_moves_the_same_energy() {
        let rows = [
            (0.0, 100.0),
            (0.02, -40.0),
            (0.04, 10.0),
            (0.07, 250.0),
            (0.3, 30.0),
            (0.31, 0.0),
        ];
        let profile = Profile::new("p", Demand::Power, Interpolation::Hold, &rows).unwrap();
        let coarse = averaged(&profile);
        assert_eq!(coarse.time_s, [0.0, 0.07, 0.3, 0.31]);
        // 2 J − 0.8 J + 0.3 J over 70 ms.
        let expected = [1.5 / 0.07, 250.0, 30.0, 0.0];
        for (found, expected) in coarse.value.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{coarse:?}");
        }
    }

    #[test]
    fn an_averaged_resistance_takes_the_same_power_at_one_voltage() {
        let rows = [(0.0, 1.0), (0.03, 4.0), (0.06, 2.0), (1.0, 2.0)];
        let hold = Interpolation::Hold;
        let profile = Profile::new("p", Demand::Resistance, hold, &rows).unwrap();
        let coarse = averaged(&profile);
        assert_eq!(coarse.time_s, [0.0, 0.06, 1.0]);
        // The mean of 1 S and 0.25 S is 0.625 S.
        for (found, expected) in coarse.value.iter().zip([1.6, 2.0, 2.0]) {
            assert!((found - expected).abs() < 1e-9, "{coarse:?}");
        }
    }

    #[test]
    fn a_current_answers_each_kind_of_demand() {
        // (4 V − 0.1 Ω·10 A)·10 A are 30 W; the most is 40 W.
        let current_a = |demand, value| answer(demand, value, 4.0, 0.1);
        assert!((current_a(Demand::Power, 30.0).unwrap() - 10.0).abs() < 1e-12);
        assert!((current_a(Demand::Power, -50.0).unwrap() + 10.0).abs() < 1e-12);
        assert_eq!(current_a(Demand::Power, 41.0), None);
        assert_eq!(current_a(Demand::Current, 7.0), Some(7.0));
        assert_eq!(current_a(Demand::Resistance, 0.3), Some(10.0));
    }
}
