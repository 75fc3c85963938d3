//! |Z| and phase over the logarithm of the frequency.

use super::axis::Axis;
use super::frame::{BOTTOM, Frame, LEFT, RIGHT, heading};
use super::marks::{bar, draw};
use super::nyquist::unit;
use super::scene::{Place, Scene, Shape};
use super::{ImpedancePlot, PlotError, Series, SeriesPoint};
use num_complex::Complex64;

const GAP: f64 = 18.0;
/// Height of each panel over the width.
const ASPECT: f64 = 0.3;

pub(super) fn layout(plot: &ImpedancePlot) -> Result<Scene, PlotError> {
    let width = f64::from(plot.width_px.clamp(320, 4000));
    let unit = unit(plot);
    let (mut shapes, top) = heading(plot, width)?;
    let inner = width - LEFT - RIGHT;
    let height = (inner * ASPECT).round();
    let magnitude = |z: Complex64| z.norm() * unit.per_ohm;
    let phase = |z: Complex64| z.arg().to_degrees();
    let x = frequencies(plot);
    let upper = Frame {
        left: LEFT,
        top,
        width: inner,
        height,
        x: x.clone(),
        y: vertical(plot, magnitude),
    };
    let lower = Frame {
        top: top + height + GAP,
        x,
        y: vertical(plot, phase),
        left: LEFT,
        width: inner,
        height,
    };
    shapes.extend(upper.shapes("", &format!("|Z| / {}", unit.name)));
    shapes.extend(lower.shapes("Frequency / Hz", "Phase / °"));
    for series in &plot.series {
        shapes.extend(panel(&upper, series, magnitude, |p| {
            2.0 * unit.per_ohm * sigma(p, p.z_ohm / p.z_ohm.norm())
        }));
        let across = |p: &SeriesPoint| Complex64::I * p.z_ohm / p.z_ohm.norm();
        shapes.extend(panel(&lower, series, phase, |p| {
            (2.0 * sigma(p, across(p)) / p.z_ohm.norm()).to_degrees()
        }));
    }
    Ok(Scene {
        title: plot.title.clone(),
        width,
        height: lower.top + height + BOTTOM,
        shapes,
    })
}

/// One series in one panel; `spread` is the half length of its bars in the panel's unit.
fn panel(
    frame: &Frame,
    series: &Series,
    value: impl Fn(Complex64) -> f64,
    spread: impl Fn(&SeriesPoint) -> f64,
) -> Vec<Shape> {
    let place =
        |p: &SeriesPoint, shift: f64| frame.place(p.freq_hz.log10(), value(p.z_ohm) + shift);
    let places: Vec<Place> = series.points.iter().map(|p| place(p, 0.0)).collect();
    let bars = series.points.iter().flat_map(|p| {
        let half = spread(p);
        // Inside the frame only: one wild bar must not draw over the title.
        let inside = |y: f64| y.clamp(frame.top, frame.top + frame.height);
        bar(
            series,
            place(p, 0.0).0,
            [inside(place(p, half).1), inside(place(p, -half).1)],
        )
    });
    bars.chain(draw(series, &places)).collect()
}

/// Returns the standard uncertainty of the impedance along a unit vector, Ω.
fn sigma(p: &SeriesPoint, along: Complex64) -> f64 {
    let c = &p.covariance;
    (c.re_re * along.re * along.re
        + 2.0 * c.re_im * along.re * along.im
        + c.im_im * along.im * along.im)
        .sqrt()
}

fn frequencies(plot: &ImpedancePlot) -> Axis {
    let all = plot
        .series
        .iter()
        .flat_map(|s| &s.points)
        .map(|p| p.freq_hz);
    let (lo, hi) = all.fold((f64::INFINITY, 0.0f64), |(lo, hi), f| {
        (lo.min(f), hi.max(f))
    });
    Axis::decades(lo, hi)
}

fn vertical(plot: &ImpedancePlot, value: impl Fn(Complex64) -> f64) -> Axis {
    let all = plot
        .series
        .iter()
        .flat_map(|s| &s.points)
        .map(|p| value(p.z_ohm));
    let (lo, hi) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| {
        (lo.min(v), hi.max(v))
    });
    let pad = 0.08 * (hi - lo).max(0.02 * hi.abs().max(lo.abs())).max(1e-6);
    Axis::linear(lo - pad, hi + pad, 9.0)
}
