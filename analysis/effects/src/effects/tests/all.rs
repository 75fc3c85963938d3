//! Properties that every effect of the catalogue has.

use super::{
    super::{catalogue, find},
    *,
};
use crate::contract::{Group, Scale};

#[test]
fn a_card_says_everything() {
    for effect in catalogue() {
        let card = effect.card();
        let texts = [
            card.name,
            card.title,
            card.mechanism,
            card.state_equation,
            card.impedance,
            card.source,
            card.signature,
            card.experiment,
        ];
        assert!(
            texts.iter().all(|t| !t.trim().is_empty()),
            "{}: an empty text",
            card.name
        );
        assert!(
            card.name
                .chars()
                .all(|c| c.is_ascii_lowercase() || c == '_'),
            "{}: a name in lower case",
            card.name
        );
        assert!(
            std::ptr::eq(find(card.name).unwrap().card(), card),
            "{}: found by its name once",
            card.name
        );
        assert!(
            !card.confounders.is_empty() && !card.confounders.contains(&card.name),
            "{}: confounders other than itself",
            card.name
        );
    }
    assert!(
        catalogue().is_sorted_by_key(|e| e.card().group == Group::Bench),
        "cells' effects come first"
    );
}

/// A usual range that ended at a bound of the search, or that did not contain "no effect", would be
/// useless or warn of everything.
#[test]
fn usual_ranges_lie_within_the_search_and_hold_no_effect() {
    let base = base();
    let mut met = 0;
    for effect in catalogue() {
        for p in effect.parameters(&base) {
            let Some(usual) = p.usual else { continue };
            let (inner, outer) = (usual.range, p.range);
            assert!(
                inner.lower <= 0.0 && inner.upper > 0.0 && !usual.source.is_empty(),
                "{} {}",
                effect.card().name,
                p.name
            );
            assert!(
                inner.lower >= outer.lower && inner.upper <= outer.upper,
                "{} {}: {inner:?} of {outer:?}",
                effect.card().name,
                p.name
            );
            // An interval that only extends out of the range is not unusual.
            assert!(p.unusual(inner.upper, 9.0 * inner.upper).is_none());
            assert!(p.unusual(1.1 * inner.upper, 1.2 * inner.upper).is_some());
            met += 1;
        }
    }
    assert!(met >= 4, "{met}");
}

#[test]
fn confounders_are_in_the_catalogue() {
    for effect in catalogue() {
        for name in effect.card().confounders {
            assert!(
                find(name).is_some(),
                "{}: {name} is not an effect",
                effect.card().name
            );
        }
    }
}

#[test]
fn parameters_keep_the_convention() {
    for effect in catalogue() {
        let (name, parameters) = (effect.card().name, effect.parameters(&base()));
        let strength = &parameters[0];
        let (lower, upper) = (strength.range.lower, strength.range.upper);
        assert_eq!(
            (strength.scale, strength.starts.len()),
            (Scale::Linear, 0),
            "{name}"
        );
        assert!(
            lower <= 0.0 && upper > 0.0 && strength.typical > 0.0 && strength.typical < upper,
            "{name}: {strength:?}"
        );
        for p in &parameters[1..] {
            assert!(
                !p.starts.is_empty()
                    && p.starts
                        .iter()
                        .all(|s| (p.range.lower..=p.range.upper).contains(s)),
                "{name}: {p:?}"
            );
            assert!(
                p.scale == Scale::Choice
                    || p.only_with.is_some()
                    || (p.scale == Scale::Log && p.range.lower > 0.0),
                "{name}: {p:?}"
            );
        }
    }
}

#[test]
fn a_strength_of_zero_is_absence() {
    let (pulses, block) = (Trace::pulses(), Trace::block());
    for effect in catalogue() {
        for p in settings(*effect, |_| 0.0) {
            let added = [Added {
                effect: *effect,
                p: &p,
            }];
            for record in [pulses.record(0.5, 3.0), block.record(0.7, 20.0)] {
                let error = largest(
                    &play(&added, &record, Between::Hold, 1),
                    &play(&[], &record, Between::Hold, 1),
                );
                assert!(error < 1e-12, "{} {p:?}: {error} V", effect.card().name);
            }
            for (freq_hz, bias_a, soc) in [(0.1, 0.0, 0.5), (30.0, 5.0, 0.3), (300.0, -5.0, 0.9)] {
                let at = Point {
                    amplitude_a: Some(1.0),
                    bias_a,
                    soc,
                    order: 7.0,
                    ..point(freq_hz)
                };
                let error = (seen(effect.card().name, &p, &at) - plain(&at)).norm();
                assert!(
                    error < 1e-15,
                    "{} {p:?}: {error} Ω at {freq_hz} Hz",
                    effect.card().name
                );
            }
        }
    }
}

#[test]
fn an_effect_grows_in_proportion_to_a_small_strength() {
    let (pulses, block) = (Trace::pulses(), Trace::block());
    for effect in catalogue() {
        let name = effect.card().name;
        for shapes in settings(*effect, |s| s.typical) {
            let strong = |share: f64| [&[share * shapes[0]], &shapes[1..]].concat();
            let difference = |p: Vec<f64>| -> Vec<f64> {
                let added = [Added {
                    effect: *effect,
                    p: &p,
                }];
                let records = [pulses.record(0.5, 10.0), block.record(0.5, 10.0)];
                let change = records.iter().flat_map(|r| {
                    let (with, without) = (
                        play(&added, r, Between::Hold, 1),
                        play(&[], r, Between::Hold, 1),
                    );
                    with.into_iter()
                        .zip(without)
                        .map(|(a, b)| a - b)
                        .collect::<Vec<_>>()
                });
                let z = [0.1, 3.0, 300.0].map(|f| {
                    let at = Point {
                        soc: 0.6,
                        order: 10.0,
                        bias_a: 3.0,
                        amplitude_a: Some(1.0),
                        ..point(f)
                    };
                    augmented::impedance(
                        &augmented::network(&base(), &added),
                        &base(),
                        &added,
                        &at,
                        None,
                    ) - plain(&at)
                });
                change.chain(z.iter().flat_map(|z| [z.re, z.im])).collect()
            };
            let (one, two) = (difference(strong(0.02)), difference(strong(0.04)));
            let size = one.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
            let bend = one
                .iter()
                .zip(&two)
                .fold(0.0_f64, |m, (one, two)| m.max((two - 2.0 * one).abs()));
            assert!(size > 1e-9, "{name} {shapes:?}: nothing happens");
            assert!(bend < 0.1 * size, "{name} {shapes:?}: {bend} of {size}");
        }
    }
}

#[test]
fn nothing_breaks_at_the_bounds() {
    let (pulses, block) = (Trace::pulses(), Trace::block());
    for effect in catalogue() {
        let parameters = effect.parameters(&base());
        let ends = |p: &Parameter| {
            if p.scale == Scale::Choice {
                p.starts.clone()
            } else {
                vec![p.range.lower, p.range.upper]
            }
        };
        let corners = parameters
            .iter()
            .fold(vec![Vec::new()], |corners: Vec<Vec<f64>>, p| {
                corners
                    .iter()
                    .flat_map(|c| ends(p).into_iter().map(|e| [&c[..], &[e]].concat()))
                    .collect()
            });
        for p in corners {
            let added = [Added {
                effect: *effect,
                p: &p,
            }];
            for record in [pulses.record(0.5, 10.0), block.record(0.2, 20.0)] {
                let voltage_v = play(&added, &record, Between::Hold, 1);
                assert!(
                    voltage_v.iter().all(|v| v.is_finite()),
                    "{} {p:?}: a voltage that is not a number",
                    effect.card().name
                );
            }
            for (freq_hz, bias_a) in [(0.01, 0.0), (1000.0, 50.0), (1.0, -50.0)] {
                let at = Point {
                    amplitude_a: Some(10.0),
                    bias_a,
                    soc: 0.0,
                    order: 20.0,
                    ..point(freq_hz)
                };
                assert!(
                    seen(effect.card().name, &p, &at).is_finite(),
                    "{} {p:?} at {freq_hz} Hz",
                    effect.card().name
                );
            }
        }
    }
}

/// The error of integration stays far below a voltmeter's noise. Where 100 A rise and fall along a
/// line of 10 ms, states see the mean of half a step.
#[test]
fn half_the_step_gives_the_same_voltage() {
    let (pulses, block) = (Trace::pulses(), Trace::block());
    for effect in catalogue() {
        for p in settings(*effect, |s| s.typical) {
            let added = [Added {
                effect: *effect,
                p: &p,
            }];
            for record in [pulses.record(0.5, 10.0), block.record(0.5, 20.0)] {
                for (between, most_v) in [(Between::Hold, 20e-6), (Between::Linear, 100e-6)] {
                    let error = largest(
                        &play(&added, &record, between, 1),
                        &play(&added, &record, between, 2),
                    );
                    assert!(
                        error < most_v,
                        "{} {p:?} {between:?}: {error} V",
                        effect.card().name
                    );
                }
            }
        }
    }
}

/// A small sine in the time domain reproduces the impedance of the spectrum.
#[test]
fn time_and_frequency_agree_for_small_currents() {
    let (freq_hz, per_period, periods) = (0.5, 400, 12);
    let omega = std::f64::consts::TAU * freq_hz;
    let amplitude_a = 1e-3;
    let time_s: Vec<f64> = (0..=per_period * periods)
        .map(|k| f64::from(k) / f64::from(per_period) / freq_hz)
        .collect();
    let current_a: Vec<f64> = time_s
        .iter()
        .map(|t| amplitude_a * (omega * t).sin())
        .collect();
    let trace = Trace { time_s, current_a };
    for effect in catalogue().iter().filter(|e| e.card().group == Group::Cell) {
        for p in settings(*effect, |s| 3.0 * s.typical) {
            let record = trace.record(0.6, 10.0);
            let added = [Added {
                effect: *effect,
                p: &p,
            }];
            let (with, without) = (
                play(&added, &record, Between::Linear, 1),
                play(&[], &record, Between::Linear, 1),
            );
            let change: Vec<f64> = with.iter().zip(&without).map(|(a, b)| b - a).collect();
            let at = Point {
                soc: 0.6,
                order: 10.0,
                ..point(freq_hz)
            };
            let expected = seen(effect.card().name, &p, &at) - plain(&at);
            let met = phasor(&change, per_period as usize) / Complex64::new(0.0, -amplitude_a);
            let floor = 1e-6 * base().erm.dc_resistance_ohm();
            // The open-circuit voltage is not part of a spectrum: an effect on it alone is not
            // expected there.
            if expected == Complex64::ZERO {
                continue;
            }
            assert!(
                (met - expected).norm() < 0.02 * expected.norm() + floor,
                "{} {p:?}: {met} against {expected} Ω",
                effect.card().name
            );
        }
    }
}

/// Returns the amplitude of exp(jωt) over the last two periods; a trend is taken off by the
/// difference of both.
fn phasor(signal: &[f64], per_period: usize) -> Complex64 {
    let last = &signal[signal.len() - 1 - 2 * per_period..signal.len() - 1];
    let trend = (last[per_period..].iter().sum::<f64>() - last[..per_period].iter().sum::<f64>())
        / (per_period * per_period) as f64;
    let sum: Complex64 = last
        .iter()
        .enumerate()
        .map(|(k, v)| {
            (v - trend * k as f64)
                * Complex64::cis(-std::f64::consts::TAU * k as f64 / per_period as f64)
        })
        .sum();
    sum / per_period as f64
}
