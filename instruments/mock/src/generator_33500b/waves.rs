//! Loaded waves of the 33500B: converter values as text, selected by name, output at a sample rate.

use scpi::error::{Error, ErrorCode};

use super::{
    super::tree::{Argument, Arguments, Fallible, Span, fail},
    Keysight,
};

/// Points of a wave, and samples per second.
const WAVE_POINTS: std::ops::RangeInclusive<usize> = 8..=1_000_000;
const RATE_RANGE_HZ: (f64, f64) = (1e-6, 250e6);
const FILTERS: [&str; 3] = ["NORMal", "STEP", "OFF"];
const LONGEST_NAME: usize = 12;

impl Keysight {
    pub(super) fn choose_wave(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let Some(Argument::Word(name)) = arguments.next() else {
            return fail(ErrorCode::MissingParameter);
        };
        if !self.waves[index].contains_key(&name) {
            return fail(ErrorCode::IllegalParameterValue);
        }
        self.chosen[index] = Some(name);
        if index == 0 && self.channels[0].arbitrary {
            self.reshape();
            self.act();
        }
        Ok(())
    }

    pub(super) fn set_rate(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = RATE_RANGE_HZ;
        let rate_hz = arguments.number_in(
            "HZ",
            Span {
                min,
                max,
                default: 40e3,
            },
        )?;
        if !(min..=max).contains(&rate_hz) {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.change(index, |channel| channel.rate_hz = rate_hz);
        Ok(())
    }

    pub(super) fn set_filter(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.channels[index].filter = arguments.word(&FILTERS)?;
        Ok(())
    }

    /// Deletes the loaded waves. A channel that outputs one falls back to its sine.
    pub(super) fn clear_waves(&mut self, index: usize, _: &mut Arguments) -> Fallible {
        self.waves[index].clear();
        self.chosen[index] = None;
        self.change(index, |channel| channel.arbitrary = false);
        Ok(())
    }

    /// Handles `SOURn:DATA:ARB:DAC name,value,…`; returns true for a message of this header. Its
    /// many values bypass the parser.
    pub(super) fn load_wave(&mut self, message: &[u8]) -> bool {
        let Ok(text) = std::str::from_utf8(message) else {
            return false;
        };
        let Some((header, rest)) = text.trim().split_once(' ') else {
            return false;
        };
        let header = header.trim_start_matches(':').to_ascii_uppercase();
        let index = match header.as_str() {
            "SOUR:DATA:ARB:DAC" | "SOUR1:DATA:ARB:DAC" | "SOURCE1:DATA:ARBITRARY:DAC" => 0,
            "SOUR2:DATA:ARB:DAC" | "SOURCE2:DATA:ARBITRARY:DAC" => 1,
            _ => return false,
        };
        let (name, values) = rest.split_once(',').unwrap_or((rest, ""));
        let points: Result<Vec<i16>, _> = values
            .split(',')
            .map(|value| value.trim().parse::<i16>())
            .collect();
        let code = match points {
            Err(_) => ErrorCode::DataTypeError,
            Ok(_) if name.is_empty() || name.len() > LONGEST_NAME => {
                ErrorCode::IllegalParameterValue
            }
            Ok(points) if !WAVE_POINTS.contains(&points.len()) || points.contains(&i16::MIN) => {
                ErrorCode::DataOutOfRange
            }
            // A name that is there already.
            Ok(_) if self.waves[index].contains_key(name) => ErrorCode::SettingsConflict,
            Ok(points) => {
                self.waves[index].insert(
                    name.to_owned(),
                    points
                        .iter()
                        .map(|value| f64::from(*value) / 32_767.0)
                        .collect(),
                );
                return true;
            }
        };
        scpi::Device::handle_error(self, Error::new(code));
        true
    }
}
