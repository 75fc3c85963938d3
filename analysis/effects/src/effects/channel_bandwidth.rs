//! The voltage channel is slower than the current channel.

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range, Record};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "channel_bandwidth",
    title: "bandwidth of the voltage channel",
    group: Group::Bench,
    mechanism: "The amplifier or filter of the voltage channel is slower than the one of the \
    current channel.",
    state_equation: "τ·du_logged/dt = u − u_logged; τ in s; the voltage goes straight between two \
    samples",
    impedance: "Z → Z/(1 + jωτ), of cell and controls alike",
    source: "first-order low-pass",
    signature: "phase and magnitude fall together at the top of the band, on every impedance \
    alike; rounded edges",
    confounders: &["time_skew", "inductance", "current_smoothing"],
    contains: &[],
    experiment: "a sweep of a shunt; a current step into a shunt, both channels logged fast",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ChannelBandwidth;

impl Effect for ChannelBandwidth {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        // ωτ = 1 at the highest frequency; without spectra, a few samples.
        let upper = base
            .facts
            .highest_hz
            .map_or(5.0 * base.facts.shortest_s, |f| {
                1.0 / (std::f64::consts::TAU * f)
            });
        if !upper.is_finite() {
            return Vec::new();
        }
        vec![Parameter::strength(
            "tau_s",
            "s",
            Range { lower: 0.0, upper },
            0.01 * upper,
        )]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        z_ohm / Complex64::new(1.0, std::f64::consts::TAU * at.freq_hz * p[0])
    }

    fn voltage(&self, p: &[f64], record: &Record<'_>, voltage_v: &mut [f64]) {
        if p[0] <= 0.0 {
            return;
        }
        let Some(first) = voltage_v.first() else {
            return;
        };
        let (mut before_v, mut logged_v) = (*first, *first);
        for (v, w) in voltage_v.iter_mut().skip(1).zip(record.time_s.windows(2)) {
            let x = (w[1] - w[0]) / p[0];
            let decay = (-x).exp();
            let mean = if x > 1e-9 {
                -(-x).exp_m1() / x
            } else {
                1.0 - 0.5 * x
            };
            logged_v = decay * logged_v + (mean - decay) * before_v + (1.0 - mean) * *v;
            before_v = std::mem::replace(v, logged_v);
        }
    }
}
