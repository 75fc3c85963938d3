//! Diagnoses whose base has effects from the start.

use super::bench::{Hidden, campaign, model};
use crate::{ByHand, DiagnosisOptions, Verdict, diagnose::diagnose_with, guards::Guards};

#[test]
fn a_diagnosis_starts_from_what_a_diagnosis_has_found() {
    let hidden = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    let set = campaign(3, &hidden, &hidden);
    let diagnosed = |options: &DiagnosisOptions| {
        let outcome = diagnose_with(&set, &model(), options, Guards::default());
        outcome.map(|outcome| outcome.diagnosis)
    };
    let first = diagnosed(&DiagnosisOptions::default()).unwrap();
    let mut options = DiagnosisOptions {
        given: first.additions("test"),
        ..DiagnosisOptions::default()
    };
    let again = diagnosed(&options).unwrap();
    assert_eq!(
        (again.verdict, again.effects.len()),
        (Verdict::AtNoiseFloor, 0)
    );
    let [own] = again.given.as_slice() else {
        panic!("{:?}", again.given);
    };
    let [was, is] = [&first.effects[0].parameters[0], &own.parameters[0]];
    // The noise is estimated about another model.
    assert!(
        (was.value - is.value).abs() < was.sigma.unwrap(),
        "{was:?} {is:?}"
    );
    assert_eq!(again.additions("test").len(), 1, "it is not lost");
    options.by_hand.without = vec!["soc_resistance"];
    let without = diagnosed(&options).unwrap();
    let gap = without.by_hand.unwrap();
    assert!(gap.after_mv > gap.before_mv && gap.after_chi2 > gap.before_chi2 + 100.0);
    assert!(without.effects.iter().all(|e| e.name != "soc_resistance"));
    options.given[0].parameters.clear();
    let message = diagnosed(&options).unwrap_err().to_string();
    assert_eq!(
        message,
        "effect \"soc_resistance\": expected all parameters that the catalogue has"
    );
}

#[test]
fn an_effect_is_put_in_whatever_it_gains() {
    let set = campaign(1, &Hidden::default(), &Hidden::default());
    let options = DiagnosisOptions {
        by_hand: ByHand {
            add: vec!["rc_slow"],
            ..ByHand::default()
        },
        ..DiagnosisOptions::default()
    };
    let outcome = diagnose_with(&set, &model(), &options, Guards::default()).unwrap();
    let d = outcome.diagnosis;
    assert_eq!(d.given.len(), 1);
    let gap = d.by_hand.unwrap();
    assert_eq!(gap.added, ["rc_slow"]);
    assert!(gap.after_chi2 <= gap.before_chi2 && gap.before_chi2 - gap.after_chi2 < 30.0);
    assert_eq!(gap.gap.len(), d.gap.len());
}
