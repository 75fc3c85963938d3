//! `eis-bench fit --table` and `kk --table`: many spectra in, one table out.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
    process::Stdio,
};

use serde_json::Value;

use crate::support::{Ended, command, program};

/// Writes spectra of a resistance and one RC branch whose time constant grows with the number.
fn long_form(file: &Path, spectra: usize) {
    write_spectra(file, spectra, 1);
}

/// Writes spectra over five decades.
fn write_spectra(file: &Path, spectra: usize, per_decade: i32) {
    let mut text = "spectrum_id,freq_hz,z_re_ohm,z_im_ohm,operator\n".to_owned();
    for nth in 0..spectra {
        let tau_s = 1.0e-3 * (1.0 + nth as f64 / spectra as f64);
        for k in 0..=5 * per_decade {
            let freq_hz = 10.0_f64.powf(f64::from(k) / f64::from(per_decade) - 1.0);
            let x = std::f64::consts::TAU * freq_hz * tau_s;
            let (re, im) = (0.01 + 0.02 / (1.0 + x * x), -0.02 * x / (1.0 + x * x));
            writeln!(text, "cell {nth},{freq_hz},{re},{im},nobody").unwrap();
        }
    }
    std::fs::write(file, text).unwrap();
}

/// Returns the rows of a CSV as lists of fields; only texts in the last columns contain commas.
fn rows(file: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let text = std::fs::read_to_string(file).unwrap();
    let fields = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
    let mut lines = text.lines();
    (fields(lines.next().unwrap()), lines.map(fields).collect())
}

fn value<'a>(table: &'a (Vec<String>, Vec<Vec<String>>), row: usize, column: &str) -> &'a str {
    let place = table.0.iter().position(|name| name == column).unwrap();
    &table.1[row][place]
}

fn number(table: &(Vec<String>, Vec<Vec<String>>), row: usize, column: &str) -> f64 {
    value(table, row, column).parse().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_path_buf();
    (folder, path)
}

#[test]
fn a_row_holds_what_a_single_fit_prints() {
    let (_kept, at) = folder();
    let spectra = "../fixtures/data/spectra/p45b_thesis.csv";
    let table = at.join("fits.csv");
    program(&["fit", spectra, "--rc", "2", "--table", text(&table)]).ok();
    let printed: Value = program(&["fit", spectra, "--rc", "2", "--json"]).json();
    let (table, fits) = (rows(&table), printed["fits"].as_array().unwrap());
    assert!(fits.len() > 20);
    let of_cells: Vec<usize> = (0..table.1.len())
        .filter(|row| !value(&table, *row, "r_ohm").is_empty())
        .collect();
    assert_eq!(of_cells.len(), fits.len());
    for (row, fit) in of_cells.into_iter().zip(fits) {
        assert_eq!(value(&table, row, "spectrum_id"), fit["spectra"][0]);
        for (column, expected) in [
            ("r_ohm", &fit["r_ohm"]),
            ("r_sigma_ohm", &fit["sigma"]["r_ohm"]),
            ("c2_f", &fit["branches"][1]["c_f"]),
            ("objective", &fit["objective"]),
        ] {
            assert_eq!(number(&table, row, column), expected.as_f64().unwrap());
        }
    }
}

#[test]
fn circuits_and_tests_of_validity_make_tables_too() {
    let (_kept, at) = folder();
    let (spectra, fits) = (at.join("in.csv"), at.join("fits.csv"));
    long_form(&spectra, 3);
    let of = ["--circuit", "R0-p(R1,C1)", "--table"];
    program(&["fit", text(&spectra), of[0], of[1], of[2], text(&fits)]).ok();
    let table = rows(&fits);
    for row in 0..3 {
        assert!((number(&table, row, "R1") - 0.02).abs() < 1e-8);
        let tau_s = number(&table, row, "R1") * number(&table, row, "C1");
        assert!((tau_s / (1.0e-3 * (1.0 + row as f64 / 3.0)) - 1.0).abs() < 1e-6);
    }
    // One point per decade does not show what is noise; three do.
    for (per_decade, grade) in [(1, "cannot-be-judged"), (3, "good")] {
        write_spectra(&spectra, 3, per_decade);
        let judged = at.join(format!("{grade}.csv"));
        let judge = ["--drt", "--table", text(&judged)];
        program(&["kk", text(&spectra), judge[0], judge[1], judge[2]]).ok();
        let table = rows(&judged);
        assert_eq!(value(&table, 1, "grade"), grade);
        assert!(number(&table, 1, "drt_polarisation_ohm") > 0.0);
    }
}

#[test]
fn a_row_that_cannot_be_used_costs_its_spectrum_alone() {
    let (_kept, at) = folder();
    let (spectra, table) = (at.join("in.csv"), at.join("out.csv"));
    long_form(&spectra, 3);
    let good = std::fs::read_to_string(&spectra).unwrap();
    let bad = good.replacen("cell 1,1,", "cell 1,one,", 1);
    std::fs::write(&spectra, bad).unwrap();
    program(&["fit", text(&spectra), "--rc", "1", "--table", text(&table)]).ok();
    let table = std::fs::read_to_string(&table).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert!(
        lines[2].contains("line 9: column freq_hz: expected a number, met \"\"one\"\""),
        "{}",
        lines[2]
    );
    assert!(lines[1].ends_with(','), "{}", lines[1]);
    assert!(lines[3].ends_with(','), "{}", lines[3]);
}

#[test]
fn a_folder_may_hold_files_that_are_no_spectra() {
    let (_kept, at) = folder();
    let (input, table) = (at.join("in"), at.join("out.csv"));
    std::fs::create_dir(&input).unwrap();
    long_form(&input.join("a.csv"), 2);
    std::fs::write(input.join("b.txt"), "no spectrum at all\n").unwrap();
    let summary = program(&["fit", text(&input), "--rc", "1", "--table", text(&table)]).ok();
    assert!(
        summary.starts_with("3 spectra; 1 without a result"),
        "{summary}"
    );
    let met = std::fs::read_to_string(&table).unwrap();
    assert!(met.contains("\nb.txt,"), "{met}");
}

#[test]
fn a_killed_call_goes_on_and_ends_as_if_it_had_not_been() {
    let (_kept, at) = folder();
    let spectra = at.join("in.csv");
    long_form(&spectra, 2600);
    let (whole, killed) = (at.join("whole.csv"), at.join("killed.csv"));
    let call = |table: &Path| {
        let mut command = command(&["fit", text(&spectra), "--rc", "1", "--table", text(table)]);
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    assert!(call(&whole).status().unwrap().success());
    let mut child = call(&killed).spawn().unwrap();
    let part = at.join("killed.csv.parts/000000.parquet");
    while !part.exists() {
        assert!(
            child.try_wait().unwrap().is_none(),
            "it ended before a part was seen"
        );
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!killed.exists());
    let output = Ended::of(call(&killed).output().unwrap());
    let message = output.stderr;
    assert!(
        message.contains("were worked on by a call before this one"),
        "{message}"
    );
    assert_eq!(
        std::fs::read(&whole).unwrap(),
        std::fs::read(&killed).unwrap()
    );
    assert!(!at.join("killed.csv.parts").exists());
}

#[test]
fn parts_of_another_call_and_tables_that_are_there_are_left_alone() {
    let (_kept, at) = folder();
    let (spectra, table) = (at.join("in.csv"), at.join("out.csv"));
    long_form(&spectra, 2);
    let call = ["fit", text(&spectra), "--table", text(&table), "--rc"];
    let of = |rc| [call.as_slice(), &[rc]].concat();
    let parts = at.join("out.csv.parts");
    std::fs::create_dir(&parts).unwrap();
    std::fs::write(parts.join("call.txt"), "fit of another kind").unwrap();
    let message = program(&of("1")).refused();
    assert!(
        message.contains("the parts of `fit of another kind`"),
        "{message}"
    );
    std::fs::remove_dir_all(&parts).unwrap();
    program(&of("1")).ok();
    let message = program(&of("1")).refused();
    assert!(message.contains("nothing is written over"), "{message}");
    let message = program(&of("all")[..].iter().map(|a| a.trim()).collect::<Vec<_>>()).refused();
    assert!(
        message.contains("--rc: expected one number or `auto`"),
        "{message}"
    );
}

#[test]
fn rows_of_a_spectrum_in_two_places_are_refused() {
    let (_kept, at) = folder();
    let (spectra, table) = (at.join("in.csv"), at.join("out.csv"));
    long_form(&spectra, 2);
    let mut whole = std::fs::read_to_string(&spectra).unwrap();
    whole += "cell 0,1000000,0.01,0,nobody\n";
    std::fs::write(&spectra, whole).unwrap();
    let message = program(&["fit", text(&spectra), "--rc", "1", "--table", text(&table)]).refused();
    assert!(
        message.contains("line 14: expected the rows of each spectrum one after another")
            && message.contains("\"cell 0\" again"),
        "{message}"
    );
}

#[test]
fn pictures_are_drawn_where_they_are_asked_for() {
    let (_kept, at) = folder();
    let (spectra, table, out) = (at.join("in.csv"), at.join("out.csv"), at.join("pictures"));
    long_form(&spectra, 2);
    let call = ["fit", text(&spectra), "--rc", "1", "--table", text(&table)];
    let message = program(&[call.as_slice(), &["--plots", "all"]].concat()).refused();
    assert!(message.contains("--plots: expected --out"), "{message}");
    program(&[call.as_slice(), &["--plots", "all", "--out", text(&out)]].concat()).ok();
    assert!(out.join("cell 1.svg").exists() && out.join("cell 1.png").exists());
}

#[test]
fn above_twenty_spectra_nothing_is_drawn_unasked() {
    let (_kept, at) = folder();
    let spectra = "../fixtures/data/spectra/p45b_thesis.csv";
    let out = at.join("fits");
    program(&["fit", spectra, "--rc", "1", "--out", text(&out)]).ok();
    let drawn = |folder: &Path| {
        let entries = std::fs::read_dir(folder).unwrap();
        entries
            .filter(|e| {
                e.as_ref()
                    .unwrap()
                    .path()
                    .extension()
                    .is_some_and(|e| e == "svg")
            })
            .count()
    };
    let first = std::fs::read_dir(&out)
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    assert!(first.join("model_1rc.json").exists());
    assert_eq!(drawn(&first), 0);
}

#[test]
fn every_model_of_a_table_of_fits_carries_every_profile() {
    let (_kept, folder) = folder();
    let (spectra, fits) = (folder.join("spectra.csv"), folder.join("fits.parquet"));
    long_form(&spectra, 3);
    let mut content = std::fs::read_to_string(&spectra).unwrap();
    content += "broken,1,0.03,nonsense,nobody\n";
    std::fs::write(&spectra, content).unwrap();
    program(&[
        "fit",
        text(&spectra),
        "--rc",
        "1",
        "--ocv-slope",
        "none",
        "--table",
        text(&fits),
    ])
    .ok();
    let profiles = folder.join("profiles");
    std::fs::create_dir(&profiles).unwrap();
    std::fs::write(profiles.join("a.csv"), "time_s,current_a\n0,10\n5,0\n6,0\n").unwrap();
    std::fs::write(profiles.join("b.csv"), "time_s,current_a\n0,50\n5,0\n6,0\n").unwrap();
    let table = folder.join("loads.csv");
    let summary = program(&[
        "simulate",
        "--model",
        text(&fits),
        "--profile",
        text(&profiles),
        "--ocv-v",
        "3.7",
        "--largest-factor",
        "--table",
        text(&table),
    ])
    .ok();
    assert!(
        summary.contains("8 simulations; 2 without a result, 3 with warnings"),
        "{summary}"
    );
    let found = rows(&table);
    assert_eq!(found.1.len(), 8);
    for model in 0..3 {
        let (a, b) = (2 * model, 2 * model + 1);
        assert_eq!(value(&found, a, "spectrum_id"), format!("cell {model}"));
        assert_eq!(
            [value(&found, a, "profile"), value(&found, b, "profile")],
            ["a", "b"]
        );
        // 10 mΩ and 20 mΩ, the branch charged within milliseconds.
        assert!((number(&found, a, "min_ccv_v") - 3.4).abs() < 1e-4);
        assert!((number(&found, b, "min_ccv_v") - 2.2).abs() < 1e-4);
        assert!((number(&found, b, "margin_low_v") + 0.3).abs() < 1e-4);
        assert_eq!(value(&found, b, "warning_codes"), "below_window");
        assert!((number(&found, a, "largest_factor") - 4.0).abs() < 1e-3);
    }
    let reason = found.1[6].join(",");
    assert!(reason.contains("spectra.csv, line 20"), "{reason}");
    let again = program(&[
        "simulate",
        "--model",
        text(&fits),
        "--profile",
        text(&profiles),
        "--ocv-v",
        "3.7",
        "--table",
        text(&table),
    ])
    .refused();
    assert!(again.contains("nothing is written over"), "{again}");
}

#[test]
fn data_sets_become_rows_of_their_held_out_runs() {
    let (_kept, folder) = folder();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let set = repository.join("configs/datasets/panasonic_50soc");
    let broken = folder.join("broken");
    std::fs::create_dir(&broken).unwrap();
    std::fs::write(broken.join("dataset.toml"), "name = 3\n").unwrap();
    let table = folder.join("gaps.csv");
    let summary = program(&[
        "diagnose",
        text(&set),
        text(&folder),
        "--base-only",
        "--table",
        text(&table),
    ])
    .ok();
    assert!(
        summary.contains("2 data sets; 1 without a result"),
        "{summary}"
    );
    let found = rows(&table);
    assert_eq!(found.1.len(), 3);
    assert_eq!(
        [value(&found, 0, "run"), value(&found, 1, "run")],
        ["2C", "6C"]
    );
    for row in 0..2 {
        assert_eq!(value(&found, row, "verdict"), "gap");
        assert_eq!(value(&found, row, "effects"), "\"\"");
        // After the new fit it is closer, and nothing was added to it.
        assert!(number(&found, row, "base_mv") < number(&found, row, "eis_only_mv"));
        assert!(number(&found, row, "base_mv") > number(&found, row, "floor_mv"));
        assert_eq!(
            value(&found, row, "augmented_mv"),
            value(&found, row, "base_mv")
        );
    }
    assert_eq!(value(&found, 2, "data_set"), "broken");
    assert!(found.1[2].join(",").contains("name"), "{:?}", found.1[2]);
    let refused = program(&["diagnose", text(&set), text(&set)]).refused();
    assert!(refused.contains("expected one data set"), "{refused}");
}
