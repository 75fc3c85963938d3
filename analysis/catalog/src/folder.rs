//! Reads a run folder into the records of the catalogue. A file that cannot be read is reported and
//! does not stop the reading.

use std::{
    fs,
    os::unix::fs::MetadataExt,
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use analysis_files::{
    dataset::{RunIndex, SweepEntry, read_spectrum_csv},
    run_folder::{self, CAMPAIGN, INDEX, JOURNAL, MANIFEST, MAP, MAP_LOGS, SUMS},
};
use analysis_fit::{
    fit::{MODEL_SCHEMA, MODEL_SCHEMA_VERSION},
    given::GivenModel,
};
use analysis_signal::spectrum::ImpedancePoint;
use serde::{Deserialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};

use crate::{
    journal::{self, Told},
    record::{
        CatalogCell, CatalogFit, CatalogMap, CatalogRun, CatalogSpectrum, CatalogVerdict, Folder,
        TimeSource,
    },
};

/// Fixture in the jig for a spectrum of a cell.
pub(crate) const CELL: &str = "cell";

/// Facts of a run beside its folder, by the server that began it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Beside {
    /// Operator who requested the run.
    pub operator: Option<String>,
    /// How the run ended; counts if the journal has no end entry.
    pub how: Option<String>,
    /// Tags of the run.
    pub tags: Vec<String>,
    /// Texts of the notes about the run.
    pub notes: Vec<String>,
}

impl Beside {
    /// Returns a digest of all facts.
    fn digest(&self) -> String {
        hex(&Sha256::digest(format!("{self:?}"))[..8])
    }
}

#[derive(Debug, Default, Deserialize)]
struct ManifestCell {
    #[serde(default)]
    name: String,
    #[serde(default)]
    identity: Identity,
}

/// Identity of a cell, or of a kind of cell.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct Identity {
    serial: Option<String>,
    batch: Option<String>,
    barcode: Option<String>,
    maker: Option<String>,
    chemistry: Option<String>,
    term: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Manifest {
    version: String,
    experiment: String,
    bench: String,
    cell: ManifestCell,
    specimen: Option<String>,
    seed: u64,
    time: String,
    simulated: bool,
    config_sha256: Option<String>,
    started_unix_s: Option<f64>,
    instruments: serde_json::Value,
    bench_time_s: f64,
}

#[derive(Debug, Deserialize)]
struct CampaignFile {
    cells: Vec<CampaignCell>,
}

#[derive(Debug, Deserialize)]
struct CampaignCell {
    name: String,
    #[serde(flatten)]
    identity: Identity,
}

#[derive(Debug, Deserialize)]
struct ModelHead {
    schema: String,
    schema_version: u32,
}

#[derive(Debug, Deserialize)]
struct Model {
    rc: u32,
    fit: Fit,
    dc_resistance_ohm: f64,
    #[serde(default)]
    time_constants_s: Vec<f64>,
}

#[derive(Debug, Deserialize)]
struct Fit {
    erm: Erm,
    sigma: Sigma,
    rms_ohm: f64,
    reduced_chi2: Option<f64>,
    points: u32,
}

#[derive(Debug, Deserialize)]
struct Erm {
    r_ohm: f64,
    branches: Vec<Pair>,
}

#[derive(Debug, Deserialize)]
struct Pair {
    r_ohm: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Sigma {
    r_ohm: Option<f64>,
    branches: Vec<PairSigma>,
    dc_resistance_ohm: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct PairSigma {
    r_ohm: Option<f64>,
    time_constant_s: Option<f64>,
}

/// Returns the identity of a folder: the first 16 digits of the SHA-256 of its absolute path.
pub(crate) fn identity(folder: &Path) -> String {
    let path = folder.as_os_str().as_encoded_bytes();
    hex(&Sha256::digest(path)[..8])
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns whether a folder is that of a run.
pub(crate) fn is_run(folder: &Path) -> bool {
    [MANIFEST, JOURNAL]
        .iter()
        .any(|name| folder.join(name).is_file())
}

/// Returns the state of the files of a folder: the part that changes when the run continues or is
/// computed again.
pub(crate) fn stamp(folder: &Path, beside: &Beside) -> String {
    let of = |path: &Path| {
        fs::metadata(path).map_or_else(
            |_| "-".to_owned(),
            |meta| format!("{}:{}.{}", meta.len(), meta.mtime(), meta.mtime_nsec()),
        )
    };
    let files = [MANIFEST, SUMS, JOURNAL, INDEX].map(|name| of(&folder.join(name)));
    format!("{} {} {}", of(folder), files.join(" "), beside.digest())
}

/// Reads a run folder.
pub(crate) fn read(folder: &Path, stamp: String, beside: Beside) -> Folder {
    let mut reading = Reading::of(folder, beside);
    let spectra = reading.spectra();
    let fits = reading.fits(&spectra);
    let map = reading.map();
    let run = reading.run(&spectra, fits.len(), map);
    Folder {
        run,
        stamp,
        instruments: reading.manifest.instruments,
        notes: reading.beside.notes,
        spectra,
        fits,
        events: reading.journal.events,
    }
}

/// A run folder that is being read.
struct Reading<'a> {
    folder: &'a Path,
    run: String,
    manifest: Manifest,
    journal: Told,
    index: RunIndex,
    cells: Vec<CatalogCell>,
    beside: Beside,
    damage: Vec<String>,
}

impl<'a> Reading<'a> {
    fn of(folder: &'a Path, beside: Beside) -> Self {
        let mut damage = Vec::new();
        let mut journal = journal::read(folder).unwrap_or_else(|reason| {
            damage.push(reason);
            Told::default()
        });
        let manifest: Option<Manifest> = json(folder, MANIFEST, &mut damage);
        if manifest.is_none() && damage.is_empty() && journal.how.is_some() {
            damage.push(format!("{MANIFEST}: expected of an ended run, found none"));
        }
        journal.how = journal.how.or_else(|| beside.how.clone());
        let index: RunIndex = json(folder, INDEX, &mut damage).unwrap_or_default();
        let manifest = manifest.unwrap_or_default();
        let cells = cells(folder, &manifest, &journal, &index);
        Self {
            folder,
            run: identity(folder),
            beside,
            manifest,
            journal,
            index,
            cells,
            damage,
        }
    }

    fn name(&self) -> String {
        let name = self.folder.file_name();
        name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    }

    fn time_source(&self) -> TimeSource {
        match self.manifest.started_unix_s {
            Some(_) => TimeSource::Clock,
            None => TimeSource::File,
        }
    }

    fn started_unix_s(&self) -> f64 {
        let file = || {
            [MANIFEST, JOURNAL]
                .iter()
                .find_map(|name| fs::metadata(self.folder.join(name)).ok()?.modified().ok())
                .map_or(0.0, unix_s)
        };
        self.manifest.started_unix_s.unwrap_or_else(file)
    }

    /// Returns the cell of an entry of the index: its own, or the only one.
    fn cell_of(&self, sweep: &SweepEntry) -> String {
        match (&sweep.cell, self.cells.as_slice()) {
            (Some(cell), _) => cell.clone(),
            (None, [one]) => one.name.clone(),
            _ => self.index.cell.clone(),
        }
    }

    fn spectra(&mut self) -> Vec<CatalogSpectrum> {
        let sweeps = std::mem::take(&mut self.index.sweeps);
        let spectra = sweeps.iter().map(|sweep| self.spectrum(sweep)).collect();
        self.index.sweeps = sweeps;
        spectra
    }

    fn spectrum(&mut self, sweep: &SweepEntry) -> CatalogSpectrum {
        let points = read_spectrum_csv(&self.folder.join(&sweep.file)).unwrap_or_else(|error| {
            let reason = error.to_string();
            let within = format!("{}/", self.folder.display());
            self.damage.push(reason.replace(&within, ""));
            Vec::new()
        });
        let ends = Ends::of(points);
        let real = self.manifest.started_unix_s;
        let cell = self.cell_of(sweep);
        let known = self.cells.iter().find(|known| known.name == cell);
        CatalogSpectrum {
            run: self.run.clone(),
            name: self.name(),
            file: sweep.file.clone(),
            bench: self.manifest.bench.clone(),
            serial: known.and_then(CatalogCell::any_serial),
            batch: known.and_then(|known| known.batch.clone()),
            chemistry: known.and_then(|known| known.chemistry.clone()),
            cell,
            fixture: sweep.fixture.clone(),
            corrected: sweep.corrected,
            repeat: count(sweep.repeat),
            started_unix_s: real.map_or_else(
                || self.started_unix_s(),
                |started| started + sweep.start_time_s,
            ),
            time_source: self.time_source(),
            amplitude_a: sweep.amplitude_a,
            bias_a: sweep.bias_a,
            ocv_v: sweep.start_ocv_v,
            temperature_degc: sweep.temperature_degc,
            points: ends.points,
            refused_points: count(sweep.flagged.len()),
            low_hz: ends.low.map(|point| point.freq_hz),
            high_hz: ends.high_hz,
            r_high_ohm: ends.crossing.map(|point| point.r_ohm),
            r_high_hz: ends.crossing.map(|point| point.freq_hz),
            r_high_sigma_ohm: ends.crossing.and_then(|point| point.sigma_ohm),
            r_low_ohm: ends.low.map(|point| point.r_ohm),
            r_low_sigma_ohm: ends.low.and_then(|point| point.sigma_ohm),
        }
    }

    fn fits(&mut self, spectra: &[CatalogSpectrum]) -> Vec<CatalogFit> {
        let entries = fs::read_dir(self.folder).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .filter_map(|entry| entry.file_name().into_string().ok())
            .filter(|name| run_folder::is_model(name))
            .collect();
        names.sort();
        let first = spectra.iter().find(|spectrum| spectrum.fixture == CELL);
        names
            .into_iter()
            .filter_map(|name| self.fit(name, first))
            .collect()
    }

    fn fit(&mut self, file: String, first: Option<&CatalogSpectrum>) -> Option<CatalogFit> {
        let text = match fs::read(self.folder.join(&file)) {
            Ok(text) => text,
            Err(error) => {
                self.damage.push(format!("{file}: {error}"));
                return None;
            }
        };
        let model = model(&text);
        let model = model.map_err(|reason| self.damage.push(format!("{file}: {reason}")));
        let model = model.ok()?;
        let slowest = model.fit.erm.branches.len().checked_sub(1);
        let slow_sigma = slowest.and_then(|at| model.fit.sigma.branches.get(at));
        let only = match self.cells.as_slice() {
            [one] => Some(one),
            _ => None,
        };
        Some(CatalogFit {
            run: self.run.clone(),
            name: self.name(),
            file,
            bench: self.manifest.bench.clone(),
            cell: only.map_or_else(|| self.manifest.cell.name.clone(), |one| one.name.clone()),
            serial: only.and_then(CatalogCell::any_serial),
            batch: only.and_then(|one| one.batch.clone()),
            cells: count(self.cells.len()),
            rc: model.rc,
            started_unix_s: self.started_unix_s(),
            time_source: self.time_source(),
            temperature_degc: first.and_then(|spectrum| spectrum.temperature_degc),
            ocv_v: first.and_then(|spectrum| spectrum.ocv_v),
            r_ohm: model.fit.erm.r_ohm,
            r_sigma_ohm: model.fit.sigma.r_ohm,
            dc_resistance_ohm: model.dc_resistance_ohm,
            dc_resistance_sigma_ohm: model.fit.sigma.dc_resistance_ohm,
            slow_r_ohm: slowest.map(|at| model.fit.erm.branches[at].r_ohm),
            slow_r_sigma_ohm: slow_sigma.and_then(|sigma| sigma.r_ohm),
            slow_tau_s: model.time_constants_s.last().copied(),
            slow_tau_sigma_s: slow_sigma.and_then(|sigma| sigma.time_constant_s),
            time_constants_s: model.time_constants_s,
            rms_ohm: model.fit.rms_ohm,
            reduced_chi2: model.fit.reduced_chi2,
            points: model.fit.points,
        })
    }

    /// Reads the map that the run has fitted, if there is one.
    fn map(&mut self) -> Option<CatalogMap> {
        let text = match fs::read_to_string(self.folder.join(MAP)) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
            Err(error) => {
                self.damage.push(format!("{MAP}: {error}"));
                return None;
            }
        };
        let model = GivenModel::from_json(&text, MAP, None);
        let model = model.map_err(|error| self.damage.push(format!("{MAP}: {error}")));
        let map = model.ok()?.map?;
        let logs = fs::read_to_string(self.folder.join(MAP_LOGS)).unwrap_or_default();
        Some(CatalogMap {
            soc_low: *map.soc.first()?,
            soc_high: *map.soc.last()?,
            temperature_low_degc: *map.temperature_degc.first()?,
            temperature_high_degc: *map.temperature_degc.last()?,
            left_out_mv: largest(&logs, "left_out_rms_mv"),
        })
    }

    fn run(&self, spectra: &[CatalogSpectrum], fits: usize, map: Option<CatalogMap>) -> CatalogRun {
        let Self {
            manifest,
            journal,
            beside,
            ..
        } = self;
        let or = |one: &str, other: &str| if one.is_empty() { other } else { one }.to_owned();
        let corrected =
            |spectrum: &&CatalogSpectrum| spectrum.fixture == CELL && spectrum.corrected;
        let refused = spectra.iter().map(|spectrum| spectrum.refused_points).sum();
        CatalogRun {
            run: self.run.clone(),
            name: self.name(),
            folder: self.folder.to_string_lossy().into_owned(),
            missing: false,
            version: or(&manifest.version, &journal.version),
            experiment: or(&manifest.experiment, &journal.experiment),
            bench: manifest.bench.clone(),
            cells: self.cells.clone(),
            operator: beside.operator.clone().or_else(|| journal.by.clone()),
            tags: beside.tags.clone(),
            notes: count(beside.notes.len()),
            seed: if manifest.seed == 0 {
                journal.seed
            } else {
                manifest.seed
            },
            time: or(&manifest.time, &journal.time),
            simulated: manifest.simulated,
            started_unix_s: self.started_unix_s(),
            time_source: self.time_source(),
            bench_time_s: manifest.bench_time_s,
            how: journal.how.clone(),
            verdict: self.verdict(refused),
            trip: journal.trip().map(str::to_owned),
            resumed: journal.resumed,
            spectra: count(spectra.iter().filter(corrected).count()),
            refused_points: refused,
            fits: count(fits),
            map,
            config_sha256: manifest.config_sha256.clone(),
            content_sha256: content_sha256(self.folder),
            damage: self.damage.clone(),
        }
    }

    fn verdict(&self, refused: u32) -> CatalogVerdict {
        match &self.journal.how {
            _ if !self.damage.is_empty() => CatalogVerdict::Damaged,
            None => CatalogVerdict::Unfinished,
            Some(how) if run_folder::is_stopped(how) => CatalogVerdict::Stopped,
            Some(_) if !self.journal.is_finished() => CatalogVerdict::Failed,
            Some(_) if refused > 0 || self.journal.soc_missed => CatalogVerdict::Doubtful,
            Some(_) => CatalogVerdict::Good,
        }
    }
}

/// Returns the specimens of a campaign or of the operator's answers, otherwise the one cell.
fn cells(folder: &Path, manifest: &Manifest, journal: &Told, index: &RunIndex) -> Vec<CatalogCell> {
    let kind = &manifest.cell;
    let named = |name: &str, own: Identity| CatalogCell {
        name: name.to_owned(),
        serial: own.serial,
        scanned_serial: None,
        model: Some(kind.name.clone()).filter(|model| !model.is_empty() && model != name),
        batch: own.batch.or_else(|| kind.identity.batch.clone()),
        barcode: own.barcode,
        maker: own.maker.or_else(|| kind.identity.maker.clone()),
        chemistry: own.chemistry.or_else(|| kind.identity.chemistry.clone()),
        term: own.term.or_else(|| kind.identity.term.clone()),
    };
    let of_serial = |serial: Option<&String>| Identity {
        serial: serial.cloned(),
        ..Identity::default()
    };
    if let Some(name) = &manifest.specimen {
        return vec![CatalogCell {
            scanned_serial: journal.scanned.clone(),
            ..named(name, kind.identity.clone())
        }];
    }
    // A run of one cell has no such file; its end is stored elsewhere.
    let campaign: Option<CampaignFile> = json(folder, CAMPAIGN, &mut Vec::new());
    let campaign = campaign.into_iter().flat_map(|file| file.cells);
    let mut cells: Vec<CatalogCell> = campaign
        .map(|cell| named(&cell.name, cell.identity))
        .collect();
    let mut add = |cell: CatalogCell| {
        let known = cells.iter_mut().find(|known| known.name == cell.name);
        match known {
            Some(known) => {
                known.serial = known.serial.take().or(cell.serial);
                known.scanned_serial = cell.scanned_serial.or(known.scanned_serial.take());
            }
            None => cells.push(cell),
        }
    };
    for asked in &journal.cells {
        add(CatalogCell {
            scanned_serial: asked.scanned.clone(),
            ..named(&asked.name, of_serial(asked.serial.as_ref()))
        });
    }
    for cell in index.sweeps.iter().filter_map(|sweep| sweep.cell.as_ref()) {
        add(named(cell, Identity::default()));
    }
    let one = [&index.cell, &kind.name]
        .into_iter()
        .find(|name| !name.is_empty());
    if let Some(name) = one.filter(|_| cells.is_empty()) {
        cells.push(CatalogCell {
            scanned_serial: journal.scanned.clone(),
            ..named(name, kind.identity.clone())
        });
    }
    cells
}

/// Reads a JSON file. Returns `None` if it does not exist; any other failure counts as damage.
fn json<T: DeserializeOwned>(folder: &Path, name: &str, damage: &mut Vec<String>) -> Option<T> {
    let text = match fs::read(folder.join(name)) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        Err(error) => {
            damage.push(format!("{name}: {error}"));
            return None;
        }
    };
    match serde_json::from_slice(&text) {
        Ok(value) => Some(value),
        Err(error) => {
            damage.push(format!(
                "{name}: expected JSON of this program, found {error}"
            ));
            None
        }
    }
}

fn model(text: &[u8]) -> Result<Model, String> {
    let head: ModelHead = serde_json::from_slice(text).map_err(|error| error.to_string())?;
    if head.schema != MODEL_SCHEMA || !(1..=MODEL_SCHEMA_VERSION).contains(&head.schema_version) {
        return Err(format!(
            "schema: expected {MODEL_SCHEMA} version 1 to {MODEL_SCHEMA_VERSION}, \
             found {} version {}",
            head.schema, head.schema_version
        ));
    }
    let model: Model = serde_json::from_slice(text).map_err(|error| error.to_string())?;
    let pairs = model.fit.erm.branches.len();
    if model.rc as usize != pairs {
        return Err(format!(
            "rc: expected {pairs}, the number of pairs, found {}",
            model.rc
        ));
    }
    Ok(model)
}

/// Returns the largest number of a column of a table, given as text.
fn largest(table: &str, column: &str) -> Option<f64> {
    let mut lines = table.lines();
    let place = lines.next()?.split(',').position(|name| name == column)?;
    let number = |line: &str| line.split(',').nth(place)?.parse::<f64>().ok();
    lines.filter_map(number).reduce(f64::max)
}

fn content_sha256(folder: &Path) -> Option<String> {
    let list = fs::read(folder.join(SUMS)).ok()?;
    Some(hex(&Sha256::digest(list)))
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

/// Seconds since 1970, negative before.
fn unix_s(time: SystemTime) -> f64 {
    match time.duration_since(UNIX_EPOCH) {
        Ok(since) => since.as_secs_f64(),
        Err(before) => -before.duration().as_secs_f64(),
    }
}

/// A resistance at a frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Resistance {
    freq_hz: f64,
    r_ohm: f64,
    sigma_ohm: Option<f64>,
}

impl Resistance {
    fn of(point: &ImpedancePoint) -> Self {
        let sigma_ohm = point.covariance.re_re.sqrt();
        Self {
            freq_hz: point.freq_hz,
            r_ohm: point.z_ohm.re,
            sigma_ohm: Some(sigma_ohm).filter(|sigma| sigma.is_finite()),
        }
    }
}

/// The two ends of a spectrum.
#[derive(Debug, Default)]
struct Ends {
    points: u32,
    low: Option<Resistance>,
    high_hz: Option<f64>,
    crossing: Option<Resistance>,
}

impl Ends {
    fn of(mut points: Vec<ImpedancePoint>) -> Self {
        points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
        Self {
            points: count(points.len()),
            low: points.first().map(Resistance::of),
            high_hz: points.last().map(|point| point.freq_hz),
            crossing: crossing(&points),
        }
    }
}

/// Returns the resistance at the sign change of the imaginary part, between the two points beside
/// it, otherwise that at the highest frequency.
fn crossing(points: &[ImpedancePoint]) -> Option<Resistance> {
    let between = points.windows(2).rev().find_map(|pair| {
        let [low, high] = pair else { return None };
        if !(low.z_ohm.im < 0.0 && high.z_ohm.im >= 0.0) {
            return None;
        }
        let share = -low.z_ohm.im / (high.z_ohm.im - low.z_ohm.im);
        let mix = |a: f64, b: f64| a + share * (b - a);
        let [low, high] = [low, high].map(Resistance::of);
        Some(Resistance {
            freq_hz: mix(low.freq_hz.ln(), high.freq_hz.ln()).exp(),
            r_ohm: mix(low.r_ohm, high.r_ohm),
            sigma_ohm: low.sigma_ohm.zip(high.sigma_ohm).map(|(a, b)| a.max(b)),
        })
    });
    between.or_else(|| points.last().map(Resistance::of))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resistance_at_the_change_of_sign_lies_between_its_points() {
        let point = |freq_hz: f64, re: f64, im: f64| {
            let value = serde_json::json!({
                "freq_hz": freq_hz, "z_ohm": [re, im], "amplitude_a": 1.0,
                "covariance": { "re_re": 1e-12, "im_im": 1e-12, "re_im": 0.0 },
            });
            serde_json::from_value::<ImpedancePoint>(value).unwrap()
        };
        let points = [
            point(1.0, 3.0, -1.0),
            point(100.0, 2.0, -0.25),
            point(10_000.0, 1.0, 0.75),
        ];
        let found = crossing(&points).unwrap();
        assert!((found.r_ohm - 1.75).abs() < 1e-12 && (found.freq_hz - 316.227_766).abs() < 1e-3);
        assert_eq!(crossing(&points[..2]).unwrap().freq_hz, 100.0);
    }
}
