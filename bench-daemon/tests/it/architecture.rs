//! The arrows between the crates (ARCHITECTURE.md): a new one turns this red.

use std::{collections::BTreeSet, path::Path};

fn manifest(krate: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(krate)
        .join("Cargo.toml");
    std::fs::read_to_string(path).unwrap().parse().unwrap()
}

/// Name of the crate in a folder.
fn name(folder: &str) -> &str {
    folder.rsplit('/').next().unwrap_or(folder)
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
    let folders = [
        "instruments",
        "analysis",
        "fixtures",
        "fixtures/study",
        "bench-daemon",
    ];
    let names = folders.map(name);
    let found: BTreeSet<(String, String)> = folders
        .iter()
        .flat_map(|folder| {
            dependencies(
                folder,
                &["dependencies", "dev-dependencies", "build-dependencies"],
            )
            .into_iter()
            .filter(|dependency| names.contains(&dependency.as_str()))
            .map(|dependency| (name(folder).to_owned(), dependency))
        })
        .collect();
    let expected = [
        ("bench-daemon", "analysis"),
        ("bench-daemon", "fixtures"),
        ("bench-daemon", "instruments"),
        // Its tests take data sets from there.
        ("bench-daemon", "study"),
        ("fixtures", "instruments"),
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
    assert_eq!(
        members,
        BTreeSet::from([
            "instruments",
            "analysis",
            "fixtures",
            "fixtures/study",
            "bench-daemon"
        ])
    );
}

#[test]
fn numbers_know_no_sockets_and_sockets_know_no_files_of_ours() {
    for forbidden in ["tokio", "tokio-serial", "toml", "clap", "scpi"] {
        assert!(
            !dependencies("analysis", &["dependencies"]).contains(forbidden),
            "analysis depends on {forbidden}"
        );
    }
    for forbidden in ["polars", "plotters", "toml", "clap", "rustfft"] {
        assert!(
            !dependencies("instruments", &["dependencies"]).contains(forbidden),
            "instruments depends on {forbidden}"
        );
    }
    for forbidden in ["polars", "plotters", "tokio", "rustfft"] {
        assert!(
            !dependencies("fixtures", &["dependencies"]).contains(forbidden),
            "fixtures depends on {forbidden}"
        );
    }
}

/// The labels and names of hidden cases are no part of the shipped program.
#[test]
fn the_program_does_not_know_the_blind_study() {
    assert!(!dependencies("bench-daemon", &["dependencies"]).contains("study"));
    assert!(!dependencies("fixtures", &["dependencies"]).contains("study"));
}

/// The truth of the study and the model share no code: `hidden` names nothing of the analysis.
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
