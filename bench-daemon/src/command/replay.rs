//! `eis-bench replay`: analyses recorded captures again with the present program, and lists the
//! changes.
//!
//! The results of a run of this version are bit-identical. Otherwise every changed point is
//! listed with the ratio of its change to its stated uncertainty. The run folder is not modified;
//! `--out` writes the results into a folder of its own. A TOML file describes captures of other
//! programs.

mod captures;

use crate::command::printed::say_json;
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU32, Ordering},
};

use analysis::{
    dataset::{self, RunIndex},
    run_folder::{EVENTS, INDEX, JOURNAL, MANIFEST, READINGS, TRANSCRIPTS},
    spectrum::ImpedancePoint,
};
use clap::Args;
use instruments::clock::{Clock, TimeMode};

use bench_core::{record::RecordError, safety::failure::Failure};
use bench_evaluate::{
    run::Recorded,
    support::{
        compare::{Difference, compare},
        present::significant,
    },
};
use bench_plan::support::terminal::say;

/// Changed points that are listed for each spectrum.
const MOST_LISTED: usize = 12;
/// Rounds of which the fastest counts.
const ROUNDS: usize = 3;

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Run folders, folders of run folders, or TOML files that describe captures of a scope.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Write the results into this folder, with a subfolder for each run if there are several.
    /// Existing files are not overwritten.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON; for run folders only.
    #[arg(long)]
    pub json: bool,
}

/// Outcome of the replay of a run.
#[derive(Debug, serde::Serialize)]
struct Replayed {
    folder: PathBuf,
    captures: usize,
    bytes: u64,
    samples: u64,
    took_s: f64,
    points: usize,
    /// Points that are as the journal has them, bit by bit.
    identical_points: usize,
    /// Points of sweeps that were not finished.
    unfinished_points: usize,
    /// The run was stopped, and how.
    stopped: Option<String>,
    recorded_by: String,
    replayed_by: &'static str,
    spectra: usize,
    identical_spectra: usize,
    changed_spectra: Vec<Changed>,
    traces: usize,
    identical_traces: usize,
    trace_differences: Vec<Difference>,
    /// Points that the quality gate refuses.
    refused_points: usize,
    /// The folder that was written.
    written: Option<PathBuf>,
}

/// A spectrum that changed.
#[derive(Debug, serde::Serialize)]
struct Changed {
    file: String,
    stored_points: usize,
    points: usize,
    /// Its points, the largest changes first.
    changes: Vec<Change>,
}

/// A point that changed.
#[derive(Debug, serde::Serialize)]
struct Change {
    freq_hz: f64,
    change_ohm: f64,
    /// Change over the stated uncertainty; null where none was stated.
    over_sigma: f64,
    /// Relative change of the uncertainty.
    sigma_change: f64,
}

/// Replays runs.
///
/// # Errors
/// A folder that is not a readable run; a capture that is damaged or cannot be analysed;
/// [`Failure::Refused`], after all output, if the quality gate refuses points of the output
/// requested with `--out`.
pub fn replay(args: &ReplayArgs) -> Result<(), Failure> {
    let (described, named): (Vec<PathBuf>, Vec<PathBuf>) = args
        .runs
        .iter()
        .cloned()
        .partition(|path| path.extension().is_some_and(|end| end == "toml"));
    if let (true, [first, ..]) = (args.json, described.as_slice()) {
        return Err(Failure::Usage(format!(
            "--json: expected run folders, found {}",
            first.display()
        )));
    }
    for file in &described {
        captures::replay(file, args.out.as_deref())?;
    }
    let folders = run_folders(&named)?;
    let (mut count, mut all) = (0, Vec::new());
    for folder in &folders {
        let out = args.out.as_ref().map(|out| {
            let own = folder.file_name().map_or_else(PathBuf::new, PathBuf::from);
            if folders.len() > 1 {
                out.join(own)
            } else {
                out.clone()
            }
        });
        let replayed = of_run(folder, out.as_deref())?;
        count += replayed.refused_points;
        if args.json {
            all.push(replayed);
        } else {
            tell(&replayed);
        }
    }
    if args.json {
        say_json(&all)?;
    }
    // The output is an ordinary run folder; the exit code must report the changes, too.
    if count > 0 && args.out.is_some() {
        Err(Failure::Refused { count })
    } else {
        Ok(())
    }
}

/// Rates at which the captures of a run are read, decoded and analysed, each on all cores, in lines
/// of a table.
///
/// # Errors
/// As [`replay`].
pub fn rates(folder: &Path) -> Result<Vec<String>, Failure> {
    let recorded = Recorded::read(folder)?;
    let known = recorded.points()?;
    let files: Vec<PathBuf> = known
        .iter()
        .flat_map(|known| &known.files)
        .map(|file| folder.join(file))
        .collect();
    let bytes: u64 = files
        .iter()
        .filter_map(|file| fs::metadata(file).ok())
        .map(|found| found.len())
        .sum();
    let clock = Clock::start(TimeMode::Real);
    let mut lines = vec![format!(
        "{} captures, {:.1} MB on disk",
        files.len(),
        1.0e-6 * bytes as f64
    )];
    let mut timed = |what: &str, work: &dyn Fn() -> Result<(), Failure>| -> Result<(), Failure> {
        // The best of some rounds: on a shared machine the others are of other programs.
        let mut best_s = f64::INFINITY;
        for _ in 0..ROUNDS {
            let start_s = clock.now_s();
            work()?;
            best_s = best_s.min(clock.now_s() - start_s);
        }
        lines.push(format!(
            "{what:<44} {:>9.1} MB/s of files  {best_s:>8.3} s",
            1.0e-6 * bytes as f64 / best_s
        ));
        Ok(())
    };
    let on_all = |work: &(dyn Fn(&PathBuf) -> Result<(), Failure> + Sync)| {
        bench_evaluate::run::on_all_cores(&files, work).map(drop)
    };
    timed("reading the files (from the cache)", &|| {
        on_all(&|file| fs::read(file).map(drop).map_err(Failure::from))
    })?;
    timed("SHA-256 of the files", &|| {
        on_all(&|file| {
            bench_plan::support::hash::sha256_of(file)
                .map(drop)
                .map_err(Failure::from)
        })
    })?;
    timed("decoding their Parquet", &|| {
        on_all(&|file| {
            dataset::read_capture(file)
                .map(drop)
                .map_err(|error| RecordError::from(error).into())
        })
    })?;
    timed("replay: decoding, fits, quality", &|| {
        recorded.analyse(&known).map(drop)
    })?;
    let recomputed = recorded.analyse(&known)?;
    let same = known
        .iter()
        .zip(&recomputed)
        .filter(|(known, recomputed)| known.point == recomputed.point)
        .count();
    lines.push(format!("points bit-identical: {same} of {}", known.len()));
    Ok(lines)
}

/// Returns the run folders among and below the named folders.
///
/// # Errors
/// A folder that contains no run.
pub(super) fn run_folders(named: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut all = Vec::new();
    for folder in named {
        let before = all.len();
        below(folder, &mut all)?;
        if all.len() == before {
            return Err(Failure::Usage(format!(
                "{}: expected a run folder, or a folder of them, found no {JOURNAL} in or below it",
                folder.display()
            )));
        }
    }
    Ok(all)
}

fn below(folder: &Path, all: &mut Vec<PathBuf>) -> Result<(), Failure> {
    if folder.join(JOURNAL).exists() {
        all.push(folder.to_owned());
        return Ok(());
    }
    let entries = fs::read_dir(folder)
        .map_err(|error| Failure::Usage(format!("{}: {error}", folder.display())))?;
    let mut folders: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    folders.iter().try_for_each(|folder| below(folder, all))
}

/// One run.
fn of_run(folder: &Path, out: Option<&Path>) -> Result<Replayed, Failure> {
    let recorded = Recorded::read(folder)?;
    let known = recorded.points()?;
    let clock = Clock::start(TimeMode::Real);
    let recomputed = recorded.analyse(&known)?;
    let took_s = clock.now_s();
    let (bytes, samples) = recomputed
        .iter()
        .fold((0, 0), |sum, one| (sum.0 + one.bytes, sum.1 + one.samples));
    let same = known
        .iter()
        .zip(&recomputed)
        .filter(|(known, recomputed)| known.point == recomputed.point)
        .count();
    let captures = recomputed.len();
    let scratch = Scratch::new("replay")?;
    let goal = out.unwrap_or(scratch.path());
    let points: Vec<_> = known
        .iter()
        .zip(recomputed)
        .map(|(known, recomputed)| (known.stage, recomputed.point))
        .collect();
    let others = recorded.settle(&points, goal, out.is_some() && recorded.stopped().is_none())?;
    let mut replayed = Replayed {
        folder: folder.to_owned(),
        captures,
        bytes,
        samples,
        took_s,
        points: known.len(),
        identical_points: same,
        unfinished_points: recorded.unfinished(),
        stopped: recorded.stopped().map(|how| how.to_string()),
        recorded_by: recorded.version().to_owned(),
        replayed_by: env!("CARGO_PKG_VERSION"),
        spectra: 0,
        identical_spectra: 0,
        changed_spectra: Vec::new(),
        traces: 0,
        identical_traces: 0,
        trace_differences: Vec::new(),
        refused_points: others.refused,
        written: out.map(Path::to_owned),
    };
    compare_with(goal, &mut replayed)?;
    if let Some(out) = out {
        tidy(out)?;
    }
    Ok(replayed)
}

/// Compares the spectra and traces of the index.
fn compare_with(recomputed: &Path, replayed: &mut Replayed) -> Result<(), Failure> {
    let folder = replayed.folder.clone();
    let text = fs::read_to_string(folder.join(INDEX)).unwrap_or_default();
    let index: RunIndex = serde_json::from_str(&text).unwrap_or_default();
    for file in index.sweeps.iter().map(|sweep| sweep.file.as_str()) {
        let read = |folder: &Path| {
            dataset::read_spectrum_csv(&folder.join(file)).map_err(RecordError::from)
        };
        let (was, is) = (read(&folder)?, read(recomputed)?);
        replayed.spectra += 1;
        if fs::read(folder.join(file))? == fs::read(recomputed.join(file))? {
            replayed.identical_spectra += 1;
        } else {
            replayed.changed_spectra.push(changed(file, &was, &is));
        }
    }
    for trace in index
        .traces
        .iter()
        .filter(|trace| trace.commanded.is_some())
    {
        let differences = compare(&folder, recomputed, &trace.file)?;
        replayed.traces += 1;
        replayed.identical_traces += usize::from(differences.is_empty());
        replayed.trace_differences.extend(differences);
    }
    Ok(())
}

/// The changes of a spectrum, the largest first.
fn changed(file: &str, was: &[ImpedancePoint], is: &[ImpedancePoint]) -> Changed {
    let mut changes: Vec<Change> = Vec::new();
    for point in is {
        let Some(before) = was.iter().find(|before| before.freq_hz == point.freq_hz) else {
            continue;
        };
        let change_ohm = (point.z_ohm - before.z_ohm).norm();
        let sigma_ohm = (before.covariance.re_re + before.covariance.im_im).sqrt();
        let sigma_now_ohm = (point.covariance.re_re + point.covariance.im_im).sqrt();
        changes.push(Change {
            freq_hz: point.freq_hz,
            change_ohm,
            over_sigma: change_ohm / sigma_ohm,
            sigma_change: sigma_now_ohm / sigma_ohm - 1.0,
        });
    }
    changes.sort_by(|a, b| b.over_sigma.total_cmp(&a.over_sigma));
    Changed {
        file: file.to_owned(),
        stored_points: was.len(),
        points: is.len(),
        changes,
    }
}

fn tell(replayed: &Replayed) {
    let Replayed { took_s, .. } = replayed;
    let (megabytes, million) = (
        1.0e-6 * replayed.bytes as f64,
        1.0e-6 * replayed.samples as f64,
    );
    say!(
        "{}: {} captures, {megabytes:.1} MB on disk, {million:.1} million samples, in {took_s:.3} s: \
        {:.0} MB/s of files, {:.0} MB/s of codes",
        replayed.folder.display(),
        replayed.captures,
        megabytes / took_s,
        2.0 * million / took_s
    );
    say!(
        "  points as the journal has them, bit by bit: {} of {}",
        replayed.identical_points,
        replayed.points
    );
    if replayed.unfinished_points > 0 {
        say!(
            "  {} points are of sweeps that were not finished: no spectrum is made of them",
            replayed.unfinished_points
        );
    }
    if let Some(how) = &replayed.stopped {
        say!("  the run was stopped ({how}): it has no report, and none is made");
    }
    if replayed.recorded_by != replayed.replayed_by {
        say!(
            "  recorded by version {}, replayed by {}",
            replayed.recorded_by,
            replayed.replayed_by
        );
    }
    replayed.changed_spectra.iter().for_each(tell_changed);
    say!(
        "  spectra bit-identical: {} of {}",
        replayed.identical_spectra,
        replayed.spectra
    );
    for Difference { file, what } in &replayed.trace_differences {
        say!("  {file}: {what}");
    }
    if replayed.traces > 0 {
        say!(
            "  traces bit-identical: {} of {}",
            replayed.identical_traces,
            replayed.traces
        );
    }
    if let Some(written) = &replayed.written {
        say!("  written: {}", written.display());
    }
}

/// A table of what changed in a spectrum.
fn tell_changed(spectrum: &Changed) {
    let rows = &spectrum.changes;
    let worst = rows.iter().map(|row| row.over_sigma).fold(0.0, f64::max);
    say!(
        "  {}: changed; {} points stored, {} now; |ΔZ|/σ at most {}",
        spectrum.file,
        spectrum.stored_points,
        spectrum.points,
        significant(worst, 3)
    );
    say!(
        "    {:>12} {:>12} {:>10} {:>12}",
        "f / Hz",
        "|ΔZ| / µΩ",
        "|ΔZ|/σ",
        "Δσ / %"
    );
    for row in rows.iter().take(MOST_LISTED) {
        say!(
            "    {:>12} {:>12} {:>10} {:>12}",
            significant(row.freq_hz, 6),
            significant(1.0e6 * row.change_ohm, 3),
            significant(row.over_sigma, 3),
            significant(100.0 * row.sigma_change, 3)
        );
    }
    if rows.len() > MOST_LISTED {
        say!("    {} more", rows.len() - MOST_LISTED);
    }
}

/// Removes files that only served the replay: links to input files, and partial records.
fn tidy(out: &Path) -> Result<(), Failure> {
    for entry in fs::read_dir(out)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let served = [JOURNAL, MANIFEST, EVENTS, READINGS, TRANSCRIPTS].contains(&name.as_str());
        if entry.file_type()?.is_symlink() || (served && entry.path().is_file()) {
            fs::remove_file(entry.path())?;
        } else if served {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

/// A folder for a while.
pub(super) struct Scratch(PathBuf);

impl Scratch {
    /// A new, empty one.
    ///
    /// # Errors
    /// The file system's.
    pub(super) fn new(what: &str) -> std::io::Result<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path =
            std::env::temp_dir().join(format!("eis-bench-{what}-{}-{number}", std::process::id()));
        fs::create_dir(&path)?;
        Ok(Self(path))
    }

    /// Returns its path.
    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A remnant in the system's folder of temporary files is not an error.
        let _ = fs::remove_dir_all(&self.0);
    }
}
