//! A catalogue of run folders. Each question opens the file anew, so that none holds it while a scan
//! writes; answers are the JSON text that a server gives.

use std::path::PathBuf;

use analysis::catalog::{
    Catalog as File, CatalogError, query::Filter, record::CatalogVerdict, scan::ScanOptions,
};
use analysis::dataset::{DatasetError, read_spectrum_csv};
use analysis::spectrum::ImpedancePoint;
use numpy::IntoPyArray;
use pyo3::{prelude::*, types::PyDict};

use crate::error::{apart, json, refused};

/// Conditions, as Python gives them.
#[derive(FromPyObject)]
pub(crate) struct Wanted {
    cell: Option<String>,
    serial: Option<String>,
    batch: Option<String>,
    bench: Option<String>,
    experiment: Option<String>,
    from_s: Option<f64>,
    to_s: Option<f64>,
    verdict: Option<String>,
    trip: bool,
    map: bool,
    text: Option<String>,
    after: Option<String>,
    most: usize,
}

impl Wanted {
    fn filter(self) -> PyResult<Filter> {
        let verdict = self.verdict.map(|word| verdict(&word)).transpose()?;
        Ok(Filter {
            cell: self.cell,
            serial: self.serial,
            batch: self.batch,
            bench: self.bench,
            from_unix_s: self.from_s,
            to_unix_s: self.to_s,
            verdict,
            trip: self.trip,
            map: self.map,
            tag: None,
            text: self.text,
            after: self.after,
            most: self.most,
            experiment: self.experiment,
        })
    }
}

fn verdict(word: &str) -> PyResult<CatalogVerdict> {
    CatalogVerdict::of_word(word).ok_or_else(|| {
        let words = CatalogVerdict::ALL.map(CatalogVerdict::label).join(", ");
        refused(&format!("verdict: expected one of {words}, met {word:?}"))
    })
}

/// A catalogue in a file.
#[pyclass(frozen, module = "eisbench")]
pub(crate) struct Catalog {
    path: PathBuf,
}

impl Catalog {
    fn ask<T: serde::Serialize>(
        &self,
        py: Python<'_>,
        question: impl FnOnce(&File) -> Result<T, CatalogError> + Send,
    ) -> PyResult<String> {
        apart(py, || {
            let catalog = File::open(&self.path).map_err(|error| error.to_string())?;
            json(&question(&catalog).map_err(|error| error.to_string())?)
        })
    }
}

#[pymethods]
impl Catalog {
    /// Opens the catalogue in an existing file.
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        File::open(&path).map_err(|error| refused(&error))?;
        Ok(Self { path })
    }

    /// Scans run folders into a file, which is created if it does not exist. Returns a summary as
    /// JSON.
    #[staticmethod]
    fn scan(py: Python<'_>, path: PathBuf, roots: Vec<PathBuf>) -> PyResult<String> {
        apart(py, || {
            let catalog = File::make(&path).map_err(|error| error.to_string())?;
            let scanned = catalog.scan(&roots, &ScanOptions::plain());
            json(&scanned.map_err(|error| error.to_string())?)
        })
    }

    fn runs(&self, py: Python<'_>, wanted: Wanted) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.runs(&filter))
    }

    fn spectra(&self, py: Python<'_>, wanted: Wanted) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.spectra(&filter))
    }

    fn cells(&self, py: Python<'_>, wanted: Wanted) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.cells(&filter))
    }

    fn fits(&self, py: Python<'_>, wanted: Wanted) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.fits(&filter))
    }

    fn diagnoses(&self, py: Python<'_>, wanted: Wanted) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.diagnoses(&filter))
    }

    /// All that is known of a run, by its identity, its folder or its name.
    fn show(&self, py: Python<'_>, run: String) -> PyResult<String> {
        self.ask(py, |catalog| catalog.show(&run))
    }

    /// Returns the folders of runs, by their identities.
    fn folders(&self, py: Python<'_>, runs: Vec<String>) -> PyResult<Vec<String>> {
        apart(py, || {
            let catalog = File::open(&self.path).map_err(|error| error.to_string())?;
            let named: Vec<&str> = runs.iter().map(String::as_str).collect();
            let folders = catalog.folders(&named).map_err(|error| error.to_string())?;
            let folders = folders.into_iter().zip(&runs).map(|(folder, run)| {
                folder.ok_or_else(|| format!("run: expected one of the catalogue, met {run:?}"))
            });
            folders.collect()
        })
    }

    fn ageing(&self, py: Python<'_>, wanted: Wanted, rc: Option<u32>) -> PyResult<String> {
        let filter = wanted.filter()?;
        self.ask(py, |catalog| catalog.ageing(&filter, rc))
    }
}

/// Names of the columns of points, as the table of spectra of a catalogue has them.
const POINT_COLUMNS: [&str; 7] = [
    "freq_hz",
    "z_re_ohm",
    "z_im_ohm",
    "sigma_re_ohm",
    "sigma_im_ohm",
    "cov_re_im_ohm2",
    "amplitude_a",
];

fn numbers(point: &ImpedancePoint) -> [f64; POINT_COLUMNS.len()] {
    let covariance = &point.covariance;
    [
        point.freq_hz,
        point.z_ohm.re,
        point.z_ohm.im,
        covariance.re_re.sqrt(),
        covariance.im_im.sqrt(),
        covariance.re_im,
        point.amplitude_a,
    ]
}

/// Number of points of a file, or the reason why there are none.
type Read = (usize, Option<String>);

/// Returns the points of spectra of run folders, one file after another, and what each file has
/// given.
#[pyfunction]
pub(crate) fn points_of_files<'py>(
    py: Python<'py>,
    files: Vec<PathBuf>,
) -> PyResult<(Bound<'py, PyDict>, Vec<Read>)> {
    let read = apart(py, || {
        let read = files.iter().map(|file| read_spectrum_csv(file));
        Ok(read.collect::<Vec<_>>())
    })?;
    let points = read.iter().flatten().flatten();
    let rows: Vec<[f64; POINT_COLUMNS.len()]> = points.map(numbers).collect();
    let columns = PyDict::new(py);
    for (index, name) in POINT_COLUMNS.iter().enumerate() {
        let column: Vec<f64> = rows.iter().map(|row| row[index]).collect();
        columns.set_item(name, column.into_pyarray(py))?;
    }
    let summary = |one: &Result<Vec<ImpedancePoint>, _>| match one {
        Ok(points) => (points.len(), None),
        Err(error) => (0, Some(DatasetError::to_string(error))),
    };
    Ok((columns, read.iter().map(summary).collect()))
}
