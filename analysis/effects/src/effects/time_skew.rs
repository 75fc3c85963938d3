//! The voltage channel is read later than the current channel.

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "time_skew",
    title: "time skew between voltage and current",
    group: Group::Bench,
    mechanism: "Voltage and current are not sampled at the same instant: different delays of \
    probes, amplifiers or channels.",
    state_equation: "u(t) → u(t − Δt); Δt in s, positive where the voltage comes late",
    impedance: "Z → Z·exp(−jωΔt); with two channels against ground, of which one is late, (Z + \
    R)·exp(−jωΔt) − R or Z + R − R·exp(−jωΔt), R in Ω the impedance of what lies \
        between the lower tap and the ground",
    source: "delay theorem of the Fourier transform",
    signature: "phase proportional to the frequency at the top of the band, on every impedance \
    alike",
    confounders: &["inductance", "channel_bandwidth"],
    contains: &[],
    experiment: "sweeps of shunts of two values: the imaginary part scales with the resistance",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct TimeSkew;

impl Effect for TimeSkew {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let Some(highest_hz) = base.facts.highest_hz else {
            return Vec::new();
        };
        let most_s = 0.1 / highest_hz;
        vec![
            Parameter::strength(
                "delay_s",
                "s",
                Range {
                    lower: -most_s,
                    upper: most_s,
                },
                1e-2 * most_s,
            ),
            // Both channels of the voltage, that of the upper tap, that of the lower one.
            Parameter::choice("channel", 3),
        ]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        let late = Complex64::cis(-std::f64::consts::TAU * at.freq_hz * p[0]);
        let below_ohm = at.common_mode.impedance(at.freq_hz);
        match p[1].round() as u8 {
            0 => z_ohm * late,
            1 => (z_ohm + below_ohm) * late - below_ohm,
            _ => z_ohm + below_ohm - below_ohm * late,
        }
    }
}
