//! Compares two files that should be equal: finds which number of which row differs, and by how
//! much.

use std::{collections::BTreeSet, fs, path::Path};

use analysis::batch::has_same_rows;
use serde_json::Value;

/// Differences of one file that are listed; more are counted.
const MOST_LISTED: usize = 8;

/// Something that differs.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Difference {
    /// The file, relative to the folder.
    pub file: String,
    /// Location in the file, and what was expected and found.
    pub what: String,
}

/// Compares a file of two folders, the stored first.
///
/// # Errors
/// A file that cannot be read.
pub fn compare(stored: &Path, again: &Path, file: &str) -> std::io::Result<Vec<Difference>> {
    let (was, is) = (fs::read(stored.join(file))?, fs::read(again.join(file))?);
    let is_table = file.ends_with(".parquet");
    if was == is || (is_table && has_same_rows(&stored.join(file), &again.join(file))) {
        return Ok(Vec::new());
    }
    let (was_text, is_text) = (String::from_utf8_lossy(&was), String::from_utf8_lossy(&is));
    let mut places = if file.ends_with(".csv") {
        of_tables(&was_text, &is_text)
    } else if let (true, Ok(was), Ok(is)) = (
        file.ends_with(".json"),
        serde_json::from_str(&was_text),
        serde_json::from_str(&is_text),
    ) {
        let mut places = Vec::new();
        of_values("", &was, &is, &mut places);
        places
    } else {
        Vec::new()
    };
    if places.is_empty() {
        let at = was
            .iter()
            .zip(&is)
            .position(|(was, is)| was != is)
            .unwrap_or(was.len().min(is.len()));
        places.push(format!(
            "byte {at}: {} bytes stored, {} recomputed",
            was.len(),
            is.len()
        ));
    }
    let more = places.len().saturating_sub(MOST_LISTED);
    places.truncate(MOST_LISTED);
    places.extend((more > 0).then(|| format!("{more} more")));
    Ok(places
        .into_iter()
        .map(|what| Difference {
            file: file.to_owned(),
            what,
        })
        .collect())
}

fn differs(place: &str, was: &str, is: &str) -> String {
    let share = match (was.parse::<f64>(), is.parse::<f64>()) {
        (Ok(was), Ok(is)) if was != 0.0 && is.is_finite() => {
            format!(" ({:+.2e} of it)", (is - was) / was.abs())
        }
        _ => String::new(),
    };
    format!("{place}: stored {was}, recomputed {is}{share}")
}

fn of_tables(was: &str, is: &str) -> Vec<String> {
    let header: Vec<&str> = was.lines().next().unwrap_or("").split(',').collect();
    let mut places = Vec::new();
    let (was, is): (Vec<&str>, Vec<&str>) = (was.lines().collect(), is.lines().collect());
    for (number, (was, is)) in (1..)
        .zip(was.iter().zip(&is))
        .filter(|(_, (was, is))| was != is)
    {
        let (a, b): (Vec<&str>, Vec<&str>) = (was.split(',').collect(), is.split(',').collect());
        if a.len() != b.len() {
            places.push(format!("line {number}: stored {was:?}, recomputed {is:?}"));
            continue;
        }
        for (column, (a, b)) in a.iter().zip(&b).enumerate().filter(|(_, (a, b))| a != b) {
            places.push(differs(
                &format!("line {number}, {}", header.get(column).unwrap_or(&"")),
                a,
                b,
            ));
        }
    }
    if was.len() != is.len() {
        places.push(format!(
            "{} lines stored, {} recomputed",
            was.len(),
            is.len()
        ));
    }
    places
}

fn of_values(at: &str, was: &Value, is: &Value, places: &mut Vec<String>) {
    match (was, is) {
        (Value::Object(a), Value::Object(b)) => {
            let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys {
                let below = if at.is_empty() {
                    key.clone()
                } else {
                    format!("{at}.{key}")
                };
                of_values(
                    &below,
                    a.get(key).unwrap_or(&Value::Null),
                    b.get(key).unwrap_or(&Value::Null),
                    places,
                );
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().for_each(|(index, (was, is))| {
                of_values(&format!("{at}[{index}]"), was, is, places);
            });
        }
        (was, is) if was != is => {
            let short = |value: &Value| value.to_string().chars().take(80).collect::<String>();
            places.push(differs(at, &short(was), &short(is)));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_that_differs_is_named() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let message = |name: &str, was: &str, is: &str| {
            fs::write(a.path().join(name), was).unwrap();
            fs::write(b.path().join(name), is).unwrap();
            compare(a.path(), b.path(), name)
                .unwrap()
                .into_iter()
                .map(|one| one.what)
                .collect::<Vec<_>>()
        };
        assert_eq!(message("x.csv", "f,z\n1,2\n", "f,z\n1,2\n"), [""; 0]);
        assert_eq!(
            message("x.csv", "f,z\n1,2\n3,4\n", "f,z\n1,2.5\n"),
            [
                "line 2, z: stored 2, recomputed 2.5 (+2.50e-1 of it)",
                "3 lines stored, 2 recomputed"
            ]
        );
        let (was, is) = (r#"{"a":{"b":[1,2]},"c":"x"}"#, r#"{"a":{"b":[1,4]}}"#);
        assert_eq!(
            message("x.json", was, is),
            [
                "a.b[1]: stored 2, recomputed 4 (+1.00e0 of it)",
                "c: stored \"x\", recomputed null"
            ]
        );
        assert_eq!(
            message("x.png", "ab", "ac"),
            ["byte 1: 2 bytes stored, 2 recomputed"]
        );
    }
}
