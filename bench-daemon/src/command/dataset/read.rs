//! Reads the files of `dataset init`, detects their kinds, and expresses their paths relative to
//! the folder of the data set.

use std::path::{Component, Path, PathBuf};

use analysis::{
    formats::{
        FileSpectra, FormatError, ReadOptions, ReadSeries, SeriesOptions, SeriesReadError, State,
        names_a_spectrum, read_file, read_profile, read_record,
    },
    forward::Interpolation,
    series::TimeSeries,
    spectrum::SourcedSpectrum,
};

use super::{
    args::{InitArgs, Stated},
    findings::{FileFinding, FileKind},
};
use bench_core::safety::failure::Failure;
use bench_evaluate::investigate::proposal::{FoundSpectrum, Place};

/// A log that was read.
pub(super) struct Log {
    /// Path from the folder of the data set.
    pub(super) file: String,
    pub(super) name: String,
    pub(super) series: TimeSeries,
    /// Numbers of the cycler's steps.
    pub(super) steps: Option<Vec<f64>>,
    /// State of the cell from the file.
    pub(super) state: State,
}

impl Log {
    /// Returns remarks on data other than current and voltage that are used from the file.
    pub(super) fn remarks(&self) -> Vec<String> {
        let head = self.state.head;
        let capacity = head.capacity_ah.map(|fact| {
            let (value, line) = (fact.value, fact.line);
            format!("its head has a capacity of {value} Ah in line {line}")
        });
        let celsius = head.temperature_degc.map(|fact| {
            let (value, line) = (fact.value, fact.line);
            format!("its head has a temperature of {value} °C in line {line}")
        });
        let column = self.state.soc.as_ref();
        let column = column.map(|_| "it has a column of the state of charge".to_owned());
        let steps = self.steps.as_ref();
        let steps = steps.map(|_| "it is cut by the steps of the cycler".to_owned());
        [steps, capacity, celsius, column]
            .into_iter()
            .flatten()
            .collect()
    }
}

/// Content of a file.
pub(super) struct Content {
    pub(super) finding: FileFinding,
    pub(super) log: Option<Log>,
    pub(super) spectra: Vec<FoundSpectrum>,
}

/// Returns the stated conditions of a name.
pub(super) fn stated(all: &[Stated], name: &str) -> Place {
    all.iter()
        .find(|one| one.name == name)
        .map_or_else(Place::default, |one| one.place)
}

/// Reads all files. A file that no reader accepts is reported and skipped.
pub(super) fn read_all(args: &InitArgs) -> Result<Vec<Content>, Failure> {
    let mut names = Names::default();
    let contents: Vec<Content> = args
        .files
        .iter()
        .map(|path| one(args, path, &mut names))
        .collect::<Result<_, _>>()?;
    let known = |name: &str| {
        contents.iter().any(|content| {
            content.log.as_ref().is_some_and(|log| log.name == name)
                || content.spectra.iter().any(|spectrum| spectrum.name == name)
        })
    };
    match args.at.iter().find(|one| !known(&one.name)) {
        Some(one) => Err(Failure::Usage(format!(
            "--at: expected the name of a log or a spectrum of these files, met {:?}",
            one.name
        ))),
        None => Ok(contents),
    }
}

/// Names of logs and spectra that are in use.
#[derive(Default)]
struct Names(Vec<String>);

impl Names {
    /// Returns the name, with a number if it is already in use.
    fn unique(&mut self, name: &str) -> String {
        let numbered = (2..).map(|number| format!("{name}_{number}"));
        let mut candidates = std::iter::once(name.to_owned()).chain(numbered);
        let free = candidates.find(|candidate| !self.0.contains(candidate));
        let free = free.unwrap_or_default();
        self.0.push(free.clone());
        free
    }
}

fn one(args: &InitArgs, path: &Path, names: &mut Names) -> Result<Content, Failure> {
    let options = SeriesOptions {
        sign: args.positive,
    };
    let finding = |kind, text| FileFinding {
        file: path.display().to_string(),
        kind,
        text,
    };
    let series_error = match read_record(path, &options) {
        Ok(read) => return of_log(args, path, read, names),
        Err(error) => error,
    };
    match read_file(path) {
        Ok(read) => {
            let text = described(&read);
            let own = Place::default();
            Ok(Content {
                finding: finding(Some(FileKind::Spectra), text),
                log: None,
                spectra: of_spectra(args, path, &read, own, names)?,
            })
        }
        Err(error) => Ok(Content {
            finding: finding(None, nearest(path, &series_error, &error)),
            log: None,
            spectra: Vec::new(),
        }),
    }
}

/// Reads a log, with the spectra in some of its rows.
fn of_log(
    args: &InitArgs,
    path: &Path,
    read: ReadSeries,
    names: &mut Names,
) -> Result<Content, Failure> {
    let mut text = format!("{} rows", read.series.len());
    text.extend(read.notes.iter().map(|note| format!("; {note}")));
    let mut spectra = Vec::new();
    let within = names_a_spectrum(path)
        .then(|| read_file(path).ok())
        .flatten();
    if let Some(found) = within {
        text += &format!("; {}", described(&found));
        spectra = of_spectra(args, path, &found, place_of(&read), names)?;
    }
    let kind = if spectra.is_empty() {
        FileKind::Log
    } else {
        FileKind::Spectra
    };
    Ok(Content {
        finding: FileFinding {
            file: path.display().to_string(),
            kind: Some(kind),
            text,
        },
        log: Some(Log {
            file: from_folder(path, &args.out)?,
            name: names.unique(&stem(path)),
            series: read.series,
            steps: read.steps,
            state: read.state,
        }),
        spectra,
    })
}

/// Current below which a log is at rest, as a fraction of its maximum current, as for the rests of a
/// log. A log without any current is at rest.
const REST_PART: f64 = 2e-3;

/// Returns state and temperature in the rows of a log with spectra.
fn place_of(read: &ReadSeries) -> Place {
    let middle = |all: &[f64]| {
        let mut all: Vec<f64> = all.iter().copied().filter(|v| v.is_finite()).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let series = &read.series;
    let most_a = series
        .current_a
        .iter()
        .fold(0.0_f64, |most, a| most.max(a.abs()));
    let at_rest: Vec<f64> = (series.current_a.iter().zip(&series.voltage_v))
        .filter(|(a, _)| a.abs() <= REST_PART * most_a)
        .map(|(_, v)| *v)
        .collect();
    let soc = read.state.soc.as_deref().and_then(middle);
    Place {
        soc,
        ocv_v: middle(&at_rest).filter(|_| soc.is_none()),
        temperature_degc: series.temperature_degc.as_deref().and_then(middle).or(read
            .state
            .head
            .temperature_degc
            .map(|fact| fact.value)),
    }
}

/// Describes the spectra of a file, with the remarks of the reader.
fn described(read: &FileSpectra) -> String {
    let mut text = match read.spectra.len() {
        1 => "1 spectrum".to_owned(),
        count => format!("{count} spectra"),
    };
    text.extend(read.notes.iter().map(|note| format!("; {note}")));
    text
}

/// Returns the spectra of a file. Its own state and temperature apply if none are stated.
fn of_spectra(
    args: &InitArgs,
    path: &Path,
    read: &FileSpectra,
    own: Place,
    names: &mut Names,
) -> Result<Vec<FoundSpectrum>, Failure> {
    let file = from_folder(path, &args.out)?;
    let several = read.spectra.len() > 1;
    let each = read.spectra.iter().map(|sourced| FoundSpectrum {
        among: several.then(|| sourced.spectrum.name.clone()),
        ..spectrum(args, sourced, &file, own, names)
    });
    Ok(each.collect())
}

/// Returns the most similar reader, and its reason.
fn nearest(path: &Path, series: &SeriesReadError, spectra: &FormatError) -> String {
    let knows_columns = !matches!(
        series,
        SeriesReadError::UnknownFormat { .. }
            | SeriesReadError::Text(_)
            | SeriesReadError::Foreign { .. }
            | SeriesReadError::Read { .. }
    );
    if knows_columns {
        return format!("nearest is the reader of logs: {series}");
    }
    if !matches!(spectra, FormatError::UnknownFormat { .. }) {
        return format!("nearest is the reader of spectra: {spectra}");
    }
    let profile = ReadOptions {
        demand: None,
        interpolation: Interpolation::Hold,
        charge_positive: false,
    };
    if read_profile(path, &profile).is_ok() {
        return "it reads as a load profile, which has no voltage: no run can be made of it"
            .to_owned();
    }
    format!("no reader knows it. As a log: {series}. As spectra: {spectra}")
}

fn spectrum(
    args: &InitArgs,
    sourced: &SourcedSpectrum,
    file: &str,
    own: Place,
    names: &mut Names,
) -> FoundSpectrum {
    let name = names.unique(&sourced.spectrum.name);
    let mut place = stated(&args.at, &name);
    let temperature_degc = place.temperature_degc.or(args.temperature_degc);
    place.temperature_degc = temperature_degc.or(own.temperature_degc);
    if place.soc.is_none() && place.ocv_v.is_none() {
        (place.soc, place.ocv_v) = (own.soc, own.ocv_v);
    }
    let points = &sourced.spectrum.points;
    // The points are in order of rising frequency.
    let inductive = points.iter().position(|point| point.z_ohm.im > 0.0);
    let of_cell = sourced
        .origin
        .fixture
        .as_deref()
        .is_none_or(|fixture| fixture == "cell");
    FoundSpectrum {
        file: file.to_owned(),
        among: None,
        points: points.len(),
        from_hz: args.from_hz,
        to_hz: args.to_hz.or_else(|| {
            let last = inductive?.checked_sub(1)?;
            Some(points[last].freq_hz)
        }),
        inductive: args.to_hz.is_none() && inductive.is_some(),
        place,
        assumed: Vec::new(),
        refusal: if of_cell {
            sourced
                .spectrum
                .validate()
                .err()
                .map(|error| error.to_string())
        } else {
            Some("it is of a control and not of a cell".to_owned())
        },
        name,
    }
}

/// Returns a path relative to a folder, which need not exist yet.
pub(super) fn from_folder(path: &Path, folder: &Path) -> Result<String, Failure> {
    let fail = |path: &Path, error: &std::io::Error| {
        Failure::Usage(format!("{}: {error}", path.display()))
    };
    let target = std::fs::canonicalize(path).map_err(|error| fail(path, &error))?;
    let base = whole(folder).map_err(|error| fail(folder, &error))?;
    let same = target
        .components()
        .zip(base.components())
        .take_while(|(a, b)| a == b)
        .count();
    let mut relative: PathBuf = base.components().skip(same).map(|_| "..").collect();
    relative.extend(target.components().skip(same));
    Ok(relative.to_string_lossy().into_owned())
}

/// Returns a folder without links and `..`; its last components need not exist yet.
fn whole(folder: &Path) -> std::io::Result<PathBuf> {
    let mut found = std::env::current_dir().and_then(std::fs::canonicalize)?;
    for component in folder.components() {
        match component {
            Component::ParentDir => _ = found.pop(),
            other => found.push(other),
        }
        if let Ok(real) = std::fs::canonicalize(&found) {
            found = real;
        }
    }
    Ok(found)
}

/// Returns the name of a file without its extensions.
fn stem(path: &Path) -> String {
    let stem = path.file_stem().map_or_else(
        || "file".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    stem.trim_end_matches(".bdf").to_owned()
}
