//! Spectra of an uploaded file, for comparison with those of a run. Nothing is stored.
//!
//! A file, above all a compressed one, can be crafted to exhaust memory or time. It is therefore
//! read by a separate process with limits of both, the hidden command `read-spectra`. Exceeding a
//! limit ends that process, and affects neither the server nor a run.

use std::{collections::BTreeMap, io::Read, path::Path};

use analysis::{formats::parse_file, run_folder, spectrum::SourcedSpectrum};
use nix::sys::resource::{Resource, setrlimit};
use serde::Serialize;
use utoipa::ToSchema;

use super::spectra::{Point, Spectrum};
use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::say;

/// Longest file, bytes: a spectrum of a thousand points has some 100 kB in any format that is read.
pub const LONGEST: usize = 8_000_000;
/// Maximum number of files that are read, and held in memory, at the same time.
pub const AT_ONCE: usize = 2;
/// Maximum number of points of a file. In JSON a point has some 150 bytes, so that a reply has at
/// most 3 MB.
pub const MOST_POINTS: usize = 20_000;

/// Memory of the process that reads a file, bytes of address space: the largest file takes less
/// than a tenth of it.
const MEMORY: u64 = 2 << 30;
/// Processor time of it, s: the largest file takes 3 s in a build for tests.
const PROCESSOR_S: u64 = 20;
/// Time limit for reading a file, s.
pub const WAIT_S: f64 = 60.0;

/// Arguments of `read-spectra`.
#[derive(Debug, clap::Args)]
pub struct ReadSpectraArgs {
    /// Name of the file; its bytes come on standard input.
    pub name: String,
}

/// Reads a file on standard input within the bounds, and prints its spectra as JSON.
///
/// # Errors
/// A file that is not of a known format.
pub fn command(args: &ReadSpectraArgs) -> Result<(), Failure> {
    for (resource, bound) in [
        (Resource::RLIMIT_AS, MEMORY),
        (Resource::RLIMIT_CPU, PROCESSOR_S),
        (Resource::RLIMIT_CORE, 0),
    ] {
        setrlimit(resource, bound, bound).map_err(std::io::Error::from)?;
    }
    let mut bytes = Vec::new();
    std::io::stdin().lock().read_to_end(&mut bytes)?;
    let spectra = read(&args.name, &bytes).map_err(Failure::Usage)?;
    let text = serde_json::to_string(&spectra).map_err(std::io::Error::from)?;
    say!("{text}");
    Ok(())
}

/// Reason why a process has read no file, by its end and its last words.
pub fn refusal(name: &str, code: Option<i32>, errors: &str) -> String {
    let word = errors
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("eis-bench: "));
    match (code, word) {
        (Some(2), Some(word)) => word.to_owned(),
        _ => format!(
            "{name}: expected a file that can be read with {} GiB and within {PROCESSOR_S} s, found \
            one that needs more, or that cannot be read at all",
            MEMORY >> 30
        ),
    }
}

/// Spectra of a file.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub struct ImportedSpectra {
    /// Spectra in the order of the file, in the format of those of a run.
    pub spectra: Vec<Spectrum>,
    /// How the file was read: how its spectra were distinguished, and what was left out or assumed.
    pub notes: Vec<String>,
}

/// Reads the bytes of a file. Its name is used for names and messages only.
///
/// # Errors
/// A file that is not of a known format, or has more than [`MOST_POINTS`]: it is named, with what
/// was expected and found.
pub fn read(name: &str, bytes: &[u8]) -> Result<ImportedSpectra, String> {
    let read = parse_file(Path::new(name), bytes).map_err(|error| error.to_string())?;
    let points = read.spectra.iter().map(|one| one.spectrum.points.len());
    let points: usize = points.sum();
    if points > MOST_POINTS {
        return Err(format!(
            "{name}: expected at most {MOST_POINTS} points to be compared, found {points}"
        ));
    }
    Ok(ImportedSpectra {
        spectra: read.spectra.iter().map(shown).collect(),
        notes: read.notes,
    })
}

/// Converts a spectrum to the format of those of a run, with the quality flags of its points.
fn shown(sourced: &SourcedSpectrum) -> Spectrum {
    let flagged = sourced.flagged.iter();
    let refused: BTreeMap<u64, String> = flagged
        .map(|point| (point.freq_hz.to_bits(), point.reasons.join("; ")))
        .collect();
    let spectrum = &sourced.spectrum;
    let mut points: Vec<Point> = spectrum.points.iter().map(Point::from).collect();
    for point in &mut points {
        point.verdict = refused.get(&point.freq_hz.to_bits()).cloned();
    }
    points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
    Spectrum {
        name: spectrum.name.clone(),
        corrected: !run_folder::is_raw(&spectrum.name),
        points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "freq_hz,z_re_ohm,z_im_ohm,flags\n";

    #[test]
    fn refused_points_tell_why_and_the_lowest_frequency_is_first() {
        let text = format!("{HEAD}10,0.02,-0.001,\n1,0.03,-0.002,noise: expected less; drift\n");
        let spectra = read("cell.csv", text.as_bytes()).unwrap().spectra;
        assert_eq!((spectra.len(), spectra[0].name.as_str()), (1, "cell"));
        let points = &spectra[0].points;
        assert_eq!([points[0].freq_hz, points[1].freq_hz], [1.0, 10.0]);
        assert_eq!(
            points[0].verdict.as_deref(),
            Some("noise: expected less; drift")
        );
        assert_eq!(points[1].verdict, None);
        let raw = read("raw_cell.csv", text.as_bytes()).unwrap();
        assert!(spectra[0].corrected && !raw.spectra[0].corrected);
    }

    #[test]
    fn more_points_than_can_be_compared_are_refused() {
        let rows = (0..=MOST_POINTS).map(|k| format!("{},0.02,-0.001,\n", 1 + k));
        let text = format!("{HEAD}{}", rows.collect::<String>());
        let error = read("long.csv", text.as_bytes()).unwrap_err();
        assert_eq!(
            error,
            "long.csv: expected at most 20000 points to be compared, found 20001"
        );
    }
}
