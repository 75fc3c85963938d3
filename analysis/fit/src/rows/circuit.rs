//! Rows of fitted circuits.

use super::{Cell, ResultColumn, ResultRows, RowValues, at_points};
use crate::fit::{CellSweeps, CircuitOptions, Slope, fit_circuit_cells};
use analysis_model::model::Circuit;
use analysis_signal::spectrum::SourcedSpectrum;

/// A fit of a circuit to each spectrum.
///
/// Columns: `points`, `objective`, `objective_kind`, `weight`, `rms_ohm`, `reduced_chi2`, `aicc`,
/// `starts`, `starts_at_optimum`; for each parameter `R0`, `R0_sigma` in the parameter's unit and
/// `R0_state`; `cov_R0_R0`, …: the lower triangle of the covariance.
#[derive(Debug, Clone)]
pub struct CircuitRows {
    /// The circuit.
    pub circuit: Circuit,
    /// Options for each fit.
    pub options: CircuitOptions,
    /// Treatment of the charge storage.
    pub slope: Slope,
}

impl ResultRows for CircuitRows {
    fn own_columns(&self) -> Vec<ResultColumn> {
        let mut columns = vec![
            ResultColumn::count("points"),
            ResultColumn::number("objective"),
            ResultColumn::text("objective_kind"),
            ResultColumn::text("weight"),
            ResultColumn::number("rms_ohm"),
            ResultColumn::number("reduced_chi2"),
            ResultColumn::number("aicc"),
            ResultColumn::count("starts"),
            ResultColumn::count("starts_at_optimum"),
        ];
        let names = self.circuit.parameter_names();
        for name in names {
            columns.extend([
                ResultColumn::number(name.clone()),
                ResultColumn::number(format!("{name}_sigma")),
                ResultColumn::text(format!("{name}_state")),
            ]);
        }
        for (nth, row) in names.iter().enumerate() {
            let triangle = names.iter().take(nth + 1);
            columns
                .extend(triangle.map(|column| ResultColumn::number(format!("cov_{row}_{column}"))));
        }
        columns
    }

    fn values(&self, sourced: &SourcedSpectrum) -> Result<RowValues, String> {
        let spectrum = &self.slope.less(&sourced.spectrum);
        let sourced = SourcedSpectrum {
            spectrum: spectrum.clone(),
            ..sourced.clone()
        };
        let cells = CellSweeps::sort(&[sourced]);
        let fit = fit_circuit_cells(&cells, &self.circuit, &self.options)
            .map_err(|error| error.to_string())?;
        let mut cells = vec![
            Cell::whole(fit.points),
            Cell::finite(fit.objective),
            Cell::Text(Some(fit.objective_kind.to_string())),
            Cell::Text(Some(fit.weight.to_string())),
            Cell::finite(fit.rms_ohm),
            Cell::Number(fit.reduced_chi2),
            Cell::Number(fit.aicc),
            Cell::whole(fit.starts),
            Cell::whole(fit.starts_at_optimum),
        ];
        for ((value, sigma), state) in fit.values.iter().zip(&fit.sigmas).zip(&fit.states) {
            cells.extend([
                Cell::finite(*value),
                Cell::Number(*sigma),
                Cell::Text(Some(state.name().to_owned())),
            ]);
        }
        for (nth, row) in fit.covariance.iter().enumerate() {
            cells.extend(row.iter().take(nth + 1).map(|value| Cell::Number(*value)));
        }
        let fitted = at_points(spectrum, &fit.circuit, |freq_hz| {
            self.circuit.impedance(&fit.values, freq_hz)
        });
        Ok(RowValues::of(cells, &fit.warnings, fitted))
    }
}
