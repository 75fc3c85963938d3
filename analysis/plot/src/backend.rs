//! Draws a scene with plotters.

use super::PlotError;
use super::scene::{Anchor, Colour, Label, Place, Scene, Shape, escape};
use plotters::prelude::{
    BitMapBackend, Color, DrawingBackend, FontDesc, FontFamily, FontStyle, FontTransform,
    RGBAColor, SVGBackend, ShapeStyle, TextStyle,
};
use plotters::style::register_font;
use plotters::style::text_anchor;
use std::path::Path;
use std::sync::OnceLock;

/// Backends support whole units only: an SVG is drawn larger by this factor and scaled down, so
/// that curves stay smooth.
const SVG_SCALE: f64 = 4.0;
/// Pixels of a PNG per logical pixel.
const PNG_SCALE: usize = 2;
/// A PNG is drawn this much larger still and averaged: plotters smooths only hairlines.
const OVERSAMPLING: usize = 2;
const FONT: &str = "sans-serif";

impl Scene {
    /// Writes by the file name's ending.
    pub(super) fn write(&self, path: &Path) -> Result<(), PlotError> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("svg") => {
                let failed = |e: std::io::Error| PlotError::Write {
                    path: path.to_owned(),
                    message: e.to_string(),
                };
                std::fs::write(path, self.to_svg()?).map_err(failed)
            }
            Some("png") => self.write_png(path),
            _ => Err(PlotError::UnknownFormat {
                path: path.to_owned(),
            }),
        }
    }

    pub(super) fn to_svg(&self) -> Result<String, PlotError> {
        ensure_font()?;
        let size = self.size(SVG_SCALE);
        let mut text = String::new();
        self.draw(&mut SVGBackend::with_string(&mut text, size), &Pen::SVG)?;
        let drawn = format!("<svg width=\"{}\" height=\"{}\"", size.0, size.1);
        let title = escape(&self.title);
        let shown = format!(
            "<svg role=\"img\" aria-label=\"{title}\" width=\"{}\" height=\"{}\"",
            self.width.round(),
            self.height.round()
        );
        Ok(text.replacen(&drawn, &shown, 1))
    }

    fn write_png(&self, path: &Path) -> Result<(), PlotError> {
        ensure_font()?;
        let (width, height) = self.size(PNG_SCALE as f64);
        let (w, h) = (width as usize, height as usize);
        let fine_width = w * OVERSAMPLING;
        let mut fine = vec![255u8; fine_width * h * OVERSAMPLING * 3];
        let fine_size = (width * OVERSAMPLING as u32, height * OVERSAMPLING as u32);
        self.draw(
            &mut BitMapBackend::with_buffer(&mut fine, fine_size),
            &Pen::PNG,
        )?;
        let mut averaged = Vec::with_capacity(w * h * 3);
        for i in 0..w * h * 3 {
            let (row, column, channel) =
                (i / (3 * w) * OVERSAMPLING, i / 3 % w * OVERSAMPLING, i % 3);
            let start = (row * fine_width + column) * 3 + channel;
            let block = (0..OVERSAMPLING * OVERSAMPLING)
                .map(|k| (k / OVERSAMPLING * fine_width + k % OVERSAMPLING) * 3);
            let sum: u32 = block
                .map(|offset| fine.get(start + offset).copied().map_or(255, u32::from))
                .sum();
            averaged.push((sum / (OVERSAMPLING * OVERSAMPLING) as u32) as u8);
        }
        let failed = |e: String| PlotError::Write {
            path: path.to_owned(),
            message: e,
        };
        let mut file = BitMapBackend::new(path, (width, height));
        file.blit_bitmap((0, 0), (width, height), &averaged)
            .map_err(|e| failed(e.to_string()))?;
        file.present().map_err(|e| failed(e.to_string()))
    }

    fn size(&self, scale: f64) -> (u32, u32) {
        (
            (self.width * scale).round() as u32,
            (self.height * scale).round() as u32,
        )
    }

    fn draw<B: DrawingBackend>(&self, backend: &mut B, pen: &Pen) -> Result<(), PlotError> {
        let (w, h) = self.size(pen.scale);
        let white = ShapeStyle::from(&RGBAColor(255, 255, 255, 1.0)).filled();
        drawn(backend.draw_rect((0, 0), (w as i32, h as i32), &white, true))?;
        for shape in &self.shapes {
            draw_shape(backend, shape, pen)?;
        }
        drawn(backend.present())
    }
}

fn draw_shape<B: DrawingBackend>(
    backend: &mut B,
    shape: &Shape,
    pen: &Pen,
) -> Result<(), PlotError> {
    let whole = |length: f64| (length * pen.scale).round().max(1.0) as u32;
    let style = |c: &Colour, width: f64| ShapeStyle::from(&rgba(*c)).stroke_width(whole(width));
    let place = |p: &Place| pen.place(p);
    match shape {
        Shape::Line {
            points,
            colour,
            width,
        } => {
            let mut placed: Vec<(i32, i32)> = points.iter().map(place).collect();
            placed.dedup();
            drawn(backend.draw_path(placed, &style(colour, *width)))
        }
        Shape::Area { points, colour } => {
            drawn(backend.fill_polygon(points.iter().map(place), &style(colour, 1.0).filled()))
        }
        Shape::Disc { at, radius, colour } => drawn(backend.draw_circle(
            place(at),
            whole(*radius),
            &style(colour, 1.0).filled(),
            true,
        )),
        Shape::Label(label) => draw_label(backend, label, pen),
    }
}

fn draw_label<B: DrawingBackend>(
    backend: &mut B,
    label: &Label,
    pen: &Pen,
) -> Result<(), PlotError> {
    let transform = if label.upright {
        FontTransform::Rotate270
    } else {
        FontTransform::None
    };
    let weight = if label.bold {
        FontStyle::Bold
    } else {
        FontStyle::Normal
    };
    let font = FontDesc::new(
        FontFamily::SansSerif,
        label.size * pen.scale * pen.size_per_em,
        weight,
    )
    .transform(transform);
    let colour = rgba(label.colour);
    let style = TextStyle::from(font)
        .color(&colour)
        .pos(anchor(label.anchor));
    let [top, centre] = pen.sink_em;
    let sink = label.size
        * match label.anchor {
            Anchor::TopLeft | Anchor::Top => top,
            Anchor::Left | Anchor::Centre | Anchor::Right => centre,
        };
    let at = if label.upright {
        (label.at.0 + sink, label.at.1)
    } else {
        (label.at.0, label.at.1 + sink)
    };
    drawn(backend.draw_text(&label.text, &style, pen.place(&at)))
}

fn anchor(anchor: Anchor) -> text_anchor::Pos {
    use text_anchor::{HPos, VPos};
    let (h, v) = match anchor {
        Anchor::Left => (HPos::Left, VPos::Center),
        Anchor::Centre => (HPos::Center, VPos::Center),
        Anchor::Right => (HPos::Right, VPos::Center),
        Anchor::TopLeft => (HPos::Left, VPos::Top),
        Anchor::Top => (HPos::Center, VPos::Top),
    };
    text_anchor::Pos::new(h, v)
}

fn rgba(c: Colour) -> RGBAColor {
    plotters::style::RGBColor(c.0, c.1, c.2).mix(c.3)
}

/// Parameters that make a backend draw what a scene means.
struct Pen {
    /// Backend units per logical pixel.
    scale: f64,
    /// The library's font size for one em.
    size_per_em: f64,
    /// How much lower than the library's default, in em, a text must be placed so that its capitals
    /// lie below or about its position: for the two vertical anchors.
    sink_em: [f64; 2],
}

impl Pen {
    /// The library divides sizes by 1.24 and shifts with `dy`; capitals of a sans-serif are 0.73 em
    /// high.
    const SVG: Self = Self {
        scale: SVG_SCALE,
        size_per_em: 1.24,
        sink_em: [0.0, 0.09],
    };
    /// The library takes the size for ascent plus descent, 1.164 em in DejaVu, and sets the
    /// baseline half of it below the upper edge.
    const PNG: Self = Self {
        scale: (PNG_SCALE * OVERSAMPLING) as f64,
        size_per_em: 1.164,
        sink_em: [0.18, 0.25],
    };

    fn place(&self, p: &Place) -> (i32, i32) {
        (
            (p.0 * self.scale).round() as i32,
            (p.1 * self.scale).round() as i32,
        )
    }
}

/// Returns the library's complaint as ours.
fn drawn<E: std::fmt::Display>(result: Result<(), E>) -> Result<(), PlotError> {
    result.map_err(|e| PlotError::Draw {
        message: e.to_string(),
    })
}

/// Returns the width of a text in logical pixels, about.
pub(super) fn text_width(text: &str, size: f64) -> Result<f64, PlotError> {
    ensure_font()?;
    let (width, _) = FontDesc::new(
        FontFamily::SansSerif,
        size * 8.0 * Pen::PNG.size_per_em,
        FontStyle::Normal,
    )
    .box_size(text)
    .map_err(|e| PlotError::Draw {
        message: e.to_string(),
    })?;
    Ok(f64::from(width) / 8.0)
}

/// Registers the embedded font once per process: without it a PNG has no letters and plotters
/// panics.
fn ensure_font() -> Result<(), PlotError> {
    static DONE: OnceLock<bool> = OnceLock::new();
    let register = || {
        register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok()
            && register_font(FONT, FontStyle::Bold, dejavu::sans::bold()).is_ok()
    };
    if *DONE.get_or_init(register) {
        Ok(())
    } else {
        Err(PlotError::Draw {
            message: "the embedded font is not usable".to_owned(),
        })
    }
}
