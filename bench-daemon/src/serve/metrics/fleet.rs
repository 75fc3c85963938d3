//! Metrics of the fleet; empty if no fleet is configured. If the NATS server is unreachable, only
//! that is reported: earlier counts would be stale.

use bench_fleet::{Fleet, JobCounts, JobState, Tally};

use super::{
    metric::{Metric, gauge},
    sample::Sample,
    snapshot::Snapshot,
};

/// Values with the label `fleet`, which is equal for all servers of a fleet.
struct Rows<'a>(&'a Fleet);

impl Rows<'_> {
    fn labels(&self) -> Vec<(&'static str, String)> {
        vec![("fleet", self.0.settings().fleet.clone())]
    }

    fn plain(&self, value: f64) -> Vec<Sample> {
        let labels = self.labels();
        vec![Sample { labels, value }]
    }

    fn by_state<'a>(&self, counts: impl Iterator<Item = (&'a str, usize)>) -> Vec<Sample> {
        let row = |(state, count): (&str, usize)| {
            let mut labels = self.labels();
            labels.push(("state", state.to_owned()));
            Sample {
                labels,
                value: count as f64,
            }
        };
        counts.map(row).collect()
    }
}

fn of(now: &Snapshot<'_>, read: impl Fn(&Rows<'_>) -> Vec<Sample>) -> Vec<Sample> {
    let fleet = now.server.fleet.get();
    fleet.map_or_else(Vec::new, |fleet| read(&Rows(fleet)))
}

fn counted(now: &Snapshot<'_>, read: impl Fn(&Rows<'_>, &Tally) -> Vec<Sample>) -> Vec<Sample> {
    of(now, |rows| {
        let tally = rows.0.tally();
        tally.map_or_else(Vec::new, |tally| read(rows, &tally))
    })
}

fn jobs(counts: &JobCounts) -> impl Iterator<Item = (&'static str, usize)> {
    let by_state = JobState::ALL.map(|state| (state.name(), counts.of(state)));
    by_state.into_iter().chain([("lost", counts.lost)])
}

/// All metrics of the fleet.
pub(super) const METRICS: &[Metric] = &[
    gauge(
        "fleet_connected",
        "",
        "The NATS server of the fleet is there.",
        |now| of(now, |rows| rows.plain(f64::from(rows.0.is_connected()))),
    ),
    gauge(
        "fleet_jobs",
        "{job}",
        "Jobs of the whole fleet by their state; a lost one is not counted as started.",
        |now| counted(now, |rows, tally| rows.by_state(jobs(&tally.jobs))),
    ),
    gauge(
        "fleet_stranded_jobs",
        "{job}",
        "Jobs that wait and that no bench of the fleet can take.",
        |now| counted(now, |rows, tally| rows.plain(tally.stranded as f64)),
    ),
    gauge(
        "fleet_benches",
        "{bench}",
        "Benches of the whole fleet by their state.",
        |now| {
            counted(now, |rows, tally| {
                let benches = tally.benches.iter();
                rows.by_state(benches.map(|(state, count)| (*state, *count)))
            })
        },
    ),
];
