//! Applies the quality gate to a multisine. A band whose lines fail is recorded again as long as
//! the budget lasts, and the better record of every line is kept. The finished multisine is
//! checked for consistency as a sweep is.

use instruments::fixture::Fixture;

use super::{ExecuteError, Executor, SweepState};
use crate::{clock::TypedClock, record::Event};
use bench_plan::{
    measure::{
        Spent, SweepPoint,
        quality::{Failing, Quality, severity},
    },
    plan::{Band, Stage, Step},
};

impl SweepState {
    /// Checks whether another record of a band is within the sweep's budget.
    fn afford_band(&self, quality: &Quality, band: &Band) -> bool {
        let time_s = band.settle_s + band.span_s;
        let more = Spent {
            time_s,
            charge_coulomb: band.mean_a() * time_s,
        };
        self.spent.allows(quality, more)
    }
}

impl Executor<'_> {
    /// Applies the gate, if any, to one band.
    pub(super) async fn gated_band(
        &mut self,
        band: &Band,
        points: &mut Vec<SweepPoint>,
    ) -> Result<(), ExecuteError> {
        let first = points.len();
        for (point, line) in self.multisine(band, first, 0).await? {
            points.push(point);
            self.known.lines.push(line);
        }
        let Some(quality) = band.quality else {
            return Ok(());
        };
        for point in &mut points[first..] {
            point.failing = quality.judge(&point.measures);
        }
        for _ in 0..quality.again {
            if points[first..].iter().all(|point| point.failing.is_empty())
                || !self.sweep.afford_band(&quality, band)
            {
                break;
            }
            self.band_again(band, &quality, first, points).await?;
        }
        Ok(())
    }

    /// Compares the lines of all bands with each other, and records again the bands of those that
    /// do not fit.
    pub(super) async fn recheck_bands(
        &mut self,
        quality: &Quality,
        stage: &Stage,
        points: &mut [SweepPoint],
    ) -> Result<(), ExecuteError> {
        for round in 0..=quality.again {
            let residuals = self.known.residuals(points);
            for (point, residual) in points.iter_mut().zip(residuals) {
                point.failing.retain(|failing| !failing.is_of_sweep());
                point
                    .failing
                    .extend(residual.and_then(|share| quality.judge_residual(share)));
            }
            if round == quality.again {
                break;
            }
            let mut measured = false;
            let mut first = 0;
            for step in &stage.steps {
                let Step::Multisine(band) = step else {
                    continue;
                };
                let range = first..(first + band.design.harmonics.len()).min(points.len());
                first = range.end;
                let fails = points[range.clone()]
                    .iter()
                    .any(|point| point.failing.iter().any(Failing::is_of_sweep));
                if fails && self.sweep.afford_band(quality, band) {
                    self.band_again(band, quality, range.start, points).await?;
                    measured = true;
                }
            }
            if !measured {
                break;
            }
        }
        Ok(())
    }

    /// Records a band again and keeps the better record of every line. A line whose own record is
    /// good is measured again for the sake of the whole.
    async fn band_again(
        &mut self,
        band: &Band,
        quality: &Quality,
        first: usize,
        points: &mut [SweepPoint],
    ) -> Result<(), ExecuteError> {
        let range = first..(first + band.design.harmonics.len()).min(points.len());
        let reasons: Vec<String> = points[range.clone()]
            .iter()
            .flat_map(|point| {
                point
                    .failing
                    .iter()
                    .map(|failing| format!("{:.4} Hz: {failing}", point.phasors.freq_hz))
            })
            .take(3)
            .collect();
        let text = format!(
            "multisine {}: recorded again: {}",
            band.number,
            reasons.join("; ")
        );
        tracing::info!("{text}");
        self.rig.handle_abort()?;
        self.rig.recorder.event(Event::Again, &text)?;
        let start_s = self.rig.clock.now();
        let taken = points[range.clone()]
            .iter()
            .map(|point| point.captures)
            .max()
            .unwrap_or(0);
        let step = Step::Multisine(std::sync::Arc::new(band.clone()));
        self.rig.begin(Fixture::Cell, &step);
        let again = self.multisine(band, first, taken).await?;
        let took_s = self.rig.clock.now() - start_s;
        self.sweep.spent = self.sweep.spent
            + Spent {
                time_s: took_s,
                charge_coulomb: band.mean_a() * took_s,
            };
        for (slot, (mut point, line)) in range.zip(again) {
            point.failing = quality.judge(&point.measures);
            let (captures, before) = (point.captures, &points[slot]);
            let of_sweep = !before.failing.is_empty()
                && before.failing.iter().all(Failing::is_of_sweep)
                && point.failing.is_empty();
            if of_sweep || severity(&point.failing) < severity(&before.failing) {
                points[slot] = point;
                self.known.lines[slot] = line;
            }
            points[slot].captures = captures;
        }
        Ok(())
    }
}
