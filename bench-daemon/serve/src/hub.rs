//! Events of the server. Each event is stored once for all listeners. A listener reads at its own
//! pace; a listener that is too slow detects that it has missed some. Nothing here ever waits for
//! a listener.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use serde::Serialize;
use tokio::sync::watch;

/// Number of events that are kept.
const KEPT: usize = 2048;
/// Maximum number of events in one read.
const AT_ONCE: usize = 64;

/// One event.
#[derive(Debug)]
pub struct Event {
    /// Its number, from 1.
    pub number: u64,
    /// Kind of the event.
    pub kind: &'static str,
    /// JSON on one line.
    pub data: String,
}

/// Events that came.
#[derive(Debug)]
pub struct ReceivedEvents {
    /// In order.
    pub events: Vec<Arc<Event>>,
    /// Some before them are gone.
    pub lost: bool,
}

/// The events of this process.
#[derive(Debug)]
pub struct Hub {
    epoch: u64,
    ring: Mutex<Ring>,
    wake: watch::Sender<u64>,
}

#[derive(Debug, Default)]
struct Ring {
    latest: u64,
    events: VecDeque<Arc<Event>>,
    closed: bool,
}

impl Hub {
    /// Creates a hub without events. `epoch` distinguishes event numbers of this process from
    /// those of an earlier one.
    pub fn new(epoch: u64) -> Self {
        Self {
            epoch,
            ring: Mutex::default(),
            wake: watch::Sender::new(0),
        }
    }

    /// Something changed.
    pub fn tell(&self, kind: &'static str, data: &impl Serialize) {
        let Ok(data) = serde_json::to_string(data) else {
            return;
        };
        let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        ring.latest += 1;
        let number = ring.latest;
        ring.events
            .push_back(Arc::new(Event { number, kind, data }));
        if ring.events.len() > KEPT {
            ring.events.pop_front();
        }
        drop(ring);
        self.wake.send_replace(number);
    }

    /// Closes the hub: no further events follow.
    pub fn close(&self) {
        self.ring
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .closed = true;
        self.wake.send_modify(|_| {});
    }

    /// Returns whether the hub is closed.
    pub fn closed(&self) -> bool {
        self.ring
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .closed
    }

    /// Number of the latest event.
    pub fn latest(&self) -> u64 {
        self.ring
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .latest
    }

    /// Returns the events after the event of this number.
    pub fn after(&self, number: u64) -> ReceivedEvents {
        let ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        let oldest = ring
            .events
            .front()
            .map_or(ring.latest + 1, |event| event.number);
        let skip = usize::try_from((number + 1).saturating_sub(oldest)).unwrap_or(usize::MAX);
        ReceivedEvents {
            events: ring
                .events
                .iter()
                .skip(skip)
                .take(AT_ONCE)
                .cloned()
                .collect(),
            lost: number + 1 < oldest,
        }
    }

    /// The name of an event that a listener may come back with.
    pub fn id(&self, number: u64) -> String {
        format!("{}-{number}", self.epoch)
    }

    /// Returns the number of such an identifier, or `None` if it is invalid or from another
    /// process.
    pub fn number(&self, id: &str) -> Option<u64> {
        let (epoch, number) = id.split_once('-')?;
        let number = number
            .parse()
            .ok()
            .filter(|number| *number <= self.latest())?;
        (epoch.parse() == Ok(self.epoch)).then_some(number)
    }

    /// Returns a receiver that is notified of new events.
    pub fn wake(&self) -> watch::Receiver<u64> {
        self.wake.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_listener_goes_on_where_it_was_and_one_that_is_too_slow_is_notified() {
        let hub = Hub::new(7);
        for number in 0..10 {
            hub.tell("x", &number);
        }
        let news = hub.after(hub.number("7-8").unwrap());
        assert_eq!(
            (
                news.events
                    .iter()
                    .map(|event| event.number)
                    .collect::<Vec<_>>(),
                news.lost
            ),
            (vec![9, 10], false)
        );
        assert_eq!(news.events[1].data, "9");
        for _ in 0..KEPT {
            hub.tell("x", &0);
        }
        let news = hub.after(8);
        assert!(
            news.lost && news.events.len() == AT_ONCE && news.events[0].number == 11,
            "{news:?}"
        );
        assert_eq!(hub.after(hub.latest()).events.len(), 0);
    }

    #[test]
    fn numbers_of_another_process_and_nonsense_are_none() {
        let hub = Hub::new(7);
        hub.tell("x", &1);
        for id in ["6-1", "7-2", "7", "", "7-x", "-1", "7--1"] {
            assert_eq!(hub.number(id), None, "{id}");
        }
        assert_eq!(hub.number(&hub.id(1)), Some(1));
    }
}
