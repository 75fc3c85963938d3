//! Determines at which step an interrupted stage is resumed.
use crate::journal::PointDone;
use bench_plan::plan::{Stage, Step};

/// Resume point of an interrupted stage; by default its beginning.
#[derive(Debug, Clone, Default)]
pub struct ResumePoint<'a> {
    /// The first step that is executed.
    pub from: usize,
    /// Points that were finished before, with their steps.
    pub points: Vec<&'a PointDone>,
}

impl<'a> ResumePoint<'a> {
    pub(super) fn point(&self, index: usize) -> Option<&'a PointDone> {
        self.points
            .iter()
            .copied()
            .find(|point| point.step == index)
    }

    /// Returns true for steps that are executed again: fixtures are clamped and outputs are
    /// powered again, as long as anything remains to be measured.
    pub(super) fn plays(&self, stage: &Stage, index: usize, step: &Step) -> bool {
        let sine = |(at, step): (usize, &Step)| match step {
            Step::Sine { .. } => self.point(at).is_none(),
            // Whether it was done does not matter: repeated, it finds nothing to do.
            Step::Recheck(_) => true,
            _ => false,
        };
        let idle = !self.points.is_empty() && !stage.steps.iter().enumerate().any(sine);
        let clamps = matches!(step, Step::Specimen(_) | Step::Mount(_));
        self.point(index).is_none() && !idle && (index >= self.from || clamps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_plan::test_settings;
    use analysis_signal::spectrum::{ChannelPhasors, PhasorVariance};
    use bench_plan::{interlock::Reading, measure::SweepPoint, plan::Purpose};
    use instruments::units::{Amps, Hertz, Seconds, Volts};
    use instruments::{fixture::Fixture, supply4q::Holds};

    fn done(step: usize) -> PointDone {
        let phasors = ChannelPhasors {
            freq_hz: 1.0,
            volts: [num_complex::Complex64::ONE; 4],
            variance: [PhasorVariance::circular(1.0e-12); 4],
        };
        let point = SweepPoint {
            fixture: Fixture::Cell,
            index: step - 2,
            phasors,
            volts_per_div: [1.0; 4],
            free_freq_hz: Hertz(1.0),
            residual_lag1: 0.0,
            harmonics_and_drift: bench_plan::measure::HarmonicsAndDrift::default(),
            warnings: Vec::new(),
            time_s: Seconds(0.0),
            captures: 1,
            rechecked: 0,
            spent: bench_plan::measure::Spent::default(),
            measures: bench_plan::measure::quality::Measures::default(),
            failing: Vec::new(),
            conditions: None,
        };
        PointDone {
            stage: 0,
            step,
            files: Vec::new(),
            idle: Reading::default(),
            point,
        }
    }

    #[test]
    fn what_is_finished_is_left_out_and_what_carries_the_rest_is_not() {
        let sine = |index| Step::Sine {
            index,
            freq_hz: Hertz(1.0),
            amplitude_a: Amps(1.0),
            wait_s: Seconds(12.0),
            settings: test_settings(),
        };
        let up = Step::PowerUp {
            compliance_v: Volts(4.5),
            limit_a: Amps(2.0),
            held: Holds::CurrentAndVoltage,
            idle_a: Amps(0.2),
            depth: None,
        };
        let steps = vec![
            Step::Mount(Fixture::Cell),
            up,
            sine(0),
            sine(1),
            Step::PowerDown,
        ];
        let stage = Stage {
            purpose: Purpose::Sweep(Fixture::Cell, 1),
            steps,
        };
        let points: Vec<PointDone> = [2, 3].map(done).to_vec();
        for (from, finished, played) in [
            (0, 0..0, vec![0, 1, 2, 3, 4]),
            (0, 0..1, vec![0, 1, 3, 4]),
            (0, 1..2, vec![0, 1, 2, 4]),
            (0, 0..2, vec![]),
            (4, 0..0, vec![0, 4]),
        ] {
            let resume_point = ResumePoint {
                from,
                points: points[finished].iter().collect(),
            };
            let met: Vec<usize> = stage
                .steps
                .iter()
                .enumerate()
                .filter(|(index, step)| resume_point.plays(&stage, *index, step))
                .map(|(index, _)| index)
                .collect();
            assert_eq!(met, played);
        }
    }
}
