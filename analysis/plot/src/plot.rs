//! Contents of an impedance plot, and the reasons why a plot is not made.

use std::{ops::RangeInclusive, path::PathBuf};

use analysis_numeric::Covariance2;
use num_complex::Complex64;

/// Points of a fitted curve over its band.
const CURVE_POINTS: u32 = 240;

/// Style of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeriesStyle {
    /// Markers, with 2σ if it is known.
    Points,
    /// Small, half transparent markers without σ: for many sweeps over each other.
    Cloud,
    /// A line without markers.
    Curve,
}

/// One point of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Impedance, Ω.
    pub z_ohm: Complex64,
    /// Its covariance, Ω²; not a number where unknown.
    pub covariance: Covariance2,
}

/// Points or a curve with a place in the legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Entry in the legend; none for a series that shares the entry of another.
    pub label: Option<String>,
    /// Index of colour and marker, counted modulo the palette.
    pub colour: usize,
    /// Style of the series.
    pub style: SeriesStyle,
    /// By rising frequency.
    pub points: Vec<SeriesPoint>,
}

impl Series {
    /// Measured points with 2σ, their name in the legend.
    pub fn data(name: &str, points: Vec<SeriesPoint>, colour: usize) -> Self {
        Self {
            label: Some(name.to_owned()),
            colour,
            style: SeriesStyle::Points,
            points,
        }
    }

    /// Any impedance in Ω as a curve over a band of frequencies in Hz, above zero.
    pub fn curve(
        label: &str,
        band_hz: RangeInclusive<f64>,
        colour: usize,
        impedance: impl Fn(f64) -> Complex64,
    ) -> Self {
        let (low_hz, high_hz) = band_hz.into_inner();
        let at = |k: u32| low_hz * (high_hz / low_hz).powf(f64::from(k) / f64::from(CURVE_POINTS));
        let point = |freq_hz| SeriesPoint {
            freq_hz,
            z_ohm: impedance(freq_hz),
            covariance: Covariance2::UNKNOWN,
        };
        Self {
            label: Some(label.to_owned()),
            colour,
            style: SeriesStyle::Curve,
            points: (0..=CURVE_POINTS).map(|k| point(at(k))).collect(),
        }
    }

    /// Returns the same in another style.
    #[must_use]
    pub fn styled(self, style: SeriesStyle) -> Self {
        Self { style, ..self }
    }

    /// Returns the same under another label, or none.
    #[must_use]
    pub fn labelled(self, label: Option<&str>) -> Self {
        Self {
            label: label.map(str::to_owned),
            ..self
        }
    }
}

/// Contents of an impedance plot, for Nyquist and Bode alike.
#[derive(Debug, Clone, PartialEq)]
pub struct ImpedancePlot {
    /// First line, bold.
    pub title: String,
    /// Second line; empty for none.
    pub subtitle: String,
    /// Drawn in this order, later over earlier.
    pub series: Vec<Series>,
    /// Width in pixels of an SVG at its natural size (a PNG has twice as many); kept within
    /// 320…4000. The height follows from the content.
    pub width_px: u32,
    /// Writes the frequency beside a point or two per decade of the Nyquist plot.
    pub mark_decades: bool,
}

impl ImpedancePlot {
    /// Creates a plot 900 pixels wide with marked decades.
    pub fn new(title: &str, subtitle: &str, series: Vec<Series>) -> Self {
        Self {
            title: title.to_owned(),
            subtitle: subtitle.to_owned(),
            series,
            width_px: 900,
            mark_decades: true,
        }
    }

    pub(super) fn check(&self) -> Result<(), PlotError> {
        let usable =
            |p: &SeriesPoint| p.z_ohm.is_finite() && p.freq_hz.is_finite() && p.freq_hz > 0.0;
        if self.series.iter().all(|s| s.points.is_empty()) {
            return Err(PlotError::NothingToShow {
                title: self.title.clone(),
            });
        }
        match self
            .series
            .iter()
            .flat_map(|s| &s.points)
            .find(|p| !usable(p))
        {
            Some(p) => Err(PlotError::BadPoint {
                title: self.title.clone(),
                freq_hz: p.freq_hz,
                z_ohm: p.z_ohm,
            }),
            None => Ok(()),
        }
    }
}

/// Reason why a plot was not made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlotError {
    /// No points in any series.
    #[error("plot \"{title}\": expected at least one point, met none")]
    NothingToShow {
        /// The plot's title.
        title: String,
    },
    /// A point that has no place on the axes.
    #[error(
        "plot \"{title}\": expected a finite impedance at a positive finite frequency, met {z_ohm} \
        Ω at {freq_hz} Hz"
    )]
    BadPoint {
        /// The plot's title.
        title: String,
        /// Frequency met, Hz.
        freq_hz: f64,
        /// Impedance met, Ω.
        z_ohm: Complex64,
    },
    /// A point of a chart that has no place on its axes.
    #[error(
        "chart \"{title}\", trace \"{trace}\": expected finite coordinates (above zero on a \
        logarithmic axis), met ({x}, {y})"
    )]
    BadCoordinates {
        /// The chart's title.
        title: String,
        /// The trace's label; empty if it has none.
        trace: String,
        /// Horizontal coordinate met.
        x: f64,
        /// Vertical coordinate met.
        y: f64,
    },
    /// A build without the feature `draw`.
    #[error("plot \"{title}\": expected a build with the feature `draw`, met one without")]
    NoBackend {
        /// The plot's title.
        title: String,
    },
    /// The file name does not have a known format.
    #[error("{}: expected a file name that ends in .svg or .png", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file could not be written.
    #[error("{}: expected to write a plot: {message}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error message of the operating system.
        message: String,
    },
    /// The drawing library failed.
    #[error("drawing a plot: {message}")]
    Draw {
        /// Message of the drawing library.
        message: String,
    },
}
