//! What the watch has done, for the run folder.

use crate::interlock::Drive;

/// Readings of one drive.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Readings {
    /// How many readings were judged.
    pub judged: u64,
    /// How many of them the watch asked for itself.
    pub asked: u64,
    /// Time from the first to the last, s.
    pub span_s: f64,
    /// Longest time between two, s.
    pub longest_s: f64,
    /// Slowest answer of its meter to one question, s.
    pub slowest_s: f64,
}

/// What the watch has done.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WatchLog {
    /// Readings of each drive that the bench has.
    pub readings: [Readings; 3],
    /// Remarks for the report: what could not be read for a while.
    pub remarks: Vec<String>,
    /// Every drive of the bench was read a moment ago, and answers in time.
    pub sees_every_drive: bool,
}

impl WatchLog {
    /// Takes a reading that came at `machine_s`, `since_s` after the one before.
    pub(super) fn count(&mut self, drive: Drive, since_s: Option<f64>, answer_s: f64, own: bool) {
        let readings = &mut self.readings[drive as usize];
        readings.judged += 1;
        readings.asked += u64::from(own);
        readings.slowest_s = readings.slowest_s.max(answer_s);
        if let Some(since_s) = since_s {
            readings.span_s += since_s;
            readings.longest_s = readings.longest_s.max(since_s);
        }
    }

    /// One line for each drive: readings per second, longest gap, slowest answer.
    pub fn lines(&self) -> Vec<String> {
        Drive::ALL
            .into_iter()
            .filter_map(|drive| {
                let Readings {
                    judged,
                    asked,
                    span_s,
                    longest_s,
                    slowest_s,
                } = self.readings[drive as usize];
                (span_s > 0.0).then(|| {
                    format!(
                        "watch of the {}: {judged} readings in {span_s:.1} s ({:.2} per second, \
                        {asked} asked by the watch), longest gap {longest_s:.2} s, slowest answer \
                        {slowest_s:.3} s",
                        drive.role(),
                        judged as f64 / span_s
                    )
                })
            })
            .collect()
    }
}
