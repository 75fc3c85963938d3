//! Tables of a catalogue for other programs: runs, fits, and spectra in long form.

use std::path::Path;

use analysis_files::{
    batch::{Cells, TableColumn, write_table},
    dataset::read_spectrum_csv,
};
use analysis_signal::spectrum::ImpedancePoint;
use serde::Serialize;

use crate::{
    Catalog, CatalogError,
    query::{DiagnosesFound, Filter, RunsFound, SpectraFound},
    record::{CatalogDiagnosis, CatalogFit, CatalogRun, CatalogSpectrum},
};

/// Number of rows requested at once.
const PAGE: usize = 1000;

/// Result of an export.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Exported {
    /// Number of rows of the table.
    pub rows: usize,
    /// Spectra whose files cannot be read now, with the reason.
    pub left_out: Vec<String>,
}

impl Catalog {
    /// Every run that meets the conditions.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn all_runs(&self, filter: &Filter) -> Result<Vec<CatalogRun>, CatalogError> {
        all(filter, |page| {
            let RunsFound { runs, after } = self.runs(page)?;
            Ok(Page { rows: runs, after })
        })
    }

    /// Every spectrum that meets the conditions.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn all_spectra(&self, filter: &Filter) -> Result<Vec<CatalogSpectrum>, CatalogError> {
        all(filter, |page| {
            let SpectraFound { spectra, after } = self.spectra(page)?;
            Ok(Page {
                rows: spectra,
                after,
            })
        })
    }

    /// Every diagnosis of runs that meet the conditions.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn all_diagnoses(&self, filter: &Filter) -> Result<Vec<CatalogDiagnosis>, CatalogError> {
        all(filter, |page| {
            let DiagnosesFound { diagnoses, after } = self.diagnoses(page)?;
            Ok(Page {
                rows: diagnoses,
                after,
            })
        })
    }

    /// Writes runs as a table: Parquet for a file named `.parquet`, otherwise CSV.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn export_runs(&self, path: &Path, filter: &Filter) -> Result<Exported, CatalogError> {
        let runs = self.all_runs(filter)?;
        write_table(path, &run_columns(&runs))?;
        Ok(Exported {
            rows: runs.len(),
            left_out: Vec::new(),
        })
    }

    /// Writes fits as a table.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn export_fits(&self, path: &Path, filter: &Filter) -> Result<Exported, CatalogError> {
        let fits = self.all_fits(filter)?;
        write_table(path, &fit_columns(&fits))?;
        Ok(Exported {
            rows: fits.len(),
            left_out: Vec::new(),
        })
    }

    /// Writes the diagnoses of the runs that meet the conditions as a table.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn export_diagnoses(&self, path: &Path, filter: &Filter) -> Result<Exported, CatalogError> {
        let diagnoses = self.all_diagnoses(filter)?;
        write_table(path, &diagnosis_columns(&diagnoses))?;
        Ok(Exported {
            rows: diagnoses.len(),
            left_out: Vec::new(),
        })
    }

    /// Writes spectra in long form, one row for each point, read from their run folders now: the
    /// table that `eis-bench fit` takes, with cell, bench and circumstances beside each point.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn export_spectra(&self, path: &Path, filter: &Filter) -> Result<Exported, CatalogError> {
        let (mut rows, mut left_out) = (Vec::new(), Vec::new());
        let spectra = self.all_spectra(filter)?;
        let runs: Vec<&str> = spectra.iter().map(|one| one.run.as_str()).collect();
        let folders = self.folders(&runs)?;
        for (spectrum, folder) in spectra.into_iter().zip(folders) {
            let folder = folder.unwrap_or_default();
            match read_spectrum_csv(&Path::new(&folder).join(&spectrum.file)) {
                Ok(points) => rows.push(Points { spectrum, points }),
                Err(error) => left_out.push(error.to_string()),
            }
        }
        write_table(path, &point_columns(&rows))?;
        Ok(Exported {
            rows: rows.iter().map(|one| one.points.len()).sum(),
            left_out,
        })
    }
}

/// Part of a reply, and the cursor of the next part.
struct Page<T> {
    rows: Vec<T>,
    after: Option<String>,
}

/// Returns all rows of a query that is executed page by page.
fn all<T>(
    filter: &Filter,
    ask: impl Fn(&Filter) -> Result<Page<T>, CatalogError>,
) -> Result<Vec<T>, CatalogError> {
    let mut page = Filter {
        most: PAGE,
        ..filter.clone()
    };
    let mut all = Vec::new();
    loop {
        let Page { rows, after } = ask(&page)?;
        all.extend(rows);
        page.after = after;
        if page.after.is_none() {
            return Ok(all);
        }
    }
}

/// A spectrum with its points.
#[derive(Debug, Clone)]
pub(crate) struct Points {
    pub(crate) spectrum: CatalogSpectrum,
    pub(crate) points: Vec<ImpedancePoint>,
}

fn texts<T>(name: &'static str, rows: &[T], of: impl Fn(&T) -> Option<String>) -> TableColumn {
    TableColumn {
        name,
        cells: Cells::Texts(rows.iter().map(of).collect()),
    }
}

fn numbers<T>(name: &'static str, rows: &[T], of: impl Fn(&T) -> Option<f64>) -> TableColumn {
    TableColumn {
        name,
        cells: Cells::Numbers(rows.iter().map(of).collect()),
    }
}

fn counts<T>(name: &'static str, rows: &[T], of: impl Fn(&T) -> u32) -> TableColumn {
    TableColumn {
        name,
        cells: Cells::Counts(rows.iter().map(of).collect()),
    }
}

/// Returns the columns of a table of runs; several cells share one field, separated by `; `.
pub fn run_columns(runs: &[CatalogRun]) -> Vec<TableColumn> {
    let cells = |run: &CatalogRun, of: fn(&crate::record::CatalogCell) -> Option<&String>| {
        let all: Vec<&str> = run
            .cells
            .iter()
            .filter_map(of)
            .map(String::as_str)
            .collect();
        Some(all.join("; ")).filter(|text| !text.is_empty())
    };
    vec![
        texts("run", runs, |run| Some(run.run.clone())),
        texts("name", runs, |run| Some(run.name.clone())),
        texts("cells", runs, |run| cells(run, |cell| Some(&cell.name))),
        texts("serials", runs, |run| {
            cells(run, |cell| cell.serial.as_ref())
        }),
        texts("scanned_serials", runs, |run| {
            cells(run, |cell| cell.scanned_serial.as_ref())
        }),
        texts("batches", runs, |run| {
            cells(run, |cell| cell.batch.as_ref())
        }),
        texts("barcodes", runs, |run| {
            cells(run, |cell| cell.barcode.as_ref())
        }),
        texts("makers", runs, |run| cells(run, |cell| cell.maker.as_ref())),
        texts("chemistries", runs, |run| {
            cells(run, |cell| cell.chemistry.as_ref())
        }),
        texts("terms", runs, |run| cells(run, |cell| cell.term.as_ref())),
        texts("bench", runs, |run| Some(run.bench.clone())),
        texts("experiment", runs, |run| Some(run.experiment.clone())),
        texts("operator", runs, |run| run.operator.clone()),
        numbers("started_unix_s", runs, |run| Some(run.started_unix_s)),
        texts("time_source", runs, |run| {
            Some(run.time_source.label().to_owned())
        }),
        numbers("bench_time_s", runs, |run| Some(run.bench_time_s)),
        texts("verdict", runs, |run| Some(run.verdict.label().to_owned())),
        texts("how", runs, |run| run.how.clone()),
        texts("trip", runs, |run| run.trip.clone()),
        counts("resumed", runs, |run| run.resumed),
        counts("spectra", runs, |run| run.spectra),
        counts("refused_points", runs, |run| run.refused_points),
        counts("fits", runs, |run| run.fits),
        numbers("map_soc_low", runs, |run| Some(run.map?.soc_low)),
        numbers("map_soc_high", runs, |run| Some(run.map?.soc_high)),
        numbers("map_temperature_low_c", runs, |run| {
            Some(run.map?.temperature_low_degc)
        }),
        numbers("map_temperature_high_c", runs, |run| {
            Some(run.map?.temperature_high_degc)
        }),
        numbers("map_left_out_mv", runs, |run| run.map?.left_out_mv),
        counts("simulated", runs, |run| u32::from(run.simulated)),
        counts("missing", runs, |run| u32::from(run.missing)),
        texts("version", runs, |run| Some(run.version.clone())),
        texts("config_sha256", runs, |run| run.config_sha256.clone()),
        texts("content_sha256", runs, |run| run.content_sha256.clone()),
        texts("folder", runs, |run| Some(run.folder.clone())),
    ]
}

/// Returns the columns of a table of fits.
pub fn fit_columns(fits: &[CatalogFit]) -> Vec<TableColumn> {
    vec![
        texts("run", fits, |fit| Some(fit.run.clone())),
        texts("name", fits, |fit| Some(fit.name.clone())),
        texts("file", fits, |fit| Some(fit.file.clone())),
        texts("cell", fits, |fit| Some(fit.cell.clone())),
        texts("serial", fits, |fit| fit.serial.clone()),
        texts("batch", fits, |fit| fit.batch.clone()),
        counts("cells", fits, |fit| fit.cells),
        texts("bench", fits, |fit| Some(fit.bench.clone())),
        numbers("started_unix_s", fits, |fit| Some(fit.started_unix_s)),
        texts("time_source", fits, |fit| {
            Some(fit.time_source.label().to_owned())
        }),
        numbers("temperature_c", fits, |fit| fit.temperature_degc),
        numbers("ocv_v", fits, |fit| fit.ocv_v),
        counts("rc", fits, |fit| fit.rc),
        numbers("r_ohm", fits, |fit| Some(fit.r_ohm)),
        numbers("r_sigma_ohm", fits, |fit| fit.r_sigma_ohm),
        numbers("dc_resistance_ohm", fits, |fit| Some(fit.dc_resistance_ohm)),
        numbers("dc_resistance_sigma_ohm", fits, |fit| {
            fit.dc_resistance_sigma_ohm
        }),
        numbers("slow_r_ohm", fits, |fit| fit.slow_r_ohm),
        numbers("slow_r_sigma_ohm", fits, |fit| fit.slow_r_sigma_ohm),
        numbers("slow_tau_s", fits, |fit| fit.slow_tau_s),
        numbers("slow_tau_sigma_s", fits, |fit| fit.slow_tau_sigma_s),
        numbers("rms_ohm", fits, |fit| Some(fit.rms_ohm)),
        numbers("reduced_chi2", fits, |fit| fit.reduced_chi2),
        counts("points", fits, |fit| fit.points),
    ]
}

/// Returns the columns of a table of diagnoses; several effects share one field, separated by `; `,
/// and the parameters are JSON.
pub fn diagnosis_columns(diagnoses: &[CatalogDiagnosis]) -> Vec<TableColumn> {
    let effects = |one: &CatalogDiagnosis| {
        let mut names: Vec<&str> = one
            .parameters
            .iter()
            .map(|parameter| parameter.effect.as_str())
            .collect();
        names.dedup();
        Some(names.join("; ")).filter(|text| !text.is_empty())
    };
    let parameters = |one: &CatalogDiagnosis| serde_json::to_string(&one.parameters).ok();
    let known = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
    vec![
        texts("run", diagnoses, |one| one.run.clone()),
        texts("diagnosis", diagnoses, |one| Some(one.folder.clone())),
        texts("cell", diagnoses, |one| one.cell.clone()),
        texts("data_set", diagnoses, |one| known(&one.data_set)),
        texts("model", diagnoses, |one| known(&one.model)),
        texts("verdict", diagnoses, |one| known(&one.verdict)),
        texts("summary", diagnoses, |one| known(&one.summary)),
        texts("effects", diagnoses, effects),
        texts("parameters", diagnoses, parameters),
        texts("damage", diagnoses, |one| one.damage.clone()),
    ]
}

pub(crate) fn point_columns(rows: &[Points]) -> Vec<TableColumn> {
    let number = |name, of: &dyn Fn(&ImpedancePoint) -> f64| {
        let all = rows.iter().flat_map(|one| &one.points);
        TableColumn {
            name,
            cells: Cells::Numbers(all.map(|point| Some(of(point))).collect()),
        }
    };
    let circumstance = |name, of: &dyn Fn(&CatalogSpectrum) -> Option<f64>| {
        let all = rows
            .iter()
            .flat_map(|one| std::iter::repeat_n(of(&one.spectrum), one.points.len()));
        TableColumn {
            name,
            cells: Cells::Numbers(all.collect()),
        }
    };
    let text = |name, of: &dyn Fn(&CatalogSpectrum) -> Option<String>| {
        let all = rows
            .iter()
            .flat_map(|one| std::iter::repeat_n(of(&one.spectrum), one.points.len()));
        TableColumn {
            name,
            cells: Cells::Texts(all.collect()),
        }
    };
    vec![
        text("spectrum_id", &|one| {
            Some(format!("{}/{}", one.run, one.file.trim_end_matches(".csv")))
        }),
        number("freq_hz", &|point| point.freq_hz),
        number("z_re_ohm", &|point| point.z_ohm.re),
        number("z_im_ohm", &|point| point.z_ohm.im),
        number("sigma_re_ohm", &|point| point.covariance.re_re.sqrt()),
        number("sigma_im_ohm", &|point| point.covariance.im_im.sqrt()),
        number("cov_re_im_ohm2", &|point| point.covariance.re_im),
        number("amplitude_a", &|point| point.amplitude_a),
        text("run", &|one| Some(one.run.clone())),
        text("name", &|one| Some(one.name.clone())),
        text("cell", &|one| Some(one.cell.clone())),
        text("serial", &|one| one.serial.clone()),
        text("batch", &|one| one.batch.clone()),
        text("chemistry", &|one| one.chemistry.clone()),
        text("bench", &|one| Some(one.bench.clone())),
        circumstance("started_unix_s", &|one| Some(one.started_unix_s)),
        text("time_source", &|one| {
            Some(one.time_source.label().to_owned())
        }),
        circumstance("ocv_v", &|one| one.ocv_v),
        circumstance("temperature_c", &|one| one.temperature_degc),
        circumstance("bias_a", &|one| Some(one.bias_a)),
    ]
}
