//! The direct current along the steps of a stage: which is in force at a step, and the charge that it
//! has moved.

use instruments::units::{Amps, Coulombs, Seconds};

use super::{Stage, Step};

/// The direct current and its charge along the steps of a stage.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BiasCourse {
    /// Direct current, A.
    pub(super) bias_a: Amps,
    /// Charge that it has moved since the last recharge, C.
    moved_coulomb: Coulombs,
    /// Charge that it may move, C.
    most_coulomb: Coulombs,
}

impl BiasCourse {
    /// Takes the change of a step, which is expected to take `expected_s`. Returns an error if the
    /// step does not continue the current, or moves too much charge.
    pub(super) fn take(&mut self, step: &Step, expected_s: Seconds) -> Result<(), String> {
        match step {
            Step::Bias(bias) => {
                if bias.from_a != self.bias_a {
                    return Err(format!(
                        "expected a ramp from {} A, found one from {} A",
                        self.bias_a.0, bias.from_a.0
                    ));
                }
                self.moved_coulomb += bias.to_a.abs() * expected_s;
                (self.bias_a, self.most_coulomb) = (bias.to_a, bias.most_coulomb);
            }
            Step::Sine { .. } | Step::Multisine(_) => {
                self.moved_coulomb += self.bias_a.abs() * expected_s;
            }
            Step::Recharge(_) if self.bias_a != Amps::ZERO => {
                return Err(format!(
                    "expected no direct current, found {} A",
                    self.bias_a.0
                ));
            }
            Step::Recharge(_) => self.moved_coulomb = Coulombs::ZERO,
            Step::PowerDown if self.bias_a != Amps::ZERO || self.moved_coulomb > Coulombs::ZERO => {
                return Err(
                    "expected a ramp to 0 A and a recharge before the supply is taken down"
                        .to_owned(),
                );
            }
            Step::Trace(_) | Step::Recheck(_) if self.bias_a != Amps::ZERO => {
                return Err(format!(
                    "expected no direct current, found {} A",
                    self.bias_a.0
                ));
            }
            _ => {}
        }
        if self.moved_coulomb > self.most_coulomb {
            return Err(format!(
                "expected a direct current to move at most {:.0} C before a recharge \
                (bias_charge), found {:.0} C: fewer periods, a higher frequency or a smaller \
                current",
                self.most_coulomb.0, self.moved_coulomb.0
            ));
        }
        Ok(())
    }
}

impl Stage {
    /// Returns the direct current in force at a step, A.
    pub fn bias_at(&self, step: usize) -> Amps {
        let before = self.steps.get(..step).unwrap_or_default();
        let found = before.iter().rev().find_map(|step| match step {
            Step::Bias(bias) => Some(bias.to_a),
            _ => None,
        });
        found.unwrap_or(Amps::ZERO)
    }

    /// Returns the direct current under the sinusoids of the stage, A.
    pub fn bias_a(&self) -> Amps {
        let found = self.steps.iter().find_map(|step| match step {
            Step::Bias(bias) if bias.to_a != Amps::ZERO => Some(bias.to_a),
            _ => None,
        });
        found.unwrap_or(Amps::ZERO)
    }
}
