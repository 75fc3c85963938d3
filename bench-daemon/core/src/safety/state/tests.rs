use instruments::units::Seconds;

use super::*;
use bench_plan::interlock::Trip;

fn state(folder: &Path) -> State {
    State {
        folder: folder.to_owned(),
        bench: "b".to_owned(),
        file: "b.toml".into(),
        places: vec![folder.to_owned()],
        outputs: Vec::new(),
        mocked: true,
        unswitched: false,
    }
}

/// Returns benches that each have their own folder, and whose instruments have folders of these
/// names.
fn sharing(root: &Path, benches: [(&str, &[&'static str]); 3]) -> [State; 3] {
    benches.map(|(name, instruments)| {
        let folder = root.join(name);
        let mut places: Vec<PathBuf> = instruments
            .iter()
            .map(|instrument| root.join(instrument))
            .chain([folder.clone()])
            .collect();
        places.sort_unstable();
        places
            .iter()
            .for_each(|place| fs::create_dir_all(place).unwrap());
        State {
            folder,
            bench: name.to_owned(),
            file: root.join(name).with_extension("toml"),
            outputs: instruments
                .iter()
                .map(|instrument| OutputPlace::at(instrument, root.join(instrument)))
                .collect(),
            places,
            mocked: true,
            unswitched: false,
        }
    })
}

#[test]
fn benches_that_share_an_instrument_exclude_each_other_and_see_each_others_latch() {
    let root = tempfile::tempdir().unwrap();
    let [one, two, apart] = sharing(
        root.path(),
        [
            ("one", &["scope", "load"]),
            ("two", &["load", "supply"]),
            ("apart", &["other"]),
        ],
    );
    let lock = one.lock(Path::new("runs/a")).unwrap();
    let words = format!(
        "process {} runs one ({}), which shares an instrument with two, for runs/a",
        pid(),
        one.file.display()
    );
    for refused in [
        two.lock(Path::new("runs/b")).unwrap_err(),
        two.refuse_busy().unwrap_err(),
    ] {
        assert_eq!(
            refused.to_string(),
            format!("expected a bench that is not in use: {words}")
        );
    }
    apart.lock(Path::new("runs/c")).unwrap();
    drop(lock);
    // A lock that is refused half-way releases what it already held.
    one.lock(Path::new("runs/a")).unwrap();
    let guardian = two.lock_guardian().unwrap();
    assert!(
        guardian.is_some()
            && one.lock_guardian().unwrap().is_none()
            && apart.lock_guardian().unwrap().is_some()
    );

    let cause = Latched::new("daemon", "too warm");
    one.latch(&cause).unwrap();
    let refused = two.refuse_latched().unwrap_err().to_string();
    let words = format!(
        "two, for it shares an instrument with {}, which is latched: too warm. Look at ",
        one.file.display()
    );
    assert!(refused.starts_with(&words), "{refused}");
    apart.refuse_latched().unwrap();
    // Clearing the latch through either bench clears it for both.
    two.clear(&cause, None, None).unwrap();
    one.refuse_latched().unwrap();
    two.refuse_latched().unwrap();
}

#[test]
fn a_run_stays_open_for_all_that_share_an_instrument_until_it_is_settled() {
    let root = tempfile::tempdir().unwrap();
    let [one, two, apart] = sharing(
        root.path(),
        [
            ("one", &["scope", "load"]),
            ("two", &["load", "supply"]),
            ("apart", &["other"]),
        ],
    );
    one.begin(Path::new("runs/a")).unwrap();
    let open = two.open_run().unwrap().unwrap();
    assert_eq!(
        (
            open.holder.run.as_path(),
            open.holder.file.as_path(),
            open.holder.lives()
        ),
        (Path::new("runs/a"), one.file.as_path(), true)
    );
    assert!(apart.open_run().unwrap().is_none());
    two.latch_with(&Latched::new("daemon", "left on"), &open)
        .unwrap();
    two.settle(&open).unwrap();
    assert!(one.open_run().unwrap().is_none() && two.open_run().unwrap().is_none());
    assert!(
        one.refuse_latched()
            .unwrap_err()
            .to_string()
            .contains("left on")
    );
    fs::write(one.places[0].join(OPEN), "{").unwrap();
    assert!(
        !one.open_run().unwrap().unwrap().holder.lives(),
        "what cannot be understood is an open run too"
    );
}

#[test]
fn a_torn_last_line_of_the_history_stays_a_line_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    let line = serde_json::json!({ "what": "latched" });
    state.remember(&line).unwrap();
    fs::write(
        state.path(HISTORY),
        fs::read_to_string(state.path(HISTORY)).unwrap() + "{\"what\":\"cle",
    )
    .unwrap();
    state.remember(&line).unwrap();
    let text = fs::read_to_string(state.path(HISTORY)).unwrap();
    assert_eq!(
        text.lines().collect::<Vec<_>>(),
        [
            "{\"what\":\"latched\"}",
            "{\"what\":\"cle",
            "{\"what\":\"latched\"}"
        ]
    );
}

#[test]
fn one_process_runs_a_bench_and_the_next_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    assert_eq!(state.holder().unwrap(), None);
    let lock = state.lock(Path::new("runs/a")).unwrap();
    let holder = state.holder().unwrap().unwrap();
    assert_eq!(
        (holder.pid, holder.run.as_path(), holder.lives()),
        (pid(), Path::new("runs/a"), true)
    );
    let refused = state.lock(Path::new("runs/b")).unwrap_err().to_string();
    assert_eq!(
        refused,
        format!(
            "expected a bench that is not in use: process {} runs b for runs/a",
            pid()
        )
    );
    drop(lock);
    state.lock(Path::new("runs/b")).unwrap();
}

#[test]
fn the_first_cause_stays_until_a_person_clears_it_and_all_are_remembered() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    let trip = Trip::Limit {
        what: "cell voltage",
        value: 4.3,
        unit: "V",
        least: 2.5,
        greatest: 4.2,
        time_s: Seconds(12.0),
    };
    let first = Latched::of_trip("daemon", &trip).during(Path::new("runs/a"), "charge");
    state.latch(&first).unwrap();
    state.latch(&Latched::new("guardian", "later")).unwrap();
    assert_eq!(state.latched().unwrap().as_ref(), Some(&first));
    let refused = state.refuse_latched().unwrap_err().to_string();
    let words = "b is latched: interlock: cell voltage 4.3000 V left its limits (2.5 V to 4.2 V) \
    at 12.0 s in step \"charge\" of runs/a. \
                 Look at the bench and the cell, then `eis-bench clear b.toml`";
    assert_eq!(refused, words);
    state.clear(&first, None, None).unwrap();
    state.refuse_latched().unwrap();
    let history = fs::read_to_string(state.path(HISTORY)).unwrap();
    let whats: Vec<_> = history
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["what"].clone())
        .collect();
    assert_eq!(whats, ["latched", "latched", "cleared"]);
    assert!(
        history.contains(&format!("\"who\":\"{}\"", account::who())),
        "{history}"
    );
}

#[test]
fn a_history_that_cannot_be_written_loses_no_latch() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    fs::create_dir(state.path(HISTORY)).unwrap();
    let cause = Latched::new("daemon", "too warm");
    assert!(state.latch(&cause).is_err());
    assert_eq!(state.latched().unwrap(), Some(cause));
}

#[test]
fn a_latch_that_cannot_be_understood_is_a_latch() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    fs::write(state.path(TRIP), "{\"cause\":").unwrap();
    assert!(
        state
            .refuse_latched()
            .unwrap_err()
            .to_string()
            .contains("cannot be understood")
    );
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let state = state(Path::new("/proc/no-such-folder"));
    let message = state.lock(Path::new("r")).unwrap_err().to_string();
    assert!(
        message
            .starts_with("/proc/no-such-folder/lock: the state of the bench cannot be written: "),
        "{message}"
    );
}

#[test]
fn what_was_read_of_a_shared_instrument_is_known_to_both_benches_until_a_run_begins() {
    use crate::bench::outputs::{OutputReading, OutputState, OutputsKind};
    let root = tempfile::tempdir().unwrap();
    let [one, two, apart] = sharing(
        root.path(),
        [
            ("one", &["load", "supply"]),
            ("two", &["load"]),
            ("apart", &["generator"]),
        ],
    );
    let read = |role: &str, state, unix_s| OutputReading {
        role: role.to_owned(),
        model: "m".to_owned(),
        state,
        volts: None,
        amps: None,
        unix_s,
        by: "read".to_owned(),
    };
    let now_s = clock::unix_time_s();
    assert_eq!(one.outputs().words, "outputs not read");
    one.keep_readings(&[
        read("load", OutputState::Off, now_s - 2.0),
        read("supply", OutputState::Off, now_s - 2.0),
    ])
    .unwrap();
    let states = || [&one, &two, &apart].map(|bench| bench.outputs().state);
    assert_eq!(
        states(),
        [OutputsKind::Off, OutputsKind::Off, OutputsKind::NotRead]
    );
    // The output was found on through the other bench.
    two.keep_readings(&[read("load", OutputState::On, now_s)])
        .unwrap();
    assert_eq!(
        states(),
        [OutputsKind::On, OutputsKind::On, OutputsKind::NotRead]
    );
    let open = two.begin(Path::new("runs/a")).unwrap();
    assert_eq!(states(), [OutputsKind::NotRead; 3]);
    assert!(
        two.outputs()
            .words
            .starts_with("outputs not read since a run began at "),
        "{}",
        two.outputs().words
    );
    drop(open);
    two.settled().unwrap();
}

#[test]
fn a_run_whose_record_cannot_be_removed_is_over_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    let mut open = state.begin(Path::new("runs/a")).unwrap();
    assert!(state.open_run().unwrap().is_some());
    // The run writes its end into its open file before it removes the file.
    let (path, saved) = (state.path(OPEN), state.path("saved"));
    fs::hard_link(&path, &saved).unwrap();
    state.settled_by(&mut open).unwrap();
    assert!(!path.exists());
    fs::rename(&saved, &path).unwrap();
    assert_eq!(state.open_run().unwrap(), None);
    // An incomplete line counts as no line.
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, &text[..text.len() - 4]).unwrap();
    assert!(state.open_run().unwrap().is_some());
}

#[test]
fn who_only_reads_makes_way_for_runs_and_is_refused_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let state = state(folder.path());
    let reader = state.lock_reader().unwrap();
    let words = |refused: Result<Lock, StateError>| refused.unwrap_err().to_string();
    assert_eq!(
        words(state.lock_reader()),
        "expected a bench that can be asked, found another reading of its outputs, or a switching \
        off at work on b"
    );
    drop(reader);
    let run = state.lock(Path::new("runs/a")).unwrap();
    assert!(words(state.lock_reader()).contains("runs b for runs/a"));
    drop(run);
    let guardian = state.lock_guardian().unwrap();
    assert!(words(state.lock_reader()).contains("the guardian of a run"));
    drop(guardian);
    let off = (state.end_reader(), state.end_reader());
    assert!(words(state.lock_reader()).contains("switching off"));
    drop(off);
    state.lock_reader().unwrap();
}
