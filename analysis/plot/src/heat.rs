//! A matrix as coloured squares with numbers.

use super::PlotError;
use super::backend::text_width;
use super::frame::{LEFT, RIGHT, Titles, label, strip, text_shape, widest};
use super::marks::{GREY, INK};
use super::scene::{Anchor, Colour, Label, Scene, Shape};

const SMALL: f64 = 13.0;
const MARGIN: f64 = 24.0;
/// Colours from the lower to the upper end of the scale: dark blue over teal to nearly white,
/// lightness rising all the way.
const RAMP: [(f64, f64, f64); 5] = [
    (8.0, 48.0, 107.0),
    (33.0, 102.0, 172.0),
    (103.0, 169.0, 207.0),
    (209.0, 229.0, 240.0),
    (250.0, 250.0, 250.0),
];

/// Scale of the colours.
#[derive(Debug, Clone, PartialEq)]
pub struct HeatScale {
    /// Value of the darkest and of the lightest colour; what lies beyond gets the nearest.
    pub ends: (f64, f64),
    /// Words at the two ends.
    pub end_labels: (String, String),
    /// Decimals of the numbers in the squares.
    pub decimals: usize,
}

/// A matrix to be shown.
#[derive(Debug, Clone, PartialEq)]
pub struct HeatMap {
    /// First line, bold.
    pub title: String,
    /// Second line; empty for none.
    pub subtitle: String,
    /// Names of rows and columns.
    pub labels: (Vec<String>, Vec<String>),
    /// Rows of values; values that are not finite stay empty.
    pub values: Vec<Vec<f64>>,
    /// Scale of the colours.
    pub scale: HeatScale,
}

pub(super) fn layout(map: &HeatMap) -> Result<Scene, PlotError> {
    let (rows, columns) = (&map.labels.0, &map.labels.1);
    if map.values.iter().flatten().next().is_none() {
        return Err(PlotError::NothingToShow {
            title: map.title.clone(),
        });
    }
    let widest = |names: &[String]| widest(names.iter().map(String::as_str), SMALL);
    let left = MARGIN + widest(rows)? + 10.0;
    let side = (640.0 / columns.len().max(1) as f64).clamp(34.0, 64.0);
    let width = (left + side * columns.len() as f64 + RIGHT).max(640.0);
    let titles = Titles {
        title: &map.title,
        subtitle: &map.subtitle,
    };
    let (mut shapes, head) = strip(titles, &[], width)?;
    shapes.extend(key(&map.scale, head)?);
    let top = head + 40.0 + widest(columns)? + 8.0;
    for (k, name) in columns.iter().enumerate() {
        let at = (
            left + side * (k as f64 + 0.5),
            top - 8.0 - text_width(name, SMALL)? / 2.0,
        );
        shapes.push(Shape::Label(Label {
            upright: true,
            ..label(name, at, SMALL, Anchor::Centre)
        }));
    }
    for (row, values) in map.values.iter().enumerate() {
        let y = top + side * row as f64;
        let name = rows.get(row).map_or("", String::as_str);
        shapes.push(text_shape(
            name,
            (left - 9.0, y + side / 2.0),
            SMALL,
            Anchor::Right,
        ));
        for (column, value) in values.iter().enumerate() {
            let square = Square {
                left: left + side * column as f64,
                top: y,
                side,
            };
            shapes.extend(square.shapes(&map.scale, *value));
        }
    }
    Ok(Scene {
        title: map.title.clone(),
        width,
        height: top + side * map.values.len() as f64 + MARGIN,
        shapes,
    })
}

/// The square of one value, in logical pixels from the upper left.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Square {
    left: f64,
    top: f64,
    side: f64,
}

impl Square {
    fn shapes(self, scale: &HeatScale, value: f64) -> Vec<Shape> {
        let Self {
            left: x,
            top: y,
            side,
        } = self;
        if !value.is_finite() {
            return Vec::new();
        }
        let fraction = ((value - scale.ends.0) / (scale.ends.1 - scale.ends.0)).clamp(0.0, 1.0);
        let corners =
            |x0: f64, x1: f64, y1: f64| vec![(x0, y + 0.5), (x1, y + 0.5), (x1, y1), (x0, y1)];
        let ink = if fraction < 0.5 {
            Colour(255, 255, 255, 1.0)
        } else {
            INK
        };
        let text = format!("{value:.*}", scale.decimals);
        let word = label(
            &text,
            (x + side / 2.0, y + side / 2.0),
            SMALL - 1.0,
            Anchor::Centre,
        );
        vec![
            Shape::Area {
                points: corners(x + 0.5, x + side - 0.5, y + side - 0.5),
                colour: ramp(fraction),
            },
            Shape::Label(Label {
                colour: ink,
                ..word
            }),
        ]
    }
}

/// Draws the scale of colours with its ends as text.
fn key(scale: &HeatScale, top: f64) -> Result<Vec<Shape>, PlotError> {
    const LENGTH: f64 = 180.0;
    const PIECES: u32 = 36;
    let (low, high) = (
        format!("{} {}", scale.ends.0, scale.end_labels.0),
        format!("{} {}", scale.ends.1, scale.end_labels.1),
    );
    let start = LEFT + text_width(&low, SMALL)? + 10.0;
    let middle = top + 12.0;
    let mut shapes = vec![text_shape(&low, (LEFT, middle), SMALL, Anchor::Left)];
    for k in 0..PIECES {
        let (x0, x1) = (
            start + LENGTH * f64::from(k) / f64::from(PIECES),
            start + LENGTH * f64::from(k + 1) / f64::from(PIECES),
        );
        let points = vec![
            (x0, middle - 8.0),
            (x1, middle - 8.0),
            (x1, middle + 8.0),
            (x0, middle + 8.0),
        ];
        shapes.push(Shape::Area {
            points,
            colour: ramp(f64::from(k) / f64::from(PIECES - 1)),
        });
    }
    let frame = [
        (0.0, -8.0),
        (LENGTH, -8.0),
        (LENGTH, 8.0),
        (0.0, 8.0),
        (0.0, -8.0),
    ];
    shapes.push(Shape::Line {
        points: frame.map(|(x, y)| (start + x, middle + y)).to_vec(),
        colour: GREY,
        width: 1.0,
    });
    shapes.push(text_shape(
        &high,
        (start + LENGTH + 10.0, middle),
        SMALL,
        Anchor::Left,
    ));
    Ok(shapes)
}

fn ramp(fraction: f64) -> Colour {
    let at = fraction.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let k = (at.floor() as usize).min(RAMP.len() - 2);
    let part = at - k as f64;
    let mix = |a: f64, b: f64| (a + (b - a) * part).round() as u8;
    let (from, to) = (RAMP[k], RAMP[k + 1]);
    Colour(mix(from.0, to.0), mix(from.1, to.1), mix(from.2, to.2), 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: Vec<Vec<f64>>) -> HeatMap {
        let scale = HeatScale {
            ends: (0.0, 1.0),
            end_labels: ("identical".into(), "distinct".into()),
            decimals: 2,
        };
        let names = vec!["heat".to_owned(), "rc_slow".to_owned()];
        HeatMap {
            title: "Map".into(),
            subtitle: String::new(),
            labels: (names.clone(), names),
            values,
            scale,
        }
    }

    #[test]
    fn squares_bear_their_numbers_and_unknown_ones_stay_empty() {
        let svg = layout(&map(vec![vec![f64::NAN, 0.42], vec![7.5, 0.0]]))
            .unwrap()
            .to_svg()
            .unwrap();
        for text in ["0.42", "7.50", "0.00", "0 identical", "1 distinct"] {
            assert!(svg.contains(&format!(">\n{text}\n<")), "{text}");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn colours_get_lighter_all_the_way() {
        let light = |k: u32| {
            let c = ramp(f64::from(k) / 50.0);
            0.21 * f64::from(c.0) + 0.72 * f64::from(c.1) + 0.07 * f64::from(c.2)
        };
        assert!((0..50).all(|k| light(k) < light(k + 1)));
    }

    #[test]
    fn an_empty_matrix_is_refused() {
        assert_eq!(
            layout(&map(vec![])).unwrap_err().to_string(),
            "plot \"Map\": expected at least one point, met none"
        );
    }
}
