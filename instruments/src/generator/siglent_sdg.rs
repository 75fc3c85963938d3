//! Siglent SDG1000X (and 2000X/6000X): one keyword-list command per channel, read back whole, silently clamped when out of range; no error queue
//! to rely on (programming guide PG02-E05B).

use super::{Capabilities, Dialect, Sine};
use crate::{
    exchange::{Exchange, Expect, Identity},
    link::LinkProfile,
    supply4q::ms,
    units::{Hertz, Volts},
};

/// Siglent SDG1000X.
pub(super) const SDG1000X: Sdg = Sdg;

/// Relative rounding of a frequency that is read back.
const FREQ_DIGITS: f64 = 1.0e-6;
/// An amplitude is read back to four digits or 0.1 mV; wider, and the least amplitude would pass for half of it.
const AMPLITUDE_STEP_V: f64 = 2.5e-4;
/// A millivolt, 2 mA of a supply of ±20 A.
const OFFSET_TOLERANCE_V: f64 = 1.0e-3;

pub(super) struct Sdg;

impl Dialect for Sdg {
    fn key(&self) -> &'static str {
        "siglent-sdg1000x"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile { min_gap: ms(10), error_query: None, ..LinkProfile::scpi() }
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities {
            freq_range: (Hertz(1.0e-6), Hertz(30.0e6)),
            // 2 mV peak to peak.
            min_amplitude: Volts(1.0e-3),
            max_peak: Volts(10.0),
            freq_step: Hertz(1.0e-6),
        }
    }

    fn recognises(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("Siglent") && identity.model.starts_with("SDG") && identity.model.contains('X')
    }

    fn output(&self, channel: u8, on: bool) -> Vec<Exchange> {
        let (word, expect) = if on {
            ("ON", Expect::All(vec![contains("OUTP ON"), contains("LOAD,HZ"), contains("PLRT,NOR")]))
        } else {
            ("OFF", contains("OUTP OFF"))
        };
        vec![Exchange::Set { message: format!("C{channel}:OUTP {word}"), read_back: format!("C{channel}:OUTP?"), expect }]
    }

    fn prepare(&self, channel: u8) -> Vec<Exchange> {
        // With 50 Ω set, an open analog input would see twice the volts that were asked for; inverted, it would charge instead of discharge.
        [("OUTP LOAD,HZ", "OUTP?", "LOAD,HZ"), ("OUTP PLRT,NOR", "OUTP?", "PLRT,NOR")]
            .into_iter()
            .chain([
                ("BTWV STATE,OFF", "BTWV?", "STATE,OFF"),
                ("SWWV STATE,OFF", "SWWV?", "STATE,OFF"),
                ("MDWV STATE,OFF", "MDWV?", "STATE,OFF"),
            ])
            .map(|(message, read_back, text)| Exchange::Set {
                message: format!("C{channel}:{message}"),
                read_back: format!("C{channel}:{read_back}"),
                expect: contains(text),
            })
            .collect()
    }

    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange> {
        let (freq_hz, peak_to_peak_v, offset_v) = (sine.freq.value(), 2.0 * sine.amplitude.value(), sine.offset.value());
        let fields = vec![
            ("FRQ", freq_hz, FREQ_DIGITS * freq_hz + 1.0e-6),
            ("AMP", peak_to_peak_v, 1.0e-3 * peak_to_peak_v + AMPLITUDE_STEP_V),
            ("OFST", offset_v, OFFSET_TOLERANCE_V),
        ];
        vec![Exchange::Set {
            message: format!("C{channel}:BSWV WVTP,SINE,FRQ,{freq_hz:.6},AMP,{peak_to_peak_v:.4},OFST,{offset_v:.4},PHSE,0"),
            read_back: format!("C{channel}:BSWV?"),
            expect: Expect::All(vec![contains("WVTP,SINE"), Expect::Fields(fields)]),
        }]
    }

    fn steady(&self, channel: u8, level: Volts) -> Vec<Exchange> {
        let level_v = level.value();
        vec![Exchange::Set {
            message: format!("C{channel}:BSWV WVTP,DC,OFST,{level_v:.4}"),
            read_back: format!("C{channel}:BSWV?"),
            expect: Expect::All(vec![contains("WVTP,DC"), Expect::Fields(vec![("OFST", level_v, OFFSET_TOLERANCE_V)])]),
        }]
    }
}

fn contains(text: &str) -> Expect {
    Expect::Contains(text.to_owned())
}
