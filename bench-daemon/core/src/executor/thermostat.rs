//! Controls the temperature of a bath with a heater and a cooler on relays: a
//! proportional-integral law whose output is the share of a window for which a relay is on.
//!
//! The functions are pure: they take readings with their times and return pulses. Pulses that are
//! too short for a relay accumulate until they are long enough. A pause separates heating from
//! cooling. An invalid reading switches both off, and a reading that is too old is a fault.

use instruments::units::{Celsius, Kelvins, Seconds};

use bench_plan::config::Thermostat as Settings;

/// Least time between two switchings of a relay, s.
const LEAST_S: Seconds = Seconds(2.0);
/// Time for which both relays are off between heating and cooling, s.
const REVERSAL_S: Seconds = Seconds(60.0);
/// Time at full power after which an unchanged sensor counts as faulty, s.
const UNMOVED_S: Seconds = Seconds(120.0);

/// Action to take now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Heat for this number of seconds, or cool if it is negative; zero switches both off.
    Pulse(Seconds),
    /// Permanently off, with the reason.
    Fault(Fault),
}

/// Why the bath is not under control.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The sensor has no plausible reading.
    #[error("no plausible bath temperature for {age_s:.0}")]
    Stale {
        /// Age of the last plausible reading, s.
        age_s: Seconds,
    },
    /// The sensor does not follow.
    #[error(
        "the bath shows {celsius:.3} all the while, after {spent_s:.0} of full power in one \
        direction"
    )]
    Unmoved {
        /// Reading, °C.
        celsius: Celsius,
        /// Seconds of full power.
        spent_s: Seconds,
    },
}

/// One control loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Thermostat {
    settings: Settings,
    setpoint_degc: Celsius,
    /// Share of full power that is needed permanently.
    integral: f64,
    /// Accumulated time of pulses that were too short, s.
    saved_s: Seconds,
    due_s: Seconds,
    /// Time of the last good reading, s.
    good_s: Seconds,
    /// Sign and end of the last pulse.
    last: (f64, Seconds),
    /// Reading at the last change, and the time of full power in one direction since then, s.
    unmoved: (Celsius, Seconds),
}

impl Thermostat {
    /// Creates a control loop that begins at bench time `now_s`.
    pub fn new(settings: Settings, setpoint_degc: Celsius, now_s: Seconds) -> Self {
        Self {
            settings,
            setpoint_degc,
            integral: 0.0,
            saved_s: Seconds::ZERO,
            due_s: now_s,
            good_s: now_s,
            last: (0.0, Seconds::NEG_INFINITY),
            unmoved: (Celsius::NAN, Seconds::ZERO),
        }
    }

    /// Changes the set-point of the loop.
    pub fn set(&mut self, setpoint_degc: Celsius) {
        self.setpoint_degc = setpoint_degc;
    }

    /// Checks whether a window has passed, so that the bath must be read.
    pub fn is_due(&self, now_s: Seconds) -> bool {
        now_s >= self.due_s
    }

    /// Returns the action for a reading of the sensor at `now_s`. `None` stands for an implausible
    /// reading.
    pub fn step(&mut self, reading_degc: Option<Celsius>, now_s: Seconds) -> Action {
        let window_s = self.settings.window_s;
        self.due_s = now_s + window_s;
        let Some(celsius) = reading_degc.filter(|celsius| celsius.is_finite()) else {
            let age_s = now_s - self.good_s;
            self.saved_s = Seconds::ZERO;
            return if age_s > self.settings.stale_s {
                Action::Fault(Fault::Stale { age_s })
            } else {
                Action::Pulse(Seconds::ZERO)
            };
        };
        // The error did not persist during a gap between readings.
        let passed_s = (now_s - self.good_s).clamp(Seconds::ZERO, window_s);
        self.good_s = now_s;
        let error_k = self.setpoint_degc - (celsius - self.settings.sensor_offset_k);
        let share = self.share(error_k, passed_s);
        let pulse_s = self.pulse(share, now_s);
        match self.follows(celsius, pulse_s) {
            Some(fault) => Action::Fault(fault),
            None => Action::Pulse(pulse_s),
        }
    }

    /// Returns the share of full power, −1 to 1. The integral does not change while the output is
    /// at its limit.
    fn share(&mut self, error_k: Kelvins, passed_s: Seconds) -> f64 {
        let proportional = error_k / self.settings.band_k;
        if (proportional + self.integral).abs() < 1.0 {
            self.integral = (self.integral + proportional * passed_s / self.settings.integral_s)
                .clamp(-1.0, 1.0);
        }
        (proportional + self.integral).clamp(-1.0, 1.0)
    }

    fn pulse(&mut self, share: f64, now_s: Seconds) -> Seconds {
        let window_s = self.settings.window_s;
        self.saved_s = (self.saved_s + share * window_s).clamp(-window_s, window_s);
        let reverses =
            self.saved_s * self.last.0 < Seconds::ZERO && now_s < self.last.1 + REVERSAL_S;
        if self.saved_s.abs() < LEAST_S || reverses {
            return Seconds::ZERO;
        }
        // A relay that would be off only briefly stays on.
        let pulse_s = if window_s - self.saved_s.abs() < LEAST_S {
            Seconds(window_s.value().copysign(self.saved_s.value()))
        } else {
            self.saved_s
        };
        self.saved_s -= pulse_s;
        // Lasts a little beyond the next window, so that a full pulse leaves no gap.
        let longer_s = if pulse_s.abs() >= window_s {
            pulse_s * 1.25
        } else {
            pulse_s
        };
        self.last = (longer_s.value().signum(), now_s + longer_s.abs());
        longer_s
    }

    fn follows(&mut self, celsius: Celsius, pulse_s: Seconds) -> Option<Fault> {
        let (shown_degc, spent_s) = self.unmoved;
        // Less than full power may just balance the losses of the bath: then a constant reading is
        // correct.
        if celsius != shown_degc
            || spent_s.value() * pulse_s.value() < 0.0
            || pulse_s.abs() < self.settings.window_s
        {
            self.unmoved = (celsius, Seconds::ZERO);
            return None;
        }
        self.unmoved.1 += pulse_s;
        let spent_s = self.unmoved.1.abs();
        (spent_s > UNMOVED_S).then_some(Fault::Unmoved { celsius, spent_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Settings = Settings {
        band_k: Kelvins(0.5),
        integral_s: Seconds(400.0),
        window_s: Seconds(20.0),
        stale_s: Seconds(60.0),
        sensor_offset_k: Kelvins(0.0),
    };

    /// Simulates a bath that loses heat to the room, in steps of a second, read in sixteenths of a
    /// degree. Returns its greatest error after the first half hour, K.
    fn held(band_k: f64, ambient_degc: f64, (heater, cooler): (f64, f64)) -> f64 {
        let mut thermostat = Thermostat::new(
            Settings {
                band_k: Kelvins(band_k),
                ..SETTINGS
            },
            Celsius(25.0),
            Seconds(0.0),
        );
        let (mut bath_degc, mut pulse, mut worst_k) = (ambient_degc, (0.0, 0.0), 0.0_f64);
        for second in 0..7200 {
            let now_s = f64::from(second);
            if thermostat.is_due(Seconds(now_s)) {
                let Action::Pulse(pulse_s) = thermostat.step(
                    Some(Celsius((bath_degc * 16.0).round() / 16.0)),
                    Seconds(now_s),
                ) else {
                    panic!("at {now_s} s")
                };
                pulse = (pulse_s.value(), now_s + pulse_s.value().abs());
            }
            let on = if now_s < pulse.1 {
                pulse.0.signum()
            } else {
                0.0
            };
            bath_degc +=
                (ambient_degc - bath_degc) / 1800.0 + if on > 0.0 { heater } else { on * cooler };
            if now_s > 1800.0 {
                worst_k = worst_k.max((bath_degc - 25.0).abs());
            }
        }
        worst_k
    }

    #[test]
    fn it_holds_a_bath_in_a_cold_and_in_a_warm_room() {
        // A bath that reacts twice as strongly needs twice the band, and the shortest pulse of its
        // heater alone changes it by 0.06 K.
        for (band_k, ambient_degc, powers, most_k) in [
            (0.5, 22.0, (0.015, 0.01), 0.08),
            (0.5, 25.0, (0.015, 0.01), 0.08),
            (0.5, 30.0, (0.015, 0.01), 0.08),
            (1.0, 20.0, (0.03, 0.02), 0.12),
        ] {
            let worst_k = held(band_k, ambient_degc, powers);
            assert!(worst_k < most_k, "{ambient_degc} °C: {worst_k} K");
        }
    }

    #[test]
    fn a_reading_that_is_none_switches_off_at_once_and_an_old_one_is_a_fault() {
        let mut thermostat = Thermostat::new(SETTINGS, Celsius(25.0), Seconds(0.0));
        assert_eq!(
            thermostat.step(Some(Celsius(20.0)), Seconds(0.0)),
            Action::Pulse(Seconds(25.0))
        );
        assert!(!thermostat.is_due(Seconds(19.0)) && thermostat.is_due(Seconds(20.0)));
        assert_eq!(
            thermostat.step(None, Seconds(20.0)),
            Action::Pulse(Seconds::ZERO)
        );
        assert_eq!(
            thermostat.step(Some(Celsius::NAN), Seconds(40.0)),
            Action::Pulse(Seconds::ZERO)
        );
        let Action::Fault(fault) = thermostat.step(None, Seconds(80.0)) else {
            panic!("expected a fault")
        };
        assert_eq!(fault.to_string(), "no plausible bath temperature for 80 s");
    }

    #[test]
    fn a_sensor_that_hangs_beside_the_bath_is_a_fault_before_the_bath_boils() {
        let mut thermostat = Thermostat::new(SETTINGS, Celsius(25.0), Seconds(0.0));
        let end = (0..)
            .map(|window| {
                (
                    window,
                    thermostat.step(Some(Celsius(22.0)), Seconds(20.0 * f64::from(window))),
                )
            })
            .find(|(_, action)| matches!(action, Action::Fault(_)));
        let (window, Action::Fault(fault)) = end.unwrap() else {
            panic!("expected a fault")
        };
        assert!(window <= 6, "{window}");
        assert_eq!(
            fault.to_string(),
            "the bath shows 22.000 °C all the while, after 125 s of full power in one direction"
        );
    }

    #[test]
    fn what_is_too_short_is_saved_up_and_heat_does_not_follow_cold() {
        let mut thermostat = Thermostat::new(
            Settings {
                integral_s: Seconds(1.0e9),
                ..SETTINGS
            },
            Celsius(25.0),
            Seconds(0.0),
        );
        // Six hundredths of full power: 1.2 s in 20 s.
        let pulses: Vec<Action> = (0..4)
            .map(|window| thermostat.step(Some(Celsius(24.97)), Seconds(20.0 * f64::from(window))))
            .collect();
        let [first, second, ..] = pulses[..] else {
            panic!()
        };
        assert_eq!(first, Action::Pulse(Seconds::ZERO));
        assert!(
            matches!(second, Action::Pulse(pulse) if (pulse - Seconds(2.4)).abs() < Seconds(1.0e-3)),
            "{pulses:?}"
        );
        // Suddenly too warm: cooling does not begin within a minute.
        let after: Vec<Action> = (4..9)
            .map(|window| thermostat.step(Some(Celsius(25.3)), Seconds(20.0 * f64::from(window))))
            .collect();
        assert_eq!(after[0], Action::Pulse(Seconds::ZERO));
        assert!(
            after
                .iter()
                .any(|action| matches!(action, Action::Pulse(pulse) if *pulse < Seconds(0.0))),
            "{after:?}"
        );
    }
}
