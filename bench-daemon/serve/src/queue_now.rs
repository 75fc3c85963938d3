//! The queue as clients see it.

use std::collections::BTreeMap;

use serde::Serialize;
use utoipa::ToSchema;

use super::{Server, queue::Item};

/// Current state of the queue.
#[derive(Debug, Serialize, ToSchema)]
pub struct QueueNow {
    /// Running and waiting runs, in order.
    items: Vec<Item>,
    /// Held benches with the reasons.
    held: BTreeMap<String, String>,
}

impl QueueNow {
    /// Returns the queue state of a server.
    pub fn of(server: &Server) -> Self {
        let queue = server.queue();
        let held = |bench: &bench_plan::config::Bench| {
            queue
                .held(&bench.name)
                .map(|why| (bench.name.clone(), why.to_owned()))
        };
        Self {
            items: queue.items().to_vec(),
            held: server.settings.benches.iter().filter_map(held).collect(),
        }
    }
}

impl Server {
    /// Publishes the queue.
    pub fn tell_queue(&self) {
        let shown = QueueNow::of(self);
        self.hub.tell("queue", &shown);
    }
}
