//! Siglent SDG1000X (and 2000X/6000X): one keyword-list command per channel, read back whole, silently clamped when out of range; no error queue
//! to rely on (programming guide PG02-E05B).

use super::{Capabilities, Dialect, Sine};
use crate::{
    exchange::{Exchange, Expect, Identity},
    instrument::{Model, ms},
    link::LinkProfile,
    units::{Hertz, Volts},
};

/// Siglent SDG1000X.
pub(super) const SDG1000X: Sdg = Sdg;

/// The least sine: 2 mV peak to peak.
const MIN_AMPLITUDE: Volts = Volts(1.0e-3);
/// Its frequency while nothing is driven.
const QUIET_FREQ: Hertz = Hertz(1000.0);

pub(super) struct Sdg;

impl Model for Sdg {
    fn key(&self) -> &'static str {
        "siglent-sdg1000x"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile { min_gap: ms(10), error_query: None, ..LinkProfile::scpi() }
    }

    fn recognises(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("Siglent") && identity.model.starts_with("SDG")
    }
}

impl Dialect for Sdg {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            freq_range: (Hertz(1.0e-6), Hertz(30.0e6)),
            min_amplitude: MIN_AMPLITUDE,
            max_peak: Volts(10.0),
            freq_step: Hertz(1.0e-6),
        }
    }

    fn output(&self, channel: u8, on: bool) -> Vec<Exchange> {
        let read_back = format!("C{channel}:OUTP?");
        if on {
            return vec![Exchange::Set {
                message: format!("C{channel}:OUTP ON"),
                read_back,
                expect: Expect::Contains("OUTP ON".to_owned()),
            }];
        }
        vec![
            Exchange::Set {
                message: format!("C{channel}:OUTP OFF"),
                read_back: read_back.clone(),
                expect: Expect::Contains("OUTP OFF".to_owned()),
            },
            // With 50 Ω set, an open analog input would see twice the volts that were asked for.
            Exchange::Set { message: format!("C{channel}:OUTP LOAD,HZ"), read_back, expect: Expect::Contains("LOAD,HZ".to_owned()) },
        ]
    }

    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange> {
        let (freq_hz, peak_to_peak_v, offset_v) = (sine.freq.value(), 2.0 * sine.amplitude.value(), sine.offset.value());
        vec![Exchange::Set {
            message: format!("C{channel}:BSWV WVTP,SINE,FRQ,{freq_hz:.6},AMP,{peak_to_peak_v:.4},OFST,{offset_v:.4},PHSE,0"),
            read_back: format!("C{channel}:BSWV?"),
            expect: Expect::All(vec![
                Expect::FieldWord("WVTP", "SINE"),
                Expect::Fields(vec![
                    ("FRQ", freq_hz, 1.0e-6 * freq_hz + 1.0e-6),
                    ("AMP", peak_to_peak_v, 1.0e-3 * peak_to_peak_v + 1.0e-3),
                    ("OFST", offset_v, 1.0e-3),
                ]),
            ]),
        }]
    }

    fn quiet(&self, channel: u8, offset: Volts) -> Vec<Exchange> {
        let mut script = self.sine(channel, &Sine { freq: QUIET_FREQ, amplitude: MIN_AMPLITUDE, offset });
        let mut off = |message: String, read_back: String, text: &str| {
            script.push(Exchange::Set { message, read_back, expect: Expect::Contains(text.to_owned()) });
        };
        off(format!("C{channel}:OUTP PLRT,NOR"), format!("C{channel}:OUTP?"), "PLRT,NOR");
        for modifier in ["BTWV", "SWWV", "MDWV"] {
            off(format!("C{channel}:{modifier} STATE,OFF"), format!("C{channel}:{modifier}?"), "STATE,OFF");
        }
        script
    }
}
