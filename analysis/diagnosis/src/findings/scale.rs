//! A factor between the model's voltage and the records': a spectrum or a model of another cell, or
//! a current channel with another gain.

use num_complex::Complex64;

use super::finding::{Finding, FindingKind};
use super::scene::{Played, Scene};
use crate::data::Fixture;
use crate::thresholds::{
    LARGE_STEP_PART, SCALE_FEWEST, SCALE_LEAST, SCALE_SAME_CURRENT, SCALE_SIGMAS,
    SCALE_SPECTRUM_NEAR, SCALE_VARIES, SCALE_WINDOW_S, VISIBLE_STEP_SIGMAS,
};

/// The factor of one edge, and the weight of it.
#[derive(Debug, Clone, Copy)]
struct Factor {
    value: f64,
    weight: f64,
    /// Size of the current beside the edge, the larger one, A.
    current_a: f64,
}

/// The factor of all edges up to about one current.
#[derive(Debug, Clone, Copy)]
struct OfCurrent {
    current_a: f64,
    mean: f64,
    sigma: f64,
}

pub(super) fn find(scene: &Scene<'_>) -> Vec<Finding> {
    let mut runs = Vec::new();
    let mut factors = Vec::new();
    for played in scene.of_cells().filter(|played| !played.is_held_out()) {
        let of_run = factors_of(scene, &played);
        if !of_run.is_empty() {
            runs.push(played.run.name.clone());
            factors.extend(of_run);
        }
    }
    if factors.len() < SCALE_FEWEST {
        return Vec::new();
    }
    let weight: f64 = factors.iter().map(|f| f.weight).sum();
    let mean = factors.iter().map(|f| f.weight * f.value).sum::<f64>() / weight;
    let scatter = (factors
        .iter()
        .map(|f| f.weight * (f.value - mean).powi(2))
        .sum::<f64>()
        / weight)
        .sqrt();
    // Edges of one run share its errors: as many factors as runs.
    let spread = scene.at.set.history.map_or(0.0, |h| h.resistance_rel);
    let sigma = (scatter / (runs.len() as f64).sqrt()).hypot(spread * mean);
    let far = mean <= 0.0 || mean.ln().abs() > SCALE_LEAST.ln();
    if !(far && (mean - 1.0).abs() > SCALE_SIGMAS * sigma) {
        return Vec::new();
    }
    let spectra = of_spectra(scene);
    let edges = factors.len();
    let varies = variation(factors);
    let meaning = match spectra {
        _ if varies.is_some() => varies.clone().unwrap_or_default(),
        Some(factor) if factor.ln().abs() < SCALE_SPECTRUM_NEAR => format!(
            "the model meets the spectra of the set at a factor of {factor:.3}, so that spectra \
            and records do not belong to one cell in one state, or the current of the records has \
            another gain"
        ),
        Some(factor) => format!(
            "the model meets the spectra of the set at a factor of {factor:.3}: it is a model of \
            another cell, state or temperature"
        ),
        None => {
            "the set has no spectrum that shows whether the model or the records are off".to_owned()
        }
    };
    vec![Finding {
        kind: FindingKind::Scale,
        text: format!(
            "the voltage answers a step of the current {mean:.3} ± {sigma:.3} times as strongly \
            as the model, over {} edges of {} records; {meaning}",
            edges,
            runs.len()
        ),
        how_sure: format!("{:.0} σ from 1", (mean - 1.0).abs() / sigma),
        effect: if varies.is_some() {
            "No single gain and no single temperature makes this; an effect of the current must \
            explain it."
        } else {
            "A fit gives the factor to resistances or to an effect that scales them. Check cell, \
            temperature and state of charge of spectrum and records before any name is accepted."
        }
        .to_owned(),
        runs,
        correctable: false,
    }]
}

/// Returns how the factor changes with the current, or `None` if one factor serves all currents.
fn variation(factors: Vec<Factor>) -> Option<String> {
    let each = by_current(factors);
    let [first, .., last] = each.as_slice() else {
        return None;
    };
    let sigma = first.sigma.hypot(last.sigma);
    let change = last.mean / first.mean;
    if change.is_nan() || change.ln().abs() < SCALE_VARIES.ln() {
        return None;
    }
    if (last.mean - first.mean).abs() < SCALE_SIGMAS * sigma {
        return None;
    }
    let (verb, cause) = if change < 1.0 {
        (
            "falls",
            "charge transfer or self-heating lowers the resistance under current",
        )
    } else {
        (
            "rises",
            "something limits the current, as a depleted electrolyte does",
        )
    };
    Some(format!(
        "it {verb} from {:.2} at {:.3} A to {:.2} at {:.3} A: {cause}; a gain is the same at every \
        current",
        first.mean, first.current_a, last.mean, last.current_a
    ))
}

/// Returns the factors by current, the smallest first.
fn by_current(mut factors: Vec<Factor>) -> Vec<OfCurrent> {
    factors.sort_by(|a, b| a.current_a.total_cmp(&b.current_a));
    factors
        .chunk_by(|a, b| b.current_a < SCALE_SAME_CURRENT * a.current_a)
        .filter(|group| group.len() >= SCALE_FEWEST)
        .map(|group| {
            let weight: f64 = group.iter().map(|f| f.weight).sum();
            let mean = group.iter().map(|f| f.weight * f.value).sum::<f64>() / weight;
            let squares = group.iter().map(|f| f.weight * (f.value - mean).powi(2));
            OfCurrent {
                current_a: group.iter().map(|f| f.current_a).sum::<f64>() / group.len() as f64,
                mean,
                sigma: (squares.sum::<f64>() / weight / group.len() as f64).sqrt(),
            }
        })
        .collect()
}

/// Factors at the large edges of a record: the change since the sample before the edge, over the
/// time in which the curve has not moved.
fn factors_of(scene: &Scene<'_>, played: &Played<'_>) -> Vec<Factor> {
    let series = &played.record.series;
    let step = |k: usize| (series.current_a[k] - series.current_a[k - 1]).abs();
    let from = played.first_compared().max(1);
    let largest_a = (from..series.len()).map(step).fold(0.0, f64::max);
    if largest_a <= 0.0 {
        return Vec::new();
    }
    let is_edge = |k: &usize| step(*k) > LARGE_STEP_PART * largest_a;
    let edges: Vec<usize> = (from..series.len()).filter(is_edge).collect();
    let noise_v = scene.at.sample_noise_v(played.record);
    let ends = edges.iter().skip(1).copied().chain([series.len()]);
    edges
        .iter()
        .zip(ends)
        .filter_map(|(edge, end)| {
            let before = edge - 1;
            let until_s = series.time_s[*edge] + SCALE_WINDOW_S;
            let (mut along, mut size) = (0.0, 0.0);
            // The first sample may be read while the current still changes.
            for k in (edge + 1)..end {
                if series.time_s[k] > until_s {
                    break;
                }
                let measured_v = series.voltage_v[k] - series.voltage_v[before];
                let expected_v = played.expected_v[k] - played.expected_v[before];
                along += measured_v * expected_v;
                size += expected_v * expected_v;
            }
            let visible = size > (VISIBLE_STEP_SIGMAS * noise_v).powi(2);
            visible.then(|| Factor {
                value: along / size,
                weight: size,
                current_a: series.current_a[before]
                    .abs()
                    .max(series.current_a[*edge].abs()),
            })
        })
        .collect()
}

/// Returns the factor of the spectra to the model's, by the sizes.
fn of_spectra(scene: &Scene<'_>) -> Option<f64> {
    let (mut along, mut size) = (0.0, 0.0);
    for subject in &scene.at.runs {
        if let (Fixture::Cell(_), Some((sweep, expected))) = (&subject.run.fixture, subject.sweep())
        {
            for (point, z) in sweep.points.iter().zip(expected) {
                along += (point.z_ohm * Complex64::conj(z)).re;
                size += z.norm_sqr();
            }
        }
    }
    (size > 0.0 && along > 0.0).then(|| along / size)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factors(each: &[(f64, f64)]) -> Vec<Factor> {
        let around = [-0.01, 0.0, 0.0, 0.01];
        let of = |(current_a, value): &(f64, f64)| {
            around.map(|off| Factor {
                value: value + off,
                weight: *current_a,
                current_a: current_a * (1.0 + 0.1 * off),
            })
        };
        each.iter().flat_map(of).collect()
    }

    #[test]
    fn a_factor_that_changes_with_the_current_is_not_a_gain() {
        let text = variation(factors(&[(10.0, 0.71), (1.0, 1.02), (4.0, 0.9)])).unwrap();
        assert!(
            text.starts_with("it falls from 1.02 at 1.000 A to 0.71 at 10.000 A: charge transfer"),
            "{text}"
        );
        let text = variation(factors(&[(1.0, 1.02), (10.0, 1.4)])).unwrap();
        assert!(text.starts_with("it rises from 1.02"), "{text}");
        assert_eq!(variation(factors(&[(1.0, 0.7), (10.0, 0.71)])), None);
        assert_eq!(variation(factors(&[(10.0, 0.5)])), None);
    }
}
