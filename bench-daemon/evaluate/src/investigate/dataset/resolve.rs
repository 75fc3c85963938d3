//! `dataset.toml` → a data set. Every error names file, line, field and what was expected.

use std::{ops::RangeInclusive, path::Path};

use analysis::{
    augmented::Between,
    contract::CommonModeImpedance,
    dataset::CurrentPositive,
    diagnosis::{
        BenchHistory, DataSet, Finding, Fixture, Role, Run, RunData, Start, Sweep, TimeRecord,
    },
    formats::CurrentSign,
    run_folder::read_harmonics,
    series::TimeSeries,
    spectrum::{FlaggedPoint, SourcedSpectrum},
};

use super::{
    DataSetProblem, Flagged, Loaded, NamedFile, NamedFiles, Reading,
    files::{self, FileError, Files},
    raw,
};
use bench_plan::config::{ConfigError, Source, schema::Kind};

/// A control in the jig has no state of charge; a run must hold some.
pub(super) const CONTROL_SOC: f64 = 0.5;

/// Temperatures that a cell is measured at, °C.
const TEMPERATURES_C: RangeInclusive<f64> = -60.0..=120.0;

/// Reads the file and the runs that it lists.
///
/// # Errors
/// The first mistake, with file, line and field.
pub(super) fn read(path: &Path, how: Reading) -> Result<Loaded, ConfigError> {
    let source = Source::read(path)?;
    let raw: raw::File = source.parse_as(Kind::Dataset)?;
    // Assumed errors are as they should be for any current.
    let stated = raw.bench.as_ref().map(|bench| bench.completed(0.0));
    check_history(&source, stated.as_ref())?;
    let mut resolver = Resolver {
        source: &source,
        files: Files::default(),
        flagged: Vec::new(),
        findings: Vec::new(),
    };
    let (mut listed, mut problems) = (Vec::new(), Vec::new());
    let mut names: Vec<String> = Vec::new();
    for (index, entry) in raw.runs.iter().enumerate() {
        let number = index + 1;
        let name = entry.name.clone().unwrap_or_else(|| stem(&entry.file));
        if name.is_empty() || names.contains(&name) {
            return Err(source.complain(
                &format!("runs.{number}.name"),
                format!("expected a name of its own for every run, found {name:?}"),
            ));
        }
        names.push(name.clone());
        match resolver.run(number, name, entry)? {
            Ok(run) => listed.push((run, entry.start_s)),
            Err(problem) => problems.push(problem),
        }
    }
    if names.is_empty() {
        return Err(source.complain("runs", "expected at least one [[runs]], found none"));
    }
    let left = raw.calibration.as_ref();
    if left.is_some_and(|left| !left.is_finite()) {
        return Err(source.complain("calibration", "expected finite numbers"));
    }
    let runs = with_starts(listed);
    let notes = raw.bench.as_ref().and_then(assumed_note);
    let set = DataSet {
        name: raw.name,
        history: raw.bench.map(|bench| bench.completed(greatest_a(&runs))),
        runs,
        calibration: raw.calibration,
    };
    let mut loaded = Loaded {
        set,
        problems,
        notes: notes.into_iter().chain(resolver.files.notes).collect(),
        findings: resolver.findings,
        accept: raw.accept.iter().flatten().map(|one| one.kind()).collect(),
        refused: Vec::new(),
    };
    for flagged in resolver.flagged {
        loaded.flag(&Flagged {
            wanted: flagged.wanted || how.refused_points,
            ..flagged
        });
    }
    loaded.leave_out_refused();
    Ok(loaded)
}

/// Remark on the errors that `[bench]` does not state.
fn assumed_note(bench: &raw::StatedBench) -> Option<String> {
    let assumed = bench.assumed_keys();
    (!assumed.is_empty()).then(|| {
        format!(
            "[bench] does not state {}: they are assumed, and weighed as if they were known",
            assumed.join(", ")
        )
    })
}

/// Greatest current of these runs, A.
fn greatest_a(runs: &[Run]) -> f64 {
    let of = |run: &Run| match &run.data {
        RunData::Time(record) => {
            let size = record.series.current_a.iter().map(|a| a.abs());
            size.fold(0.0, f64::max)
        }
        RunData::Eis(sweep) => sweep.bias_a.abs(),
    };
    runs.iter().map(of).fold(0.0, f64::max)
}

/// Returns the files that the file names for a diagnosis.
///
/// # Errors
/// A file that cannot be read, or that contains something that it must not.
pub(super) fn named_files(path: &Path) -> Result<NamedFiles, ConfigError> {
    let source = Source::read(path)?;
    let raw: raw::File = source.parse_as(Kind::Dataset)?;
    let file = |key, path: Option<String>| path.map(|path| NamedFile::new(&source, key, &path));
    Ok(NamedFiles {
        model: file("model", raw.model),
        ocv: file("ocv", raw.ocv),
    })
}

/// Runs that state no start begin when the one before ends.
fn with_starts(mut listed: Vec<(Run, Option<f64>)>) -> Vec<Run> {
    let mut by_order: Vec<usize> = (0..listed.len()).collect();
    by_order.sort_by_key(|k| listed[*k].0.order);
    let mut free_s = 0.0;
    for k in by_order {
        let (run, stated_s) = &mut listed[k];
        run.start_s = stated_s.unwrap_or(free_s);
        free_s = run.start_s + least_duration_s(&run.data);
    }
    listed.into_iter().map(|(run, _)| run).collect()
}

/// Returns the minimum duration: the samples of a record, or at least one period of each
/// frequency of a sweep.
fn least_duration_s(data: &RunData) -> f64 {
    match data {
        RunData::Time(record) => record.series.time_s.last().copied().unwrap_or(0.0),
        RunData::Eis(sweep) => sweep.points.iter().map(|point| 1.0 / point.freq_hz).sum(),
    }
}

/// `pulse_1` of `data/pulse_1.bdf.csv`.
pub(super) fn stem(file: &str) -> String {
    let stem = Path::new(file)
        .file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    stem.strip_suffix(".bdf")
        .map_or(stem.clone(), str::to_owned)
}

fn check_history(source: &Source, history: Option<&BenchHistory>) -> Result<(), ConfigError> {
    let Some(h) = history else { return Ok(()) };
    let fields = [
        ("voltage_noise_v", h.voltage_noise_v),
        ("voltage_resolution_v", h.voltage_resolution_v),
        ("voltage_offset_v", h.voltage_offset_v),
        ("voltage_drift_v", h.voltage_drift_v),
        ("voltage_drift_s", h.voltage_drift_s),
        ("resistance_rel", h.resistance_rel),
        ("current_gain_rel", h.current_gain_rel),
        ("current_offset_a", h.current_offset_a),
        ("current_noise_a", h.current_noise_a),
        ("current_resolution_a", h.current_resolution_a),
        ("eis_noise_rel", h.eis_noise_rel),
    ];
    match fields
        .iter()
        .find(|(_, value)| !(value.is_finite() && *value >= 0.0))
    {
        Some((name, value)) => Err(source.complain(
            &format!("bench.{name}"),
            format!("expected a number of zero or more, found {value}"),
        )),
        None => Ok(()),
    }
}

struct Resolver<'a> {
    source: &'a Source,
    files: Files,
    /// Points of the sweeps so far that quality gates have refused.
    flagged: Vec<Flagged>,
    /// Oddities of the files so far.
    findings: Vec<Finding>,
}

/// A run, or why its file gives none.
type Resolved = Result<Run, DataSetProblem>;

impl Resolver<'_> {
    fn run(
        &mut self,
        number: usize,
        name: String,
        entry: &raw::Run,
    ) -> Result<Resolved, ConfigError> {
        let source = self.source;
        let at = At { source, number };
        let fixture = at.fixture(entry)?;
        let start = at.start(entry)?;
        at.fields_of_kind(entry)?;
        let data = match entry.kind {
            raw::Kind::Time => self.record(&at, &name, entry)?,
            raw::Kind::Eis => sweep(&at, entry)?.map(|(swept, flagged)| {
                let (points, wanted) = (swept.points.len(), entry.refused_points);
                self.flagged.push(Flagged {
                    run: name.clone(),
                    file: entry.file.clone(),
                    points,
                    flagged,
                    wanted,
                });
                RunData::Eis(swept)
            }),
        };
        let data = match data {
            Ok(data) => data,
            Err(text) => return Ok(Err(DataSetProblem { run: name, text })),
        };
        Ok(Ok(Run {
            repeat_group: entry.repeat_group.clone().unwrap_or_else(|| name.clone()),
            fixture,
            role: entry.role.unwrap_or(Role::Train),
            order: entry
                .order
                .unwrap_or(u32::try_from(number - 1).unwrap_or(u32::MAX)),
            start_s: at.finite("start_s", entry.start_s)?.unwrap_or(0.0),
            temperature_degc: at.temperature(entry, &data)?,
            start,
            data,
            name,
        }))
    }

    fn record(
        &mut self,
        at: &At<'_>,
        name: &str,
        entry: &raw::Run,
    ) -> Result<Result<RunData, String>, ConfigError> {
        let path = self.source.relative(&entry.file);
        let (series, left_out) = match self
            .files
            .series(&path, entry.current_positive.map(raw::sign))
        {
            Ok(series) => series,
            Err(error) => return at.damaged(error),
        };
        let (from_s, to_s) = (
            at.finite("from_s", entry.from_s)?,
            at.finite("to_s", entry.to_s)?,
        );
        let window = files::window(
            series,
            from_s.unwrap_or(f64::NEG_INFINITY),
            to_s.unwrap_or(f64::INFINITY),
        )
        .ok_or_else(|| {
            let (first, last) = ends(series);
            at.complain(
                "from_s",
                format!(
                    "expected two samples or more from `from_s` to `to_s`; \
            the file holds {first} s to {last} s"
                ),
            )
        })?;
        let part = files::part(series, window.clone());
        // Time is that of the part, whose first sample is at zero.
        let begun_s = series
            .time_s
            .iter()
            .copied()
            .find(|t| *t >= from_s.unwrap_or(f64::NEG_INFINITY))
            .unwrap_or(0.0);
        let compared_from_s = at
            .finite("compare_from_s", entry.compare_from_s)?
            .map_or(0.0, |t| (t - begun_s).max(0.0));
        if part
            .time_s
            .last()
            .is_none_or(|last| *last < compared_from_s)
        {
            return Err(at.complain(
                "compare_from_s",
                format!(
                    "expected samples after it, found none up to {} s",
                    ends(&part).1 + begun_s
                ),
            ));
        }
        let level_sigma_v = at
            .positive("level_sigma_v", entry.level_sigma_v)?
            .unwrap_or(0.0);
        let between = entry.current_between_samples.unwrap_or(Between::Linear);
        let stated = |name, fits| {
            files::column(&path, name, series.len(), fits)
                .map(|column| column.map(|all| all[window.clone()].to_vec()))
        };
        let [from, to] = files::WINDOW_COLUMNS;
        let stated =
            stated(files::SIGMA_COLUMN, |v| *v > 0.0 && v.is_finite()).and_then(|sigma_v| {
                Ok((
                    sigma_v,
                    stated(from, |t| t.is_finite())?.zip(stated(to, |t| t.is_finite())?),
                ))
            });
        let (sigma_v, windows) = match stated {
            Ok(stated) => stated,
            Err(error) => return at.damaged(error),
        };
        let first_s = series.time_s[window.start];
        let stamps = &series.time_s[window.clone()];
        if let Some(to_s) = to_s {
            self.findings
                .extend(Finding::ends_early(name, stamps, to_s));
        }
        let last_s = to_s.unwrap_or(f64::INFINITY);
        let lines: Vec<usize> = left_out
            .iter()
            .filter(|row| !row.replaced && (first_s..=last_s).contains(&row.time_s))
            .map(|row| row.line)
            .collect();
        if !lines.is_empty() {
            self.findings
                .push(Finding::rows_not_measured(name, &lines, window.len()));
        }
        let averaged_s = windows.map(|(from, to)| {
            from.iter()
                .zip(&to)
                .map(|(from_s, to_s)| (from_s - first_s, to_s - first_s))
                .collect()
        });
        Ok(Ok(RunData::Time(TimeRecord {
            series: part,
            between,
            compared_from_s,
            level_sigma_v,
            sigma_v,
            averaged_s,
            current_errors_a: Vec::new(),
        })))
    }
}

fn ends(series: &TimeSeries) -> (f64, f64) {
    let end = |t: Option<&f64>| t.copied().unwrap_or(f64::NAN);
    (end(series.time_s.first()), end(series.time_s.last()))
}

/// A sweep, and the points that the quality gate of its measurement has refused.
type Swept = (Sweep, Vec<FlaggedPoint>);

fn sweep(at: &At<'_>, entry: &raw::Run) -> Result<Result<Swept, String>, ConfigError> {
    let spectra = match files::spectra(&at.source.relative(&entry.file)) {
        Ok(spectra) => spectra,
        Err(error) => return at.damaged(error),
    };
    // As Origin counts: charge positive.
    let sign = raw::sign(entry.current_positive.unwrap_or(CurrentPositive::Charge));
    let stated_a = at.finite("bias_a", entry.bias_a)?.map(|bias| {
        if sign == CurrentSign::Charge {
            bias
        } else {
            -bias
        }
    });
    let chosen = choose(&spectra, entry.spectrum.as_deref(), stated_a).ok_or_else(|| {
        let names: Vec<&str> = spectra
            .iter()
            .map(|one| one.spectrum.name.as_str())
            .collect();
        let field = if entry.spectrum.is_some() || entry.bias_a.is_none() {
            "spectrum"
        } else {
            "bias_a"
        };
        at.complain(
            field,
            format!(
                "expected the name of one of the file's spectra: {}",
                names.join(", ")
            ),
        )
    })?;
    let amplitude_a = at.positive("amplitude_a", entry.amplitude_a)?;
    let bias_a = stated_a.or(chosen.origin.bias_a).unwrap_or(0.0);
    // −0 and 0 are one bias.
    let mut sweep = files::sweep(&chosen.spectrum, 0.0 - bias_a, amplitude_a);
    let common_mode = |field, stated| at.finite(field, stated).map(|value| value.unwrap_or(0.0));
    sweep.common_mode = CommonModeImpedance {
        r_ohm: common_mode("below_ohm", entry.below_ohm)?,
        l_h: common_mode("below_h", entry.below_h)?,
    };
    sweep.elapsed_s = entry.elapsed_s.clone().unwrap_or_default();
    if let Some(odd) = sweep.elapsed_s.iter().find(|t| !t.is_finite() || **t < 0.0) {
        return Err(at.complain(
            "elapsed_s",
            format!("expected times of 0 s or more, found {odd}"),
        ));
    }
    sweep.charge_coulomb = entry.charge_coulomb.clone().unwrap_or_default();
    if let Some(odd) = sweep.charge_coulomb.iter().find(|c| !c.is_finite()) {
        return Err(at.complain("charge_c", format!("expected finite charges, found {odd}")));
    }
    for (field, what, count) in [
        ("elapsed_s", "a time", sweep.elapsed_s.len()),
        ("charge_c", "a charge", sweep.charge_coulomb.len()),
    ] {
        if count > 0 && count != sweep.points.len() {
            let points = sweep.points.len();
            return Err(at.complain(
                field,
                format!("expected {what} for each of {points} points, found {count}"),
            ));
        }
    }
    if let Some(file) = &entry.harmonics_file {
        let number = entry.harmonics_sweep.unwrap_or(1);
        let rows = read_harmonics(&at.source.relative(file))
            .map_err(|text| at.complain("harmonics_file", text))?;
        sweep.harmonics = files::harmonics(&rows, number, 0.0 - sweep.bias_a)
            .map_err(|text| at.complain("harmonics_file", format!("{file}: {text}")))?;
        if sweep.harmonics.is_empty() {
            return Err(at.complain(
                "harmonics_sweep",
                format!("expected a sweep with harmonics of order 2 or 3 in {file}, found none of number {number}"),
            ));
        }
    }
    if entry.harmonics_file.is_none() && entry.harmonics_sweep.is_some() {
        return Err(at.complain(
            "harmonics_sweep",
            "expected `harmonics_file` beside it, found none",
        ));
    }
    let from_hz = at.positive("from_hz", entry.from_hz)?.unwrap_or(0.0);
    let to_hz = at.positive("to_hz", entry.to_hz)?.unwrap_or(f64::INFINITY);
    sweep.retain(|freq_hz| (from_hz..=to_hz).contains(&freq_hz));
    if sweep.points.is_empty() {
        return Err(at.complain(
            "from_hz",
            "expected frequencies of the sweep from `from_hz` to `to_hz`, found none",
        ));
    }
    let flagged = chosen
        .flagged
        .iter()
        .filter(|point| (from_hz..=to_hz).contains(&point.freq_hz))
        .cloned()
        .collect();
    Ok(Ok((sweep, flagged)))
}

/// The spectrum of a name; else the only one; else the only one at this bias.
fn choose<'a>(
    spectra: &'a [SourcedSpectrum],
    name: Option<&str>,
    bias_a: Option<f64>,
) -> Option<&'a SourcedSpectrum> {
    if let Some(name) = name {
        return spectra.iter().find(|one| one.spectrum.name == name);
    }
    if let [only] = spectra {
        return Some(only);
    }
    let mut at_bias = spectra
        .iter()
        .filter(|one| one.origin.bias_a.is_some() && one.origin.bias_a == bias_a);
    at_bias.next().filter(|_| at_bias.next().is_none())
}

/// One `[[runs]]`, for complaints about its fields.
struct At<'a> {
    source: &'a Source,
    number: usize,
}

impl At<'_> {
    fn complain(&self, field: &str, reason: impl Into<String>) -> ConfigError {
        self.source
            .complain(&format!("runs.{}.{field}", self.number), reason)
    }

    fn damaged<T>(&self, error: FileError) -> Result<Result<T, String>, ConfigError> {
        match error {
            FileError::Usage(text) => Err(self.complain("file", text)),
            FileError::Damaged(text) => Ok(Err(text)),
        }
    }

    fn finite(&self, field: &str, value: Option<f64>) -> Result<Option<f64>, ConfigError> {
        match value.filter(|value| !value.is_finite()) {
            Some(value) => {
                Err(self.complain(field, format!("expected a finite number, found {value}")))
            }
            None => Ok(value),
        }
    }

    fn positive(&self, field: &str, value: Option<f64>) -> Result<Option<f64>, ConfigError> {
        match value.filter(|value| !(value.is_finite() && *value > 0.0)) {
            Some(value) => Err(self.complain(
                field,
                format!("expected a number above zero, found {value}"),
            )),
            None => Ok(value),
        }
    }

    fn fixture(&self, entry: &raw::Run) -> Result<Fixture, ConfigError> {
        let ohm = self.positive("fixture_ohm", entry.fixture_ohm)?;
        let known = |fixture: &str| {
            ohm.ok_or_else(|| {
                self.complain(
                    "fixture_ohm",
                    format!("expected the resistance of the {fixture} in Ω, found none"),
                )
            })
        };
        if entry.fixture == raw::Fixture::Cell && ohm.is_some() {
            return Err(self.complain(
                "fixture_ohm",
                "expected none beside a cell: only shunt and fake_cell have a known resistance",
            ));
        }
        if entry.fixture != raw::Fixture::Cell && entry.cell.is_some() {
            return Err(self.complain("cell", "expected none beside a shunt or a fake_cell"));
        }
        Ok(match entry.fixture {
            raw::Fixture::Cell => {
                Fixture::Cell(entry.cell.clone().unwrap_or_else(|| "cell".to_owned()))
            }
            raw::Fixture::Shunt => Fixture::Shunt(known("shunt")?),
            raw::Fixture::FakeCell => Fixture::FakeCell(known("fake_cell")?),
        })
    }

    fn start(&self, entry: &raw::Run) -> Result<Start, ConfigError> {
        match (entry.soc, self.positive("ocv_v", entry.ocv_v)?) {
            (Some(_), Some(_)) => {
                Err(self.complain("ocv_v", "expected either `soc` or `ocv_v`, found both"))
            }
            (Some(soc), None) if (0.0..=1.0).contains(&soc) => Ok(Start::Soc(soc)),
            (Some(soc), None) => Err(self.complain(
                "soc",
                format!("expected a state of charge from 0 to 1, found {soc}"),
            )),
            (None, Some(ocv_v)) => Ok(Start::Ocv(ocv_v)),
            (None, None) if entry.fixture != raw::Fixture::Cell => Ok(Start::Soc(CONTROL_SOC)),
            (None, None) => Err(self.complain("soc", "expected `soc` or `ocv_v`, found neither")),
        }
    }

    fn fields_of_kind(&self, entry: &raw::Run) -> Result<(), ConfigError> {
        let (kind, foreign): (&str, Vec<(&str, bool)>) = match entry.kind {
            raw::Kind::Eis => (
                "eis",
                vec![
                    ("from_s", entry.from_s.is_some()),
                    ("to_s", entry.to_s.is_some()),
                    ("compare_from_s", entry.compare_from_s.is_some()),
                    ("level_sigma_v", entry.level_sigma_v.is_some()),
                    (
                        "current_between_samples",
                        entry.current_between_samples.is_some(),
                    ),
                ],
            ),
            raw::Kind::Time => (
                "time",
                vec![
                    ("bias_a", entry.bias_a.is_some()),
                    ("below_ohm", entry.below_ohm.is_some()),
                    ("below_h", entry.below_h.is_some()),
                    ("elapsed_s", entry.elapsed_s.is_some()),
                    ("charge_c", entry.charge_coulomb.is_some()),
                    ("harmonics_file", entry.harmonics_file.is_some()),
                    ("harmonics_sweep", entry.harmonics_sweep.is_some()),
                    ("from_hz", entry.from_hz.is_some()),
                    ("to_hz", entry.to_hz.is_some()),
                    ("amplitude_a", entry.amplitude_a.is_some()),
                    ("spectrum", entry.spectrum.is_some()),
                ],
            ),
        };
        match foreign.iter().find(|(_, given)| *given) {
            Some((field, _)) => {
                Err(self.complain(field, format!("a run of kind `{kind}` has no such field")))
            }
            None => Ok(()),
        }
    }

    /// As stated, else the first of the file.
    fn temperature(&self, entry: &raw::Run, data: &RunData) -> Result<f64, ConfigError> {
        let measured = match data {
            RunData::Time(record) => record
                .series
                .temperature_degc
                .iter()
                .flatten()
                .copied()
                .find(|t| t.is_finite()),
            RunData::Eis(_) => None,
        };
        let temperature_degc = entry.temperature_degc.or(measured).ok_or_else(|| {
            self.complain(
                "temperature_c",
                "expected the temperature at the start in °C: the file holds none",
            )
        })?;
        if TEMPERATURES_C.contains(&temperature_degc) {
            return Ok(temperature_degc);
        }
        let (low, high) = (TEMPERATURES_C.start(), TEMPERATURES_C.end());
        Err(self.complain(
            "temperature_c",
            format!("expected {low} °C to {high} °C, found {temperature_degc}"),
        ))
    }
}
