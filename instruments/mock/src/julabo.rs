//! Julabo circulator on its serial line: not SCPI. A command ends with CR, a reply with CR LF; a
//! write has no reply.
//!
//! In local (manual) mode `OUT_` commands are ignored silently. The remote mode is selected at the
//! unit's panel, here with the quirk `local`. `STATUS` reports the mode, or the error of the last
//! command as a negative number. Assumed: the next valid command clears that error; the working
//! range is that of a CF31.

use instruments_scpi::decode::Terminator;

use super::{
    Device, MockOptions,
    plant::{Action, ChillerState, Meter, SharedPlant},
    world::World,
};

const SETPOINT_RANGE_C: (f64, f64) = (-30.0, 200.0);
const VERSION: &str = "JULABO CRYOCOMPACT CF31 VERSION 5.0";
/// Least time between a write and the next command, s.
const PAUSE_AFTER_WRITE_S: f64 = 0.25;
/// Longest command that is looked at, bytes.
const LONGEST_COMMAND: usize = 64;

const INVALID_COMMAND: &str = "-08 INVALID COMMAND";
const NOT_ALLOWED: &str = "-09 COMMAND NOT ALLOWED IN CURRENT OPERATING MODE";
const TOO_SMALL: &str = "-10 VALUE TOO SMALL";
const TOO_LARGE: &str = "-11 VALUE TOO LARGE";
const LOW_LEVEL: &str = "-01 LOW LEVEL ALARM";

/// The circulator.
pub(super) struct Julabo {
    world: World,
    remote: bool,
    strict_pacing: bool,
    state: ChillerState,
    external: bool,
    message: Option<&'static str>,
    busy_until_s: f64,
}

impl Julabo {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let julabo = Self {
            world: World::new(plant, options.since_s),
            remote: !options.quirks.is("local"),
            strict_pacing: options.quirks.is("strict_pacing"),
            state: ChillerState {
                running: false,
                setpoint_degc: 25.0,
            },
            external: false,
            message: None,
            busy_until_s: f64::NEG_INFINITY,
        };
        julabo.act();
        julabo
    }

    fn act(&self) {
        self.world.act(Action::Chiller(self.state));
    }

    fn status(&self) -> &'static str {
        if self.world.plant().chiller_alarm(self.world.now_s) {
            return LOW_LEVEL;
        }
        self.message
            .unwrap_or(match (self.remote, self.state.running) {
                (false, false) => "00 MANUAL STOP",
                (false, true) => "01 MANUAL START",
                (true, false) => "02 REMOTE STOP",
                (true, true) => "03 REMOTE START",
            })
    }

    fn read(&mut self, command: &str) -> Option<String> {
        let bath = || format!("{:.2}", self.world.read(Meter::BathCelsius));
        let answer = match command {
            "IN_PV_00" | "IN_PV_03" => bath(),
            "IN_PV_01" => (if self.state.running { "15" } else { "0" }).to_owned(),
            "IN_PV_02" => "---.--".to_owned(),
            "IN_SP_00" => format!("{:.2}", self.state.setpoint_degc),
            "IN_SP_03" => format!("{:.2}", SETPOINT_RANGE_C.1),
            "IN_SP_04" => format!("{:.2}", SETPOINT_RANGE_C.0),
            "IN_MODE_04" => u8::from(self.external).to_string(),
            "IN_MODE_05" => u8::from(self.state.running).to_string(),
            "VERSION" => VERSION.to_owned(),
            _ => return None,
        };
        self.message = None;
        Some(answer)
    }

    fn write(&mut self, command: &str) {
        let (name, value) = command
            .split_once(' ')
            .map_or((command, ""), |(name, value)| (name, value.trim()));
        self.message = None;
        self.busy_until_s = self.world.now_s + PAUSE_AFTER_WRITE_S;
        match (name, value) {
            ("OUT_SP_00", value) => match value.parse::<f64>() {
                Ok(celsius) if celsius < SETPOINT_RANGE_C.0 => self.message = Some(TOO_SMALL),
                Ok(celsius) if celsius > SETPOINT_RANGE_C.1 => self.message = Some(TOO_LARGE),
                Ok(celsius) if celsius.is_finite() => {
                    self.state.setpoint_degc = (celsius * 100.0).round() / 100.0;
                }
                _ => self.message = Some(INVALID_COMMAND),
            },
            ("OUT_MODE_05", "0" | "1") => self.state.running = value == "1",
            ("OUT_MODE_04", "0" | "1") => self.external = value == "1",
            ("OUT_MODE_01", "0") => {}
            // Only one set-point is simulated.
            ("OUT_MODE_01", "1" | "2") => self.message = Some(NOT_ALLOWED),
            _ => self.message = Some(INVALID_COMMAND),
        }
        self.act();
    }
}

impl Device for Julabo {
    fn terminator(&self) -> Terminator {
        Terminator::Cr
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        let command = String::from_utf8_lossy(message).trim().to_ascii_uppercase();
        let hasty = self.strict_pacing && now_s < self.busy_until_s;
        if command.is_empty() || hasty {
            return Vec::new();
        }
        if command == "STATUS" {
            return format!("{}\r\n", self.status()).into_bytes();
        }
        if command.starts_with("OUT_") && command.len() <= LONGEST_COMMAND {
            if self.remote {
                self.write(&command);
            }
            return Vec::new();
        }
        match self.read(&command) {
            Some(answer) => format!("{answer}\r\n").into_bytes(),
            None => {
                self.message = Some(INVALID_COMMAND);
                Vec::new()
            }
        }
    }
}
