//! Siglent SDM3065X multimeter: one input, here with a type K thermocouple on the cell's surface.
//!
//! Only temperatures come from the bench; the direct voltage of the thermocouple is shown in the
//! other function. Assumed, for want of a source: out-of-range values are refused by -222; the unit
//! of temperatures survives another configuration; an open thermocouple reads 9.9E37; the version
//! in the identity.

use scpi::{Branch, Leaf, Root, error::ErrorCode, tree::Node};

use super::{
    MockOptions,
    machine::scpi_device,
    number::signed_nr3,
    plant::{Meter, SharedPlant},
    tree::{Answer, Arguments, Fallible, Status, both, common, fail, get, set, text},
    world::World,
};

const QUEUE_DEPTH: usize = 20;
const OVERLOAD: f64 = 9.9e37;
/// Most readings of one trigger.
const MEMORY: f64 = 10_000.0;
/// A type K thermocouple near room temperature, V/K, and its cold junction, °C.
const VOLTS_PER_KELVIN: f64 = 41e-6;
const JUNCTION_C: f64 = 23.0;

/// The multimeter.
pub(super) struct Sdm {
    world: World,
    status: Status,
    serial_number: String,
    /// Shows a temperature, by a thermocouple of type K.
    temperature: bool,
    unit: &'static str,
    samples: usize,
    source: &'static str,
    readings: Vec<f64>,
    open: bool,
}

impl Sdm {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            serial_number: options.serial_number.clone(),
            temperature: false,
            unit: ["F", "K"]
                .into_iter()
                .find(|unit| *unit == options.quirks.word("unit"))
                .unwrap_or("C"),
            samples: 1,
            source: "IMM",
            readings: Vec::new(),
            open: options.quirks.is("open_thermocouple"),
        }
    }

    fn configure_temperature(&mut self, arguments: &mut Arguments) -> Fallible {
        let sensor = arguments.word(&["RTD", "THER"])?;
        let kind = if sensor == "RTD" {
            &["PT100", "PT1000"][..]
        } else {
            &[
                "BITS90", "EITS90", "JITS90", "KITS90", "NITS90", "RITS90", "SITS90", "TITS90",
            ]
        };
        // Another sensor than the one that is connected shows nothing of use.
        self.temperature = arguments.word(kind)? == "KITS90";
        (self.samples, self.source) = (1, "IMM");
        self.readings.clear();
        Ok(())
    }

    fn configure_voltage(&mut self, arguments: &mut Arguments) -> Fallible {
        if !arguments.is_empty() {
            let range = arguments.number("V")?;
            self.status.bounded(range, 0.0..=1000.0)?;
        }
        self.temperature = false;
        self.readings.clear();
        Ok(())
    }

    fn function(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(if self.temperature {
            "\"TEMP THER,KITS90\""
        } else {
            "\"VOLT:DC\""
        })
    }

    fn set_samples(&mut self, arguments: &mut Arguments) -> Fallible {
        let samples = self
            .status
            .bounded(arguments.number("")?.round(), 1.0..=MEMORY)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within the range"
        )]
        let samples = samples as usize;
        self.samples = samples;
        Ok(())
    }

    fn set_unit(&mut self, arguments: &mut Arguments) -> Fallible {
        self.unit = arguments.word(&["C", "F", "K"])?;
        Ok(())
    }

    fn set_source(&mut self, arguments: &mut Arguments) -> Fallible {
        self.source = match arguments.word(&["IMMediate", "EXTernal", "BUS"])? {
            "EXTernal" => "EXT",
            "BUS" => "BUS",
            _ => "IMM",
        };
        Ok(())
    }

    fn reading(&self) -> f64 {
        let celsius = self.world.read(Meter::CellCelsius);
        match self.unit {
            _ if self.open => OVERLOAD,
            _ if !self.temperature => (celsius - JUNCTION_C) * VOLTS_PER_KELVIN,
            "F" => celsius * 1.8 + 32.0,
            "K" => celsius + 273.15,
            _ => celsius,
        }
    }

    fn initiate(&mut self, _: &mut Arguments) -> Fallible {
        if self.source != "IMM" {
            return fail(ErrorCode::SettingsConflict);
        }
        self.readings = (0..self.samples).map(|_| self.reading()).collect();
        Ok(())
    }

    fn fetch(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        if self.readings.is_empty() {
            return fail(ErrorCode::DataCorruptOrStale);
        }
        text(
            self.readings
                .iter()
                .map(|reading| signed_nr3(*reading))
                .collect::<Vec<_>>()
                .join(","),
        )
    }

    fn read(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        self.initiate(arguments)?;
        self.fetch(arguments)
    }
}

const TREE: Node<'static, Sdm> = Root! {
    Leaf! {b"*IDN" => &get(|sdm: &mut Sdm, _| {
        text(format!("Siglent Technologies,SDM3065X,{},3.01.01.10", sdm.serial_number))
    })},
    Leaf! {b"*RST" => &set(|sdm: &mut Sdm, _| {
        (sdm.temperature, sdm.unit, sdm.samples, sdm.source) = (false, "C", 1, "IMM");
        Ok(())
    })},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Branch! {b"CONFigure" => &get(Sdm::function);
        Leaf! {b"TEMPerature" => &set(Sdm::configure_temperature)},
        Branch! {b"VOLTage" => &set(Sdm::configure_voltage); Leaf! {b"DC" => &set(Sdm::configure_voltage)}}
    },
    Branch! {b"UNIT"; Leaf! {b"TEMPerature" => &both(Sdm::set_unit, |sdm, _| text(sdm.unit))}},
    Branch! {b"SAMPle"; Leaf! {b"COUNt" => &both(Sdm::set_samples, |sdm, _| text(sdm.samples.to_string()))}},
    Branch! {b"TRIGger"; Leaf! {b"SOURce" => &both(Sdm::set_source, |sdm, _| text(sdm.source))}},
    Branch! {b"INITiate" => &set(Sdm::initiate); Leaf! {b"IMMediate" => &set(Sdm::initiate)}},
    Leaf! {b"ABORt" => &set(|sdm: &mut Sdm, _| { sdm.readings.clear(); Ok(()) })},
    Leaf! {b"FETCh" => &get(Sdm::fetch)},
    Leaf! {b"READ" => &get(Sdm::read)},
    Branch! {b"SYSTem"; Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}}}
};

scpi_device!(Sdm, TREE, coded);
