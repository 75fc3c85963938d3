//! Dependencies between crates that must not be (ARCHITECTURE.md).

use std::{collections::BTreeSet, path::Path};

fn manifest(krate: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(krate)
        .join("Cargo.toml");
    std::fs::read_to_string(path).unwrap().parse().unwrap()
}

/// Returns the folders of the crates.
fn folders() -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml");
    let manifest: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    let members = manifest["workspace"]["members"].as_array().unwrap();
    members
        .iter()
        .map(|member| member.as_str().unwrap().to_owned())
        .collect()
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
fn numbers_know_no_sockets_and_sockets_know_no_files_of_ours() {
    for folder in folders().iter().filter(|one| one.starts_with("analysis")) {
        for forbidden in ["tokio", "tokio-serial", "toml", "clap", "scpi"] {
            assert!(
                !dependencies(folder, &["dependencies"]).contains(forbidden),
                "{folder} depends on {forbidden}"
            );
        }
    }
    for folder in folders()
        .iter()
        .filter(|one| one.starts_with("instruments"))
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
        for folder in ["bench-daemon/plan", "bench-daemon/core"] {
            assert!(
                !dependencies(folder, &["dependencies"]).contains(forbidden),
                "{folder} depends on {forbidden}"
            );
        }
    }
}

/// Runs and their results are the same with and without a server.
#[test]
fn the_results_of_a_run_know_no_server() {
    for forbidden in ["axum", "hyper", "lettre", "bench-serve"] {
        assert!(
            !dependencies("bench-daemon/evaluate", &["dependencies"]).contains(forbidden),
            "bench-evaluate depends on {forbidden}"
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
        let users: Vec<String> = folders()
            .into_iter()
            .filter(|folder| dependencies(folder, &["dependencies"]).contains(library))
            .collect();
        assert_eq!(users, [user], "{library}");
    }
}
