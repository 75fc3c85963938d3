//! What charge went into the cell before a run: what remembers it, remembers the stretches between reversals.

use super::block::{Block, Kind};

/// Part of the capacity by which states of charge must differ for charge to have flown between two runs: voltages at rest, which they are read from, lie higher
/// or lower after a charge or a discharge.
const LEAST_BETWEEN: f64 = 0.01;
/// Charge that must flow back to be a reversal, as a part of the capacity.
const LEAST_REVERSAL: f64 = 1e-4;

impl Block {
    /// Adds what its record puts into the cell and says how much that is, C: nothing for a sweep, whose swings are small.
    fn add_charge(&self, all: &mut Stretches) -> f64 {
        let Kind::Time(time) = &self.kind else { return 0.0 };
        let mut sum_c = 0.0;
        for k in 1..time.time_s.len() {
            let amps = if time.linear { 0.5 * (time.current_a[k] + time.current_a[k - 1]) } else { time.current_a[k - 1] };
            let charge_c = -amps * (time.time_s[k] - time.time_s[k - 1]);
            all.add(charge_c);
            sum_c += charge_c;
        }
        sum_c
    }

    /// Charge before a run that follows this one and begins at a state of charge, see [`Record::before_c`].
    pub(super) fn charge_until(&self, soc: f64, capacity_ah: f64) -> Vec<f64> {
        let mut all = Stretches { all_c: self.before_c.clone(), ..Stretches::new(capacity_ah) };
        let own_soc = self.at.soc + self.add_charge(&mut all) / (3600.0 * capacity_ah);
        all.add((soc - own_soc) * 3600.0 * capacity_ah);
        all.all_c
    }

    /// Tells each block, in the order of time, what charge went before it. Between two runs of a cell flows what the state of charge differs by.
    pub(super) fn tell_charge(blocks: &mut [Self], capacity_ah: f64) {
        let (mut all, mut soc) = (Stretches::new(capacity_ah), None);
        for block in blocks.iter_mut().filter(|b| b.at.is_cell) {
            let between = soc.map_or(0.0, |soc: f64| block.at.soc - soc);
            if between.abs() > LEAST_BETWEEN {
                all.add(between * 3600.0 * capacity_ah);
            }
            block.before_c.clone_from(&all.all_c);
            soc = Some(block.at.soc + block.add_charge(&mut all) / (3600.0 * capacity_ah));
        }
    }
}

/// Charges without a reversal.
struct Stretches {
    all_c: Vec<f64>,
    /// Put back since the last stretch's end, too little to be a reversal.
    back_c: f64,
    least_c: f64,
}

impl Stretches {
    fn new(capacity_ah: f64) -> Self {
        Self { all_c: vec![0.0], back_c: 0.0, least_c: LEAST_REVERSAL * 3600.0 * capacity_ah }
    }

    fn add(&mut self, charge_c: f64) {
        self.back_c += charge_c;
        match self.all_c.last_mut() {
            Some(last) if *last * self.back_c >= 0.0 => *last += std::mem::take(&mut self.back_c),
            _ if self.back_c.abs() > self.least_c => self.all_c.push(std::mem::take(&mut self.back_c)),
            _ => {}
        }
    }
}
