//! What is expected of a map where the data say little.

use super::design::Design;
use super::solve::{INDUCTANCE_H, Kinetics, Normal};
use analysis_model::map::arrhenius;

/// Standard deviations of the priors: bend over 0.1 SOC and difference between two temperatures of
/// a resistance, as shares of a third of the DC resistance.
const BEND: f64 = 0.3;
/// Standard deviation of the difference between two knots 0.1 SOC apart, as a share of the same: it
/// decides only where nothing else does.
const SLOPE: f64 = 2.0;
const UNLIKE: f64 = 0.6;
/// Standard deviation of the correction of the OCV, V, and of its change with temperature, V/K.
const OCV_V: f64 = 0.01;
const OCV_V_PER_K: f64 = 0.0002;
/// Real over imaginary part of the impedance of the branches at the highest frequency of the spectra: that
/// of a constant-phase element of exponent 2/3. One of 0.5, as a porous electrode without charge transfer
/// has it, gives 1; a branch of one time constant gives 0.
const TAIL: f64 = 0.58;
/// Standard deviation of that real part, as a share of a third of the DC resistance.
const TAIL_SIGMA: f64 = 0.05;
/// Standard deviation of the inductance of the wiring, H.
const INDUCTANCE_SIGMA_H: f64 = 1e-6;

impl Design {
    pub(super) fn add_priors(&self, kinetics: &Kinetics, normal: &mut Normal) {
        let (knots, resistances) = (self.soc.len(), self.resistances());
        let bends: Vec<[(usize, f64); 3]> = (1..knots - 1).map(|k| bend(&self.soc, k)).collect();
        for surface in 0..self.surfaces() {
            for (node, unit_ohm) in self.unit_ohm.iter().enumerate() {
                for k in 1..knots {
                    let factor = 0.1 / (self.soc[k] - self.soc[k - 1]) / (SLOPE * unit_ohm);
                    normal.expect_zero(&[
                        (self.index(surface, node, k - 1), -factor),
                        (self.index(surface, node, k), factor),
                    ]);
                }
                for terms in &bends {
                    normal.expect_zero(&terms.map(|(knot, factor)| {
                        (self.index(surface, node, knot), factor / (BEND * unit_ohm))
                    }));
                }
            }
            let energy = if surface == 0 {
                kinetics.series
            } else {
                kinetics.branches
            };
            for node in 1..self.nodes() {
                // In units of either node, so that a ratio by Arrhenius' law costs nothing.
                let factor = arrhenius(energy, self.nodes_degc[node - 1], self.nodes_degc[node]);
                let sigma_ohm = UNLIKE * self.unit_ohm[node - 1];
                for knot in 0..knots {
                    normal.expect_zero(&[
                        (self.index(surface, node - 1, knot), 1.0 / sigma_ohm),
                        (self.index(surface, node, knot), -factor / sigma_ohm),
                    ]);
                }
            }
        }
        for (start, sigma) in [(resistances, OCV_V), (resistances + knots, OCV_V_PER_K)] {
            for terms in &bends {
                normal.expect_zero(&terms.map(|(knot, factor)| (start + knot, factor / sigma)));
            }
            for knot in 0..knots {
                normal.expect_zero(&[(start + knot, 1.0 / sigma)]);
            }
        }
        normal.expect_zero(&[(self.inductance(), INDUCTANCE_H / INDUCTANCE_SIGMA_H)]);
        if let Some(omega) = self.continued_from {
            self.continue_spectra(omega, normal);
        }
    }

    /// Expects the branches to fall as a constant-phase element does from the highest frequency of the
    /// spectra on: their real part there is a constant share of their imaginary part.
    fn continue_spectra(&self, omega: f64, normal: &mut Normal) {
        for (node, unit_ohm) in self.unit_ohm.iter().enumerate() {
            for knot in 0..self.soc.len() {
                let terms = self.taus_s.iter().enumerate().map(|(branch, tau_s)| {
                    let x = omega * tau_s;
                    let factor = (1.0 - TAIL * x) / (1.0 + x * x) / (TAIL_SIGMA * unit_ohm);
                    (self.index(1 + branch, node, knot), factor)
                });
                normal.expect_zero(&terms.collect::<Vec<_>>());
            }
        }
    }
}

/// Second difference over 0.1 SOC at a knot.
fn bend(soc: &[f64], k: usize) -> [(usize, f64); 3] {
    let (left, right) = (soc[k] - soc[k - 1], soc[k + 1] - soc[k]);
    let (a, b) = (0.1 / left, 0.1 / right);
    [(k - 1, a), (k, -a - b), (k + 1, b)]
}
