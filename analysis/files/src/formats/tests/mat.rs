//! Structures of MATLAB: nested, several, and of the layout of NASA's PCoE.

use crate::formats::{ReadSeries, SeriesOptions, read_record};
use std::path::Path;

/// An element of a type, padded to eight bytes.
fn element(kind: u32, content: &[u8]) -> Vec<u8> {
    let mut all = kind.to_le_bytes().to_vec();
    all.extend(u32::try_from(content.len()).unwrap().to_le_bytes());
    all.extend(content);
    all.resize(all.len().next_multiple_of(8), 0);
    all
}

/// An array of a class.
fn array(class: u8, sizes: [i32; 2], name: &str, content: &[u8]) -> Vec<u8> {
    let flags = element(6, &[class, 0, 0, 0, 0, 0, 0, 0]);
    let sizes = element(5, &sizes.map(i32::to_le_bytes).concat());
    let name = element(1, name.as_bytes());
    element(14, &[flags, sizes, name, content.to_vec()].concat())
}

fn vector(name: &str, values: &[f64]) -> Vec<u8> {
    let content: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let rows = i32::try_from(values.len()).unwrap();
    array(6, [rows, 1], name, &element(9, &content))
}

/// A structure of fields without own names.
fn structure(name: &str, fields: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut names = Vec::new();
    for (field, _) in fields {
        let mut padded = field.as_bytes().to_vec();
        padded.resize(32, 0);
        names.extend(padded);
    }
    let content: Vec<Vec<u8>> = [element(5, &32_i32.to_le_bytes()), element(1, &names)]
        .into_iter()
        .chain(fields.iter().map(|(_, content)| content.clone()))
        .collect();
    array(2, [1, 1], name, &content.concat())
}

/// A record with a pulse of this current, from the given time on.
fn record(name: &str, from_s: f64, current_a: f64) -> Vec<u8> {
    let time_s: Vec<f64> = (0..30).map(|k| from_s + f64::from(k)).collect();
    let on = |k: usize| {
        if (10..20).contains(&k) {
            current_a
        } else {
            0.0
        }
    };
    let amps: Vec<f64> = (0..30).map(on).collect();
    let volts: Vec<f64> = amps.iter().map(|a| 3.6 + 0.05 * a).collect();
    structure(
        name,
        &[
            ("Time", vector("", &time_s)),
            ("Voltage", vector("", &volts)),
            ("Current", vector("", &amps)),
        ],
    )
}

fn read(variables: &[Vec<u8>]) -> Result<ReadSeries, String> {
    let mut file = b"MATLAB 5.0 MAT-file".to_vec();
    file.resize(124, b' ');
    file.extend(b"\x00\x01IM");
    file.extend(variables.concat());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mat");
    std::fs::write(&path, file).unwrap();
    read_record(&path, &SeriesOptions::default()).map_err(|error| error.to_string())
}

#[test]
fn a_structure_within_structures_is_a_record() {
    let inner = structure("", &[("meas", record("", 0.0, -2.0))]);
    let read = read(&[structure("cell1", &[("test", inner)])]).unwrap();
    assert_eq!((read.series.len(), read.series.current_a[12]), (30, 2.0));
    assert_eq!(read.steps, None);
}

#[test]
fn several_records_become_one_by_their_times_or_with_an_hour_between_them() {
    let after = read(&[record("a", 0.0, -2.0), record("b", 100.0, 1.0)]).unwrap();
    assert_eq!(after.series.time_s[30], 100.0);
    assert_eq!(after.series.current_a[42], -1.0);
    assert_eq!(after.steps.unwrap()[29..31], [1.0, 2.0]);
    assert!(after.notes[0].contains("2 records"), "{:?}", after.notes);
    let again = read(&[record("a", 0.0, -2.0), record("b", 0.0, 1.0)]).unwrap();
    assert_eq!(again.series.time_s[30], 29.0 + 3600.0);
    assert!(again.notes[0].contains("an hour"), "{:?}", again.notes);
}

#[test]
fn no_record_and_the_same_one_twice_are_refused_by_their_names() {
    let twice = read(&[record("raw", 0.0, -2.0), record("copy", 0.0, -2.0)]).unwrap_err();
    assert!(twice.contains("the same one in raw and copy"), "{twice}");
    let none = read(&[structure("meas", &[("Power", vector("", &[1.0, 2.0]))])]).unwrap_err();
    assert!(none.contains("fields are meas, Power"), "{none}");
}

#[test]
fn cycles_with_dates_are_steps_of_one_record() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/data/series");
    let path = Path::new(folder).join("cycles.mat");
    let read = read_record(&path, &SeriesOptions::default()).unwrap();
    let series = &read.series;
    assert_eq!(series.len(), 200);
    // 2008-04-02 13:08:17.921 to 15:25:41.593.
    assert!(
        (series.time_s[100] - 8243.672).abs() < 1e-3,
        "{}",
        series.time_s[100]
    );
    assert_eq!((series.current_a[40], series.current_a[140]), (-1.5, 2.0));
    assert_eq!(series.temperature_degc.as_ref().unwrap()[3], 24.0);
    assert_eq!(read.steps.unwrap()[99..101], [1.0, 2.0]);
}
