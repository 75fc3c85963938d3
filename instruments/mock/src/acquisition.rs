//! Acquisition of the simulated oscilloscopes: armed, triggered, stopped. Common to all models.
//!
//! Nothing happens between two messages. The next message computes what the instrument would have
//! done in the meantime: the frame of a running acquisition is the newest one that lies wholly
//! between its start and now.

use std::ops::RangeInclusive;

use super::{
    plant::{HISTORY_S, TriggerSearch},
    world::World,
};

/// Maximum number of backward steps in the search for the first trigger of a single acquisition.
const MAX_STEPS_BACK: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    Auto,
    Normal,
    Single,
}

/// Settings of a panel for time and trigger.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    /// From the trigger to the first sample, s; usually negative.
    pub(super) start_after_trigger_s: f64,
    /// Length of a frame, s.
    pub(super) span_s: f64,
    /// Edge that triggers; `None` if no channel does.
    pub(super) trigger: Option<Edge>,
}

/// An edge that triggers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    /// Scope channel 1…4.
    pub(super) channel: u8,
    /// Level at the probe tip, V.
    pub(super) level_v: f64,
    pub(super) rising: bool,
    pub(super) falling: bool,
}

/// State of the acquisition; `P` is everything that decides how a frame is taken.
#[derive(Debug, Clone)]
pub(super) struct Acquisition<P> {
    pub(super) mode: Mode,
    pub(super) running: bool,
    /// Since when it runs with these settings, s.
    pub(super) since_s: f64,
    /// Up to when triggers have been looked for, s.
    searched_s: f64,
    /// When it was forced to trigger.
    forced_s: Option<f64>,
    /// The newest frame.
    pub(super) frame: Option<Frame<P>>,
    /// Frames so far: their number.
    count: u64,
    /// Number of the last frame that was reported.
    reported: u64,
    stop_delay_s: f64,
    /// The acquisition received a stop command and stops at this time, s.
    stops_s: Option<f64>,
}

/// One capture: when, and with which settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame<P> {
    /// Bench time of the first sample, s.
    pub(super) start_s: f64,
    pub(super) panel: P,
    pub(super) number: u64,
}

impl<P: Copy> Acquisition<P> {
    /// Creates the state after power-on. The acquisition continues for `stop_delay_s` after a stop
    /// command.
    pub(super) fn power_on(stop_delay_s: f64) -> Self {
        Self {
            mode: Mode::Auto,
            running: true,
            since_s: 0.0,
            searched_s: 0.0,
            forced_s: None,
            frame: None,
            count: 0,
            reported: 0,
            stop_delay_s,
            stops_s: None,
        }
    }

    /// Returns whether a message is the query that waits for the end of a running operation.
    pub(super) fn keeps_waiting(&self, message: &[u8]) -> bool {
        self.running && message.trim_ascii().eq_ignore_ascii_case(b"*OPC?")
    }

    /// As after power-on, but numbers go on: no two frames of one run share the noise.
    pub(super) fn reset(&mut self, now_s: f64) {
        *self = Self {
            count: self.count,
            reported: self.count,
            ..Self::power_on(self.stop_delay_s)
        };
        self.restart(now_s);
    }

    /// Restarts a running acquisition; leaves a stopped one and its frame alone.
    pub(super) fn restart(&mut self, now_s: f64) {
        if self.running {
            self.since_s = now_s;
            self.searched_s = now_s;
            self.forced_s = None;
            self.frame = None;
        }
    }

    pub(super) fn run(&mut self, now_s: f64) {
        self.stops_s = None;
        self.running = true;
        self.restart(now_s);
    }

    pub(super) fn stop(&mut self, now_s: f64) {
        self.stops_s = Some(now_s + self.stop_delay_s);
        self.stop_in_time(now_s);
    }

    fn stop_in_time(&mut self, now_s: f64) {
        if self.stops_s.is_some_and(|stops_s| stops_s <= now_s) {
            self.running = false;
            self.stops_s = None;
        }
    }

    pub(super) fn set_mode(&mut self, mode: Mode, now_s: f64) {
        self.mode = mode;
        self.stops_s = None;
        // Single arms at once; the other modes take effect when it runs.
        if mode == Mode::Single {
            self.running = true;
        }
        self.restart(now_s);
    }

    pub(super) fn force_trigger(&mut self, now_s: f64) {
        if self.running {
            self.forced_s = Some(now_s);
        }
    }

    /// Returns whether there is a frame that this method has not reported before.
    pub(super) fn take_new(&mut self) -> bool {
        let number = self
            .frame
            .as_ref()
            .map_or(self.reported, |frame| frame.number);
        std::mem::replace(&mut self.reported, number) != number
    }

    /// Returns the newest frame, unless it is so old that the world has forgotten it, which an
    /// instrument would not: treated as none rather than made up.
    pub(super) fn remembered(&self, now_s: f64) -> Option<Frame<P>> {
        self.frame
            .filter(|frame| now_s - frame.start_s <= HISTORY_S)
    }

    /// Catches up with what has happened since the last message.
    pub(super) fn refresh(&mut self, world: &World, panel: P, view: &View) {
        self.stop_in_time(world.now_s);
        if !self.running {
            return;
        }
        // The trigger itself is looked for only once the acquisition runs, even when the screen
        // begins later.
        let from_s = self.since_s + (-view.start_after_trigger_s).max(0.0);
        let to_s = (world.now_s - view.start_after_trigger_s - view.span_s).min(world.now_s);
        if to_s < from_s {
            return;
        }
        let found = self.search_trigger(world, view, from_s..=to_s);
        let forced = self
            .forced_s
            .take_if(|forced_s| (from_s..=to_s).contains(forced_s));
        let trigger_s = match (found, forced) {
            (Some(found), Some(forced)) => Some(found.max(forced)),
            (found, forced) => found.or(forced),
        };
        match (trigger_s, self.mode) {
            (Some(trigger_s), mode) => {
                self.take(trigger_s + view.start_after_trigger_s, panel);
                self.running = mode != Mode::Single;
            }
            (None, Mode::Auto) => self.take(world.now_s - view.span_s, panel),
            (None, _) => {}
        }
    }

    fn take(&mut self, start_s: f64, panel: P) {
        if self
            .frame
            .as_ref()
            .is_none_or(|frame| frame.start_s.to_bits() != start_s.to_bits())
        {
            self.count += 1;
            self.frame = Some(Frame {
                start_s,
                panel,
                number: self.count,
            });
        }
    }

    /// Returns the trigger that makes the next frame, if there was one since the last search.
    fn search_trigger(
        &mut self,
        world: &World,
        view: &View,
        span_s: RangeInclusive<f64>,
    ) -> Option<f64> {
        let (from_s, to_s) = span_s.into_inner();
        let remembered_s = world.now_s - HISTORY_S - view.start_after_trigger_s;
        let from_s = from_s.max(self.searched_s).max(remembered_s);
        if to_s < from_s {
            return None;
        }
        let found = match self.mode {
            Mode::Single => first_trigger(world, view, from_s..=to_s),
            Mode::Normal | Mode::Auto => newest_trigger(world, view, from_s..=to_s),
        };
        self.searched_s = to_s;
        found
    }
}

fn newest_trigger(world: &World, view: &View, span_s: RangeInclusive<f64>) -> Option<f64> {
    let (from_s, to_s) = span_s.into_inner();
    let edge = view.trigger?;
    let find = |rising| {
        let search = TriggerSearch {
            channel: edge.channel,
            level_v: edge.level_v,
            rising,
            from_s,
            to_s,
        };
        world.plant().find_trigger(world.now_s, &search)
    };
    let rising = if edge.rising { find(true) } else { None };
    let falling = if edge.falling { find(false) } else { None };
    [rising, falling]
        .into_iter()
        .flatten()
        .max_by(f64::total_cmp)
}

/// Finds the first trigger of a span: widens the search until there is one, then steps back from it
/// as long as there are earlier ones.
fn first_trigger(world: &World, view: &View, span_s: RangeInclusive<f64>) -> Option<f64> {
    let (from_s, to_s) = span_s.into_inner();
    let mut width_s = view.span_s;
    let mut first_s = loop {
        let end_s = (from_s + width_s).min(to_s);
        if let Some(found_s) = newest_trigger(world, view, from_s..=end_s) {
            break found_s;
        }
        if end_s >= to_s {
            return None;
        }
        width_s *= 4.0;
    };
    for _ in 0..MAX_STEPS_BACK {
        // A little earlier than the one just found, so as not to find it again.
        let end_s = first_s - 1e-7 * view.span_s;
        let earlier_s = if end_s > from_s {
            newest_trigger(world, view, from_s..=end_s)
        } else {
            None
        };
        let Some(earlier_s) = earlier_s else { break };
        first_s = earlier_s;
    }
    Some(first_s)
}
