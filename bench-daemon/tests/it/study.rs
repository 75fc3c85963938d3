//! A share of the blind study. The whole one is `eis-bench study`; what it found is in
//! docs/study.md.

use bench_daemon::study::trial::{End, Score, play, strength_for};
use fixtures::hidden::{EffectKind, Spec, Stratum};

fn drawn(stratum: Stratum, seeds: std::ops::Range<u64>) -> Vec<Score> {
    seeds
        .map(|seed| play(stratum, &stratum.draw(seed), 0).unwrap())
        .collect()
}

#[test]
fn nothing_hidden_is_never_given_a_name() {
    for score in drawn(Stratum::Null, 500..512) {
        assert_eq!((score.end, score.named.len()), (End::None, 0), "{score:?}");
    }
}

#[test]
fn one_effect_is_named_alone_or_among_what_these_data_cannot_tell_apart() {
    let kinds = [
        EffectKind::Diffusion,
        EffectKind::ButlerVolmer,
        EffectKind::Heat,
        EffectKind::Hysteresis,
        EffectKind::ResistanceSoc,
        EffectKind::Inductance,
        EffectKind::CurrentOffset,
        EffectKind::ShuntHeating,
    ];
    for kind in kinds {
        let strength = strength_for(811, kind, 500.0).unwrap();
        let score = play(Stratum::Single, &Spec::single(811, kind, strength), 0).unwrap();
        assert!(
            score.lambda.is_some_and(|l| (300.0..800.0).contains(&l)),
            "{score:?}"
        );
        assert!(matches!(score.end, End::Right | End::Twin), "{score:?}");
        // Where there was a gap to close on held-out runs, it is closed as by someone who knew.
        assert!(score.closed.is_none_or(|share| share > 0.9), "{score:?}");
    }
}

/// What looks alike in all runs of a campaign is told by the run that is recommended.
#[test]
fn the_recommended_run_settles_what_these_data_cannot_tell() {
    for kind in [EffectKind::Inductance, EffectKind::SelfDischarge] {
        let strength = strength_for(813, kind, 300.0).unwrap();
        let score = play(Stratum::Single, &Spec::single(813, kind, strength), 1).unwrap();
        assert_eq!(score.end, End::Twin, "{score:?}");
        assert!(
            score.recommended.len() == 1 && score.recommended[0].settled == End::Right,
            "{score:?}"
        );
        assert_eq!(
            score.placebo,
            Some(End::None),
            "with nothing hidden the same run says nothing: {score:?}"
        );
    }
}

#[test]
fn what_the_catalogue_does_not_know_gets_no_certain_name() {
    for score in drawn(Stratum::Outside, 600..608) {
        assert!(
            matches!(
                score.end,
                End::None | End::Unexplained | End::Misled | End::Twin
            ),
            "{score:?}"
        );
    }
}

#[test]
fn damaged_files_are_refused() {
    for score in drawn(Stratum::Corrupted, 700..706) {
        assert_eq!(score.end, End::Invalid, "{score:?}");
    }
}

/// The voltage grows without limit where the salt ends, so that the linear test overshoots the
/// strength by far.
#[test]
fn a_strong_depletion_is_found_from_a_weaker_start_than_the_linear_test_wants() {
    for seed in 1..=4 {
        let score = play(
            Stratum::Single,
            &Spec::single(seed, EffectKind::Depletion, 1.6),
            0,
        )
        .unwrap();
        assert_eq!(score.end, End::Right, "{seed}: {score:?}");
    }
}
