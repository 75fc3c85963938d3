//! Small run folders, as a run on a bench leaves them.

use std::{
    fs,
    path::{Path, PathBuf},
};

use analysis_catalog::{
    Catalog,
    query::Filter,
    record::CatalogVerdict,
    scan::{ScanOptions, Scanned},
};
use analysis_files::run_folder::{
    self, CAMPAIGN, DIAGNOSIS, INDEX, JOURNAL, MANIFEST, SPECTRUM, SUMS,
};
use analysis_fit::fit::MODEL_SCHEMA;
use serde_json::{Value, json};

/// Start of the first run, s since 1970.
pub(crate) const FIRST_S: f64 = 1.7e9;
/// Seconds from one run to the next.
pub(crate) const EVERY_S: f64 = 3600.0;
/// Number of points of a spectrum.
const POINTS: usize = 20;

/// A run that is made.
#[derive(Debug, Clone)]
pub(crate) struct Made {
    /// Its number, from 0: the time follows from it.
    pub(crate) number: usize,
    /// The cell.
    pub(crate) cell: String,
    /// Its serial number.
    pub(crate) serial: Option<String>,
    /// Its barcode.
    pub(crate) barcode: Option<String>,
    /// Its batch.
    pub(crate) batch: String,
    /// Names of the cells of a campaign, which give the type of each cell; empty without a
    /// campaign.
    pub(crate) cells: Vec<&'static str>,
    /// The experiment.
    pub(crate) experiment: String,
    /// The bench.
    pub(crate) bench: String,
    /// How it ended; `None` if it did not.
    pub(crate) how: Option<String>,
    /// Points that its gate refused.
    pub(crate) refused: usize,
    /// In virtual time.
    pub(crate) is_virtual: bool,
}

impl Made {
    /// Creates a run that came to its end, of one of 100 cells on one of five benches.
    pub(crate) fn of(number: usize) -> Self {
        Self {
            number,
            cell: format!("C{:02}", number % 100),
            serial: Some(format!("P45B-{:04}", number % 100)),
            barcode: None,
            batch: "2026-03".to_owned(),
            cells: Vec::new(),
            experiment: "ageing".to_owned(),
            bench: format!("bench{}", number % 5),
            how: Some("finished".to_owned()),
            refused: 0,
            is_virtual: false,
        }
    }

    /// Series resistance of its cell, Ω: it grows with the number.
    pub(crate) fn r_ohm(&self) -> f64 {
        0.006 * (1.0 + 1.0e-5 * self.number as f64)
    }

    /// When it began, s since 1970.
    pub(crate) fn started_unix_s(&self) -> f64 {
        FIRST_S + EVERY_S * self.number as f64
    }

    /// Returns the name of its folder.
    pub(crate) fn name(&self) -> String {
        format!("run{:06}", self.number)
    }

    /// Writes its folder below another one.
    pub(crate) fn write(&self, root: &Path) -> PathBuf {
        let folder = root.join(self.name());
        fs::create_dir_all(&folder).unwrap();
        let put = |name: &str, text: &str| fs::write(folder.join(name), text).unwrap();
        put(MANIFEST, &self.manifest().to_string());
        put(JOURNAL, &self.journal());
        put(INDEX, &self.index().to_string());
        put(SPECTRUM, &self.spectrum());
        for rc in 1..=2 {
            put(&run_folder::model(rc), &self.model(rc).to_string());
        }
        if !self.cells.is_empty() {
            let cell = |name| json!({ "name": name, "serial": format!("S-{name}") });
            let cells: Vec<Value> = self.cells.iter().map(cell).collect();
            put(CAMPAIGN, &json!({ "cells": cells }).to_string());
        }
        put(SUMS, &format!("{:064x}  {MANIFEST}\n", self.number));
        folder
    }

    /// Writes a diagnosis into a folder that is made.
    pub(crate) fn diagnose(&self, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        let text = json!({
            "data_set": self.name(), "model": "m", "verdict": "explained", "summary": "s",
            "effects": [{ "name": "diffusion", "parameters": [
                { "name": "r_ohm", "value": 0.002, "sigma": 1e-4, "unit": "Ω" },
            ]}],
        });
        fs::write(folder.join(DIAGNOSIS), text.to_string()).unwrap();
    }

    fn manifest(&self) -> Value {
        json!({
            "program": "eis-bench", "version": "0.1.0", "experiment": self.experiment,
            "bench": self.bench,
            "cell": {
                "name": self.cell, "capacity_c": 16200.0,
                "identity": {
                    "serial": self.serial, "batch": self.batch, "barcode": self.barcode,
                    "chemistry": "NMC / graphite", "maker": "Molicel", "term": "https://v.example/c",
                },
            },
            "seed": self.number, "time": if self.is_virtual { "virtual" } else { "real" },
            "simulated": false, "config_sha256": "00", "files": {},
            "started_unix_s": (!self.is_virtual).then(|| self.started_unix_s()),
            "instruments": [{ "role": "scope", "model": "mock" }],
            "status": self.how, "bench_time_s": 100.0,
        })
    }

    fn journal(&self) -> String {
        let started = json!({ "started": {
            "version": "0.1.0", "experiment": self.experiment, "seed": self.number, "time": "real",
            "inherited": false, "files": [], "plan": [],
        }});
        let answered = json!({ "answered": { "question": 2, "by": "ann" } });
        let ended = self
            .how
            .as_ref()
            .map(|how| json!({ "ended": { "how": how } }));
        let point = json!({ "point": { "stage": 1, "step": 2, "long": "x".repeat(400) } });
        let points = std::iter::repeat_n(point, POINTS);
        let entries = [started, answered].into_iter().chain(points).chain(ended);
        let line = |(number, entry): (usize, Value)| {
            // In the journal's format the entry follows the number and the time.
            format!("{{\"number\":{number},\"time_s\":1.5,\"entry\":{entry},\"sha256\":\"00\"}}\n")
        };
        (1..).zip(entries).map(line).collect()
    }

    fn index(&self) -> Value {
        let flagged = json!({ "freq_hz": 1.0, "reasons": ["noise"] });
        json!({
            "cell": self.cell, "capacity_c": 16200.0, "traces": [],
            "sweeps": [{
                "cell": self.cells.first(), "file": SPECTRUM, "fixture": "cell", "fixture_ohm": null, "corrected": true,
                "amplitude_a": 1.0, "repeat": 1, "order": 0, "start_time_s": 50.0,
                "start_ocv_v": 3.7, "temperature_c": 25.0, "role": "train",
                "repeat_group": "eis", "flagged": vec![flagged; self.refused],
            }],
        })
    }

    fn spectrum(&self) -> String {
        let head = "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a";
        let rows = (0..POINTS).map(|k| {
            let freq_hz = 10.0_f64.powf(-1.0 + 0.2 * k as f64);
            let x = freq_hz / 3.0;
            let (re, im) = (0.004 / (1.0 + x * x), -0.004 * x / (1.0 + x * x));
            let re = self.r_ohm() + re;
            format!("{freq_hz:?},{re:?},{im:?},3e-6,3e-6,0.0,1.0\n")
        });
        format!("{head}\n{}", rows.collect::<String>())
    }

    fn model(&self, rc: usize) -> Value {
        let branches: Vec<Value> = (0..rc)
            .map(|k| json!({ "r_ohm": 0.004 + 0.001 * k as f64, "c_f": 10.0 }))
            .collect();
        let sigmas = json!({ "r_ohm": 1e-5, "c_f": 0.1, "time_constant_s": 0.01 });
        let dc_ohm = self.r_ohm() + 0.004 * rc as f64;
        json!({
            "schema": MODEL_SCHEMA, "schema_version": 1, "name": self.cell, "rc": rc,
            "fit": {
                "erm": { "r_ohm": self.r_ohm(), "branches": branches },
                "sigma": {
                    "r_ohm": 1e-6, "branches": vec![sigmas; rc], "dc_resistance_ohm": 2e-6,
                },
                "objective": 1.0, "points": POINTS, "rms_ohm": 3e-6, "reduced_chi2": 1.1,
            },
            "dc_resistance_ohm": dc_ohm, "time_constants_s": vec![0.04; rc],
            "spectra": ["spectrum"],
        })
    }
}

/// A folder of run folders with a catalogue beside them.
pub(crate) struct Place {
    _folder: tempfile::TempDir,
    /// Directory of the run folders.
    pub(crate) runs: PathBuf,
    /// The catalogue.
    pub(crate) catalog: PathBuf,
}

impl Place {
    /// Returns a place with runs.
    pub(crate) fn with(runs: &[Made]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let place = Self {
            runs: folder.path().join("runs"),
            catalog: folder.path().join("catalog.sqlite"),
            _folder: folder,
        };
        fs::create_dir(&place.runs).unwrap();
        for run in runs {
            run.write(&place.runs);
        }
        place
    }

    /// Scans the run folders.
    pub(crate) fn scan(&self) -> Scanned {
        let catalog = Catalog::make(&self.catalog).unwrap();
        catalog
            .scan(std::slice::from_ref(&self.runs), &ScanOptions::plain())
            .unwrap()
    }

    /// Opens the catalogue for queries.
    pub(crate) fn open(&self) -> Catalog {
        Catalog::open(&self.catalog).unwrap()
    }

    /// Returns the names of the runs that meet conditions.
    pub(crate) fn names(&self, filter: &Filter) -> Vec<String> {
        let found = self.open().runs(filter).unwrap();
        found.runs.into_iter().map(|run| run.name).collect()
    }
}

/// Returns a filter of these conditions.
pub(crate) fn filter(conditions: &[(&str, &str)]) -> Filter {
    let mut filter = Filter::default();
    for (name, value) in conditions {
        let text = Some((*value).to_owned());
        match *name {
            "cell" => filter.cell = text,
            "serial" => filter.serial = text,
            "batch" => filter.batch = text,
            "bench" => filter.bench = text,
            "experiment" => filter.experiment = text,
            "text" => filter.text = text,
            "verdict" => filter.verdict = CatalogVerdict::of_word(value),
            "most" => filter.most = value.parse().unwrap(),
            "trip" => filter.trip = true,
            _ => panic!("{name}"),
        }
    }
    filter
}

/// Returns every reply of a catalogue as text: equal texts mean equal replies.
pub(crate) fn answers(catalog: &Catalog) -> String {
    let all = Filter::default();
    let runs = catalog.all_runs(&all).unwrap();
    let shown: Vec<_> = runs
        .iter()
        .map(|run| catalog.show(&run.run).unwrap())
        .collect();
    let cells = Filter {
        most: 1000,
        ..all.clone()
    };
    let cells = catalog.cells(&cells).unwrap();
    let of_cell = |cell: &str| Filter {
        cell: Some(cell.to_owned()),
        ..Filter::default()
    };
    let ageing = cells.cells.iter().map(|cell| {
        let of_cell = of_cell(&cell.cell);
        let listed = catalog.cells(&of_cell).unwrap();
        json!([catalog.ageing(&of_cell, None).unwrap(), listed])
    });
    let ageing: Vec<_> = ageing.collect();
    let spectra = catalog.all_spectra(&all).unwrap();
    let diagnoses = catalog.all_diagnoses(&all).unwrap();
    let fits = catalog.all_fits(&all).unwrap();
    serde_json::to_string(&json!([shown, spectra, fits, diagnoses, cells, ageing])).unwrap()
}
