//! `eis-bench replay`: analyses recorded captures again with the present program, and lists the
//! changes.
//!
//! A run of the same version comes out bit-identical. Otherwise every point that changed is told
//! with its change over its stated uncertainty. Nothing is changed in the run folder; `--out`
//! writes what comes out into a folder of its own. Captures of other programs are described by a
//! TOML.

mod captures;

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

use crate::{
    record::RecordError, run::Recorded, safety::failure::Failure, support::compare::compare,
    support::present::significant, support::terminal::say,
};

/// Changed points that are listed for each spectrum.
const TOLD: usize = 12;
/// Rounds of which the fastest counts.
const ROUNDS: usize = 3;

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Run folders, folders of run folders, or TOML files that describe captures of a scope.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Write what comes out into this folder, a folder in it for each run where there are several.
    /// Nothing that is there is written over.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Replays runs.
///
/// # Errors
/// A folder that cannot be read as a run; a capture that is damaged or cannot be analysed;
/// [`Failure::Refused`], once everything is written, where the quality gate refuses points of what
/// was asked for with `--out`.
pub fn replay(args: &ReplayArgs) -> Result<(), Failure> {
    let (described, named): (Vec<PathBuf>, Vec<PathBuf>) = args
        .runs
        .iter()
        .cloned()
        .partition(|path| path.extension().is_some_and(|end| end == "toml"));
    for file in &described {
        captures::replay(file, args.out.as_deref())?;
    }
    let folders = run_folders(&named)?;
    let mut count = 0;
    for folder in &folders {
        let out = args.out.as_ref().map(|out| {
            let own = folder.file_name().map_or_else(PathBuf::new, PathBuf::from);
            if folders.len() > 1 {
                out.join(own)
            } else {
                out.clone()
            }
        });
        count += of_run(folder, out.as_deref())?;
    }
    // What is written is a run folder like any other; whoever reads nothing but the exit code must
    // know.
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
        crate::run::on_all_cores(&files, work).map(drop)
    };
    timed("reading the files (from the cache)", &|| {
        on_all(&|file| fs::read(file).map(drop).map_err(Failure::from))
    })?;
    timed("SHA-256 of the files", &|| {
        on_all(&|file| {
            crate::support::hash::sha256_of(file)
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

/// The run folders among and below those that were named.
///
/// # Errors
/// A folder with no run in it.
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

/// One run; how many points of it the quality gate refuses.
fn of_run(folder: &Path, out: Option<&Path>) -> Result<usize, Failure> {
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
    say!(
        "{}: {} captures, {:.1} MB on disk, {:.1} million samples, in {took_s:.3} s: {:.0} MB/s of \
        files, {:.0} MB/s of codes",
        folder.display(),
        recomputed.len(),
        1.0e-6 * bytes as f64,
        1.0e-6 * samples as f64,
        1.0e-6 * bytes as f64 / took_s,
        2.0e-6 * samples as f64 / took_s
    );
    say!(
        "  points as the journal has them, bit by bit: {same} of {}",
        known.len()
    );
    if recorded.unfinished() > 0 {
        say!(
            "  {} points are of sweeps that were not finished: no spectrum is made of them",
            recorded.unfinished()
        );
    }
    if let Some(how) = recorded.stopped() {
        say!("  the run was stopped ({how}): it has no report, and none is made");
    }
    if recorded.version() != env!("CARGO_PKG_VERSION") {
        say!(
            "  recorded by version {}, replayed by {}",
            recorded.version(),
            env!("CARGO_PKG_VERSION")
        );
    }
    let scratch = Scratch::new("replay")?;
    let goal = out.unwrap_or(scratch.path());
    let points: Vec<_> = known
        .iter()
        .zip(recomputed)
        .map(|(known, recomputed)| (known.stage, recomputed.point))
        .collect();
    let others = recorded.settle(&points, goal, out.is_some() && recorded.stopped().is_none())?;
    tell(folder, goal)?;
    if let Some(out) = out {
        tidy(out)?;
        say!("  written: {}", out.display());
    }
    Ok(others.refused)
}

/// Compares the spectra of the index.
fn tell(folder: &Path, recomputed: &Path) -> Result<(), Failure> {
    let text = fs::read_to_string(folder.join(INDEX)).unwrap_or_default();
    let index: RunIndex = serde_json::from_str(&text).unwrap_or_default();
    let files = index.sweeps.iter().map(|sweep| sweep.file.as_str());
    let (mut spectra, mut identical) = (0, 0);
    for file in files {
        let read = |folder: &Path| {
            dataset::read_spectrum_csv(&folder.join(file)).map_err(RecordError::from)
        };
        let (was, is) = (read(folder)?, read(recomputed)?);
        spectra += 1;
        if fs::read(folder.join(file))? == fs::read(recomputed.join(file))? {
            identical += 1;
            continue;
        }
        changed(file, &was, &is);
    }
    say!("  spectra bit-identical: {identical} of {spectra}");
    let traces: Vec<&str> = index
        .traces
        .iter()
        .filter(|trace| trace.commanded.is_some())
        .map(|trace| trace.file.as_str())
        .collect();
    let mut same = 0;
    for file in &traces {
        let differences = compare(folder, recomputed, file)?;
        same += usize::from(differences.is_empty());
        differences
            .iter()
            .for_each(|one| say!("  {}: {}", one.file, one.what));
    }
    if !traces.is_empty() {
        say!("  traces bit-identical: {same} of {}", traces.len());
    }
    Ok(())
}

/// A table of what changed in a spectrum.
fn changed(file: &str, was: &[ImpedancePoint], is: &[ImpedancePoint]) {
    let mut rows: Vec<(f64, f64, f64, f64)> = Vec::new();
    for point in is {
        let Some(before) = was.iter().find(|before| before.freq_hz == point.freq_hz) else {
            continue;
        };
        let (change_ohm, sigma_ohm) = (
            (point.z_ohm - before.z_ohm).norm(),
            (before.covariance.re_re + before.covariance.im_im).sqrt(),
        );
        let sigma_change =
            (point.covariance.re_re + point.covariance.im_im).sqrt() / sigma_ohm - 1.0;
        rows.push((
            point.freq_hz,
            change_ohm,
            change_ohm / sigma_ohm,
            sigma_change,
        ));
    }
    let worst = rows.iter().map(|row| row.2).fold(0.0, f64::max);
    say!(
        "  {file}: changed; {} points stored, {} now; |ΔZ|/σ at most {}",
        was.len(),
        is.len(),
        significant(worst, 3)
    );
    say!(
        "    {:>12} {:>12} {:>10} {:>12}",
        "f / Hz",
        "|ΔZ| / µΩ",
        "|ΔZ|/σ",
        "Δσ / %"
    );
    rows.sort_by(|a, b| b.2.total_cmp(&a.2));
    for (freq_hz, change_ohm, over_sigma, sigma_change) in rows.iter().take(TOLD) {
        say!(
            "    {:>12} {:>12} {:>10} {:>12}",
            significant(*freq_hz, 6),
            significant(1.0e6 * change_ohm, 3),
            significant(*over_sigma, 3),
            significant(100.0 * sigma_change, 3)
        );
    }
    if rows.len() > TOLD {
        say!("    {} more", rows.len() - TOLD);
    }
}

/// Takes away what only served the replay: links to what was read, and the beginnings of records.
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

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A left-over in the system's folder of temporary files is no failure.
        let _ = fs::remove_dir_all(&self.0);
    }
}
