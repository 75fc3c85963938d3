//! Kepco BOP bipolar supplies: the switching BOP-MG, whose analog input is selected by command, and
//! a linear BOP with a BIT card, whose analog input depends on the wiring.
//!
//! One command tree serves both; the linear unit implements a subset and answers the other commands
//! with −113. Not simulated: list and transient programs, the analog input as a multiplier
//! (`GAIN`), relays and faults. Assumed, for lack of a source: the negative side of a `BOTH` limit
//! reads back with its sign; a new limit also changes the set-point; the off-behaviour survives
//! switching off and `*RST`, and was left at `BATTERY`; a linear unit with its output off programs
//! both channels to zero and so draws nothing from a cell.

mod tree;

use scpi::error::ErrorCode;

use super::{
    MockOptions,
    plant::{Action, BipolarState, SharedPlant},
    tree::{Fallible, HasStatus, Span, Status, fail},
    world::World,
};

/// Longest message in bytes; a longer one overruns the input buffer.
const LONGEST_MESSAGE: usize = 253;
/// Entries of the error queue.
const QUEUE_DEPTH: usize = 15;
/// Rated output, V and A.
const RATED: [f64; 2] = [50.0, 20.0];
const RATED_LINEAR: [f64; 2] = [20.0, 20.0];

/// How the model differs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Family {
    /// BOP 1KW-MG.
    Switching,
    /// BOP 20-20 with a BIT card; `analog_wired` states that the analog input is connected and so
    /// always commands the output.
    Linear { analog_wired: bool },
}

/// Voltage or current, in this order in every pair of this module.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Channel {
    Voltage = 0,
    Current = 1,
}

/// A positive and a negative bound, both as magnitudes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bounds {
    positive: f64,
    negative: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Both,
    Positive,
    Negative,
}

/// The supply.
pub(super) struct Kepco {
    world: World,
    status: Status,
    family: Family,
    /// The function query returns another keyword than the one that sets it.
    function_word: bool,
    serial_number: String,
    settings: Settings,
}

#[derive(Debug, Clone, Copy)]
struct Settings {
    mode: Channel,
    level: [f64; 2],
    limits: [Bounds; 2],
    protections: [Bounds; 2],
    protection_modes: [&'static str; 2],
    external: bool,
    output_on: bool,
    off_mode: &'static str,
    pin_mode: &'static str,
    /// Commands come from messages, not from the panel.
    remote: bool,
}

impl Settings {
    fn power_on(rated: [f64; 2]) -> Self {
        let limits = rated.map(|value| Bounds {
            positive: value,
            negative: value,
        });
        let protections = rated.map(|value| Bounds {
            positive: 1.01 * value,
            negative: 1.01 * value,
        });
        Self {
            mode: Channel::Voltage,
            level: [0.0; 2],
            limits,
            protections,
            protection_modes: ["FIXED"; 2],
            external: false,
            output_on: false,
            off_mode: "BATTERY",
            pin_mode: "OFF",
            remote: false,
        }
    }
}

impl Kepco {
    pub(super) fn new(family: Family, plant: SharedPlant, options: &MockOptions) -> Self {
        let kepco = Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            family,
            function_word: options.quirks.is("function_word"),
            serial_number: options.serial_number.clone(),
            settings: Settings {
                off_mode: if options.quirks.is("off_active") {
                    "ACTIVE"
                } else {
                    "BATTERY"
                },
                ..Settings::power_on(rated(family))
            },
        };
        kepco.act();
        kepco
    }

    fn identity(&self) -> String {
        match self.family {
            Family::Switching => format!("KEPCO,BOP1KW 50-20 ,{}, 2.01", self.serial_number),
            Family::Linear { .. } => format!("KEPCO,BOP 20-20,{},2.6", self.serial_number),
        }
    }

    /// −113 on the linear units, which lack the header.
    fn switching_only(&self) -> Fallible {
        if self.family == Family::Switching {
            Ok(())
        } else {
            fail(ErrorCode::UndefinedHeader)
        }
    }

    fn span(&self, channel: Channel) -> Span {
        let limits = self.settings.limits[channel as usize];
        Span {
            min: -limits.negative,
            max: limits.positive,
            default: 0.0,
        }
    }

    fn set_level(&mut self, channel: Channel, value: f64) -> Fallible {
        let span = self.span(channel);
        self.settings.level[channel as usize] = self.status.bounded(value, span.min..=span.max)?;
        self.act();
        Ok(())
    }

    fn set_bounds(&mut self, which: Which, side: Side, value: f64) -> Fallible {
        let rated = rated(self.family)[which.channel() as usize];
        let ceiling = if matches!(which, Which::Protection(_)) {
            1.01 * rated
        } else {
            rated
        };
        let value = self
            .status
            .bounded(value.abs(), 0.0..=ceiling * (1.0 + 1e-9))?;
        let bounds = self.bounds_mut(which);
        if side != Side::Negative {
            bounds.positive = value;
        }
        if side != Side::Positive {
            bounds.negative = value;
        }
        // A set-point that a new limit forbids moves to the limit.
        let Span { min, max, .. } = self.span(which.channel());
        let level = &mut self.settings.level[which.channel() as usize];
        *level = level.clamp(min, max);
        self.act();
        Ok(())
    }

    fn bounds_mut(&mut self, which: Which) -> &mut Bounds {
        match which {
            Which::Limit(channel) => &mut self.settings.limits[channel as usize],
            Which::Protection(channel) => &mut self.settings.protections[channel as usize],
        }
    }

    fn reset(&mut self) {
        let old = self.settings;
        // The off-behaviour and the pin are configuration, not settings.
        self.settings = Settings {
            off_mode: old.off_mode,
            pin_mode: old.pin_mode,
            remote: old.remote,
            ..Settings::power_on(rated(self.family))
        };
        self.act();
    }

    fn act(&self) {
        let settings = &self.settings;
        let (main, other) = match settings.mode {
            Channel::Voltage => (Channel::Voltage, Channel::Current),
            Channel::Current => (Channel::Current, Channel::Voltage),
        };
        let protection = settings.protections[other as usize];
        let (analog_input, off_is_open) = match self.family {
            Family::Switching => (settings.external, settings.off_mode != "ACTIVE"),
            Family::Linear { analog_wired } => (analog_wired && settings.output_on, true),
        };
        self.world.act(Action::Bipolar(BipolarState {
            output_on: settings.output_on,
            current_mode: settings.mode == Channel::Current,
            analog_input,
            setpoint: settings.level[main as usize],
            limit: settings.level[other as usize]
                .abs()
                .min(protection.positive.min(protection.negative)),
            off_is_open,
        }));
    }
}

fn rated(family: Family) -> [f64; 2] {
    match family {
        Family::Switching => RATED,
        Family::Linear { .. } => RATED_LINEAR,
    }
}

/// A software limit or a protection value of a channel.
#[derive(Debug, Clone, Copy)]
enum Which {
    Limit(Channel),
    Protection(Channel),
}

impl Which {
    fn channel(self) -> Channel {
        match self {
            Self::Limit(channel) | Self::Protection(channel) => channel,
        }
    }
}

/// The unit's own number reader keeps four digits before and eight after the point of the mantissa,
/// silently.
fn truncated(digits: &str) -> String {
    let (mantissa, exponent) = digits
        .find(['e', 'E'])
        .map_or((digits, ""), |at| digits.split_at(at));
    let (sign, mantissa) = match mantissa.strip_prefix(['-', '+']) {
        Some(rest) => (if mantissa.starts_with('-') { "-" } else { "" }, rest),
        None => ("", mantissa),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let whole = whole.get(whole.len().saturating_sub(4)..).unwrap_or(whole);
    let fraction = fraction.get(..8).unwrap_or(fraction);
    format!("{sign}0{whole}.{fraction}0{exponent}")
}

impl HasStatus for Kepco {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}

#[cfg(test)]
mod tests {
    use super::truncated;

    #[test]
    fn long_numbers_lose_digits_as_in_the_manual_example() {
        for (written, expected) in [
            ("10345.2e-1", 34.52),
            ("-2.5", -2.5),
            ("+.5", 0.5),
            ("0.123456789", 0.123_456_78),
            ("2E1", 20.0),
        ] {
            assert!(
                (truncated(written).parse::<f64>().unwrap() - expected).abs() < 1e-12,
                "{written}"
            );
        }
    }
}
