//! Keys that a proposal lacks, because neither the files nor the user state them.

use serde::Serialize;

use super::runs::{FoundSpectrum, Place, ProposedRun};

/// A key that a person must fill in before `diagnose` accepts the data set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Missing {
    /// Run that lacks it.
    pub run: String,
    /// Its name in `dataset.toml`.
    pub key: &'static str,
    /// What to fill in, and why it is not there.
    pub text: &'static str,
    /// Option of `dataset init` that states it.
    pub option: String,
}

/// The missing keys of runs and of spectra that are used.
pub fn missing(runs: &[ProposedRun], spectra: &[FoundSpectrum]) -> Vec<Missing> {
    let used = spectra.iter().filter(|one| one.refusal.is_none());
    let of_spectra = used.flat_map(|one| of_place(&one.name, &one.place));
    runs.iter()
        .flat_map(|run| of_place(&run.name, &run.place))
        .chain(of_spectra)
        .collect()
}

/// The keys that the run of this name lacks.
pub(super) fn of_place(run: &str, place: &Place) -> Vec<Missing> {
    let mut all = Vec::new();
    if place.temperature_degc.is_none() {
        all.push(Missing {
            run: run.to_owned(),
            key: "temperature_c",
            text: "the temperature of the cell at the start, °C; the file holds none",
            option: "--temperature-c C".to_owned(),
        });
    }
    if place.soc.is_none() && place.ocv_v.is_none() {
        all.push(Missing {
            run: run.to_owned(),
            key: "soc",
            text: "the state of charge at the start, 0 to 1 (or `ocv_v`, the rest voltage, V); the file \
                   holds neither",
            option: format!("--at {run}:soc=SOC"),
        });
    }
    all
}
