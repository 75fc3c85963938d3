//! Nyquist and Bode plots of measured and modelled impedance, general charts, bars and heat maps,
//! SVG and PNG from one description.
//!
//! A plot is first laid out as a list of shapes (`scene`), which plotters' backends then draw
//! (`backend`), so both formats show the same picture. Without the feature `draw` plotters is not
//! built, and drawing is an error. The Nyquist plot has equal scaling of its axes, exact to the
//! pixel, as figures 3.8 and 3.11–3.14 of the thesis. The legend stands above the axes and hides
//! nothing. Colours are those of Okabe and Ito (2008), which colour-blind readers can distinguish;
//! marker shapes differ too.
//!
//! PNG and text widths use DejaVu Sans, embedded through the `dejavu` crate (MIT or Apache-2.0; the
//! font under the Bitstream Vera licence, which allows embedding). SVG asks the viewer for its own
//! sans-serif.

mod axis;
#[cfg(feature = "draw")]
mod backend;
#[cfg(not(feature = "draw"))]
#[path = "undrawn.rs"]
mod backend;
mod bars;
mod bode;
mod chart;
mod drawing;
mod frame;
mod heat;
mod marks;
mod nyquist;
mod plot;
pub mod report;
mod scene;

pub use bars::{Bar, BarChart, BarGroup, BarPanel, BarRow, Reference};
pub use chart::{AxisSpec, Chart, Panel, Trace, TraceStyle, chart, chart_svg};
pub use drawing::Drawing;
pub use heat::{HeatMap, HeatScale};

pub use plot::{ImpedancePlot, PlotError, Series, SeriesPoint, SeriesStyle};
use std::path::Path;

/// Writes a Nyquist plot (−Im against Re, equal scaling) to a `.svg` or `.png` file.
///
/// # Errors
/// [`PlotError`] for nothing to show, points that are not finite, another file name, or a file that
/// cannot be written.
pub fn nyquist(plot: &ImpedancePlot, path: &Path) -> Result<(), PlotError> {
    plot.check()?;
    nyquist::layout(plot)?.write(path)
}

/// Returns a Nyquist plot as the text of an SVG.
///
/// # Errors
/// As [`nyquist`], but for the file.
pub fn nyquist_svg(plot: &ImpedancePlot) -> Result<String, PlotError> {
    plot.check()?;
    nyquist::layout(plot)?.to_svg()
}

/// Writes a Bode plot (|Z| and phase over log frequency) to a `.svg` or `.png` file.
///
/// # Errors
/// As [`nyquist`].
pub fn bode(plot: &ImpedancePlot, path: &Path) -> Result<(), PlotError> {
    plot.check()?;
    bode::layout(plot)?.write(path)
}

/// Returns a Bode plot as the text of an SVG.
///
/// # Errors
/// As [`nyquist`], but for the file.
pub fn bode_svg(plot: &ImpedancePlot) -> Result<String, PlotError> {
    plot.check()?;
    bode::layout(plot)?.to_svg()
}

#[cfg(all(test, feature = "draw"))]
mod tests;
