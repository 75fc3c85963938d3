//! Rows of fitted extended Randles models.

use super::{Cell, ResultColumn, ResultRows, RowValues, at_points};
use crate::fit::{ErmFit, ErmRequest, MOST_AUTO};
use analysis_signal::spectrum::SourcedSpectrum;

/// A fit of each spectrum.
///
/// Columns: `points`, `rc`, `objective`, `objective_kind`, `rms_ohm`, `reduced_chi2`,
/// `dc_resistance_ohm` and `r_ohm` with their `…_sigma_ohm`; for each branch k `rk_ohm`, `ck_f`,
/// `tauk_s` with `rk_sigma_ohm`, `ck_sigma_f`, `tauk_sigma_s`; `cov_ln_r_ln_r`, `cov_ln_r1_ln_r`, …:
/// the lower triangle of the covariance of the logarithms of the parameters.
#[derive(Debug, Clone, Copy)]
pub struct ErmRows {
    /// Options for each fit.
    pub request: ErmRequest,
}

impl ErmRows {
    /// Branches that the columns have room for.
    fn most(&self) -> usize {
        self.request.rc.unwrap_or(MOST_AUTO)
    }
}

impl ResultRows for ErmRows {
    fn own_columns(&self) -> Vec<ResultColumn> {
        let mut columns = vec![
            ResultColumn::count("points"),
            ResultColumn::count("rc"),
            ResultColumn::number("objective"),
            ResultColumn::text("objective_kind"),
            ResultColumn::number("rms_ohm"),
            ResultColumn::number("reduced_chi2"),
            ResultColumn::number("dc_resistance_ohm"),
            ResultColumn::number("dc_resistance_sigma_ohm"),
            ResultColumn::number("r_ohm"),
            ResultColumn::number("r_sigma_ohm"),
        ];
        for k in 1..=self.most() {
            columns.extend(
                [
                    format!("r{k}_ohm"),
                    format!("r{k}_sigma_ohm"),
                    format!("c{k}_f"),
                    format!("c{k}_sigma_f"),
                    format!("tau{k}_s"),
                    format!("tau{k}_sigma_s"),
                ]
                .map(ResultColumn::number),
            );
        }
        let branches = (1..=self.most()).flat_map(|k| [format!("r{k}"), format!("c{k}")]);
        let names: Vec<String> = std::iter::once("r".to_owned()).chain(branches).collect();
        for (nth, row) in names.iter().enumerate() {
            let triangle = names.iter().take(nth + 1);
            columns.extend(
                triangle.map(|column| ResultColumn::number(format!("cov_ln_{row}_ln_{column}"))),
            );
        }
        columns
    }

    fn values(&self, sourced: &SourcedSpectrum) -> Result<RowValues, String> {
        let answer = self.request.fit(std::slice::from_ref(sourced));
        let fit = answer.map_err(|error| error.to_string())?.fit;
        let name = format!("{} RC", fit.erm.branches.len());
        let fitted = at_points(&sourced.spectrum, &name, |freq_hz| fit.impedance(freq_hz));
        Ok(RowValues::of(
            cells(&fit, self.most()),
            &fit.warnings,
            fitted,
        ))
    }
}

fn cells(fit: &ErmFit, most: usize) -> Vec<Cell> {
    let sigma = &fit.sigma;
    let mut cells = vec![
        Cell::whole(fit.points),
        Cell::whole(fit.erm.branches.len()),
        Cell::finite(fit.objective),
        Cell::Text(Some(fit.objective_kind.to_string())),
        Cell::finite(fit.rms_ohm),
        Cell::Number(fit.reduced_chi2),
        Cell::finite(fit.erm.dc_resistance_ohm()),
        Cell::Number(sigma.dc_resistance_ohm),
        Cell::finite(fit.erm.r_ohm),
        Cell::Number(sigma.r_ohm),
    ];
    for k in 0..most {
        let (branch, sigma) = (fit.erm.branches.get(k), sigma.branches.get(k));
        cells.extend(
            [
                branch.map(|b| b.r_ohm),
                sigma.and_then(|s| s.r_ohm),
                branch.map(|b| b.c_f),
                sigma.and_then(|s| s.c_f),
                branch.map(|b| b.r_ohm * b.c_f),
                sigma.and_then(|s| s.time_constant_s),
            ]
            .map(Cell::Number),
        );
    }
    for row in 0..=2 * most {
        let known = fit.log_covariance.as_ref().and_then(|rows| rows.get(row));
        let value = |column| known.and_then(|row| row.get(column).copied());
        cells.extend((0..=row).map(|column| Cell::Number(value(column))));
    }
    cells
}
