//! Errors of what the data of a map show least: its extrapolated branches, and the voltage of charge
//! transfer.

use super::CellMap;

/// Standard deviation of the resistance of an extrapolated branch as a part of it: exponents of
/// constant-phase elements from 0.55 to 1 give from about twice its resistance to none.
const EXTRAPOLATED_SHARE: f64 = 0.5;
/// Standard deviation of the logarithm of the voltage of charge transfer: in porous electrodes it rises by
/// up to 40 % from small currents to large ones, and a fit finds one for the currents of its logs.
const BEND_SIGMA: f64 = 0.2;

/// An instant of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instant {
    /// State of charge.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: f64,
    /// Current, A.
    pub current_a: f64,
}

/// Both errors along a run of a cell.
#[derive(Debug, Clone)]
pub struct Unmeasured<'a> {
    map: &'a CellMap,
    /// Resistances of the branches, Ω.
    branch_ohm: Vec<f64>,
    /// Change of the voltage of each branch with the logarithm of the voltage of charge transfer, V.
    fallen_v: Vec<f64>,
}

impl<'a> Unmeasured<'a> {
    /// Returns the errors of a cell at rest.
    pub fn new(map: &'a CellMap) -> Self {
        let zeros = vec![0.0; map.branches.len()];
        Self {
            map,
            branch_ohm: zeros.clone(),
            fallen_v: zeros,
        }
    }

    /// Moves by a time, s, to an instant with the voltages of all branches, V, and returns the standard
    /// deviation of its voltage, V. After an infinite time the errors are those of a current that has lasted.
    ///
    /// What an extrapolated branch settles at is measured, so that it is wrong by a part of what it still
    /// lacks. The change v′ of a voltage v with ln b obeys τ·dv′/dt = cosh(v/b)·(v − b·tanh(v/b) − v′).
    pub fn advance(
        &mut self,
        step_s: f64,
        at: Instant,
        branch_v: impl IntoIterator<Item = f64>,
    ) -> f64 {
        let values = self
            .map
            .values(at.soc, at.temperature_degc, &mut self.branch_ohm);
        let branches = self.map.branches.iter().zip(&self.branch_ohm);
        let states = branches.zip(&mut self.fallen_v).zip(branch_v);
        let (mut lacking_v, mut fallen_sum_v) = (0.0, 0.0);
        for (((branch, r_ohm), fallen_v), v) in states {
            let drive = values.drive(branch.tau_s, *r_ohm, at.current_a);
            if branch.extrapolated {
                lacking_v += drive.settled_v() - v;
            }
            let kept = (-step_s / branch.tau_s * drive.leaking_slope(v)).exp();
            *fallen_v = kept * *fallen_v + (1.0 - kept) * drive.fallen_v(v);
            fallen_sum_v += *fallen_v;
        }
        (EXTRAPOLATED_SHARE * lacking_v).hypot(BEND_SIGMA * fallen_sum_v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{BranchStep, ChargeTransfer, MapBranch, Surface};

    fn flat(r_ohm: f64) -> Surface {
        Surface {
            activation_j_per_mol: 0.0,
            r_ohm: vec![vec![r_ohm; 2]],
            sigma_ohm: Vec::new(),
        }
    }

    /// 2 mΩ that are extrapolated and 20 mΩ of charge transfer.
    fn map(voltage_v: Option<f64>) -> CellMap {
        let branch = |tau_s, r_ohm, extrapolated| MapBranch {
            tau_s,
            extrapolated,
            resistance: flat(r_ohm),
        };
        CellMap {
            soc: vec![0.0, 1.0],
            temperature_degc: vec![25.0],
            series: flat(0.01),
            branches: vec![branch(3e-4, 0.002, true), branch(0.02, 0.02, false)],
            ocv_offset_v: vec![0.0; 2],
            ocv_v_per_k: vec![0.0; 2],
            ocv_temperature_degc: 25.0,
            charge_transfer: voltage_v.map(|voltage_v| ChargeTransfer {
                voltage_v,
                slowest_s: 3.0,
            }),
            most_current_a: None,
            thermal: None,
            voltage_error: None,
        }
    }

    #[test]
    fn an_extrapolated_branch_is_wrong_until_it_settles() {
        let map = map(None);
        assert_eq!(map.lasting_errors(), 3);
        let mut unmeasured = Unmeasured::new(&map);
        let at = Instant {
            soc: 0.5,
            temperature_degc: 25.0,
            current_a: 10.0,
        };
        // Half of 2 mΩ at 10 A at once, half of what 4 mV lack later, none at last.
        for (v, expected) in [(0.0, 0.01), (0.016, 0.002), (0.02, 0.0)] {
            let met = unmeasured.advance(1e-3, at, [v, 0.1]);
            assert!((met - expected).abs() < 1e-12, "{v}: {met}");
        }
    }

    /// The change with ln b of a run of both branches, by two runs of both sides of b.
    #[test]
    fn the_error_of_charge_transfer_is_that_of_a_run_with_another_voltage() {
        let run = |voltage_v: f64, errors: &mut Vec<f64>| {
            let map = map(Some(voltage_v));
            assert_eq!(map.lasting_errors(), 4);
            let mut unmeasured = Unmeasured::new(&map);
            let (mut v, step_s) = ([0.0; 2], 2e-4);
            let mut sums = Vec::new();
            for k in 0..400 {
                // A strong pulse, its relaxation, and a weaker current.
                let current_a = [20.0, 20.0, 0.0, -5.0][k / 100];
                let values = map.values(0.5, 25.0, &mut [0.0; 2]);
                for (v, branch) in v.iter_mut().zip(&map.branches) {
                    let r_ohm = branch.resistance.r_ohm[0][0];
                    let drive = values.drive(branch.tau_s, r_ohm, current_a);
                    let step = BranchStep::new(step_s, branch.tau_s);
                    *v = step.bent_end(*v, drive, drive).v;
                }
                let at = Instant {
                    soc: 0.5,
                    temperature_degc: 25.0,
                    current_a,
                };
                errors.push(unmeasured.advance(step_s, at, v));
                sums.push(v.iter().sum::<f64>());
            }
            sums
        };
        let (by, mut errors) = (1e-3_f64, Vec::new());
        let below = run(0.06 * (-by).exp(), &mut Vec::new());
        let above = run(0.06 * by.exp(), &mut Vec::new());
        run(0.06, &mut errors);
        // The fast branch has settled again 4 ms after each change of the current.
        for k in (0..400).filter(|k| k % 100 >= 20) {
            let expected = BEND_SIGMA * ((above[k] - below[k]) / (2.0 * by)).abs();
            assert!(
                (errors[k] - expected).abs() < 2e-4 + 0.05 * expected,
                "{k}: {} {expected}",
                errors[k]
            );
        }
        assert!(errors[199] > 2e-3, "{}", errors[199]);
    }
}
