//! The arrows between the crates (ARCHITECTURE.md): a new one turns this red.

use std::{collections::BTreeSet, path::Path};

fn manifest(krate: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(krate)
        .join("Cargo.toml");
    std::fs::read_to_string(path).unwrap().parse().unwrap()
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
    let crates = ["instruments", "analysis", "fixtures", "bench-daemon"];
    let found: BTreeSet<(String, String)> = crates
        .iter()
        .flat_map(|krate| {
            dependencies(
                krate,
                &["dependencies", "dev-dependencies", "build-dependencies"],
            )
            .into_iter()
            .filter(|dependency| crates.contains(&dependency.as_str()))
            .map(|dependency| ((*krate).to_owned(), dependency))
        })
        .collect();
    let expected = [
        ("bench-daemon", "analysis"),
        ("bench-daemon", "fixtures"),
        ("bench-daemon", "instruments"),
        ("fixtures", "instruments"),
    ];
    assert_eq!(
        found,
        expected
            .map(|(from, to)| (from.to_owned(), to.to_owned()))
            .into()
    );
}

#[test]
fn the_workspace_has_these_four_crates() {
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
        BTreeSet::from(["instruments", "analysis", "fixtures", "bench-daemon"])
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
