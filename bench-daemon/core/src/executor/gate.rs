//! Applies the quality gate to a sweep. A point that fails is measured again as long as the
//! sweep's budget of time and charge lasts. The best of its records is kept, and remaining
//! failures are stored with the point.

use analysis_fit::validity::{FEWEST_POINTS, KkPoint, Noise, kramers_kronig};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use instruments::{
    fixture::Fixture,
    units::{Coulombs, Seconds},
};

use super::{ExecuteError, Executor, Known, SweepState};
use crate::{clock::TypedClock, record::Event};
use bench_plan::{
    measure::{
        Spent, SweepPoint,
        quality::{Failing, Quality, severity},
    },
    plan::{Stage, Step, SweepSettings},
};

/// A residual below this number of standard deviations counts as noise.
const CERTAIN: f64 = 5.0;
/// Number of passes over a finished sweep: a point that was measured again changes what the others
/// are compared with.
const ROUNDS: usize = 3;

impl SweepState {
    /// Checks whether another record of a point is within the sweep's budget.
    pub(super) fn afford(&self, quality: &Quality, step: &Step) -> bool {
        let time_s = step.expected_s();
        let more = Spent {
            time_s,
            charge_coulomb: moved_coulomb(step, time_s),
        };
        self.spent.allows(quality, more)
    }
}

impl Known {
    /// Returns the Kramers–Kronig residuals, relative to |Z|, of points that do not fit the
    /// others. Returns nothing if all points fit or the sweep is too short for the test. If a
    /// sweep runs up and down, each direction is tested separately, because the cell may have
    /// changed between them.
    pub(super) fn residuals(&self, points: &[SweepPoint]) -> Vec<Option<f64>> {
        let mut found = vec![None; points.len()];
        for way in ways(points) {
            let sorted: Vec<(usize, ImpedancePoint)> = way
                .into_iter()
                .map(|k| (k, self.tested(&points[k])))
                .collect();
            if sorted.len() < FEWEST_POINTS {
                continue;
            }
            let spectrum = Spectrum {
                name: "sweep".to_owned(),
                points: sorted.iter().map(|(_, point)| *point).collect(),
                ..Spectrum::default()
            };
            let Ok(test) =
                Noise::of(&spectrum, &[]).and_then(|noise| kramers_kronig(&spectrum, &noise))
            else {
                continue;
            };
            let fails = |point: &KkPoint| point.left_out || point.sigmas > CERTAIN;
            for ((k, _), point) in sorted.iter().zip(&test.points) {
                found[*k] = fails(point).then(|| 0.01 * point.percent());
            }
        }
        found
    }

    /// Prepares a point for the test: corrected, with the noise of its own record.
    fn tested(&self, point: &SweepPoint) -> ImpedancePoint {
        let covariance = self
            .correction
            .measured_parts(&point.phasors)
            .into_iter()
            .sum();
        ImpedancePoint {
            covariance,
            ..self.correction.apply(&point.phasors)
        }
    }
}

impl Executor<'_> {
    /// Applies the gate, if any, to one point.
    pub(super) async fn gated(
        &mut self,
        fixture: Fixture,
        step: &Step,
        settings: &SweepSettings,
    ) -> Result<SweepPoint, ExecuteError> {
        let mut best = self.sine(fixture, step, 0).await?;
        let Some(quality) = settings.quality else {
            return Ok(best);
        };
        best.failing = quality.judge(&best.measures);
        for _ in 0..quality.again {
            if best.failing.is_empty() || !self.sweep.afford(&quality, step) {
                break;
            }
            best = self.measure_again(fixture, step, &quality, best).await?;
        }
        Ok(best)
    }

    /// Returns the better of a point and its next record.
    async fn measure_again(
        &mut self,
        fixture: Fixture,
        step: &Step,
        quality: &Quality,
        before: SweepPoint,
    ) -> Result<SweepPoint, ExecuteError> {
        self.rig.handle_abort()?;
        let reasons: Vec<String> = before.failing.iter().map(ToString::to_string).collect();
        let text = format!("{step}: measured again: {}", reasons.join("; "));
        tracing::info!("{text}");
        self.rig.recorder.event(Event::Again, &text)?;
        let start_s = self.rig.clock.now();
        self.rig.begin(fixture, step);
        let mut point = self.sine(fixture, step, before.captures).await?;
        let took_s = self.rig.clock.now() - start_s;
        let spent = Spent {
            time_s: took_s,
            charge_coulomb: moved_coulomb(step, took_s),
        };
        self.sweep.spent = self.sweep.spent + spent;
        let spent = before.spent + spent;
        point.failing = quality.judge(&point.measures);
        let captures = point.captures;
        // A point whose own record is good is measured again for the sake of the sweep: the new
        // record is used if it is as good.
        let of_sweep = before.failing.iter().all(Failing::is_of_sweep) && point.failing.is_empty();
        let better = if of_sweep || severity(&point.failing) < severity(&before.failing) {
            point
        } else {
            before
        };
        Ok(SweepPoint {
            captures,
            spent,
            ..better
        })
    }

    /// Compares the points of a finished sweep with each other, measures again those that do not
    /// fit, and flags those that still do not fit. Returns the points that changed: their steps in
    /// the stage and their indices among the points.
    pub(super) async fn recheck(
        &mut self,
        fixture: Fixture,
        quality: &Quality,
        stage: &Stage,
        points: &mut [SweepPoint],
    ) -> Result<Vec<(usize, usize)>, ExecuteError> {
        let before = points.to_vec();
        for round in 0..=ROUNDS {
            let residuals = self.known.residuals(points);
            let mut again = Vec::new();
            for (point, residual) in points.iter_mut().zip(residuals) {
                point.failing.retain(|failing| !failing.is_of_sweep());
                let fails = residual.and_then(|share| quality.judge_residual(share));
                again.extend(fails.is_some().then_some(point.index));
                point.failing.extend(fails);
            }
            if again.is_empty() || round == ROUNDS {
                break;
            }
            let mut measured = false;
            for index in again {
                let step = stage.steps.iter().find(
                    |step| matches!(step, Step::Sine { index: number, .. } if *number == index),
                );
                let slot = points.iter_mut().find(|point| point.index == index);
                let (Some(step), Some(slot)) = (step, slot) else {
                    continue;
                };
                if slot.rechecked < quality.again && self.sweep.afford(quality, step) {
                    let rechecked = slot.rechecked + 1;
                    let point = self
                        .measure_again(fixture, step, quality, slot.clone())
                        .await?;
                    *slot = SweepPoint { rechecked, ..point };
                    measured = true;
                }
            }
            if !measured {
                break;
            }
        }
        let step = |point: &SweepPoint| {
            stage
                .steps
                .iter()
                .position(|step| matches!(step, Step::Sine { index, .. } if *index == point.index))
        };
        let changed = points
            .iter()
            .zip(&before)
            .enumerate()
            .filter(|(_, (after, before))| after != before);
        Ok(changed
            .filter_map(|(place, (after, _))| Some((step(after)?, place)))
            .collect())
    }
}

/// Returns the indices of the points of each direction, by rising frequency: the first visits of
/// all frequencies, then the second.
fn ways(points: &[SweepPoint]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| {
        let (a, b) = (&points[*a], &points[*b]);
        a.phasors
            .freq_hz
            .total_cmp(&b.phasors.freq_hz)
            .then(a.index.cmp(&b.index))
    });
    let mut ways: Vec<Vec<usize>> = Vec::new();
    let (mut visit, mut freq_hz) = (0, f64::NAN);
    for k in order {
        visit = if points[k].phasors.freq_hz == freq_hz {
            visit + 1
        } else {
            0
        };
        freq_hz = points[k].phasors.freq_hz;
        if ways.len() <= visit {
            ways.push(Vec::new());
        }
        ways[visit].push(k);
    }
    ways
}

/// Returns the charge that a sinusoid moves back and forth, C: its mean magnitude is 2/π of its
/// amplitude.
fn moved_coulomb(step: &Step, time_s: Seconds) -> Coulombs {
    if let Step::Sine { amplitude_a, .. } = step {
        std::f64::consts::FRAC_2_PI * *amplitude_a * time_s
    } else {
        Coulombs::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_signal::spectrum::{ChannelPhasors, PhasorVariance};
    use instruments::units::Hertz;

    fn point(index: usize, freq_hz: f64, time_s: f64) -> SweepPoint {
        let phasors = ChannelPhasors {
            freq_hz,
            volts: [num_complex::Complex64::ONE; 4],
            variance: [PhasorVariance::circular(1.0e-12); 4],
        };
        SweepPoint {
            fixture: Fixture::Cell,
            index,
            phasors,
            volts_per_div: [1.0; 4],
            free_freq_hz: Hertz(freq_hz),
            residual_lag1: 0.0,
            harmonics_and_drift: bench_plan::measure::HarmonicsAndDrift::default(),
            warnings: Vec::new(),
            time_s: Seconds(0.0),
            captures: 1,
            rechecked: 0,
            spent: Spent {
                time_s: Seconds(time_s),
                charge_coulomb: Coulombs(0.5 * time_s),
            },
            measures: bench_plan::measure::quality::Measures::default(),
            failing: Vec::new(),
            conditions: None,
        }
    }

    #[test]
    fn a_sweep_there_and_back_is_two_ways_by_rising_frequency() {
        let freqs = [10.0, 1.0, 100.0, 100.0, 1.0, 10.0];
        let points: Vec<SweepPoint> = freqs
            .iter()
            .enumerate()
            .map(|(k, freq_hz)| point(k, *freq_hz, 0.0))
            .collect();
        assert_eq!(ways(&points), [[1, 0, 2], [4, 5, 3]]);
        assert_eq!(ways(&points[..3]), [[1, 0, 2]]);
    }

    #[test]
    fn what_finished_points_have_spent_counts_on() {
        let quality = Quality {
            noise: 0.0,
            distortion: 0.0,
            drift: 0.0,
            repeatability: 0.0,
            kramers_kronig: 0.0,
            again: 2,
            time_s: Seconds(100.0),
            charge_coulomb: Coulombs(60.0),
        };
        let points = [point(0, 1.0, 30.0), point(1, 2.0, 50.0)];
        let spent = Spent::of(points.iter());
        assert_eq!(
            spent,
            Spent {
                time_s: Seconds(80.0),
                charge_coulomb: Coulombs(40.0)
            }
        );
        let allows = |time_s, charge_coulomb| {
            spent.allows(
                &quality,
                Spent {
                    time_s,
                    charge_coulomb,
                },
            )
        };
        assert!(
            allows(Seconds(20.0), Coulombs(20.0))
                && !allows(Seconds(20.1), Coulombs(0.0))
                && !allows(Seconds(1.0), Coulombs(20.1))
        );
    }
}
