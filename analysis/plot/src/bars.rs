//! Rows of horizontal bars with text: their names on the left, their values at their ends, a remark
//! on the right.

use super::PlotError;
use super::axis::Axis;
use super::chart::{AxisSpec, dashes};
use super::frame::{BOTTOM, Entry, RIGHT, TEXT, Titles, label, strip, text_shape, widest, wrapped};
use super::marks::{GREY, INK, PALE, palette};
use super::scene::{Anchor, Colour, Label, Scene, Shape};

const SMALL: f64 = 13.0;
const BAR: f64 = 14.0;
const STEP: f64 = 17.0;
const ROW_GAP: f64 = 9.0;
const HEADING: f64 = 28.0;
const MARGIN: f64 = 24.0;
const PANEL_GAP: f64 = 14.0;
const FAINT: f64 = 0.35;
const TICKS: f64 = 6.0;

/// One bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// End of the bar, in the unit of the axis; no bar is drawn for a value that has no place on
    /// it.
    pub value: f64,
    /// Index of its colour, counted modulo the palette.
    pub colour: usize,
    /// Pale: to be known, but not significant.
    pub faint: bool,
    /// Words at its end.
    pub text: String,
}

/// A named row of bars.
#[derive(Debug, Clone, PartialEq)]
pub struct BarRow {
    /// Name at the left.
    pub label: String,
    /// Its name in bold.
    pub marked: bool,
    /// From the top.
    pub bars: Vec<Bar>,
    /// Remark at the right; empty for none.
    pub note: String,
}

/// Rows under a heading.
#[derive(Debug, Clone, PartialEq)]
pub struct BarGroup {
    /// Heading; empty for none.
    pub heading: String,
    /// From the top.
    pub rows: Vec<BarRow>,
}

/// A value that bars are held against.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The value, in the unit of the axis.
    pub value: f64,
    /// Its name.
    pub label: String,
}

/// Groups over one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct BarPanel {
    /// The axis of the values; one without a range follows the bars.
    pub axis: AxisSpec,
    /// Start of the bars, in the unit of the axis.
    pub baseline: f64,
    /// Dashed line across all rows.
    pub reference: Option<Reference>,
    /// From the top.
    pub groups: Vec<BarGroup>,
    /// Heading of the remarks; empty for none.
    pub note_heading: String,
}

/// Panels of bars below each other under one title.
#[derive(Debug, Clone, PartialEq)]
pub struct BarChart {
    /// First line, bold.
    pub title: String,
    /// Second line; empty for none.
    pub subtitle: String,
    /// Legend of the colours: text and index.
    pub legend: Vec<(String, usize)>,
    /// From the top.
    pub panels: Vec<BarPanel>,
    /// Width in pixels of an SVG at its natural size; kept within 320…4000.
    pub width_px: u32,
}

impl BarPanel {
    fn rows(&self) -> impl Iterator<Item = &BarRow> {
        self.groups.iter().flat_map(|g| &g.rows)
    }

    fn bars(&self) -> impl Iterator<Item = &Bar> {
        self.rows().flat_map(|r| &r.bars)
    }

    fn axis(&self) -> Axis {
        let placed = |v: &f64| self.axis.coordinate(*v).is_finite();
        let fixed = self
            .reference
            .iter()
            .map(|r| r.value)
            .chain([self.baseline]);
        let all = self.bars().map(|b| b.value).chain(fixed).filter(placed);
        let (lo, hi) = self.axis.range.unwrap_or_else(|| {
            all.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| {
                (lo.min(v), hi.max(v))
            })
        });
        if self.axis.logarithmic {
            Axis::tight_decades(lo, hi.max(2.0 * lo))
        } else {
            Axis::linear(lo, if hi > lo { hi } else { lo + 1.0 }, TICKS)
        }
    }
}

/// Columns of a panel: names, bars, remarks; and its axis.
struct Columns {
    right: f64,
    /// Ends of the axis.
    bars: (f64, f64),
    /// Left end of the remarks.
    notes: f64,
    axis: Axis,
}

impl Columns {
    fn of(panel: &BarPanel, names: f64, width: f64) -> Result<Self, PlotError> {
        let drawn = panel
            .bars()
            .filter(|b| panel.axis.coordinate(b.value).is_finite());
        let ends = widest(drawn.map(|b| b.text.as_str()), SMALL)?;
        let remarks = widest(
            panel
                .rows()
                .map(|r| r.note.as_str())
                .chain([panel.note_heading.as_str()]),
            SMALL,
        )?;
        let right = width - RIGHT;
        let left = MARGIN + names.min(0.3 * width) + 10.0;
        let notes = if remarks > 0.0 {
            right - remarks.min(0.34 * width)
        } else {
            right
        };
        let end = notes - ends - 22.0;
        Ok(Self {
            right,
            bars: (left, end.max(left + 60.0)),
            notes,
            axis: panel.axis(),
        })
    }

    fn place(&self, panel: &BarPanel, value: f64) -> Option<f64> {
        let at = self.axis.fraction(panel.axis.coordinate(value));
        at.is_finite()
            .then(|| self.bars.0 + (self.bars.1 - self.bars.0) * at.clamp(0.0, 1.0))
    }
}

pub(super) fn layout(chart: &BarChart) -> Result<Scene, PlotError> {
    if chart.panels.iter().all(|p| p.rows().next().is_none()) {
        return Err(PlotError::NothingToShow {
            title: chart.title.clone(),
        });
    }
    let width = f64::from(chart.width_px.clamp(320, 4000));
    let entries: Vec<Entry<'_>> = chart
        .legend
        .iter()
        .map(|(text, colour)| Entry {
            text,
            sample: Box::new(move |at| {
                let sample = Rectangle {
                    left: at.0 - 13.0,
                    right: at.0 + 13.0,
                    top: at.1 - BAR / 2.0,
                    bottom: at.1 + BAR / 2.0,
                };
                vec![sample.filled(palette(*colour))]
            }),
        })
        .collect();
    let titles = Titles {
        title: &chart.title,
        subtitle: &chart.subtitle,
    };
    let (mut shapes, mut top) = strip(titles, &entries, width)?;
    // Bold letters are about a tenth wider.
    let names = 1.1
        * widest(
            chart
                .panels
                .iter()
                .flat_map(BarPanel::rows)
                .map(|r| r.label.as_str()),
            SMALL,
        )?;
    for panel in chart.panels.iter().filter(|p| p.rows().next().is_some()) {
        let columns = Columns::of(panel, names, width)?;
        let (drawn, bottom) = draw(panel, &columns, top)?;
        shapes.extend(drawn);
        top = bottom + PANEL_GAP;
    }
    Ok(Scene {
        title: chart.title.clone(),
        width,
        height: top,
        shapes,
    })
}

fn draw(panel: &BarPanel, columns: &Columns, top: f64) -> Result<(Vec<Shape>, f64), PlotError> {
    let mut front = Vec::new();
    let above = if panel.reference.is_some() || !panel.note_heading.is_empty() {
        22.0
    } else {
        4.0
    };
    let first = top + above;
    let mut y = first + 4.0;
    for group in &panel.groups {
        if !group.heading.is_empty() {
            let heading = label(
                &group.heading,
                (MARGIN, y + HEADING / 2.0),
                TEXT,
                Anchor::Left,
            );
            front.push(Shape::Label(Label {
                colour: GREY,
                ..heading
            }));
            y += HEADING;
        }
        for row in &group.rows {
            let (drawn, height) = draw_row(panel, columns, row, y)?;
            front.extend(drawn);
            y += height + ROW_GAP;
        }
    }
    let area = Rectangle {
        left: columns.bars.0,
        right: columns.bars.1,
        top: first,
        bottom: y,
    };
    let mut shapes = grid(panel, columns, &area);
    shapes.extend(front);
    shapes.extend(reference(panel, columns, &area));
    if !panel.note_heading.is_empty() {
        let heading = label(
            &panel.note_heading,
            (columns.notes, top + 8.0),
            SMALL,
            Anchor::Left,
        );
        shapes.push(Shape::Label(Label {
            colour: GREY,
            ..heading
        }));
    }
    Ok((shapes, y + BOTTOM))
}

fn draw_row(
    panel: &BarPanel,
    columns: &Columns,
    row: &BarRow,
    top: f64,
) -> Result<(Vec<Shape>, f64), PlotError> {
    let names = wrapped(
        &row.label,
        SMALL * if row.marked { 1.1 } else { 1.0 },
        columns.bars.0 - MARGIN - 8.0,
    )?;
    let notes = wrapped(&row.note, SMALL, columns.right - columns.notes + 4.0)?;
    let lines = names.len().max(notes.len()).max(row.bars.len()) as f64;
    let middle = top + lines * STEP / 2.0;
    let line = |count: usize, k: usize| middle + (k as f64 - (count as f64 - 1.0) / 2.0) * STEP;
    let mut shapes = Vec::new();
    for (k, text) in names.iter().enumerate() {
        let name = label(
            text,
            (columns.bars.0 - 9.0, line(names.len(), k)),
            SMALL,
            Anchor::Right,
        );
        shapes.push(Shape::Label(Label {
            bold: row.marked,
            ..name
        }));
    }
    for (k, text) in notes.iter().enumerate() {
        shapes.push(text_shape(
            text,
            (columns.notes, line(notes.len(), k)),
            SMALL,
            Anchor::Left,
        ));
    }
    for (k, bar) in row.bars.iter().enumerate() {
        let (y, start) = (
            line(row.bars.len(), k),
            columns
                .place(panel, panel.baseline)
                .unwrap_or(columns.bars.0),
        );
        let end = columns.place(panel, bar.value).unwrap_or(start);
        let colour = palette(bar.colour);
        if (end - start).abs() >= 0.5 {
            let colour = if bar.faint {
                colour.faded(FAINT)
            } else {
                colour
            };
            let drawn = Rectangle {
                left: start.min(end),
                right: start.max(end),
                top: y - BAR / 2.0,
                bottom: y + BAR / 2.0,
            };
            shapes.push(drawn.filled(colour));
        }
        // Text is placed right of the reference rather than on it.
        let reference = panel
            .reference
            .as_ref()
            .and_then(|r| columns.place(panel, r.value))
            .unwrap_or(start);
        shapes.push(text_shape(
            &bar.text,
            (start.max(end).max(reference) + 6.0, y),
            SMALL,
            Anchor::Left,
        ));
    }
    Ok((shapes, lines * STEP))
}

fn grid(panel: &BarPanel, columns: &Columns, area: &Rectangle) -> Vec<Shape> {
    let Rectangle {
        left,
        right,
        top,
        bottom,
    } = *area;
    let x = |v: f64| left + (right - left) * columns.axis.fraction(v);
    let upright = |at: f64, colour, width| Shape::Line {
        points: vec![(at, top), (at, bottom)],
        colour,
        width,
    };
    let mut shapes: Vec<Shape> = columns
        .axis
        .ticks
        .iter()
        .map(|(v, _)| upright(x(*v), PALE, 1.0))
        .collect();
    shapes.push(Shape::Line {
        points: vec![(left, bottom), (right, bottom)],
        colour: GREY,
        width: 1.0,
    });
    if let Some(at) = columns.place(panel, panel.baseline) {
        shapes.push(upright(at, GREY, 1.0));
    }
    for (v, text) in &columns.axis.ticks {
        shapes.push(text_shape(
            text,
            (x(*v), bottom + 8.0),
            TEXT - 1.0,
            Anchor::Top,
        ));
    }
    shapes.push(text_shape(
        &panel.axis.name,
        ((left + right) / 2.0, bottom + 31.0),
        TEXT,
        Anchor::Top,
    ));
    shapes
}

fn reference(panel: &BarPanel, columns: &Columns, area: &Rectangle) -> Vec<Shape> {
    let Rectangle { top, bottom, .. } = *area;
    let Some(reference) = &panel.reference else {
        return Vec::new();
    };
    let Some(at) = columns.place(panel, reference.value) else {
        return Vec::new();
    };
    let mut shapes = dashes(&[(at, top), (at, bottom)], |points| Shape::Line {
        points,
        colour: INK,
        width: 1.5,
    });
    shapes.push(text_shape(
        &reference.label,
        (at, top - 11.0),
        SMALL,
        Anchor::Centre,
    ));
    shapes
}

/// An upright rectangle, its edges in logical pixels from the upper left.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Rectangle {
    fn filled(&self, colour: Colour) -> Shape {
        let Self {
            left,
            right,
            top,
            bottom,
        } = *self;
        Shape::Area {
            points: vec![(left, top), (right, top), (right, bottom), (left, bottom)],
            colour,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(values: &[f64]) -> BarChart {
        let bar = |v: &f64| Bar {
            value: *v,
            colour: 1,
            faint: false,
            text: format!("{v} mV"),
        };
        let row = BarRow {
            label: "a run".into(),
            marked: true,
            bars: values.iter().map(bar).collect(),
            note: "a remark of some words".into(),
        };
        let panel = BarPanel {
            axis: AxisSpec::logarithmic("Score / 1"),
            baseline: 1.0,
            reference: Some(Reference {
                value: 8.0,
                label: "needed".into(),
            }),
            groups: vec![BarGroup {
                heading: "Group".into(),
                rows: vec![row],
            }],
            note_heading: "why".into(),
        };
        BarChart {
            title: "Bars".into(),
            subtitle: String::new(),
            legend: vec![("before".into(), 1)],
            panels: vec![panel],
            width_px: 900,
        }
    }

    fn widths(chart: &BarChart) -> Vec<f64> {
        let area = |s: &Shape| {
            if let Shape::Area { points, .. } = s {
                Some(points[1].0 - points[0].0)
            } else {
                None
            }
        };
        layout(chart)
            .unwrap()
            .shapes
            .iter()
            .filter_map(area)
            .skip(1)
            .collect()
    }

    #[test]
    fn lengths_follow_the_axis() {
        let found = widths(&example(&[10.0, 100.0]));
        assert!((found[1] / found[0] - 2.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn what_has_no_place_has_words_and_no_bar() {
        let chart = example(&[-3.0, f64::NAN, 50.0]);
        assert_eq!(widths(&chart).len(), 1);
        let svg = layout(&chart).unwrap().to_svg().unwrap();
        for text in [
            "-3 mV",
            "NaN mV",
            "50 mV",
            "needed",
            "why",
            "Score / 1",
            "Group",
            "before",
        ] {
            assert!(svg.contains(&format!(">\n{text}\n<")), "{text}");
        }
    }

    #[test]
    fn no_rows_are_refused() {
        let empty = BarChart {
            panels: vec![],
            ..example(&[1.0])
        };
        assert_eq!(
            layout(&empty).unwrap_err().to_string(),
            "plot \"Bars\": expected at least one point, met none"
        );
    }
}
