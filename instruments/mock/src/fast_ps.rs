//! CAENels FAST-PS 2020-400 on its `#` protocol: not SCPI. A command ends with CR, a reply with CR
//! LF; every write is confirmed by `#AK` or refused by `#NAK:nn`.
//!
//! Simulated are switching, both loops, set-points, the analog input and readings. Assumed, for
//! lack of a source: bit 1 of the status word is a fault and the bit above 26 is always set; a
//! change of the update mode is accepted whether the output is on or off; the set-point is zero
//! when it is switched on; its own limits bound set-points and not the analog input; the output is
//! open when off.

use instruments_scpi::decode::Terminator;

use super::{
    Device, MockOptions,
    plant::{Action, BipolarState, Meter, SharedPlant},
    quirks::Quirks,
    world::World,
};

/// Rated output, V and A.
const RATED: (f64, f64) = (20.0, 20.0);
/// Longest command that is looked at, bytes.
const LONGEST_COMMAND: usize = 64;
const PRESENT: u32 = 0x0800_0000;

/// A refusal.
type Nak = u8;

/// The supply.
pub(super) struct FastPs {
    world: World,
    quirks: Quirks,
    on: bool,
    current_loop: bool,
    mode: &'static str,
    setpoint: f64,
    slew: f64,
}

impl FastPs {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (world, quirks) = (World::new(plant, options.since_s), options.quirks.clone());
        let supply = Self {
            world,
            quirks,
            on: false,
            current_loop: true,
            mode: "NORMAL",
            setpoint: 0.0,
            slew: 20.0,
        };
        supply.act();
        supply
    }

    fn act(&self) {
        self.world.act(Action::Bipolar(BipolarState {
            output_on: self.on,
            current_mode: self.current_loop,
            analog_input: self.mode == "ANALOG",
            setpoint: self.setpoint,
            limit: if self.current_loop { RATED.0 } else { RATED.1 },
            off_is_open: true,
        }));
    }

    fn limits(&self) -> (f64, f64) {
        (
            self.quirks.number("own_volts"),
            self.quirks.number("own_amps"),
        )
    }

    fn switch(&mut self, on: bool) -> Result<(), Nak> {
        if self.quirks.is("fault") && on {
            return Err(8);
        }
        if on == self.on {
            return Err(if on { 9 } else { 13 });
        }
        (self.on, self.setpoint) = (on, 0.0);
        Ok(())
    }

    fn choose_loop(&mut self, word: &str) -> Result<(), Nak> {
        let current_loop = match word {
            "I" => true,
            "V" => false,
            _ => return Err(2),
        };
        if current_loop == self.current_loop {
            return Err(19);
        }
        if self.on {
            return Err(38);
        }
        (self.current_loop, self.setpoint) = (current_loop, 0.0);
        Ok(())
    }

    fn choose_mode(&mut self, word: &str) -> Result<(), Nak> {
        self.mode = match word {
            "NORMAL" => "NORMAL",
            "ANALOG" if self.quirks.is("no_analog_input") => return Err(24),
            "ANALOG" => "ANALOG",
            "WAVEFORM" | "TRIGGER" => return Err(24),
            _ => return Err(2),
        };
        Ok(())
    }

    fn set(&mut self, current: bool, argument: &str) -> Result<(), Nak> {
        let value: f64 = argument
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or(12)?;
        let (volts, amps) = self.limits();
        let (rated, own) = if current {
            (RATED.1, amps)
        } else {
            (RATED.0, volts)
        };
        match () {
            () if !self.on => Err(13),
            () if self.mode != "NORMAL" => Err(21),
            () if current != self.current_loop => Err(20),
            () if value.abs() > rated => Err(10),
            () if value.abs() > own => Err(11),
            () => {
                self.setpoint = value;
                Ok(())
            }
        }
    }

    fn set_slew(&mut self, argument: &str) -> Result<(), Nak> {
        let slew: f64 = argument.parse().map_err(|_| 12)?;
        if !(slew > 0.0 && slew <= 1000.0) {
            return Err(14);
        }
        self.slew = slew;
        Ok(())
    }

    /// Returns a command that is answered by a value, without the question.
    fn read(&self, command: &str) -> Option<String> {
        let (volts, amps) = self.limits();
        Some(match command {
            "VER" => "FAST-PS 2020-400:1.5.9".to_owned(),
            "MST" => format!(
                "{:08X}",
                PRESENT | u32::from(self.on) | u32::from(self.quirks.is("fault")) << 1
            ),
            "MRI" => format!("{:+.5}", self.world.read(Meter::BipolarAmps)),
            "MRV" => format!("{:+.5}", self.world.read(Meter::BipolarVolts)),
            "MRT" => "30.00".to_owned(),
            "MRP" => "48.00".to_owned(),
            "MGC" => "+0.00010".to_owned(),
            "LOOP:?" => (if self.current_loop { "I" } else { "V" }).to_owned(),
            "UPMODE:?" => self.mode.to_owned(),
            "MLIMITS:?" => format!("{:.1}:{volts:.1}:{:.1}:{amps:.1}", -volts, -amps),
            "MSRI:?" | "MSRV:?" => format!("{:.5}", self.slew),
            _ => return None,
        })
    }

    fn write(&mut self, command: &str) -> Result<(), Nak> {
        if self.quirks.is("local") {
            return Err(15);
        }
        match command.split_once(':').unwrap_or((command, "")) {
            ("MON", "") => self.switch(true),
            ("MOFF", "") => self.switch(false),
            ("MRESET", "") => Ok(()),
            ("LOOP" | "UPMODE" | "MWI" | "MWIR" | "MWV" | "MWVR" | "MSRI" | "MSRV", "") => Err(4),
            ("LOOP", word) => self.choose_loop(word),
            ("UPMODE", word) => self.choose_mode(word),
            ("MWI" | "MWIR", value) => self.set(true, value),
            ("MWV" | "MWVR", value) => self.set(false, value),
            ("MSRI" | "MSRV", value) => self.set_slew(value),
            _ => Err(1),
        }
    }
}

impl Device for FastPs {
    fn terminator(&self) -> Terminator {
        Terminator::Cr
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        let command = String::from_utf8_lossy(
            message
                .trim_ascii()
                .get(..LONGEST_COMMAND)
                .unwrap_or(message.trim_ascii()),
        )
        .into_owned();
        if let Some(value) = self.read(&command) {
            return format!("#{}:{value}\r\n", command.trim_end_matches(":?")).into_bytes();
        }
        match self.write(&command) {
            Ok(()) => {
                self.act();
                b"#AK\r\n".to_vec()
            }
            Err(code) => format!("#NAK:{code:02}\r\n").into_bytes(),
        }
    }
}
