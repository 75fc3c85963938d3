//! Huber Pilot ONE with PB commands over TCP: not SCPI. Eight characters and CR LF. The reply to a
//! well-formed command is the register's value after limiting; other commands get no reply.
//!
//! Only the registers that a bench needs are simulated; the others answer `7FFF`, like registers
//! that the unit does not have. Remote settings are lost at power-down. Assumed: a write to a
//! read-only register is answered with its value.

use instruments_scpi::decode::Terminator;

use super::{
    Device, MockOptions,
    plant::{Action, ChillerState, Meter, SharedPlant},
    quirks::Quirks,
    world::World,
};

/// Least and greatest set-point, hundredths of a degree.
const SETPOINTS: (i16, i16) = (-4000, 15_000);
const NOT_AVAILABLE: u16 = 0x7fff;
/// Status bit of an error.
const ERROR: u16 = 1 << 8;

/// The circulator.
pub(super) struct Huber {
    world: World,
    setpoint: i16,
    controlling: bool,
    /// Nothing was written since it was switched on.
    restarted: bool,
    quirks: Quirks,
}

impl Huber {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let huber = Self {
            world: World::new(plant, options.since_s),
            setpoint: 2500,
            controlling: false,
            restarted: true,
            quirks: options.quirks.clone(),
        };
        huber.act();
        huber
    }

    fn act(&self) {
        let setpoint_degc = f64::from(self.setpoint) / 100.0;
        self.world.act(Action::Chiller(ChillerState {
            running: self.controlling,
            setpoint_degc,
        }));
    }

    /// Returns whether the pump is stopped.
    fn stopped(&self) -> bool {
        self.world.plant().chiller_alarm(self.world.now_s)
    }

    fn write(&mut self, address: u8, value: u16) {
        match address {
            0x00 => self.setpoint = value.cast_signed().clamp(SETPOINTS.0, SETPOINTS.1),
            0x14 => self.controlling = value & 1 == 1,
            _ => return,
        }
        self.restarted = false;
        self.act();
    }

    fn read(&self, address: u8) -> u16 {
        match address {
            0x00 => self.setpoint.cast_unsigned(),
            0x01 if self.quirks.word("bath_sensor") == "absent" => (-15_100_i16).cast_unsigned(),
            0x01 if self.quirks.word("bath_sensor") == "unknown" => NOT_AVAILABLE,
            0x01 => hundredths(self.world.read(Meter::BathCelsius)),
            // No process sensor.
            0x07 => (-15_100_i16).cast_unsigned(),
            0x05 => u16::from(self.stopped()),
            0x06 => 0,
            0x0a if self.stopped() => ERROR | u16::from(!self.restarted) << 14,
            0x0a => {
                u16::from(self.controlling)
                    | u16::from(self.controlling) << 1
                    | u16::from(!self.restarted) << 14
            }
            0x14 | 0x16 => u16::from(self.controlling),
            0x30 => SETPOINTS.0.cast_unsigned(),
            0x31 => SETPOINTS.1.cast_unsigned(),
            _ => NOT_AVAILABLE,
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "clamped before")]
fn hundredths(celsius: f64) -> u16 {
    ((celsius * 100.0).round().clamp(-15_000.0, 30_000.0) as i16).cast_unsigned()
}

/// Returns the register and, for a write, the value.
fn command(message: &[u8]) -> Option<(u8, Option<u16>)> {
    let text = std::str::from_utf8(message).ok()?.trim();
    let digits = text
        .strip_prefix("{M")
        .filter(|digits| digits.len() == 6 && digits.is_ascii())?;
    let address = u8::from_str_radix(&digits[..2], 16).ok()?;
    match &digits[2..] {
        "****" => Some((address, None)),
        value => Some((address, Some(u16::from_str_radix(value, 16).ok()?))),
    }
}

impl Device for Huber {
    fn terminator(&self) -> Terminator {
        Terminator::CrLf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        let Some((address, value)) = command(message) else {
            return Vec::new();
        };
        if let Some(value) = value {
            self.write(address, value);
        }
        format!("{{S{address:02X}{:04X}\r\n", self.read(address)).into_bytes()
    }
}
