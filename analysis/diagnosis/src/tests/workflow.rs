use super::bench::{Hidden, campaign, model};
use crate::{DiagnosisOptions, Verdict, diagnose::diagnose_with, guards::Guards};

fn verdict(seed: u64, hidden: &Hidden) -> crate::Diagnosis {
    diagnose_with(
        &campaign(seed, hidden, hidden),
        &model(),
        &DiagnosisOptions::default(),
        Guards::default(),
    )
    .unwrap()
    .diagnosis
}

#[test]
fn nothing_hidden_nothing_named() {
    for seed in 1..=5 {
        let d = verdict(seed, &Hidden::default());
        assert_eq!(
            (d.verdict, d.effects.len()),
            (Verdict::AtNoiseFloor, 0),
            "seed {seed}: {} {:?}",
            d.summary,
            d.quality
        );
        let mean =
            |pick: fn(&crate::Gap) -> f64| d.gap.iter().map(|g| pick(g).powi(2)).sum::<f64>();
        let ratio = mean(|g| g.augmented_mv) / mean(|g| g.floor_mv);
        assert!(ratio < 2.0 && ratio > 0.3, "seed {seed}: {:?}", d.gap);
    }
}

#[test]
fn a_hidden_effect_is_found_with_its_size_and_closes_the_gap() {
    let hidden = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    let d = verdict(3, &hidden);
    assert_eq!(d.verdict, Verdict::Explained, "{}", d.summary);
    assert_eq!(
        d.effects.iter().map(|e| e.name).collect::<Vec<_>>(),
        ["soc_resistance"]
    );
    let k = &d.effects[0].parameters[0];
    assert!(
        k.interval.0 < -0.6 && -0.6 < k.interval.1 && k.sigma.unwrap() < 0.1,
        "{k:?}"
    );
    assert!(
        d.gap
            .iter()
            .all(|g| g.augmented_mv < 1.6 * g.floor_mv && g.base_mv > 1.5 * g.floor_mv),
        "{:?}",
        d.gap
    );
    // Before any name: the misfit is where charge has passed.
    assert!(
        d.blocks[0].p_value < 1e-6 && d.where_after.iter().all(|b| b.p_value > 1e-4),
        "{:?}",
        d.blocks[0]
    );
}

#[test]
fn without_repeats_no_floor_is_claimed() {
    let mut set = campaign(4, &Hidden::default(), &Hidden::default());
    let mut seen = std::collections::BTreeSet::new();
    set.runs.retain(|r| seen.insert(r.repeat_group.clone()));
    set.history = None;
    let d = diagnose_with(
        &set,
        &model(),
        &DiagnosisOptions::default(),
        Guards::default(),
    )
    .unwrap()
    .diagnosis;
    assert!(
        d.verdict != Verdict::AtNoiseFloor && !d.noise.from_repeats,
        "{:?}",
        d.verdict
    );
    assert!(
        d.notes
            .iter()
            .any(|n| n.contains("no noise floor can be claimed")),
        "{:?}",
        d.notes
    );
}

#[test]
fn a_missing_branch_is_found_from_a_base_that_imitates_it() {
    // The refitted base stretches one of its branches towards 47 s: from there no addition leads
    // back.
    let hidden = Hidden {
        slow: (8e-3, 47.0),
        ..Hidden::default()
    };
    let d = verdict(6, &hidden);
    let named: Vec<&str> = d.effects.iter().map(|e| e.name).collect();
    assert_eq!(
        (d.verdict, named),
        (Verdict::Explained, vec!["rc_slow"]),
        "{} {:?} {:?}",
        d.summary,
        d.rivals,
        d.ranking
    );
    let value = |k: usize| d.effects[0].parameters[k].value;
    assert!(
        (value(0) / 8e-3 - 1.0).abs() < 0.05 && (value(1) / 47.0 - 1.0).abs() < 0.05,
        "{:?}",
        d.effects[0].parameters
    );
}

#[test]
fn no_current_and_a_flat_curve_leave_nothing_to_look_for() {
    let mut model = model();
    model.ocv.ocv_v.iter_mut().for_each(|v| *v = 3.3);
    model.ocv.slope_v.iter_mut().for_each(|v| *v = 0.0);
    let base = analysis_effects::contract::Base {
        erm: model.erm,
        ocv: model.ocv,
        facts: analysis_effects::contract::Facts {
            widest_soc: 0.1,
            ..analysis_effects::contract::Facts::NONE
        },
    };
    for name in ["ocv_curvature", "current_offset"] {
        assert_eq!(
            super::super::structure::variants(
                analysis_effects::effects::find(name).unwrap(),
                &base
            )
            .len(),
            0,
            "{name}"
        );
    }
}
