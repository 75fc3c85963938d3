//! Pushes: once, whatever fails and wherever they end.

use std::{fs, path::Path};

use analysis_catalog::{rows::RunRows, scan::Beside};
use analysis_files::{
    batch::Cells,
    run_folder::{JOURNAL, SPECTRUM, SUMS},
};
use bench_archive::{
    ArchiveError,
    push::Outcome,
    receipt::{RunState, TroubleKind},
    snapshot::RunSource,
};
use object_store::{ObjectStoreExt, PutPayload, path::Path as ObjectPath};

use crate::made::{Made, Place, block_on, diagnosed, held, write_sums};

/// Pushes until it goes well.
fn push_at_last(place: &Place, source: &RunSource) {
    let went_well = (0..200).any(|_| place.push(source).is_ok());
    assert!(went_well, "{:?}", place.receipt(source).trouble);
}

#[test]
fn every_byte_of_a_run_is_there_and_a_second_push_asks_for_nothing() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    assert!(matches!(place.push(&run).unwrap(), Outcome::Archived(_)));
    place.assert_holds(&run);
    let sha256 = place.kept(&run).placed.run_sha256;
    let partition = "site=north/bench=b1/date=2023-11-14";
    let rows = ["fits", "runs", "spectra"]
        .map(|table| format!("tables/{table}/{partition}/{sha256}.parquet"));
    assert_eq!(place.rows(), rows);
    let asked = place.faults.operations();
    assert!(matches!(place.push(&run).unwrap(), Outcome::Unchanged(_)));
    assert_eq!(place.faults.operations(), asked);
}

#[test]
fn a_push_that_ends_at_any_operation_and_is_repeated_gives_the_same_store() {
    let place = Place::new();
    let run = Made::LARGE.write(&place);
    place.push(&run).unwrap();
    let (wanted, operations) = (place.held(), place.faults.operations());
    assert!(operations > 20, "{operations}");
    for dead_from in 0..operations {
        let place = Place::new();
        let run = Made::LARGE.write(&place);
        place.faults.die_after(dead_from);
        let error = place.push(&run).unwrap_err();
        assert!(error.is_of_store() && error.may_pass(), "{error}");
        assert!(place.receipt(&run).kept.is_none());
        place.faults.mend();
        place.push(&run).unwrap();
        assert!(place.held() == wanted, "after {dead_from} operations");
        assert_eq!(place.receipt(&run).trouble, None);
    }
}

#[test]
fn a_run_that_is_in_use_is_looked_at_again_though_no_file_has_changed() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    let journal = fs::File::open(run.folder.join(JOURNAL)).unwrap();
    journal.lock().unwrap();
    let error = place.push(&run).unwrap_err();
    assert!(matches!(error, ArchiveError::Waiting { .. }), "{error}");
    let receipt = place.receipt(&run);
    assert_eq!(
        receipt.state(&receipt.store, &run.stamp()),
        RunState::Pending
    );
    journal.unlock().unwrap();
    assert!(matches!(place.push(&run).unwrap(), Outcome::Archived(_)));
}

#[test]
fn the_list_of_a_run_comes_last() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let operations = place.faults.operations();
    for dead_from in 0..operations {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        place.faults.die_after(dead_from);
        let _ = place.push(&run);
        let is_listed = place.held().keys().any(|path| path.starts_with("runs/"));
        if is_listed {
            let held = place.held();
            let objects = held.keys().filter(|path| path.starts_with("objects/"));
            assert_eq!((objects.count(), place.rows().len()), (8, 3), "{dead_from}");
        }
    }
}

#[test]
fn faults_by_chance_change_nothing_in_the_store() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let wanted = place.held();
    let mut failed = 0;
    for seed in 1..=40 {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        place.faults.fail_by_chance(24, seed);
        failed += usize::from(place.push(&run).is_err());
        push_at_last(&place, &run);
        place.faults.mend();
        assert!(place.held() == wanted, "seed {seed}");
    }
    assert!(failed > 20, "{failed}");
}

#[test]
fn bytes_that_come_back_as_others_are_not_taken_for_archived() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.faults.give_wrong("objects/");
    let error = place.push(&run).unwrap_err();
    assert!(matches!(error, ArchiveError::Bytes { .. }), "{error}");
    assert!(error.to_string().contains(": expected ") && error.to_string().contains(", found "));
    let receipt = place.receipt(&run);
    assert_eq!(receipt.kept, None);
    assert_eq!(receipt.trouble.unwrap().kind, TroubleKind::Failed);
    assert!(!place.held().keys().any(|path| path.starts_with("runs/")));
}

#[test]
fn a_damaged_object_is_sent_again() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let wanted = place.held();
    let object = wanted
        .keys()
        .find(|path| path.starts_with("objects/"))
        .unwrap();
    let damaged = vec![0; wanted[object].len()];
    let put = |bytes: Vec<u8>| {
        let at = ObjectPath::parse(object).unwrap();
        block_on(place.inner.put(&at, PutPayload::from(bytes))).unwrap();
    };
    put(damaged);
    fs::remove_dir_all(place.runs().join("../archive")).unwrap();
    place.push(&run).unwrap();
    assert!(place.held() == wanted);
}

#[test]
fn a_run_with_a_new_diagnosis_takes_the_place_of_the_one_before() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let before = place.kept(&run).placed.run_sha256;
    let diagnosed = diagnosed(&place, &run, "diagnosis-1");
    place.push(&diagnosed).unwrap();
    place.assert_holds(&diagnosed);
    let kept = place.kept(&run);
    assert_eq!(kept.supersedes.as_ref(), Some(&before));
    let rows = place.rows();
    assert_eq!(rows.len(), 4, "{rows:?}");
    assert!(
        rows.iter()
            .all(|path| path.contains(&kept.placed.run_sha256)),
        "{rows:?}"
    );
    // What it was stays, without rows.
    assert!(place.held().contains_key(&format!("runs/{before}.json")));
}

#[test]
fn a_change_that_ends_at_any_operation_and_is_repeated_counts_the_run_once() {
    let change = |dead_from: Option<u64>| {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        place.push(&run).unwrap();
        let first = diagnosed(&place, &run, "diagnosis-1");
        match dead_from {
            Some(dead_from) => place.faults.die_after(dead_from),
            None => place.faults.die_after(u64::MAX),
        }
        let pushed = place.push(&first);
        assert_eq!(pushed.is_ok(), dead_from.is_none());
        let operations = place.faults.operations();
        place.faults.mend();
        // It has changed once more by the time that it is pushed again.
        let second = diagnosed(&place, &first, "diagnosis-2");
        place.push(&second).unwrap();
        place.assert_holds(&second);
        let run = place.kept(&second).placed.run_sha256;
        let rows = place.rows();
        assert_eq!(rows.len(), 4, "after {dead_from:?} operations: {rows:?}");
        assert!(rows.iter().all(|path| path.contains(&run)), "{rows:?}");
        operations
    };
    let operations = change(None);
    (0..operations).for_each(|dead_from| _ = change(Some(dead_from)));
}

#[test]
fn two_runs_of_the_same_content_are_one_in_the_store() {
    let place = Place::new();
    let one = Made::ONE.write(&place);
    let other = Made {
        name: "other",
        ..Made::ONE
    }
    .write(&place);
    place.push(&one).unwrap();
    let wanted = place.held();
    place.push(&other).unwrap();
    assert!(place.held() == wanted);
    assert_eq!(place.kept(&one).tables, place.kept(&other).tables);
    // The rows of the one that changes are not taken from the other.
    place.push(&diagnosed(&place, &one, "diagnosis-1")).unwrap();
    assert_eq!(place.rows().len(), 3 + 4);
    place
        .push(&diagnosed(&place, &other, "diagnosis-2"))
        .unwrap();
    assert_eq!(place.rows().len(), 4 + 4);
}

#[test]
fn two_sites_that_push_the_same_run_leave_its_rows_in_one_partition() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let wanted = place.held();
    let south = Place {
        site: "south",
        ..Place::with(place.inner.clone())
    };
    let copy = Made::ONE.write(&south);
    south.push(&copy).unwrap();
    assert!(held(&place.inner) == wanted);
    // South was faster with the list, after North had begun.
    for dead_from in 0..60 {
        let north = Place::new();
        let run = Made::ONE.write(&north);
        north.faults.die_after(dead_from);
        let _ = north.push(&run);
        north.faults.mend();
        let south = Place {
            site: "south",
            ..Place::with(north.inner.clone())
        };
        south.push(&Made::ONE.write(&south)).unwrap();
        north.push(&run).unwrap();
        assert_eq!(north.rows().len(), 3, "{dead_from}: {:?}", north.rows());
    }
}

#[test]
fn a_list_that_another_made_meanwhile_is_kept_with_its_partition() {
    let north = Place::new();
    let run = Made::ONE.write(&north);
    north.push(&run).unwrap();
    let operations = north.faults.operations();
    for at in 1..=operations {
        let north = Place::new();
        let run = Made::ONE.write(&north);
        let inner = north.inner.clone();
        north.faults.at(move |number| {
            if number == at {
                let inner = inner.clone();
                // A runtime of its own: this one is at work.
                let other = std::thread::spawn(move || {
                    let south = Place {
                        site: "south",
                        ..Place::with(inner)
                    };
                    south.push(&Made::ONE.write(&south)).unwrap();
                });
                other.join().unwrap();
            }
        });
        north.push(&run).unwrap();
        let rows = north.rows();
        assert_eq!(rows.len(), 3, "operation {at}: {rows:?}");
        let lists = north
            .held()
            .into_keys()
            .filter(|path| path.starts_with("runs/"));
        assert_eq!(lists.count(), 1);
    }
}

#[test]
fn a_folder_that_is_not_what_its_list_says_is_refused_with_the_reason() {
    let refused = |change: &dyn Fn(&Path)| {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        change(&run.folder);
        let error = place.push(&run).unwrap_err();
        assert!(matches!(error, ArchiveError::Refused { .. }), "{error}");
        assert_eq!(
            place.receipt(&run).trouble.unwrap().kind,
            TroubleKind::Refused
        );
        assert!(place.held().is_empty());
        error.to_string()
    };
    let message = refused(&|folder| fs::write(folder.join(SPECTRUM), "x").unwrap());
    assert!(
        message.contains("one: not archived: spectrum.csv: expected the SHA-256"),
        "{message}"
    );
    let message = refused(&|folder| fs::remove_file(folder.join(SPECTRUM)).unwrap());
    assert!(
        message.contains("spectrum.csv: expected of SHA256SUMS, found none"),
        "{message}"
    );
    let message = refused(&|folder| fs::write(folder.join("x"), "x").unwrap());
    assert!(
        message.contains("x: expected in SHA256SUMS, found in the folder only"),
        "{message}"
    );
    let message = refused(&|folder| fs::remove_file(folder.join(SUMS)).unwrap());
    assert!(message.contains("SHA256SUMS: "), "{message}");
    let message = refused(&|folder| {
        std::os::unix::fs::symlink("/etc/hostname", folder.join("link")).unwrap();
    });
    assert!(
        message.contains("expected plain files, found \"link\""),
        "{message}"
    );
}

#[test]
fn a_diagnosis_in_the_run_folder_is_not_an_alteration() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let beside = diagnosed(&place, &run, "x").diagnoses.remove(0);
    fs::rename(beside.folder, run.folder.join("diagnosis")).unwrap();
    assert!(matches!(place.push(&run).unwrap(), Outcome::Archived(_)));
    place.assert_holds(&run);
    assert_eq!(place.rows().len(), 4);
}

#[test]
fn diagnoses_of_single_cells_in_the_run_folder_are_seen_and_have_rows() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    let before = run.stamp();
    place.push(&run).unwrap();
    for cell in ["P45B", "other"] {
        let beside = diagnosed(&place, &run, cell).diagnoses.remove(0);
        let own = run.folder.join("diagnosis");
        fs::create_dir_all(&own).unwrap();
        fs::rename(beside.folder, own.join(cell)).unwrap();
    }
    let after = run.stamp();
    assert_ne!(before, after);
    assert!(matches!(place.push(&run).unwrap(), Outcome::Archived(_)));
    place.assert_holds(&run);
    assert_eq!(place.rows().len(), 4);
    let rows = RunRows::read(&run.folder, Beside::default(), &[]).tables("00");
    let diagnoses = rows.iter().find(|table| table.name == "diagnoses").unwrap();
    let texts = |name: &str| {
        let column = diagnoses
            .columns
            .iter()
            .find(|one| one.name == name)
            .unwrap();
        let Cells::Texts(cells) = &column.cells else {
            panic!("{name}: expected texts")
        };
        cells.iter().flatten().cloned().collect::<Vec<String>>()
    };
    assert_eq!(texts("diagnosis"), ["diagnosis/P45B", "diagnosis/other"]);
    // The run has one cell, so the diagnosis must refer to it.
    assert_eq!(texts("cell"), ["P45B", "P45B"]);
    // A diagnosis that is made again, in a folder whose own entries stay.
    let file = run.folder.join("diagnosis/other/diagnosis.json");
    fs::write(&file, fs::read_to_string(&file).unwrap() + "\n").unwrap();
    assert_ne!(run.stamp(), after);
    assert!(matches!(place.push(&run).unwrap(), Outcome::Archived(_)));
}

#[test]
fn a_run_without_an_end_waits_and_one_that_failed_does_not() {
    let place = Place::new();
    let run = Made {
        how: None,
        ..Made::ONE
    }
    .write(&place);
    let error = place.push(&run).unwrap_err();
    assert!(
        error.to_string().contains("its journal has no end"),
        "{error}"
    );
    assert!(place.held().is_empty());
    let failed = Made {
        name: "failed",
        how: Some("aborted"),
        ..Made::ONE
    }
    .write(&place);
    place.push(&failed).unwrap();
    place.assert_holds(&failed);
    assert!(!place.kept(&failed).finished);
}

#[test]
fn a_folder_that_a_process_works_in_waits() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    let journal = fs::File::open(run.folder.join("journal.jsonl")).unwrap();
    journal.lock().unwrap();
    let error = place.push(&run).unwrap_err();
    assert!(
        error.to_string().contains("a process works in its folder"),
        "{error}"
    );
    drop(journal);
    place.push(&run).unwrap();
}

#[test]
fn a_folder_that_changes_meanwhile_is_begun_again() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let operations = place.faults.operations();
    for at in 1..operations {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        let folder = run.folder.clone();
        place.faults.at(move |number| {
            if number == at {
                fs::write(folder.join("report.html"), "computed again").unwrap();
                write_sums(&folder);
            }
        });
        place.push(&run).unwrap();
        // A change after the last check is a separate one, which the next push finds.
        place.push(&run).unwrap();
        place.assert_holds(&run);
        let (rows, sha256) = (place.rows(), place.kept(&run).placed.run_sha256);
        assert!(
            rows.iter().all(|path| path.contains(&sha256)),
            "{at}: {rows:?}"
        );
        assert_eq!(rows.len(), 3, "{at}");
    }
}

#[test]
fn something_else_than_a_store_is_not_written_into() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    let head = br#"{"format":"eis-bench store","version":2}"#;
    let at = ObjectPath::from("store.json");
    block_on(place.inner.put(&at, PutPayload::from(head.to_vec()))).unwrap();
    let error = place.push(&run).unwrap_err().to_string();
    assert!(
        error.contains("expected the format \"eis-bench store\" of version 1, found"),
        "{error}"
    );
    assert_eq!(place.held().len(), 1);
}

#[test]
fn another_store_gets_the_run_as_if_there_were_none() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let other = Place::new();
    let receipts = place.receipts();
    let store = bench_archive::Store::of(other.inner.clone(), "another".to_owned());
    let mut pusher = bench_archive::push::Pusher::of(&store, &receipts, "north");
    block_on(pusher.push(&run, &bench_archive::push::Now::default())).unwrap();
    assert!(held(&other.inner) == place.held());
    assert_eq!(place.receipt(&run).store, "another");
}
