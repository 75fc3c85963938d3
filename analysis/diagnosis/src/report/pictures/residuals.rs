//! Residuals of one run: over time with the current below, or over frequency.

use super::super::numbers::plain;
use super::{AFTER, ALONE, BEFORE, Kind, NOISE, Picture, effect_names, file_name, has_after};
use crate::outcome::{Curves, Diagnosis, RunCurves};
use analysis_plot::{AxisSpec, Chart, Drawing, Panel, Trace, TraceStyle};
use num_complex::Complex64;
use std::ops::RangeInclusive;

/// Most pieces a record is drawn in.
const PIECES: usize = 250;
/// Fraction of a record's pieces at either end of the axis that may lie beyond it: if an edge falls
/// between two samples, one of them can be off by the whole step of the voltage, and everything
/// else would be a flat line.
const BEYOND: f64 = 0.03;
/// Factor by which that must shorten the axis.
const SHORTER: f64 = 1.5;
/// Room beyond the lines, as a part of their range.
const ROOM: f64 = 0.25;

/// Returns the picture of a run, under a name valid for a file, or `None` if nothing can be drawn.
pub(super) fn picture(d: &Diagnosis, run: &RunCurves) -> Option<Picture> {
    let (kind, (panels, beyond_mv)) = match &run.curves {
        Curves::Time { .. } => (Kind::Time, time_panels(d, &run.curves)?),
        Curves::Eis { .. } => (Kind::Spectrum, (spectrum_panels(d, &run.curves)?, None)),
    };
    let role = if run.held_out { "held out" } else { "training" };
    let title = format!("{}, {role}: measured less predicted", run.name);
    let chart = Chart::new(&title, &subtitle(d, &run.curves), panels);
    let caption = match kind {
        Kind::Time => format!(
            "Voltage of {} ({role}), measured less predicted: lines are means over pieces of the \
            record, their pale areas reach from the lowest to the highest sample.{}",
            run.name,
            beyond_mv.map_or_else(String::new, |mv| format!(
                " Some pieces reach beyond the axis, up to {} mV.",
                plain(mv)
            ))
        ),
        _ => format!(
            "Impedance of {} ({role}), measured less predicted, with the band of the noise.",
            run.name
        ),
    };
    Some(Picture {
        name: file_name(&run.name),
        kind,
        caption,
        drawing: Drawing::Chart(chart),
    })
}

/// Error of the refitted base: V for records, a part of |Z| for spectra; zero for empty runs.
pub(super) fn miss(curves: &Curves) -> f64 {
    match curves {
        Curves::Time {
            measured_v, base_v, ..
        } => rms(measured_v.iter().zip(base_v).map(|(m, p)| m - p)),
        Curves::Eis {
            measured_ohm,
            base_ohm,
            ..
        } => rms(measured_ohm
            .iter()
            .zip(base_ohm)
            .map(|(m, p)| (m - p).norm() / m.norm())),
    }
}

fn subtitle(d: &Diagnosis, curves: &Curves) -> String {
    let (scale, unit) = if matches!(curves, Curves::Time { .. }) {
        (1e3, "mV")
    } else {
        (1e2, "% of |Z|")
    };
    let words = |label: &str, value: f64| format!("{label} {} {unit}", plain(scale * value));
    let (alone, augmented) = others(curves);
    let mut parts = vec![
        words("rms: spectra alone", alone),
        words("refit", miss(curves)),
    ];
    if has_after(d) {
        parts.push(words(&format!("with {}", effect_names(d)), augmented));
    }
    parts.join(", ")
}

/// As [`miss`] of the model file alone and of the augmented model.
fn others(curves: &Curves) -> (f64, f64) {
    match curves {
        Curves::Time {
            measured_v,
            eis_only_v,
            augmented_v,
            ..
        } => {
            let of = |p: &[f64]| rms(measured_v.iter().zip(p).map(|(m, p)| m - p));
            (of(eis_only_v), of(augmented_v))
        }
        Curves::Eis {
            measured_ohm,
            eis_only_ohm,
            augmented_ohm,
            ..
        } => {
            let of = |p: &[Complex64]| {
                rms(measured_ohm
                    .iter()
                    .zip(p)
                    .map(|(m, p)| (m - p).norm() / m.norm()))
            };
            (of(eis_only_ohm), of(augmented_ohm))
        }
    }
}

/// Returns the panels, and the extent of the lines if it exceeds the axis, mV.
fn time_panels(d: &Diagnosis, curves: &Curves) -> Option<(Vec<Panel>, Option<f64>)> {
    let Curves::Time {
        time_s,
        current_a,
        measured_v,
        eis_only_v,
        base_v,
        augmented_v,
        floor_v,
    } = curves
    else {
        return None;
    };
    let (factor, unit) = time_unit(time_s);
    let time: Vec<f64> = time_s.iter().map(|t| t / factor).collect();
    let residual = |predicted: &[f64]| -> Vec<f64> {
        measured_v
            .iter()
            .zip(predicted)
            .map(|(m, p)| 1e3 * (m - p))
            .collect()
    };
    let line = |label: &str, colour, values: &[f64]| thinned(label, colour, &time, values);
    let band: Vec<f64> = floor_v.iter().map(|s| 2e3 * s).collect();
    let step = band.len().div_ceil(PIECES).max(1);
    let kept = |v: &[f64]| -> Vec<f64> { v.iter().copied().step_by(step).collect() };
    let places: Vec<(f64, f64)> = kept(&time).into_iter().map(|t| (t, 0.0)).collect();
    let mut traces =
        vec![Trace::new(noise_words(d), NOISE, TraceStyle::Band, places).with_spread(kept(&band))];
    traces.extend(line("spectra alone", ALONE, &residual(eis_only_v)));
    traces.extend(line("refit", BEFORE, &residual(base_v)));
    if has_after(d) {
        traces.extend(line(
            &format!("with {}", effect_names(d)),
            AFTER,
            &residual(augmented_v),
        ));
    }
    let range = range(&traces);
    let y = AxisSpec::linear("Voltage residual / mV");
    let (y, beyond_mv) = match range {
        Some(ends) => (
            y.between(*ends.start(), *ends.end()),
            traces
                .iter_mut()
                .map(|trace| cut(trace, &ends))
                .fold(None, f64_max),
        ),
        None => (y, None),
    };
    let (first, last) = (time.first().copied()?, time.last().copied()?);
    let x = || {
        AxisSpec::linear(&format!("Time / {unit}"))
            .between(first, if last > first { last } else { first + 1.0 })
    };
    let current = steps(ALONE, &time, current_a);
    (current.iter().all(|t| !t.points.is_empty())
        && traces
            .iter()
            .any(|t| t.style == TraceStyle::Line && !t.points.is_empty()))
    .then(|| {
        let below = Panel {
            aspect: 0.18,
            ..Panel::new(x(), AxisSpec::linear("Discharge / A"), current)
        };
        (vec![Panel::new(x(), y, traces), below], beyond_mv)
    })
}

fn spectrum_panels(d: &Diagnosis, curves: &Curves) -> Option<Vec<Panel>> {
    let Curves::Eis {
        freq_hz,
        measured_ohm,
        eis_only_ohm,
        base_ohm,
        augmented_ohm,
        floor_ohm,
    } = curves
    else {
        return None;
    };
    let percent = |predicted: &[Complex64], part: fn(Complex64) -> f64| -> Vec<(f64, f64)> {
        let relative = measured_ohm
            .iter()
            .zip(predicted)
            .map(|(m, p)| 100.0 * part(m - p) / m.norm());
        freq_hz
            .iter()
            .copied()
            .zip(relative)
            .filter(|(f, v)| *f > 0.0 && f.is_finite() && v.is_finite())
            .collect()
    };
    let bands: Vec<(f64, f64)> = freq_hz
        .iter()
        .zip(measured_ohm.iter().zip(floor_ohm))
        .map(|(f, (m, s))| (*f, 200.0 * s / m.norm()))
        .collect();
    let bands: Vec<(f64, f64)> = bands
        .into_iter()
        .filter(|(f, s)| *f > 0.0 && f.is_finite() && s.is_finite())
        .collect();
    let panel = |part: fn(Complex64) -> f64, name: &str, first: bool| {
        let label = |text: &str| {
            if first {
                text.to_owned()
            } else {
                String::new()
            }
        };
        let band = Trace::new(
            &label(noise_words(d)),
            NOISE,
            TraceStyle::Band,
            bands.iter().map(|b| (b.0, 0.0)).collect(),
        );
        let mut traces = vec![band.with_spread(bands.iter().map(|b| b.1).collect())];
        traces.push(Trace::new(
            &label("spectra alone"),
            ALONE,
            TraceStyle::Dashed,
            percent(eis_only_ohm, part),
        ));
        let mut pair = |text: &str, colour, predicted: &[Complex64]| {
            traces.push(Trace::new(
                "",
                colour,
                TraceStyle::Line,
                percent(predicted, part),
            ));
            traces.push(Trace::new(
                &label(text),
                colour,
                TraceStyle::Points,
                percent(predicted, part),
            ));
        };
        pair("refit", BEFORE, base_ohm);
        if has_after(d) {
            pair(&format!("with {}", effect_names(d)), AFTER, augmented_ohm);
        }
        Panel {
            aspect: 0.3,
            ..Panel::new(
                AxisSpec::logarithmic("Frequency / Hz"),
                AxisSpec::linear(name),
                traces,
            )
        }
    };
    (!percent(base_ohm, |z| z.re).is_empty()).then(|| {
        vec![
            panel(|z| z.re, "Re residual / % of |Z|", true),
            panel(|z| z.im, "Im residual / % of |Z|", false),
        ]
    })
}

fn noise_words(d: &Diagnosis) -> &'static str {
    if d.noise.from_repeats {
        "±2σ noise and repeatability"
    } else {
        "±2σ noise as assumed"
    }
}

/// Seconds per unit of a time axis, and the unit's name.
fn time_unit(time_s: &[f64]) -> (f64, &'static str) {
    match time_s.last().copied().unwrap_or(0.0) {
        t if t > 36_000.0 => (3600.0, "h"),
        t if t > 1200.0 => (60.0, "min"),
        _ => (1.0, "s"),
    }
}

/// Returns a trace of the means over pieces, with the area between the lowest and highest sample of
/// each behind it, so that no spike is lost. Values that are not finite are left out.
fn thinned(label: &str, colour: usize, x: &[f64], y: &[f64]) -> Vec<Trace> {
    let points: Vec<(f64, f64)> = x
        .iter()
        .copied()
        .zip(y.iter().copied())
        .filter(|p| p.0.is_finite() && p.1.is_finite())
        .collect();
    if points.len() <= PIECES {
        return vec![Trace::new(label, colour, TraceStyle::Line, points)];
    }
    let pieces = || points.chunks(points.len().div_ceil(PIECES));
    let mean = |piece: &[(f64, f64)], of: fn(&(f64, f64)) -> f64| {
        piece.iter().map(of).sum::<f64>() / piece.len() as f64
    };
    let ends = |piece: &[(f64, f64)]| {
        piece
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| {
                (lo.min(p.1), hi.max(p.1))
            })
    };
    let middles = pieces()
        .map(|c| (mean(c, |p| p.0), (ends(c).0 + ends(c).1) / 2.0))
        .collect();
    let halves = pieces().map(|c| (ends(c).1 - ends(c).0) / 2.0).collect();
    let means = pieces()
        .map(|c| (mean(c, |p| p.0), mean(c, |p| p.1)))
        .collect();
    vec![
        Trace::new("", colour, TraceStyle::Band, middles).with_spread(halves),
        Trace::new(label, colour, TraceStyle::Line, means),
    ]
}

/// Returns ends of an axis that show all lines except their outermost pieces, and zero, or `None`
/// if all pieces need hardly more room.
fn range(traces: &[Trace]) -> Option<RangeInclusive<f64>> {
    let wider = |(lo, hi): (f64, f64), (a, b): (f64, f64)| (lo.min(a), hi.max(b));
    let most = |line: &Trace| {
        let mut values: Vec<f64> = line.points.iter().map(|p| p.1).collect();
        values.sort_by(f64::total_cmp);
        let beyond = (BEYOND * values.len() as f64) as usize;
        values
            .get(beyond)
            .copied()
            .zip(values.iter().nth_back(beyond).copied())
            .unwrap_or_default()
    };
    let (low, high) = traces
        .iter()
        .filter(|t| t.style == TraceStyle::Line)
        .map(most)
        .fold((0.0, 0.0), wider);
    let of_point = |t: &Trace, k: usize| {
        t.spread.get(k).map_or((t.points[k].1, t.points[k].1), |s| {
            (t.points[k].1 - s, t.points[k].1 + s)
        })
    };
    let (lowest, highest) = traces
        .iter()
        .flat_map(|t| (0..t.points.len()).map(move |k| of_point(t, k)))
        .fold((low, high), wider);
    let room = ROOM * (high - low);
    (high > low && highest - lowest > SHORTER * (high - low + 2.0 * room))
        .then_some(low - room..=high + room)
}

/// Cuts off the parts of a trace beyond an axis. Returns the extent of the line if it was cut.
fn cut(trace: &mut Trace, ends: &RangeInclusive<f64>) -> Option<f64> {
    let (low, high) = (*ends.start(), *ends.end());
    let (mut farthest, is_noise) = (
        None,
        trace.style == TraceStyle::Band && trace.label.is_some(),
    );
    for (k, point) in trace.points.iter_mut().enumerate() {
        let spread = trace.spread.get(k).copied().unwrap_or(0.0);
        let (from, to) = (point.1 - spread, point.1 + spread);
        if (from < low || to > high) && !is_noise {
            farthest = f64_max(farthest, Some(from.abs().max(to.abs())));
        }
        let (from, to) = (from.clamp(low, high), to.clamp(low, high));
        point.1 = 0.5 * (from + to);
        if let Some(spread) = trace.spread.get_mut(k) {
            *spread = 0.5 * (to - from);
        }
    }
    farthest
}

fn f64_max(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).reduce(f64::max)
}

/// Draws a current from the samples at which it changes, as corners; as [`thinned`] if it changes
/// all the time.
fn steps(colour: usize, time: &[f64], current_a: &[f64]) -> Vec<Trace> {
    let (low, high) = current_a
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), i| {
            (lo.min(*i), hi.max(*i))
        });
    let count = time.len().min(current_a.len());
    let changes = |k: usize| {
        k > 0 && k < count && (current_a[k] - current_a[k - 1]).abs() > 0.01 * (high - low)
    };
    let corners = (0..count).filter(|k| *k == 0 || k + 1 == count || changes(*k) || changes(k + 1));
    let (x, y): (Vec<f64>, Vec<f64>) = corners.map(|k| (time[k], current_a[k])).unzip();
    if x.len() <= PIECES {
        thinned("", colour, &x, &y)
    } else {
        thinned("", colour, time, current_a)
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values
        .filter(|v| v.is_finite())
        .fold((0.0, 0usize), |(sum, count), v| (sum + v * v, count + 1));
    if count == 0 {
        0.0
    } else {
        (sum / count as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 9 mV that decay, and one sample of 100 mV.
    #[test]
    fn a_spike_does_not_make_all_else_flat() {
        let points = |spike: f64| {
            (0..200)
                .map(|k| {
                    (
                        f64::from(k),
                        if k == 60 {
                            spike
                        } else {
                            9.0 * (-f64::from(k) / 50.0).exp()
                        },
                    )
                })
                .collect()
        };
        let line = |spike: f64| Trace::new("refit", BEFORE, TraceStyle::Line, points(spike));
        let band = Trace::new(
            "noise",
            NOISE,
            TraceStyle::Band,
            vec![(0.0, 0.0), (199.0, 0.0)],
        )
        .with_spread(vec![1.0, 300.0]);
        let ends = range(&[band.clone(), line(-100.0)]).unwrap();
        assert!(
            (9.0..12.0).contains(ends.end()) && (-3.0..0.0).contains(ends.start()),
            "{ends:?}"
        );
        let (mut band, mut spiked) = (band, line(-100.0));
        assert_eq!(
            (cut(&mut band, &ends), cut(&mut spiked, &ends)),
            (None, Some(100.0))
        );
        assert!(
            spiked.points.iter().all(|p| p.1 >= *ends.start())
                && spiked.points[59] == line(0.0).points[59]
        );
        assert!(
            (band.points[1].1 + band.spread[1] - ends.end()).abs() < 1e-12 && band.spread[0] == 1.0
        );
        assert_eq!(range(&[line(-3.0)]), None, "it fits");
    }

    #[test]
    fn a_spike_survives_the_thinning() {
        let x: Vec<f64> = (0..100_000).map(f64::from).collect();
        let mut y = vec![0.0; x.len()];
        (y[51_234], y[7]) = (-5.0, f64::NAN);
        let traces = thinned("line", 0, &x, &y);
        let least = traces[0]
            .points
            .iter()
            .zip(&traces[0].spread)
            .map(|(p, s)| p.1 - s)
            .fold(0.0, f64::min);
        assert_eq!((traces.len(), least), (2, -5.0));
        assert!(
            traces
                .iter()
                .all(|t| t.points.len() <= PIECES && t.points.windows(2).all(|w| w[0].0 < w[1].0))
        );
        assert_eq!(traces[1].label.as_deref(), Some("line"));
    }
}
