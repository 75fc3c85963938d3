//! Judges a known step of the command: which of drive, ammeter, probes and voltmeter can be
//! trusted. The functions are pure.

use instruments::fixture::Fixture;

use super::{
    findings::{Findings, Texts, Verdict},
    probes::{COVERAGE, KnownResistance, Loop, METER_SIGMA, Mistake},
};

/// Gain errors of the drive, as shares: beyond the first a remark is made, the second is the
/// limit.
const GAIN: (f64, f64) = (0.05, 0.15);
/// Share of the wanted current below which the current counts as none.
const NOTHING: f64 = 0.05;
/// Resolution of a bench voltmeter, V.
const VOLTMETER_V: f64 = 2.0e-3;

/// Changes from the lower to the upper level of the command.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// The current that the configured gain should give, A.
    pub(super) wanted_a: f64,
    /// Change of the bipolar supply's ammeter, A.
    pub(super) ammeter_a: f64,
    /// Change of its voltmeter, V.
    pub(super) supply_v: f64,
    /// Change of the voltmeter of the load, if there is one, V.
    pub(super) load_v: Option<f64>,
    /// Changes of the four channels, V.
    pub(super) channels_v: [f64; 4],
    /// The configured trim of the command.
    pub(super) trim: f64,
}

/// Judges a step; returns whether all probes and the drive can be trusted.
pub(super) fn judge(findings: &mut Findings, circuit: &Loop, step: &Step) -> bool {
    let by = |reference_a: f64| step.channels_v.map(|volts| volts / reference_a);
    let [c1, c2, c3, c4] = step.channels_v;
    let shunt_a = (c2 - c1) / circuit.shunt.ohm;
    let none = |amps: f64| amps.abs() < NOTHING * step.wanted_a.abs();
    if none(step.ammeter_a)
        && step
            .channels_v
            .iter()
            .all(|volts| none(volts / circuit.shunt.ohm))
    {
        let met = format!(
            "{:.4} A by the ammeter, {shunt_a:.4} A by the shunt",
            step.ammeter_a
        );
        let advice = "no current follows the command: look at wiring.generator_channel and the \
        cable from that output to the analog input, at the \
                      output of the generator, and whether the supply's analog input is selected";
        findings.add(
            "drive.gain",
            Texts {
                expected: wanted(step),
                met,
            },
            Verdict::Fail,
            advice,
        );
        return false;
    }
    let explained = if none(step.ammeter_a) {
        Vec::new()
    } else {
        circuit.explain(by(step.ammeter_a))
    };
    // If nothing else explains it and the controls agree with each other, the ammeter is wrong; if
    // the shunt's value may be wrong, too, the command decides.
    let of_value = explained
        .iter()
        .all(|mistake| matches!(mistake, Mistake::Shunt(_)));
    let command =
        [step.ammeter_a, shunt_a].map(|amps| (amps / step.wanted_a - 1.0).abs() <= GAIN.0);
    let ammeter_is_off = explained.is_empty() || command == [false, true];
    let by_shunt = of_value && ammeter_is_off && circuit.explain(by(shunt_a)) == [Mistake::None];
    let (current_a, mistakes) = if by_shunt {
        (shunt_a, vec![Mistake::None])
    } else {
        (step.ammeter_a, explained)
    };
    let sound = mistakes == [Mistake::None];
    let readings = by(current_a);
    let sigma =
        circuit.sigma_ohm(readings[0], readings[1], Some(circuit.shunt)) / circuit.shunt.ohm;
    let by_shunt = ByShunt {
        current_a: shunt_a,
        ratio_sigma: sigma.hypot(METER_SIGMA),
    };
    let metered = ammeter(findings, step, sound, by_shunt);
    probes(findings, circuit, &mistakes, readings, command);
    let gain = drive(findings, step, current_a, sound || !mistakes.is_empty());
    voltmeter(findings, circuit, step, sound, [c2, c3, c4]);
    sound && gain && metered
}

fn wanted(step: &Step) -> String {
    format!("{:+.3} A", step.wanted_a)
}

/// The current from the shunt, with which the ammeter is compared.
#[derive(Clone, Copy)]
struct ByShunt {
    current_a: f64,
    /// Standard deviation of the ratio of the two readings.
    ratio_sigma: f64,
}

fn ammeter(findings: &mut Findings, step: &Step, sound: bool, by_shunt: ByShunt) -> bool {
    let ByShunt {
        current_a: shunt_a,
        ratio_sigma: sigma,
    } = by_shunt;
    let within = |k: f64| format!("{:.4} A", k * sigma * shunt_a.abs());
    let expected = format!(
        "{shunt_a:+.4} A, as the shunt carries, ± {} (95 %), ± {} (99 %)",
        within(COVERAGE.0),
        within(COVERAGE.1)
    );
    let texts = Texts {
        expected,
        met: format!("{:+.4} A", step.ammeter_a),
    };
    if !sound {
        findings.skip(
            &["meters.ammeter"],
            "probes or controls cannot be trusted",
            "settle first what is wrong with them",
        );
        return false;
    }
    let ratio = step.ammeter_a / shunt_a;
    let advice = if ratio.abs() < NOTHING {
        "the bipolar supply's ammeter is dead: its read-back cannot watch over a cell; look at its \
        meter and its remote read-back"
    } else if ratio < 0.0 {
        "the ammeter and the shunt disagree in sign: the leads at the bipolar supply's output are \
        swapped"
    } else {
        "the ammeter and the shunt disagree: check wiring.shunt.resistance against the shunt's \
        plate, then the supply's calibration"
    };
    let verdict = verdict((ratio - 1.0).abs(), sigma);
    findings.add(
        "meters.ammeter",
        texts,
        verdict,
        if verdict == Verdict::Ok { "" } else { advice },
    );
    verdict != Verdict::Fail
}

/// Returns the verdict: correct within 95 %, a remark within 99 %, wrong beyond.
fn verdict(off: f64, sigma: f64) -> Verdict {
    match off {
        off if off <= COVERAGE.0 * sigma => Verdict::Ok,
        off if off <= COVERAGE.1 * sigma => Verdict::Warn,
        _ => Verdict::Fail,
    }
}

/// Judges the probes. `command` states whether ammeter and shunt, in this order, show the
/// commanded current.
fn probes(
    findings: &mut Findings,
    circuit: &Loop,
    mistakes: &[Mistake],
    readings: [f64; 4],
    command: [bool; 2],
) {
    let [a, b, c, d] = readings;
    let all = |ids: [&str; 3]| {
        ids.iter().all(|id| {
            mistakes
                .iter()
                .all(|mistake| mistake.id() != *id || *mistake == Mistake::None)
        })
    };
    let pairs = [
        ("probes.current_pair", (a, b), circuit.shunt),
        ("probes.voltage_pair", (c, d), circuit.control),
    ];
    let unexplained = mistakes.is_empty();
    for (id, (low, high), known) in pairs {
        let (met, sigma_ohm) = (high - low, circuit.sigma_ohm(low, high, Some(known)));
        let expected = expected(known, sigma_ohm);
        let mine: Vec<_> = mistakes
            .iter()
            .filter(|mistake| mistake.id() == id && **mistake != Mistake::None)
            .collect();
        if unexplained {
            let each = readings.map(milli).join(", ");
            let advice = "no single mistake explains the four channels: look at each lead, and at \
            the probe factor of each channel";
            findings.add(
                id,
                Texts {
                    expected,
                    met: format!("{} of C1 … C4 at {each}", milli(met)),
                },
                Verdict::Fail,
                advice,
            );
        } else if !mine.is_empty() {
            let what: Vec<String> = mine.iter().map(|mistake| mistake.describe().0).collect();
            let met = format!("{}: {}", milli(met), what.join(", or "));
            findings.add(
                id,
                Texts { expected, met },
                Verdict::Fail,
                &advice(circuit, &mine, command),
            );
        } else if circuit.fixture == Fixture::Shunt
            && mistakes
                .iter()
                .any(|mistake| matches!(mistake, Mistake::Shunt(_)))
        {
            findings.skip(
                &[id],
                "both pairs are on a shunt whose value is in doubt",
                "",
            );
        } else if all(["probes.swapped"; 3]) {
            let verdict = verdict((met - known.ohm).abs(), sigma_ohm);
            let advice = "one sound bench in twenty reads so: the gains of its probes differ by \
            much, or the control is not quite that of the bench file";
            let met = format!("{} ({:+.1} %)", milli(met), 100.0 * (met / known.ohm - 1.0));
            findings.add(
                id,
                Texts { expected, met },
                if verdict == Verdict::Ok {
                    Verdict::Ok
                } else {
                    Verdict::Warn
                },
                if verdict == Verdict::Ok { "" } else { advice },
            );
        } else {
            findings.skip(&[id], "the pairs are swapped", "");
        }
    }
    let id = "probes.swapped";
    match mistakes.iter().find(|mistake| mistake.id() == id) {
        Some(mistake) => {
            let (what, advice) = mistake.describe();
            let expected = format!(
                "{} at C1, C2 and {} at C3, C4",
                milli(circuit.shunt.ohm),
                milli(circuit.control.ohm)
            );
            findings.add(
                id,
                Texts {
                    expected,
                    met: format!("{} and {}: {what}", milli(b - a), milli(d - c)),
                },
                Verdict::Fail,
                &advice,
            );
        }
        None if circuit.fixture == Fixture::Shunt => {
            findings.skip(
                &[id],
                "both pairs are on the shunt",
                "`--fixture fake_cell` separates the pairs",
            );
        }
        None if unexplained => findings.skip(&[id], "probes or controls cannot be trusted", ""),
        None => findings.add(
            id,
            Texts {
                expected: "each pair on its own resistance",
                met: "each pair on its own resistance",
            },
            Verdict::Ok,
            "",
        ),
    }
}

fn milli(ohms: f64) -> String {
    format!("{:.2} mΩ", 1.0e3 * ohms)
}

/// Describes a control with the readings of a sound bench.
fn expected(known: KnownResistance, sigma_ohm: f64) -> String {
    let within = |k: f64| milli(k * sigma_ohm);
    let KnownResistance {
        ohm,
        sigma_ohm: own_ohm,
    } = known;
    let of = if sigma_ohm > 2.0 * own_ohm {
        "by the gains of the probes and the ammeter"
    } else {
        "by its own uncertainty"
    };
    format!(
        "{} ± {} (95 %), ± {} (99 %), mostly {of}",
        milli(ohm),
        within(COVERAGE.0),
        within(COVERAGE.1)
    )
}

/// Returns the remedy as text. If a value of the bench file may be wrong, it explains how to
/// decide.
fn advice(circuit: &Loop, mine: &[&Mistake], command: [bool; 2]) -> String {
    let each: Vec<String> = mine.iter().map(|mistake| mistake.describe().1).collect();
    let either = if each.len() > 1 {
        format!("either is possible: {}", each.join("; or "))
    } else {
        each.concat()
    };
    let of_shunt = mine
        .iter()
        .any(|mistake| matches!(mistake, Mistake::Shunt(_)));
    let of_control = mine
        .iter()
        .any(|mistake| matches!(mistake, Mistake::Control(_)));
    let decides = match (circuit.fixture, of_shunt, of_control) {
        (Fixture::Shunt, true, _) if command == [true, false] => {
            "Both pairs read the same, and the ammeter shows the current that was commanded: it is \
            the value, or gains of the \
             supply that are off twice; `--fixture fake_cell` decides by a second control"
        }
        (Fixture::Shunt, true, _) => {
            "Both pairs read the same, so that the cause is not a probe but the value or the \
            ammeter; `--fixture fake_cell` decides by a second control, or a meter of known \
            accuracy in series"
        }
        (_, true, _) => {
            "`--fixture shunt` decides: where C3, C4 read on the shunt what C1, C2 do, it is the \
            value or the ammeter, else a probe"
        }
        (_, _, true) => {
            "`--fixture shunt` decides: if C3, C4 read the shunt right, it is the value, otherwise \
            a probe; the charger's displayed current through the fake cell and the voltage across \
            it give its resistance once more"
        }
        _ => return either,
    };
    format!("{either}. {decides}")
}

fn drive(findings: &mut Findings, step: &Step, current_a: f64, known: bool) -> bool {
    let ratio = current_a / step.wanted_a;
    let met = format!("{current_a:+.4} A, {ratio:.3} of it");
    if !known {
        findings.skip(
            &["drive.gain"],
            "neither ammeter nor probes can be trusted",
            "",
        );
        return false;
    }
    let trim = step.trim / ratio;
    let off = (ratio - 1.0).abs();
    let (verdict, advice) = if off <= GAIN.0 {
        (Verdict::Ok, String::new())
    } else if ratio < 0.0 {
        (
            Verdict::Fail,
            "the current runs against the command: swap the leads at the supply's output, or the \
            signal at its analog input"
                .to_owned(),
        )
    } else {
        let advice = format!(
            "the drive gives {ratio:.3} of what the bench file says: check model and range of the \
            supply and the generator's load setting; if they are \
             right, wiring.command_trim = {trim:.3}"
        );
        (
            if off <= GAIN.1 {
                Verdict::Warn
            } else {
                Verdict::Fail
            },
            advice,
        )
    };
    findings.add(
        "drive.gain",
        Texts {
            expected: wanted(step),
            met,
        },
        verdict,
        &advice,
    );
    verdict != Verdict::Fail
}

/// Judges the voltmeter of the load, whose leads include the wire to the jig and its contents.
fn voltmeter(
    findings: &mut Findings,
    circuit: &Loop,
    step: &Step,
    sound: bool,
    [c2, c3, c4]: [f64; 3],
) {
    let id = "meters.voltmeter";
    let (jig_v, fixture_v) = (c4 - c2, c4 - c3);
    let Some(load_v) = step.load_v else {
        findings.skip(
            &[id],
            "the bench has no load, whose leads would see the jig",
            "",
        );
        return;
    };
    if !sound {
        findings.skip(
            &[id],
            "probes or controls cannot be trusted",
            "settle first what is wrong with them",
        );
        return;
    }
    let milli = |volts: f64| format!("{:+.1} mV", 1.0e3 * volts);
    let (expected, good) = if circuit.fixture == Fixture::Shunt {
        let good = (c3.signum() * load_v) > 0.5 * VOLTMETER_V
            && load_v.abs() <= step.supply_v.abs() + VOLTMETER_V;
        (
            format!(
                "more than nothing, at most the supply's {}",
                milli(step.supply_v)
            ),
            good,
        )
    } else {
        // Sense leads may be connected to the jig itself, which is better, or include the wire to
        // it.
        let around = |volts: f64| {
            (
                volts - 0.3 * volts.abs() - VOLTMETER_V,
                volts + 0.3 * volts.abs() + VOLTMETER_V,
            )
        };
        let (one, other) = (around(fixture_v), around(jig_v));
        let expected = format!(
            "{} of the fixture alone to {} with its wire, as the probes show",
            milli(fixture_v),
            milli(jig_v)
        );
        (
            expected,
            (one.0.min(other.0)..=one.1.max(other.1)).contains(&load_v),
        )
    };
    let advice = "the load's voltmeter does not follow the voltage at the jig: it watches over the \
    cell; look at its sense leads and its sense setting";
    findings.judge(
        id,
        Texts {
            expected,
            met: milli(load_v),
        },
        good,
        advice,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    const CIRCUIT: Loop = Loop {
        fixture: Fixture::FakeCell,
        shunt: KnownResistance {
            ohm: 9.96e-3,
            sigma_ohm: 0.02e-3,
        },
        control: KnownResistance {
            ohm: 3.75e-3,
            sigma_ohm: 0.05e-3,
        },
        gain_sigma: 0.01,
    };

    fn step(true_a: f64) -> Step {
        let channels_v = [17.0e-3, 26.96e-3, 39.0e-3, 42.75e-3].map(|ohm| ohm * true_a);
        Step {
            wanted_a: 1.0,
            ammeter_a: true_a,
            supply_v: 60.0e-3 * true_a,
            load_v: Some(15.8e-3 * true_a),
            channels_v,
            trim: 1.0,
        }
    }

    fn failed(step: &Step) -> Vec<(String, String)> {
        failed_on(&CIRCUIT, step)
    }

    fn failed_on(circuit: &Loop, step: &Step) -> Vec<(String, String)> {
        let mut findings = Findings::default();
        judge(&mut findings, circuit, step);
        let failed = findings
            .checks
            .into_iter()
            .filter(|check| check.verdict == Verdict::Fail);
        failed.map(|check| (check.id, check.advice)).collect()
    }

    #[test]
    fn the_one_that_is_wrong_is_named_and_no_other() {
        let dead = Step {
            ammeter_a: 0.0,
            ..step(1.0)
        };
        let reversed = Step {
            ammeter_a: -1.0,
            ..step(1.0)
        };
        let blind = Step {
            load_v: Some(0.0),
            ..step(1.0)
        };
        let silent = Step {
            ammeter_a: 0.0,
            load_v: Some(0.0),
            channels_v: [0.0; 4],
            ..step(0.0)
        };
        let mut probe = step(1.0);
        probe.channels_v[2] *= 0.1;
        for (step, id, word) in [
            (step(0.5), "drive.gain", "wiring.command_trim = 2.000"),
            (step(-1.0), "drive.gain", "against the command"),
            (silent, "drive.gain", "wiring.generator_channel"),
            (dead, "meters.ammeter", "is dead"),
            (reversed, "meters.ammeter", "disagree in sign"),
            (blind, "meters.voltmeter", "sense leads"),
            (probe, "probes.voltage_pair", "probe factor of channel 3"),
        ] {
            let found = failed(&step);
            assert!(
                found.len() == 1 && found[0].0 == id && found[0].1.contains(word),
                "{id}: {found:?}"
            );
        }
        assert_eq!(failed(&step(0.98)), []);
    }

    /// Equal readings for another value in the bench file or for a wrong ammeter: the command
    /// decides which of them applies.
    #[test]
    fn a_wrong_value_is_distinguished_from_a_wrong_ammeter_by_a_second_control_or_the_command() {
        let shunt_of = |ohm: f64| KnownResistance {
            ohm,
            sigma_ohm: 0.02e-3,
        };
        let on_shunt = |ohm: f64| Loop {
            fixture: Fixture::Shunt,
            shunt: shunt_of(ohm),
            control: shunt_of(ohm),
            ..CIRCUIT
        };
        let both = |ammeter_a: f64, wanted_a: f64| {
            let channels_v = [17.0e-3, 26.96e-3, 17.0e-3, 26.96e-3];
            Step {
                wanted_a,
                ammeter_a,
                channels_v,
                load_v: None,
                ..step(1.0)
            }
        };
        for (circuit, step, id, word) in [
            // A fake cell of 3.75 mΩ, although the bench file states 6.
            (
                Loop {
                    control: KnownResistance {
                        ohm: 6.0e-3,
                        sigma_ohm: 0.05e-3,
                    },
                    ..CIRCUIT
                },
                step(1.0),
                "probes.voltage_pair",
                "it is the value, otherwise a probe",
            ),
            (
                Loop {
                    shunt: shunt_of(15.0e-3),
                    ..CIRCUIT
                },
                step(1.0),
                "probes.current_pair",
                "`--fixture shunt` decides",
            ),
            (
                on_shunt(15.0e-3),
                both(1.0, 1.0),
                "probes.current_pair",
                "shows the current that was commanded",
            ),
            (
                on_shunt(9.96e-3),
                both(1.5, 1.0),
                "meters.ammeter",
                "disagree",
            ),
            (
                on_shunt(15.0e-3),
                both(1.0, 2.0),
                "probes.current_pair",
                "not a probe but the value",
            ),
            // Both controls agree with each other, but not with the ammeter.
            (
                CIRCUIT,
                Step {
                    ammeter_a: 1.5,
                    ..step(1.0)
                },
                "meters.ammeter",
                "disagree",
            ),
        ] {
            let found = failed_on(&circuit, &step);
            assert!(
                found
                    .first()
                    .is_some_and(|(met, advice)| met == id && advice.contains(word)),
                "{id}, {word}: {found:?}"
            );
        }
    }
}
