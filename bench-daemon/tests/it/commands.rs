//! Features for newcomers, scripts and shells: `demo`, `config`, `--json`, units in flags,
//! completions, manual pages.

use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    path::Path,
    process::Command,
};

use serde_json::Value;

use crate::support::{BENCH, EXPERIMENT, Files, program, program_in};

fn text(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn the_files_to_begin_with_are_right_and_are_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let new = text(&folder.path().join("lab"));
    let (code, out, _) = program(&["config", "new", &new]).parts();
    assert_eq!(code, 0);
    let written: Vec<&str> = out.lines().collect();
    assert!(written.len() > 5 && written.iter().all(|path| Path::new(path).is_file()));
    let checked: Vec<&str> = written
        .iter()
        .copied()
        .filter(|path| !path.contains("cells") && !path.contains("scenarios"))
        .collect();
    let mut words = vec!["config", "check"];
    words.extend(&checked);
    let (code, out, err) = program(&words).parts();
    assert_eq!(code, 0, "{out}{err}");
    for kind in ["experiment", "bench", "server"] {
        assert!(out.contains(&format!(" {kind} that is right")), "{out}");
    }
    let (code, _, err) = program(&["config", "new", &new]).parts();
    assert!(
        code == 2 && err.contains("expected no such file, found one"),
        "{err}"
    );
}

#[test]
fn a_call_without_a_command_names_the_ways_in() {
    let (code, out, _) = program::<&str>(&[]).parts();
    assert!(code == 0 && out.lines().count() <= 14, "{out}");
    let help = program(&["--help"]).parts().1;
    for command in [
        "demo", "config", "identify", "doctor", "plan", "kk", "fit", "dataset", "map", "hppc",
        "ocv", "simulate", "sop", "pack", "convert",
    ] {
        assert!(out.contains(command), "{command}: {out}");
        assert!(help.contains(&format!("\n  {command} ")), "{command}");
    }
}

#[test]
fn a_file_of_another_kind_is_named_as_what_it_is() {
    let files = Files::demo();
    let path = |name: &str| text(&files.path(name));
    let (bench, experiment, cell) = (path(BENCH), path(EXPERIMENT), path("cells/p45b.toml"));
    let log = path("log.csv");
    fs::write(&log, "time_s,voltage_v,current_a\n0,3.7,0\n1,3.6,-1\n").unwrap();
    for (call, found, hint) in [
        (
            ["run", &bench],
            "expected an experiment, found a bench",
            "--bench",
        ),
        (
            ["plan", &cell],
            "expected an experiment, found a cell",
            "config new",
        ),
        (
            ["serve", &experiment],
            "expected a server, found an experiment",
            "",
        ),
        (["outputs", &cell], "expected a bench, found a cell", ""),
        (
            ["diagnose", &log],
            "expected a data set, found another file",
            "dataset init",
        ),
    ] {
        let mut call = call.to_vec();
        if call[0] == "diagnose" {
            call.extend(["--erm", "10 mΩ; 2 mΩ, 1 s"]);
        }
        let (code, _, err) = program(&call).parts();
        let file = Path::new(call[1]).file_name().unwrap().to_str().unwrap();
        let found = format!("{file}: {found}");
        assert!(
            code == 2 && err.contains(&found) && err.contains(hint),
            "{call:?}: {err}"
        );
    }
}

#[test]
fn packs_are_ranked_from_a_table_of_cells() {
    let folder = tempfile::tempdir().unwrap();
    let table = text(&folder.path().join("cells.csv"));
    let header = "cell,capacity_ah,ocv_v,dcir_ohm,mass_kg,v_min,v_max,discharge_max_a\n";
    fs::write(
        &table,
        format!("{header}P45B,4.5,3.6,0.015,0.07,2.5,4.2,45\n"),
    )
    .unwrap();
    let base = [
        "pack",
        "rank",
        &table,
        "--series",
        "14..18",
        "--parallel",
        "3",
    ];
    let needs = [
        "--interconnect-ohm",
        "0.03",
        "--power-w",
        "5000",
        "--bus-v",
        "40,68",
    ];
    let found = program(&[&base[..], &needs, &["--json"]].concat()).json();
    let packs = found.as_array().unwrap();
    assert_eq!(packs.len(), 5);
    // 14S3P is too weak above 40 V; 15S3P is the lightest that is not, and the bus limits it.
    let first = (&packs[0]["series"], &packs[0]["limited_by"]);
    assert_eq!(first, (&15.into(), &"lower_voltage".into()));
    assert_eq!(packs[4]["unmet"][0], "full at 75.6 V");
    let (_, out, _) = program(&[&base[..], &needs, &["--rows", "2"]].concat()).parts();
    assert!(
        out.contains("15S3P") && out.contains("2 of 5 packs"),
        "{out}"
    );

    for (text, message) in [
        (
            "cell,ocv_v\n",
            "expected a column capacity_ah, found cell, ocv_v",
        ),
        (header, "expected at least one cell, found a header only"),
        (
            &format!("{header}x,4.5,3.6,?,0.07,2.5,4.2,\n"),
            "line 2, column dcir_ohm: expected a number",
        ),
    ] {
        fs::write(&table, text).unwrap();
        let (code, _, err) = program(&base).parts();
        assert!(code == 2 && err.contains(message), "{err}");
    }
    let (code, _, err) =
        program(&["pack", "rank", &table, "--series", "0", "--parallel", "1"]).parts();
    assert!(code == 2 && err.contains("a range such as 14..18"), "{err}");
}

#[test]
fn a_mistake_is_reported_with_its_file_and_field() {
    let files = Files::demo().edit(EXPERIMENT, "\"5 A\"", "\"5 V\"");
    let (file, bench) = (text(&files.path(EXPERIMENT)), text(&files.path(BENCH)));
    let (code, out, err) = program(&["config", "check", &file, &bench, "--json"]).parts();
    assert!(code == 2 && err.contains("1 of 2 files are wrong"), "{err}");
    let report: Value = serde_json::from_str(&out).unwrap();
    let mistake = report[0]["mistake"].as_str().unwrap();
    assert!(
        mistake.contains("demo.toml") && mistake.contains("expected a current with its unit"),
        "{mistake}"
    );
    assert!(report[1]["mistake"].is_null() && report[1]["kind"] == "bench");
    let (code, out, _) =
        program(&["config", "check", &text(&files.path("cells/p45b.toml"))]).parts();
    assert!(
        code == 2 && out.contains("expected an experiment (key `cell`)"),
        "{out}"
    );
}

#[test]
fn schemas_describe_the_files_that_are_there() {
    let schema = program(&["config", "schema", "experiment"]).json();
    assert_eq!(
        schema["required"],
        serde_json::json!(["name", "bench", "cell"])
    );
    let eis = &schema["$defs"]["eis"]["properties"];
    assert_eq!(eis["start"]["examples"][0], "0.1 Hz");
    assert!(eis["start"]["pattern"].as_str().unwrap().contains("mHz"));
    for kind in ["bench", "cell", "scenario", "server", "dataset"] {
        let schema = program(&["config", "schema", kind]).json();
        assert!(
            schema["properties"].as_object().unwrap().len() > 3,
            "{kind}"
        );
        assert_eq!(schema["additionalProperties"], false);
    }
}

#[test]
fn a_run_its_plan_its_replay_and_its_check_are_printed_as_json() {
    let files = Files::brief(3);
    let (experiment, out) = (text(&files.path(EXPERIMENT)), text(&files.path("out")));
    let plan = program(&["plan", &experiment, "--json"]).json();
    assert_eq!(plan["experiment"], "demo");
    assert!(plan["stages"].as_array().unwrap().len() > 2);
    assert!(plan["expected_s"].as_f64().unwrap() <= plan["longest_s"].as_f64().unwrap());
    let run = program(&["run", &experiment, "--out", &out, "--json"]).json();
    assert_eq!(run["refused_points"], 0);
    assert_eq!(run["recommended_rc"], 1);
    assert!(run["model"].as_str().unwrap().ends_with("model_1rc.json"));
    assert!(Path::new(run["model"].as_str().unwrap()).is_file());
    assert!(Path::new(run["report"].as_str().unwrap()).is_file());
    let verified = program(&["verify", &out, "--json"]).json();
    assert_eq!(verified[0]["good"], true);
    assert!(verified[0]["recomputed"]["points"].as_u64().unwrap() >= 9);
    let replayed = program(&["replay", &out, "--json"]).json();
    assert_eq!(replayed[0]["points"], replayed[0]["identical_points"]);
    assert_eq!(replayed[0]["spectra"], replayed[0]["identical_spectra"]);
    let report = Path::new(&out).join("report.html");
    fs::write(&report, "altered").unwrap();
    let (code, stdout, _) = program(&["verify", &out, "--json"]).parts();
    let answer: Value = serde_json::from_str(&stdout).unwrap();
    assert!(
        code == 10
            && answer[0]["good"] == false
            && answer[0]["altered"][0]["file"] == "report.html"
    );
}

#[test]
fn tokens_are_printed_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let new = text(&folder.path().join("lab"));
    program(&["config", "new", &new]).parts();
    let server = new + "/serve.toml";
    let made = program(&[
        "token",
        "add",
        &server,
        "anna",
        "--scope",
        "read,operate",
        "--json",
    ])
    .json();
    assert!(made["token"].as_str().unwrap().len() > 20);
    let all = program(&["token", "list", &server, "--json"]).json();
    assert_eq!(all[0]["name"], "anna");
    assert_eq!(all[0]["scopes"], serde_json::json!(["read", "operate"]));
    assert_eq!(all[0]["expired"], false);
    let at = |key: &str| all[0][key].as_u64().unwrap();
    let valid_s = at("expires_unix_s") - at("made_unix_s");
    assert!(valid_s.abs_diff(365 * 86_400) <= 1, "{valid_s}");
    let (code, _, err) = program(&["token", "add", &server, "bob", "--valid", "soon"]).parts();
    assert!(code == 2 && err.contains("or `never`"), "{err}");
    let gone = program(&["token", "revoke", &server, "anna", "--json"]).json();
    assert_eq!(gone["left"], 0);
}

#[test]
fn flags_take_units() {
    let size = |ocv: &str, dcir: &str| {
        program(&[
            "pack",
            "size",
            "--series",
            "16",
            "--parallel",
            "3",
            "--ocv-v",
            ocv,
            "--dcir-ohm",
            dcir,
            "--json",
        ])
        .json()
    };
    assert_eq!(size("3.6", "0.015"), size("3.6 V", "15 mΩ"));
    let (code, _, err) = program(&[
        "pack",
        "size",
        "--series",
        "1",
        "--parallel",
        "1",
        "--ocv-v",
        "3.6 A",
        "--dcir-ohm",
        "1",
    ])
    .parts();
    assert!(
        code == 2 && err.contains("expected a voltage in V, or with its unit, such as \"3.80 V\""),
        "{err}"
    );
}

#[test]
fn a_web_server_is_not_an_instrument() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for mut client in listener.incoming().map_while(Result::ok) {
            let _ = client.read(&mut [0; 256]);
            let _ = client.write_all(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n");
        }
    });
    let (code, out, err) = program(&["identify", &address]).parts();
    assert_eq!(code, 3, "{out}{err}");
    assert!(
        out.contains("expected an instrument, met a web server"),
        "{out}{err}"
    );
    assert!(
        !out.contains("model = "),
        "no dialect is to be forced on it: {out}"
    );
}

#[test]
fn mocks_write_a_bench_beside_one_in_the_working_folder() {
    let files = Files::demo();
    let folder = files.path("benches");
    let mut mock = Command::new(env!("CARGO_BIN_EXE_eis-bench"))
        .args([
            "mock",
            "demo.toml",
            "--write-bench",
            "served.toml",
            "--json",
        ])
        .current_dir(&folder)
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = [0; 1];
    mock.stdout
        .as_mut()
        .unwrap()
        .read_exact(&mut first)
        .unwrap();
    mock.kill().unwrap();
    mock.wait().unwrap();
    assert!(
        fs::read_to_string(folder.join("served.toml"))
            .unwrap()
            .contains("tcp://127.0.0.1")
    );
}

#[test]
fn shells_and_man_are_served_from_the_definition() {
    for shell in ["bash", "zsh", "fish"] {
        let (code, out, _) = program(&["completions", shell]).parts();
        assert!(
            code == 0 && out.contains("eis-bench") && out.contains("diagnose"),
            "{shell}"
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let (code, _, _) = program(&["man", &text(folder.path())]).parts();
    assert_eq!(code, 0);
    let page = fs::read_to_string(folder.path().join("eis-bench-fit.1")).unwrap();
    assert!(page.contains(".TH") && page.contains("spectra"));
}

#[test]
fn the_demo_runs_from_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = program_in(folder.path(), &["demo", "--seed", "3"]).ok();
    assert!(
        out.contains("next: open eis-bench-demo/run/report.html"),
        "{out}"
    );
    assert!(
        folder
            .path()
            .join("eis-bench-demo/run/report.html")
            .is_file()
    );
}

#[test]
fn the_help_shows_commands_in_groups() {
    let (_, out, _) = program(&["--help"]).parts();
    let begin = out.find(" To begin with:").unwrap();
    let model = out.find(" What a model lacks:").unwrap();
    assert!(begin < model && out[begin..model].contains("demo"));
    assert!(out.lines().all(|line| line.chars().count() <= 120));
}
