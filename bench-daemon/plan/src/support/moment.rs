//! Moments whose distance stays known when the machine's clock is set: beside the calendar time,
//! each holds the time since the machine was started (proc(5)), which cannot be set.

use std::fs;

use instruments::clock;
use serde::{Deserialize, Serialize};

/// A calendar time and a time since the start of the machine differ by more than this, s, only if
/// the clock was set in between.
const CLOCK_SET_S: f64 = 60.0;

/// A moment on this machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Calendar time, s since 1970.
    pub unix_s: f64,
    /// Identity of the start of the machine; `None` if the system does not provide it.
    #[serde(default)]
    pub boot: Option<String>,
    /// Time since then, s.
    #[serde(default)]
    pub uptime_s: Option<f64>,
}

impl Moment {
    /// Reads the clocks.
    pub fn now() -> Self {
        let text = |path| fs::read_to_string(path).ok();
        let uptime = text("/proc/uptime");
        Self {
            unix_s: clock::unix_time_s(),
            boot: text("/proc/sys/kernel/random/boot_id").map(|id| id.trim().to_owned()),
            uptime_s: uptime.and_then(|text| text.split_whitespace().next()?.parse().ok()),
        }
    }

    /// Returns the time from this moment to a later one, s. Returns `None` if `now` lies earlier,
    /// or if the clock was set in between: then neither the age nor the calendar time is
    /// meaningful.
    pub fn age_s(&self, now: &Self) -> Option<f64> {
        let by_calendar_s = now.unix_s - self.unix_s;
        let by_uptime_s = match (self.uptime_s, now.uptime_s) {
            (Some(then_s), Some(now_s)) if self.boot.is_some() && self.boot == now.boot => {
                now_s - then_s
            }
            _ => by_calendar_s,
        };
        let is_known = (by_calendar_s - by_uptime_s).abs() <= CLOCK_SET_S
            && by_calendar_s > -CLOCK_SET_S
            && by_uptime_s > -CLOCK_SET_S;
        is_known.then_some(by_uptime_s.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(unix_s: f64, boot: &str, uptime_s: f64) -> Moment {
        Moment {
            unix_s,
            boot: Some(boot.to_owned()),
            uptime_s: Some(uptime_s),
        }
    }

    #[test]
    fn an_age_is_known_unless_the_clock_was_set() {
        let then = at(1000.0, "a", 10.0);
        for (now, age_s) in [
            (at(1300.0, "a", 310.0), Some(300.0)),
            (at(1300.5, "a", 310.0), Some(300.0)),
            // Set back and set ahead.
            (at(700.0, "a", 310.0), None),
            (at(9000.0, "a", 310.0), None),
            // Started again: the calendar alone counts.
            (at(9000.0, "b", 5.0), Some(8000.0)),
            (at(700.0, "b", 5.0), None),
        ] {
            assert_eq!(then.age_s(&now), age_s, "{now:?}");
        }
        let now = Moment::now();
        assert_eq!(now.age_s(&now), Some(0.0));
        assert!(now.boot.is_some() && now.uptime_s.is_some());
    }
}
