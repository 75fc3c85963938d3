//! Spectra and fits of a run folder, as the API shows them. A sweep in work shows the points that
//! it has.

use std::{collections::BTreeMap, os::unix::fs::MetadataExt, path::Path};

use analysis::{
    dataset::{FLAGS, read_spectrum_csv},
    run_folder::{self, SPECTRA},
};
use serde::Serialize;
use utoipa::ToSchema;

pub use bench_evaluate::figures::curves::Point;
use bench_plan::support::confined_path;

/// A spectrum.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Spectrum {
    /// Its name: that of the file, without extension.
    pub name: String,
    /// True if the harness is subtracted; otherwise it is as read.
    pub corrected: bool,
    /// Its points, by frequency.
    pub points: Vec<Point>,
}

/// Files of spectra with their stamps.
pub type Stamps = BTreeMap<String, (u64, i64, i64, u64)>;

/// Which spectra a run folder has, and which state they are in: cheap to ask often.
pub fn stamps(run: &Path) -> Stamps {
    let stamp = |file: &str| {
        let meta = std::fs::symlink_metadata(run.join(file))
            .ok()
            .filter(std::fs::Metadata::is_file)?;
        Some((
            file.to_owned(),
            (meta.len(), meta.mtime(), meta.mtime_nsec(), meta.ino()),
        ))
    };
    let below = |folder: &str| {
        let entries = std::fs::read_dir(run.join(folder))
            .into_iter()
            .flatten()
            .flatten();
        entries
            .filter_map(|entry| entry.file_name().into_string().ok())
            .collect::<Vec<_>>()
    };
    let root = below("")
        .into_iter()
        .filter(|name| run_folder::is_spectrum(name));
    let more = below(SPECTRA)
        .into_iter()
        .map(|name| format!("{SPECTRA}/{name}"));
    let csv =
        |name: &String| name.ends_with(".csv") && !name.contains("/.") && !name.starts_with('.');
    root.chain(more)
        .filter(csv)
        .filter_map(|file| stamp(&file))
        .collect()
}

/// Reads a spectrum, or returns `None` if it cannot be read now.
pub fn read(run: &Path, file: &str) -> Option<Spectrum> {
    let text = std::io::read_to_string(confined_path::open(run, file)?).ok()?;
    let flags = flags(&text);
    let mut points: Vec<Point> = read_spectrum_csv(&run.join(file))
        .ok()?
        .iter()
        .map(Point::from)
        .collect();
    for (point, flag) in points.iter_mut().zip(flags) {
        point.verdict = Some(flag.to_owned()).filter(|flag| !flag.is_empty());
    }
    points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
    let name = file.trim_end_matches(".csv").to_owned();
    Some(Spectrum {
        corrected: !run_folder::is_raw(&name),
        name,
        points,
    })
}

/// Returns the reasons of the gate for each row; empty if the table has no such column.
fn flags(text: &str) -> Vec<&str> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = header
        .iter()
        .position(|name| *name == FLAGS.trim_start_matches(','));
    let of_row = |line| {
        column
            .and_then(|column| str::split(line, ',').nth(column))
            .unwrap_or_default()
    };
    lines.map(of_row).collect()
}

/// Fitted models of a run folder, as their files hold them.
pub fn fits(run: &Path) -> Vec<(String, serde_json::Value)> {
    let entries = std::fs::read_dir(run).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.retain(|name| run_folder::is_model(name));
    names.sort();
    let read = |name: String| {
        let value = serde_json::from_reader(confined_path::open(run, &name)?).ok()?;
        Some((name.trim_end_matches(".json").to_owned(), value))
    };
    names.into_iter().filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_points_tell_why_and_the_others_do_not() {
        let text = "freq_hz,z_re_ohm,flags\n1,2,\n3,4,noise: expected less; drift\n";
        assert_eq!(flags(text), ["", "noise: expected less; drift"]);
        assert_eq!(flags("freq_hz,z_re_ohm\n1,2\n"), [""]);
    }
}
