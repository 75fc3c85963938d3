//! Simulated instruments for tests and demos, on real ports or in process. Each has the dialect of
//! its model, and all act on one simulated world.
//!
//! Each file contains one model's command table, written from the model's documentation and never
//! from a driver, so that a shared mistake cannot cancel. An unknown header gets the model's
//! response to it: an entry in the error queue, or silence; never a guess. Contains no physics: the
//! world is behind [`plant::Plant`].

mod faults;
pub mod plant;
pub mod quirks;

mod acquisition;
mod device;
mod dho;
mod dl3000;
mod dp832;
mod e36312a;
mod fast_ps;
mod generator_33500b;
mod huber;
mod jig;
mod julabo;
mod kepco;
mod latency;
mod machine;
mod messages;
mod number;
mod protocol_quirks;
mod relay_board;
mod replay;
mod scanner;
mod scope;
mod sdg;
mod sdl;
mod sdm;
mod serve;
mod spd;
mod tree;
mod world;

pub use faults::{
    Armed, Fault, FaultLog, FaultSwitch, Happened, Remote, Schedule, Trouble, make_troubled,
};
pub use latency::{Latency, MEASURED};
pub use messages::Messages;
use plant::SharedPlant;
use quirks::{Quirk, QuirkError, Quirks};
pub use replay::{Divergence, Outcome, Replay};
pub use serve::{
    Vxi11Ports, serve, serve_gpib, serve_gpib_pty, serve_hislip, serve_memory, serve_pty,
    serve_tcp, serve_usbtmc, serve_vxi11,
};

pub use device::{Absence, Device, MockOptions};

/// One line of [`MODELS`].
pub struct Model {
    /// Name in configurations.
    pub key: &'static str,
    /// Role on the bench.
    pub role: &'static str,
    /// One line for people.
    pub description: &'static str,
    /// Message that switches the output off, with the same effect as its protection or a person at
    /// its panel.
    pub panel_off: Option<&'static str>,
    /// Messages whose effect the faults depend on.
    pub messages: Messages,
    /// Messages that another client might send to it, in several variants.
    pub meddling: &'static [&'static [&'static str]],
    /// Quirks that it has beside the common ones.
    pub own_quirks: &'static [&'static [Quirk]],
    /// Makes one, in the state in which it is switched on.
    pub make: fn(SharedPlant, &MockOptions) -> Box<dyn Device>,
}

impl Model {
    /// Every switch that it has.
    pub fn quirks(&self) -> impl Iterator<Item = &'static Quirk> + use<> {
        std::iter::once(quirks::COMMON)
            .chain(self.own_quirks.iter().copied())
            .flatten()
    }
}

/// Every model that can be simulated.
pub const MODELS: &[Model] = &[
    Model {
        key: "kepco-bop-mg",
        role: "supply4q",
        description: "Kepco BOP 1KW 50-20MG: ±50 V ±20 A, analog input selected by command",
        panel_off: Some("OUTP OFF"),
        messages: Messages::metered(&["OUTP OFF"]),
        meddling: &[
            &["CURR:MODE FIX", "CURR 1.9"],
            &["CURR:LIM 20"],
            &["OUTP OFF"],
        ],
        own_quirks: &[quirks::KEPCO_MG, quirks::QUEUE, quirks::REFUSES],
        make: |plant, options| {
            Box::new(kepco::Kepco::new(kepco::Family::Switching, plant, options))
        },
    },
    Model {
        key: "kepco-bop-linear",
        role: "supply4q",
        description: "Kepco BOP 20-20 with BIT card: ±20 V ±20 A, analog input by wiring",
        panel_off: Some("OUTP OFF"),
        messages: Messages::metered(&["OUTP OFF"]),
        meddling: &[&["OUTP OFF"], &["VOLT 20"]],
        own_quirks: &[quirks::KEPCO_LINEAR, quirks::QUEUE, quirks::REFUSES],
        make: |plant, options| {
            Box::new(kepco::Kepco::new(
                kepco::Family::Linear {
                    analog_wired: options.quirks.is("analog_wired"),
                },
                plant,
                options,
            ))
        },
    },
    Model {
        key: "caenels-fast-ps",
        role: "supply4q",
        description: "CAENels FAST-PS 2020-400: ±20 V ±20 A, analog input selected by command",
        panel_off: Some("MOFF"),
        messages: Messages {
            off: &["MOFF"],
            off_answer: "#AK\r\n",
            measure: &["MRV", "MRI"],
        },
        meddling: &[&["UPMODE:NORMAL", "MWI:1.9"], &["MOFF"]],
        own_quirks: &[quirks::FAST_PS],
        make: |plant, options| Box::new(fast_ps::FastPs::new(plant, options)),
    },
    Model {
        key: "siglent-sdg1000x",
        role: "generator",
        description: "Siglent SDG1032X: sine and offset on channel 1",
        panel_off: Some("C1:OUTP OFF"),
        messages: Messages {
            off: &["C#:OUTP OFF"],
            ..Messages::NONE
        },
        meddling: &[
            &["C1:BSWV AMP,2"],
            &["C1:BSWV OFST,0.43"],
            &["C1:BSWV FRQ,7"],
            &["C1:OUTP OFF"],
            &["C1:BTWV STATE,OFF"],
            &["C1:BTWV STPS,90"],
        ],
        own_quirks: &[quirks::SDG, quirks::CLAMPS],
        make: |plant, options| Box::new(sdg::Sdg::new(plant, options)),
    },
    Model {
        key: "siglent-sds800x-hd",
        role: "scope",
        description: "Siglent SDS824X HD: four channels, 12 bits",
        panel_off: None,
        messages: Messages::NONE,
        meddling: &[
            &[":CHANnel2:SCALe 2"],
            &[":TIMebase:SCALe 1E-3"],
            &[":TRIGger:RUN"],
        ],
        own_quirks: &[quirks::SDS, quirks::DOUBLE_BLOCKS, quirks::QUEUE],
        make: |plant, options| Box::new(scope::Scope::new(plant, options)),
    },
    Model {
        key: "rigol-dho800",
        role: "scope",
        description: "Rigol DHO824: four channels, 12 bits",
        panel_off: None,
        messages: Messages::NONE,
        meddling: &[
            &[":CHANnel2:SCALe 2"],
            &[":TIMebase:MAIN:SCALe 1E-3"],
            &[":RUN"],
        ],
        own_quirks: &[quirks::DHO, quirks::BLOCKS, quirks::QUEUE],
        make: |plant, options| Box::new(dho::Dho::new(plant, options)),
    },
    Model {
        key: "siglent-sdl1000x",
        role: "load",
        description: "Siglent SDL1020X-E: constant current to 30 A",
        panel_off: Some(":INP OFF"),
        messages: Messages::metered(&[":INP OFF"]),
        meddling: &[
            &[":CURR:LEV:IMM 5"],
            &[":CURR:LEV:IMM 2", ":INP ON"],
            &[":INP OFF"],
        ],
        own_quirks: &[quirks::SDL, quirks::CLAMPS],
        make: |plant, options| Box::new(sdl::Sdl::new(plant, options)),
    },
    Model {
        key: "siglent-spd3303x",
        role: "supply",
        description: "Siglent SPD3303X: 32 V 3.2 A on channel 1",
        panel_off: Some("OUTP CH1,OFF"),
        messages: Messages::metered(&["OUTP CH1,OFF"]),
        meddling: &[
            &["CH1:CURR 3"],
            &["CH1:VOLT 5", "CH1:CURR 1", "OUTP CH1,ON"],
            &["OUTP CH1,OFF"],
        ],
        own_quirks: &[quirks::QUEUE, quirks::CLAMPS, quirks::STEPS],
        make: |plant, options| Box::new(spd::Spd::new(plant, options)),
    },
    Model {
        key: "keysight-33500b",
        role: "generator",
        description: "Keysight 33522B: sine and offset on channel 1",
        panel_off: Some("OUTP1 OFF"),
        messages: Messages {
            off: &["OUTP# OFF"],
            ..Messages::NONE
        },
        meddling: &[
            &["SOUR1:VOLT 2"],
            &["SOUR1:VOLT:OFFS 0.43"],
            &["SOUR1:FREQ 7"],
            &["OUTP1 OFF"],
            &["SOUR1:BURS:STAT OFF"],
            &["SOUR1:BURS:PHAS 90"],
        ],
        own_quirks: &[quirks::B33500, quirks::QUEUE, quirks::REFUSES],
        make: |plant, options| Box::new(generator_33500b::Keysight::new(plant, options)),
    },
    Model {
        key: "keysight-e36312a",
        role: "supply",
        description: "Keysight E36312A: 6 V 5 A on channel 1",
        panel_off: Some("OUTP OFF,(@1)"),
        messages: Messages::metered(&["OUTP OFF,(@1)"]),
        meddling: &[
            &["CURR 3,(@1)"],
            &["VOLT 5,(@1)", "CURR 1,(@1)", "OUTP ON,(@1)"],
            &["OUTP OFF,(@1)"],
        ],
        own_quirks: &[quirks::QUEUE, quirks::REFUSES],
        make: |plant, options| Box::new(e36312a::Keysight::new(plant, options)),
    },
    Model {
        key: "rigol-dp832",
        role: "supply",
        description: "Rigol DP832: 30 V 3 A on channel 1",
        panel_off: Some(":OUTP CH1,OFF"),
        messages: Messages::metered(&[":OUTP CH1,OFF"]),
        meddling: &[
            &[":SOUR1:CURR 3"],
            &[":SOUR1:VOLT 5", ":SOUR1:CURR 1", ":OUTP CH1,ON"],
            &[":OUTP CH1,OFF"],
        ],
        own_quirks: &[quirks::QUEUE, quirks::REFUSES, quirks::STEPS],
        make: |plant, options| Box::new(dp832::Dp832::new(plant, options)),
    },
    Model {
        key: "rigol-dl3000",
        role: "load",
        description: "Rigol DL3021: constant current to 40 A",
        panel_off: Some(":INP OFF"),
        messages: Messages::metered(&[":SOUR:INP:STAT OFF", ":INP OFF"]),
        meddling: &[
            &[":SOUR:CURR:LEV:IMM 5"],
            &[":SOUR:CURR:LEV:IMM 2", ":SOUR:INP:STAT ON"],
            &[":SOUR:INP:STAT OFF"],
        ],
        own_quirks: &[quirks::DL3000, quirks::QUEUE, quirks::REFUSES],
        make: |plant, options| Box::new(dl3000::Dl3000::new(plant, options)),
    },
    Model {
        key: "huber-pb",
        role: "chiller",
        description: "Huber Pilot ONE circulator, PB commands",
        panel_off: Some("{M140000"),
        messages: Messages::measuring(&["{M01"]),
        meddling: &[&["{M001B58"], &["{M140000"]],
        own_quirks: &[quirks::HUBER],
        make: |plant, options| Box::new(huber::Huber::new(plant, options)),
    },
    Model {
        key: "julabo",
        role: "chiller",
        description: "Julabo CF31 circulator, serial",
        panel_off: Some("OUT_MODE_05 0"),
        messages: Messages::measuring(&["IN_PV"]),
        meddling: &[&["OUT_SP_00 70.00"], &["OUT_MODE_05 0"]],
        own_quirks: &[quirks::JULABO],
        make: |plant, options| Box::new(julabo::Julabo::new(plant, options)),
    },
    Model {
        key: "relay-thermostat",
        role: "chiller",
        description: "a bath with a DS18B20, a heater and a cooler on relays, on one serial board",
        panel_off: Some("OFF"),
        messages: Messages::measuring(&["TEMP"]),
        meddling: &[],
        own_quirks: &[quirks::RELAYS],
        make: |plant, options| Box::new(relay_board::RelayBoard::new(plant, options)),
    },
    Model {
        key: "siglent-sdm3065x",
        role: "logger",
        description: "Siglent SDM3065X: one thermocouple on the cell",
        panel_off: None,
        messages: Messages::measuring(&["READ?"]),
        meddling: &[],
        own_quirks: &[quirks::SDM, quirks::QUEUE],
        make: |plant, options| Box::new(sdm::Sdm::new(plant, options)),
    },
    Model {
        key: "keysight-34970a",
        role: "logger",
        description: "Keysight 34970A: thermocouples on 101 (cell), 102 (ambient), 103 (bath)",
        panel_off: None,
        messages: Messages::measuring(&["READ?"]),
        meddling: &[],
        own_quirks: &[quirks::SCANNER, quirks::BLOCKS, quirks::QUEUE],
        make: |plant, options| Box::new(scanner::Scanner::new(plant, options)),
    },
    Model {
        key: "mock-jig",
        role: "jig",
        description: "the hands that clamp another fixture into the jig",
        panel_off: None,
        messages: Messages::NONE,
        meddling: &[],
        own_quirks: &[],
        make: |plant, options| Box::new(jig::Jig::new(plant, options)),
    },
];

/// Reason why a mock cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MakeError {
    /// A model key that is not in [`MODELS`].
    #[error(
        "expected a model that can be simulated ({}), found `{found}`",
        known_models()
    )]
    Unknown {
        /// The requested key.
        found: String,
    },
    /// A quirk that the model does not have, or not so.
    #[error(transparent)]
    Quirk(#[from] QuirkError),
}

fn known_models() -> String {
    MODELS
        .iter()
        .map(|model| model.key)
        .collect::<Vec<_>>()
        .join(", ")
}

/// Returns the model of this key.
///
/// # Errors
/// [`MakeError::Unknown`].
pub fn model(key: &str) -> Result<&'static Model, MakeError> {
    MODELS
        .iter()
        .find(|candidate| candidate.key == key)
        .ok_or_else(|| MakeError::Unknown {
            found: key.to_owned(),
        })
}

/// Quirks of a model when some of them are given, the others at their defaults.
///
/// # Errors
/// One that it does not have, or not so.
pub fn check_quirks(key: &str, given: &Quirks) -> Result<Quirks, MakeError> {
    let known: Vec<&'static [Quirk]> = std::iter::once(quirks::COMMON)
        .chain(model(key)?.own_quirks.iter().copied())
        .collect();
    Ok(Quirks::of(&known, given)?)
}

/// Makes one simulated instrument and connects it to the world, which learns the state at switch-on
/// as of bench time zero: all instruments of a bench are made before the first of them is served.
///
/// # Errors
/// When no model has this key, or it does not have one of the quirks.
pub fn make(
    key: &str,
    plant: SharedPlant,
    options: &MockOptions,
) -> Result<Box<dyn Device>, MakeError> {
    let options = MockOptions {
        quirks: check_quirks(key, &options.quirks)?,
        ..options.clone()
    };
    let device = (model(key)?.make)(plant.clone(), &options);
    let latency = Latency::of(key).filter(|_| options.quirks.word("latency") == "measured");
    Ok(Box::new(
        protocol_quirks::QuirkyDevice::new(device, plant, options.quirks).with_latency(latency),
    ))
}
