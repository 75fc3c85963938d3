//! The band around a simulated run, and the uncertainty of its lowest voltage.

use analysis::{
    forward::{
        Demand, ForwardError, Profile, RunBand, RunError, SensitivityRow, SimModel, SimOptions,
        SimState, Simulation, sensitivity,
    },
    given::GivenModel,
    map::{CellMap, ErrorSource},
};

/// A run, and what was asked.
pub(super) struct Played<'a> {
    pub(super) state: &'a SimState,
    pub(super) profile: &'a Profile,
    pub(super) options: &'a SimOptions,
    pub(super) run: &'a Simulation,
}

/// What the uncertainty of a model does to a run.
#[derive(Debug, Default)]
pub(super) struct Uncertainty {
    /// Around the voltage of a cell.
    pub(super) band: Option<RunBand>,
    /// Standard deviation of the lowest voltage at the terminals, V.
    pub(super) lowest_sigma_v: Option<f64>,
    /// Derivatives of the lowest voltage by ln R, ln R₁, ln C₁, … of the cell, V; empty without a fit.
    pub(super) slopes_v: Vec<f64>,
    /// Whether the band contains the uncertainty of fitted parameters.
    is_of_fit: bool,
    /// Held-out runs of the diagnosis that the band holds.
    held_out_runs: Option<usize>,
}

impl Uncertainty {
    /// Determines it for a run whose cells scatter by `cell_share` of their resistances.
    pub(super) fn of(
        file: &GivenModel,
        model: &SimModel,
        played: &Played<'_>,
        cell_share: f64,
    ) -> Result<Self, ForwardError> {
        let Played { profile, run, .. } = played;
        let band = |error| RunBand::new(model, &run.trace, profile.demand, error, cell_share);
        // At the point where the run stopped, the voltage has no derivative and no minimum.
        if !run.summary.feasible {
            return Ok(Self::default());
        }
        let known = vec![0.0; run.trace.time_s.len()];
        let of_cells = || band(RunError::Parameters(1, &known)).filter(|_| cell_share > 0.0);
        if file.map.is_some() {
            return Ok(Self {
                band: band(RunError::Map).or_else(of_cells),
                lowest_sigma_v: of_map(model, profile.demand, run),
                ..Self::default()
            });
        }
        // With additions, the fit's parameters are incomplete; the diagnosis has predicted other runs.
        if !file.additions.is_empty() {
            let held_out = file.facts.and_then(|facts| facts.held_out);
            return Ok(Self {
                band: held_out.and_then(|error| band(RunError::HeldOut(error))),
                held_out_runs: held_out.map(|error| error.runs),
                ..Self::default()
            });
        }
        // Steps as fine as the ones that error control took on average, but not more than a quarter of
        // a million.
        let step_s = (run.summary.simulated_s / run.summary.steps.max(1) as f64)
            .max(profile.duration_s() / 2.5e5);
        let rows = sensitivity(model, played.state, profile, played.options.beyond, step_s)?.rows;
        let values = values(file, model);
        let lowest = rows.iter().min_by(|a, b| a.ccv_v.total_cmp(&b.ccv_v));
        let slopes_v = lowest.map_or_else(Vec::new, |row| slopes_of(&values, row));
        let covariance = file.log_covariance.as_deref();
        let Some(covariance) = covariance.filter(|all| all.len() == values.len()) else {
            return Ok(Self {
                band: of_cells(),
                slopes_v,
                ..Self::default()
            });
        };
        let sigmas_v: Vec<f64> = rows
            .iter()
            .map(|row| sigma_v(covariance, &slopes_of(&values, row)))
            .collect();
        let of_cell: Vec<f64> = at_rows(&run.trace.time_s, &rows, &sigmas_v)
            .map(|sigma_v| sigma_v / f64::from(model.pack.series))
            .collect();
        Ok(Self {
            band: band(RunError::Parameters(values.len(), &of_cell)),
            lowest_sigma_v: Some(sigma_v(covariance, &slopes_v)).filter(|v| v.is_finite()),
            slopes_v,
            is_of_fit: true,
            held_out_runs: None,
        })
    }

    /// Describes the band, in mV per cell.
    pub(super) fn text(&self, profile: &str, file: &GivenModel) -> Option<String> {
        let band = self.band.as_ref()?;
        let map = file.map.as_ref().filter(|map| map.voltage_error.is_some());
        let unmeasured = if map.is_some_and(CellMap::has_unmeasured) {
            "by the errors of charge transfer and of what is faster than the spectra, and "
        } else {
            ""
        };
        let of_runs = self.held_out_runs.map(|runs| match runs {
            1 => "as the held-out run of the diagnosis does, for a run of its kind".to_owned(),
            _ => {
                format!("as the {runs} held-out runs of the diagnosis do, for a run of their kind")
            }
        });
        let shown = match map.and_then(|map| map.voltage_error.as_ref()) {
            Some(error) => match error.from {
                ErrorSource::HeldOut => "as held-out logs show, above 10 % of charge",
                ErrorSource::LeftOut => {
                    "as left-out pieces of the fitted logs show, above 10 % of charge; other loads may \
                    be farther off"
                }
            },
            None if self.is_of_fit => {
                "by the uncertainty of the fitted parameters and the scatter of --sigma-r, without what \
                the model lacks"
            }
            None => of_runs
                .as_deref()
                .unwrap_or("by the scatter of --sigma-r alone"),
        };
        Some(format!(
            "{profile}: with a probability of {:.0} % the voltage of a cell stays over the whole run within \
            ± {:.0} mV of the prediction (mean; at most ± {:.0} mV), and so above {:.3} V, {unmeasured}{shown}",
            1e2 * band.probability,
            1e3 * band.mean_half_v,
            1e3 * band.most_half_v,
            band.lowest_v
        ))
    }
}

/// Parameters of the pack at the terminals: R, R₁, C₁, ….
fn values(file: &GivenModel, model: &SimModel) -> Vec<f64> {
    let (ratio, cell) = (model.pack.ratio(), &file.erm);
    let branches = cell.branches.iter();
    let branches = branches.flat_map(|b| [b.r_ohm * ratio, b.c_f / ratio]);
    std::iter::once(cell.r_ohm * ratio)
        .chain(branches)
        .collect()
}

/// Derivatives of the voltage at the terminals by the logarithms of the parameters, V.
fn slopes_of(values: &[f64], row: &SensitivityRow) -> Vec<f64> {
    let both = values.iter().zip(&row.by_parameter);
    both.map(|(value, slope)| value * slope).collect()
}

/// √(gᵀΣg) with the covariance of the logarithms.
fn sigma_v(covariance: &[Vec<f64>], slopes_v: &[f64]) -> f64 {
    let rows = covariance.iter().zip(slopes_v).map(|(row, slope)| {
        let of_row = row.iter().zip(slopes_v).map(|(c, other)| c * other);
        slope * of_row.sum::<f64>()
    });
    rows.sum::<f64>().max(0.0).sqrt()
}

/// Values of rows of derivatives, along lines, at the rows of a trace. Both have two rows at a jump.
fn at_rows<'a>(
    time_s: &'a [f64],
    rows: &'a [SensitivityRow],
    values: &'a [f64],
) -> impl Iterator<Item = f64> + 'a {
    time_s.iter().enumerate().map(move |(k, t)| {
        // Both count their times up in steps of their own, so that they differ by rounding.
        let near_s = 1e-9 * t.abs().max(1e-3);
        let is_after_jump = k > 0 && (time_s[k - 1] - t).abs() <= near_s;
        let above = if is_after_jump {
            rows.partition_point(|row| row.time_s <= t + near_s)
        } else {
            rows.partition_point(|row| row.time_s < t - near_s)
        };
        let last = rows.len() - 1;
        if is_after_jump || above == 0 || above > last {
            return values[if is_after_jump {
                above.max(1) - 1
            } else {
                above.min(last)
            }];
        }
        let (from, to) = (rows[above - 1].time_s, rows[above].time_s);
        let share = if to > from {
            (t - from) / (to - from)
        } else {
            1.0
        };
        values[above - 1] + share * (values[above] - values[above - 1])
    })
}

/// Standard deviation of the lowest voltage at the terminals by the error of a map, V.
///
/// Under a power a lower voltage also takes more current, so that only a current has one.
fn of_map(model: &SimModel, demand: Demand, run: &Simulation) -> Option<f64> {
    if demand != Demand::Current || !run.summary.feasible {
        return None;
    }
    let rows = run.trace.ccv_v.iter().zip(&run.trace.cell_sigma_v);
    let (_, sigma_v) = rows.min_by(|a, b| a.0.total_cmp(b.0))?;
    Some(f64::from(model.pack.series) * sigma_v)
}
