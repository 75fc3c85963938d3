//! EIS sweep (thesis 3.3.1): one sinusoid after the other, at least eleven periods plus one second
//! each. The same sweep over a control impedance is the fixture check (thesis 3.3.2).

use std::sync::Arc;

use instruments::{
    fixture::Fixture,
    units::{Amps, Hertz, Ohms, Seconds, Volts},
};

use crate::{
    config::{Eis, Order},
    interlock::Limits,
    plan::{Purpose, Stage, Step, SweepSettings},
};

use super::{biased, power::Power};

/// Resistance of the loop outside the cell that the compliance must allow for, Ω: leads, shunt,
/// contacts.
const LOOP_OHM: Ohms = Ohms(0.1);
/// Least distance of the compliance above the cell's limit, V: below the cell's voltage the two
/// loops of the supply would interfere and drive more current than requested, and the limit is
/// accurate only to 0.3 % of the rated voltage.
const COMPLIANCE_MARGIN_V: Volts = Volts(0.3);
/// Factor of the current limit on the amplitude.
const LIMIT_FACTOR: f64 = 1.25;
/// Additional margin of the current limit, A, for the offset that the trim must cancel.
const LIMIT_MARGIN_A: Amps = Amps(0.75);
/// Number of periods within which a trigger occurs after half a screen has passed.
const TRIGGER_PERIODS: f64 = 1.5;
/// Time for the scope to take the frame, s.
const FRAME_MARGIN_S: Seconds = Seconds(0.2);

/// One sweep.
pub(super) struct Sweep<'a> {
    /// Fixture that is swept.
    pub(super) fixture: Fixture,
    /// 0 if the fixture is a control.
    pub(super) repeat: usize,
    /// Amplitude, A.
    pub(super) amplitude_a: Amps,
    /// Direct current under it, A.
    pub(super) bias_a: Amps,
    /// Power-up of the bipolar supply.
    pub(super) power: Power,
    /// Frequencies beyond those of the sweep, for a control, Hz.
    pub(super) beyond_hz: &'a [Hertz],
    /// Seed of the order.
    pub(super) seed: u64,
    /// Settings that its points share.
    pub(super) settings: &'a Arc<SweepSettings>,
}

pub(super) fn stage(
    sweep: &Sweep<'_>,
    eis: &Eis,
    limits: &Limits,
    screen_s: impl Fn(Seconds) -> Seconds,
) -> Stage {
    let Sweep {
        fixture,
        repeat,
        amplitude_a,
        bias_a,
        power,
        settings,
        ..
    } = *sweep;
    let mut steps = vec![Step::Mount(fixture)];
    if fixture == Fixture::Cell && eis.rest_s > Seconds::ZERO {
        steps.push(Step::Pause { span_s: eis.rest_s });
    }
    let bias = eis.bias.as_ref().filter(|_| bias_a != Amps::ZERO);
    // The ranges of a run hold the greatest amplitude.
    let bias = bias.map(|bias| bias.plan(bias_a, settings.amplitude_a));
    steps.extend(bias.map(Step::BiasZero));
    let peak_a = bias_a.abs() + amplitude_a;
    steps.push(power.up(
        limits.max_v + (LOOP_OHM * peak_a).max(COMPLIANCE_MARGIN_V),
        LIMIT_FACTOR * peak_a + LIMIT_MARGIN_A,
    ));
    let mut points = Vec::new();
    for (index, freq_hz) in frequencies(sweep, eis).into_iter().enumerate() {
        let thesis_s = eis.periods / freq_hz + eis.extra_wait_s;
        let frame_s =
            screen_s(eis.periods_on_screen / freq_hz) + TRIGGER_PERIODS / freq_hz + FRAME_MARGIN_S;
        points.push(Step::Sine {
            index,
            freq_hz,
            amplitude_a,
            wait_s: thesis_s.max(frame_s),
            settings: settings.clone(),
        });
    }
    match &bias {
        Some(bias) => steps.extend(biased::in_groups(points, bias)),
        None => steps.extend(points),
    }
    if let Some(quality) = eis
        .quality
        .filter(|quality| repeat > 0 && quality.again > 0)
    {
        steps.push(Step::Recheck(quality));
    }
    steps.push(Step::PowerDown);
    Stage {
        purpose: Purpose::Sweep(fixture, repeat),
        steps,
    }
}

/// Returns the frequencies in their order. A control does not change, and is swept upwards. In a
/// sweep up and down, the two visits of each frequency have the same mean time.
fn frequencies(sweep: &Sweep<'_>, eis: &Eis) -> Vec<Hertz> {
    let rising = &eis.freqs_hz;
    if sweep.repeat == 0 {
        return rising.iter().chain(sweep.beyond_hz).copied().collect();
    }
    let mut order: Vec<Hertz> = match eis.order {
        Order::Ascending => rising.clone(),
        Order::Descending => rising.iter().rev().copied().collect(),
        Order::Alternating => {
            let count = rising.len();
            (0..count)
                .map(|k| {
                    if k % 2 == 0 {
                        rising[k / 2]
                    } else {
                        rising[count - 1 - k / 2]
                    }
                })
                .collect()
        }
        Order::Random => shuffled(rising, sweep.seed.wrapping_add(sweep.repeat as u64)),
    };
    if eis.compensate_drift {
        order.extend(order.clone().into_iter().rev());
    }
    order
}

/// Shuffles with the method of Fisher and Yates, with SplitMix64 (Steele, Lea and Flood 2014) as
/// the random number generator.
fn shuffled<T: Clone>(values: &[T], mut state: u64) -> Vec<T> {
    let mut next = || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    let mut values = values.to_vec();
    for k in (1..values.len()).rev() {
        values.swap(k, (next() % (k as u64 + 1)) as usize);
    }
    values
}

#[cfg(test)]
mod tests {
    use instruments::supply4q::Holds;
    use instruments::units::Celsius;

    use super::*;
    use crate::plan::test_settings;

    const POWER: Power = Power {
        held: Holds::CurrentAndVoltage,
        idle_a: Amps(0.2),
        depth: None,
    };

    fn sweep(settings: &Arc<SweepSettings>) -> Sweep<'_> {
        Sweep {
            fixture: Fixture::Cell,
            repeat: 1,
            amplitude_a: Amps(1.0),
            bias_a: Amps(0.0),
            power: POWER,
            beyond_hz: &[],
            seed: 1,
            settings,
        }
    }

    #[test]
    fn every_point_waits_eleven_periods_and_a_second_and_a_whole_frame() {
        let eis = Eis {
            fixture: Fixture::Cell,
            repeat: 1,
            rest_s: Seconds(0.0),
            freqs_hz: vec![Hertz(0.1), Hertz(0.21), Hertz(300.0)],
            amplitude_a: Amps(1.0),
            periods: 11.0,
            extra_wait_s: Seconds(1.0),
            periods_on_screen: 5.0,
            record_points: 10_000,
            memory_points: 1_000_000,
            mains_hz: None,
            order: Order::Ascending,
            steps_a: vec![Amps(1.0)],
            compensate_drift: false,
            overlap: None,
            quality: None,
            bias: None,
        };
        let limits = Limits {
            min_v: Volts(2.5),
            max_v: Volts(4.2),
            charge_a: Amps(13.5),
            discharge_a: Amps(45.0),
            min_degc: Celsius(0.0),
            max_degc: Celsius(60.0),
        };
        let stage = stage(&sweep(&test_settings()), &eis, &limits, |span_s| {
            2.5 * span_s
        });
        let waits: Vec<(Hertz, Seconds)> = stage
            .steps
            .iter()
            .filter_map(|step| {
                if let Step::Sine {
                    freq_hz, wait_s, ..
                } = step
                {
                    Some((*freq_hz, *wait_s))
                } else {
                    None
                }
            })
            .collect();
        assert_eq!(waits.len(), 3);
        for (freq_hz, wait_s) in waits {
            assert!(
                wait_s >= 11.0 / freq_hz + Seconds(1.0) && wait_s >= (12.5 + 1.5) / freq_hz,
                "{freq_hz} waits {wait_s}"
            );
        }
        assert!(matches!(
            stage.steps[1],
            Step::PowerUp { compliance_v, limit_a, .. }
                if (compliance_v - Volts(4.5)).abs() < Volts(1e-9) && limit_a == Amps(2.0)
        ));
    }

    #[test]
    fn the_frequencies_come_in_any_order_and_there_and_back() {
        let eis = |order, compensate_drift| Eis {
            fixture: Fixture::Cell,
            repeat: 1,
            rest_s: Seconds(0.0),
            freqs_hz: [1.0, 2.0, 3.0, 4.0, 5.0].map(Hertz).to_vec(),
            amplitude_a: Amps(1.0),
            periods: 11.0,
            extra_wait_s: Seconds(1.0),
            periods_on_screen: 5.0,
            record_points: 10_000,
            memory_points: 1_000_000,
            mains_hz: None,
            order,
            steps_a: vec![Amps(1.0)],
            compensate_drift,
            overlap: None,
            quality: None,
            bias: None,
        };
        let settings = test_settings();
        let ordered = |order| frequencies(&sweep(&settings), &eis(order, false));
        assert_eq!(
            ordered(Order::Ascending),
            [1.0, 2.0, 3.0, 4.0, 5.0].map(Hertz)
        );
        assert_eq!(
            ordered(Order::Descending),
            [5.0, 4.0, 3.0, 2.0, 1.0].map(Hertz)
        );
        assert_eq!(
            ordered(Order::Alternating),
            [1.0, 5.0, 2.0, 4.0, 3.0].map(Hertz)
        );
        let random = ordered(Order::Random);
        let mut sorted = random.clone();
        sorted.sort_by(Hertz::total_cmp);
        assert!(
            sorted == [1.0, 2.0, 3.0, 4.0, 5.0].map(Hertz) && random != sorted,
            "{random:?}"
        );
        assert_eq!(
            random,
            ordered(Order::Random),
            "the same from the same seed"
        );
        assert_ne!(
            random,
            frequencies(
                &Sweep {
                    repeat: 2,
                    ..sweep(&settings)
                },
                &eis(Order::Random, false)
            ),
            "another one for the next sweep"
        );
        assert_eq!(
            frequencies(&sweep(&settings), &eis(Order::Alternating, true)),
            [1.0, 5.0, 2.0, 4.0, 3.0, 3.0, 4.0, 2.0, 5.0, 1.0].map(Hertz)
        );
        let control = Sweep {
            fixture: Fixture::Shunt,
            repeat: 0,
            beyond_hz: &[Hertz(9.0)],
            ..sweep(&settings)
        };
        assert_eq!(
            frequencies(&control, &eis(Order::Random, true)),
            [1.0, 2.0, 3.0, 4.0, 5.0, 9.0].map(Hertz)
        );
    }
}
