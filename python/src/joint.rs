//! Models from spectra and pulses together.

use analysis::joint::{JointOptions, Role, Study, StudyInput, StudyOptions, study};
use analysis::spectrum::{SourcedSpectrum, Spectrum as Points};
use pyo3::prelude::*;

use crate::error::{apart, json};
use crate::model::Model;
use crate::series::{Columns, Curve};
use crate::spectrum::Spectrum;

/// Wishes for a joint fit, as Python gives them.
#[derive(FromPyObject)]
pub(crate) struct JointWishes {
    rc: Option<usize>,
    at_v: f64,
    within_v: f64,
    dcir_ohm: f64,
    seed: u64,
}

/// A study, and the gaps that its print gives too: by the spectra alone, by the joint model, V.
#[derive(serde::Serialize)]
struct Answer<'a> {
    #[serde(flatten)]
    study: &'a Study,
    fitted_rms_v: Option<(f64, f64)>,
    held_out_rms_v: Option<(f64, f64)>,
}

/// Of a pulse: time since its edge, s, and voltages less that before it, V: measured, by the
/// spectra's model, by the joint one.
type Overlay = Vec<[f64; 4]>;

#[pyfunction]
pub(crate) fn joint(
    py: Python<'_>,
    spectra: Vec<Spectrum>,
    series: Columns<'_>,
    curve: Curve<'_>,
    wishes: JointWishes,
) -> PyResult<(String, Model, Vec<Overlay>)> {
    let sourced: Vec<SourcedSpectrum> = spectra.into_iter().map(|s| s.sourced).collect();
    let plain: Vec<Points> = sourced.iter().map(|one| one.spectrum.clone()).collect();
    let series = series.series("series")?;
    let curve = curve.read()?;
    let options = StudyOptions {
        ocv_window_v: (wishes.at_v, wishes.within_v),
        dcir_ohm: wishes.dcir_ohm,
        rc: wishes.rc,
        fit: JointOptions::for_spectra(&plain, wishes.seed),
    };
    apart(py, || {
        let input = StudyInput {
            spectra: &sourced,
            series: &series,
            curve: &curve,
        };
        let (study, _) = study(&input, &options).map_err(|error| error.to_string())?;
        let fit = study.joint().ok_or("no order was fitted")?;
        let model = Model::of("joint", fit.erm.clone(), curve.clone())?;
        let overlays = study.pulses.iter().map(|pulse| pulse.overlay.clone());
        let overlays = overlays.collect();
        let answer = Answer {
            fitted_rms_v: study.rms_v(Role::Fitted),
            held_out_rms_v: study.rms_v(Role::HeldOut),
            study: &study,
        };
        Ok((json(&answer)?, model, overlays))
    })
}
