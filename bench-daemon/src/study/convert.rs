//! Hidden-effect data as a data set: what the diagnosis may see, and nothing else.

use analysis::{
    augmented::Between,
    contract::Below,
    diagnosis::{
        BaseModel, BenchHistory, DataSet, Fixture, Role, Run, RunData, Start, Sweep, SweepPoint,
        TimeRecord,
    },
    fit::{Bounds, FitOptions, Objective, fit_erm},
    numeric::Covariance2,
    ocv::OcvCurve,
    series::TimeSeries,
    spectrum::{ImpedancePoint, Spectrum},
};
use anyhow::Context;
use fixtures::hidden;
use num_complex::Complex64;

/// Runs of a case without seed, label or anything that tells.
pub fn data_set(case: &hidden::Case) -> DataSet {
    DataSet {
        name: "hidden".to_owned(),
        runs: case.runs.iter().map(run).collect(),
        history: Some(history(&case.history)),
        calibration: None,
    }
}

/// What the bench's history says.
fn history(h: &hidden::BenchHistory) -> BenchHistory {
    BenchHistory {
        voltage_noise_v: h.voltage_noise_v,
        voltage_resolution_v: h.voltage_resolution_v,
        voltage_offset_v: h.voltage_offset_v,
        voltage_drift_v: h.voltage_drift_v,
        voltage_drift_s: h.voltage_drift_s,
        resistance_rel: h.resistance_rel,
        current_gain_rel: h.current_gain_rel,
        current_offset_a: h.current_offset_a,
        current_noise_a: h.current_noise_a,
        current_resolution_a: h.current_resolution_a,
        eis_noise_rel: h.eis_noise_rel,
        start_voltage_v: 0.0,
        calibration_rel: 0.0,
        channel_gain_rel: 0.0,
    }
}

/// One run; currents turn from the file's sign to discharge positive.
pub fn run(run: &hidden::Run) -> Run {
    let fixture = match run.fixture {
        hidden::Fixture::Cell => Fixture::Cell("cell".to_owned()),
        hidden::Fixture::Shunt { ohm } => Fixture::Shunt(ohm),
        hidden::Fixture::FakeCell { ohm } => Fixture::FakeCell(ohm),
    };
    let data = match &run.data {
        hidden::RunData::Eis {
            points,
            amplitude_a,
        } => {
            let mut points: Vec<SweepPoint> = points
                .iter()
                .map(|(freq_hz, re, im)| SweepPoint {
                    freq_hz: *freq_hz,
                    z_ohm: Complex64::new(*re, *im),
                    sigma_ohm: None,
                    amplitude_a: Some(*amplitude_a),
                })
                .collect();
            points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
            RunData::Eis(Sweep {
                bias_a: 0.0,
                below: Below::default(),
                elapsed_s: Vec::new(),
                points,
            })
        }
        hidden::RunData::Time {
            time_s,
            current_a,
            voltage_v,
            temperature_c,
        } => {
            let series = TimeSeries {
                name: run.name.clone(),
                time_s: time_s.clone(),
                current_a: current_a.iter().map(|i| -i).collect(),
                voltage_v: voltage_v.clone(),
                temperature_c: temperature_c.clone(),
            };
            RunData::Time(TimeRecord {
                series,
                between: Between::Hold,
                compared_from_s: 0.0,
                level_sigma_v: 0.0,
                sigma_v: None,
                averaged_s: None,
            })
        }
    };
    Run {
        name: run.name.clone(),
        fixture,
        role: if run.held_out {
            Role::HeldOut
        } else {
            Role::Train
        },
        repeat_group: run.repeat_group.clone(),
        order: run.order as u32,
        start_s: run.start_s,
        temperature_c: run.temperature_c,
        start: Start::Soc(run.start_soc),
        data,
    }
}

/// The model that a user would have: an ERM fitted to the training sweeps, with the curve of the
/// cell's data sheet.
pub fn model(set: &DataSet, base: &hidden::TrueBase) -> anyhow::Result<BaseModel> {
    let (soc, ocv_v) = base.ocv.iter().copied().unzip();
    let ocv = OcvCurve::monotone(base.capacity_ah, soc, ocv_v)?;
    let spectra: Vec<Spectrum> = set
        .runs
        .iter()
        .filter(|r| r.role == Role::Train)
        .filter_map(spectrum)
        .collect();
    let options = FitOptions {
        rc: base.branches.len(),
        objective: Objective::Complex,
        bounds: Bounds::for_spectra(&spectra),
        seed: 1,
    };
    let fit = fit_erm(&spectra, &options).context("fit of the training sweeps")?;
    Ok(BaseModel {
        name: "model".to_owned(),
        erm: fit.erm,
        ocv,
    })
}

fn spectrum(run: &Run) -> Option<Spectrum> {
    let RunData::Eis(sweep) = &run.data else {
        return None;
    };
    let covariance = Covariance2 {
        re_re: f64::NAN,
        re_im: f64::NAN,
        im_im: f64::NAN,
    };
    let point = |p: &SweepPoint| ImpedancePoint {
        freq_hz: p.freq_hz,
        z_ohm: p.z_ohm,
        covariance,
        amplitude_a: p.amplitude_a.unwrap_or(f64::NAN),
    };
    Some(Spectrum {
        name: run.name.clone(),
        points: sweep.points.iter().map(point).collect(),
        ..Spectrum::default()
    })
}
