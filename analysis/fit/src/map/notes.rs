//! Remarks on what the data do not show.

use super::design::Design;
use super::log::Log;
use super::train::Train;
use analysis_model::map::CellMap;
use std::f64::consts::TAU;

impl Design {
    /// Remarks on what the logs do not show.
    pub(super) fn notes(&self, map: &CellMap, train: &Train) -> Vec<String> {
        let mut notes = Vec::new();
        // The branch that continues the spectra stands for those that are faster.
        let shortest_s = self.continued_from.map_or(0.0, f64::recip);
        let left_out_s = self.left_out_s.iter().filter(|tau_s| **tau_s > shortest_s);
        let list: Vec<String> = left_out_s.map(f64::to_string).collect();
        if !list.is_empty() {
            notes.push(format!(
                "no branch of {} s: no log and no spectrum shows it",
                list.join(", ")
            ));
        }
        if let Some(omega) = self.continued_from {
            notes.push(format!(
                "a branch of {:.2} ms continues the spectra beyond {:.0} Hz, their highest frequency without an \
                inductive part: its resistance is extrapolated",
                1e3 * self.taus_s[0],
                omega / TAU
            ));
        }
        for log in &train.logs {
            if let Some(current_a) = log.current_at_start_a(train.ocv.capacity_ah) {
                notes.push(format!(
                    "{} begins under {current_a:.2} A: its branches are taken as at rest there",
                    log.name
                ));
            }
            notes.extend(
                log.remarks
                    .iter()
                    .map(|remark| format!("{}: {remark}", log.name)),
            );
        }
        let inductive: usize = train.sweeps.iter().map(|sweep| sweep.inductive).sum();
        if inductive > 0 {
            notes.push(format!(
                "{inductive} points of the spectra are inductive and left out"
            ));
        }
        if let Some(law) = map.charge_transfer {
            notes.push(format!(
                "resistances of branches up to {} s fall under current, with {:.0} mV of charge transfer at \
                25 °C; the map states them at small current",
                law.slowest_s,
                1e3 * law.voltage_v
            ));
        }
        if self.nodes() == 1 {
            notes.push(format!(
                "one temperature ({:.1} °C): other temperatures follow Arrhenius' law from it",
                self.nodes_degc[0]
            ));
        }
        if train.logs.is_empty() {
            notes.push(
                "no log: the OCV is that of the curve at every temperature, and nothing shows the heat \
                of the cell"
                    .to_owned(),
            );
            return notes;
        }
        if map.thermal.is_none() {
            notes.push(
                "the temperatures do not show the heat of the cell: a simulation keeps it at the \
                temperature of its surroundings"
                    .to_owned(),
            );
        }
        let draws = |log: &&Log| log.samples.current_a.iter().all(|i| *i > -1e-3);
        if train.logs.iter().all(draws) {
            notes.push(
                "no log charges the cell: its charge is predicted by its discharge".to_owned(),
            );
        }
        notes
    }
}
