//! Scans: folders that are read, folders that are read again, and folders that have disappeared.

use std::fs;

use analysis_catalog::{
    Catalog,
    query::Filter,
    record::{CatalogVerdict, TimeSource},
    scan::ScanOptions,
};
use analysis_files::run_folder::{JOURNAL, MANIFEST, SPECTRUM};

use crate::made::{Made, Place, answers, filter};

fn few() -> Vec<Made> {
    (0..12).map(Made::of).collect()
}

#[test]
fn what_has_not_changed_is_not_read_again() {
    let place = Place::with(&few());
    let first = place.scan();
    assert_eq!((first.runs, first.read, first.damaged), (12, 12, 0));
    let second = place.scan();
    assert_eq!((second.runs, second.read, second.vanished), (12, 0, 0));
    Made {
        how: Some("ended early: interlock: voltage 4.3 V".to_owned()),
        ..Made::of(3)
    }
    .write(&place.runs);
    Made {
        how: Some("ended early: stopped on request; the bench is in safe state".to_owned()),
        ..Made::of(4)
    }
    .write(&place.runs);
    Made::of(12).write(&place.runs);
    assert_eq!(place.scan().read, 3);
    let stopped = place.open().show("run000004").unwrap();
    assert_eq!(stopped.run.verdict, CatalogVerdict::Stopped);
    assert!(!stopped.run.verdict.eq(&CatalogVerdict::Failed));
    let shown = place.open().show("run000003").unwrap();
    assert_eq!(shown.run.verdict, CatalogVerdict::Failed);
    assert_eq!(shown.run.trip.as_deref(), Some("voltage 4.3 V"));
    assert_eq!(shown.fits.len(), 2);
}

#[test]
fn a_catalogue_that_is_built_again_gives_the_same_answers() {
    let place = Place::with(&few());
    place.scan();
    let before = answers(&place.open());
    fs::remove_file(&place.catalog).unwrap();
    place.scan();
    assert_eq!(answers(&place.open()), before);
    assert!(before.contains("\"run000011\""));
}

#[test]
fn a_vanished_folder_is_marked_and_taken_out_on_request_only() {
    let place = Place::with(&few());
    place.scan();
    let folder = place.runs.join("run000005");
    let away = place.catalog.with_file_name("away");
    fs::rename(&folder, &away).unwrap();
    let scanned = place.scan();
    assert_eq!((scanned.runs, scanned.vanished), (11, 1));
    assert!(place.open().show("run000005").unwrap().run.missing);
    assert_eq!(place.scan().vanished, 0);
    fs::rename(&away, &folder).unwrap();
    assert_eq!(place.scan().read, 1);
    assert!(!place.open().show("run000005").unwrap().run.missing);
    fs::remove_dir_all(&folder).unwrap();
    place.scan();
    assert_eq!(
        Catalog::make(&place.catalog)
            .unwrap()
            .forget_missing()
            .unwrap(),
        1
    );
    let error = place.open().show("run000005").unwrap_err().to_string();
    assert!(error.contains("found 0 for \"run000005\""), "{error}");
}

#[test]
fn one_folder_is_scanned_again_without_the_others() {
    let place = Place::with(&few());
    place.scan();
    Made::of(12).write(&place.runs);
    let folder = Made::of(13).write(&place.runs);
    let catalog = Catalog::make(&place.catalog).unwrap();
    let scanned = catalog
        .scan_again(&[folder], &ScanOptions::plain())
        .unwrap();
    assert_eq!((scanned.runs, scanned.read, scanned.vanished), (1, 1, 0));
    let names = place.names(&Filter::default());
    assert_eq!((names.len(), names[0].as_str()), (13, "run000013"));
    assert_eq!(catalog.roots().unwrap().len(), 1);
}

#[test]
fn a_root_that_is_not_there_changes_nothing() {
    let place = Place::with(&few());
    place.scan();
    let away = place.runs.with_file_name("away");
    fs::rename(&place.runs, &away).unwrap();
    let catalog = Catalog::make(&place.catalog).unwrap();
    let error = catalog.scan(&[], &ScanOptions::plain()).unwrap_err();
    assert!(
        error.to_string().contains("expected a folder to scan"),
        "{error}"
    );
    assert!(
        place
            .open()
            .all_runs(&Filter::default())
            .unwrap()
            .iter()
            .all(|run| !run.missing)
    );
}

#[test]
fn damaged_folders_are_listed_with_their_reasons() {
    let place = Place::with(&few());
    let write = |run: &str, name: &str, text: &str| {
        fs::write(place.runs.join(run).join(name), text).unwrap();
    };
    write("run000000", MANIFEST, "{\"version\":");
    write("run000001", SPECTRUM, "freq_hz\n1\n");
    write("run000002", JOURNAL, "no journal\n");
    write(
        "run000003",
        "model_1rc.json",
        "{\"schema\":\"other\",\"schema_version\":1}",
    );
    fs::remove_file(place.runs.join("run000004").join(MANIFEST)).unwrap();
    let scanned = place.scan();
    assert_eq!((scanned.runs, scanned.damaged), (12, 5));
    let reason = |run: &str| place.open().show(run).unwrap().run.damage.join("\n");
    assert!(reason("run000000").starts_with("manifest.json: expected JSON of this program"));
    assert!(reason("run000001").starts_with("spectrum.csv, line 1: expected the header"));
    assert!(reason("run000002").starts_with("journal.jsonl:1: expected a line with the field"));
    assert!(reason("run000003").contains("schema: expected eis-bench/model version 1 to 2"));
    assert!(reason("run000004").starts_with("manifest.json: expected of an ended run"));
    let damaged = filter(&[("verdict", "damaged")]);
    assert_eq!(place.names(&damaged).len(), 5);
}

#[test]
fn a_run_in_virtual_time_has_the_time_of_its_file() {
    let virtually = Made {
        is_virtual: true,
        ..Made::of(0)
    };
    let place = Place::with(&[virtually, Made::of(1)]);
    place.scan();
    let run = |name: &str| place.open().show(name).unwrap().run;
    assert_eq!(run("run000000").time_source, TimeSource::File);
    assert!(run("run000000").started_unix_s > 1.7e9 + 1.0e6);
    assert_eq!(run("run000001").time_source, TimeSource::Clock);
    assert_eq!(
        run("run000001").started_unix_s,
        Made::of(1).started_unix_s()
    );
}

#[test]
fn a_diagnosis_finds_its_run_beside_it() {
    let place = Place::with(&few());
    Made::of(7).diagnose(&place.runs.join("diagnosed"));
    assert_eq!(place.scan().diagnoses, 1);
    let catalog = place.open();
    let shown = catalog.show("run000007").unwrap();
    assert_eq!(shown.diagnoses[0].verdict, "explained");
    assert_eq!(shown.diagnoses[0].cell.as_deref(), Some("C07"));
    let cell = filter(&[("cell", "C07")]);
    let ageing = catalog.ageing(&cell, None).unwrap();
    assert_eq!(ageing.points[0].diffusion[0].sigma, Some(1e-4));
    let chart = analysis_plot::chart_svg(&ageing.chart()).unwrap();
    assert!(chart.contains("diffusion r_ohm") && chart.contains("DC resistance / mΩ"));
}

#[test]
fn a_diagnosis_that_came_before_its_run_finds_it_later() {
    let place = Place::with(&few());
    let late = Made::of(20);
    late.diagnose(&place.runs.join("diagnosed"));
    assert_eq!(place.scan().diagnoses, 1);
    assert!(
        place
            .open()
            .all_diagnoses(&Filter::default())
            .unwrap()
            .is_empty()
    );
    late.write(&place.runs);
    place.scan();
    let shown = place.open().show("run000020").unwrap();
    assert_eq!(shown.diagnoses.len(), 1);
    // A known diagnosis is not read again.
    assert_eq!(place.scan().diagnoses, 1);
}

#[test]
fn diagnoses_of_several_cells_are_of_one_each() {
    let several = Made {
        cells: vec!["A", "B"],
        ..Made::of(3)
    };
    let place = Place::with(&[Made::of(1), several.clone()]);
    let run = place.runs.join("run000003");
    several.diagnose(&run.join("diagnosis/A"));
    several.diagnose(&run.join("diagnosis/B"));
    // Laid out as by a server, with one diagnosis that belongs to none of them.
    several.diagnose(&place.runs.join("analyses/d-1/out/B"));
    several.diagnose(&place.runs.join("analyses/d-2/out"));
    let found = place.scan();
    assert_eq!((found.runs, found.diagnoses), (2, 4));
    let catalog = place.open();
    let shown = catalog.show("run000003").unwrap().diagnoses;
    let cells: Vec<Option<&str>> = shown.iter().map(|one| one.cell.as_deref()).collect();
    assert_eq!(cells, [Some("B"), None, Some("A"), Some("B")]);
    for (cell, number) in [("A", 2), ("S-B", 3), ("C01", 0)] {
        let filter = Filter {
            cell: Some(cell.to_owned()),
            ..Filter::default()
        };
        assert_eq!(
            catalog.all_diagnoses(&filter).unwrap().len(),
            number,
            "{cell}"
        );
    }
    // The state of the folder is that of its diagnoses.
    fs::remove_dir_all(run.join("diagnosis/A")).unwrap();
    assert_eq!(place.scan().diagnoses, 3);
}
