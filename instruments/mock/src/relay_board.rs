//! A serial board with a DS18B20 in a bath and two relays, for a heater and a cooler. Its protocol
//! belongs to this project (`docs/thermostat.md`); the sensor's reply is that of the Linux kernel's
//! `w1_slave`.
//!
//! A relay is switched on for a limited time, at most a minute, and then drops automatically:
//! nothing stays on if the client falls silent. Assumed: the sensor follows the bath at once, and
//! each query returns a fresh conversion.

use instruments_scpi::decode::Terminator;

use super::{
    Device, MockOptions,
    plant::{Action, BathState, Meter, SharedPlant},
    quirks::Quirks,
    world::World,
};

/// Longest pulse, s.
const LONGEST_S: f64 = 60.0;
/// The register that a DS18B20 shows after power-on: 85 °C.
const POWER_ON: i16 = 0x0550;

/// The board.
pub(super) struct RelayBoard {
    world: World,
    quirks: Quirks,
    bath: BathState,
    /// Reading that a stuck sensor repeats.
    first: Option<i16>,
}

impl RelayBoard {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let world = World::new(plant, options.since_s);
        let board = Self {
            world,
            quirks: options.quirks.clone(),
            bath: BathState::default(),
            first: None,
        };
        board.world.act(Action::Bath(board.bath));
        board
    }

    fn left_s(&self) -> f64 {
        (self.bath.until_s - self.world.now_s).max(0.0)
    }

    fn state(&self) -> String {
        let left_s = self.left_s();
        match self.bath.power {
            power if left_s > 0.0 && power > 0.0 => format!("HEAT {left_s:.2}"),
            power if left_s > 0.0 && power < 0.0 => format!("COOL {left_s:.2}"),
            _ => "OFF".to_owned(),
        }
    }

    fn switch(&mut self, power: f64, seconds: &str) -> String {
        let Some(seconds) = seconds
            .parse()
            .ok()
            .filter(|seconds: &f64| (0.0..=LONGEST_S).contains(seconds))
        else {
            return format!("ERR expected 0 to {LONGEST_S} seconds");
        };
        match self.quirks.word("relay") {
            "refused" => return "ERR relay".to_owned(),
            // It conducts for good, whatever the board believes.
            "welded" => self.world.act(Action::Bath(BathState {
                power: 1.0,
                until_s: f64::MAX,
            })),
            _ => {}
        }
        self.bath = BathState {
            power: if seconds > 0.0 { power } else { 0.0 },
            until_s: self.world.now_s + seconds,
        };
        if self.quirks.word("relay") != "welded" {
            self.world.act(Action::Bath(self.bath));
        }
        format!("OK {}", self.state())
    }

    /// Returns the two lines of `w1_slave` in one.
    fn convert(&mut self) -> String {
        #[expect(clippy::cast_possible_truncation, reason = "a temperature of water")]
        let real = (self.world.read(Meter::BathCelsius).clamp(-55.0, 125.0) * 16.0).round() as i16;
        let raw = match self.quirks.word("sensor") {
            "absent" => return "ERR no sensor".to_owned(),
            "power_on" => POWER_ON,
            "stuck" => *self.first.get_or_insert(real),
            _ => real,
        };
        let [low, high] = raw.to_le_bytes();
        let mut bytes = [low, high, 0x4b, 0x46, 0x7f, 0xff, 0x0c, 0x10, 0];
        bytes[8] = crc(&bytes[..8]);
        if self.quirks.word("sensor") == "crc" {
            bytes[0] ^= 0x20;
        }
        let fits = crc(&bytes[..8]) == bytes[8];
        let hex = bytes
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect::<Vec<_>>()
            .join(" ");
        let millidegrees = i32::from(i16::from_le_bytes([bytes[0], bytes[1]])) * 1000 / 16;
        format!(
            "{hex} : crc={:02x} {} {hex} t={millidegrees}",
            bytes[8],
            if fits { "YES" } else { "NO" }
        )
    }
}

/// Returns the sum of the 1-Wire bus: x⁸ + x⁵ + x⁴ + 1, least bit first.
fn crc(bytes: &[u8]) -> u8 {
    let mut sum = 0_u8;
    for bit in bytes
        .iter()
        .flat_map(|byte| (0..8).map(move |place| byte >> place & 1))
    {
        let out = (sum & 1) ^ bit;
        sum >>= 1;
        if out == 1 {
            sum ^= 0b1000_1100;
        }
    }
    sum
}

impl Device for RelayBoard {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        let text = String::from_utf8_lossy(message).trim().to_owned();
        let (word, argument) = text.split_once(' ').unwrap_or((text.as_str(), ""));
        let answer = match (word, argument) {
            ("ID", "") => "THERMOSTAT BOARD 1".to_owned(),
            ("TEMP", "") => self.convert(),
            ("STATE", "") => self.state(),
            ("OFF", "") => self.switch(0.0, "0"),
            ("HEAT", seconds) => self.switch(1.0, seconds),
            ("COOL", seconds) => self.switch(-1.0, seconds),
            _ => "ERR unknown command".to_owned(),
        };
        format!("{answer}\n").into_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::crc;

    #[test]
    fn the_sum_is_that_of_the_kernel_s_own_example() {
        assert_eq!(crc(&[0x72, 0x01, 0x4b, 0x46, 0x7f, 0xff, 0x0e, 0x10]), 0x57);
    }
}
