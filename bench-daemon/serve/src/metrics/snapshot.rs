//! State of a server at one moment, for its metrics.

use instruments::clock;

use super::sample::Sample;
use crate::{
    Server,
    health::{BenchHealth, Noted},
    live::Live,
    queue::Item,
};

/// State of a server at one moment.
pub struct Snapshot<'a> {
    /// The server, for its counters.
    pub server: &'a Server,
    /// Each bench.
    pub live: Vec<Live>,
    /// Places in the queue.
    pub queue: Vec<Item>,
    /// Notes of disk, controls and ends of runs.
    pub noted: Noted,
    /// Now, s since 1970.
    pub unix_s: f64,
}

impl<'a> Snapshot<'a> {
    /// The state now. No disk is touched.
    pub fn of(server: &'a Server) -> Self {
        Self {
            live: server.live().values().cloned().collect(),
            queue: server.queue().items().to_vec(),
            noted: server.health.noted(),
            unix_s: clock::unix_time_s(),
            server,
        }
    }

    /// A value for each bench that has one.
    pub fn benches(&self, value: impl Fn(&Live) -> Option<f64>) -> Vec<Sample> {
        let sample = |live: &Live| {
            Some(Sample {
                labels: vec![("bench", live.bench.clone())],
                value: value(live)?,
            })
        };
        self.live.iter().filter_map(sample).collect()
    }

    /// Returns one health value of each bench.
    pub fn noted(&self, value: impl Fn(&BenchHealth) -> Option<f64>) -> Vec<Sample> {
        let none = BenchHealth::default();
        self.benches(|live| value(self.noted.benches.get(&live.bench).unwrap_or(&none)))
    }

    /// Places that wait for a bench.
    pub fn waiting(&self, bench: &str) -> impl Iterator<Item = &Item> {
        let waits = |item: &&Item| item.process.is_none();
        let here = move |item: &&Item| item.bench == *bench;
        self.queue.iter().filter(waits).filter(here)
    }

    /// The place of the run in work on a bench.
    pub fn in_work(&self, bench: &str) -> Option<&Item> {
        let here = |item: &&Item| item.bench == bench && item.process.is_some();
        self.queue.iter().find(here)
    }
}
