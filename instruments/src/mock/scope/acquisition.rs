//! When the oscilloscope takes a frame: armed, triggered, stopped.
//!
//! Nothing happens between two messages. What the instrument would have done meanwhile is found out when the next message comes: the frame of a
//! running acquisition is the newest one that lies wholly between its start and now.

use super::{DIVISIONS, Panel, Scope};
use crate::mock::plant::{HISTORY_S, TriggerSearch};

/// From this time scale on the automatic mode rolls, s/div.
const ROLL_FROM_S: f64 = 0.05;
/// How often the search for the first trigger of a single acquisition goes back.
const MAX_STEPS_BACK: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    Auto,
    Normal,
    Single,
}

/// State of the acquisition.
#[derive(Debug, Clone)]
pub(super) struct Acquisition {
    pub(super) mode: Mode,
    pub(super) running: bool,
    /// Since when it runs with these settings, s.
    since_s: f64,
    /// Up to when triggers have been looked for, s.
    searched_s: f64,
    /// When it was forced to trigger.
    forced_s: Option<f64>,
    /// The newest frame.
    pub(super) frame: Option<Frame>,
    /// Frames so far: their number.
    pub(super) count: u64,
    /// Number of the frame that `INR?` has told of.
    reported: u64,
}

/// One capture: when, and with which settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    /// Bench time of the first sample, s.
    pub(super) start_s: f64,
    pub(super) panel: Panel,
    pub(super) number: u64,
}

impl Acquisition {
    pub(super) fn power_on() -> Self {
        Self { mode: Mode::Auto, running: true, since_s: 0.0, searched_s: 0.0, forced_s: None, frame: None, count: 0, reported: 0 }
    }

    /// As after power-on, but numbers go on: no two frames of one run share the noise.
    pub(super) fn reset(&mut self, now_s: f64) {
        *self = Self { count: self.count, reported: self.count, ..Self::power_on() };
        self.restart(now_s);
    }

    /// Starts a running acquisition anew; leaves a stopped one and its frame alone.
    pub(super) fn restart(&mut self, now_s: f64) {
        if self.running {
            self.since_s = now_s;
            self.searched_s = now_s;
            self.forced_s = None;
            self.frame = None;
        }
    }

    fn take(&mut self, start_s: f64, panel: Panel) {
        if self.frame.is_none_or(|frame| frame.start_s.to_bits() != start_s.to_bits()) {
            self.count += 1;
            self.frame = Some(Frame { start_s, panel, number: self.count });
        }
    }
}

impl Scope {
    pub(super) fn run(&mut self) {
        self.acquisition.running = true;
        self.acquisition.restart(self.world.now_s);
    }

    pub(super) fn stop(&mut self) {
        self.acquisition.running = false;
    }

    pub(super) fn set_mode(&mut self, mode: Mode) {
        self.acquisition.mode = mode;
        // Single arms at once; the other modes take effect when it runs.
        if mode == Mode::Single {
            self.acquisition.running = true;
        }
        self.acquisition.restart(self.world.now_s);
    }

    pub(super) fn force_trigger(&mut self) {
        if self.acquisition.running {
            self.acquisition.forced_s = Some(self.world.now_s);
        }
    }

    /// Catches up with what has happened since the last message.
    pub(super) fn refresh(&mut self) {
        if !self.acquisition.running {
            return;
        }
        let start_after_s = self.panel.start_after_trigger_s();
        // The trigger itself is looked for only once the acquisition runs, even when the screen begins later.
        let from_s = self.acquisition.since_s + (-start_after_s).max(0.0);
        let to_s = (self.world.now_s - start_after_s - self.panel.span_s()).min(self.world.now_s);
        if to_s < from_s {
            return;
        }
        let found = self.search_trigger(from_s, to_s);
        let forced = self.acquisition.forced_s.take_if(|forced_s| (from_s..=to_s).contains(forced_s));
        let trigger_s = match (found, forced) {
            (Some(found), Some(forced)) => Some(found.max(forced)),
            (found, forced) => found.or(forced),
        };
        match (trigger_s, self.acquisition.mode) {
            (Some(trigger_s), mode) => {
                self.acquisition.take(trigger_s + start_after_s, self.panel);
                self.acquisition.running = mode != Mode::Single;
            }
            (None, Mode::Auto) => self.acquisition.take(self.world.now_s - self.panel.span_s(), self.panel),
            (None, _) => {}
        }
    }

    /// The trigger that makes the next frame, if there was one since the last search.
    fn search_trigger(&mut self, from_s: f64, to_s: f64) -> Option<f64> {
        let remembered_s = self.world.now_s - HISTORY_S - self.panel.start_after_trigger_s();
        let from_s = from_s.max(self.acquisition.searched_s).max(remembered_s);
        if to_s < from_s {
            return None;
        }
        let found = match self.acquisition.mode {
            Mode::Single => self.first_trigger(from_s, to_s),
            Mode::Normal | Mode::Auto => self.newest_trigger(from_s, to_s),
        };
        self.acquisition.searched_s = to_s;
        found
    }

    fn newest_trigger(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let trigger = self.panel.trigger;
        let index = ["C1", "C2", "C3", "C4"].iter().position(|name| *name == trigger.source)?;
        let probe = self.panel.channels.get(index)?.probe;
        let search = TriggerSearch {
            channel: u8::try_from(index + 1).ok()?,
            level_v: trigger.level / probe,
            rising: trigger.slope != "FALLing",
            from_s,
            to_s,
        };
        let now_s = self.world.now_s;
        let found = self.world.plant().find_trigger(now_s, &search);
        if trigger.slope != "ALTernate" {
            return found;
        }
        let falling = self.world.plant().find_trigger(now_s, &TriggerSearch { rising: false, ..search });
        [found, falling].into_iter().flatten().max_by(f64::total_cmp)
    }

    /// The first trigger of a span: widens the search until there is one, then goes back from it as long as there are earlier ones.
    fn first_trigger(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let mut width_s = DIVISIONS * self.panel.time_scale;
        let mut first_s = loop {
            let end_s = (from_s + width_s).min(to_s);
            if let Some(found_s) = self.newest_trigger(from_s, end_s) {
                break found_s;
            }
            if end_s >= to_s {
                return None;
            }
            width_s *= 4.0;
        };
        for _ in 0..MAX_STEPS_BACK {
            // A little earlier than the one just found, so as not to find it again.
            let end_s = first_s - 1e-6 * self.panel.time_scale;
            let earlier_s = if end_s > from_s { self.newest_trigger(from_s, end_s) } else { None };
            let Some(earlier_s) = earlier_s else { break };
            first_s = earlier_s;
        }
        Some(first_s)
    }

    pub(super) fn trigger_status(&self) -> &'static str {
        let acquisition = &self.acquisition;
        let filled_s = acquisition.since_s - self.panel.start_after_trigger_s();
        match acquisition.mode {
            _ if !acquisition.running => "Stop",
            Mode::Auto if self.panel.time_scale >= ROLL_FROM_S => "Roll",
            Mode::Auto => "Auto",
            _ if acquisition.frame.is_some() => "Trig'd",
            _ if self.world.now_s < filled_s => "Arm",
            _ => "Ready",
        }
    }

    /// Whether there is a frame that this has not told of before.
    pub(super) fn take_new(&mut self) -> bool {
        let number = self.acquisition.frame.map_or(self.acquisition.reported, |frame| frame.number);
        std::mem::replace(&mut self.acquisition.reported, number) != number
    }
}
