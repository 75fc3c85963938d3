//! Diagnoses with nothing to show, and pictures that must be drawable.

use super::{sample, words};
use crate::{
    outcome::{Curves, Diagnosis, RunCurves},
    report::{Kind, Picture, markdown, pictures, text},
};

fn kinds(pictures: &[Picture]) -> Vec<Kind> {
    pictures.iter().map(|p| p.kind).collect()
}

fn draw(pictures: &[Picture]) {
    for picture in pictures {
        let svg = picture.drawing.svg().unwrap();
        assert!(
            !svg.contains("NaN") && !svg.contains(">\ninf"),
            "{}",
            picture.name
        );
    }
}

#[test]
fn every_verdict_has_pictures_that_can_be_drawn() {
    use Kind::{Gap, HeldOut, Map, Ranking, Spectrum, Time};
    let after = [Map, Time, Time, Time, Spectrum, Ranking, Gap];
    let charts = |held_out: usize| [vec![HeldOut; held_out], after.to_vec()].concat();
    let cases = [
        ("explained", sample::explained(), charts(3)),
        ("ambiguous", sample::ambiguous(), charts(3)),
        ("unexplained", sample::unexplained(), charts(3)),
        ("at_floor", sample::at_floor(), charts(1)),
        ("invalid", sample::invalid(), vec![]),
    ];
    for (verdict, d, expected) in cases {
        let found = pictures(&d, &sample::runs());
        assert_eq!(kinds(&found), expected, "{verdict}");
        draw(&found);
    }
    draw(&words::matrix().pictures());
}

#[test]
fn nothing_gives_no_picture_and_no_panic() {
    let bare = Diagnosis {
        blocks: vec![],
        where_after: vec![],
        gap: vec![],
        gap_spectra: vec![],
        ranking: vec![],
        ..sample::explained()
    };
    assert!(pictures(&bare, &[]).is_empty());
    assert!(text(&bare).contains("No run was held out"));
    assert!(!markdown(&bare, &[]).contains("!["));
    let (v, z) = (vec![], vec![]);
    let time = Curves::Time {
        time_s: v.clone(),
        current_a: v.clone(),
        measured_v: v.clone(),
        eis_only_v: v.clone(),
        base_v: v.clone(),
        augmented_v: v.clone(),
        floor_v: v.clone(),
    };
    let eis = Curves::Eis {
        freq_hz: v.clone(),
        measured_ohm: z.clone(),
        eis_only_ohm: z.clone(),
        base_ohm: z.clone(),
        augmented_ohm: z,
        floor_ohm: v,
    };
    let empty = [time, eis].map(|curves| RunCurves {
        name: "empty".into(),
        held_out: true,
        curves,
    });
    assert!(pictures(&bare, &empty).is_empty());
}

#[test]
fn samples_that_are_no_numbers_are_left_out() {
    let mut runs = sample::runs();
    if let Curves::Time {
        measured_v,
        floor_v,
        ..
    } = &mut runs[0].curves
    {
        (measured_v[3], floor_v[5]) = (f64::NAN, f64::INFINITY);
    }
    if let Curves::Eis {
        measured_ohm,
        freq_hz,
        ..
    } = &mut runs[3].curves
    {
        (measured_ohm[2].re, freq_hz[4]) = (f64::NAN, 0.0);
    }
    let d = Diagnosis {
        gap: vec![],
        gap_spectra: vec![],
        ..sample::explained()
    };
    draw(&pictures(&d, &runs));
}

#[test]
fn of_many_runs_the_worst_are_shown_in_their_order() {
    let named = |k: usize| {
        let mut run = sample::runs().swap_remove(0);
        run.name = format!("run {k}");
        if let Curves::Time { base_v, .. } = &mut run.curves {
            base_v.iter_mut().for_each(|v| *v += 1e-3 * k as f64);
        }
        run
    };
    let runs: Vec<RunCurves> = (0..9).map(named).collect();
    let names: Vec<String> = pictures(&sample::explained(), &runs)
        .into_iter()
        .filter(|p| p.kind == Kind::Time)
        .map(|p| p.name)
        .collect();
    let expected: Vec<String> = (3..9)
        .map(|k| format!("residual-{}-run_{k}", k - 2))
        .collect();
    assert_eq!(names, expected);
}
