//! A laid-out plot: shapes in logical pixels. Knows nothing of impedance, and of no library that
//! draws.

/// Red, green, blue, and opacity 0…1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Colour(pub(super) u8, pub(super) u8, pub(super) u8, pub(super) f64);

impl Colour {
    pub(super) fn faded(self, opacity: f64) -> Self {
        Self(self.0, self.1, self.2, opacity)
    }
}

/// A place in logical pixels, from the upper left.
pub(super) type Place = (f64, f64);

/// Point of a text that lies at its position: its centre, or the middle or corner of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Anchor {
    Left,
    Centre,
    Right,
    TopLeft,
    Top,
}

/// Words at a place.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Label {
    pub(super) text: String,
    pub(super) at: Place,
    /// Em, logical pixels.
    pub(super) size: f64,
    pub(super) colour: Colour,
    pub(super) bold: bool,
    /// Read from below to above.
    pub(super) upright: bool,
    pub(super) anchor: Anchor,
}

/// Shapes that can be drawn.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    Line {
        points: Vec<Place>,
        colour: Colour,
        width: f64,
    },
    Area {
        points: Vec<Place>,
        colour: Colour,
    },
    Disc {
        at: Place,
        radius: f64,
        colour: Colour,
    },
    Label(Label),
}

/// A plot ready to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scene {
    pub(super) title: String,
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) shapes: Vec<Shape>,
}

/// Returns the text as XML wants it.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
