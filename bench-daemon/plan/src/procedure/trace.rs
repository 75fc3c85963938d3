//! A current trace: the bipolar supply drives steps of direct current. The scope cannot record
//! while it is read, so it records frames around the steps and short ones between them. A wave in
//! the generator's memory is one frame; a trace through load and supply is recorded by their own
//! meters.

use std::{ops::RangeInclusive, sync::Arc};

use instruments::{
    fixture::Fixture,
    units::{Amps, Ohms, Seconds, Unit, Volts},
};

use crate::{
    config::{AFTER_WAVE_S, BEFORE_S, Cell, Segment, Trace},
    plan::{Frame, LONGEST_FRAME_S, Level, Purpose, Stage, Step, Through, TracePlan},
};

use super::power::Power;

/// Least time from a step to the end of its frame, s.
const AFTER_S: Seconds = Seconds(2.0);
/// Longest part of a rest before the first step that is recorded, s.
const LEAD_S: Seconds = Seconds(20.0);
/// Time to read a frame and arm for the next, s.
const GAP_S: Seconds = Seconds(2.5);
/// Length of a frame between steps, s: long enough to roll.
const SPOT_S: Seconds = Seconds(1.0);
const SPOT_POINTS: u64 = 2_000;
/// Greatest share of a step that is due to rounding.
const ROUNDING: f64 = 1.0e-6;
/// Least number of samples per step of a wave, and the available record sizes.
const SAMPLES_PER_STEP: f64 = 8.0;
const WAVE_POINTS: [u64; 3] = [POINTS, 2 * POINTS, 5 * POINTS];
/// Number of points of a frame around steps.
const POINTS: u64 = 100_000;
/// Length up to which a frame has that number of points, s; longer frames have ten times as many.
const FINE_S: Seconds = Seconds(10.0);
/// Distance of the compliance above the cell's limit: a least value, V, and the resistance of the
/// loop, Ω.
const COMPLIANCE: (Volts, Ohms) = (Volts(0.3), Ohms(0.1));
/// Factor and margin, A, of the current limit above the greatest current.
const LIMIT: (f64, Amps) = (1.02, Amps(0.5));

/// Returns the stage of a trace. `screen_s` returns the time that the scope's screen spans for a
/// given least span.
pub(super) fn stage(
    trace: &Trace,
    repeat: usize,
    cell: &Cell,
    power: Power,
    screen_s: impl Fn(Seconds) -> Seconds,
) -> Stage {
    let levels = levels(trace);
    let frames = match trace.through {
        Through::Bipolar => frames(&levels, end_s(trace), trace, screen_s),
        Through::Wave { step_s, .. } => vec![wave_frame(end_s(trace), step_s, screen_s)],
        Through::LoadAndSupply => Vec::new(),
    };
    let plan = Arc::new(TracePlan {
        name: trace.name.clone(),
        repeat,
        role: trace.role,
        repeat_group: trace.repeat_group.clone(),
        through: trace.through,
        averaged: trace.averaged,
        lead_ohm: trace.lead_ohm,
        rest_s: trace.rest_s,
        levels,
        end_s: end_s(trace),
        frames,
        start_v: trace.start_v,
        resistance_max_ohm: trace.resistance_max_ohm,
        capacity_coulomb: cell.capacity_coulomb,
        thinning: (trace.first_sample_s, trace.growth, trace.longest_s),
    });
    let (least_a, greatest_a) = plan.extremes_a();
    let most_a = greatest_a.max(-least_a);
    let up = power.up(
        hundredths(cell.limits.max_v + (COMPLIANCE.1 * most_a).max(COMPLIANCE.0)),
        hundredths(LIMIT.0 * most_a + LIMIT.1),
    );
    let (mount, zero) = (Step::Mount(Fixture::Cell), Step::Zero(plan.clone()));
    let steps = if plan.bipolar() {
        vec![mount, zero, up, Step::Trace(plan), Step::PowerDown]
    } else {
        vec![mount, zero, Step::Trace(plan)]
    };
    Stage {
        purpose: Purpose::Trace,
        steps,
    }
}

/// Rounds to two decimals, which is the resolution of a supply.
fn hundredths<Q: Unit>(value: Q) -> Q {
    Q::of((value.number() * 100.0).round() / 100.0)
}

/// Returns the steps of the current; equal neighbours are merged, and nothing flows at the end.
fn levels(trace: &Trace) -> Vec<Level> {
    let (mut levels, mut flowing, mut at_s): (Vec<Level>, _, Seconds) =
        (Vec::new(), (Amps::ZERO, None), before_s(trace));
    for Segment {
        current_a,
        duration_s,
        power_w,
    } in trace.segments.iter().copied()
    {
        // Without a current the power is undefined.
        let power_w = power_w.filter(|_| current_a != Amps::ZERO);
        if (current_a, power_w) != flowing {
            levels.push(Level {
                at_s,
                current_a,
                power_w,
            });
            flowing = (current_a, power_w);
        }
        at_s += duration_s;
    }
    if flowing.0 != Amps::ZERO || levels.is_empty() {
        levels.push(Level {
            at_s,
            current_a: Amps::ZERO,
            power_w: None,
        });
    }
    levels
}

/// Returns the time before the first row, s: whole steps of a wave.
fn before_s(trace: &Trace) -> Seconds {
    if let Through::Wave { step_s, .. } = trace.through {
        (BEFORE_S / step_s - ROUNDING).ceil() * step_s
    } else {
        BEFORE_S
    }
}

/// Returns the frame that holds a whole wave, with the number of points that its steps require.
fn wave_frame(end_s: Seconds, step_s: Seconds, screen_s: impl Fn(Seconds) -> Seconds) -> Frame {
    let span_s = screen_s(end_s + AFTER_WAVE_S);
    let wanted = span_s / step_s * SAMPLES_PER_STEP;
    let record_points = WAVE_POINTS
        .into_iter()
        .find(|points| *points as f64 >= wanted)
        .unwrap_or(10 * POINTS);
    Frame {
        start_s: Seconds::ZERO,
        span_s,
        memory_points: record_points.max(10 * POINTS),
        record_points,
    }
}

fn end_s(trace: &Trace) -> Seconds {
    before_s(trace)
        + trace
            .segments
            .iter()
            .map(|segment| segment.duration_s)
            .sum::<Seconds>()
}

/// Returns frames around the steps, each as long as its steps require, and spot frames between
/// them. Their spacing grows with the time since the step.
fn frames(
    levels: &[Level],
    end_s: Seconds,
    trace: &Trace,
    screen_s: impl Fn(Seconds) -> Seconds,
) -> Vec<Frame> {
    let mut frames: Vec<Frame> = Vec::new();
    let (mut free_s, mut first, mut stepped_s) = (Seconds::ZERO, 0, Seconds::ZERO);
    while let Some(step) = levels.get(first) {
        let start_s = (step.at_s - BEFORE_S).max(free_s);
        if first == 0 {
            free_s = (start_s - LEAD_S).max(Seconds::ZERO);
        }
        spots(
            free_s..=start_s - GAP_S - SPOT_S,
            stepped_s,
            trace,
            &mut frames,
        );
        let mut last = first;
        let span_s = loop {
            let span_s = screen_s(levels[last].at_s + AFTER_S - start_s);
            let crowded = levels
                .get(last + 1)
                .is_some_and(|next| next.at_s - BEFORE_S < start_s + span_s + GAP_S);
            if !crowded || span_s > LONGEST_FRAME_S {
                break span_s;
            }
            last += 1;
        };
        let points = if span_s <= FINE_S {
            POINTS
        } else {
            10 * POINTS
        };
        frames.push(Frame {
            start_s,
            span_s,
            memory_points: points,
            record_points: points,
        });
        (free_s, first, stepped_s) = (start_s + span_s + GAP_S, last + 1, levels[last].at_s);
    }
    spots(free_s..=end_s - SPOT_S, stepped_s, trace, &mut frames);
    frames
}

fn spots(
    range_s: RangeInclusive<Seconds>,
    stepped_s: Seconds,
    trace: &Trace,
    frames: &mut Vec<Frame>,
) {
    let (mut at_s, latest_s) = range_s.into_inner();
    while at_s <= latest_s {
        frames.push(Frame {
            start_s: at_s,
            span_s: SPOT_S,
            memory_points: 10_000,
            record_points: SPOT_POINTS,
        });
        at_s += (trace.growth * (at_s - stepped_s))
            .clamp(SPOT_S + GAP_S, trace.longest_s.max(SPOT_S + GAP_S));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_signal::series::Role;

    fn trace(segments: &[(f64, f64)]) -> Trace {
        Trace {
            name: "t".to_owned(),
            role: Role::Train,
            repeat_group: "t".to_owned(),
            repeat: 1,
            rest_s: Seconds(0.0),
            through: Through::Bipolar,
            averaged: None,
            lead_ohm: Ohms(0.0),
            start_v: (Volts(3.6), Volts(3.8)),
            resistance_max_ohm: Ohms(0.03),
            segments: segments
                .iter()
                .map(|&(current_a, duration_s)| Segment {
                    current_a: Amps(current_a),
                    duration_s: Seconds(duration_s),
                    power_w: None,
                })
                .collect(),
            first_sample_s: Seconds(0.002),
            growth: 0.25,
            longest_s: Seconds(10.0),
        }
    }

    /// Returns screens of 1, 2, 5 and so on.
    fn screen_s(span_s: Seconds) -> Seconds {
        [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0]
            .map(Seconds)
            .into_iter()
            .find(|screen_s| *screen_s >= span_s)
            .unwrap_or(Seconds(1000.0))
    }

    fn laid_out(segments: &[(f64, f64)]) -> (Vec<Level>, Vec<Frame>) {
        let trace = trace(segments);
        let levels = levels(&trace);
        let frames = frames(&levels, end_s(&trace), &trace, screen_s);
        (levels, frames)
    }

    #[test]
    fn equal_neighbours_are_one_step_and_nothing_flows_at_the_end() {
        let (levels, _) = laid_out(&[(0.0, 2.0), (-5.0, 3.0), (-5.0, 4.0), (3.0, 5.0)]);
        let met: Vec<(f64, f64)> = levels
            .iter()
            .map(|level| (level.at_s.value(), level.current_a.value()))
            .collect();
        assert_eq!(met, [(2.5, -5.0), (9.5, 3.0), (14.5, 0.0)]);
    }

    #[test]
    fn the_end_of_a_rest_before_the_first_step_is_recorded() {
        let starts = |rest_s: f64| -> Vec<f64> {
            let (_, frames) = laid_out(&[(0.0, rest_s), (-5.0, 5.0)]);
            frames
                .iter()
                .take(6)
                .map(|frame| frame.start_s.value())
                .collect()
        };
        assert_eq!(starts(15.0), [0.0, 3.5, 7.0, 10.5, 15.0]);
        assert_eq!(starts(100.0)[0], 80.0);
        assert_eq!(starts(3.0), [3.0]);
    }

    #[test]
    fn every_step_has_its_frame_and_frames_leave_time_to_be_read() {
        let pulses = [(-5.0, 5.0), (0.0, 35.0), (5.0, 5.0), (0.0, 35.0)];
        let long = [(-9.0, 300.0), (0.0, 300.0)];
        let crowd = [
            (-9.0, 2.0),
            (4.0, 3.0),
            (-1.0, 2.0),
            (7.0, 30.0),
            (0.0, 10.0),
        ];
        for (segments, around) in [
            (&pulses[..], vec![10.0, 10.0]),
            (&long, vec![5.0, 5.0]),
            (&crowd, vec![10.0, 5.0]),
        ] {
            let (levels, frames) = laid_out(segments);
            for level in &levels {
                let held = |frame: &&Frame| {
                    frame.start_s + BEFORE_S <= level.at_s
                        && level.at_s + AFTER_S <= frame.start_s + frame.span_s
                };
                assert!(
                    frames.iter().any(|frame| held(&frame)),
                    "{level:?}: {frames:?}"
                );
            }
            for pair in frames.windows(2) {
                assert!(
                    pair[1].start_s - pair[0].start_s - pair[0].span_s >= GAP_S - Seconds(1.0e-9),
                    "{pair:?}"
                );
            }
            let steps: Vec<f64> = frames
                .iter()
                .filter(|frame| frame.span_s > SPOT_S)
                .map(|frame| frame.span_s.value())
                .collect();
            assert_eq!(steps, around, "{frames:?}");
        }
        // The spacing of the spot frames grows with the time since the step, up to the longest
        // interval.
        let (_, frames) = laid_out(&long);
        let gaps: Vec<f64> = frames
            .windows(2)
            .take(30)
            .map(|pair| (pair[1].start_s - pair[0].start_s).value())
            .collect();
        assert!(
            gaps[1] < 4.0 && (gaps[28] - 10.0).abs() < 1.0e-9,
            "{gaps:?}"
        );
    }
}
