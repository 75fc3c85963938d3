//! Determines the positions of the four probes from a known change of the current: where each of
//! them is, and whether it reads the expected value. The functions are pure.
//!
//! The loop is earth, return wire, (1) shunt (2), wire, (3) fixture (4), with all voltages against
//! earth. So for one ampere the four readings rise in this order, by the unknown resistance of a
//! wire, the shunt, another wire and the fixture in the jig; with the second pair on the shunt
//! they equal those of the first. Every single mistake that is common at a bench – leads in
//! another order, a lead that reads nothing, a probe of another factor, a control with a wrong
//! value in the bench file – is tried; a mistake that makes all four readings possible is an
//! explanation.
//!
//! The allowed error of a reading follows from the stated uncertainties: the standard deviation of
//! the control in the bench file, and that of the probes' gains, which act on the voltage that
//! both leads of a pair have in common.

use instruments::fixture::Fixture;

/// Loop of the current, as the bench file describes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Loop {
    /// Fixture that the probes C3 and C4 are on.
    pub(super) fixture: Fixture,
    /// The current shunt.
    pub(super) shunt: KnownResistance,
    /// The fixture.
    pub(super) control: KnownResistance,
    /// Standard deviation of the gain of one channel relative to another.
    pub(super) gain_sigma: f64,
}

/// A resistance of the bench file with its standard deviation, Ω.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownResistance {
    pub(super) ohm: f64,
    pub(super) sigma_ohm: f64,
}

/// A mistake at the probes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mistake {
    /// No mistake.
    None,
    /// Channels 1 to 4 are connected to these positions.
    Order([usize; 4]),
    /// A channel, from 1, reads this multiple of its voltage.
    Factor(usize, f64),
    /// A channel, from 1, reads nothing.
    Dead(usize),
    /// The shunt differs from the bench file and has this resistance, Ω.
    Shunt(f64),
    /// The fixture differs from the bench file and has this resistance, Ω.
    Control(f64),
}

/// Wrong probe factors that people commonly set, and a sign.
const FACTORS: [f64; 8] = [0.1, 10.0, 0.01, 100.0, 0.5, 2.0, -1.0, 0.001];
/// Numbers of standard deviations that cover 95 % and 99 % of a normal distribution.
pub(super) const COVERAGE: (f64, f64) = (1.96, 2.576);
/// Standard deviation of the read-back of a supply, as a share; its manual may state a larger one.
pub(super) const METER_SIGMA: f64 = 0.01;
/// The noise of a mean, Ω at the current of the test.
const FLOOR_OHM: f64 = 0.1e-3;
/// Greatest ratio between another control's value and that in the bench file, in either direction;
/// beyond it a lead is the more likely cause.
const ANOTHER: f64 = 3.0;
/// Greatest resistance of a wire, Ω.
const MOST_WIRE_OHM: f64 = 0.3;

impl Loop {
    /// Returns every simplest explanation of four readings in Ω: the voltages' change over that of
    /// the current. Returns none if no single mistake explains them.
    pub(super) fn explain(&self, readings: [f64; 4]) -> Vec<Mistake> {
        if self.possible(readings, None) {
            return vec![Mistake::None];
        }
        let mut found: Vec<Mistake> = Vec::new();
        for order in orders() {
            let undone = [0, 1, 2, 3].map(|slot| {
                order
                    .iter()
                    .position(|from| *from == slot)
                    .map_or(f64::NAN, |at| readings[at])
            });
            if self.possible(undone, None) && order != [0, 1, 2, 3] {
                found.push(Mistake::Order(order));
            }
        }
        let swaps = |mistake: &Mistake| {
            if let Mistake::Order(order) = mistake {
                moved(order)
            } else {
                0
            }
        };
        let least = found.iter().map(swaps).min().unwrap_or(0);
        found.retain(|mistake| swaps(mistake) == least);
        for slot in 0..4 {
            for factor in FACTORS {
                let mut undone = readings;
                undone[slot] /= factor;
                if self.possible(undone, None) {
                    found.push(Mistake::Factor(slot + 1, factor));
                }
            }
            let largest = largest(&readings);
            if readings[slot].abs() < self.bound(self.sigma_ohm(largest, 0.0, None))
                && self.possible(readings, Some(slot))
            {
                found.push(Mistake::Dead(slot + 1));
            }
        }
        found.extend(self.values(readings));
        found
    }

    /// Returns values of the controls that make the readings possible.
    fn values(&self, readings: [f64; 4]) -> Vec<Mistake> {
        let [a, b, c, d] = readings;
        let another = |met: f64, known: KnownResistance| {
            (known.ohm / ANOTHER..=known.ohm * ANOTHER).contains(&met)
        };
        let with = |known: KnownResistance, ohm: f64| KnownResistance { ohm, ..known };
        let mut found = Vec::new();
        let (shunt, control) = (with(self.shunt, b - a), with(self.control, d - c));
        let on_shunt = self.fixture == Fixture::Shunt;
        let other = if on_shunt {
            Self {
                shunt,
                control: shunt,
                ..*self
            }
        } else {
            Self { shunt, ..*self }
        };
        if another(b - a, self.shunt) && other.possible(readings, None) {
            found.push(Mistake::Shunt(b - a));
        }
        if !on_shunt
            && another(d - c, self.control)
            && (Self { control, ..*self }).possible(readings, None)
        {
            found.push(Mistake::Control(d - c));
        }
        found
    }

    /// Returns the standard deviation of the difference of two readings, Ω: from their gains, and,
    /// if a control lies between them, from its value and from the current.
    pub(super) fn sigma_ohm(&self, low: f64, high: f64, known: Option<KnownResistance>) -> f64 {
        let control = known.map_or(0.0, |known| known.sigma_ohm.hypot(METER_SIGMA * known.ohm));
        (self.gain_sigma * low.hypot(high)).hypot(control)
    }

    /// Returns the bound within which 99 % of the readings of a sound bench stay, Ω.
    fn bound(&self, sigma_ohm: f64) -> f64 {
        COVERAGE.1 * sigma_ohm + FLOOR_OHM
    }

    /// Checks whether four readings can belong to this loop; a channel may be ignored.
    fn possible(&self, readings: [f64; 4], without: Option<usize>) -> bool {
        let near = |(low, high): (f64, f64), known: Option<KnownResistance>| {
            let value = known.map_or(0.0, |known| known.ohm);
            (high - low - value).abs() <= self.bound(self.sigma_ohm(low, high, known))
        };
        let wire = |(low, high): (f64, f64)| {
            (-self.bound(self.sigma_ohm(low, high, None))..=MOST_WIRE_OHM).contains(&(high - low))
        };
        let known = |a: usize, b: usize| without.is_some_and(|slot| slot == a || slot == b);
        let [a, b, c, d] = readings;
        let shunt = known(0, 1) || near((a, b), Some(self.shunt));
        let first = without == Some(0) || wire((0.0, a));
        let second = if self.fixture == Fixture::Shunt {
            (known(2, 3) || near((c, d), Some(self.shunt)))
                && (known(0, 2) || near((a, c), None))
                && (known(1, 3) || near((b, d), None))
        } else {
            (known(2, 3) || near((c, d), Some(self.control))) && (known(1, 2) || wire((b, c)))
        };
        readings.iter().all(|value| value.is_finite()) && shunt && first && second
    }
}

impl Mistake {
    /// Returns the ID of the check that it belongs to.
    pub(super) fn id(&self) -> &'static str {
        match self {
            Self::Order(order) if order[0] >= 2 || order[1] >= 2 => "probes.swapped",
            Self::Order(order) if order[0] != 0 => "probes.current_pair",
            Self::Factor(1 | 2, _) | Self::Dead(1 | 2) | Self::Shunt(_) => "probes.current_pair",
            _ => "probes.voltage_pair",
        }
    }

    /// Returns the mistake and its remedy, as text.
    pub(super) fn describe(&self) -> (String, String) {
        match *self {
            Self::None => ("every probe where it belongs".to_owned(), String::new()),
            Self::Order([1, 0, 2, 3]) => (
                "the pair C1, C2 is reversed".to_owned(),
                "swap the leads C1 and C2 at the shunt".to_owned(),
            ),
            Self::Order([0, 1, 3, 2]) => (
                "the pair C3, C4 is reversed".to_owned(),
                "swap the leads C3 and C4".to_owned(),
            ),
            Self::Order([2, 3, 0, 1]) => (
                "the pairs are swapped: C1 and C2 are on the fixture, C3 and C4 on the shunt"
                    .to_owned(),
                "C1 and C2 belong on the shunt, C3 and C4 on the jig".to_owned(),
            ),
            Self::Order(order) => {
                let on = |place: usize| format!("C{}", place + 1);
                let listed: Vec<String> = (0..4)
                    .filter(|slot| order[*slot] != *slot)
                    .map(|slot| format!("{} is where {} belongs", on(slot), on(order[slot])))
                    .collect();
                (
                    listed.join(", "),
                    "bring the leads into the order C1, C2 at the shunt, C3 (−), C4 (+) at the jig"
                        .to_owned(),
                )
            }
            Self::Factor(channel, -1.0) => (
                format!("C{channel} reads with the wrong sign"),
                format!("switch off the inversion of channel {channel} on the scope"),
            ),
            Self::Factor(channel, factor) => (
                format!("C{channel} reads {factor} of its voltage"),
                format!(
                    "set the probe factor of channel {channel} on the scope to that of the probe, \
                    and the switch on the probe"
                ),
            ),
            Self::Shunt(ohm) => (
                format!(
                    "the shunt has {:.2} mΩ by the ammeter, and wiring.shunt.resistance says \
                    otherwise",
                    1.0e3 * ohm
                ),
                "measure the shunt in four-wire, or look at its plate".to_owned(),
            ),
            Self::Control(ohm) => (
                format!(
                    "the fake cell has {:.2} mΩ, and controls.fake_cell.resistance says otherwise",
                    1.0e3 * ohm
                ),
                "measure the fake cell in four-wire".to_owned(),
            ),
            Self::Dead(channel) => (
                format!("C{channel} reads nothing"),
                format!("look at the lead of C{channel}, its clip and its plug at the scope"),
            ),
        }
    }
}

fn largest(readings: &[f64; 4]) -> f64 {
    readings
        .iter()
        .fold(0.0, |most, value| value.abs().max(most))
}

fn moved(order: &[usize; 4]) -> usize {
    order
        .iter()
        .enumerate()
        .filter(|(slot, from)| slot != *from)
        .count()
}

/// Returns all 24 orders of four leads.
fn orders() -> Vec<[usize; 4]> {
    let mut all = Vec::with_capacity(24);
    for code in 0..256_usize {
        let order = [code & 3, (code >> 2) & 3, (code >> 4) & 3, (code >> 6) & 3];
        if (0..4).all(|slot| order.contains(&slot)) {
            all.push(order);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    const OF_SHUNT: KnownResistance = KnownResistance {
        ohm: 9.96e-3,
        sigma_ohm: 0.02e-3,
    };
    const FAKE: Loop = Loop {
        fixture: Fixture::FakeCell,
        shunt: OF_SHUNT,
        control: KnownResistance {
            ohm: 3.75e-3,
            sigma_ohm: 0.05e-3,
        },
        gain_sigma: 0.01,
    };
    const SHUNT: Loop = Loop {
        fixture: Fixture::Shunt,
        shunt: OF_SHUNT,
        control: OF_SHUNT,
        gain_sigma: 0.01,
    };

    fn milli(values: [f64; 4]) -> [f64; 4] {
        values.map(|value| 1.0e-3 * value)
    }

    #[test]
    fn a_good_loop_needs_no_explanation() {
        assert_eq!(
            FAKE.explain(milli([17.1, 27.0, 38.9, 42.8])),
            [Mistake::None]
        );
        assert_eq!(
            SHUNT.explain(milli([17.1, 27.0, 17.0, 27.1])),
            [Mistake::None]
        );
    }

    #[test]
    fn each_single_mistake_on_the_fake_cell_is_named() {
        let good = milli([17.0, 27.0, 39.0, 42.8]);
        let mut expected: Vec<([f64; 4], Mistake)> = vec![];
        for order in [
            [1, 0, 2, 3],
            [0, 1, 3, 2],
            [2, 3, 0, 1],
            [0, 2, 1, 3],
            [3, 1, 2, 0],
        ] {
            expected.push((order.map(|from| good[from]), Mistake::Order(order)));
        }
        for slot in 0..4 {
            for factor in [0.1, 10.0, -1.0] {
                let mut readings = good;
                readings[slot] *= factor;
                expected.push((readings, Mistake::Factor(slot + 1, factor)));
            }
            let mut readings = good;
            readings[slot] = 0.0;
            expected.push((readings, Mistake::Dead(slot + 1)));
        }
        for (readings, mistake) in expected {
            let found = FAKE.explain(readings);
            assert!(
                found.contains(&mistake) && found.len() <= 3,
                "{mistake:?}: {found:?} of {readings:?}"
            );
        }
    }

    #[test]
    fn on_the_shunt_a_swap_of_pairs_is_not_a_mistake_and_a_reversed_pair_is() {
        let good = milli([17.0, 27.0, 17.0, 27.0]);
        assert_eq!(
            SHUNT.explain([2, 3, 0, 1].map(|from: usize| good[from])),
            [Mistake::None]
        );
        assert_eq!(
            SHUNT.explain([1, 0, 2, 3].map(|from: usize| good[from]))[0].id(),
            "probes.current_pair"
        );
        assert!(
            SHUNT
                .explain([0, 1, 3, 2].map(|from: usize| good[from]))
                .contains(&Mistake::Order([0, 1, 3, 2]))
        );
        assert_eq!(
            SHUNT.explain(milli([17.0, 27.0, 17.0, 2.7])),
            [Mistake::Factor(4, 0.1)]
        );
    }

    /// A wrong value produces readings that a wrong probe could also produce: both are reported.
    #[test]
    fn a_control_of_another_value_is_reported_beside_what_else_it_may_be() {
        let fake_of_6 = FAKE.explain(milli([17.0, 27.0, 39.0, 45.0]));
        assert!(
            matches!(fake_of_6[..], [Mistake::Control(ohm)] if (ohm - 6.0e-3).abs() < 1.0e-9),
            "{fake_of_6:?}"
        );
        let shunt_of_20 = FAKE.explain(milli([17.0, 37.0, 49.0, 52.75]));
        assert!(
            matches!(shunt_of_20[..], [.., Mistake::Shunt(ohm)] if (ohm - 20.0e-3).abs() < 1.0e-9),
            "{shunt_of_20:?}"
        );
        let half = FAKE.explain(milli([8.5, 27.0, 39.0, 42.75]));
        assert!(
            half.contains(&Mistake::Factor(1, 0.5))
                && half
                    .iter()
                    .any(|mistake| matches!(mistake, Mistake::Shunt(_))),
            "{half:?}"
        );
        // Both pairs read the same: the probes are not the cause.
        let both = SHUNT.explain(milli([17.0, 37.0, 17.0, 37.0]));
        assert!(matches!(both[..], [Mistake::Shunt(_)]), "{both:?}");
    }

    #[test]
    fn the_tolerance_follows_from_what_is_stated() {
        // Gains of 1 % on 39 mΩ and 42.75 mΩ are 0.58 mΩ; a control with ten times the uncertainty
        // is visible beside that.
        let sigma = |sigma_ohm| {
            FAKE.sigma_ohm(
                39.0e-3,
                42.75e-3,
                Some(KnownResistance {
                    ohm: 3.75e-3,
                    sigma_ohm,
                }),
            )
        };
        assert!(
            (sigma(0.05e-3) - 0.582e-3).abs() < 1.0e-6 && (sigma(0.5e-3) - 0.766e-3).abs() < 1.0e-6,
            "{} {}",
            sigma(0.05e-3),
            sigma(0.5e-3)
        );
        let exact = Loop {
            gain_sigma: 0.001,
            ..FAKE
        };
        assert_eq!(
            FAKE.explain(milli([17.0, 27.0, 39.0, 43.8])),
            [Mistake::None]
        );
        assert!(matches!(
            exact.explain(milli([17.0, 27.0, 39.0, 43.8]))[..],
            [Mistake::Control(_)]
        ));
    }

    #[test]
    fn two_mistakes_at_once_have_no_single_explanation() {
        assert_eq!(FAKE.explain(milli([1.7, 27.0, 39.0, 428.0])), []);
        assert_eq!(FAKE.explain([f64::NAN; 4]), []);
    }

    #[test]
    fn every_mistake_has_words_and_a_check() {
        for mistake in [
            Mistake::Order([1, 0, 2, 3]),
            Mistake::Order([2, 3, 0, 1]),
            Mistake::Factor(4, 0.1),
            Mistake::Dead(2),
        ] {
            let (what, advice) = mistake.describe();
            assert!(
                !what.is_empty() && !advice.is_empty() && mistake.id().starts_with("probes."),
                "{mistake:?}"
            );
        }
        assert_eq!(
            Mistake::Order([0, 3, 2, 1]).describe().0,
            "C2 is where C4 belongs, C4 is where C2 belongs"
        );
    }
}
