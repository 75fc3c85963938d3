//! The gate on data whose truth and damage come from another hand than its own tests.

use analysis::diagnosis::gate::{Expected, GateReport, gate};
use bench_daemon::study::convert;
use fixtures::hidden::{Case, Corruption, EffectKind, Spec};

fn look(spec: &Spec) -> GateReport {
    let case = Case::new(spec);
    let set = convert::data_set(&case);
    let model = convert::model(&set, &case.base).unwrap();
    gate(&set, &Expected::new(&set, &model))
}

#[test]
fn every_damage_is_found() {
    let missed: Vec<String> = Corruption::ALL
        .into_iter()
        .flat_map(|kind| (1..=4).map(move |seed| (kind, seed)))
        .filter(|(kind, seed)| {
            look(&Spec {
                corruption: Some(*kind),
                ..Spec::null(*seed)
            })
            .invalid
            .is_empty()
        })
        .map(|(kind, seed)| format!("{} of seed {seed}", kind.name()))
        .collect();
    assert!(missed.is_empty(), "{missed:#?}");
}

#[test]
fn no_effect_is_taken_for_damage() {
    let nulls = (1..=10).map(Spec::null);
    let singles = EffectKind::NAMED
        .into_iter()
        .flat_map(|kind| (1..=2).map(move |seed| Spec::single(seed, kind, 1.0)));
    let refused: Vec<String> = nulls
        .chain(singles)
        .map(|spec| {
            (
                spec.hidden
                    .first()
                    .map_or("nothing", |(kind, _)| kind.name()),
                spec.seed,
                look(&spec).invalid,
            )
        })
        .filter(|(_, _, invalid)| !invalid.is_empty())
        .map(|(kind, seed, invalid)| format!("{kind} of seed {seed}: {invalid:?}"))
        .collect();
    assert!(refused.is_empty(), "{refused:#?}");
}
