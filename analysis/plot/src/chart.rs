//! Charts of anything over anything: one or more panels below each other, lines, points with bars,
//! bands; linear or logarithmic axes.

use super::PlotError;
use super::axis::Axis;
use super::frame::{BOTTOM, Entry, Frame, LEFT, RIGHT, Room, Titles, strip};
use super::marks::{palette, symbol, thinned};
use super::scene::{Place, Scene, Shape};
use std::path::Path;

const GAP: f64 = 18.0;
const TICKS: f64 = 8.0;

/// An axis: its name with the unit, its scale, and its range if it is not to follow the data.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisSpec {
    /// Name with unit, as "Time / s".
    pub name: String,
    /// Logarithmic, over whole decades.
    pub logarithmic: bool,
    /// Fixed lower and upper end, in the unit of the axis.
    pub range: Option<(f64, f64)>,
}

impl AxisSpec {
    /// Returns a linear axis that follows the data.
    pub fn linear(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            logarithmic: false,
            range: None,
        }
    }

    /// Returns a logarithmic axis that follows the data.
    pub fn logarithmic(name: &str) -> Self {
        Self {
            logarithmic: true,
            ..Self::linear(name)
        }
    }

    /// Returns the same with fixed ends.
    #[must_use]
    pub fn between(self, lo: f64, hi: f64) -> Self {
        Self {
            range: Some((lo, hi)),
            ..self
        }
    }

    pub(super) fn coordinate(&self, value: f64) -> f64 {
        if self.logarithmic {
            value.log10()
        } else {
            value
        }
    }

    fn axis(&self, values: impl Iterator<Item = f64>, margin: f64) -> Axis {
        let (lo, hi) = self.range.unwrap_or_else(|| {
            let (lo, hi) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| {
                (lo.min(v), hi.max(v))
            });
            let pad = margin * (hi - lo).max(1e-3 * hi.abs().max(lo.abs())).max(1e-12);
            if self.logarithmic {
                (lo, hi)
            } else {
                (lo - pad, hi + pad)
            }
        });
        if self.logarithmic {
            Axis::decades(lo, hi)
        } else {
            Axis::linear(lo, hi, TICKS)
        }
    }
}

/// Style of a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TraceStyle {
    /// A line.
    Line,
    /// A broken line: limits, references.
    Dashed,
    /// Markers, with bars if a spread is given.
    Points,
    /// The area between the values less and plus their spread.
    Band,
}

/// Points with a place in the legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Entry in the legend; none for a trace that shares the entry of another.
    pub label: Option<String>,
    /// Index of colour and marker, counted modulo the palette.
    pub colour: usize,
    /// Style of the trace.
    pub style: TraceStyle,
    /// (x, y) in the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// Half length of each point's bar (or half height of the band), in the unit of y; empty for
    /// none.
    pub spread: Vec<f64>,
}

impl Trace {
    /// Creates a trace; an empty label gives it no entry in the legend.
    pub fn new(label: &str, colour: usize, style: TraceStyle, points: Vec<(f64, f64)>) -> Self {
        Self {
            label: (!label.is_empty()).then(|| label.to_owned()),
            colour,
            style,
            points,
            spread: Vec::new(),
        }
    }

    /// Returns the same with bars (or, for a band, a half height) of these half lengths.
    #[must_use]
    pub fn with_spread(self, spread: Vec<f64>) -> Self {
        Self { spread, ..self }
    }

    fn spread(&self, index: usize) -> f64 {
        self.spread
            .get(index)
            .copied()
            .filter(|s| s.is_finite())
            .unwrap_or(0.0)
    }
}

/// One frame of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Horizontal axis.
    pub x: AxisSpec,
    /// Vertical axis.
    pub y: AxisSpec,
    /// Drawn in this order, later over earlier.
    pub traces: Vec<Trace>,
    /// Height over width.
    pub aspect: f64,
}

impl Panel {
    /// Creates a panel of height 0.4 times its width.
    pub fn new(x: AxisSpec, y: AxisSpec, traces: Vec<Trace>) -> Self {
        Self {
            x,
            y,
            traces,
            aspect: 0.4,
        }
    }

    fn frame(&self, room: Room) -> Frame {
        let Room { top, width } = room;
        let all = || self.traces.iter().flat_map(|t| &t.points);
        let ends = self.traces.iter().flat_map(|t| {
            let ends = |(i, p): (usize, &(f64, f64))| {
                if self.y.logarithmic {
                    [p.1; 2]
                } else {
                    [p.1 - t.spread(i), p.1 + t.spread(i)]
                }
            };
            t.points.iter().enumerate().flat_map(ends)
        });
        let (x, y) = (
            self.x.axis(all().map(|p| p.0), 0.02),
            self.y.axis(ends, 0.06),
        );
        Frame {
            left: LEFT,
            top,
            width,
            height: (width * self.aspect).round(),
            x,
            y,
        }
    }
}

/// Panels below each other under one title; the legend names the traces of all.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// First line, bold.
    pub title: String,
    /// Second line; empty for none.
    pub subtitle: String,
    /// From the top.
    pub panels: Vec<Panel>,
    /// Width in pixels of an SVG at its natural size; kept within 320…4000.
    pub width_px: u32,
}

impl Chart {
    /// Creates a chart 900 pixels wide.
    pub fn new(title: &str, subtitle: &str, panels: Vec<Panel>) -> Self {
        Self {
            title: title.to_owned(),
            subtitle: subtitle.to_owned(),
            panels,
            width_px: 900,
        }
    }

    fn check(&self) -> Result<(), PlotError> {
        if self
            .panels
            .iter()
            .flat_map(|p| &p.traces)
            .all(|t| t.points.is_empty())
        {
            return Err(PlotError::NothingToShow {
                title: self.title.clone(),
            });
        }
        for panel in &self.panels {
            for trace in &panel.traces {
                let usable = |(x, y): &&(f64, f64)| {
                    panel.x.coordinate(*x).is_finite() && panel.y.coordinate(*y).is_finite()
                };
                if let Some((x, y)) = trace.points.iter().find(|p| !usable(p)) {
                    let trace = trace.label.clone().unwrap_or_default();
                    return Err(PlotError::BadCoordinates {
                        title: self.title.clone(),
                        trace,
                        x: *x,
                        y: *y,
                    });
                }
            }
        }
        Ok(())
    }
}

/// Writes a chart to a `.svg` or `.png` file.
///
/// # Errors
/// [`PlotError`] for nothing to show, coordinates without a place on their axes, another file name,
/// or a file that cannot be written.
pub fn chart(chart: &Chart, path: &Path) -> Result<(), PlotError> {
    layout(chart)?.write(path)
}

/// Returns a chart as the text of an SVG.
///
/// # Errors
/// As [`chart`], but for the file.
pub fn chart_svg(chart: &Chart) -> Result<String, PlotError> {
    layout(chart)?.to_svg()
}

pub(super) fn layout(chart: &Chart) -> Result<Scene, PlotError> {
    chart.check()?;
    let width = f64::from(chart.width_px.clamp(320, 4000));
    let mut entries = Vec::new();
    for trace in chart.panels.iter().flat_map(|p| &p.traces) {
        if let Some(text) = trace.label.as_deref() {
            entries.push(Entry {
                text,
                sample: Box::new(move |at| sample(trace, at)),
            });
        }
    }
    let titles = Titles {
        title: &chart.title,
        subtitle: &chart.subtitle,
    };
    let (mut shapes, mut top) = strip(titles, &entries, width)?;
    for (index, panel) in chart.panels.iter().enumerate() {
        // An axis that the next panel repeats is named there.
        let named = chart
            .panels
            .get(index + 1)
            .is_none_or(|next| next.x != panel.x);
        let frame = panel.frame(Room {
            top,
            width: width - LEFT - RIGHT,
        });
        shapes.extend(frame.shapes(if named { &panel.x.name } else { "" }, &panel.y.name));
        for trace in &panel.traces {
            shapes.extend(draw(panel, &frame, trace));
        }
        top += frame.height + if named { BOTTOM } else { GAP };
    }
    Ok(Scene {
        title: chart.title.clone(),
        width,
        height: top,
        shapes,
    })
}

fn draw(panel: &Panel, frame: &Frame, trace: &Trace) -> Vec<Shape> {
    let at = |x: f64, y: f64| {
        let (px, py) = frame.place(panel.x.coordinate(x), panel.y.coordinate(y));
        // Values beyond a fixed range must not draw over the title.
        let inside = |v: f64, lo: f64, hi: f64| if v.is_finite() { v.clamp(lo, hi) } else { hi };
        (
            inside(px, frame.left, frame.left + frame.width),
            inside(py, frame.top, frame.top + frame.height),
        )
    };
    let colour = palette(trace.colour);
    let points = || trace.points.iter().enumerate();
    match trace.style {
        TraceStyle::Line => {
            vec![Shape::Line {
                points: thinned(&points().map(|(_, p)| at(p.0, p.1)).collect::<Vec<_>>()),
                colour,
                width: 2.0,
            }]
        }
        TraceStyle::Dashed => dashes(
            &points().map(|(_, p)| at(p.0, p.1)).collect::<Vec<_>>(),
            |points| Shape::Line {
                points,
                colour,
                width: 1.5,
            },
        ),
        TraceStyle::Band => {
            let edge = |sign: f64| points().map(move |(i, p)| (p.0, p.1 + sign * trace.spread(i)));
            let (upper, lower): (Vec<Place>, Vec<Place>) = (
                edge(1.0).map(|p| at(p.0, p.1)).collect(),
                edge(-1.0).map(|p| at(p.0, p.1)).collect(),
            );
            vec![Shape::Area {
                points: upper.into_iter().chain(lower.into_iter().rev()).collect(),
                colour: colour.faded(0.25),
            }]
        }
        TraceStyle::Points => points()
            .flat_map(|(i, p)| {
                let spread = trace.spread(i);
                let bar = Shape::Line {
                    points: vec![at(p.0, p.1 - spread), at(p.0, p.1 + spread)],
                    colour: colour.faded(0.8),
                    width: 1.2,
                };
                let marker = symbol(trace.colour, at(p.0, p.1), 4.0, colour);
                if spread > 0.0 {
                    vec![bar, marker]
                } else {
                    vec![marker]
                }
            })
            .collect(),
    }
}

fn sample(trace: &Trace, at: Place) -> Vec<Shape> {
    let colour = palette(trace.colour);
    let ends = [(at.0 - 13.0, at.1), (at.0 + 13.0, at.1)];
    match trace.style {
        TraceStyle::Line => vec![Shape::Line {
            points: ends.to_vec(),
            colour,
            width: 2.0,
        }],
        TraceStyle::Dashed => dashes(&ends, |points| Shape::Line {
            points,
            colour,
            width: 1.5,
        }),
        TraceStyle::Points => vec![symbol(trace.colour, at, 4.0, colour)],
        TraceStyle::Band => {
            let corners = [(-13.0, -6.0), (13.0, -6.0), (13.0, 6.0), (-13.0, 6.0)];
            vec![Shape::Area {
                points: corners.map(|(x, y)| (at.0 + x, at.1 + y)).to_vec(),
                colour: colour.faded(0.25),
            }]
        }
    }
}

/// Returns a path as strokes of 7 pixels with gaps of 5.
pub(super) fn dashes(path: &[Place], stroke: impl Fn(Vec<Place>) -> Shape) -> Vec<Shape> {
    const STROKE: f64 = 7.0;
    const PERIOD: f64 = 12.0;
    let mut shapes = Vec::new();
    let mut walked = 0.0;
    for pair in path.windows(2) {
        let [from, to] = [pair[0], pair[1]];
        let length = (to.0 - from.0).hypot(to.1 - from.1);
        let mut done = 0.0;
        while done < length {
            let phase: f64 = (walked + done) % PERIOD;
            let (on, left) = if phase < STROKE {
                (true, STROKE - phase)
            } else {
                (false, PERIOD - phase)
            };
            let end = (done + left.max(1e-3)).min(length);
            let place = |d: f64| {
                (
                    from.0 + (to.0 - from.0) * d / length,
                    from.1 + (to.1 - from.1) * d / length,
                )
            };
            if on {
                shapes.push(stroke(vec![place(done), place(end)]));
            }
            done = end;
        }
        walked += length;
    }
    shapes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Chart {
        let x = || AxisSpec::linear("Time / s");
        let wave: Vec<(f64, f64)> = (0..200)
            .map(|k| (f64::from(k) * 0.05, (f64::from(k) * 0.05).sin()))
            .collect();
        let points: Vec<(f64, f64)> = wave.iter().step_by(20).copied().collect();
        let upper = vec![
            Trace::new("band", 0, TraceStyle::Band, wave.clone()).with_spread(vec![0.2; 200]),
            Trace::new("line", 0, TraceStyle::Line, wave),
            Trace::new("points", 1, TraceStyle::Points, points).with_spread(vec![0.1; 10]),
        ];
        let lower = vec![Trace::new(
            "limit",
            6,
            TraceStyle::Dashed,
            vec![(0.0, 2.5), (10.0, 2.5)],
        )];
        Chart::new(
            "A chart",
            "with two panels",
            vec![
                Panel::new(x(), AxisSpec::linear("Voltage / V"), upper),
                Panel::new(x(), AxisSpec::logarithmic("Limit / V"), lower),
            ],
        )
    }

    #[test]
    fn every_word_is_there_and_a_shared_axis_is_named_once() {
        let svg = chart_svg(&example()).unwrap();
        for text in [
            "A chart",
            "with two panels",
            "band",
            "line",
            "points",
            "limit",
            "Voltage / V",
            "Limit / V",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("Time / s").count(), 1);
    }

    #[test]
    fn refuses_what_has_no_place() {
        let mut bad = example();
        bad.panels[1].traces[0].points[0].1 = 0.0;
        let text = chart_svg(&bad).unwrap_err().to_string();
        assert_eq!(
            text,
            "chart \"A chart\", trace \"limit\": expected finite coordinates (above zero on a \
            logarithmic axis), met (0, 0)"
        );
        let empty = Chart::new("Nothing", "", vec![]);
        assert!(
            chart_svg(&empty)
                .unwrap_err()
                .to_string()
                .contains("at least one point")
        );
    }

    #[test]
    fn dashes_cover_seven_twelfths() {
        let strokes = dashes(&[(0.0, 0.0), (100.0, 0.0), (1200.0, 0.0)], |points| {
            Shape::Line {
                points,
                colour: palette(0),
                width: 1.0,
            }
        });
        let length = |s: &Shape| {
            if let Shape::Line { points, .. } = s {
                points[1].0 - points[0].0
            } else {
                0.0
            }
        };
        let total: f64 = strokes.iter().map(length).sum();
        assert!((total - 700.0).abs() < 1.0, "{total}");
    }
}
