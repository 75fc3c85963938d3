//! Multisine: odd harmonics at once, some of which are omitted to show distortion, with phases of
//! a low crest factor; one record per band.

use std::sync::Arc;

use analysis_signal::multisine::{Choice, Path, Placement, Sampling, design, odd_grid, place};
use instruments::{
    fixture::Fixture,
    units::{Amps, Ohms, Seconds, Volts},
};

use crate::{
    config::{Band as Wanted, Multisine},
    interlock::Limits,
    plan::{Band, Depth, Purpose, Stage, Step},
};

use super::{biased, power::Power};

/// Distance of the compliance above the cell's limit: a least value, V, and the resistance of the
/// loop, Ω.
const COMPLIANCE: (Volts, Ohms) = (Volts(0.3), Ohms(0.1));
/// Factor and margin, A, of the current limit above the peak.
const LIMIT: (f64, Amps) = (1.1, Amps(0.5));

/// Largest error of the impedance at a line due to an image, Ω. It is half the standard deviation
/// that the noise of the demo's records has there (6 µΩ), so that the sum is an eighth larger. The
/// remaining error is measured in the record, and is part of its uncertainty.
const TOLERATED_OHM: f64 = 3.0e-6;
/// A loop of two metres of wire, a microhenry each.
const LOOP_H: f64 = 2.0e-6;
/// Assumed delay between the probes.
const SKEW_S: f64 = 150.0e-9;
/// Assumed pickup of two untwisted probe leads.
const PICKUP_H: f64 = 100.0e-9;
/// Ratio of the corner of a supply's response to the frequency that it follows within a seventh.
const CORNER: f64 = 2.0;
/// Greatest factor by which a record may exceed the requested points to avoid images.
const MORE_POINTS: f64 = 2.5;
/// Least depth of a scope's memory.
const LEAST_DEPTH: f64 = 1.0e4;

/// Returns rates and lines of a band at which no image of the generator's steps falls onto a line
/// beyond the noise, or those with the least disturbance.
fn placed(multisine: &Multisine, band: &Wanted) -> Placement {
    let (start_hz, stop_hz) = band.range_hz;
    let harmonics = odd_grid(
        band.base_hz.value(),
        start_hz.value()..=stop_hz.value(),
        band.lines,
    );
    let periods = ((band.span_s * band.base_hz).round() as usize).max(1);
    let steps: Vec<usize> = std::iter::successors(Some(band.steps.0), |steps| Some(2 * steps))
        .take_while(|s| *s <= band.steps.1)
        .collect();
    let depth = Depth {
        memory_points: multisine.memory_points,
        record_points: multisine.record_points,
    };
    let samples = record_sizes(depth, periods);
    let range = (
        (start_hz / band.base_hz).round() as usize,
        (stop_hz / band.base_hz * (1.0 + 1.0e-9)).floor() as usize,
    );
    let path = Path {
        corner_hz: CORNER * band.followed_hz.value(),
        loop_h: LOOP_H,
        skew_s: SKEW_S,
        pickup_h: PICKUP_H,
    };
    let choice = Choice {
        steps: &steps,
        samples: &samples,
        periods,
        range,
        base_hz: band.base_hz.value(),
        path,
        tolerated_ohm: TOLERATED_OHM,
    };
    let as_asked = Sampling {
        steps: band.steps.0,
        periods,
        samples: multisine.record_points as usize,
    };
    place(&harmonics, &choice).unwrap_or(Placement {
        harmonics,
        sampling: as_asked,
        worst: None,
    })
}

/// Returns the possible sizes of a record: every n-th point of the memory, whole numbers of them
/// in a period, at least as many as requested and not too many more. The depths of the scopes'
/// memories are decades.
fn record_sizes(wanted: Depth, periods: usize) -> Vec<usize> {
    let Depth {
        memory_points,
        record_points,
    } = wanted;
    let depth = 10.0_f64
        .powf((memory_points as f64).max(LEAST_DEPTH).log10().ceil())
        .round() as usize;
    let asked = record_points as usize;
    let most = (MORE_POINTS * record_points as f64) as usize;
    let of = |stride: usize| {
        depth
            .is_multiple_of(stride * periods)
            .then_some(depth / stride)
    };
    let mut found: Vec<usize> = (1..=depth / asked.max(1))
        .filter_map(of)
        .filter(|size| (asked..=most).contains(size))
        .collect();
    if found.is_empty() {
        found.push(asked);
    }
    found.sort_unstable();
    found
}

/// One stage.
pub(super) struct Asked<'a> {
    pub(super) multisine: &'a Multisine,
    /// Its number among the stages, from 1.
    pub(super) repeat: usize,
    /// Direct current under it, A.
    pub(super) bias_a: Amps,
    /// Seed of the phases.
    pub(super) seed: u64,
}

pub(super) fn stage(asked: &Asked<'_>, limits: &Limits, power: Power) -> Stage {
    let Asked {
        multisine,
        repeat,
        bias_a,
        seed,
    } = *asked;
    let bias = multisine.bias.as_ref().filter(|_| bias_a != Amps::ZERO);
    let bias = bias.map(|bias| bias.plan(bias_a, multisine.peak_a));
    let peak_a = bias_a.abs() + multisine.peak_a;
    let mut steps = vec![Step::Mount(Fixture::Cell)];
    if multisine.rest_s > Seconds::ZERO {
        steps.push(Step::Pause {
            span_s: multisine.rest_s,
        });
    }
    steps.extend(bias.map(Step::BiasZero));
    let compliance_v = limits.max_v + (COMPLIANCE.1 * peak_a).max(COMPLIANCE.0);
    steps.push(power.up(compliance_v, LIMIT.0 * peak_a + LIMIT.1));
    let bands = bands(multisine, seed);
    // Every band has a number of its own, after which its captures are named.
    let round = |round: usize| {
        let numbered = |band: &Band| {
            Step::Multisine(Arc::new(Band {
                number: round * bands.len() + band.number,
                ..band.clone()
            }))
        };
        bands.iter().map(numbered).collect::<Vec<Step>>()
    };
    match &bias {
        None => steps.extend(round(0)),
        Some(bias) if multisine.operando => steps.extend(biased::along(round, bias)),
        Some(bias) => steps.extend(biased::in_groups(round(0), bias)),
    }
    if let Some(quality) = multisine.quality.filter(|quality| quality.again > 0) {
        steps.push(Step::Recheck(quality));
    }
    steps.push(Step::PowerDown);
    Stage {
        purpose: Purpose::Multisine(repeat),
        steps,
    }
}

/// Returns the bands with rates and lines.
fn bands(multisine: &Multisine, seed: u64) -> Vec<Band> {
    let of = |(number, band): (usize, &Wanted)| {
        let Placement {
            harmonics,
            sampling,
            worst,
        } = placed(multisine, band);
        let (start_hz, stop_hz) = band.range_hz;
        let wanted = odd_grid(
            band.base_hz.value(),
            start_hz.value()..=stop_hz.value(),
            band.lines,
        );
        let moved = wanted
            .iter()
            .copied()
            .zip(harmonics.iter().copied())
            .filter(|(from, to)| from != to)
            .collect();
        Band {
            number,
            base_hz: band.base_hz,
            design: design(&harmonics, seed.wrapping_add(number as u64)),
            steps: sampling.steps,
            peak_a: multisine.peak_a,
            settle_s: band.settle_s,
            span_s: band.span_s,
            memory_points: multisine.memory_points,
            record_points: sampling.samples as u64,
            moved,
            disturbed: worst,
            quality: multisine.quality,
        }
    };
    (1..).zip(&multisine.bands).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments::units::Hertz;

    fn multisine(record_points: u64, lines: usize) -> Multisine {
        let band = Wanted {
            base_hz: Hertz(5.0),
            range_hz: (Hertz(15.0), Hertz(300.0)),
            lines,
            span_s: Seconds(2.0),
            settle_s: Seconds(5.0),
            steps: (4096, 16_384),
            followed_hz: Hertz(3000.0),
        };
        let (memory_points, quality) = (1_000_000, None);
        Multisine {
            peak_a: Amps(2.0),
            repeat: 1,
            rest_s: Seconds(0.0),
            bands: vec![band],
            memory_points,
            record_points,
            quality,
            bias: None,
            operando: false,
        }
    }

    fn of(multisine: &Multisine) -> Placement {
        placed(multisine, &multisine.bands[0])
    }

    #[test]
    fn rates_change_where_lines_can_stay() {
        let found = of(&multisine(100_000, 8));
        assert_eq!(found.harmonics, [3, 5, 9, 11, 17, 25, 39, 59]);
        assert!(
            found.sampling.steps > 4096 || found.sampling.samples > 100_000,
            "{found:?}"
        );
        assert!(
            found
                .worst
                .is_none_or(|worst| worst.error_ohm <= TOLERATED_OHM),
            "{found:?}"
        );
    }

    #[test]
    fn lines_move_where_the_rates_cannot_change() {
        let mut rigid = multisine(200_000, 8);
        rigid.bands[0].steps = (4096, 4096);
        let found = of(&rigid);
        assert_ne!(found.harmonics, [3, 5, 9, 11, 17, 25, 39, 59]);
        assert_eq!(found.harmonics.len(), 8);
        // Twenty lines do not fit: the message contains the image and its line.
        rigid.bands[0].lines = 20;
        let crowded = of(&rigid);
        assert!(
            crowded
                .worst
                .is_some_and(|worst| worst.error_ohm > TOLERATED_OHM),
            "{crowded:?}"
        );
    }

    #[test]
    fn records_are_whole_periods_of_the_memory() {
        let sizes = |memory_points, record_points, periods| {
            let depth = Depth {
                memory_points,
                record_points,
            };
            record_sizes(depth, periods)
        };
        assert_eq!(
            sizes(1_000_000, 100_000, 10),
            [100_000, 125_000, 200_000, 250_000]
        );
        assert_eq!(
            sizes(300_000, 100_000, 10),
            [100_000, 125_000, 200_000, 250_000]
        );
        assert_eq!(sizes(1_000_000, 1_000_000, 7), [1_000_000]);
    }
}
