//! Instruments that speak their own dialect and look at one simulated world: what the bench is tested against, on real ports or in process.
//!
//! Each file holds one model's command table, written from the model's documentation and never from a driver of this crate, so that a shared
//! mistake cannot cancel. An unknown header gets what the model does with it: an entry in the error queue, or silence; never a guess.
//! Knows no physics: the world is behind [`plant::Plant`].

mod faults;
pub mod plant;

mod acquisition;
mod dho;
mod dl3000;
mod dp832;
mod e36312a;
mod generator_33500b;
mod huber;
mod jig;
mod julabo;
mod kepco;
mod number;
mod replay;
mod scanner;
mod scope;
mod sdg;
mod sdl;
mod serve;
mod spd;
mod tree;
mod world;

pub use faults::{Fault, FaultLog, Happened, Schedule, Trouble, make_troubled};
use plant::SharedPlant;
pub use replay::{Divergence, Outcome, Replay};
pub use serve::{
    Vxi11Ports, serve, serve_gpib, serve_gpib_pty, serve_hislip, serve_memory, serve_pty, serve_tcp, serve_usbtmc, serve_vxi11,
};

use crate::scpi::decode::Terminator;

/// A simulated instrument: answers messages, acts on its world, reads it.
pub trait Device: Send {
    /// What ends a message to the instrument.
    fn terminator(&self) -> Terminator;

    /// Handles one message (without its terminator) at bench time `now_s` and gives the whole reply, terminators included; nothing for silence.
    /// Times never decrease from one call to the next.
    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8>;

    /// What goes wrong on the wire with the message that is about to be handled; nothing with a sound instrument.
    fn trouble(&mut self, _now_s: f64, _message: &[u8]) -> Option<Trouble> {
        None
    }

    /// How late the answer to a message of `now_s` is, s.
    fn late_s(&self, now_s: f64) -> f64 {
        let _ = now_s;
        0.0
    }
}

/// What a mock can be told about itself. What does not apply to a model is ignored by it.
#[derive(Debug, Clone, PartialEq)]
pub struct MockOptions {
    /// Serial number in the identity (`34970A` has none, `julabo` no identity).
    pub serial_number: String,
    /// Every message is sent back, followed by CR LF, before it is answered: a telnet port or a serial line with echo.
    pub echo: bool,
    /// `kepco-bop-linear`: the analog input is wired up and commands the output whenever that is on.
    pub analog_wired: bool,
    /// `kepco-bop-mg`: with its output off it holds its terminals at zero volts, which shorts a cell, until it is told otherwise; else it was left
    /// with `BATTERY` stored, as on a bench for cells.
    pub off_active: bool,
    /// `siglent-sds800x-hd`: points in one page of a waveform, at least 1.
    pub page_points: usize,
    /// `julabo`: left in manual mode at its panel, so that it obeys no command.
    pub local: bool,
    /// `julabo`: a command that comes too soon after a write is lost.
    pub strict_pacing: bool,
    /// Bench time at which it is switched on, s.
    pub since_s: f64,
}

impl Default for MockOptions {
    fn default() -> Self {
        Self {
            serial_number: "SIM00001".to_owned(),
            echo: false,
            analog_wired: true,
            off_active: false,
            page_points: 10_000_000,
            local: false,
            strict_pacing: false,
            since_s: 0.0,
        }
    }
}

/// One line of [`MODELS`].
pub struct Model {
    /// Name in configurations.
    pub key: &'static str,
    /// What it does on the bench.
    pub role: &'static str,
    /// One line for people.
    pub description: &'static str,
    /// What its protection or a hand at its panel would do to its output, as a message.
    pub panel_off: Option<&'static str>,
    /// Makes one, in the state in which it is switched on.
    pub make: fn(SharedPlant, &MockOptions) -> Box<dyn Device>,
}

/// Every model that can be simulated.
pub const MODELS: &[Model] = &[
    Model {
        key: "kepco-bop-mg",
        role: "supply4q",
        description: "Kepco BOP 1KW 50-20MG: ±50 V ±20 A, analog input selected by command",
        panel_off: Some("OUTP OFF"),
        make: |plant, options| Box::new(kepco::Kepco::new(kepco::Family::Switching, plant, options)),
    },
    Model {
        key: "kepco-bop-linear",
        role: "supply4q",
        description: "Kepco BOP 20-20 with BIT card: ±20 V ±20 A, analog input by wiring",
        panel_off: Some("OUTP OFF"),
        make: |plant, options| Box::new(kepco::Kepco::new(kepco::Family::Linear { analog_wired: options.analog_wired }, plant, options)),
    },
    Model {
        key: "siglent-sdg1000x",
        role: "generator",
        description: "Siglent SDG1032X: sine and offset on channel 1",
        panel_off: Some("C1:OUTP OFF"),
        make: |plant, options| Box::new(sdg::Sdg::new(plant, options)),
    },
    Model {
        key: "siglent-sds800x-hd",
        role: "scope",
        description: "Siglent SDS824X HD: four channels, 12 bits",
        panel_off: None,
        make: |plant, options| Box::new(scope::Scope::new(plant, options)),
    },
    Model {
        key: "rigol-dho800",
        role: "scope",
        description: "Rigol DHO824: four channels, 12 bits",
        panel_off: None,
        make: |plant, options| Box::new(dho::Dho::new(plant, options)),
    },
    Model {
        key: "siglent-sdl1000x",
        role: "load",
        description: "Siglent SDL1020X-E: constant current to 30 A",
        panel_off: Some(":INP OFF"),
        make: |plant, options| Box::new(sdl::Sdl::new(plant, options)),
    },
    Model {
        key: "siglent-spd3303x",
        role: "supply",
        description: "Siglent SPD3303X: 32 V 3.2 A on channel 1",
        panel_off: Some("OUTP CH1,OFF"),
        make: |plant, options| Box::new(spd::Spd::new(plant, options)),
    },
    Model {
        key: "keysight-33500b",
        role: "generator",
        description: "Keysight 33522B: sine and offset on channel 1",
        panel_off: Some("OUTP1 OFF"),
        make: |plant, options| Box::new(generator_33500b::Keysight::new(plant, options)),
    },
    Model {
        key: "keysight-e36312a",
        role: "supply",
        description: "Keysight E36312A: 6 V 5 A on channel 1",
        panel_off: Some("OUTP OFF,(@1)"),
        make: |plant, options| Box::new(e36312a::Keysight::new(plant, options)),
    },
    Model {
        key: "rigol-dp832",
        role: "supply",
        description: "Rigol DP832: 30 V 3 A on channel 1",
        panel_off: Some(":OUTP CH1,OFF"),
        make: |plant, options| Box::new(dp832::Dp832::new(plant, options)),
    },
    Model {
        key: "rigol-dl3000",
        role: "load",
        description: "Rigol DL3021: constant current to 40 A",
        panel_off: Some(":INP OFF"),
        make: |plant, options| Box::new(dl3000::Dl3000::new(plant, options)),
    },
    Model {
        key: "huber-pb",
        role: "chiller",
        description: "Huber Pilot ONE circulator, PB commands",
        panel_off: Some("{M140000"),
        make: |plant, options| Box::new(huber::Huber::new(plant, options)),
    },
    Model {
        key: "julabo",
        role: "chiller",
        description: "Julabo CF31 circulator, serial",
        panel_off: Some("OUT_MODE_05 0"),
        make: |plant, options| Box::new(julabo::Julabo::new(plant, options)),
    },
    Model {
        key: "keysight-34970a",
        role: "logger",
        description: "Keysight 34970A: thermocouples on 101 (cell), 102 (ambient), 103 (bath)",
        panel_off: None,
        make: |plant, options| Box::new(scanner::Scanner::new(plant, options)),
    },
    Model {
        key: "mock-jig",
        role: "jig",
        description: "the hands that clamp another fixture into the jig",
        panel_off: None,
        make: |plant, options| Box::new(jig::Jig::new(plant, options)),
    },
];

/// A model key that is not in [`MODELS`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected a model that can be simulated ({}), found `{found}`", known_models())]
pub struct UnknownModel {
    /// The key asked for.
    pub found: String,
}

fn known_models() -> String {
    MODELS.iter().map(|model| model.key).collect::<Vec<_>>().join(", ")
}

/// Makes one simulated instrument and connects it to the world, which learns the state at switch-on as of bench time zero: all instruments of a
/// bench are made before the first of them is served.
///
/// # Errors
/// [`UnknownModel`] when no model has this key.
pub fn make(model: &str, plant: SharedPlant, options: &MockOptions) -> Result<Box<dyn Device>, UnknownModel> {
    let found = MODELS.iter().find(|candidate| candidate.key == model);
    let device = found.map(|found| (found.make)(plant.clone(), options)).ok_or_else(|| UnknownModel { found: model.to_owned() })?;
    let device: Box<dyn Device> = Box::new(Late { device, plant });
    Ok(if options.echo { Box::new(Echo(device)) } else { device })
}

/// Answers as late as the world has it.
struct Late {
    device: Box<dyn Device>,
    plant: SharedPlant,
}

impl Device for Late {
    fn terminator(&self) -> Terminator {
        self.device.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.device.handle(now_s, message)
    }

    fn late_s(&self, now_s: f64) -> f64 {
        self.plant.lock().unwrap_or_else(std::sync::PoisonError::into_inner).late_s(now_s)
    }
}

/// Sends every message back before the answer.
struct Echo(Box<dyn Device>);

impl Device for Echo {
    fn terminator(&self) -> Terminator {
        self.0.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        [message, b"\r\n", &self.0.handle(now_s, message)].concat()
    }

    fn trouble(&mut self, now_s: f64, message: &[u8]) -> Option<Trouble> {
        self.0.trouble(now_s, message)
    }

    fn late_s(&self, now_s: f64) -> f64 {
        self.0.late_s(now_s)
    }
}
