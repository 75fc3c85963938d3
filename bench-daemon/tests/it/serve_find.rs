//! Work with runs over the API: find them, write notes, inspect the record of a point, change
//! files, analyse, explore packs.

use std::{fs, path::Path};

use analysis::formats;
use serde_json::{Value, json};

use crate::{
    map_next,
    serve_support::{Served, config, data, submit, token},
    support::{CELL, EXPERIMENT, Files, poll, program, project},
};

/// Starts a server with a finished run of the demo in virtual time.
pub(crate) fn with_a_run() -> (Files, Served) {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    assert_eq!(run, "demo-1");
    served.ended("demo-1");
    (files, served)
}

/// Number of runs of the catalogue that meet conditions; none before its first scan.
fn number_found(served: &Served, query: &str) -> usize {
    let answer = served.ask("GET", &format!("/api/v1/catalog/runs?{query}"), ("", ""));
    match answer.status {
        503 => 0,
        _ => answer.expect(200).json()["runs"].as_array().unwrap().len(),
    }
}

fn put(served: &Served, path: &str, body: &Value) -> crate::serve_support::Answer {
    served.ask("PUT", &format!("/api/v1{path}"), ("", &body.to_string()))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn a_run_is_found_by_what_is_known_and_written_of_it() {
    let (_files, served) = with_a_run();
    let found = |query: &str| number_found(&served, query);
    let appears = |query: &str| poll(query, || (found(query) == 1).then_some(()));
    appears("text=DEMO+p45b");
    appears("cell=Molicel%20P45B&bench=demo&verdict=good");
    assert_eq!(found("verdict=failed"), 0);
    assert_eq!(found("from_s=1e12"), 0);
    assert_eq!(found("text=swollen"), 0);
    let note = json!({ "text": "cell looks <b>swollen</b>\nat the seam" }).to_string();
    let notes = "/runs/demo-1/notes";
    let kept = served.post(notes, &note).expect(201).json();
    assert_eq!(kept["by"], "local");
    assert_eq!(
        served.get(notes)[0]["text"],
        "cell looks <b>swollen</b>\nat the seam"
    );
    appears("text=swollen");
    for text in ["", "  ", "a\u{1b}[2J"] {
        let answer = served
            .post(notes, &json!({ "text": text }).to_string())
            .expect(422);
        assert!(
            answer
                .text()
                .contains("text: expected 1 to 4000 characters"),
            "{}",
            answer.text()
        );
    }
    let tags = "/runs/demo-1/tags";
    put(
        &served,
        tags,
        &json!({ "tags": ["aged", "Zelle-Ä", "aged"] }),
    )
    .expect(200);
    appears("tag=aged");
    assert_eq!(found("tag=age"), 0);
    assert_eq!(
        served.get("/catalog/choices")["tags"],
        json!(["Zelle-Ä", "aged"])
    );
    let card = served.get("/runs/demo-1")["card"].clone();
    assert_eq!(
        (&card["tags"], &card["notes"]),
        (&json!(["Zelle-Ä", "aged"]), &json!(1))
    );
    let answer = put(&served, tags, &json!({ "tags": ["a b"] })).expect(422);
    assert!(
        answer.text().contains("tags: expected 1 to 40 letters"),
        "{}",
        answer.text()
    );
    served.post("/runs/none/notes", &note).expect(404);
}

#[test]
fn a_spectrum_shows_its_models_and_the_record_behind_each_point() {
    let (_files, served) = with_a_run();
    let models = served.get("/runs/demo-1/models?spectrum=spectrum");
    let recommended: Vec<_> = (models.as_array().unwrap().iter())
        .map(|model| &model["recommended"])
        .collect();
    assert_eq!(recommended, [true, false, false, false]);
    assert_eq!(models[0]["name"], "ERM, 4 RC");
    // The scenario has the order of the model: the residual is noise at every frequency.
    let residuals = models[0]["residuals"].as_array().unwrap();
    assert_eq!(residuals.len(), 20);
    let parts = residuals
        .iter()
        .flat_map(|one| [&one["re_sigmas"], &one["im_sigmas"]]);
    let squares: f64 = parts.map(|part| number(part).powi(2)).sum();
    assert!(squares / 40.0 < 3.0, "{squares}");
    let spectra = served.get("/runs/demo-1/spectra");
    let spectrum = spectra
        .as_array()
        .unwrap()
        .iter()
        .find(|one| one["name"] == "spectrum")
        .unwrap();
    for place in [0, 19] {
        let point = &spectrum["points"][place];
        let path = format!(
            "/runs/demo-1/capture?spectrum=spectrum&freq_hz={}",
            point["freq_hz"]
        );
        let capture = served.get(&path);
        assert_eq!(capture["channels"].as_array().unwrap().len(), 4);
        // The largest line of each channel is the frequency that was driven.
        for lines in capture["spectrum"].as_array().unwrap() {
            let heights = lines["amplitude"].as_array().unwrap();
            let peak = (0..heights.len())
                .max_by(|&a, &b| number(&heights[a]).total_cmp(&number(&heights[b])));
            let at = number(&lines["freq_hz"][peak.unwrap()]);
            let driven = number(&point["freq_hz"]);
            let resolution = 1.0 / (number(&capture["samples"]) * number(&capture["interval_s"]));
            assert!((at - driven).abs() <= resolution, "{at} Hz, {driven} Hz");
        }
        let channel = &capture["channels"][0];
        let rms = number(&channel["residual_rms_v"]);
        assert!(rms < 0.05 * number(&channel["amplitude_v"]), "{rms}");
    }
    served
        .ask(
            "GET",
            "/api/v1/runs/demo-1/capture?spectrum=spectrum&freq_hz=7",
            ("", ""),
        )
        .expect(404);
    served
        .ask(
            "GET",
            "/api/v1/runs/demo-1/models?spectrum=..%2Fx",
            ("", ""),
        )
        .expect(404);
    poll("the cell in the catalogue", || {
        let notes = served.ask("GET", "/api/v1/cells/Molicel%20P45B/notes", ("", ""));
        (notes.status == 200).then_some(())
    });
    served
        .ask("GET", "/api/v1/cells/none/notes", ("", ""))
        .expect(404);
}

#[test]
fn a_campaign_is_a_table_of_cells_and_repeats() {
    let campaign = "[campaign]\nrepeats = 2\ncells = [{ name = \"A\", serial = \"S-1\" }]\n";
    let files = Files::demo().append(EXPERIMENT, campaign);
    config(&files, "");
    let served = Served::start(&files);
    served.ended(&submit(&served, r#"{"experiment":"demo"}"#));
    let matrix = served.get("/runs/demo-1/campaign");
    assert_eq!(matrix["cells"], json!([{ "name": "A", "serial": "S-1" }]));
    let runs = matrix["runs"].as_array().unwrap();
    let states: Vec<_> = runs
        .iter()
        .map(|run| {
            (
                run["state"].as_str().unwrap(),
                run["spectrum"].as_str().unwrap(),
            )
        })
        .collect();
    assert_eq!(states, [("done", "spectra/A_1"), ("done", "spectra/A_2")]);
    poll("both spectra in the catalogue", || {
        let answer = served.ask("GET", "/api/v1/catalog/spectra?cell=A", ("", ""));
        let spectra = (answer.status == 200).then(|| answer.json())?;
        (spectra["spectra"].as_array()?.len() == 2).then_some(())
    });
    for (query, number) in [("cell=S-1", 1), ("cell=A&serial=S-1", 1), ("serial=S-2", 0)] {
        assert_eq!(number_found(&served, query), number, "{query}");
    }
    // The record of the second repeat is found by the number of its run.
    let freq = &served.get("/runs/demo-1/spectra")[0]["points"][0]["freq_hz"];
    let path = format!("/runs/demo-1/capture?spectrum=spectra%2FA_2&freq_hz={freq}");
    assert!(
        served.get(&path)["path"]
            .as_str()
            .unwrap()
            .starts_with("captures/cell_2/")
    );
}

#[test]
fn a_draft_says_what_it_would_do_or_which_field_is_wrong() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let drafts = "/drafts";
    let text = files.text(EXPERIMENT);
    let draft = served
        .post(drafts, &json!({ "text": text }).to_string())
        .expect(200)
        .json();
    assert_eq!(draft["mistakes"], json!([]));
    assert!(
        number(&draft["plan"]["expected_s"]) > 0.0 && number(&draft["plan"]["discharge_c"]) > 0.0
    );
    let current = draft["margins"]
        .as_array()
        .unwrap()
        .iter()
        .find(|one| one["unit"] == "A")
        .unwrap();
    assert_eq!(current["planned_least"], -5.0);
    assert_eq!(number(&current["margin"]), 10.5);
    // The values result in an equivalent text.
    let value = draft["value"].clone();
    let again = served
        .post(drafts, &json!({ "value": value }).to_string())
        .expect(200)
        .json();
    assert_eq!((&again["value"], &again["plan"]), (&value, &draft["plan"]));
    let mut wrong = value;
    wrong["eis"]["amplitude"] = json!("100 A");
    let checked = served
        .post(drafts, &json!({ "value": wrong }).to_string())
        .expect(200)
        .json();
    assert_eq!(checked["mistakes"][0]["field"], "eis.amplitude");
    assert_eq!(
        checked["mistakes"][0]["message"],
        "expected 0.01 A to 13.5 A, found 100 A"
    );
    assert_eq!(checked["plan"], Value::Null);
    let checked = served
        .post(drafts, &json!({ "text": "name = " }).to_string())
        .expect(200)
        .json();
    assert_eq!(
        (
            &checked["value"],
            checked["mistakes"].as_array().unwrap().len()
        ),
        (&Value::Null, 1)
    );
    served.post(drafts, "{}").expect(422);
    // Nothing of this lies anywhere.
    assert!(!files.path("data/submitted").join("demo-1").exists());
}

#[test]
fn files_are_changed_with_history_and_are_read_by_what_is_submitted_later() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let path = "/files/cells/p45b";
    let first = served.get(path);
    let text = first["text"]
        .as_str()
        .unwrap()
        .replace("voltage_max = \"4.2 V\"", "voltage_max = \"4.1 V\"");
    let change =
        |text: &str, why: &str, was: &Value| json!({ "text": text, "why": why, "was_sha256": was });
    put(&served, path, &change(&text, "", &first["sha256"])).expect(422);
    let bad = text.replace("4.1 V", "41 V");
    let answer = put(&served, path, &change(&bad, "x", &first["sha256"])).expect(422);
    assert!(answer.text().contains("voltage_max"), "{}", answer.text());
    let second = put(&served, path, &change(&text, "gentler", &first["sha256"]))
        .expect(200)
        .json();
    assert_eq!(second["versions"][1]["why"], "gentler");
    // A client that has not read the file cannot overwrite it.
    put(&served, path, &change(&text, "again", &first["sha256"])).expect(409);
    assert_eq!(
        served.get(&format!("{path}?version=0"))["text"],
        first["text"]
    );
    assert_eq!(
        files.text(CELL),
        first["text"].as_str().unwrap(),
        "the file itself is not changed"
    );
    // The demo charges to 4.2 V: that is now beyond the cell.
    let answer = served
        .post("/queue", r#"{"experiment":"demo"}"#)
        .expect(422);
    assert!(answer.text().contains("4.1 V"), "{}", answer.text());
    // An experiment of a new name, on the changed cell.
    let experiment = files
        .text(EXPERIMENT)
        .replace("\"4.2 V\"", "\"4.1 V\"")
        .replace("\"demo\"", "\"gentle\"");
    let path = "/files/experiments/gentle";
    put(
        &served,
        path,
        &change(&experiment, "for the changed cell", &Value::Null),
    )
    .expect(200);
    assert_eq!(submit(&served, r#"{"experiment":"gentle"}"#), "gentle-1");
    served.ended("gentle-1");
    assert!(data(&files, "submitted/gentle-1/cells/p45b.toml").contains("4.1 V"));
    let of_run = served.get("/runs/gentle-1/experiment");
    assert_eq!(of_run["value"]["soc_reset"]["charge_voltage"], "4.1 V");
    for name in ["..%2Fx", "a.b", "%2Fetc"] {
        let answer = put(
            &served,
            &format!("/files/cells/{name}"),
            &change("", "x", &Value::Null),
        );
        assert!([404, 422].contains(&answer.status), "{}", answer.text());
    }
}

fn analysed(served: &Served, body: &Value) -> Value {
    let analysis = served
        .post("/analyses", &body.to_string())
        .expect(201)
        .json();
    let path = format!("/analyses/{}", analysis["id"].as_str().unwrap());
    poll("the analysis", || {
        let now = served.get(&path);
        (!["waiting", "in work"].contains(&now["state"].as_str().unwrap())).then_some(now)
    })
}

#[test]
fn analyses_run_beside_and_give_the_results_of_the_command() {
    let (files, served) = with_a_run();
    let fit = analysed(
        &served,
        &json!({ "kind": "fit", "runs": ["demo-1"], "options": { "rc": "2" } }),
    );
    assert_eq!(
        (&fit["state"], &fit["message"]),
        (&json!("done"), &Value::Null)
    );
    let file = served
        .ask(
            "GET",
            "/api/v1/analyses/fit-1/files/model_2rc.json",
            ("", ""),
        )
        .expect(200);
    // The result equals that on a terminal.
    let out = files.path("by-hand");
    let spectrum = files.path("data/runs/demo-1/shared/spectrum.csv");
    program(&[
        "fit".as_ref(),
        spectrum.as_os_str(),
        "--rc=2".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
    ])
    .expect_code(0);
    assert_eq!(
        file.json()["fit"],
        crate::support::json(&out.join("model_2rc.json"))["fit"]
    );
    let kk = analysed(&served, &json!({ "kind": "kk", "runs": ["demo-1"] }));
    assert!(
        kk["files"]
            .as_array()
            .unwrap()
            .iter()
            .any(|file| file["path"] == "kk.json")
    );
    let diagnosis = analysed(&served, &json!({ "kind": "diagnose", "runs": ["demo-1"] }));
    let story = &diagnosis["stories"][0];
    assert_eq!(story["verdict"], "cannot tell");
    for part in ["where", "what", "how_sure", "next"] {
        assert!(
            !story[part].as_array().unwrap().is_empty(),
            "{part}: {story}"
        );
    }
    // The recommended experiment can be run on this server.
    let text = &story["next"][0]["experiment"];
    let draft = served.post(
        "/drafts",
        &json!({ "text": text, "bench": "demo" }).to_string(),
    );
    assert_eq!(draft.expect(200).json()["mistakes"], json!([]));
    for (body, words) in [
        (
            json!({ "kind": "fit", "runs": [] }),
            "runs: expected 1 to 50",
        ),
        (
            json!({ "kind": "fit", "runs": ["../x"] }),
            "runs: expected names of runs",
        ),
        (
            json!({ "kind": "fit", "runs": ["demo-1"], "options": { "rc": "--out=/" } }),
            "options.rc: expected",
        ),
        (
            json!({ "kind": "fit", "runs": ["demo-1"], "spectra": ["../x"] }),
            "spectra: expected",
        ),
        (
            json!({ "kind": "kk", "runs": ["demo-1"], "options": { "rc": "2" } }),
            "options.rc: expected one of drt",
        ),
        (
            json!({ "kind": "diagnose", "runs": ["demo-1"], "options": { "order": 9 } }),
            "options.order: expected",
        ),
    ] {
        let answer = served.post("/analyses", &body.to_string()).expect(422);
        assert!(answer.text().contains(words), "{}", answer.text());
    }
    // A failed analysis reports the reason.
    let failed = analysed(
        &served,
        &json!({ "kind": "fit", "runs": ["demo-1"], "options": { "circuit": "R0-Q" } }),
    );
    assert_eq!(failed["state"], "failed");
    assert!(
        failed["message"].as_str().unwrap().contains("Q"),
        "{failed}"
    );
}

#[test]
fn an_analysis_is_cancelled_while_it_waits_and_while_it_works() {
    let (_files, served) = with_a_run();
    // Many elements without start values: long.
    let long = json!({
        "kind": "fit",
        "runs": ["demo-1"],
        "options": { "circuit": "R0-L1-p(R1,CPE1)-p(R2,CPE2)-p(R3,CPE3)-p(R4,CPE4)-p(R5-Wo1,CPE5)" },
    });
    let ids = [0, 1].map(|_| {
        let answer = served.post("/analyses", &long.to_string()).expect(201);
        answer.json()["id"].as_str().unwrap().to_owned()
    });
    let path = |id: &str| format!("/analyses/{id}");
    poll("the first to begin", || {
        (served.get(&path(&ids[0]))["state"] == "in work").then_some(())
    });
    for id in [&ids[1], &ids[0]] {
        served
            .ask("DELETE", &format!("/api/v1{}", path(id)), ("", ""))
            .expect(200);
        assert_eq!(served.get(&path(id))["state"], "cancelled");
        served
            .ask("DELETE", &format!("/api/v1{}", path(id)), ("", ""))
            .expect(409);
    }
    // The next analysis does not wait for the cancelled one.
    let next = analysed(
        &served,
        &json!({ "kind": "fit", "runs": ["demo-1"], "options": { "rc": "1" } }),
    );
    assert_eq!(next["state"], "done");
}

#[test]
fn a_pack_is_explored_with_the_model_of_a_run() {
    let (_files, served) = with_a_run();
    let models = served.get("/pack/models");
    assert_eq!(
        (&models[0]["run"], &models[0]["order"]),
        (&json!("demo-1"), &json!(4))
    );
    let load = |more: Value| {
        let mut load = json!({
            "model": { "run": "demo-1", "name": "model_4rc" }, "series": 16, "parallel": 3,
            "soc": 0.5, "profile": "spin_jump",
        });
        load.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        served.post("/pack", &load.to_string())
    };
    let one = load(json!({})).expect(200).json();
    let two = load(json!({ "parallel": 6 })).expect(200).json();
    assert!(number(&one["lowest_v"]) < number(&two["lowest_v"]) && one["kept"] == true);
    let tight = load(json!({ "current_max_a": 10.0 })).expect(200).json();
    assert!(tight["kept"] == false && number(&tight["margin_a"]) < 0.0);
    // The lowest voltage is that of the curve.
    let lowest = one["voltage_v"]
        .as_array()
        .unwrap()
        .iter()
        .map(number)
        .fold(f64::INFINITY, f64::min);
    assert!((lowest - number(&one["lowest_v"])).abs() < 1e-9);
    for (more, words) in [
        (json!({ "series": 0 }), "series: expected 1 to 1000"),
        (json!({ "soc": 1.5 }), "soc: "),
        (
            json!({ "profile": "running" }),
            "profile: expected one of walking",
        ),
        (json!({ "scale": 0.0 }), "scale: expected a factor"),
        (
            json!({ "model": { "erm": "6 mΩ; x" } }),
            "model.erm: element 2",
        ),
        (
            json!({ "model": { "run": "demo-1", "name": "../x" } }),
            "model.name: expected",
        ),
    ] {
        let answer = load(more).expect(422);
        assert!(answer.text().contains(words), "{}", answer.text());
    }
}

#[test]
fn a_run_of_a_map_brings_its_map_to_the_pack_and_to_the_catalogue() {
    let files = map_next::start();
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    served.ended(&run);
    let models = served.get("/pack/models");
    assert_eq!(models.as_array().unwrap().len(), 1, "{models}");
    let model = &models[0];
    assert_eq!(
        (&model["run"], &model["name"]),
        (&json!(run), &json!("map"))
    );
    assert_eq!(
        (&model["ocv"], &model["temperature_c"]),
        (&json!(true), &Value::Null)
    );
    let range = &model["map"];
    assert!(
        number(&range["soc_low"]) <= 0.2 && number(&range["soc_high"]) >= 0.9,
        "{range}"
    );
    let degc = ["temperature_low_c", "temperature_high_c"].map(|name| number(&range[name]));
    assert!(degc.iter().all(|degc| (degc - 25.0).abs() < 1.0), "{range}");
    let load = |degc: Option<f64>| {
        let load = json!({
            "model": { "run": run, "name": "map" }, "series": 16, "parallel": 3, "soc": 0.5,
            "profile": "spin_jump", "temperature_c": degc,
        });
        served.post("/pack", &load.to_string()).expect(200).json()
    };
    // The command, with rows as far apart as those of the server.
    let profile = project("fixtures/data/profiles/spin_jump.csv");
    let rows = fs::read_to_string(&profile).unwrap();
    let last = rows.lines().last().unwrap().split(',').next().unwrap();
    let step_s = (last.parse::<f64>().unwrap() / 500.0).to_string();
    let file = files.path("data/runs").join(&run).join("map.json");
    let command = |degc: &str| -> Value {
        let words = [
            "simulate",
            "--model",
            file.to_str().unwrap(),
            "--profile",
            &profile,
            "--series",
            "16",
            "--parallel",
            "3",
            "--soc",
            "0.5",
            "--ambient-degc",
            degc,
            "--step-s",
            &step_s,
            "--json",
        ];
        let ended = program(&words);
        serde_json::from_str(&ended.expect_code(0).stdout).unwrap()
    };
    let mut lowest_v = Vec::new();
    for (degc, words) in [(Some(25.0), "25"), (Some(-5.0), "-5"), (None, "25")] {
        let (page, printed) = (load(degc), command(words));
        for (own, other) in [
            ("lowest_v", "min_ccv_v"),
            ("highest_v", "max_ccv_v"),
            ("heat_j", "heat_j"),
            ("highest_a", "peak_current_a"),
        ] {
            assert_eq!(page[own], printed[other], "{words}: {own}");
        }
        let cautions = page["cautions"].to_string();
        let outside =
            "leaves the range in which the map was measured by up to 0.000 of charge and 30.1 K";
        for notes in [cautions, printed["notes"].to_string()] {
            assert_eq!(notes.contains(outside), degc == Some(-5.0), "{notes}");
        }
        lowest_v.push(number(&page["lowest_v"]));
    }
    assert!(
        lowest_v[1] < lowest_v[0] && lowest_v[2] == lowest_v[0],
        "{lowest_v:?}"
    );
    let found = poll("the scan", || {
        let answer = served.ask("GET", "/api/v1/catalog/runs?map=true", ("", ""));
        let found = (answer.status == 200).then(|| answer.json())?;
        (!found["runs"].as_array().unwrap().is_empty()).then_some(found)
    });
    let map = &found["runs"][0]["map"];
    assert_eq!(map["soc_low"], range["soc_low"]);
    assert_eq!(map["temperature_high_c"], range["temperature_high_c"]);
    assert!(number(&map["left_out_mv"]) > 0.0, "{map}");
}

/// Sends a request with additional header lines and returns the answer.
fn asked(served: &Served, head: &str, body: &str) -> crate::serve_support::Answer {
    let request = format!(
        "{head}\r\nHost: {}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
        served.address,
        body.len()
    );
    served.raw(request.as_bytes())
}

fn cookie_of(answer: &crate::serve_support::Answer) -> String {
    let line = answer
        .head
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .unwrap();
    assert!(
        line.contains("; httponly; samesite=strict; max-age=43200"),
        "{line}"
    );
    line.split(';').next().unwrap().to_owned()
}

#[test]
fn a_session_cannot_be_forged_fixed_or_used_after_its_end() {
    let files = Files::demo();
    config(&files, "");
    let secret = token(&files, "ann", "read,operate");
    let served = Served::start(&files);
    let sign_in = |more: &str, token: &str| {
        let head = format!("POST /api/v1/session HTTP/1.1\r\nContent-Type: application/json{more}");
        asked(&served, &head, &json!({ "token": token }).to_string())
    };
    sign_in("", "eb_wrong").expect(401);
    // A session number that another client has chosen is not accepted.
    let chosen = "eis_bench_session=0123456789";
    let cookie = cookie_of(&sign_in(&format!("\r\nCookie: {chosen}"), &secret).expect(200));
    assert_ne!(cookie, chosen);
    let get = |cookie: &str| {
        asked(
            &served,
            &format!("GET /api/v1/whoami HTTP/1.1\r\nCookie: {cookie}"),
            "",
        )
    };
    get(chosen).expect(401);
    assert_eq!(get(&cookie).expect(200).json()["name"], "ann");
    // A foreign page can make a browser send the cookie, but not the header, and is identified by
    // its origin.
    let hold = |more: &str| {
        asked(
            &served,
            &format!("POST /api/v1/benches/demo/hold HTTP/1.1\r\nCookie: {cookie}{more}"),
            "",
        )
    };
    assert_eq!(hold("").expect(403).json()["code"], "forged");
    assert_eq!(
        hold("\r\nX-Eis-Bench: page\r\nOrigin: https://evil.example")
            .expect(403)
            .json()["code"],
        "other_origin"
    );
    hold("\r\nX-Eis-Bench: page").expect(200);
    let stop = format!("POST /api/v1/stop HTTP/1.1\r\nCookie: {cookie}");
    asked(&served, &stop, "").expect(403);
    sign_in("\r\nOrigin: https://evil.example", &secret).expect(403);
    // A wrong token ends nothing.
    sign_in(&format!("\r\nCookie: {cookie}"), "eb_wrong").expect(401);
    get(&cookie).expect(200);
    // Signing in again ends the session before; signing out ends it, and so does revoking the token.
    let second = cookie_of(&sign_in(&format!("\r\nCookie: {cookie}"), &secret).expect(200));
    get(&cookie).expect(401);
    let sign_out = |more: &str| {
        let head = format!("DELETE /api/v1/session HTTP/1.1\r\nCookie: {second}{more}");
        asked(&served, &head, "")
    };
    sign_out("").expect(403);
    get(&second).expect(200);
    sign_out("\r\nX-Eis-Bench: page").expect(204);
    get(&second).expect(401);
    let third = cookie_of(&sign_in("", &secret).expect(200));
    get(&third).expect(200);
    let file = files.path("serve.toml");
    program(&[
        "token".as_ref(),
        "revoke".as_ref(),
        file.as_os_str(),
        "ann".as_ref(),
    ])
    .expect_code(0);
    token(&files, "ben", "read");
    get(&third).expect(401);
}

#[test]
fn who_lets_a_queue_go_on_and_why_is_kept() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    served
        .post("/benches/demo/hold", r#"{"why":"cell is warm"}"#)
        .expect(200);
    served
        .post("/benches/demo/release", r#"{"why":"it has cooled down"}"#)
        .expect(200);
    let notes = served.get("/benches/demo/notes");
    assert_eq!(
        notes[0]["text"],
        "released: it has cooled down; it was held: cell is warm (local)"
    );
    assert_eq!(notes[0]["by"], "local");
}

/// Answer to the bytes of a file of this name.
fn bytes_of(name: &str) -> String {
    format!("name={name} HTTP/1.1\r\nContent-Type: application/octet-stream")
}

/// Posts the bytes of a file to be read, with more lines in the head.
fn send_file(served: &Served, head: &str, bytes: &[u8]) -> crate::serve_support::Answer {
    let lines = format!(
        "POST /api/v1/spectra/read?{head}\r\nHost: {}\r\nConnection: close\r\n\
        Content-Length: {}\r\n\r\n",
        served.address,
        bytes.len()
    );
    served.raw(&[lines.as_bytes(), bytes].concat())
}

#[test]
fn a_file_that_would_take_all_memory_ends_neither_the_server_nor_another_request() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    // 19 million fields, of which the decoder has two lists.
    let row = "<table:table-row><table:table-cell table:number-columns-repeated=\"16384\" \
               office:value-type=\"float\" office:value=\"1\"/></table:table-row>";
    let kind = "application/vnd.oasis.opendocument.spreadsheet";
    let sheet = format!(
        "<office:document office:mimetype=\"{kind}\"><office:body><office:spreadsheet><table:table \
         table:name=\"S\">{}</table:table></office:spreadsheet></office:body></office:document>",
        row.repeat(1180)
    );
    let refused = send_file(&served, &bytes_of("wide.fods"), sheet.as_bytes()).expect(422);
    assert!(
        refused.text().contains("found one that needs more"),
        "{}",
        refused.text()
    );
    // Two cells in opposite corners of the largest sheet that there is are two cells.
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/extent.xlsx");
    let bytes = fs::read(data).unwrap();
    let refused = send_file(&served, &bytes_of("extent.xlsx"), &bytes).expect(422);
    assert!(
        refused.text().contains("extent.xlsx [")
            && refused.text().contains("expected three numbers"),
        "{}",
        refused.text()
    );
    served.get("/benches/demo");
}

#[test]
fn a_file_of_another_program_is_read_to_be_compared_and_not_kept() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let vendors = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/data/spectra/vendors");
    let names = [
        "autolab.txt",
        "biologic.mpr",
        "biologic.mpt",
        "gamry.DTA",
        "impedance_py.csv",
        "sheets.xlsx",
        "zahner.ism",
        "zplot.z",
    ];
    for name in names {
        let path = vendors.join(name);
        let bytes = fs::read(&path).unwrap();
        let reply = send_file(&served, &bytes_of(name), &bytes)
            .expect(200)
            .json();
        let expected = formats::read_file(&path).unwrap();
        let notes = reply["notes"].as_array().unwrap();
        assert_eq!(notes.len(), expected.notes.len(), "{name}: {notes:?}");
        let spectra = reply["spectra"].as_array().unwrap();
        assert_eq!(spectra.len(), expected.spectra.len(), "{name}");
        for (one, expected) in spectra.iter().zip(&expected.spectra) {
            assert_eq!(one["name"], json!(expected.spectrum.name));
            let points = one["points"].as_array().unwrap();
            assert_eq!(points.len(), expected.spectrum.points.len(), "{name}");
            for (point, expected) in points.iter().zip(&expected.spectrum.points) {
                let same = |key: &str, value: f64| {
                    let found = number(&point[key]);
                    assert!(
                        (found - value).abs() <= 1e-12 * value.abs(),
                        "{name}: {key}"
                    );
                };
                same("freq_hz", expected.freq_hz);
                same("re_ohm", expected.z_ohm.re);
                same("im_ohm", expected.z_ohm.im);
            }
        }
    }
    let kept = fs::read_dir(files.path("data")).unwrap();
    for entry in kept {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(!names.contains(&name.as_str()), "{name}");
    }
}

#[test]
fn a_file_that_cannot_be_compared_is_refused_with_its_name() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let refused = |head: &str, bytes: &[u8], status: u16| {
        let answer = send_file(&served, head, bytes).expect(status).json();
        answer["message"].as_str().unwrap().to_owned()
    };
    let message = refused(&bytes_of("broken.csv"), b"hello,world\n1,2\n", 422);
    assert!(
        message.starts_with("broken.csv, line 1: expected three numbers"),
        "{message}"
    );
    let message = refused(&bytes_of("empty.csv"), b"", 422);
    assert!(message.starts_with("empty.csv: expected"), "{message}");
    for name in ["..%2Fx.csv", "a%2Fb.csv", "", "a%0Ab.csv"] {
        let message = refused(&bytes_of(name), b"1,2,3\n", 400);
        assert!(message.starts_with("name: expected"), "{message}");
    }
    let message = refused("name=a.csv HTTP/1.1", b"1,2,3\n", 415);
    assert_eq!(
        message,
        "Content-Type: expected application/octet-stream, found none"
    );
    // Longer than other bodies may be, but still accepted.
    let mut text = "# a comment\n".repeat(30_000);
    text += "freq_hz,z_re_ohm,z_im_ohm\n10,0.02,-0.001\n1,0.03,-0.002\n";
    let answer = send_file(&served, &bytes_of("long.csv"), text.as_bytes()).expect(200);
    assert_eq!(answer.json()["spectra"][0]["points"][0]["freq_hz"], 1.0);
    let too_long = format!(
        "POST /api/v1/spectra/read?{}\r\nHost: {}\r\nContent-Length: 8000001\r\n\r\n",
        bytes_of("long.csv"),
        served.address
    );
    let answer = served.raw(too_long.as_bytes()).expect(413);
    assert_eq!(answer.json()["code"], "too_large");
}

#[test]
fn a_file_is_read_for_whoever_may_look_and_for_no_page_of_elsewhere() {
    let files = Files::demo();
    config(&files, "");
    let secret = token(&files, "ann", "read");
    let served = Served::start(&files);
    let body = json!({ "token": secret }).to_string();
    let sign_in = "POST /api/v1/session HTTP/1.1\r\nContent-Type: application/json";
    let cookie = cookie_of(&asked(&served, sign_in, &body).expect(200));
    let send = |more: &str| {
        let head = format!("{}{more}", bytes_of("a.csv"));
        let text = b"freq_hz,z_re_ohm,z_im_ohm\n10,0.02,-0.001\n1,0.03,-0.002\n";
        send_file(&served, &head, text)
    };
    assert_eq!(send("").expect(401).json()["code"], "unauthorised");
    let session = format!("\r\nCookie: {cookie}");
    assert_eq!(send(&session).expect(403).json()["code"], "forged");
    send(&format!("{session}\r\nX-Eis-Bench: page")).expect(200);
    send(&format!("\r\nAuthorization: Bearer {secret}")).expect(200);
}
