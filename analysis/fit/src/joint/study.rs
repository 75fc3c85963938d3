//! Comparison of the orders, from spectra alone and from spectra and pulses: prediction of the
//! pulses that were fitted, held out, or measured at other states of charge.

use super::fit::{
    JointError, JointFit, JointInput, JointOptions, choose_order, fit_joint, fit_spectra,
};
use super::gap::{Gap, Source, gaps, overlay};
use super::noise::NoiseModel;
use super::pooled::{PooledError, PooledSpectrum};
use super::pulse::{Pulse, PulseOptions, SLOWEST_EDGE_S, find_pulses};
use super::window::{PulseWindow, WindowOptions};
use analysis_model::ocv::{OcvCurve, REST_SIGMA_V, SLOPE_SHARE};
use analysis_signal::{
    series::TimeSeries,
    spectrum::{OcvSlope, SourcedSpectrum},
};
use serde::{Deserialize, Serialize};

/// Times after the edge at which pulses are compared, s.
pub const TIMES_S: [f64; 3] = [0.2, 2.4, 10.0];
/// Highest order tried when the order is to be found.
const HIGHEST: usize = 6;

/// Data of the study.
#[derive(Debug, Clone, Copy)]
pub struct StudyInput<'a> {
    /// Sweeps of cells without bias.
    pub spectra: &'a [SourcedSpectrum],
    /// A series with pulses.
    pub series: &'a TimeSeries,
    /// The OCV curve.
    pub curve: &'a OcvCurve,
}

/// How.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StudyOptions {
    /// Middle and half width of the OCV range whose pulses are used, V: where the spectra were
    /// measured.
    pub ocv_window_v: (f64, f64),
    /// Resistance that the voltage before a pulse is brought to OCV with, Ω: that of the OCV
    /// curve's compensation.
    pub dcir_ohm: f64,
    /// Order; `None` to choose it.
    pub rc: Option<usize>,
    /// Options of the fits; their order is set here.
    pub fit: JointOptions,
}

/// Use of a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// In the joint fit.
    Fitted,
    /// In the OCV range, but kept from the fit.
    HeldOut,
    /// At another OCV: for information only.
    Outside,
}

/// One order from both kinds of data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrderResult {
    /// RC branches.
    pub rc: usize,
    /// From spectra alone.
    pub spectra: JointFit,
    /// From spectra and pulses.
    pub joint: JointFit,
}

/// One pulse under both models.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PulseResult {
    /// Use of the pulse.
    pub role: Role,
    /// From its first edge to its second, s.
    pub length_s: f64,
    /// The model of the spectra alone.
    pub spectra: Gap,
    /// The joint model.
    pub joint: Gap,
    /// Time since the edge, s; voltage less that before it, V: measured, by the spectra's model, by
    /// the joint model. For pictures.
    #[serde(skip)]
    pub overlay: Vec<[f64; 4]>,
}

/// The comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Study {
    /// By rising order.
    pub orders: Vec<OrderResult>,
    /// Order of the joint model.
    pub rc: usize,
    /// Order of the model of the spectra alone.
    pub spectra_rc: usize,
    /// By their place in the series.
    pub pulses: Vec<PulseResult>,
    /// Sweeps and cells pooled.
    pub sweeps_cells: (usize, usize),
    /// Relative spread of the cells' factor: the pulses' cell is not known to be one of them.
    pub cell_spread: Option<f64>,
    /// Source of the spectra's uncertainty, in words.
    pub spectra_basis: String,
    /// Standard deviation of one voltage sample, and of the mean of any number of them, V.
    pub noise_v: (f64, f64),
    /// Warnings to the user, in sentences.
    pub warnings: Vec<String>,
}

/// Reason why a comparison cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StudyError {
    /// Spectra that cannot be pooled.
    #[error(transparent)]
    Pooled(#[from] PooledError),
    /// A fit that cannot be made.
    #[error(transparent)]
    Fit(#[from] JointError),
    /// No pulses to fit.
    #[error(
        "{series}: expected a pulse of 1 to 60 s at {low:.3} to {high:.3} V OCV with half a minute \
        of steady current around it, met {met} pulses, at {at}"
    )]
    NoPulses {
        /// Name of the series.
        series: String,
        /// Lower end of the range, V.
        low: f64,
        /// Upper end of the range, V.
        high: f64,
        /// Number of pulses at any OCV.
        met: usize,
        /// Their OCVs.
        at: String,
    },
    /// The samples do not resolve the edges of the current's steps.
    #[error(
        "{series}: expected samples at most {SLOWEST_EDGE_S} s apart around the edges of a pulse, \
        met {met_s} s at its {count} steps of the current: they contain nothing about the first \
        second; record the pulses faster (0.1 s shows all), or use the record as a slow discharge, \
        for --ocv-from"
    )]
    Unseen {
        /// Name of the series.
        series: String,
        /// Shortest time between the samples next to an edge, s.
        met_s: f64,
        /// Number of such steps.
        count: usize,
    },
    /// No steady stretch to measure the noise on.
    #[error(
        "{series}: expected a stretch of steady current of at least 256 samples before a pulse to \
        measure the noise on, met none"
    )]
    NoBaseline {
        /// Name of the series.
        series: String,
    },
}

impl Study {
    /// Result of the order of the joint model.
    pub fn joint(&self) -> Option<&JointFit> {
        self.orders
            .iter()
            .find(|o| o.rc == self.rc)
            .map(|o| &o.joint)
    }

    /// Result of the spectra alone at their order.
    pub fn spectra(&self) -> Option<&JointFit> {
        self.orders
            .iter()
            .find(|o| o.rc == self.spectra_rc)
            .map(|o| &o.spectra)
    }

    /// Root mean square gap over the pulses of a role, V: spectra alone, joint. None without such
    /// pulses.
    pub fn rms_v(&self, role: Role) -> Option<(f64, f64)> {
        let of: Vec<&PulseResult> = self.pulses.iter().filter(|p| p.role == role).collect();
        let mean = |f: &dyn Fn(&PulseResult) -> f64| {
            (of.iter().map(|p| f(p).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
        };
        (!of.is_empty()).then(|| (mean(&|p| p.spectra.rms_v), mean(&|p| p.joint.rms_v)))
    }
}

/// Runs the comparison: every second pulse of the range is held out.
///
/// # Errors
/// [`StudyError`] for spectra that do not belong together, a series without pulses in the range, or
/// an order that cannot be.
pub fn study(
    input: &StudyInput<'_>,
    options: &StudyOptions,
) -> Result<(Study, PooledSpectrum), StudyError> {
    let slope = input
        .curve
        .charge_slope(options.ocv_window_v.0, REST_SIGMA_V, SLOPE_SHARE);
    let mut spectra = input.spectra.to_vec();
    if let Some(slope) = slope {
        spectra
            .iter_mut()
            .for_each(|one| one.spectrum = one.spectrum.less_charge_storage(slope));
    }
    let pooled = PooledSpectrum::new(&spectra)?;
    let (windows, noise, unseen) = windows(input, options)?;
    let role = |w: &PulseWindow| {
        let inside =
            |w: &&PulseWindow| (w.ocv_v - options.ocv_window_v.0).abs() <= options.ocv_window_v.1;
        if !inside(&w) {
            return Role::Outside;
        }
        if windows
            .iter()
            .filter(inside)
            .position(|o| o == w)
            .is_some_and(|k| k % 2 == 1)
        {
            Role::HeldOut
        } else {
            Role::Fitted
        }
    };
    let roles: Vec<Role> = windows.iter().map(role).collect();
    let fitted: Vec<PulseWindow> = windows
        .iter()
        .zip(&roles)
        .filter(|(_, r)| **r == Role::Fitted)
        .map(|(w, _)| w.clone())
        .collect();
    if fitted.is_empty() {
        let (middle, half) = options.ocv_window_v;
        let at: Vec<String> = windows
            .iter()
            .map(|w| format!("{:.3} V", w.ocv_v))
            .collect();
        let (low, high) = (middle - half, middle + half);
        return Err(StudyError::NoPulses {
            series: input.series.name.clone(),
            low,
            high,
            met: windows.len(),
            at: at.join(", "),
        });
    }
    let orders = match options.rc {
        Some(rc) => rc..=rc,
        None => 1..=HIGHEST.min(pooled.points.len() - 1),
    };
    let orders = orders
        .map(|rc| {
            let fit = JointOptions { rc, ..options.fit };
            let joint = fit_joint(
                &JointInput {
                    spectrum: &pooled,
                    windows: &fitted,
                },
                &fit,
            )?;
            Ok(OrderResult {
                rc,
                spectra: fit_spectra(&pooled, &fit)?,
                joint,
            })
        })
        .collect::<Result<Vec<OrderResult>, JointError>>()?;
    let chosen = |pick: fn(&OrderResult) -> &JointFit| {
        choose_order(&orders.iter().map(|o| pick(o).clone()).collect::<Vec<_>>()).unwrap_or(0)
    };
    let mut study = Study {
        rc: chosen(|o| &o.joint),
        spectra_rc: chosen(|o| &o.spectra),
        pulses: Vec::new(),
        sweeps_cells: (pooled.sweeps, pooled.cells),
        cell_spread: pooled.cell_spread,
        spectra_basis: pooled.basis.clone(),
        noise_v: (noise.sample_v(), noise.floor_v()),
        warnings: Vec::new(),
        orders,
    };
    let source = Source {
        series: input.series,
        noise: &noise,
        curve: input.curve,
    };
    study.pulses = pulses(&source, &windows, &roles, &study);
    study.warnings = warnings(&study);
    study.warnings.push(match slope {
        Some(OcvSlope {
            v_per_coulomb,
            sigma_v_per_coulomb,
        }) => format!(
            "the slope of the OCV curve at {:.3} V, {:.2} ± {:.2} µV/C, was taken out of the \
            spectra: the resistances are without charge storage",
            options.ocv_window_v.0,
            1e6 * v_per_coulomb,
            1e6 * sigma_v_per_coulomb
        ),
        None => format!(
            "{:.3} V lies outside the OCV curve: charge storage is left in the spectra, and the DC \
            resistance is an apparent one",
            options.ocv_window_v.0
        ),
    });
    study.warnings.extend(unseen);
    Ok((study, pooled))
}

/// Returns the pulses' windows and their noise, with a remark on omitted pulses.
fn windows(
    input: &StudyInput<'_>,
    options: &StudyOptions,
) -> Result<(Vec<PulseWindow>, NoiseModel, Option<String>), StudyError> {
    let (pulses, unseen): (Vec<Pulse>, Vec<Pulse>) =
        find_pulses(input.series, &PulseOptions::default())
            .into_iter()
            .partition(|pulse| pulse.is_seen(input.series));
    let series = input.series.name.clone();
    let met_s = unseen
        .iter()
        .map(|pulse| pulse.sampling_s(input.series))
        .fold(f64::INFINITY, f64::min);
    if pulses.is_empty() && !unseen.is_empty() {
        return Err(StudyError::Unseen {
            series,
            met_s,
            count: unseen.len(),
        });
    }
    let left_out = (!unseen.is_empty()).then(|| {
        format!(
            "{series}: {} of {} pulses were left out: the samples next to their edges are {met_s} \
            s apart or more, expected at most {SLOWEST_EDGE_S} s",
            unseen.len(),
            unseen.len() + pulses.len()
        )
    });
    if pulses.is_empty() {
        let (low, high) = (
            options.ocv_window_v.0 - options.ocv_window_v.1,
            options.ocv_window_v.0 + options.ocv_window_v.1,
        );
        return Err(StudyError::NoPulses {
            series,
            low,
            high,
            met: 0,
            at: "no OCV".to_owned(),
        });
    }
    let noise =
        NoiseModel::measure(input.series, &pulses).ok_or(StudyError::NoBaseline { series })?;
    let window = |(k, p)| {
        PulseWindow::new(
            input.series,
            &noise,
            input.curve,
            k + 1,
            p,
            options.dcir_ohm,
            &WindowOptions::default(),
        )
    };
    let windows = pulses.into_iter().enumerate().filter_map(window).collect();
    Ok((windows, noise, left_out))
}

fn pulses(
    source: &Source<'_>,
    windows: &[PulseWindow],
    roles: &[Role],
    study: &Study,
) -> Vec<PulseResult> {
    let (Some(spectra), Some(joint)) = (study.spectra(), study.joint()) else {
        return Vec::new();
    };
    let alone = gaps(source, windows, spectra, &TIMES_S);
    let both = gaps(source, windows, joint, &TIMES_S);
    let one = |(((window, role), spectra_gap), joint_gap): (((&PulseWindow, &Role), Gap), Gap)| {
        let lines = overlay(window, spectra)
            .into_iter()
            .zip(overlay(window, joint));
        let overlay = lines
            .map(|((t, measured, a), (_, _, b))| [t, measured, a, b])
            .collect();
        let length_s = window.pulse.edges_s[1].0 - window.pulse.start_s();
        PulseResult {
            role: *role,
            length_s,
            spectra: spectra_gap,
            joint: joint_gap,
            overlay,
        }
    };
    windows
        .iter()
        .zip(roles)
        .zip(alone)
        .zip(both)
        .map(one)
        .collect()
}

fn warnings(study: &Study) -> Vec<String> {
    let mut found = Vec::new();
    let Some(joint) = study.joint() else {
        return found;
    };
    found.extend(joint.warnings.iter().cloned());
    if let Some(away) = joint
        .gain_sigma
        .map(|s| (joint.gain - 1.0) / s)
        .filter(|a| a.abs() > 3.0)
    {
        found.push(format!(
            "the pulses show {:.1} % {} resistance than the spectra, {:.0} times its uncertainty: \
            another cell, another bias, or a gain error of one instrument",
            100.0 * (joint.gain - 1.0).abs(),
            if joint.gain < 1.0 { "less" } else { "more" },
            away.abs()
        ));
    }
    found.extend(wandering(study));
    if !study.pulses.iter().any(|p| p.role == Role::HeldOut) {
        found.push(
            "one pulse lies in the OCV range: nothing could be held out, the joint model is \
        untested"
                .to_owned(),
        );
    }
    match study.cell_spread {
        Some(spread) => found.push(format!(
            "cells differ by {:.2} % (1σ), and which cell the pulses are of is unknown: the \
            prediction from spectra alone carries that and the instruments' 1 %",
            100.0 * spread
        )),
        None => found.push(
            "spectra of one cell: the spread between cells is not in the \
        prediction's uncertainty"
                .to_owned(),
        ),
    }
    found
}

/// Diffusion has no end in the time the data reach: each branch more reaches further.
fn wandering(study: &Study) -> Option<String> {
    let next = study.orders.iter().find(|o| o.rc + 1 == study.rc)?;
    let joint = study.joint()?;
    let (a, b) = (&next.joint, joint);
    let difference = (a.dc_resistance_ohm - b.dc_resistance_ohm).abs();
    let spread = a.sigma.dc_resistance_ohm?.hypot(b.sigma.dc_resistance_ohm?);
    let (after, sigma) = joint
        .step_resistance
        .first()
        .and_then(|s| Some((s.1, s.2?)))?;
    (difference > spread).then(|| {
        format!(
            "the DC resistance still moves with the order, by {:.1} mΩ from {} to {} RC: the cell \
            goes on relaxing beyond what the pulses reach; believe the \
             resistance after 10 s, {:.2} ± {:.2} mΩ",
            1e3 * difference,
            next.rc,
            study.rc,
            1e3 * after,
            1e3 * sigma
        )
    })
}
