//! Fitted models of a run over one of its spectra: their lines, and what they leave of each point
//! in standard deviations.

use std::path::Path;

use analysis::{fit::ModelFile, run_folder};
use serde::Serialize;
use utoipa::ToSchema;

use super::spectra::{self, Spectrum};
use crate::support::confined_path;

/// Points of a line per decade of frequency.
const PER_DECADE: f64 = 30.0;

/// A model over a spectrum.
#[derive(Debug, Serialize, ToSchema)]
pub struct ModelOver {
    /// Its name in words.
    name: String,
    /// Its file, without the ending.
    file: String,
    /// Number of its RC pairs.
    order: usize,
    /// The spectrum.
    spectrum: String,
    /// Its impedance over the frequencies of the spectrum.
    line: Vec<LinePoint>,
    /// Measured minus model, in standard deviations of the points that state one.
    residuals: Vec<Residual>,
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

/// All models of a run over the spectrum of this name, the highest order first; none where the run
/// has no such spectrum.
pub fn over(folder: &Path, spectrum: &str) -> Option<Vec<ModelOver>> {
    let file = format!("{spectrum}.csv");
    if !spectra::stamps(folder).contains_key(&file) {
        return None;
    }
    let spectrum = spectra::read(folder, &file)?;
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut models: Vec<ModelOver> = names
        .filter(|name| run_folder::is_model(name))
        .filter_map(|name| {
            let file = confined_path::open(folder, &name)?;
            Some(of(&name, &serde_json::from_reader(file).ok()?, &spectrum))
        })
        .collect();
    models.sort_by(|a, b| b.order.cmp(&a.order).then(a.file.cmp(&b.file)));
    Some(models)
}

fn of(file: &str, model: &ModelFile, spectrum: &Spectrum) -> ModelOver {
    let erm = &model.fit.erm;
    let line = || {
        let (first, last) = (spectrum.points.first()?.freq_hz, spectrum.points.last()?.freq_hz);
        let count = (PER_DECADE * (last / first).log10()).ceil().max(1.0);
        let at = |k: usize| first * (last / first).powf(k as f64 / count);
        let point = |freq_hz: f64| {
            let z = erm.impedance(freq_hz);
            LinePoint { freq_hz, re_ohm: z.re, im_ohm: z.im }
        };
        Some((0..=count as usize).map(|k| point(at(k))).collect())
    };
    let residual = |point: &spectra::Point| {
        let z = erm.impedance(point.freq_hz);
        Some(Residual {
            freq_hz: point.freq_hz,
            re_sigmas: (point.re_ohm - z.re) / point.re_sigma_ohm.filter(|sigma| *sigma > 0.0)?,
            im_sigmas: (point.im_ohm - z.im) / point.im_sigma_ohm.filter(|sigma| *sigma > 0.0)?,
        })
    };
    ModelOver {
        name: format!("ERM, {} RC", erm.branches.len()),
        file: file.trim_end_matches(".json").to_owned(),
        order: erm.branches.len(),
        spectrum: spectrum.name.clone(),
        line: line().unwrap_or_default(),
        residuals: spectrum.points.iter().filter_map(residual).collect(),
    }
}
