//! The acquisition of this model, and the keywords for its state.

use super::{Panel, Scope};
use crate::acquisition::{self, Edge, Mode, View};

/// From this time scale on the automatic mode rolls, s/div.
const ROLL_FROM_S: f64 = 0.05;

pub(super) type Frame = acquisition::Frame<Panel>;

impl Panel {
    fn view(&self) -> View {
        let trigger = self.trigger;
        let index = ["C1", "C2", "C3", "C4"]
            .iter()
            .position(|name| *name == trigger.source);
        let edge = index.and_then(|index| {
            let level_v = trigger.level / self.channels.get(index)?.probe;
            let channel = u8::try_from(index + 1).ok()?;
            Some(Edge {
                channel,
                level_v,
                rising: trigger.slope != "FALLing",
                falling: trigger.slope != "RISing",
            })
        });
        View {
            start_after_trigger_s: self.start_after_trigger_s(),
            span_s: self.span_s(),
            trigger: edge,
        }
    }
}

impl Scope {
    /// Catches up with what has happened since the last message.
    pub(super) fn refresh(&mut self) {
        self.acquisition
            .refresh(&self.world, self.panel, &self.panel.view());
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
}
