//! Checks that the four channels of a record are potentials along one loop of passive parts. The
//! functions are pure.
//!
//! The shunt lies between C1 and C2, a wire between C2 and C3, the jig between C3 and C4.
//! Alternatively the jig comes first, and the wire lies between C4 and C1. The same current flows
//! through all of them, so the potentials per ampere must rise by a positive resistance from part
//! to part, wherever the loop is earthed. If C1 to C3 lie between earth and jig, they do not
//! depend on the contents of the jig: they must have the values that they had with a control in
//! it. If a record contradicts this, each single fault of the leads is tried, and those that
//! explain the record are named.

use analysis_signal::{calibration::Priors, spectrum::ChannelPhasors};
use instruments::fixture::Fixture;
use num_complex::Complex64;

use super::SweepPoint;

/// Standard deviations above which a contradiction does not count as noise.
const CERTAIN: f64 = 5.0;
/// Greatest relative difference of a potential per ampere from that with a control in the jig.
/// Wires warm up and contacts differ by some mΩ of tens; a dead channel loses everything, and a
/// probe factor of 10 adds nine times the value.
const MOVED: f64 = 0.5;
/// Relative difference below which two frequencies count as equal.
const SAME_FREQUENCY: f64 = 0.01;
/// Share of the largest channel below which a channel is dead.
const DEAD: f64 = 0.02;
/// Share of the commanded amplitude within which the current must be.
const AMPLITUDE: std::ops::RangeInclusive<f64> = 0.8..=1.2;
/// Wrong probe factors that are tried.
const FACTORS: [f64; 2] = [10.0, 0.1];

/// Potentials of C1 to C3 per ampere with a control in the jig, Ω.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlPotentials {
    freq_hz: f64,
    ohm: [Complex64; 3],
}

/// Criteria for a record, beside its own channels.
#[derive(Debug, Clone, Copy)]
pub struct LoopRequest<'a> {
    /// Fixture in the jig.
    pub fixture: Fixture,
    /// Resistance of the current shunt, Ω.
    pub shunt_ohm: f64,
    /// Commanded amplitude of the current, A.
    pub amplitude_a: f64,
    /// Potentials that were measured with the controls of this run.
    pub controls: &'a [ControlPotentials],
}

/// A contradiction between the channels of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelFault {
    /// What was expected and what was found.
    pub found: String,
    /// The faults of leads that explain it, as text.
    pub cause: String,
}

/// A single fault of leads or channels.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cause {
    Dead(usize),
    Factor(usize, f64),
    Inverted(usize),
    Swapped(usize, usize),
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::Dead(slot) => write!(
                f,
                "C{} shows nothing of the sinusoid: its lead is off, or the channel is dead",
                slot + 1
            ),
            Self::Factor(slot, factor) => write!(
                f,
                "C{} reads {factor} times its voltage: its probe factor is wrong",
                slot + 1
            ),
            Self::Inverted(slot) => write!(f, "C{} is inverted", slot + 1),
            Self::Swapped(one, other) => write!(
                f,
                "the leads of C{} and C{} are exchanged",
                one + 1,
                other + 1
            ),
        }
    }
}

impl ControlPotentials {
    /// Returns the potentials of a sound point of a control in the jig, or `None` for other
    /// points.
    pub fn of(point: &SweepPoint, shunt_ohm: f64) -> Option<Self> {
        let in_jig = matches!(point.fixture, Fixture::FakeCell | Fixture::Short);
        let [low, high, tap, _] = point.phasors.volts;
        let amps = (high - low) / shunt_ohm;
        let sound = in_jig && point.measures.clipped == 0.0 && amps.norm() > 0.0;
        sound.then(|| Self {
            freq_hz: point.phasors.freq_hz,
            ohm: [low, high, tap].map(|volts| volts / amps),
        })
    }

    /// Checks whether C1 to C3 lie between earth and jig, so that the contents of the jig do not
    /// affect them.
    fn is_below_jig(&self) -> bool {
        let [low, high, tap] = self.ohm;
        low.re > 0.0 && tap.re >= high.re
    }
}

/// Returns a contradiction between the channels of a record, or `None` if a loop of passive parts
/// explains it within its noise and the prior uncertainty of gains and skews.
pub fn find_channel_fault(
    phasors: &ChannelPhasors,
    request: &LoopRequest<'_>,
) -> Option<ChannelFault> {
    if request.fixture == Fixture::Shunt {
        // C3 and C4 are on the shunt; the fixture check knows their expected values.
        return None;
    }
    let potentials = Potentials::of(phasors, request, None)?;
    let mut found = potentials.contradictions(request);
    let physical = !found.is_empty();
    found.extend(potentials.wrong_amplitude(request));
    if found.is_empty() {
        return None;
    }
    let explained: Vec<(Cause, bool)> = causes(request)
        .filter_map(|cause| Some((cause, explains(cause, phasors, request)?)))
        .collect();
    // The usual order of shunt and jig explains more than the other one.
    let usual = explained.iter().any(|(_, usual)| *usual);
    let causes: Vec<String> = explained
        .iter()
        .filter(|(_, of_usual)| *of_usual == usual)
        .map(|(cause, _)| cause.to_string())
        .collect();
    let cause = match causes.len() {
        // Causes other than leads may change the amplitude.
        0 if !physical => return None,
        0 => "no single channel explains it: look at the leads of all four".to_owned(),
        _ => causes.join(", or "),
    };
    Some(ChannelFault {
        found: found.join("; "),
        cause,
    })
}

/// Returns the faults that are tried. If a cell is in the jig, the level of C4 was compared with a
/// voltmeter.
fn causes(request: &LoopRequest<'_>) -> impl Iterator<Item = Cause> {
    let slots = if request.fixture == Fixture::Cell {
        3
    } else {
        4
    };
    // Without a control a dead C1 or C2 appears only as another amplitude.
    let first_dead = if request.controls.is_empty() { 2 } else { 0 };
    let dead = (first_dead..slots).map(Cause::Dead);
    let factors = (0..slots).flat_map(|slot| FACTORS.map(|factor| Cause::Factor(slot, factor)));
    let swaps = (0..slots)
        .flat_map(move |one| (one + 1..slots).map(move |other| Cause::Swapped(one, other)));
    dead.chain(factors)
        .chain((0..slots).map(Cause::Inverted))
        .chain(swaps)
}

/// Checks whether the record is that of a sound loop after removal of a fault. Returns `None` if
/// not, otherwise whether the jig lies above the shunt, as usual.
fn explains(cause: Cause, phasors: &ChannelPhasors, request: &LoopRequest<'_>) -> Option<bool> {
    let mut mended = *phasors;
    let mut dead = None;
    match cause {
        Cause::Dead(slot) => {
            let largest = phasors.volts.iter().map(|v| v.norm()).fold(0.0, f64::max);
            if phasors.volts[slot].norm() > (DEAD * largest).max(CERTAIN * noise_v(phasors, slot)) {
                return None;
            }
            dead = Some(slot);
        }
        Cause::Factor(slot, factor) => mended.volts[slot] /= factor,
        Cause::Inverted(slot) => mended.volts[slot] = -mended.volts[slot],
        Cause::Swapped(one, other) => {
            mended.volts.swap(one, other);
            mended.variance.swap(one, other);
        }
    }
    let potentials = Potentials::of(&mended, request, dead)?;
    let sound = potentials.contradictions(request).is_empty()
        && potentials.wrong_amplitude(request).is_none();
    sound.then(|| potentials.negative(1, 2).is_none())
}

/// Returns the standard deviation of a channel's phasor, V.
fn noise_v(phasors: &ChannelPhasors, slot: usize) -> f64 {
    let total = phasors.variance[slot].total();
    (total.re_re + total.im_im).max(0.0).sqrt()
}

/// Potentials of the channels per ampere, with standard deviations, Ω.
struct Potentials {
    freq_hz: f64,
    ohm: [Complex64; 4],
    sigma_ohm: [f64; 4],
    /// A channel that counts as dead.
    dead: Option<usize>,
    /// Amplitude of the current, A; `None` if a channel of the shunt is dead.
    amplitude_a: Option<f64>,
}

impl Potentials {
    /// Returns `None` if no current flows.
    fn of(
        phasors: &ChannelPhasors,
        request: &LoopRequest<'_>,
        dead: Option<usize>,
    ) -> Option<Self> {
        let [low, high, ..] = phasors.volts;
        let measured = dead.is_none_or(|slot| slot > 1);
        let amps = match dead {
            Some(0) => Complex64::from_polar(request.amplitude_a, high.arg()),
            Some(1) => Complex64::from_polar(request.amplitude_a, low.arg()),
            _ => (high - low) / request.shunt_ohm,
        };
        if amps.norm() <= 0.0 {
            return None;
        }
        let priors = Priors::default();
        let turn = std::f64::consts::TAU * phasors.freq_hz * priors.skew_sigma_s;
        let ohm = phasors.volts.map(|volts| volts / amps);
        let sigma_ohm = [0, 1, 2, 3].map(|slot| {
            let chain = ohm[slot].norm() * priors.gain_sigma.hypot(turn);
            chain.hypot(noise_v(phasors, slot) / amps.norm())
        });
        Some(Self {
            freq_hz: phasors.freq_hz,
            ohm,
            sigma_ohm,
            dead,
            amplitude_a: measured.then(|| amps.norm()),
        })
    }

    /// Returns contradictions to any loop of passive parts, and to the loop that the controls were
    /// measured in.
    fn contradictions(&self, request: &LoopRequest<'_>) -> Vec<String> {
        // If the jig lies between earth and shunt, the wire is the one between C4 and C1.
        let wire = self
            .negative(1, 2)
            .filter(|_| self.negative(3, 0).is_some());
        let mut found: Vec<String> = wire.into_iter().chain(self.negative(2, 3)).collect();
        let same = |control: &&ControlPotentials| {
            (control.freq_hz / self.freq_hz - 1.0).abs() < SAME_FREQUENCY
        };
        let control = request.controls.iter().find(same);
        if let Some(control) = control.filter(|control| control.is_below_jig()) {
            found.extend((0..3).filter_map(|slot| self.moved(slot, control.ohm[slot])));
        }
        found
    }

    /// Describes a negative resistance between two channels.
    fn negative(&self, from: usize, to: usize) -> Option<String> {
        if self.dead.is_some_and(|slot| slot == from || slot == to) {
            return None;
        }
        let ohm = (self.ohm[to] - self.ohm[from]).re;
        let sigma_ohm = self.sigma_ohm[from].hypot(self.sigma_ohm[to]);
        (ohm < -CERTAIN * sigma_ohm).then(|| {
            format!(
                "between C{} and C{} expected a positive resistance, found {:.2} ± {:.2} mΩ",
                from + 1,
                to + 1,
                1.0e3 * ohm,
                1.0e3 * sigma_ohm
            )
        })
    }

    /// Describes a channel whose potential differs from that with a control in the jig.
    fn moved(&self, slot: usize, control_ohm: Complex64) -> Option<String> {
        let (ohm, sigma_ohm) = (self.ohm[slot], self.sigma_ohm[slot]);
        let allowed_ohm = MOVED * control_ohm.norm() + CERTAIN * sigma_ohm;
        let moved = self.dead != Some(slot) && (ohm - control_ohm).norm() > allowed_ohm;
        moved.then(|| {
            format!(
                "at C{} expected {:.2} mV/A as with the control in the jig, found {:.2} mV/A",
                slot + 1,
                1.0e3 * control_ohm.re,
                1.0e3 * ohm.re
            )
        })
    }

    /// Describes a current that differs from the commanded one.
    fn wrong_amplitude(&self, request: &LoopRequest<'_>) -> Option<String> {
        let amplitude_a = self.amplitude_a?;
        (!AMPLITUDE.contains(&(amplitude_a / request.amplitude_a))).then(|| {
            format!(
                "expected {} A by the shunt, found {amplitude_a:.3} A",
                request.amplitude_a
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_signal::spectrum::PhasorVariance;

    /// 1 A through 17 mΩ, a shunt of 10 mΩ, 12 mΩ of wire and 12 mΩ in the jig.
    const SOUND: [f64; 4] = [17e-3, 27e-3, 39e-3, 51e-3];

    fn phasors(volts: [f64; 4]) -> ChannelPhasors {
        ChannelPhasors {
            freq_hz: 30.0,
            volts: volts.map(|v| Complex64::from_polar(1.0, 0.7) * v),
            variance: [PhasorVariance::circular(1e-12); 4],
        }
    }

    fn cause(volts: [f64; 4], controls: &[ControlPotentials]) -> Option<String> {
        let request = LoopRequest {
            fixture: Fixture::Cell,
            shunt_ohm: 10e-3,
            amplitude_a: 1.0,
            controls,
        };
        find_channel_fault(&phasors(volts), &request).map(|fault| fault.cause)
    }

    #[test]
    fn each_fault_of_a_lead_is_named_by_channel_with_and_without_a_control() {
        let control = ControlPotentials {
            freq_hz: 30.0,
            ohm: [17e-3, 27e-3, 39e-3].map(Complex64::from),
        };
        let [a, b, c, d] = SOUND;
        let dead = "C3 shows nothing of the sinusoid: its lead is off, or the channel is dead";
        let factor = "C3 reads 10 times its voltage: its probe factor is wrong";
        let swapped = |one, other| format!("the leads of C{one} and C{other} are exchanged");
        for controls in [&[][..], &[control]] {
            for (volts, expected) in [
                (SOUND, None),
                ([a, b, 1e-6, d], Some(dead.to_owned())),
                ([a, b, 10.0 * c, d], Some(factor.to_owned())),
                ([b, a, c, d], Some(swapped(1, 2))),
                ([c, b, a, d], Some(swapped(1, 3))),
            ] {
                assert_eq!(cause(volts, controls), expected, "{volts:?} {controls:?}");
            }
        }
    }

    #[test]
    fn a_loop_that_is_earthed_elsewhere_and_gains_of_one_per_cent_are_sound() {
        for earth in [0.0, 20e-3, 39e-3, 60e-3] {
            let volts = SOUND.map(|v| v - earth);
            assert_eq!(cause(volts, &[]), None, "{earth}");
        }
        // The jig between earth and shunt.
        assert_eq!(cause([41e-3, 51e-3, 17e-3, 29e-3], &[]), None);
        let [a, b, c, d] = SOUND;
        assert_eq!(cause([0.99 * a, 1.01 * b, 1.01 * c, 0.99 * d], &[]), None);
        // A short in the jig, read with such gains, appears to have a negative resistance.
        assert_eq!(cause([a, b, 1.01 * c, 0.99 * c], &[]), None);
    }
}
