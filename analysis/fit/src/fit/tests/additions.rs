//! Additions in model files: written, read back, refused.

use super::exact;
use crate::fit::{Addition, AdditionEvidence, AdditionParameter, FitOptions, ModelFile, fit_erm};
use analysis_effects::contract::{Facts, Group, HeldOutError};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};

const FACTS: Facts = Facts {
    lowest_hz: Some(0.1),
    highest_hz: Some(300.0),
    longest_s: 40.0,
    // As without records.
    shortest_s: f64::INFINITY,
    greatest_a: 40.0,
    widest_soc: 0.02,
    soc: 0.5,
    temperature_degc: 25.0,
    orders: 5.0,
    span_s: 3600.0,
    held_out: None,
};

fn plain() -> ModelFile {
    let fit = fit_erm(
        &[exact((0.007, &[(0.002, 50.0)]), 6)],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    ModelFile::new("a cell", fit, vec!["a".into()], None)
}

fn addition(name: &str, parameters: &[(&str, f64, &str)]) -> Addition {
    let parameter = |(name, value, unit): &(&str, f64, &str)| AdditionParameter {
        name: (*name).to_owned(),
        value: *value,
        sigma: Some(0.1 * value),
        unit: (*unit).to_owned(),
    };
    Addition {
        name: name.to_owned(),
        title: "words".to_owned(),
        group: Group::Cell,
        parameters: parameters.iter().map(parameter).collect(),
        evidence: AdditionEvidence {
            text: "records relax more slowly than the base".to_owned(),
            lambda: 120.0,
            score: 107.0,
            held_out_gap_before_v: Some(0.0045),
            held_out_gap_after_v: None,
        },
        data_set: "pulses".to_owned(),
        added_by: "eis-bench 0.1.0".to_owned(),
    }
}

fn with(additions: Vec<Addition>) -> ModelFile {
    let ocv = OcvCurve::monotone(4.5, vec![0.0, 0.5, 1.0], vec![3.0, 3.7, 4.2]).unwrap();
    let erm = Erm {
        r_ohm: 0.008,
        branches: vec![RcBranch {
            r_ohm: 0.002,
            c_f: 60.0,
        }],
    };
    ModelFile {
        ocv: Some(ocv),
        ..plain().with_additions(erm, FACTS, additions)
    }
}

fn slow() -> Addition {
    addition("rc_slow", &[("r_ohm", 1e-3, "Ω"), ("tau_s", 20.0, "s")])
}

#[test]
fn additions_are_read_back_with_their_provenance() {
    let file = with(vec![
        slow(),
        addition("current_gain", &[("gain", 0.02, "")]),
    ]);
    let back = ModelFile::from_json(&file.to_json().unwrap()).unwrap();
    assert_eq!(
        (&back.additions, back.facts, back.schema_version),
        (&file.additions, Some(FACTS), 2)
    );
    let cell = back.augmented().unwrap().unwrap();
    assert_eq!(
        (cell.base.erm.r_ohm, cell.kept[0].p.as_slice()),
        (0.008, [1e-3, 20.0].as_slice())
    );
    assert_eq!(cell.left_out(), ["gain error of the current channel"]);
    // The uncertainties of the first fit belong to another base.
    assert!(
        back.fit.log_covariance.is_none() && back.fit.sigma.r_ohm.is_none() && back.pack.is_none()
    );
}

#[test]
fn a_file_without_additions_is_what_it_was() {
    let text = plain().to_json().unwrap();
    assert!(
        !text.contains("additions")
            && !text.contains("facts")
            && text.contains("\"schema_version\": 1"),
        "{text}"
    );
    assert_eq!(
        ModelFile::from_json(&text).unwrap().augmented().unwrap(),
        None
    );
}

#[test]
fn additions_that_the_catalogue_does_not_know_are_refused() {
    let refused = |file: ModelFile| {
        ModelFile::from_json(&file.to_json().unwrap())
            .unwrap_err()
            .to_string()
    };
    let value = |v: f64| {
        with(vec![addition(
            "rc_slow",
            &[("r_ohm", 1e-3, "Ω"), ("tau_s", v, "s")],
        )])
    };
    let cases = [
        (
            with(vec![addition("magic", &[])]),
            "expected the name of an effect of the catalogue (`eis-bench effects` lists it), \
            met \"magic\"",
        ),
        (
            with(vec![addition("rc_slow", &[("r_ohm", 1e-3, "Ω")])]),
            "rc_slow: expected the parameters r_ohm, tau_s, met r_ohm",
        ),
        (
            with(vec![addition("current_gain", &[("offset_a", 1e-3, "A")])]),
            "current_gain: expected the parameters gain, met offset_a",
        ),
        (
            value(-1.0),
            "rc_slow: tau_s: expected a finite number above 0, met -1",
        ),
        (
            ModelFile {
                ocv: None,
                ..with(vec![slow()])
            },
            "expected beside them ocv, the OCV curve of the model, met none",
        ),
        (
            ModelFile {
                facts: Some(Facts {
                    held_out: Some(HeldOutError {
                        runs: 2,
                        share: -0.1,
                    }),
                    ..FACTS
                }),
                ..with(vec![slow()])
            },
            "expected facts.held_out with 1 run or more and a share of 0 or more, met 2 and -0.1",
        ),
        (
            ModelFile {
                facts: None,
                ..with(vec![slow()])
            },
            "expected beside them facts, what the data of the additions reach, met none",
        ),
    ];
    for (file, text) in cases {
        assert_eq!(refused(file), format!("model file: additions: {text}"));
    }
}
