//! Charge that went through the cell before a run. Effects with memory remember the stretches
//! between reversals, and a sweep's swings wear them off.

use super::block::{Block, Kind};
use crate::thresholds::{LEAST_CHARGE_BETWEEN, LEAST_REVERSAL, SWEEP_INTERRUPTED};
use analysis_effects::contract::{Moved, Point};

impl Block {
    /// Adds the charge that it moves through the cell and returns how much of it remains there, C.
    fn add_charge(&self, all: &mut Stretches) -> f64 {
        let time = match &self.kind {
            Kind::Time(time) => time,
            Kind::Eis { points, .. } => {
                all.swing(swung_coulomb(self.at.start_s, points));
                return 0.0;
            }
        };
        let mut sum_coulomb = 0.0;
        for k in 1..time.time_s.len() {
            let amps = if time.linear {
                0.5 * (time.current_a[k] + time.current_a[k - 1])
            } else {
                time.current_a[k - 1]
            };
            let charge_coulomb = -amps * (time.time_s[k] - time.time_s[k - 1]);
            all.add(charge_coulomb);
            sum_coulomb += charge_coulomb;
        }
        sum_coulomb
    }

    /// Returns the charge before a run that follows this one and begins at a state of charge, see
    /// [`Record::before`](analysis_effects::contract::Record::before).
    pub(super) fn charge_until(&self, soc: f64, capacity_ah: f64) -> Vec<Moved> {
        let mut all = Stretches {
            all: self.before.clone(),
            ..Stretches::new(capacity_ah)
        };
        let own_soc = self.at.soc + self.add_charge(&mut all) / (3600.0 * capacity_ah);
        // The start of a planned run is requested, not read from a voltage.
        all.add((soc - own_soc) * 3600.0 * capacity_ah);
        all.all
    }

    /// Sets in each block, in the order of time, the charge that flowed before it. The difference
    /// in state of charge between two runs of a cell gives the charge between them.
    pub(super) fn tell_charge(blocks: &mut [Self], capacity_ah: f64) {
        let (mut all, mut soc) = (Stretches::new(capacity_ah), None);
        for block in blocks.iter_mut().filter(|b| b.at.is_cell) {
            let between = soc.map_or(0.0, |soc: f64| block.at.soc - soc);
            if between.abs() > LEAST_CHARGE_BETWEEN {
                all.add(between * 3600.0 * capacity_ah);
            }
            block.before.clone_from(&all.all);
            soc = Some(block.at.soc + block.add_charge(&mut all) / (3600.0 * capacity_ah));
        }
    }
}

/// Returns the charge that a sweep's current puts in and takes out, C. The mean size of a sine is
/// 2/π of its amplitude, and the times of the points determine how long each lasted. Returns zero
/// if amplitude or times are not known, or if there is a direct current.
fn swung_coulomb(start_s: f64, points: &[Point]) -> f64 {
    let mut visited: Vec<&Point> = points.iter().collect();
    visited.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    let [first, .., last] = visited[..] else {
        return 0.0;
    };
    if points.iter().any(|p| p.bias_a != 0.0) {
        return 0.0;
    }
    let apart_s: Vec<f64> = visited
        .windows(2)
        .map(|w| w[1].start_s - w[0].start_s)
        .collect();
    // A point takes a wait, which the quick points determine, and some periods, which the slow
    // points determine.
    let mut by_frequency: Vec<(f64, f64)> = apart_s
        .iter()
        .zip(&visited[1..])
        .map(|(s, p)| (p.freq_hz, *s))
        .collect();
    by_frequency.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (slow, quick) = by_frequency.split_at(by_frequency.len().div_ceil(2));
    let wait_s = median(quick.iter().map(|(_, s)| *s));
    let periods = median(
        slow.iter()
            .map(|(freq_hz, s)| (s - wait_s).max(0.0) * freq_hz),
    );
    // A sweep that was interrupted went on much later.
    let usual = |s: f64, p: &Point| {
        if s <= SWEEP_INTERRUPTED * (wait_s + periods / p.freq_hz) {
            s
        } else {
            wait_s
        }
    };
    // The duration of the rest before the first point is not recorded; the time of a point is the
    // middle of its capture.
    let before_s = usual(apart_s[0], visited[1]).min(first.start_s - start_s);
    let after_s = 0.5 * usual(apart_s[apart_s.len() - 1], last);
    let swung = |s: f64, p: &Point| s * p.amplitude_a.unwrap_or(0.0);
    let between: f64 = apart_s
        .iter()
        .zip(&visited[1..])
        .map(|(s, p)| swung(usual(*s, p), p))
        .sum();
    std::f64::consts::FRAC_2_PI * (swung(before_s, first) + between + swung(after_s, last))
}

/// Returns the middle one, of an even number the lower, 0 of none.
fn median(of: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = of.collect();
    sorted.sort_by(f64::total_cmp);
    sorted
        .get(sorted.len().saturating_sub(1) / 2)
        .copied()
        .unwrap_or(0.0)
}

/// Charges without a reversal, and swings between them.
struct Stretches {
    all: Vec<Moved>,
    /// Put back since the last stretch's end, too little to be a reversal.
    back_coulomb: f64,
    least_coulomb: f64,
}

impl Stretches {
    fn new(capacity_ah: f64) -> Self {
        Self {
            all: vec![Moved::default()],
            back_coulomb: 0.0,
            least_coulomb: LEAST_REVERSAL * 3600.0 * capacity_ah,
        }
    }

    fn add(&mut self, charge_coulomb: f64) {
        self.back_coulomb += charge_coulomb;
        match self.all.last_mut() {
            Some(last) if last.charge_coulomb * self.back_coulomb >= 0.0 => {
                *last =
                    Moved::one_way(last.charge_coulomb + std::mem::take(&mut self.back_coulomb));
            }
            _ if self.back_coulomb.abs() > self.least_coulomb => self
                .all
                .push(Moved::one_way(std::mem::take(&mut self.back_coulomb))),
            _ => {}
        }
    }

    fn swing(&mut self, through_coulomb: f64) {
        if through_coulomb > 0.0 {
            self.all.extend([
                Moved {
                    charge_coulomb: 0.0,
                    through_coulomb,
                },
                Moved::default(),
            ]);
        }
    }
}
