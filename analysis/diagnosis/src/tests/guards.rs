//! Each guard: with it the workflow ends as it should, without it and it alone it does not.

use super::bench::{Hidden, campaign, model};
use crate::{
    DataSet, Diagnosis, DiagnosisOptions, Role, RunData, Verdict,
    block::Workspace,
    diagnose::{base_fit, diagnose_with},
    guards::Guards,
    outcome::Evidence,
    prepare::prepare,
    problem::Fit,
    progress::Progress,
    search::{Search, excess_z},
    select::{SelectedEffect, Selection},
};
use analysis_effects::effects::Mechanism;

fn with(set: &DataSet, guards: Guards) -> Diagnosis {
    diagnose_with(set, &model(), &DiagnosisOptions::default(), guards)
        .unwrap()
        .diagnosis
}

/// Effects that are named, or that stand for a named mechanism.
fn names(d: &Diagnosis) -> Vec<&'static str> {
    let effects = d.effects.iter().map(|e| e.name);
    let mechanisms = d.mechanisms().into_iter().flat_map(|s| s.effects.clone());
    effects.chain(mechanisms).collect()
}

#[test]
fn noise_of_the_current_channel_is_not_physics() {
    let mut false_names = 0;
    for seed in 20..26 {
        let set = campaign(seed, &Hidden::default(), &Hidden::default());
        assert_eq!(
            names(&with(&set, Guards::default())),
            [""; 0],
            "seed {seed}"
        );
        let off = Guards {
            current_channel_noise: false,
            sentinel: false,
            held_out: false,
            ..Guards::default()
        };
        let kept = Guards {
            current_channel_noise: true,
            ..off
        };
        assert_eq!(names(&with(&set, kept)), [""; 0], "seed {seed}");
        false_names += usize::from(!names(&with(&set, off)).is_empty());
    }
    assert!(false_names >= 3, "{false_names} of 6 without the guard");
}

#[test]
fn what_a_parameter_of_the_base_can_do_is_outside_the_score() {
    // The base's own resistances imitate most of many effects. Only the residual of an effect may
    // be compared.
    let hidden = Hidden {
        heat_per_j: 2e-4,
        ..Hidden::default()
    };
    let set = campaign(31, &hidden, &hidden);
    let on = with(&set, Guards::default());
    let off = with(
        &set,
        Guards {
            tangent_projection: false,
            ..Guards::default()
        },
    );
    let lagrange = |d: &Diagnosis, name: &str| {
        d.ranking
            .iter()
            .find(|c| c.name == name)
            .map_or(0.0, |c| c.lagrange)
    };
    let gain = on
        .ranking
        .iter()
        .map(|c| c.lagrange / lagrange(&off, c.name).max(1.0))
        .fold(0.0, f64::max);
    assert!(gain > 5.0, "{gain}");
    let expected = |d: &Diagnosis| {
        d.blocks
            .iter()
            .map(|b| b.expected_chi2 / b.count as f64)
            .fold(1.0, f64::min)
    };
    assert!(
        expected(&on) < 0.985 && expected(&off) == 1.0,
        "{} and {}",
        expected(&on),
        expected(&off)
    );
}

#[test]
fn held_out_runs_that_contradict_are_heard() {
    let set = campaign(
        41,
        &Hidden {
            per_soc: -0.6,
            ..Hidden::default()
        },
        &Hidden::default(),
    );
    let on = with(&set, Guards::default());
    assert!(
        names(&on).is_empty() && on.verdict == Verdict::Unexplained,
        "{:?} {}",
        names(&on),
        on.summary
    );
    let off = with(
        &set,
        Guards {
            held_out: false,
            ..Guards::default()
        },
    );
    assert_eq!(names(&off), ["soc_resistance"]);
}

/// Fits a base and the base with the effect that was hidden in the training runs, and returns what
/// a search makes of the two fits.
fn judged_by_records<T>(
    seed: u64,
    train: &Hidden,
    held_out: &Hidden,
    judge: impl Fn(&mut Search<'_>, [&Fit; 2]) -> T,
) -> T {
    let set = campaign(seed, train, held_out);
    let prepared = prepare(&set, &model(), Guards::default()).unwrap();
    let problem = &prepared.problem;
    let mut workspace = Workspace::default();
    let base = base_fit(problem, &model().erm, &mut workspace);
    let effect = analysis_effects::effects::find("soc_resistance").unwrap();
    let member = crate::structure::variants(effect, &problem.base).remove(0);
    let fit = problem.fit_added(&base, &member, false, &mut workspace);
    assert!(
        fit.chi2 < base.chi2 - 100.0,
        "the effect is in the training runs"
    );
    let mut search = Search {
        problem,
        candidates: &[],
        guards: Guards::default(),
        measured: true,
        progress: &Progress::default(),
        workspace,
    };
    judge(&mut search, [&base, &fit])
}

/// Returns an error that states whether the second fit misses the held-out records by more
/// millivolts.
fn worse_in_millivolts(seed: u64, train: &Hidden, held_out: &Hidden) -> Result<(), String> {
    judged_by_records(seed, train, held_out, |search, [base, fit]| {
        search.no_record_worse(base, fit)
    })
}

#[test]
fn a_name_that_predicts_worse_than_the_refit_is_only_a_lead() {
    let hidden = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    let withdrawn = |held_out: &Hidden| {
        judged_by_records(42, &hidden, held_out, |search, [base, fit]| {
            let evidence = Evidence {
                lambda: base.chi2 - fit.chi2,
                score: base.chi2 - fit.chi2,
                share_of_excess: 1.0,
                held_out_change: 0.0,
                integration_error: 0.0,
            };
            let mut selection = Selection {
                fit: fit.clone(),
                selected: vec![SelectedEffect::new("soc_resistance", evidence)],
                ..Selection::nothing(base)
            };
            search.withdraw_what_predicts_worse(&mut selection);
            assert_eq!(
                selection.selected.len(),
                selection.fit.structure.members.len()
            );
            selection.refused.map(|(name, _, reason)| (name, reason))
        })
    };
    assert_eq!(withdrawn(&hidden), None);
    let (name, reason) = withdrawn(&Hidden::default()).unwrap();
    assert!(
        name == "soc_resistance" && reason.contains(" mV to "),
        "{name} {reason}"
    );
}

#[test]
fn a_record_that_is_missed_by_more_millivolts_is_reported_by_name() {
    let hidden = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    assert_eq!(worse_in_millivolts(42, &hidden, &hidden), Ok(()));
    let message = worse_in_millivolts(42, &hidden, &Hidden::default()).unwrap_err();
    assert!(
        message.contains("becomes worse") && message.contains(" mV to "),
        "{message}"
    );
}

#[test]
fn what_makes_held_out_records_worse_predicts_nothing() {
    let train = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    let d = with(&campaign(41, &train, &Hidden::default()), Guards::default());
    let terms: Vec<&str> = d
        .predictive
        .iter()
        .flat_map(|p| p.terms.iter().map(|t| t.name))
        .collect();
    assert!(!terms.contains(&"soc_resistance"), "{terms:?}");
    let rms = |pick: fn(&crate::Gap) -> f64| {
        let gaps = d.predictive.iter().flat_map(|p| &p.gap);
        gaps.map(|g| pick(g).powi(2)).sum::<f64>()
    };
    assert!(rms(|g| g.augmented_mv) <= rms(|g| g.base_mv));
}

#[test]
fn mechanisms_are_named_where_no_formula_may_be() {
    let hidden = Hidden {
        slow: (3e-3, 30.0),
        ripple_v: 4e-3,
        ..Hidden::default()
    };
    let d = with(&campaign(43, &hidden, &hidden), Guards::default());
    // The ripple is a part of the OCV curve, but no formula of the catalogue is a sine.
    assert_eq!(d.verdict, Verdict::Mostly, "{}", d.summary);
    assert!(d.effects.is_empty(), "{}", d.summary);
    let mechanisms: Vec<Mechanism> = d.mechanisms().iter().map(|s| s.mechanism).collect();
    assert_eq!(mechanisms, [Mechanism::Transport, Mechanism::StoredCharge]);
    let predictive = d.predictive.unwrap();
    assert_eq!(predictive.claim, crate::PREDICTION_ONLY);
    let rms = |pick: fn(&crate::Gap) -> f64| {
        let squares = predictive.gap.iter().map(|g| pick(g).powi(2));
        (squares.sum::<f64>() / predictive.gap.len() as f64).sqrt()
    };
    let [base, with] = [rms(|g| g.base_mv), rms(|g| g.augmented_mv)];
    assert!(with < 0.7 * base, "{base} mV to {with} mV");
    assert!(
        predictive.terms.iter().all(|t| !t.stands_for.is_empty())
            && predictive.range.greatest_a > 0.0
    );
}

#[test]
fn a_small_help_is_not_a_name() {
    let hidden = Hidden {
        ripple_v: 8e-3,
        ..Hidden::default()
    };
    let set = campaign(51, &hidden, &hidden);
    let kept = Guards {
        held_out: false,
        outside: false,
        ..Guards::default()
    };
    let on = with(&set, kept);
    let off = with(
        &set,
        Guards {
            material_share: false,
            ..kept
        },
    );
    assert_eq!(
        (on.verdict, names(&on).len()),
        (Verdict::Unexplained, 0),
        "{:?}",
        names(&on)
    );
    assert!(!names(&off).is_empty(), "{:?}", off.ranking);
}

#[test]
fn repeats_that_disagree_stop_everything() {
    let hidden = Hidden {
        telegraph_ohm: 4e-4,
        ..Hidden::default()
    };
    let set = campaign(61, &hidden, &hidden);
    let on = with(&set, Guards::default());
    assert_eq!((on.verdict, names(&on).len()), (Verdict::Unexplained, 0));
    assert!(
        on.summary.contains("The noise floor itself moved"),
        "{} {:?}",
        on.summary,
        on.noise
    );
    let off = with(
        &set,
        Guards {
            sentinel: false,
            ..Guards::default()
        },
    );
    assert!(
        !off.summary.contains("The noise floor itself moved"),
        "{}",
        off.summary
    );
}

#[test]
fn where_the_floor_moved_predictions_are_still_offered() {
    let hidden = Hidden {
        telegraph_ohm: 4e-4,
        slow: (6e-3, 30.0),
        ..Hidden::default()
    };
    let d = with(&campaign(61, &hidden, &hidden), Guards::default());
    assert!(
        d.summary.contains("The noise floor itself moved"),
        "{}",
        d.summary
    );
    assert_eq!(names(&d), [""; 0]);
    let predictive = d.predictive.unwrap();
    let rms = |pick: fn(&crate::Gap) -> f64| {
        let squares = predictive.gap.iter().map(|g| pick(g).powi(2));
        (squares.sum::<f64>() / predictive.gap.len() as f64).sqrt()
    };
    let [base, with] = [rms(|g| g.base_mv), rms(|g| g.augmented_mv)];
    assert!(with < 0.8 * base, "{base} mV to {with} mV");
}

/// A comparison with NaN is false: such a prediction must not pass as no worse.
#[test]
fn a_prediction_that_is_not_a_number_is_worse() {
    let set = campaign(44, &Hidden::default(), &Hidden::default());
    let prepared = prepare(&set, &model(), Guards::default()).unwrap();
    let mut workspace = Workspace::default();
    let base = base_fit(&prepared.problem, &model().erm, &mut workspace);
    let mut broken = base.clone();
    broken.x[0] = f64::NAN;
    for measured in [true, false] {
        let mut search = Search {
            problem: &prepared.problem,
            candidates: &[],
            guards: Guards::default(),
            measured,
            progress: &Progress::default(),
            workspace: Workspace::default(),
        };
        assert!(search.no_record_worse(&base, &base).is_ok());
        let message = search.no_record_worse(&base, &broken).unwrap_err();
        assert!(message.contains("becomes worse"), "{message}");
        assert!(search.held_out(&base, &broken).is_err());
    }
}

#[test]
fn a_parameter_at_its_bound_is_not_a_name() {
    // Twice the slope: the curve is another cell's, which no error of a capacity reaches.
    let hidden = Hidden {
        slope: 0.9,
        ..Hidden::default()
    };
    let set = campaign(71, &hidden, &hidden);
    assert!(!names(&with(&set, Guards::default())).contains(&"ocv_slope"));
    let kept = Guards {
        held_out: false,
        outside: false,
        ..Guards::default()
    };
    let slope = |guards: Guards| {
        let candidates = vec![analysis_effects::effects::find("ocv_slope").unwrap()];
        let options = DiagnosisOptions {
            candidates,
            ..DiagnosisOptions::default()
        };
        diagnose_with(&set, &model(), &options, guards)
            .unwrap()
            .diagnosis
    };
    let off = slope(Guards {
        bound: false,
        ..kept
    });
    assert!(names(&off).contains(&"ocv_slope"), "{:?}", off.ranking);
    assert!(!names(&slope(kept)).contains(&"ocv_slope"));
}

#[test]
fn steps_are_as_fine_as_integration_needs() {
    // Few samples: heat between two of them matters.
    let hidden = Hidden {
        heat_per_j: 3e-4,
        ..Hidden::default()
    };
    let mut set = campaign(81, &hidden, &hidden);
    for run in &mut set.runs {
        if let (RunData::Time(record), Role::Train | Role::HeldOut) = (&mut run.data, run.role) {
            thin(&mut record.series);
        }
    }
    let (on, off) = (
        with(&set, Guards::default()),
        with(
            &set,
            Guards {
                integration: false,
                ..Guards::default()
            },
        ),
    );
    let error = |d: &Diagnosis| {
        d.effects
            .iter()
            .map(|e| e.evidence.integration_error)
            .fold(0.0, f64::max)
    };
    assert!(
        names(&on).contains(&"self_heating") && error(&on) <= 0.1,
        "{:?} {}",
        names(&on),
        error(&on)
    );
    assert!(error(&off) > 0.1, "{:?} {}", names(&off), error(&off));
}

/// An error that all rows of a record share is small beside each row's noise and large beside the
/// rows' information in its direction: the guard checks the whitened rows.
#[test]
fn integration_is_judged_by_what_it_does_to_whitened_rows() {
    let hidden = Hidden {
        heat_per_j: 3e-4,
        ..Hidden::default()
    };
    let mut set = campaign(81, &hidden, &hidden);
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            thin(&mut record.series);
        }
    }
    let prepared = prepare(&set, &model(), Guards::default()).unwrap();
    let problem = &prepared.problem;
    let candidates = [analysis_effects::effects::find("self_heating").unwrap()];
    let mut search = Search {
        problem,
        candidates: &candidates,
        guards: Guards::default(),
        measured: true,
        progress: &Progress::default(),
        workspace: Workspace::default(),
    };
    let base = base_fit(problem, &model().erm, &mut search.workspace);
    let attempt = search
        .attempts(&base, None)
        .0
        .into_iter()
        .find(|a| a.name == "self_heating")
        .unwrap();
    let at = attempt.fit.at();
    let (mut white, mut by_row) = (0.0f64, 0.0f64);
    for k in 0..problem.blocks.len() {
        let [once, halves] =
            [1, 2].map(|parts| problem.predict(at, k, parts, &mut search.workspace));
        let change: Vec<f64> = once.iter().zip(&halves).map(|(a, b)| a - b).collect();
        by_row = change
            .iter()
            .zip(&problem.floors[k])
            .fold(by_row, |worst, (c, f)| worst.max((c / f).abs()));
        let mut rows = Vec::new();
        problem.whiteners[k].apply(&change, &mut rows);
        white = rows.iter().fold(white, |worst, r| worst.max(r.abs()));
    }
    let reported = search.integration_error(&attempt.fit);
    assert!(
        (reported / white - 1.0).abs() < 1e-9 && (white / by_row - 1.0).abs() > 0.2,
        "{reported}, {white} whitened, {by_row} by row"
    );
}

/// Codes that the noise does not dither leave an error that looks like structure. Their term in the
/// noise accounts for most of that misfit; at ten times the noise not for all of it, because a
/// code's error is not normally distributed.
#[test]
fn coarse_codes_are_noise_and_no_misfit() {
    let step_v = 5e-3;
    let mut set = campaign(85, &Hidden::default(), &Hidden::default());
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            record
                .series
                .voltage_v
                .iter_mut()
                .for_each(|v| *v = (*v / step_v).round() * step_v);
        }
    }
    let z = |resolution_v: f64| {
        let mut set = set.clone();
        if let Some(history) = &mut set.history {
            history.voltage_resolution_v = resolution_v;
        }
        // The noise of the history: repeats, which show the codes too, must not make up for the
        // term.
        let prepared = prepare(&set, &model(), Guards::default())
            .unwrap()
            .of_history(Guards::default())
            .unwrap();
        let base = base_fit(&prepared.problem, &model().erm, &mut Workspace::default());
        excess_z(base.chi2, prepared.problem.degrees_of_freedom(&base))
    };
    let (stated, unstated) = (z(step_v), z(0.0));
    assert!(
        unstated > 50.0 && stated < 0.2 * unstated,
        "{stated} and {unstated}"
    );
}

#[test]
fn a_name_that_something_outside_the_catalogue_beats_is_withdrawn() {
    // A contact that became worse between two runs looks like ageing to a catalogue that contains
    // nothing else.
    let hidden = Hidden {
        later_rel: 0.05,
        ..Hidden::default()
    };
    let set = campaign(91, &hidden, &hidden);
    let kept = Guards {
        sentinel: false,
        ..Guards::default()
    };
    let off = with(
        &set,
        Guards {
            outside: false,
            ..kept
        },
    );
    assert_eq!(names(&off), ["ageing"], "{} {:?}", off.summary, off.ranking);
    let on = with(&set, kept);
    assert_eq!(
        (on.verdict, names(&on).len()),
        (Verdict::Unexplained, 0),
        "{} {:?}",
        on.summary,
        on.ranking
    );
    assert!(
        on.summary
            .contains("something like a change of the resistances between two runs"),
        "{}",
        on.summary
    );
}

/// Returns a campaign with a current channel that reads too much at large currents.
fn ranged(seed: u64, gain: f64) -> DataSet {
    let mut set = campaign(seed, &Hidden::default(), &Hidden::default());
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            record
                .series
                .current_a
                .iter_mut()
                .filter(|i| i.abs() > 30.0)
                .for_each(|i| *i *= 1.0 + gain);
        }
    }
    set
}

#[test]
fn what_differs_between_circumstances_is_not_noise() {
    // So little that the sum of all squares takes it for noise.
    let set = ranged(101, 0.003);
    let differs = |d: &Diagnosis| {
        d.notes
            .iter()
            .any(|n| n.contains("the resistance is not the same over"))
    };
    let on = with(&set, Guards::default());
    assert!(
        on.quality.augmented_z < 5.0 && on.verdict == Verdict::Unexplained && differs(&on),
        "{:?} {:?}",
        on.quality,
        on.notes
    );
    assert!(!differs(&with(
        &set,
        Guards {
            consistency: false,
            ..Guards::default()
        }
    )));
    assert!(!differs(&with(&ranged(101, 0.0), Guards::default())));
}

/// Asserts that this much of something hidden is found in the repeats with a note, and taken for
/// noise without the guard; and that nothing is found where nothing is hidden.
fn assert_found_in_repeats(set: impl Fn(f64) -> DataSet, hidden: f64, note: &str) {
    let has_note = |d: &Diagnosis| d.notes.iter().any(|n| n.contains(note));
    let on = with(&set(hidden), Guards::default());
    assert!(
        on.quality.augmented_z < 5.0 && on.verdict == Verdict::Unexplained && has_note(&on),
        "{:?} {:?}",
        on.quality,
        on.notes
    );
    let guards = Guards {
        consistency: false,
        ..Guards::default()
    };
    let off = with(&set(hidden), guards);
    let floor = Verdict::AtNoiseFloor;
    assert_eq!(off.verdict, floor, "{} {:?}", off.summary, off.notes);
    let still = with(&set(0.0), Guards::default());
    assert!(
        still.verdict == floor && !has_note(&still),
        "{:?}",
        still.notes
    );
}

/// A ripple over the charge is not an effect of the catalogue. In each record it is a third of the
/// noise; the mean of three contains all of it.
#[test]
fn what_all_repeats_have_in_common_is_not_noise() {
    let set = |ripple_v: f64| {
        let hidden = Hidden {
            ripple_v,
            ..Hidden::default()
        };
        campaign(107, &hidden, &hidden)
    };
    assert_found_in_repeats(set, 4.5e-4, "have more in common than the model");
}

/// 15 µΩ at 20 to 60 A are 0.3 to 0.9 mV for some samples of some pulses, in another way in each
/// repeat.
#[test]
fn a_contact_that_comes_and_goes_is_not_noise() {
    let set = |telegraph_ohm: f64| {
        let hidden = Hidden {
            telegraph_ohm,
            ..Hidden::default()
        };
        campaign(103, &hidden, &hidden)
    };
    assert_found_in_repeats(set, 15e-6, "what is left under current comes and goes");
}

#[test]
fn a_fit_that_did_not_converge_is_not_evidence() {
    let hidden = Hidden {
        per_soc: -0.6,
        ..Hidden::default()
    };
    let set = campaign(3, &hidden, &hidden);
    let prepared = prepare(&set, &model(), Guards::default()).unwrap();
    let problem = &prepared.problem;
    let candidates = [analysis_effects::effects::find("soc_resistance").unwrap()];
    let verdict = |guards: Guards, converged: bool| {
        let mut search = Search {
            problem,
            candidates: &candidates,
            guards,
            measured: true,
            progress: &Progress::default(),
            workspace: Workspace::default(),
        };
        let base = base_fit(problem, &model().erm, &mut search.workspace);
        let mut attempt = search
            .attempts(&base, None)
            .0
            .into_iter()
            .find(|a| a.name == "soc_resistance")
            .unwrap();
        assert!(base.promise < 0.1 && attempt.fit.promise < 0.1);
        if !converged {
            attempt.fit.promise = attempt.lambda;
        }
        search.accept(&base, 0.0, &attempt, 0)
    };
    let off = Guards {
        convergence: false,
        ..Guards::default()
    };
    assert!(verdict(Guards::default(), true).is_ok() && verdict(off, false).is_ok());
    assert_eq!(
        verdict(Guards::default(), false).unwrap_err(),
        "its fit did not converge"
    );
}

#[test]
fn a_wave_that_is_small_in_every_record_is_seen_in_all_of_them() {
    const PERIOD_S: f64 = 7.3;
    let swinging = |amplitude_v: f64| {
        let mut set = campaign(91, &Hidden::default(), &Hidden::default());
        for run in &mut set.runs {
            if let RunData::Time(record) = &mut run.data {
                // Another phase in every record, because the start of the wave is unknown.
                let phase = f64::from(run.order * run.order);
                let wave =
                    record.series.time_s.iter().map(|t| {
                        amplitude_v * (std::f64::consts::TAU * t / PERIOD_S + phase).sin()
                    });
                record
                    .series
                    .voltage_v
                    .iter_mut()
                    .zip(wave)
                    .for_each(|(v, wave)| *v += wave);
            }
        }
        set
    };
    let off = Guards {
        consistency: false,
        ..Guards::default()
    };
    let [still, small] = [0.0, 3e-4].map(swinging);
    let ends = [
        with(&still, Guards::default()),
        with(&small, off),
        with(&small, Guards::default()),
    ];
    assert_eq!(
        ends.each_ref().map(|d| d.verdict),
        [
            Verdict::AtNoiseFloor,
            Verdict::AtNoiseFloor,
            Verdict::Unexplained
        ],
        "{:?}",
        ends[2].notes
    );
    let note = ends[2]
        .notes
        .iter()
        .find(|note| note.contains("a wave of"))
        .expect("the wave is reported");
    let period_s: f64 = note
        .split("a wave of ")
        .nth(1)
        .and_then(|rest| rest.split(' ').next()?.parse().ok())
        .unwrap();
    assert!((period_s / PERIOD_S - 1.0).abs() < 0.02, "{note}");
}

/// Keeps the samples at edges and every eighth in between.
fn thin(s: &mut analysis_signal::series::TimeSeries) {
    let keep: Vec<usize> = (0..s.len())
        .filter(|k| k % 8 == 0 || *k == 0 || (s.current_a[*k] - s.current_a[k - 1]).abs() > 1.0)
        .collect();
    s.time_s = keep.iter().map(|k| s.time_s[*k]).collect();
    s.current_a = keep.iter().map(|k| s.current_a[*k]).collect();
    s.voltage_v = keep.iter().map(|k| s.voltage_v[*k]).collect();
}
