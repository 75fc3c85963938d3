//! Colours and markers of series, and the ellipses and bars of their uncertainty.

use super::scene::{Colour, Place, Shape};
use super::{Series, SeriesStyle};
use analysis_numeric::Covariance2;

pub(super) const INK: Colour = Colour(34, 34, 34, 1.0);
pub(super) const GREY: Colour = Colour(100, 100, 100, 1.0);
pub(super) const PALE: Colour = Colour(224, 224, 224, 1.0);

/// Okabe and Ito's colours without the yellow, which is too light for lines on white.
const PALETTE: [Colour; 7] = [
    Colour(0, 114, 178, 1.0),
    Colour(213, 94, 0, 1.0),
    Colour(0, 158, 115, 1.0),
    Colour(204, 121, 167, 1.0),
    Colour(230, 159, 0, 1.0),
    Colour(86, 180, 233, 1.0),
    Colour(60, 60, 60, 1.0),
];

/// Returns the colour of an index.
pub(super) fn palette(index: usize) -> Colour {
    PALETTE.get(index % PALETTE.len()).copied().unwrap_or(INK)
}

/// Returns the colour of a series' marks.
pub(super) fn colour(series: &Series) -> Colour {
    let opacity = if series.style == SeriesStyle::Cloud {
        0.55
    } else {
        1.0
    };
    palette(series.colour).faded(opacity)
}

/// Half the width of a series' marks, logical pixels.
pub(super) fn radius(series: &Series) -> f64 {
    match series.style {
        SeriesStyle::Points => 4.2,
        SeriesStyle::Cloud => 3.2,
        SeriesStyle::Curve => 0.0,
    }
}

/// Returns a series at its places: markers or a line.
pub(super) fn draw(series: &Series, places: &[Place]) -> Vec<Shape> {
    match series.style {
        SeriesStyle::Curve => vec![Shape::Line {
            points: thinned(places),
            colour: colour(series),
            width: 2.25,
        }],
        SeriesStyle::Points | SeriesStyle::Cloud => {
            places.iter().map(|p| marker(series, *p)).collect()
        }
    }
}

/// Returns a series' entry in the legend.
pub(super) fn sample(series: &Series, at: Place) -> Vec<Shape> {
    match series.style {
        SeriesStyle::Curve => draw(series, &[(at.0 - 13.0, at.1), (at.0 + 13.0, at.1)]),
        SeriesStyle::Points | SeriesStyle::Cloud => vec![marker(series, at)],
    }
}

fn marker(series: &Series, at: Place) -> Shape {
    symbol(series.colour, at, radius(series), colour(series))
}

/// Five shapes of about equal area, by the colour's index.
pub(super) fn symbol(index: usize, at: Place, r: f64, colour: Colour) -> Shape {
    let polygon = |corners: &[(f64, f64)]| Shape::Area {
        points: corners
            .iter()
            .map(|(x, y)| (at.0 + r * x, at.1 + r * y))
            .collect(),
        colour,
    };
    match index % 5 {
        0 => Shape::Disc {
            at,
            radius: r,
            colour,
        },
        1 => polygon(&[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)]),
        2 => polygon(&[(0.0, -1.3), (1.2, 0.8), (-1.2, 0.8)]),
        3 => polygon(&[(0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)]),
        _ => polygon(&[(0.0, 1.3), (1.2, -0.8), (-1.2, -0.8)]),
    }
}

/// Returns the 2σ ellipse of (Re, Im) about a position, for a scale in logical pixels per Ω, or
/// `None` if it is unknown or too small to see beside the marker.
pub(super) fn ellipse(
    series: &Series,
    at: Place,
    c: &Covariance2,
    px_per_ohm: f64,
) -> Option<Shape> {
    let middle = (c.re_re + c.im_im) / 2.0;
    let half = ((c.re_re - c.im_im) / 2.0).hypot(c.re_im);
    let (major, minor) = ((middle + half).sqrt(), (middle - half).max(0.0).sqrt());
    let angle = 0.5 * (2.0 * c.re_im).atan2(c.re_re - c.im_im);
    let k = 2.0 * px_per_ohm;
    if series.style != SeriesStyle::Points || major.is_nan() || major * k <= 1.5 {
        return None;
    }
    let point = |i: u32| {
        let t = std::f64::consts::TAU * f64::from(i) / 48.0;
        let (a, b) = (k * major * t.cos(), k * minor * t.sin());
        // −Im points up and pixels down: the two signs cancel.
        (
            at.0 + a * angle.cos() - b * angle.sin(),
            at.1 + a * angle.sin() + b * angle.cos(),
        )
    };
    Some(Shape::Line {
        points: (0..=48).map(point).collect(),
        colour: palette(series.colour).faded(0.6),
        width: 1.0,
    })
}

/// Returns a vertical bar with caps between two heights; empty if the marker would hide it.
pub(super) fn bar(series: &Series, x: f64, heights: [f64; 2]) -> Vec<Shape> {
    let [y0, y1] = heights;
    if series.style != SeriesStyle::Points || (y1 - y0).is_nan() || (y1 - y0).abs() <= 3.0 {
        return Vec::new();
    }
    let line = |points| Shape::Line {
        points,
        colour: palette(series.colour).faded(0.8),
        width: 1.2,
    };
    let cap = |y| line(vec![(x - 3.5, y), (x + 3.5, y)]);
    vec![cap(y0), line(vec![(x, y0), (x, y1)]), cap(y1)]
}

/// Returns a line without the points that crowd: the backends draw joints closer than their width
/// as splinters.
pub(super) fn thinned(places: &[Place]) -> Vec<Place> {
    let mut kept: Vec<Place> = Vec::with_capacity(places.len());
    for place in places {
        match kept.last() {
            Some(last) if (place.0 - last.0).hypot(place.1 - last.1) < 2.0 => {}
            _ => kept.push(*place),
        }
    }
    if let (Some(last), true) = (places.last(), kept.len() > 1) {
        kept.pop();
        kept.push(*last);
    }
    kept
}
