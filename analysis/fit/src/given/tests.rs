//! Reading of model files of every kind.

use super::*;
use analysis_model::model::RcBranch;

const PLAIN: &str = r#"{"r_ohm": 0.00643,
    "branches": [{"r_ohm": 0.00151, "c_f": 0.553}, {"r_ohm": 0.00477, "c_f": 1084.0}]}"#;

fn read(text: &str) -> GivenModel {
    GivenModel::from_json(text, "file", None).unwrap()
}

fn refused(text: &str) -> String {
    GivenModel::from_json(text, "file", None)
        .unwrap_err()
        .to_string()
}

#[test]
fn resistances_and_capacitances_are_a_model_without_more() {
    let model = read(PLAIN);
    assert!(
        model.name == "file"
            && model.erm.r_ohm == 0.00643
            && model.erm.branches[1]
                == RcBranch {
                    r_ohm: 0.00477,
                    c_f: 1084.0
                }
    );
    assert!(
        model.ocv.is_none()
            && model.log_covariance.is_none()
            && model.additions.is_empty()
            && model.ladder.is_none()
    );
    assert!(
        model.notes().join("\n").contains("it has no uncertainty"),
        "{:?}",
        model.notes()
    );
    assert_eq!(read(&model.to_json().unwrap()), model);
    assert_eq!(GivenModel::typed("file", model.erm.clone()).unwrap(), model);
    assert!(
        read(r#"{"r_ohm": 0.01, "branches": []}"#)
            .erm
            .branches
            .is_empty()
    );
}

#[test]
fn what_is_not_a_model_is_refused_with_what_was_expected() {
    for (text, expected) in [
        ("nothing", "expected a model as JSON: expected ident"),
        (
            "[]",
            "expected a model file (schema, …), a typed model {\"r_ohm\": …",
        ),
        (
            r#"{"capacity_ah": 4.5, "soc": []}"#,
            "or a fitted circuit (circuit.json: fits, …), met the fields capacity_ah, soc",
        ),
        (
            r#"{"r_ohm": 0.01}"#,
            "typed model: missing field `branches`",
        ),
        (
            r#"{"r_ohm": 0.01, "branches": [{"r_ohm": 1}]}"#,
            "typed model: missing field `c_f`",
        ),
        (
            r#"{"r_ohm": 0.01, "branches": [], "l_h": 1e-8}"#,
            "typed model: unknown field `l_h`, expected one of",
        ),
        (
            r#"{"r_ohm": 0, "branches": []}"#,
            "typed model: R of the ERM: expected a positive finite number in Ω, met 0",
        ),
        (
            r#"{"r_ohm": 0.01, "branches": [], "map": {"charge_transfer":
                {"exchange_current_a": 2.0, "activation_j_per_mol": 3e4, "slowest_s": 3.0}}}"#,
            "which an earlier version wrote: fit the map again",
        ),
        (
            r#"{"r_ohm": 0.01, "branches": [], "map": {"charge_transfer": {"slowest_s": 3.0}}}"#,
            "charge_transfer: expected voltage_v, met none",
        ),
        (
            r#"{"r_ohm": 0.01, "branches": [], "log_covariance": [[1, 2]]}"#,
            "log_covariance: expected 1 rows and columns",
        ),
        (
            r#"{"fits": []}"#,
            "fits: expected one fitted circuit, met 0",
        ),
        (
            r#"{"fits": [{"rc": 1, "r_ohm": 1}]}"#,
            "take the model_Nrc.json that `fit --out` writes",
        ),
        (
            r#"{"fits": [{"circuit": "R0-Q1", "values": []}]}"#,
            "(did you mean CPE?)",
        ),
        (
            r#"{"fits": [{"circuit": "R0-C1"}]}"#,
            "fitted circuit: missing field `values`",
        ),
        (
            r#"{"fits": [{"circuit": "R0-CPE1", "values": [1, 1, 0.5]}]}"#,
            "expected the field band_hz",
        ),
        (r#"{"schema": "another"}"#, "schema"),
    ] {
        let met = refused(text);
        assert!(met.contains(expected), "{text}: {met}");
    }
    let met = GivenModel::from_json(PLAIN, "file", Some((1.0, 2.0)))
        .unwrap_err()
        .to_string();
    assert!(met.contains("expected a fitted circuit to follow"), "{met}");
}

#[test]
fn a_circuit_of_rc_carries_its_uncertainty_and_a_ladder_says_that_it_has_none() {
    let text = r#"{"fits": [{"circuit": "R0-p(R1,C1)", "values": [0.01, 0.002, 5],
        "band_hz": [0.1, 1000], "warnings": ["short"],
        "covariance": [[1e-8, 0, 0], [0, 4e-10, 1e-6], [0, 1e-6, 0.25]], "rms_ohm": 1e-6}]}"#;
    let model = read(text);
    let covariance = model.log_covariance.clone().unwrap();
    assert!(
        (covariance[0][0] - 1e-4).abs() < 1e-15
            && (covariance[1][2] - 1e-4).abs() < 1e-15
            && (covariance[2][2] - 0.01).abs() < 1e-15
    );
    assert!(
        model.name == "R0-p(R1,C1)" && model.warnings == ["short"] && model.notes().len() == 1,
        "{:?}",
        model.notes()
    );
    // Held parameters have no covariance, and then there is none of the whole.
    assert!(read(&text.replace("0.25", "null")).log_covariance.is_none());
    let ladder = read(
        r#"{"circuit": "R0-p(R1,CPE1)", "values": [0.01, 0.002, 5, 0.8], "band_hz": [0.1, 1000]}"#,
    );
    assert!(
        ladder
            .notes()
            .iter()
            .any(|note| note.contains("the ladder has no uncertainty")),
        "{:?}",
        ladder.notes()
    );
    // The written text is read back, with the error of the ladder.
    assert_eq!(read(&ladder.to_json().unwrap()), ladder);
}

#[test]
fn additions_to_a_typed_model_are_written_and_read_again() {
    let text = r#"{"r_ohm": 0.01, "branches": [],
        "ocv": {"capacity_ah": 4.5, "soc": [0, 1], "ocv_v": [3.0, 4.2], "slope_v": [1.2, 1.2]},
        "facts": {"lowest_hz": 0.1, "highest_hz": 300, "longest_s": 60, "shortest_s": 0.1,
            "greatest_a": 40, "widest_soc": 0.1, "soc": 0.5, "temperature_c": 25, "orders": 0,
            "span_s": 0},
        "additions": [{"name": "current_gain", "title": "gain error", "group": "bench",
            "data_set": "d", "added_by": "a",
            "parameters": [{"name": "gain", "value": 0.02, "sigma": null, "unit": ""}],
            "evidence": {"text": "a test", "lambda": 100, "score": 90,
                "held_out_gap_before_v": null, "held_out_gap_after_v": null}}]}"#;
    let found = read(text);
    assert!(found.augmented().unwrap().is_some());
    let circuit = read(
        r#"{"circuit": "R0-p(R1,CPE1)", "values": [0.01, 0.002, 5, 0.8], "band_hz": [0.1, 1000]}"#,
    );
    let base = circuit.clone().with_ocv(found.ocv.clone());
    let augmented = base.with_additions(circuit.erm, found.facts.unwrap(), found.additions);
    assert!(
        augmented.ladder.is_none(),
        "a base that was refitted follows the circuit no more"
    );
    assert_eq!(read(&augmented.to_json().unwrap()), augmented);
}

/// A model of one point whose diagnosis used data at half charge and 25 °C.
#[test]
fn the_distance_from_the_data_names_only_what_is_known() {
    let mut model = read(PLAIN);
    assert!(
        model
            .away_note(&[0.2], &[])
            .unwrap()
            .contains("does not state")
    );
    let facts = r#"{"lowest_hz": 0.1, "highest_hz": 300, "longest_s": 60, "shortest_s": 0.1,
        "greatest_a": 40, "widest_soc": 0.1, "soc": 0.5, "temperature_c": 25, "orders": 0,
        "span_s": 0}"#;
    model.facts = Some(serde_json::from_str(facts).unwrap());
    let start = "the data of the model's diagnosis lie at ";
    let end = " away, with the resistances found there";
    for (soc, degc, text) in [
        (
            &[0.2, 0.9][..],
            &[][..],
            "SOC 0.50; it is used up to 0.40 of charge",
        ),
        (&[], &[15.0], "25.0 °C; it is used up to 10.0 K"),
        (
            &[0.5, 0.6],
            &[25.0],
            "SOC 0.50 and 25.0 °C; it is used up to 0.10 of charge and 0.0 K",
        ),
    ] {
        assert_eq!(
            model.away_note(soc, degc).unwrap(),
            format!("{start}{text}{end}")
        );
    }
    assert_eq!(model.away_note(&[0.5], &[]), None);
    assert_eq!(model.away_note(&[], &[]), None);
}
