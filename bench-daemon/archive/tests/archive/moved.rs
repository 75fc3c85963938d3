//! Captures that are moved away and brought back.

use std::fs;

use analysis_files::run_folder::{ARCHIVED, Archived};
use bench_archive::{
    ArchiveError,
    fetch::{fetch_moved, fetch_run},
    push::Outcome,
    snapshot::RunSource,
    thin::{ThinPolicy, Thinned, thin},
    verify::Verifier,
};
use object_store::{ObjectStoreExt, PutPayload, path::Path};

use crate::made::{Made, Place, block_on, sha256};

const DAY_S: f64 = 86_400.0;
const CAPTURE: &str = "captures/cell/point01_1.000000Hz.parquet";

fn thin_at(place: &Place, run: &RunSource, unix_s: f64) -> Result<Thinned, ArchiveError> {
    let policy = ThinPolicy {
        captures_after_s: 30.0 * DAY_S,
        unix_s,
        dry: false,
    };
    block_on(thin(&place.store, &place.receipts(), run, &policy))
}

const DUE_S: f64 = 31.0 * DAY_S;

#[test]
fn captures_are_moved_after_their_time_and_come_back_as_they_were() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    let before = run.snapshot(true).unwrap();
    assert_eq!(
        thin_at(&place, &run, DUE_S).unwrap().files,
        0,
        "not archived"
    );
    place.push(&run).unwrap();
    assert_eq!(
        thin_at(&place, &run, 29.0 * DAY_S).unwrap().files,
        0,
        "not due"
    );
    let bytes = 16 + 100;
    assert_eq!(
        thin_at(&place, &run, DUE_S).unwrap(),
        Thinned { files: 2, bytes }
    );
    assert!(!run.folder.join(CAPTURE).exists());
    let list = Archived::read(&run.folder).unwrap().unwrap();
    assert_eq!(list.files[0].sha256, sha256(b"codes of a point"));
    assert_eq!(
        (list.store.as_str(), list.files[0].moved_unix_s),
        ("memory", DUE_S)
    );
    // It is the same run, and nothing is sent.
    assert_eq!(run.snapshot(true).unwrap(), before);
    assert!(matches!(place.push(&run).unwrap(), Outcome::Unchanged(_)));
    let kept = place.kept(&run);
    assert_eq!((kept.moved_files, kept.moved_bytes), (2, bytes));
    assert_eq!(thin_at(&place, &run, DUE_S).unwrap().files, 0);
    let fetched = block_on(fetch_moved(&place.store, &place.receipts(), &run)).unwrap();
    assert_eq!((fetched.files, fetched.bytes), (2, bytes));
    assert_eq!(
        fs::read(run.folder.join(CAPTURE)).unwrap(),
        b"codes of a point"
    );
    assert!(!run.folder.join(ARCHIVED).exists());
    assert_eq!(run.snapshot(true).unwrap(), before);
    assert!(matches!(place.push(&run).unwrap(), Outcome::Unchanged(_)));
}

#[test]
fn no_capture_is_removed_that_the_store_does_not_give_back() {
    let object = |place: &Place| {
        let hash = sha256(b"codes of a point");
        let path = format!("objects/sha256/{}/{hash}", &hash[..2]);
        assert!(place.held().contains_key(&path));
        Path::parse(path).unwrap()
    };
    let damages: [&dyn Fn(&Place); 4] = [
        &|place| block_on(place.inner.delete(&object(place))).unwrap(),
        &|place| {
            let wrong = PutPayload::from(b"codes of a paint".to_vec());
            block_on(place.inner.put(&object(place), wrong))
                .map(drop)
                .unwrap();
        },
        &|place| place.faults.give_wrong(object(place).as_ref()),
        &|place| {
            let list = place
                .held()
                .into_keys()
                .find(|path| path.starts_with("runs/"))
                .unwrap();
            block_on(place.inner.delete(&Path::parse(list).unwrap())).unwrap();
        },
    ];
    for damage in damages {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        place.push(&run).unwrap();
        damage(&place);
        thin_at(&place, &run, DUE_S).unwrap_err();
        assert!(run.folder.join(CAPTURE).exists());
        assert!(!run.folder.join(ARCHIVED).exists());
    }
}

#[test]
fn thinning_that_ends_at_any_operation_loses_nothing() {
    for dead_from in 0..12 {
        let place = Place::new();
        let run = Made::ONE.write(&place);
        let before = run.snapshot(true).unwrap();
        place.push(&run).unwrap();
        place.faults.die_after(dead_from);
        let _ = thin_at(&place, &run, DUE_S);
        assert_eq!(run.snapshot(true).unwrap(), before, "{dead_from}");
        place.faults.mend();
        thin_at(&place, &run, DUE_S).unwrap();
        assert!(!run.folder.join(CAPTURE).exists());
    }
}

#[test]
fn a_folder_that_is_not_what_was_archived_keeps_its_captures() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    fs::create_dir(run.folder.join("diagnosis")).unwrap();
    fs::write(run.folder.join("diagnosis/diagnosis.json"), "{}").unwrap();
    assert_eq!(thin_at(&place, &run, DUE_S).unwrap().files, 0);
    let failed = Made {
        name: "failed",
        how: Some("aborted"),
        ..Made::ONE
    }
    .write(&place);
    place.push(&failed).unwrap();
    // It may be gone on with, which needs its captures.
    assert_eq!(thin_at(&place, &failed, DUE_S).unwrap().files, 0);
}

#[test]
fn wrong_bytes_do_not_come_into_the_run_folder() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    thin_at(&place, &run, DUE_S).unwrap();
    place.faults.give_wrong("objects/");
    let fetched = block_on(fetch_moved(&place.store, &place.receipts(), &run));
    assert!(
        matches!(fetched, Err(ArchiveError::Bytes { .. })),
        "{fetched:?}"
    );
    assert!(!run.folder.join(CAPTURE).exists());
    assert!(run.folder.join(ARCHIVED).exists());
    place.faults.mend();
    block_on(fetch_moved(&place.store, &place.receipts(), &run)).unwrap();
    assert!(run.folder.join(CAPTURE).exists());
}

#[test]
fn a_whole_run_comes_into_a_new_folder() {
    let place = Place::new();
    let run = Made::LARGE.write(&place);
    place.push(&run).unwrap();
    let out = place.runs().join("again");
    let sha256 = place.kept(&run).placed.run_sha256;
    block_on(fetch_run(&place.store, &sha256, &out)).unwrap();
    assert_eq!(
        RunSource::of(&out).snapshot(true).unwrap(),
        run.snapshot(true).unwrap()
    );
    let error = block_on(fetch_run(&place.store, &sha256, &out)).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("expected a new folder, found files in"),
        "{error}"
    );
}

#[test]
fn a_verification_names_what_is_not_as_it_was_sent() {
    let place = Place::new();
    let run = Made::ONE.write(&place);
    place.push(&run).unwrap();
    let kept = place.kept(&run);
    let verify = || block_on(Verifier::of(&place.store).kept(&kept)).unwrap();
    assert_eq!((verify().files, verify().wrong), (8, Vec::new()));
    for path in [
        kept.tables[0].path.clone(),
        format!("runs/{}.json", kept.placed.run_sha256),
    ] {
        let at = Path::parse(&path).unwrap();
        let bytes = PutPayload::from(place.held()[&path].clone());
        block_on(place.inner.put(&at, PutPayload::from(b"{}".to_vec()))).unwrap();
        let wrong = verify().wrong;
        assert!(wrong.len() == 1 && wrong[0].contains(&path), "{wrong:?}");
        block_on(place.inner.put(&at, bytes)).unwrap();
    }
    assert_eq!(
        block_on(place.store.runs()).unwrap(),
        [kept.placed.run_sha256]
    );
}
