//! Kepco BOP. Two families that differ where it matters: BOP-MG/-GL select the analog input by command (`CURR:MODE EXT`, manual BOP 1KW-MG,
//! section 3.5.6), the linear BOP 20-20 with a BIT card by switches and wiring, where `EXT` is an unknown word.
//!
//! Numbers go out as plain `%.4f`: the parser of the instrument drops digits silently when there are more than four before the point.

use super::{AnalogSelect, Capabilities, Dialect, Limits};
use crate::{
    exchange::{Exchange, Expect, Identity},
    instrument::{Model, ms},
    link::LinkProfile,
    units::{Amps, Volts},
};

/// Kepco BOP 20-50MG/GL class, 1 kW, analog input selected by command; here the 20 V / 20 A member of the family.
pub(super) const BOP_MG: Kepco = Kepco { key: "kepco-bop-mg", analog_select: AnalogSelect::Command };
/// Kepco BOP 20-20M/D/ML, linear, with a BIT card.
pub(super) const BOP_LINEAR: Kepco = Kepco { key: "kepco-bop-linear", analog_select: AnalogSelect::Wiring };

/// Decimals of what is sent, and tolerance of what is read back: the display of a 20 A instrument rounds to a milliampere.
const READ_BACK: (usize, f64) = (4, 5.0e-3);

/// Full scale of the members that this driver knows.
const FULL_SCALE: Amps = Amps(20.0);

pub(super) struct Kepco {
    key: &'static str,
    analog_select: AnalogSelect,
}

impl Model for Kepco {
    fn key(&self) -> &'static str {
        self.key
    }

    fn profile(&self) -> LinkProfile {
        // ≈25 ms a command on the LAN card, which loses what comes faster.
        LinkProfile { min_gap: ms(35), ..LinkProfile::scpi() }
    }

    fn recognises(&self, identity: &Identity) -> bool {
        // The family spans 10 V / 75 A to 200 V / 1 A: volts at the analog input mean other amperes on another member.
        identity.raw.to_ascii_uppercase().starts_with("KEPCO") && rated_current(&identity.raw).is_none_or(|amps| amps == FULL_SCALE.value())
    }
}

impl Dialect for Kepco {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            analog_select: self.analog_select,
            full_scale: FULL_SCALE,
            full_scale_voltage: Volts(20.0),
            analog_full_scale: Volts(10.0),
            open_when_off: self.analog_select == AnalogSelect::Command,
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        if on {
            return vec![Exchange::switch("OUTP", true)];
        }
        let off = Exchange::switch("OUTP", false);
        match self.analog_select {
            // The factory setting ACTIVE holds zero volts when off, which shorts a cell; BATTERY opens the output.
            AnalogSelect::Command => vec![Exchange::word("OUTP:MODE BATTERY", "OUTP:MODE?", &["BATTERY", "BATT"]), off],
            // A linear one that is off holds zero of what its mode controls: zero amperes leave the cell alone, zero volts do not.
            AnalogSelect::Wiring => vec![Exchange::word("FUNC:MODE CURR", "FUNC:MODE?", &["1", "CURR"]), off],
        }
    }

    fn prepare(&self, limits: &Limits) -> Vec<Exchange> {
        let mut script = Vec::new();
        if self.analog_select == AnalogSelect::Command {
            script.push(Exchange::word("CURR:MODE FIX", "CURR:MODE?", &["FIX", "FIXED"]));
        }
        script.push(Exchange::word("FUNC:MODE CURR", "FUNC:MODE?", &["1", "CURR"]));
        script.push(Exchange::fixed("CURR", 0.0, READ_BACK));
        script.push(Exchange::fixed("VOLT", limits.compliance.value(), READ_BACK));
        if self.analog_select == AnalogSelect::Command {
            // In current mode the protection channel is the voltage; only the software limit bounds the current.
            script.push(both_signs("CURR:LIM", limits.current.value()));
        }
        script
    }

    fn analog(&self, on: bool) -> Vec<Exchange> {
        match (self.analog_select, on) {
            (AnalogSelect::Command, true) => vec![Exchange::word("CURR:MODE EXT", "CURR:MODE?", &["EXT", "EXTERNAL"])],
            (AnalogSelect::Command, false) => vec![Exchange::word("CURR:MODE FIX", "CURR:MODE?", &["FIX", "FIXED"])],
            (AnalogSelect::Wiring, _) => Vec::new(),
        }
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MEAS:VOLT?", "MEAS:CURR?"]
    }
}

/// The ampere in `V-A` of an identity such as `KEPCO,BOP1KW 50-20 ,E156884, 2.01`; old cards do not tell it.
fn rated_current(identity: &str) -> Option<f64> {
    identity.split([',', ' ']).find_map(|word| {
        let (volts, amps) = word.split_once('-')?;
        volts.parse::<f64>().ok()?;
        amps.trim_end_matches(|c: char| c.is_ascii_alphabetic()).parse().ok()
    })
}

/// A limit of both signs: it is answered as `pos, neg`.
fn both_signs(header: &str, value: f64) -> Exchange {
    let (decimals, tolerance) = READ_BACK;
    match Exchange::command(header, |command| command.fixed(value, decimals)) {
        Exchange::Send(message) => {
            Exchange::Set { message, read_back: format!("{header}?"), expect: Expect::Magnitude { value, tolerance } }
        }
        refused => refused,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(script: &[Exchange]) -> Vec<&str> {
        script
            .iter()
            .map(|exchange| match exchange {
                Exchange::Send(message) | Exchange::Set { message, .. } | Exchange::Refuse { message, .. } => message.as_str(),
            })
            .collect()
    }

    #[test]
    fn the_switching_family_selects_the_analog_input_by_command_and_the_linear_one_never_sends_it() {
        let limits = Limits { compliance: Volts(5.0), current: Amps(3.0) };
        assert_eq!(words(&BOP_MG.prepare(&limits)), ["CURR:MODE FIX", "FUNC:MODE CURR", "CURR 0.0000", "VOLT 5.0000", "CURR:LIM 3.0000"]);
        assert_eq!(words(&BOP_MG.analog(true)), ["CURR:MODE EXT"]);
        assert_eq!(words(&BOP_LINEAR.prepare(&limits)), ["FUNC:MODE CURR", "CURR 0.0000", "VOLT 5.0000"]);
        assert_eq!(BOP_LINEAR.analog(true), []);
    }

    #[test]
    fn another_member_of_the_family_is_not_taken_for_this_one() {
        for (raw, known) in [
            ("KEPCO,BOP1KW 50-20 ,E156884, 2.01", true),
            ("KEPCO,BOP 20-20M,E1234,2.6", true),
            ("KEPCO BOP BIT232 REV. 3.1", true),
            ("KEPCO,BOP 20-50MG,E1,2.01", false),
            ("KEPCO,BOP1KW 10-75,E1,2.01", false),
            ("ACME,BOP 20-20,1,1", false),
        ] {
            assert_eq!(BOP_MG.recognises(&Identity::parse(raw)), known, "{raw}");
        }
    }

    #[test]
    fn switching_off_never_shorts_the_cell() {
        assert_eq!(words(&BOP_MG.output(false)), ["OUTP:MODE BATTERY", "OUTP OFF"]);
        assert_eq!(words(&BOP_LINEAR.output(false)), ["FUNC:MODE CURR", "OUTP OFF"]);
    }
}
