//! Reads a run folder of this program as a data set: by its index `traces.json`, or without one,
//! the sweep of the cell alone.
//!
//! Controls are not runs of the data set if the correction of the cell's sweep uses them: their
//! raw data show a harness that the cell's spectrum no longer has.

use std::path::{Path, PathBuf};

use analysis::{
    contract::CommonModeImpedance,
    dataset::{RunIndex, SweepEntry, TraceEntry, TraceRow, read_trace_csv},
    diagnosis::{BenchHistory, DataSet, Fixture, Role, Run, RunData, Start, TimeRecord},
    run_folder::{
        CONFIG, EVENTS, Event, EventRow, HARMONICS, INDEX, MANIFEST, READINGS, ReadingRow,
        SPECTRUM, SweepHarmonic, read_harmonics,
    },
    series::TimeSeries,
    spectrum::FlaggedPoint,
};
use serde::Deserialize;

use super::{
    DataSetProblem, Flagged, Loaded, Reading,
    files::{self, FileError, Files},
    raw::sign,
    resolve::{CONTROL_SOC, stem},
};
use bench_plan::config::ConfigError;

/// Standard deviation of a voltage that was not measured, V: an offset of the supply can move it
/// by this amount.
const UNSEEN_V: f64 = 3e-3;
/// First word of the groups of multisines.
const MULTISINE: &str = "multisine";
/// Assumed temperature of a run without a thermometer, °C.
const ROOM_C: f64 = 25.0;

/// Reads a run folder. Points that its quality gate has refused are left out, unless they are
/// requested here or were requested in the experiment.
///
/// # Errors
/// [`ConfigError`] for a folder that is not a run folder, or whose files have another format than
/// those of this program.
pub(super) fn read(folder: &Path, how: Reading) -> Result<Loaded, ConfigError> {
    let manifest: Manifest = json(
        &folder.join(MANIFEST),
        &format!(
            "expected {} or a run folder with {MANIFEST}",
            super::DATASET_FILE
        ),
    )?;
    let mut reader = Reader {
        folder,
        loaded: empty(manifest.experiment),
        files: Files::default(),
        refused_points: how.refused_points,
        harmonics: Vec::new(),
        swept: 0,
    };
    reader.loaded.set.calibration = how.known;
    reader.configured();
    if !folder.join(INDEX).is_file() {
        reader.the_sweep(&manifest.cell.name)?;
        reader.loaded.leave_out_refused();
        return Ok(reader.loaded);
    }
    let index: RunIndex = json(&folder.join(INDEX), "expected the index of a run")?;
    if folder.join(HARMONICS).is_file() {
        reader.harmonics = read_harmonics(&folder.join(HARMONICS))
            .map_err(|text| unreadable(&folder.join(HARMONICS), &text))?;
    }
    let first_s = index
        .sweeps
        .iter()
        .map(|s| s.start_time_s)
        .chain(index.traces.iter().map(|t| t.start_time_s))
        .fold(f64::INFINITY, f64::min);
    let named = |own: &Option<String>| own.clone().unwrap_or_else(|| index.cell.clone());
    index
        .sweeps
        .iter()
        .try_for_each(|sweep| reader.sweep(&named(&sweep.cell), sweep, first_s))?;
    index
        .traces
        .iter()
        .try_for_each(|trace| reader.trace(&named(&trace.cell), trace, first_s))?;
    reader.loaded.leave_out_refused();
    Ok(reader.loaded)
}

fn empty(name: String) -> Loaded {
    let set = DataSet {
        name,
        runs: Vec::new(),
        history: None,
        calibration: None,
    };
    Loaded {
        set,
        problems: Vec::new(),
        findings: Vec::new(),
        accept: Vec::new(),
        notes: Vec::new(),
        refused: Vec::new(),
    }
}

#[derive(Debug, Deserialize)]
struct Manifest {
    experiment: String,
    cell: Cell,
}

#[derive(Debug, Deserialize)]
struct Cell {
    name: String,
}

/// Place among all runs.
fn order(place: usize) -> u32 {
    u32::try_from(place).unwrap_or(u32::MAX)
}

/// From when to when each row is a mean, s.
type Windows = Vec<(f64, f64)>;

struct Reader<'a> {
    folder: &'a Path,
    loaded: Loaded,
    files: Files,
    /// Points that the quality gate has refused are used, too.
    refused_points: bool,
    /// Harmonics of the sweeps of cells.
    harmonics: Vec<SweepHarmonic>,
    /// Sweeps of cells that were read.
    swept: usize,
}

impl Reader<'_> {
    /// Reads the bench's past from its file, and whether the experiment wanted refused points. The
    /// run keeps copies of both among its configuration.
    fn configured(&mut self) {
        let Ok(entries) = std::fs::read_dir(self.folder.join(CONFIG)) else {
            return;
        };
        let mut files: Vec<PathBuf> = entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect();
        files.retain(|path| {
            path.extension()
                .is_some_and(|extension| extension == "toml")
        });
        files.sort();
        for path in files {
            let Some(table) = std::fs::read_to_string(&path)
                .ok()
                .and_then(|text| text.parse::<toml::Table>().ok())
            else {
                continue;
            };
            let wanted = table
                .get("fit")
                .and_then(|fit| fit.get("refused_points"))
                .and_then(toml::Value::as_bool);
            self.refused_points |= wanted.unwrap_or(false);
            let Some(history) = table.get("history") else {
                continue;
            };
            match history.clone().try_into::<BenchHistory>() {
                Ok(history) => self.loaded.set.history = Some(history),
                Err(error) => self.note(format!(
                    "{}: [history] is not as expected and not used: {}",
                    path.display(),
                    error.message()
                )),
            }
        }
    }

    fn sweep(&mut self, cell: &str, entry: &SweepEntry, first_s: f64) -> Result<(), ConfigError> {
        let name = stem(&entry.file);
        let fixture = match (entry.fixture.as_str(), entry.fixture_ohm) {
            ("cell", _) => Fixture::Cell(cell.to_owned()),
            ("shunt", Some(ohm)) => Fixture::Shunt(ohm),
            ("fake_cell", Some(ohm)) => Fixture::FakeCell(ohm),
            (met, _) => {
                return Err(self.complain(
                    INDEX,
                    format!(
                        "sweep {name}: expected a cell, or a \
                control with its resistance, found {met:?}"
                    ),
                ));
            }
        };
        // Multisines have no number among the sweeps.
        let is_sweep =
            matches!(fixture, Fixture::Cell(_)) && !entry.repeat_group.starts_with(MULTISINE);
        self.swept += usize::from(is_sweep);
        if !entry.corrected {
            self.note(format!(
                "{name}: its harness was not corrected by control impedances"
            ));
        }
        let start = match (&fixture, entry.start_ocv_v) {
            (_, Some(ocv_v)) => Start::Ocv(ocv_v),
            (Fixture::Cell(_), None) => {
                return Err(self.complain(
                    INDEX,
                    format!("sweep {name}: expected `start_ocv_v`, found none"),
                ));
            }
            _ => Start::Soc(CONTROL_SOC),
        };
        let Some((mut data, flagged)) = self.spectrum(&entry.file, &name)? else {
            return Ok(());
        };
        let flagged = if entry.flagged.is_empty() {
            flagged
        } else {
            entry.flagged.clone()
        };
        self.loaded.set.calibration = self.loaded.set.calibration.or(entry.common_error);
        if let RunData::Eis(sweep) = &mut data {
            sweep.common_mode = CommonModeImpedance {
                r_ohm: entry.below_ohm.unwrap_or(0.0),
                l_h: entry.below_h.unwrap_or(0.0),
            };
            self.loaded.flag(&Flagged {
                run: name.clone(),
                file: entry.file.clone(),
                points: sweep.points.len(),
                flagged,
                wanted: self.refused_points,
            });
            if sweep.points.len() == entry.elapsed_s.len() {
                sweep.elapsed_s.clone_from(&entry.elapsed_s);
            }
            if sweep.points.len() == entry.conditions.len() {
                let charges = entry.conditions.iter().map(|at| at.charge_coulomb);
                sweep.charge_coulomb = charges.collect();
            }
            if is_sweep {
                sweep.harmonics = files::harmonics(&self.harmonics, self.swept, entry.bias_a)
                    .map_err(|text| unreadable(&self.folder.join(HARMONICS), &text))?;
            }
            if self.loaded.set.calibration.is_some()
                && sweep.points.len() == entry.own_sigma_ohm.len()
            {
                // The residual error of the correction is common to all sweeps, and stated once
                // for all of them.
                let stated = |[re, im]: &[f64; 2]| {
                    Some((*re, *im)).filter(|(re, im)| *re > 0.0 && *im > 0.0)
                };
                sweep
                    .points
                    .iter_mut()
                    .zip(&entry.own_sigma_ohm)
                    .for_each(|(point, own)| point.sigma_ohm = stated(own).or(point.sigma_ohm));
            }
        }
        let temperature_degc = self.temperature(&name, entry.temperature_degc);
        self.loaded.set.runs.push(Run {
            name,
            fixture,
            role: entry.role,
            repeat_group: entry.repeat_group.clone(),
            order: order(entry.order),
            start_s: entry.start_time_s - first_s,
            temperature_degc,
            start,
            data,
        });
        Ok(())
    }

    fn trace(&mut self, cell: &str, entry: &TraceEntry, first_s: f64) -> Result<(), ConfigError> {
        let name = stem(&entry.file);
        let read = self.files.series(
            &self.folder.join(&entry.file),
            Some(sign(entry.current_positive)),
        );
        let part = read.map(|(series, _)| {
            files::window(series, f64::NEG_INFINITY, f64::INFINITY)
                .map(|all| files::part(series, all))
        });
        let Some(Some(mut series)) = self.or_problem(&name, part)? else {
            return Ok(());
        };
        let rows = read_trace_csv(&self.folder.join(&entry.file))
            .map_err(|error| self.complain(&entry.file, error.to_string()))?;
        let row_s = first_row_s(&rows);
        let (mut sigma_v, mut averaged_s) =
            stated_errors(&rows, entry.sample_sigma_v, series.len());
        if let Some(sigma_v) = &mut sigma_v {
            self.rest_before(entry, row_s, &mut series, sigma_v, averaged_s.as_mut())?;
        }
        let temperature_degc = self.temperature(&name, entry.temperature_degc);
        self.loaded.set.runs.push(Run {
            name,
            fixture: Fixture::Cell(cell.to_owned()),
            role: entry.role,
            repeat_group: entry.repeat_group.clone(),
            order: order(entry.order),
            start_s: entry.start_time_s - first_s,
            temperature_degc,
            start: Start::Ocv(entry.start_ocv_v),
            data: RunData::Time(TimeRecord {
                series,
                between: entry.current_between_samples,
                compared_from_s: 0.0,
                level_sigma_v: 0.0,
                sigma_v,
                averaged_s,
                current_errors_a: Vec::new(),
            }),
        });
        Ok(())
    }

    /// Inserts the end of the rest before the first row, which is at `row_s` of test time: once
    /// the supply is on, its offset flows. The voltage is not measured then.
    fn rest_before(
        &self,
        entry: &TraceEntry,
        row_s: f64,
        series: &mut TimeSeries,
        sigma_v: &mut Vec<f64>,
        averaged_s: Option<&mut Windows>,
    ) -> Result<(), ConfigError> {
        let path = self.folder.join(EVENTS);
        let text = std::fs::read_to_string(&path)
            .map_err(|error| unreadable(&path, &error.to_string()))?;
        let ups = text
            .lines()
            .filter_map(EventRow::parse)
            .filter(|row| row.kind == Some(Event::OutputOn))
            .map(|row| row.time_s);
        let Some(up_s) = ups.rev().find(|up_s| *up_s < entry.start_time_s) else {
            return Ok(());
        };
        let since_s = row_s + entry.start_time_s - up_s;
        series
            .time_s
            .iter_mut()
            .for_each(|time_s| *time_s += since_s);
        series.time_s.insert(0, 0.0);
        series.current_a.insert(0, series.current_a[0]);
        series.voltage_v.insert(0, entry.start_ocv_v);
        if let Some(all) = &mut series.temperature_degc {
            all.insert(0, all[0]);
        }
        sigma_v.insert(0, UNSEEN_V);
        if let Some(windows) = averaged_s {
            windows
                .iter_mut()
                .for_each(|(from_s, to_s)| (*from_s, *to_s) = (*from_s + since_s, *to_s + since_s));
            windows.insert(0, (0.0, 0.0));
        }
        Ok(())
    }

    /// Adds the one sweep of a folder without an index. The rest voltage of the cell is in the
    /// readings.
    fn the_sweep(&mut self, cell: &str) -> Result<(), ConfigError> {
        let Some((data, flagged)) = self.spectrum(SPECTRUM, "spectrum")? else {
            return Ok(());
        };
        if let RunData::Eis(sweep) = &data {
            self.loaded.flag(&Flagged {
                run: "spectrum".to_owned(),
                file: SPECTRUM.to_owned(),
                points: sweep.points.len(),
                flagged,
                wanted: self.refused_points,
            });
        }
        let (ocv_v, temperature_degc) = self.readings()?;
        let temperature_degc = self.temperature("spectrum", temperature_degc);
        self.loaded.set.runs.push(Run {
            name: "spectrum".to_owned(),
            fixture: Fixture::Cell(cell.to_owned()),
            role: Role::Train,
            repeat_group: "spectrum".to_owned(),
            order: 0,
            start_s: 0.0,
            temperature_degc,
            start: Start::Ocv(ocv_v),
            data,
        });
        Ok(())
    }

    /// Voltage of the last reading at rest, else the mean under the last sweep; the last
    /// temperature.
    fn readings(&self) -> Result<(f64, Option<f64>), ConfigError> {
        let path = self.folder.join(READINGS);
        let text = std::fs::read_to_string(&path)
            .map_err(|error| unreadable(&path, &error.to_string()))?;
        let rows: Vec<ReadingRow<'_>> = text.lines().filter_map(ReadingRow::parse).collect();
        let rest_v = rows
            .iter()
            .rev()
            .filter(|row| row.phase == "rest")
            .find_map(|row| row.voltage_v);
        let swept: Vec<f64> = rows
            .iter()
            .rev()
            .skip_while(|row| row.phase != "sine")
            .take_while(|row| row.phase == "sine")
            .filter_map(|row| row.voltage_v)
            .collect();
        let mean_v = (!swept.is_empty()).then(|| swept.iter().sum::<f64>() / swept.len() as f64);
        let ocv_v = rest_v.or(mean_v).ok_or_else(|| {
            self.complain(
                READINGS,
                "expected a voltage at rest or under the sweep, found none",
            )
        })?;
        Ok((
            ocv_v,
            rows.iter().rev().find_map(|row| row.temperature_degc),
        ))
    }

    /// Returns a sweep, and the points that the quality gate has refused according to its file.
    fn spectrum(
        &mut self,
        file: &str,
        name: &str,
    ) -> Result<Option<(RunData, Vec<FlaggedPoint>)>, ConfigError> {
        let read = files::spectra(&self.folder.join(file));
        let spectra = self.or_problem(name, read)?.unwrap_or_default();
        if spectra.len() > 1 {
            let text = format!("{file}: expected one spectrum, met {}", spectra.len());
            self.loaded.problems.push(DataSetProblem {
                run: name.to_owned(),
                text,
            });
            return Ok(None);
        }
        Ok(spectra.first().map(|one| {
            let bias_a = one.origin.bias_a.unwrap_or(0.0);
            (
                // The diagnosis counts a discharge as positive.
                RunData::Eis(files::sweep(&one.spectrum, 0.0 - bias_a, None)),
                one.flagged.clone(),
            )
        }))
    }

    fn or_problem<T>(
        &mut self,
        name: &str,
        read: Result<T, FileError>,
    ) -> Result<Option<T>, ConfigError> {
        match read {
            Ok(content) => Ok(Some(content)),
            Err(FileError::Usage(text)) => Err(unreadable(self.folder, &text)),
            Err(FileError::Damaged(text)) => {
                self.loaded.problems.push(DataSetProblem {
                    run: name.to_owned(),
                    text,
                });
                Ok(None)
            }
        }
    }

    fn temperature(&mut self, name: &str, measured_degc: Option<f64>) -> f64 {
        measured_degc.unwrap_or_else(|| {
            self.note(format!(
                "{name}: its temperature was not measured, {ROOM_C} °C is taken"
            ));
            ROOM_C
        })
    }

    fn note(&mut self, text: String) {
        self.loaded.notes.push(text);
    }

    fn complain(&self, file: &str, reason: impl Into<String>) -> ConfigError {
        unreadable(&self.folder.join(file), &reason.into())
    }
}

/// Test time of the first row, s.
fn first_row_s(rows: &[TraceRow]) -> f64 {
    rows.first().map_or(0.0, |row| row.time_s)
}

/// Returns the noise of each of `rows` rows, and the averaging windows. The noise of a row is
/// that of one scope sample (V), reduced by the number of samples it averages. Windows are in the
/// time of the series, which begins with zero.
fn stated_errors(
    read: &[TraceRow],
    sample_sigma_v: f64,
    rows: usize,
) -> (Option<Vec<f64>>, Option<Windows>) {
    let row_s = first_row_s(read);
    let sigma_v: Vec<f64> = read
        .iter()
        .map(|row| sample_sigma_v / row.samples.max(1.0).sqrt())
        .collect();
    let stated = sigma_v.len() == rows && sigma_v.iter().all(|s| *s > 0.0);
    let windows: Windows = read
        .iter()
        .map(|row| (row.averaged_s.0 - row_s, row.averaged_s.1 - row_s))
        .collect();
    let in_order = windows.len() == rows && windows.iter().all(|(from_s, to_s)| from_s <= to_s);
    (stated.then_some(sigma_v), in_order.then_some(windows))
}

fn unreadable(path: &Path, reason: &str) -> ConfigError {
    ConfigError::Unreadable {
        path: path.to_owned(),
        reason: reason.to_owned(),
    }
}

fn json<T: serde::de::DeserializeOwned>(path: &Path, expected: &str) -> Result<T, ConfigError> {
    let fail = |error: &dyn std::fmt::Display| unreadable(path, &format!("{expected}: {error}"));
    let text = std::fs::read_to_string(path).map_err(|error| fail(&error))?;
    serde_json::from_str(&text).map_err(|error| fail(&error))
}
