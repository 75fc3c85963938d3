//! Any picture that is described before it is drawn.

use super::{BarChart, Chart, HeatMap, PlotError, bars, chart, heat, scene::Scene};
use std::path::Path;

/// A described picture, whatever its kind.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawing {
    /// Panels of traces.
    Chart(Chart),
    /// Rows of bars.
    Bars(BarChart),
    /// A coloured matrix.
    Heat(HeatMap),
}

impl Drawing {
    /// Returns the text of an SVG.
    ///
    /// # Errors
    /// [`PlotError`] for nothing to show or values without a place on their axes.
    pub fn svg(&self) -> Result<String, PlotError> {
        self.layout()?.to_svg()
    }

    /// Writes a `.svg` or `.png` file.
    ///
    /// # Errors
    /// As [`Drawing::svg`]; another file name, or a file that cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), PlotError> {
        self.layout()?.write(path)
    }

    fn layout(&self) -> Result<Scene, PlotError> {
        match self {
            Self::Chart(c) => chart::layout(c),
            Self::Bars(b) => bars::layout(b),
            Self::Heat(h) => heat::layout(h),
        }
    }
}
