//! Effects of the commands on the front panel.

use scpi::error::ErrorCode;

use super::{CHANNELS, DEPTHS, SCALE_RANGE, Scope};
use crate::{
    acquisition::Mode,
    tree::{Answer, Argument, Arguments, Fallible, fail, text, to_number},
};

/// Time scales, s/div.
const TIME_SCALE_RANGE: (f64, f64) = (1e-9, 1000.0);
/// The trigger level may lie this many divisions from the centre.
const TRIGGER_DIVISIONS: f64 = 4.1;
/// The delay may lie this many screens from the trigger, either way.
const DELAY_SCREENS: f64 = 1000.0;
const MAX_POINT: f64 = 1e9;

/// Returns the next number if it is valid: this instrument ignores unusable values.
fn finite(arguments: &mut Arguments, unit: &str) -> Fallible<f64> {
    let value = arguments.number(unit)?;
    if value.is_finite() {
        Ok(value)
    } else {
        fail(ErrorCode::DataOutOfRange)
    }
}

/// Returns the nearest step of 1-2-5 on a logarithmic scale.
fn nearest_step(seconds: f64) -> f64 {
    let seconds = seconds.clamp(TIME_SCALE_RANGE.0, TIME_SCALE_RANGE.1);
    let mut best = TIME_SCALE_RANGE.0;
    for exponent in -9..=3_i32 {
        for mantissa in [1.0, 2.0, 5.0] {
            // Divided rather than multiplied, for 10^n is exact and 10^-n is not.
            let step = if exponent < 0 {
                mantissa / 10_f64.powi(-exponent)
            } else {
                mantissa * 10_f64.powi(exponent)
            };
            if step <= TIME_SCALE_RANGE.1
                && (step / seconds).ln().abs() < (best / seconds).ln().abs()
            {
                best = step;
            }
        }
    }
    best
}

impl Scope {
    pub(super) fn set_switch(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let on = arguments.switch()?;
        self.change(|panel| panel.channels[index].on = on);
        Ok(())
    }

    pub(super) fn set_scale(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let scale = finite(arguments, "V")?;
        self.change(|panel| {
            let channel = &mut panel.channels[index];
            channel.scale =
                scale.clamp(SCALE_RANGE.0 * channel.probe, SCALE_RANGE.1 * channel.probe);
            channel.clamp_offset();
        });
        self.limit_level();
        Ok(())
    }

    pub(super) fn set_offset(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let offset = finite(arguments, "V")?;
        self.change(|panel| {
            panel.channels[index].offset = offset;
            panel.channels[index].clamp_offset();
        });
        self.limit_level();
        Ok(())
    }

    pub(super) fn set_coupling(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let coupling = arguments.word(&["DC", "AC", "GND"])?;
        self.change(|panel| panel.channels[index].coupling = coupling);
        Ok(())
    }

    /// A limit of 200 MHz is above this model's bandwidth, and passed over.
    pub(super) fn set_bandwidth(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let bandwidth = arguments.word(&["FULL", "20M", "200M"])?;
        if bandwidth != "200M" {
            self.change(|panel| panel.channels[index].bandwidth = bandwidth);
        }
        Ok(())
    }

    /// Handles `DEFault`, or `VALue,` and the factor. The displayed values are rescaled; the input
    /// does not change.
    pub(super) fn set_probe(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let factor = match arguments.word(&["DEFault", "VALue"])? {
            "VALue" => finite(arguments, "")?.clamp(1e-6, 1e6),
            _ => 1.0,
        };
        let amperes = self.quirks.is("unit_after_probe");
        self.change(|panel| {
            let channel = &mut panel.channels[index];
            if amperes {
                channel.unit = "A";
            }
            let ratio = factor / channel.probe;
            channel.probe = factor;
            channel.scale *= ratio;
            channel.offset *= ratio;
        });
        Ok(())
    }

    pub(super) fn set_unit(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.panel.channels[index].unit = arguments.word(&["V", "A"])?;
        Ok(())
    }

    pub(super) fn set_time_scale(&mut self, arguments: &mut Arguments) -> Fallible {
        let seconds = finite(arguments, "S")?;
        if seconds <= 0.0 {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.change(|panel| {
            let old = panel.time_scale;
            panel.time_scale = nearest_step(seconds);
            if panel.keep_position {
                panel.delay_s *= panel.time_scale / old;
            }
        });
        Ok(())
    }

    pub(super) fn set_delay(&mut self, arguments: &mut Arguments) -> Fallible {
        let seconds = finite(arguments, "S")?;
        self.change(|panel| {
            let most = DELAY_SCREENS * panel.span_s();
            panel.delay_s = seconds.clamp(-most, most);
        });
        Ok(())
    }

    pub(super) fn set_reference(&mut self, arguments: &mut Arguments) -> Fallible {
        self.panel.keep_position = arguments.word(&["DELay", "POSition"])? == "POSition";
        Ok(())
    }

    pub(super) fn set_reference_position(&mut self, arguments: &mut Arguments) -> Fallible {
        let percent = finite(arguments, "")?;
        self.change(|panel| panel.reference_percent = percent.round().clamp(0.0, 100.0));
        Ok(())
    }

    pub(super) fn set_depth(&mut self, arguments: &mut Arguments) -> Fallible {
        let word = match arguments.next() {
            Some(Argument::Number { digits, suffix }) => digits + &suffix,
            _ => return fail(ErrorCode::ExecutionError),
        };
        let Some((name, points)) = DEPTHS
            .iter()
            .find(|(name, points)| name.eq_ignore_ascii_case(&word) || word.parse() == Ok(*points))
        else {
            return fail(ErrorCode::IllegalParameterValue);
        };
        self.change(|panel| {
            panel.depth = name;
            panel.depth_points = *points;
        });
        Ok(())
    }

    pub(super) fn set_trigger_source(&mut self, arguments: &mut Arguments) -> Fallible {
        let source = arguments.word(&["C1", "C2", "C3", "C4", "EX", "EX5", "LINE"])?;
        self.change(|panel| panel.trigger.source = source);
        self.limit_level();
        Ok(())
    }

    pub(super) fn set_slope(&mut self, arguments: &mut Arguments) -> Fallible {
        let slope = arguments.word(&["RISing", "FALLing", "ALTernate"])?;
        self.change(|panel| panel.trigger.slope = slope);
        Ok(())
    }

    pub(super) fn set_level(&mut self, arguments: &mut Arguments) -> Fallible {
        let level = finite(arguments, "V")?;
        self.change(|panel| panel.trigger.level = level);
        self.limit_level();
        Ok(())
    }

    /// Keeps the level on the screen of its channel.
    fn limit_level(&mut self) {
        let source = ["C1", "C2", "C3", "C4"]
            .iter()
            .position(|name| *name == self.panel.trigger.source);
        if let Some(channel) = source
            .and_then(|index| self.panel.channels.get(index))
            .copied()
        {
            let room = TRIGGER_DIVISIONS * channel.scale;
            self.change(|panel| {
                panel.trigger.level = panel
                    .trigger
                    .level
                    .clamp(-room - channel.offset, room - channel.offset);
            });
        }
    }

    pub(super) fn set_trigger_mode(&mut self, arguments: &mut Arguments) -> Fallible {
        match arguments.word(&["AUTO", "NORMal", "SINGle", "FTRIG"])? {
            "AUTO" => self.acquisition.set_mode(Mode::Auto, self.world.now_s),
            "NORMal" => self.acquisition.set_mode(Mode::Normal, self.world.now_s),
            "SINGle" => self.acquisition.set_mode(Mode::Single, self.world.now_s),
            _ => self.acquisition.force_trigger(self.world.now_s),
        }
        Ok(())
    }

    pub(super) fn trigger_mode(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(match self.acquisition.mode {
            Mode::Auto => "AUTO",
            Mode::Normal => "NORMal",
            Mode::Single => "SINGle",
        })
    }

    pub(super) fn set_source(&mut self, arguments: &mut Arguments) -> Fallible {
        let word = arguments.word(&["C1", "C2", "C3", "C4"])?;
        self.transfer.source = ["C1", "C2", "C3", "C4"]
            .iter()
            .position(|name| *name == word)
            .unwrap_or(0)
            .min(CHANNELS - 1);
        Ok(())
    }

    /// `SINGle`, `DOUBle` or `CUSTom,` and the number of digits.
    pub(super) fn set_number_format(&mut self, arguments: &mut Arguments) -> Fallible {
        let (digits, name) = match arguments.word(&["SINGle", "DOUBle", "CUSTom"])? {
            "SINGle" => (7.0, "SINGle".to_owned()),
            "DOUBle" => (14.0, "DOUBle".to_owned()),
            _ => {
                let digits = finite(arguments, "")?.round().clamp(1.0, 64.0);
                (digits, format!("CUSTom,{digits}"))
            }
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 64"
        )]
        let digits = digits as usize;
        (self.digits, self.number_format) = (digits, name);
        Ok(())
    }

    /// `AVERage,16`, `ERES,2.0` and the like: taken, and without effect.
    pub(super) fn set_acquisition_type(&mut self, arguments: &mut Arguments) -> Fallible {
        arguments.word(&["NORMal", "PEAK", "AVERage", "ERES"])?;
        if let Some(parameter) = arguments.next() {
            to_number(&parameter, "")?;
        }
        Ok(())
    }

    /// Samples per second.
    pub(super) fn sample_rate(&self) -> f64 {
        self.panel.sampling().1.recip()
    }
}

/// Returns a whole number of points, at least `least`.
pub(super) fn points(arguments: &mut Arguments, least: f64) -> Fallible<u64> {
    let value = finite(arguments, "")?.round().clamp(least, MAX_POINT);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 to 10^9"
    )]
    Ok(value as u64)
}

#[cfg(test)]
mod tests {
    use super::nearest_step;

    #[test]
    fn time_scales_snap_to_one_two_five() {
        for (asked, step) in [
            (0.0, 1e-9),
            (0.05, 0.05),
            (0.06, 0.05),
            (3.0, 2.0),
            (3.3, 5.0),
            (20.0, 20.0),
            (1e9, 1000.0),
            (7e-4, 5e-4),
            (1e-3, 1e-3),
        ] {
            assert!(
                (nearest_step(asked) / step - 1.0).abs() < 1e-12,
                "{asked}: {}",
                nearest_step(asked)
            );
        }
    }
}
