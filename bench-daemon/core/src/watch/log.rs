//! Statistics of the watch, for the run folder.

use instruments::units::Seconds;

use bench_plan::interlock::Drive;

/// Statistics of the readings of one drive.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Readings {
    /// Number of readings that were judged.
    pub judged: u64,
    /// Number of readings that the watch requested itself.
    pub asked: u64,
    /// Time from the first to the last reading, s.
    pub span_s: Seconds,
    /// Longest time between two readings, s.
    pub longest_s: Seconds,
    /// Longest answer time of its meter to one query, s.
    pub slowest_s: Seconds,
}

/// Statistics of the watch.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WatchLog {
    /// Readings of each drive of the bench.
    pub readings: [Readings; 3],
    /// Remarks for the report, for example on drives that could not be read for a while.
    pub remarks: Vec<String>,
}

impl WatchLog {
    /// Adds a reading that arrived at `machine_s`, `since_s` after the previous one.
    pub(super) fn count(
        &mut self,
        drive: Drive,
        since_s: Option<Seconds>,
        answer_s: Seconds,
        own: bool,
    ) {
        let readings = &mut self.readings[drive as usize];
        readings.judged += 1;
        readings.asked += u64::from(own);
        readings.slowest_s = readings.slowest_s.max(answer_s);
        if let Some(since_s) = since_s {
            readings.span_s += since_s;
            readings.longest_s = readings.longest_s.max(since_s);
        }
    }

    /// Returns one line for each drive: readings per second, longest gap, longest answer time.
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
                (span_s > Seconds::ZERO).then(|| {
                    format!(
                        "watch of the {}: {judged} readings in {span_s:.1} ({:.2} per second, \
                        {asked} asked by the watch), longest gap {longest_s:.2}, slowest answer \
                        {slowest_s:.3}",
                        drive.role(),
                        (judged as f64 / span_s).0
                    )
                })
            })
            .collect()
    }
}
