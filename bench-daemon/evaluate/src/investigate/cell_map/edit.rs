//! Parts of the text of an experiment with a map that others replace: its name, its points, its controls
//! and its paths.

use std::{
    fmt::Write as _,
    path::{Component, Path, PathBuf},
};

use bench_plan::{config::MapPlace, plan::percent};

/// The section of the controls.
pub(super) const CONTROLS: &str = "fixture_check";

/// Returns a text without the sections of the controls.
pub(super) fn without_controls(text: &str) -> String {
    let mut kept = String::new();
    let mut inside = false;
    for line in text.split_inclusive('\n') {
        let header = line.trim_start().strip_prefix('[');
        if let Some((name, _)) = header.and_then(|header| header.split_once(']')) {
            let first = name.trim_start_matches('[').split('.').next();
            inside = first.is_some_and(|first| first.trim() == CONTROLS);
        }
        if !inside {
            kept.push_str(line);
        }
    }
    kept
}

/// The name of an experiment in a file: that of the file, with the characters of names.
pub(super) fn named(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let dashed = |c: char| {
        if c.is_ascii_alphanumeric() || c == '_' {
            c
        } else {
            '-'
        }
    };
    stem.chars().map(dashed).collect()
}

/// The points as the list of `[map]`.
pub(super) fn points_text(places: &[MapPlace]) -> String {
    let mut text = "points = [\n".to_owned();
    for place in places {
        let measured = [
            (place.spectrum, "\"spectrum\""),
            (place.pulses, "\"pulses\""),
        ];
        let measured: Vec<&str> = measured
            .iter()
            .filter_map(|(is_measured, name)| is_measured.then_some(*name))
            .collect();
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "    {{ soc = \"{} %\", temperature = \"{} °C\", measure = [{}] }},",
            percent(place.soc),
            place.temperature_degc,
            measured.join(", ")
        );
    }
    text + "]"
}

/// Returns a path relative to a folder; absolute if they have no common part.
pub(super) fn seen_from(folder: &Path, path: &Path) -> String {
    let (Some(folder), Some(path)) = (plain(folder), plain(path)) else {
        return path.display().to_string();
    };
    let (from, to): (Vec<_>, Vec<_>) = (folder.components().collect(), path.components().collect());
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    // Below the root alone, an absolute path is easier to read.
    if shared < 2 {
        return path.display().to_string();
    }
    let up = from[shared..].iter().map(|_| Component::ParentDir);
    let relative: PathBuf = up.chain(to[shared..].iter().copied()).collect();
    relative.display().to_string()
}

/// An absolute path without `.` and `..`.
fn plain(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path).ok()?.components() {
        match part {
            Component::ParentDir => {
                plain.pop();
            }
            Component::CurDir => {}
            other => plain.push(other),
        }
    }
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sections_of_the_controls_are_left_out() {
        assert_eq!(
            without_controls(
                "[a]\nx = 1\n[ fixture_check.shunt ]\ny = 2\n[fixture_check]\n[[b]]\nz = 3\n"
            ),
            "[a]\nx = 1\n[[b]]\nz = 3\n"
        );
    }

    #[test]
    fn a_file_is_seen_from_the_folder_of_another() {
        let seen = |folder: &str, path: &str| seen_from(Path::new(folder), Path::new(path));
        assert_eq!(seen("/a/b/c", "/a/b/../b/d/x.toml"), "../d/x.toml");
        assert_eq!(seen("/a/b", "/a/b/x.toml"), "x.toml");
        assert_eq!(seen("/a/b", "/c/x.toml"), "/c/x.toml");
    }
}
