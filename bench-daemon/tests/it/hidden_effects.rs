//! Diagnoses of data sets in which a program outside the project has hidden one effect. The sets
//! stand in a folder `shared` beside the project; without it these tests are skipped.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{program, shared_data};

/// Returns the folder of a set, or `None` without it.
fn hidden(set: &str) -> Option<PathBuf> {
    shared_data(&format!("hidden/{set}"))
}

/// Returns the diagnosis of a set against a model of `rc` branches that is fitted to its spectra,
/// or `None` without the set.
fn diagnosed(set: &str, rc: &str) -> Option<Value> {
    let data = hidden(set)?;
    let out = tempfile::tempdir().unwrap();
    let model = fitted(&data, rc, out.path());
    let ocv = data.join("ocv.json");
    let mut words = vec![Path::new("diagnose"), &data, Path::new("--model"), &model];
    words.extend([Path::new("--ocv"), &ocv, Path::new("--json")]);
    Some(program(&words).json())
}

/// Fits a model of `rc` branches to the spectra of a set, and returns its file in `out`.
fn fitted(data: &Path, rc: &str, out: &Path) -> PathBuf {
    let spectra = [0, 1, 2, 3].map(|n| data.join(format!("eis{n}.csv")));
    let mut words: Vec<&Path> = vec![Path::new("fit")];
    words.extend(spectra.iter().map(PathBuf::as_path));
    words.extend(["--pool", "--rc", rc, "--out"].map(Path::new));
    words.push(out);
    program(&words).ok();
    out.join(format!("model_{rc}rc.json"))
}

fn names(diagnosis: &Value) -> Vec<&str> {
    let effects = diagnosis["effects"].as_array().unwrap();
    effects.iter().filter_map(|e| e["name"].as_str()).collect()
}

fn value(diagnosis: &Value, parameter: usize) -> f64 {
    diagnosis["effects"][0]["parameters"][parameter]["value"]
        .as_f64()
        .unwrap()
}

/// Asserts that a diffusion of this size explains a set.
#[track_caller]
fn assert_diffusion(d: &Value, r_ohm: f64, tau_s: f64) {
    assert_eq!(d["verdict"], "explained", "{}", d["summary"]);
    assert_eq!(names(d), ["diffusion"]);
    let found = [value(d, 0) / r_ohm, value(d, 1) / tau_s];
    assert!(
        found.iter().all(|part| (part - 1.0).abs() < 0.01),
        "{found:?} of the hidden values"
    );
}

/// The base stands with a branch where the first mode of the diffusion belongs, and no small step
/// leads out of that.
#[test]
#[ignore = "drill"]
fn a_diffusion_is_found_behind_a_branch_in_its_place() {
    for (set, r_ohm, tau_s) in [
        ("diffusion_71009", 6e-3, 20.0),
        ("diffusion_71007", 3e-3, 20.0),
    ] {
        let Some(d) = diagnosed(set, "4") else {
            return;
        };
        assert_diffusion(&d, r_ohm, tau_s);
    }
}

/// The series resistance of the spectra is a thousandth of the cell's. A contact in the records
/// needs it to grow while the contact comes, which one by one makes everything worse.
#[test]
fn a_contact_is_found_although_the_series_resistance_must_grow_a_thousandfold() {
    // With three and four branches the series resistance of these spectra is at its bound.
    let Some(d) = diagnosed("pm_contact0.005", "2") else {
        return;
    };
    assert_eq!(d["verdict"], "explained", "{}", d["summary"]);
    assert_eq!(names(&d), ["contact_resistance"]);
    assert!(
        (-5.2e-3..-4.5e-3).contains(&value(&d, 0)),
        "{}",
        value(&d, 0)
    );
    let gain = d["ranking"].as_array().unwrap().iter();
    let gain = gain.filter(|c| c["name"] == "current_gain");
    let lost = gain.map(|c| {
        d["effects"][0]["evidence"]["lambda"].as_f64().unwrap() - c["lambda"].as_f64().unwrap()
    });
    assert!(lost.min_by(f64::total_cmp).unwrap() > 100.0);
}

/// The bounds of a slope over charge come from typical cells; this cell's is steeper.
#[test]
#[ignore = "drill"]
fn an_effect_that_explains_almost_everything_moves_its_bound() {
    let Some(d) = diagnosed("soc_resistance_73052", "4") else {
        return;
    };
    assert_eq!(names(&d)[0], "soc_resistance", "{}", d["summary"]);
    assert_ne!(d["verdict"], "unexplained", "{}", d["summary"]);
    assert!(value(&d, 0) < -3.0, "{}", value(&d, 0));
    let caution = d["effects"][0]["parameters"][0]["caution"]
        .as_str()
        .unwrap();
    assert!(caution.contains("beyond the bounds"), "{caution}");
}

/// A factor that falls with the current is neither a gain nor another cell.
#[test]
fn a_scale_is_asked_for_each_current() {
    let Some(d) = diagnosed("pb_DFN_Chen2020_0.5_0.25_9041", "4") else {
        return;
    };
    let text = d["findings"][0]["text"].as_str().unwrap();
    assert!(
        text.contains("it falls from 0.97 at 1.250 A to 0.63 at 9.999 A"),
        "{text}"
    );
    assert!(!text.contains("another gain"), "{text}");
}

/// The model that the first diagnosis writes is the base of the second.
#[test]
fn a_diagnosis_goes_on_from_the_model_that_one_has_written() {
    let Some(data) = hidden("diffusion_75003") else {
        return;
    };
    let out = tempfile::tempdir().unwrap();
    let model = fitted(&data, "4", out.path());
    let [ocv, first] = [data.join("ocv.json"), out.path().join("first")];
    let mut words = vec![Path::new("diagnose"), &data, Path::new("--model"), &model];
    words.extend([Path::new("--ocv"), &ocv, Path::new("--out"), &first]);
    words.push(Path::new("--json"));
    assert_diffusion(&program(&words).json(), 5e-3, 12.0);
    let augmented = first.join("model_augmented.json");
    let words = [
        Path::new("diagnose"),
        &data,
        Path::new("--model"),
        &augmented,
    ];
    let again = |more: &[&str]| {
        let words: Vec<&Path> = words
            .iter()
            .copied()
            .chain(more.iter().map(Path::new))
            .collect();
        program(&words).json()
    };
    let second = again(&["--json"]);
    assert_eq!(second["verdict"], "at_noise_floor", "{}", second["summary"]);
    assert_eq!(second["given"][0]["name"], "diffusion");
    let without = again(&["--without", "diffusion", "--json"]);
    let by_hand = &without["by_hand"];
    let mv = |name: &str| by_hand[name].as_f64().unwrap();
    assert!(mv("after_mv") > 3.0 * mv("before_mv"), "{by_hand}");
}
