//! The closed loop on the simulated bench: an effect is put into the world, and the workflow, which sees files alone, is to find it.
//!
//! `EIS_BENCH_INVESTIGATE=all` plays every case and prints how each ended; `EIS_BENCH_INVESTIGATE=104,118` plays these seeds; without it two are
//! played. With `EIS_BENCH_KEEP` the run folders stay in that folder.

use std::{fmt::Write as _, fs};

use analysis::diagnosis::Verdict;
use bench_daemon::{
    config::load_experiment,
    investigation::{Budget, End, Investigation, Means, investigate},
};

/// What is hidden: a seed, what is put into the scenario, and the names that say what it is; none where nothing is hidden.
struct Hidden {
    seed: u64,
    scenario: &'static str,
    names: &'static [&'static str],
}

const CASES: [Hidden; 27] = [
    Hidden { seed: 101, scenario: "", names: &[] },
    Hidden { seed: 102, scenario: "", names: &[] },
    Hidden { seed: 121, scenario: "", names: &[] },
    Hidden { seed: 122, scenario: "", names: &[] },
    Hidden { seed: 123, scenario: "", names: &[] },
    Hidden { seed: 124, scenario: "", names: &[] },
    Hidden { seed: 125, scenario: "", names: &[] },
    Hidden { seed: 103, scenario: "[effects.arrhenius]\nenergy_j_per_mol = 1500\nreference_c = 25", names: &["self_heating"] },
    Hidden { seed: 104, scenario: "[effects.slow_rc]\nr_ohm = 3e-4\ntau_s = 200", names: &["rc_slow"] },
    Hidden { seed: 105, scenario: "[effects.slow_rc]\nr_ohm = 2e-4\ntau_s = 150", names: &["rc_slow"] },
    Hidden { seed: 106, scenario: "[effects.diffusion]\nr_ohm = 1e-4\ntau_s = 1000", names: &["diffusion"] },
    Hidden { seed: 107, scenario: "[effects.diffusion]\nr_ohm = 2e-4\ntau_s = 600", names: &["diffusion"] },
    Hidden { seed: 108, scenario: "[effects.butler_volmer]\nbranch = 1\nalpha = 0.5", names: &["butler_volmer"] },
    Hidden { seed: 109, scenario: "[effects.butler_volmer]\nbranch = 2\nalpha = 0.35", names: &["butler_volmer_asymmetric"] },
    Hidden { seed: 110, scenario: "[effects.entropy]\nv_per_k = 1e-4\nreference_c = 25", names: &["entropic_heat"] },
    Hidden { seed: 111, scenario: "[effects.hysteresis]\nhalf_width_v = 8e-4\nrate = 30", names: &["hysteresis"] },
    Hidden { seed: 112, scenario: "[effects.arrhenius]\nenergy_j_per_mol = 6000\nreference_c = 25", names: &["self_heating"] },
    Hidden { seed: 113, scenario: "[effects.soc_resistance]\nslope = -0.05\nreference_soc = 0.5", names: &["soc_resistance"] },
    Hidden { seed: 114, scenario: "[effects.asymmetry]\nexcess = 0.01", names: &["current_asymmetry"] },
    Hidden { seed: 115, scenario: "[effects.asymmetry]\nexcess = -0.02", names: &["current_asymmetry"] },
    Hidden { seed: 116, scenario: "[effects.self_discharge]\ncurrent_a = 0.01", names: &["self_discharge"] },
    Hidden { seed: 117, scenario: "[effects.ageing]\nper_hour = 0.002", names: &["ageing"] },
    Hidden { seed: 118, scenario: "[effects.inductance]\nl_h = 5e-8", names: &["inductance"] },
    Hidden { seed: 119, scenario: "[effects.after_controls]\njig_zero_v_per_h = 1e-3", names: &["thermal_emf"] },
    Hidden { seed: 120, scenario: "capacity_ah = 4.45", names: &["ocv_slope"] },
    Hidden { seed: 126, scenario: "[effects.entropy]\nv_per_k = -3e-4\nreference_c = 25", names: &["entropic_heat"] },
    Hidden { seed: 127, scenario: "[effects.depressed_arc]\nbranch = 3\nalpha = 0.9", names: &["cpe"] },
];

/// How a case ended against what was hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Score {
    /// The floor where nothing is hidden, else the one name.
    Right,
    /// Several names, or one that is not certain.
    Ambiguous,
    /// Something is missing, and it has no name.
    Unexplained,
    /// The floor although something is hidden.
    Missed,
    /// Another name, for certain.
    Wrong,
}

fn play(case: &Hidden) -> (Score, Investigation) {
    let mut folder = tempfile::tempdir().unwrap();
    if let Some(kept) = std::env::var_os("EIS_BENCH_KEEP") {
        folder = tempfile::Builder::new().prefix(&format!("case{}_", case.seed)).disable_cleanup(true).tempdir_in(kept).unwrap();
    }
    for name in ["experiments/investigate.toml", "experiments/investigate_profile.csv", "benches/investigate.toml", "cells/p45b.toml"] {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::copy(crate::configuration::configs().join(name), path).unwrap();
    }
    let scenario = fs::read_to_string(crate::configuration::configs().join("scenarios/investigate.toml")).unwrap();
    fs::create_dir_all(folder.path().join("scenarios")).unwrap();
    let hidden = if case.scenario.starts_with('[') {
        format!("{scenario}\n{}\n", case.scenario)
    } else {
        scenario.replace("[cell]\n", &format!("[cell]\n{}\n", case.scenario))
    };
    fs::write(folder.path().join("scenarios/investigate.toml"), hidden).unwrap();
    let mut experiment = load_experiment(&folder.path().join("experiments/investigate.toml"), None).unwrap();
    experiment.seed = case.seed;
    let out = folder.path().join("out");
    let means = Means { out: &out, ocv: experiment.cell.ocv.clone().unwrap(), budget: Budget { minutes: 600.0, charge_ah: 30.0 } };
    let investigation = investigate(&experiment, &means).unwrap_or_else(|error| panic!("{}: {error}", case.scenario));
    for name in ["investigation.json", "investigation.md", "model.json", "dataset/dataset.toml", "campaign/traces.json"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    (score(case, &investigation), investigation)
}

fn score(case: &Hidden, investigation: &Investigation) -> Score {
    let diagnosis = &investigation.diagnosis;
    let named: Vec<&str> = diagnosis.effects.iter().map(|effect| effect.name).collect();
    match diagnosis.verdict {
        Verdict::AtNoiseFloor if case.names.is_empty() => Score::Right,
        Verdict::Explained if named.len() == 1 && case.names.contains(&named[0]) => Score::Right,
        Verdict::AtNoiseFloor => Score::Missed,
        Verdict::Explained => Score::Wrong,
        Verdict::Ambiguous => Score::Ambiguous,
        Verdict::Unexplained | Verdict::Invalid => Score::Unexplained,
    }
}

/// One line of the table.
fn line(case: &Hidden, score: Score, investigation: &Investigation) -> String {
    let mut text = format!("{:3} {score:11?} {:45}", case.seed, case.scenario.replace('\n', " "));
    for step in &investigation.steps {
        let bought = step.bought.as_ref().map_or("campaign", |bought| bought.experiment.name);
        let _ = write!(text, " | {bought}: {:?} {:?} or {:?}", step.verdict, step.effects, step.rivals);
    }
    let quality = &investigation.diagnosis.quality;
    let _ = write!(text, " | z {:.1} → {:.1} | {:?}: {}", quality.base_z, quality.augmented_z, investigation.end, investigation.end_text);
    text
}

#[test]
fn nothing_hidden_ends_at_the_floor_and_what_is_hidden_is_found() {
    let which = std::env::var("EIS_BENCH_INVESTIGATE").unwrap_or_else(|_| "101,103".to_owned());
    let wanted = |case: &&Hidden| which == "all" || which.split(',').any(|seed| seed == case.seed.to_string());
    let played: Vec<(&Hidden, Score, Investigation)> = CASES
        .iter()
        .filter(wanted)
        .map(|case| {
            let (score, investigation) = play(case);
            eprintln!("{}", line(case, score, &investigation));
            (case, score, investigation)
        })
        .collect();
    let count = |wanted: Score| played.iter().filter(|(_, score, _)| *score == wanted).count();
    let scores = [Score::Right, Score::Ambiguous, Score::Unexplained, Score::Missed, Score::Wrong];
    eprintln!("{}", scores.map(|score| format!("{score:?} {}", count(score))).join(", "));
    assert_eq!(count(Score::Wrong), 0);
    for (case, score, investigation) in played.iter().filter(|(case, ..)| [101, 103].contains(&case.seed)) {
        let named: Vec<&str> = investigation.diagnosis.effects.iter().map(|effect| effect.name).collect();
        let told = line(case, *score, investigation);
        assert!(case.names.iter().all(|name| named.contains(name)), "{told}");
        assert_eq!(investigation.end == End::AtNoiseFloor, case.names.is_empty(), "{told}");
    }
}
