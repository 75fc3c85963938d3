//! Second and third harmonic of the voltage under a sine, by simulation.
//!
//! The model follows a few periods of the sine, and the network of small signals follows the same
//! current. Their difference is what bends: it starts at zero, so that no transient of a slow branch
//! leaks into the harmonics.

use std::{f64::consts::TAU, sync::LazyLock};

use num_complex::Complex64;

use super::{Added, Between, Grid, Player, network};
use crate::contract::{Base, Group, Network, Point, Ramp, Record};

/// Periods that are simulated, and those at the end that are evaluated.
const PERIODS: usize = 6;
const EVALUATED: usize = 2;
/// Steps of a period.
const STEPS: usize = 48;
/// Steps of the direct current before the sine, each twice as long as the one before.
const HELD_STEPS: usize = 14;
/// Duration of the step from the direct current to the sine, s.
const STEP_S: f64 = 1e-6;
/// Evaluated samples.
const SAMPLES: usize = EVALUATED * STEPS;

/// One harmonic of a point of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarmonicPoint {
    /// Frequency of the fundamental and circumstances, with the amplitude of the current.
    pub at: Point,
    /// 2 or 3.
    pub order: u32,
}

/// Returns the harmonics of orders 2 and 3 of a cell under the sine of a point, Ω: Z_k·Aᵏ⁻¹, the
/// voltage at k times the frequency over the amplitude A of the current. Charging counts positive,
/// phases from the peak of the current. Zero without an amplitude.
///
/// Effects of the bench have no part in it: they act on the channels of a logger.
pub fn harmonics(base: &Base, added: &[Added<'_>], at: &Point) -> [Complex64; 2] {
    let Some(amplitude_a) = at.amplitude_a.filter(|a| *a > 0.0 && at.is_cell) else {
        return [Complex64::ZERO; 2];
    };
    let cell: Vec<Added<'_>> = added
        .iter()
        .copied()
        .filter(|one| one.effect.card().group == Group::Cell)
        .collect();
    let sine = Sine::new(at, amplitude_a);
    let moved_coulomb = sine.charge_coulomb();
    let record = Record {
        time_s: &sine.time_s,
        current_a: &sine.current_a,
        // The point has its state of charge where it is evaluated.
        soc: at.soc + moved_coulomb / (3600.0 * base.ocv.capacity_ah),
        temperature_degc: at.temperature_degc,
        order: at.order,
        start_s: at.start_s,
        is_cell: true,
        before: &[],
    };
    let grid = Grid::new(&sine.time_s, Between::Linear);
    let mut voltage_v = Vec::with_capacity(sine.time_s.len());
    // A player of its own: another one keeps the gains of its records.
    Player::default().play(base, &cell, &record, &grid, 1, &mut voltage_v);
    let linear_v = small_signal(&network(base, &cell), &sine);
    let first = voltage_v.len() - SAMPLES;
    let bent_v: Vec<f64> = voltage_v[first..]
        .iter()
        .zip(&linear_v[first..])
        .map(|(bent, linear)| bent + linear)
        .collect();
    // A discharge current is the negative of a charge current: odd orders change their sign.
    let [second, third] = BASIS.phasors(&bent_v);
    [second / amplitude_a, -third / amplitude_a]
}

/// A sine of current on a direct current, A, discharge positive.
struct Sine {
    time_s: Vec<f64>,
    current_a: Vec<f64>,
}

impl Sine {
    fn new(at: &Point, amplitude_a: f64) -> Self {
        let mut sine = Self {
            time_s: Vec::new(),
            current_a: Vec::new(),
        };
        let mut begin_s = 0.0;
        if at.bias_a != 0.0 {
            let mut step_s = at.held_s / ((1u32 << HELD_STEPS) - 1) as f64;
            for _ in 0..HELD_STEPS {
                sine.push(begin_s, at.bias_a);
                begin_s += step_s;
                step_s *= 2.0;
            }
            // The current is interpolated: it stays until just before the sine.
            sine.push(begin_s - STEP_S, at.bias_a);
        }
        let step_s = (STEPS as f64 * at.freq_hz).recip();
        for k in 0..PERIODS * STEPS {
            let turn = TAU * (k % STEPS) as f64 / STEPS as f64;
            sine.push(
                begin_s + k as f64 * step_s,
                at.bias_a + amplitude_a * turn.cos(),
            );
        }
        sine
    }

    fn push(&mut self, time_s: f64, current_a: f64) {
        self.time_s.push(time_s);
        self.current_a.push(current_a);
    }

    /// Charge drawn from the start to the middle of the evaluated periods, C.
    fn charge_coulomb(&self) -> f64 {
        let middle = self.time_s.len() - SAMPLES / 2;
        let steps = self.time_s[..=middle]
            .windows(2)
            .zip(self.current_a.windows(2));
        steps
            .map(|(t, i)| 0.5 * (i[0] + i[1]) * (t[1] - t[0]))
            .sum()
    }
}

/// Voltage that a linear network drops under a current, V.
fn small_signal(network: &Network, sine: &Sine) -> Vec<f64> {
    let linear = Network::of(&network.linearised());
    let mut states_v = vec![0.0; linear.branches.len()];
    let factors = Ramp {
        start: 1.0,
        end: 1.0,
    };
    let drop =
        |states_v: &[f64], current_a: f64| linear.r_ohm * current_a + states_v.iter().sum::<f64>();
    let mut dropped_v = vec![drop(&states_v, sine.current_a[0])];
    for k in 1..sine.time_s.len() {
        let currents_a = Ramp {
            start: sine.current_a[k - 1],
            end: sine.current_a[k],
        };
        let step_s = sine.time_s[k] - sine.time_s[k - 1];
        linear.advance(&mut states_v, factors, currents_a, step_s);
        dropped_v.push(drop(&states_v, sine.current_a[k]));
    }
    dropped_v
}

/// The functions of the evaluated samples, the same for every sine.
static BASIS: LazyLock<Basis> = LazyLock::new(Basis::new);

/// A constant, sines and cosines of three orders, and a parabola over whole periods.
struct Basis {
    /// Constant, then cosine and sine of each order: orthogonal to each other.
    tones: [Vec<f64>; 7],
    /// A line and a square, and what is left of each beside the tones and the one before.
    parabola: [[Vec<f64>; 2]; 2],
}

impl Basis {
    fn new() -> Self {
        let turn = |k: usize, order: usize| TAU * ((k * order) % STEPS) as f64 / STEPS as f64;
        let sampled = |function: &dyn Fn(usize) -> f64| (0..SAMPLES).map(function).collect();
        let tones = std::array::from_fn(|j| match j {
            0 => sampled(&|_| 1.0),
            1 | 3 | 5 => sampled(&|k| turn(k, j.div_ceil(2)).cos()),
            _ => sampled(&|k| turn(k, j / 2).sin()),
        });
        let x = |k: usize| 2.0 * (k as f64 + 0.5) / SAMPLES as f64 - 1.0;
        let (line, square): (Vec<f64>, Vec<f64>) = (sampled(&x), sampled(&|k| x(k) * x(k)));
        let line_left = left_beside(&line, tones.iter());
        let square_left = left_beside(&square, tones.iter().chain([&line_left]));
        Self {
            tones,
            parabola: [[line, line_left], [square, square_left]],
        }
    }

    /// Returns the phasors of the second and third order, after the parabola is removed.
    fn phasors(&self, samples: &[f64]) -> [Complex64; 2] {
        let mut rest = samples.to_vec();
        for [function, left] in self.parabola.iter().rev() {
            let part = dot(&rest, left) / dot(left, function);
            rest.iter_mut()
                .zip(function)
                .for_each(|(r, f)| *r -= part * f);
        }
        [2, 3].map(|order| {
            let read = |j: usize| dot(&rest, &self.tones[j]) / dot(&self.tones[j], &self.tones[j]);
            // Re (V e^{jωt}) = Re V·cos − Im V·sin.
            Complex64::new(read(2 * order - 1), -read(2 * order))
        })
    }
}

/// Returns what is left of a function beside others that are orthogonal to each other.
fn left_beside<'a>(function: &[f64], others: impl Iterator<Item = &'a Vec<f64>>) -> Vec<f64> {
    let mut left = function.to_vec();
    for other in others {
        let part = dot(&left, other) / dot(other, other);
        left.iter_mut().zip(other).for_each(|(l, o)| *l -= part * o);
    }
    left
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
