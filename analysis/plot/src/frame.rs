//! A frame with two axes, and the strip of title and legend above it.

use super::axis::Axis;
use super::backend::text_width;
use super::marks::{GREY, INK, PALE, sample};
use super::scene::{Anchor, Label, Place, Shape};
use super::{ImpedancePlot, PlotError};

pub(super) const TEXT: f64 = 15.0;
const TITLE: f64 = 21.0;
const LINE: f64 = 24.0;
/// Room for tick labels and the axis' name left of a frame and below it.
pub(super) const LEFT: f64 = 78.0;
pub(super) const BOTTOM: f64 = 58.0;
/// Margin right of a frame.
pub(super) const RIGHT: f64 = 26.0;

/// The room for a frame, in logical pixels from the upper left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Room {
    pub(super) top: f64,
    pub(super) width: f64,
}

/// A rectangle with axes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) x: Axis,
    pub(super) y: Axis,
}

impl Frame {
    /// Place of a point of axis coordinates.
    pub(super) fn place(&self, x: f64, y: f64) -> Place {
        (
            self.left + self.width * self.x.fraction(x),
            self.top + self.height * (1.0 - self.y.fraction(y)),
        )
    }

    /// Draws grid, ticks, border and the names of the axes; the x axis is labelled only if it has a
    /// name.
    pub(super) fn shapes(&self, x_name: &str, y_name: &str) -> Vec<Shape> {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        let vertical = |x: f64, colour, width| {
            let at = self.place(x, self.y.lo).0;
            Shape::Line {
                points: vec![(at, self.top), (at, bottom)],
                colour,
                width,
            }
        };
        let horizontal = |y: f64, colour, width| {
            let at = self.place(self.x.lo, y).1;
            Shape::Line {
                points: vec![(self.left, at), (right, at)],
                colour,
                width,
            }
        };
        let mut shapes: Vec<Shape> = self
            .x
            .minor
            .iter()
            .map(|x| vertical(*x, PALE.faded(0.5), 0.75))
            .collect();
        shapes.extend(self.x.ticks.iter().map(|(x, _)| vertical(*x, PALE, 1.0)));
        shapes.extend(self.y.ticks.iter().map(|(y, _)| horizontal(*y, PALE, 1.0)));
        if self.y.lo < 0.0 && self.y.hi > 0.0 {
            shapes.push(horizontal(0.0, GREY.faded(0.7), 1.0));
        }
        let corners = vec![
            (self.left, self.top),
            (right, self.top),
            (right, bottom),
            (self.left, bottom),
            (self.left, self.top),
        ];
        shapes.push(Shape::Line {
            points: corners,
            colour: GREY,
            width: 1.0,
        });
        let tick_text = |text: &str, at, anchor| text_shape(text, at, TEXT - 1.0, anchor);
        for (y, label) in &self.y.ticks {
            shapes.push(tick_text(
                label,
                (self.left - 9.0, self.place(self.x.lo, *y).1),
                Anchor::Right,
            ));
        }
        let middle = (self.left + self.width / 2.0, self.top + self.height / 2.0);
        let upright = Label {
            upright: true,
            ..label(
                y_name,
                (self.left - LEFT + 14.0, middle.1),
                TEXT,
                Anchor::Centre,
            )
        };
        shapes.push(Shape::Label(upright));
        if !x_name.is_empty() {
            for (x, label) in &self.x.ticks {
                shapes.push(tick_text(
                    label,
                    (self.place(*x, self.y.lo).0, bottom + 8.0),
                    Anchor::Top,
                ));
            }
            shapes.push(text_shape(
                x_name,
                (middle.0, bottom + 33.0),
                TEXT,
                Anchor::Top,
            ));
        }
        shapes
    }
}

/// One entry of a legend: its text, and the function that draws its sample about a position.
pub(super) struct Entry<'a> {
    pub(super) text: &'a str,
    pub(super) sample: Box<dyn Fn(Place) -> Vec<Shape> + 'a>,
}

/// Returns the title, subtitle and legend of an impedance plot from the upper edge down, and the
/// height they take.
pub(super) fn heading(plot: &ImpedancePlot, width: f64) -> Result<(Vec<Shape>, f64), PlotError> {
    let mut entries = Vec::new();
    for series in &plot.series {
        if let Some(text) = series.label.as_deref() {
            entries.push(Entry {
                text,
                sample: Box::new(move |at| sample(series, at)),
            });
        }
    }
    let titles = Titles {
        title: &plot.title,
        subtitle: &plot.subtitle,
    };
    strip(titles, &entries, width)
}

/// The two lines of text at the upper edge; an empty one needs no space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Titles<'a> {
    /// First line, bold.
    pub(super) title: &'a str,
    /// Second line, grey.
    pub(super) subtitle: &'a str,
}

/// Returns the title, subtitle and legend from the upper edge down, and the height they take.
pub(super) fn strip(
    titles: Titles<'_>,
    entries: &[Entry<'_>],
    width: f64,
) -> Result<(Vec<Shape>, f64), PlotError> {
    let Titles { title, subtitle } = titles;
    let mut shapes = Vec::new();
    let mut y = 16.0;
    if !title.is_empty() {
        shapes.push(Shape::Label(Label {
            bold: true,
            ..label(title, (LEFT, y), TITLE, Anchor::TopLeft)
        }));
        y += TITLE + 8.0;
    }
    if !subtitle.is_empty() {
        shapes.push(Shape::Label(Label {
            colour: GREY,
            ..label(subtitle, (LEFT, y), TEXT, Anchor::TopLeft)
        }));
        y += TEXT + 10.0;
    }
    let mut x = LEFT;
    for Entry { text, sample } in entries {
        let entry = 40.0 + text_width(text, TEXT)?;
        if x > LEFT && x + entry > width - RIGHT {
            x = LEFT;
            y += LINE;
        }
        shapes.extend(sample((x + 14.0, y + LINE / 2.0)));
        shapes.push(text_shape(
            text,
            (x + 34.0, y + LINE / 2.0),
            TEXT,
            Anchor::Left,
        ));
        x += entry + 24.0;
    }
    if !entries.is_empty() {
        y += LINE + 4.0;
    }
    Ok((shapes, y + 6.0))
}

/// Dark text at a place.
pub(super) fn text_shape(text: &str, at: Place, size: f64, anchor: Anchor) -> Shape {
    Shape::Label(label(text, at, size, anchor))
}

/// Wraps text at blanks so that each line is at most `width` wide, approximately; a longer word
/// keeps its own line.
pub(super) fn wrapped(text: &str, size: f64, width: f64) -> Result<Vec<String>, PlotError> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let longer = lines.last().map(|line| format!("{line} {word}"));
        match (lines.last_mut(), longer) {
            (Some(line), Some(longer)) if text_width(&longer, size)? <= width => *line = longer,
            _ => lines.push(word.to_owned()),
        }
    }
    Ok(lines)
}

/// Returns the width of the widest of some texts in logical pixels, about; zero without any.
pub(super) fn widest<'a>(
    mut texts: impl Iterator<Item = &'a str>,
    size: f64,
) -> Result<f64, PlotError> {
    texts.try_fold(0.0, |most: f64, text| Ok(most.max(text_width(text, size)?)))
}

/// Returns a dark label; its fields may be changed before it becomes a shape.
pub(super) fn label(text: &str, at: Place, size: f64, anchor: Anchor) -> Label {
    Label {
        text: text.to_owned(),
        at,
        size,
        colour: INK,
        bold: false,
        upright: false,
        anchor,
    }
}
