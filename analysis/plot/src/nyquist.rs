//! −Im Z against Re Z with equal scaling.

use super::axis::{Axis, round_step};
use super::backend::text_width;
use super::frame::{BOTTOM, Frame, LEFT, RIGHT, Room, TEXT, heading, text_shape};
use super::marks::{INK, draw, ellipse};
use super::scene::{Anchor, Place, Scene, Shape};
use super::{ImpedancePlot, PlotError, Series, SeriesStyle};
use num_complex::Complex64;

/// Unit of the impedance axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unit {
    pub(super) name: &'static str,
    pub(super) per_ohm: f64,
}

/// Chooses mΩ for cells, Ω for larger values.
pub(super) fn unit(plot: &ImpedancePlot) -> Unit {
    let largest = plot
        .series
        .iter()
        .flat_map(|s| &s.points)
        .fold(0.0f64, |m, p| m.max(p.z_ohm.norm()));
    if largest < 1.0 {
        Unit {
            name: "mΩ",
            per_ohm: 1e3,
        }
    } else {
        Unit {
            name: "Ω",
            per_ohm: 1.0,
        }
    }
}

pub(super) fn layout(plot: &ImpedancePlot) -> Result<Scene, PlotError> {
    let width = f64::from(plot.width_px.clamp(320, 4000));
    let unit = unit(plot);
    let (mut shapes, top) = heading(plot, width)?;
    let room = Room {
        top,
        width: width - LEFT - RIGHT,
    };
    let frame = frame(plot, unit, room);
    shapes.extend(frame.shapes(
        &format!("Re Z / {}", unit.name),
        &format!("−Im Z / {}", unit.name),
    ));
    let place = |z: Complex64| frame.place(z.re * unit.per_ohm, -z.im * unit.per_ohm);
    let px_per_ohm = frame.width / (frame.x.hi - frame.x.lo) * unit.per_ohm;
    let mut ellipses = Vec::new();
    for series in &plot.series {
        let places: Vec<Place> = series.points.iter().map(|p| place(p.z_ohm)).collect();
        ellipses.extend(
            series
                .points
                .iter()
                .zip(&places)
                .filter_map(|(p, at)| ellipse(series, *at, &p.covariance, px_per_ohm)),
        );
        shapes.extend(draw(series, &places));
    }
    if plot.mark_decades {
        let taken = ellipses.iter().flat_map(|e| {
            if let Shape::Line { points, .. } = e {
                points.as_slice()
            } else {
                &[]
            }
        });
        let notes = decades(plot, &frame, place, taken.copied().collect())?;
        shapes.extend(notes);
    }
    shapes.extend(ellipses);
    Ok(Scene {
        title: plot.title.clone(),
        width,
        height: top + frame.height + BOTTOM,
        shapes,
    })
}

/// Returns the frame whose pixels are as many units wide as high; its height follows the data
/// within limits.
fn frame(plot: &ImpedancePlot, unit: Unit, room: Room) -> Frame {
    let Room { top, width } = room;
    let (mut x, mut y) = (
        (f64::INFINITY, f64::NEG_INFINITY),
        (f64::INFINITY, f64::NEG_INFINITY),
    );
    let widen = |r: &mut (f64, f64), v: f64| *r = (r.0.min(v), r.1.max(v));
    for p in plot.series.iter().flat_map(|s| &s.points) {
        widen(&mut x, p.z_ohm.re * unit.per_ohm);
        widen(&mut y, -p.z_ohm.im * unit.per_ohm);
    }
    let size = (x.1.abs().max(y.1.abs())).max(f64::MIN_POSITIVE);
    // A resistor's cloud is drawn no larger than a twentieth of its value: noise must not look like
    // a spectrum.
    let (x_span, y_span) = (
        (x.1 - x.0).max(0.05 * size) * 1.12,
        (y.1 - y.0).max(0.02 * size) * 1.25,
    );
    let height = (width * y_span / x_span)
        .clamp(0.34 * width, 0.9 * width)
        .round();
    let per_px = (x_span / width).max(y_span / height);
    let step = round_step(per_px * width / 9.0);
    let centred = |(lo, hi): (f64, f64), px: f64| {
        let middle = (lo + hi) / 2.0;
        Axis::stepped(middle - per_px * px / 2.0, middle + per_px * px / 2.0, step)
    };
    Frame {
        left: LEFT,
        top,
        width,
        height,
        x: centred(x, width),
        y: centred(y, height),
    }
}

/// Writes the frequency beside the point of each whole decade: of the last curve, or of the first
/// points without a curve.
fn decades(
    plot: &ImpedancePlot,
    frame: &Frame,
    place: impl Fn(Complex64) -> Place,
    mut taken: Vec<Place>,
) -> Result<Vec<Shape>, PlotError> {
    let curve = plot
        .series
        .iter()
        .rfind(|s| s.style == SeriesStyle::Curve && s.points.len() > 1);
    let Some(series) = curve.or_else(|| plot.series.iter().find(|s| s.points.len() > 2)) else {
        return Ok(Vec::new());
    };
    let all = plot.series.iter().flat_map(|s| &s.points);
    taken.extend(all.map(|p| place(p.z_ohm)));
    let mut shapes = Vec::new();
    for decade in -6..=7 {
        let Some(at) = nearest(series, 10f64.powi(decade)).map(|i| place(series.points[i].z_ohm))
        else {
            continue;
        };
        let text = format!("{} Hz", super::axis::power_of_ten(decade));
        let size = Size {
            width: text_width(&text, TEXT - 2.0)?,
            height: TEXT - 2.0,
        };
        let Some(note) = Note::free(at, size, frame, &taken) else {
            continue;
        };
        taken.extend(note.outline());
        shapes.extend(note.shapes(&text));
    }
    Ok(shapes)
}

/// The size of a text, logical pixels.
#[derive(Debug, Clone, Copy)]
struct Size {
    width: f64,
    height: f64,
}

/// End of a leader, seen from its point.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// Length, logical pixels.
    length: f64,
    /// Direction, counted from the right upwards.
    angle_rad: f64,
}

/// A text beside a point with a leader to it.
struct Note {
    /// Ends of the leader: at the point, at the text.
    leader: (Place, Place),
    /// Middle of the text.
    middle: Place,
    size: Size,
}

impl Note {
    /// Returns the first position around a point, near before far and above before below, that
    /// covers nothing, or `None` if all do.
    fn free(at: Place, size: Size, frame: &Frame, taken: &[Place]) -> Option<Self> {
        const DIRECTIONS: [f64; 10] = [
            90.0, 120.0, 60.0, 150.0, 30.0, 180.0, 0.0, -90.0, -60.0, -120.0,
        ];
        let candidates = [24.0, 44.0, 70.0, 100.0].into_iter().flat_map(|length| {
            DIRECTIONS.map(|d| Reach {
                length,
                angle_rad: f64::to_radians(d),
            })
        });
        candidates
            .map(|reach| Self::towards(at, size, reach))
            .find(|n| n.inside(frame) && !n.covers(taken))
    }

    fn towards(at: Place, size: Size, reach: Reach) -> Self {
        let (ux, uy) = (reach.angle_rad.cos(), -reach.angle_rad.sin());
        let end = (at.0 + reach.length * ux, at.1 + reach.length * uy);
        let middle = (
            end.0 + ux * (size.width / 2.0 + 4.0),
            end.1 + uy * (size.height / 2.0 + 3.0),
        );
        Self {
            leader: ((at.0 + 7.0 * ux, at.1 + 7.0 * uy), end),
            middle,
            size,
        }
    }

    fn inside(&self, frame: &Frame) -> bool {
        let (half_w, half_h) = (self.size.width / 2.0 + 4.0, self.size.height / 2.0 + 4.0);
        self.middle.0 - half_w > frame.left
            && self.middle.0 + half_w < frame.left + frame.width
            && self.middle.1 - half_h > frame.top
            && self.middle.1 + half_h < frame.top + frame.height
    }

    fn covers(&self, taken: &[Place]) -> bool {
        let (half_w, half_h) = (self.size.width / 2.0 + 7.0, self.size.height / 2.0 + 6.0);
        taken
            .iter()
            .any(|p| (p.0 - self.middle.0).abs() < half_w && (p.1 - self.middle.1).abs() < half_h)
    }

    /// Returns points that represent the text's area, close enough that another text cannot fit
    /// between them.
    fn outline(&self) -> Vec<Place> {
        (-2..=2)
            .map(|k| {
                (
                    self.middle.0 + f64::from(k) / 4.0 * self.size.width,
                    self.middle.1,
                )
            })
            .collect()
    }

    fn shapes(&self, text: &str) -> [Shape; 2] {
        let leader = Shape::Line {
            points: vec![self.leader.0, self.leader.1],
            colour: INK,
            width: 1.0,
        };
        [
            leader,
            text_shape(text, self.middle, TEXT - 2.0, Anchor::Centre),
        ]
    }
}

/// Returns the index of the point within a few per cent of a frequency.
fn nearest(series: &Series, freq_hz: f64) -> Option<usize> {
    let distance = |i: &usize| (series.points[*i].freq_hz / freq_hz).ln().abs();
    (0..series.points.len())
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|i| distance(i) < 0.12)
}
