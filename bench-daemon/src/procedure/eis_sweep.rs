//! EIS sweep (thesis 3.3.1): one sinusoid after the other, at least eleven periods plus one second each. The same sweep over a control impedance is
//! the fixture check (thesis 3.3.2).

use instruments::mock::plant::Fixture;

use crate::{
    config::Eis,
    interlock::Limits,
    plan::{Purpose, Stage, Step},
};

/// Resistance of the loop outside the cell that the compliance must allow for, Ω: leads, shunt, contacts.
const LOOP_OHM: f64 = 0.1;
/// The compliance lies at least this much above the cell's limit, V: below the cell's voltage the two loops of the supply would fight and drive more
/// current than asked for, and the limit is only good to 0.3 % of the rated voltage.
const COMPLIANCE_MARGIN_V: f64 = 0.3;
/// The current limit lies above the amplitude by this factor …
const LIMIT_FACTOR: f64 = 1.25;
/// … and this much, A, for the offset that the trim has to cancel.
const LIMIT_MARGIN_A: f64 = 0.75;
/// A trigger comes within one and a half periods once half a screen has passed.
const TRIGGER_PERIODS: f64 = 1.5;
/// For the scope to take the frame, s.
const FRAME_MARGIN_S: f64 = 0.2;

/// `repeat` is 0 where the fixture is a control. `held`: the bipolar supply limits its current by itself.
pub(super) fn stage((fixture, repeat, held): (Fixture, usize, bool), eis: &Eis, limits: &Limits, screen_s: impl Fn(f64) -> f64) -> Stage {
    let mut steps = vec![Step::Mount(fixture)];
    if fixture == Fixture::Cell && eis.rest_s > 0.0 {
        steps.push(Step::Pause { span_s: eis.rest_s });
    }
    steps.push(Step::PowerUp {
        compliance_v: limits.max_v + (LOOP_OHM * eis.amplitude_a).max(COMPLIANCE_MARGIN_V),
        limit_a: LIMIT_FACTOR * eis.amplitude_a + LIMIT_MARGIN_A,
        held,
    });
    for (index, &freq_hz) in eis.freqs_hz.iter().enumerate() {
        let thesis_s = eis.periods / freq_hz + eis.extra_wait_s;
        let frame_s = screen_s(eis.periods_on_screen / freq_hz) + TRIGGER_PERIODS / freq_hz + FRAME_MARGIN_S;
        steps.push(Step::Sine { index, freq_hz, amplitude_a: eis.amplitude_a, wait_s: thesis_s.max(frame_s) });
    }
    steps.push(Step::PowerDown);
    Stage { purpose: Purpose::Sweep(fixture, repeat), steps }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_waits_eleven_periods_and_a_second_and_a_whole_frame() {
        let eis = Eis {
            fixture: Fixture::Cell,
            repeat: 1,
            rest_s: 0.0,
            freqs_hz: vec![0.1, 0.21, 300.0],
            amplitude_a: 1.0,
            periods: 11.0,
            extra_wait_s: 1.0,
            periods_on_screen: 5.0,
            record_points: 10_000,
            memory_points: 1_000_000,
            mains_hz: None,
        };
        let limits = Limits { min_v: 2.5, max_v: 4.2, charge_a: 13.5, discharge_a: 45.0, min_c: 0.0, max_c: 60.0 };
        let stage = stage((Fixture::Cell, 1, true), &eis, &limits, |span_s| 2.5 * span_s);
        let waits: Vec<(f64, f64)> = stage
            .steps
            .iter()
            .filter_map(|step| if let Step::Sine { freq_hz, wait_s, .. } = step { Some((*freq_hz, *wait_s)) } else { None })
            .collect();
        assert_eq!(waits.len(), 3);
        for (freq_hz, wait_s) in waits {
            assert!(wait_s >= 11.0 / freq_hz + 1.0 && wait_s >= (12.5 + 1.5) / freq_hz, "{freq_hz} Hz waits {wait_s} s");
        }
        assert!(
            matches!(stage.steps[1], Step::PowerUp { compliance_v, limit_a, .. } if (compliance_v - 4.5).abs() < 1e-9 && limit_a == 2.0)
        );
    }
}
