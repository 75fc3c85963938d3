//! Spectra and fitted models in the format of the page's chart, and that chart within a report.

use analysis::{fit::ErmFit, report::Scripted, spectrum::ImpedancePoint};
use base64::{Engine, prelude::BASE64_STANDARD};
use serde::Serialize;
use utoipa::ToSchema;

use bench_plan::support::hash;

/// Points of a model's line per decade of frequency.
const PER_DECADE: f64 = 30.0;

/// A point of a spectrum.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Point {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Real part, Ω.
    pub re_ohm: f64,
    /// Imaginary part, Ω; negative for a capacitive one.
    pub im_ohm: f64,
    /// Standard uncertainty of the real part, Ω; null if unknown.
    pub re_sigma_ohm: Option<f64>,
    /// Standard uncertainty of the imaginary part, Ω.
    pub im_sigma_ohm: Option<f64>,
    /// Reason of the quality gate for a refusal; null for an accepted point.
    pub verdict: Option<String>,
}

impl From<&ImpedancePoint> for Point {
    fn from(point: &ImpedancePoint) -> Self {
        let sigma = |variance: f64| Some(variance.sqrt()).filter(|sigma| sigma.is_finite());
        Self {
            freq_hz: point.freq_hz,
            re_ohm: point.z_ohm.re,
            im_ohm: point.z_ohm.im,
            re_sigma_ohm: sigma(point.covariance.re_re),
            im_sigma_ohm: sigma(point.covariance.im_im),
            verdict: None,
        }
    }
}

/// A fitted model over the frequencies of a spectrum.
#[derive(Debug, Serialize, ToSchema)]
pub struct ModelOver {
    /// Display name.
    pub name: String,
    /// File name, without extension.
    pub file: String,
    /// Number of RC pairs.
    pub order: usize,
    /// Whether it is recommended among the models of the run.
    pub recommended: bool,
    /// Name of the spectrum.
    #[serde(rename = "spectrum")]
    pub curve: String,
    /// Impedance of the model over the frequencies of the spectrum, as it would be measured:
    /// including the slope of the open-circuit voltage if the fit has one.
    pub line: Vec<LinePoint>,
    /// Measured minus model, in standard deviations, for points with a stated uncertainty.
    pub residuals: Vec<Residual>,
}

/// Impedance of a model at a frequency.
#[derive(Debug, Serialize, ToSchema)]
pub struct LinePoint {
    /// Frequency, Hz.
    freq_hz: f64,
    /// Real part, Ω.
    re_ohm: f64,
    /// Imaginary part, Ω.
    im_ohm: f64,
}

/// Measured minus model.
#[derive(Debug, Serialize, ToSchema)]
pub struct Residual {
    /// Frequency, Hz.
    freq_hz: f64,
    /// Of the real part, in its standard deviations.
    re_sigmas: f64,
    /// Of the imaginary part, in its standard deviations.
    im_sigmas: f64,
}

impl ModelOver {
    /// A fit over a spectrum, whose points rise in frequency.
    pub fn new(fit: &ErmFit, file: &str, curve: &str, points: &[Point]) -> Self {
        let order = fit.erm.branches.len();
        let line = || {
            let (first, last) = (points.first()?.freq_hz, points.last()?.freq_hz);
            let count = (PER_DECADE * (last / first).log10()).ceil().max(1.0);
            let at = |k: usize| first * (last / first).powf(k as f64 / count);
            let point = |freq_hz: f64| {
                let z = fit.impedance(freq_hz);
                LinePoint {
                    freq_hz,
                    re_ohm: z.re,
                    im_ohm: z.im,
                }
            };
            Some((0..=count as usize).map(|k| point(at(k))).collect())
        };
        let residual = |point: &Point| {
            let z = fit.impedance(point.freq_hz);
            let positive = |sigma: Option<f64>| sigma.filter(|sigma| *sigma > 0.0);
            Some(Residual {
                freq_hz: point.freq_hz,
                re_sigmas: (point.re_ohm - z.re) / positive(point.re_sigma_ohm)?,
                im_sigmas: (point.im_ohm - z.im) / positive(point.im_sigma_ohm)?,
            })
        };
        Self {
            name: format!("ERM, {order} RC"),
            file: file.to_owned(),
            order,
            recommended: false,
            curve: curve.to_owned(),
            line: line().unwrap_or_default(),
            residuals: points.iter().filter_map(residual).collect(),
        }
    }

    /// Returns the model with the mark whether it is recommended.
    #[must_use]
    pub fn marked(self, recommended: bool) -> Self {
        Self {
            recommended,
            ..self
        }
    }

    /// Returns its place among the models of a run: the recommended one first, then the highest
    /// order.
    pub fn place(&self) -> (bool, std::cmp::Reverse<usize>) {
        (!self.recommended, std::cmp::Reverse(self.order))
    }
}

/// A curve of the chart.
#[derive(Debug, Serialize)]
pub(crate) struct Curve {
    /// Name of it among the others.
    pub id: String,
    /// Name that is shown.
    pub name: String,
    /// Index of its mark and colour.
    pub index: usize,
    /// Whether the harness has been subtracted.
    pub corrected: bool,
    /// Its points by rising frequency.
    pub points: Vec<Point>,
}

/// Curves and models as the chart takes them.
#[derive(Debug, Serialize)]
struct Data<'a> {
    curves: &'a [Curve],
    models: Vec<ModelOfCurve<'a>>,
    controls: [(); 0],
}

#[derive(Debug, Serialize)]
struct ModelOfCurve<'a> {
    #[serde(flatten)]
    model: &'a ModelOver,
    curve: &'a str,
}

/// The libraries and the chart, as the page has them.
const D3: &str = include_str!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../vendor/d3/d3.min.js"
));
const CHART: &str = include_str!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../serve/src/page/curves.js"
));
const STYLE: &str = include_str!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../serve/src/page/style.css"
));
const CHART_STYLE: &str = include_str!(concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../serve/src/page/curves.css"
));
/// Draws the data of the report.
const DRAW: &str = "eisCurves.panel(document.getElementById('scripted'), {})\
.show(JSON.parse(document.getElementById('scripted-data').textContent));";

/// The chart as a part of a report. It holds its libraries, and runs nothing else.
pub(crate) fn scripted(curves: &[Curve], models: &[ModelOver]) -> Scripted {
    let data = Data {
        curves,
        models: models
            .iter()
            .map(|model| ModelOfCurve {
                model,
                curve: &model.curve,
            })
            .collect(),
        controls: [],
    };
    let scripts = [D3, CHART, DRAW].map(str::to_owned);
    let hashes: Vec<String> = scripts
        .iter()
        .map(|script| format!("'sha256-{}'", BASE64_STANDARD.encode(hash::digest(script))))
        .collect();
    // Of the page's style the variables alone: the chart takes its colours from them.
    let variables = STYLE.split("* { box-sizing").next().unwrap_or_default();
    Scripted {
        heading: "Spectra to look into".to_owned(),
        words:
            "Drawn by scripts within this file, which load nothing. Without scripts the figures \
                below show the same."
                .to_owned(),
        style: format!("{variables}{CHART_STYLE}"),
        policy: format!(
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src {}",
            hashes.join(" ")
        ),
        scripts: scripts.into(),
        data: serde_json::to_string(&data).unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_policy_names_every_script_and_no_script_ends_early() {
        let part = scripted(&[], &[]);
        assert_eq!(part.policy.matches("'sha256-").count(), part.scripts.len());
        assert!(
            part.scripts
                .iter()
                .all(|script| !script.contains("</script"))
        );
        assert!(part.style.contains("--c0") && !part.style.contains("<"));
    }
}
