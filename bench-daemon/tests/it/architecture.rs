//! The dependencies between the crates (ARCHITECTURE.md): a new one fails this test.

use std::{collections::BTreeSet, path::Path};

fn manifest(krate: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(krate)
        .join("Cargo.toml");
    std::fs::read_to_string(path).unwrap().parse().unwrap()
}

/// Folders of the crates, each after those that it may depend on.
const FOLDERS: [&str; 24] = [
    "analysis/numeric",
    "analysis/plot",
    "analysis/signal",
    "analysis/model",
    "analysis/effects",
    "analysis/fit",
    "analysis/forward",
    "analysis/files",
    "analysis/diagnosis",
    "analysis/catalog",
    "analysis",
    "instruments/domain",
    "instruments/scpi",
    "instruments/link",
    "instruments/drivers",
    "instruments/mock",
    "instruments",
    "fixtures",
    "fixtures/study",
    "bench-daemon/core",
    "bench-daemon/archive",
    "bench-daemon/fleet",
    "bench-daemon",
    "python",
];

/// Returns the name of the crate in a folder.
fn name(folder: &str) -> String {
    if folder == "python" {
        return "eisbench-python".to_owned();
    }
    match folder.strip_prefix("bench-daemon/") {
        Some(part) => format!("bench-{part}"),
        None => folder
            .strip_prefix("fixtures/")
            .unwrap_or(folder)
            .replace('/', "-"),
    }
}

fn dependencies(krate: &str, tables: &[&str]) -> BTreeSet<String> {
    let manifest = manifest(krate);
    tables
        .iter()
        .filter_map(|table| manifest.get(*table)?.as_table())
        .flat_map(|table| table.keys().cloned())
        .collect()
}

#[test]
fn the_arrows_between_the_crates_are_these_and_no_others() {
    let folders = FOLDERS;
    let names = folders.map(name);
    let found: BTreeSet<(String, String)> = folders
        .iter()
        .flat_map(|folder| {
            dependencies(
                folder,
                &["dependencies", "dev-dependencies", "build-dependencies"],
            )
            .into_iter()
            .filter(|dependency| names.contains(dependency))
            .map(|dependency| (name(folder), dependency))
        })
        .collect();
    let expected = [
        ("analysis-plot", "analysis-numeric"),
        ("analysis-signal", "analysis-numeric"),
        ("analysis-signal", "analysis-plot"),
        ("analysis-model", "analysis-numeric"),
        ("analysis-model", "analysis-signal"),
        ("analysis-effects", "analysis-model"),
        ("analysis-fit", "analysis-effects"),
        ("analysis-fit", "analysis-model"),
        ("analysis-fit", "analysis-numeric"),
        ("analysis-fit", "analysis-plot"),
        ("analysis-fit", "analysis-signal"),
        ("analysis-forward", "analysis-effects"),
        ("analysis-forward", "analysis-model"),
        ("analysis-forward", "analysis-numeric"),
        ("analysis-files", "analysis-effects"),
        ("analysis-files", "analysis-fit"),
        ("analysis-files", "analysis-forward"),
        ("analysis-files", "analysis-model"),
        ("analysis-files", "analysis-numeric"),
        ("analysis-files", "analysis-signal"),
        ("analysis-diagnosis", "analysis-effects"),
        ("analysis-diagnosis", "analysis-fit"),
        ("analysis-diagnosis", "analysis-model"),
        ("analysis-diagnosis", "analysis-numeric"),
        ("analysis-diagnosis", "analysis-plot"),
        ("analysis-diagnosis", "analysis-signal"),
        ("analysis-catalog", "analysis-files"),
        ("analysis-catalog", "analysis-fit"),
        ("analysis-catalog", "analysis-plot"),
        ("analysis-catalog", "analysis-signal"),
        // Tests of fits read files of other programs and simulate.
        ("analysis-fit", "analysis-files"),
        ("analysis-fit", "analysis-forward"),
        ("analysis", "analysis-catalog"),
        ("analysis", "analysis-diagnosis"),
        ("analysis", "analysis-effects"),
        ("analysis", "analysis-files"),
        ("analysis", "analysis-fit"),
        ("analysis", "analysis-forward"),
        ("analysis", "analysis-model"),
        ("analysis", "analysis-numeric"),
        ("analysis", "analysis-plot"),
        ("analysis", "analysis-signal"),
        ("bench-archive", "analysis-catalog"),
        ("bench-archive", "analysis-files"),
        // Only its clock.
        ("bench-archive", "instruments-link"),
        ("bench-core", "analysis-effects"),
        ("bench-core", "analysis-files"),
        ("bench-core", "analysis-fit"),
        ("bench-core", "analysis-forward"),
        ("bench-core", "analysis-model"),
        ("bench-core", "analysis-numeric"),
        ("bench-core", "analysis-signal"),
        ("bench-core", "fixtures"),
        ("bench-core", "instruments"),
        ("bench-daemon", "analysis"),
        ("bench-daemon", "bench-core"),
        ("bench-daemon", "fixtures"),
        ("bench-daemon", "instruments"),
        // Its tests use data sets from there.
        ("bench-daemon", "study"),
        ("eisbench-python", "analysis"),
        // Only its clock. It speaks the HTTP API of the daemon, which knows nothing of it.
        ("bench-fleet", "instruments-link"),
        // Only in its tests.
        ("fixtures", "instruments"),
        ("fixtures", "instruments-domain"),
        ("fixtures", "instruments-mock"),
        ("instruments", "instruments-domain"),
        ("instruments", "instruments-drivers"),
        ("instruments", "instruments-link"),
        ("instruments", "instruments-mock"),
        ("instruments", "instruments-scpi"),
        ("instruments-drivers", "instruments-domain"),
        ("instruments-drivers", "instruments-link"),
        ("instruments-drivers", "instruments-scpi"),
        ("instruments-link", "instruments-scpi"),
        ("instruments-mock", "instruments-domain"),
        ("instruments-mock", "instruments-link"),
        ("instruments-mock", "instruments-scpi"),
        ("study", "analysis"),
        ("study", "fixtures"),
    ];
    assert_eq!(
        found,
        expected
            .map(|(from, to)| (from.to_owned(), to.to_owned()))
            .into()
    );
}

#[test]
fn the_workspace_has_these_crates() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml");
    let manifest: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    let members: BTreeSet<&str> = manifest["workspace"]["members"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(toml::Value::as_str)
        .collect();
    assert_eq!(members, BTreeSet::from(FOLDERS));
}

#[test]
fn numbers_know_no_sockets_and_sockets_know_no_files_of_ours() {
    for folder in FOLDERS
        .iter()
        .filter(|folder| folder.starts_with("analysis"))
    {
        for forbidden in ["tokio", "tokio-serial", "toml", "clap", "scpi"] {
            assert!(
                !dependencies(folder, &["dependencies"]).contains(forbidden),
                "{folder} depends on {forbidden}"
            );
        }
    }
    for folder in FOLDERS
        .iter()
        .filter(|folder| folder.starts_with("instruments"))
    {
        for forbidden in ["polars", "plotters", "toml", "clap", "rustfft"] {
            assert!(
                !dependencies(folder, &["dependencies"]).contains(forbidden),
                "{folder} depends on {forbidden}"
            );
        }
    }
    for forbidden in ["polars", "plotters", "tokio", "rustfft"] {
        assert!(
            !dependencies("fixtures", &["dependencies"]).contains(forbidden),
            "fixtures depends on {forbidden}"
        );
    }
}

/// What moves current draws nothing, serves nothing, and asks no diagnosis and no catalogue.
#[test]
fn what_moves_current_knows_no_server_and_no_diagnosis() {
    for forbidden in [
        "analysis",
        "analysis-catalog",
        "analysis-diagnosis",
        "analysis-plot",
        "axum",
        "hyper",
        "lettre",
        "ureq",
    ] {
        assert!(
            !dependencies("bench-daemon/core", &["dependencies"]).contains(forbidden),
            "bench-core depends on {forbidden}"
        );
    }
}

/// A mock that used the drivers would share their mistakes.
#[test]
fn mocks_and_drivers_do_not_know_each_other() {
    let all = ["dependencies", "dev-dependencies"];
    assert!(!dependencies("instruments/mock", &all).contains("instruments-drivers"));
    assert!(!dependencies("instruments/drivers", &all).contains("instruments-mock"));
}

/// The codec and the commands of the instruments need no runtime.
#[test]
fn messages_are_read_and_written_without_io() {
    for folder in ["instruments/domain", "instruments/scpi"] {
        for forbidden in ["tokio", "tokio-serial", "nix"] {
            assert!(
                !dependencies(folder, &["dependencies"]).contains(forbidden),
                "{folder} depends on {forbidden}"
            );
        }
    }
}

/// The labels and names of hidden cases are not part of the shipped program.
#[test]
fn the_program_does_not_know_the_blind_study() {
    assert!(!dependencies("bench-daemon", &["dependencies"]).contains("study"));
    assert!(!dependencies("fixtures", &["dependencies"]).contains("study"));
}

/// The truth of the study and the model share no code: `hidden` uses nothing of the analysis.
#[test]
fn hidden_cases_name_nothing_of_the_analysis() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/study/src/hidden");
    let (mut folders, mut read) = (vec![folder], 0);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(!text.contains("analysis::"), "{}", path.display());
            read += 1;
        }
    }
    assert!(read > 10, "{read} files");
}

/// Libraries that only one crate may use: table files by polars, pictures by plotters, catalogues
/// by rusqlite, object stores by object_store, serial ports by tokio-serial, the device side of
/// SCPI by scpi, fleets by async-nats.
#[test]
fn some_libraries_have_one_user_each() {
    for (library, user) in [
        ("polars", "analysis/files"),
        ("plotters", "analysis/plot"),
        ("rusqlite", "analysis/catalog"),
        ("object_store", "bench-daemon/archive"),
        ("tokio-serial", "instruments/link"),
        ("scpi", "instruments/mock"),
        ("async-nats", "bench-daemon/fleet"),
    ] {
        let users: Vec<&str> = FOLDERS
            .into_iter()
            .filter(|folder| dependencies(folder, &["dependencies"]).contains(library))
            .collect();
        assert_eq!(users, [user], "{library}");
    }
}
