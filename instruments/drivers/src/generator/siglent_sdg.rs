//! Siglent SDG1000X (and 2000X/6000X): one keyword-list command per channel, read back whole,
//! silently clamped when out of range; no error queue to rely on (programming guide PG02-E05B).

use instruments_domain::units::{Hertz, Volts};
use instruments_link::link::{ENDS_MESSAGES, LinkProfile};

use super::{Capabilities, DELAY_TOLERANCE_S, Dialect, PHASE_TOLERANCE_DEG, QUIET_VPP, Sine, Wave};
use crate::{
    exchange::{CHOSEN, Exchange, Expect, Identity, Says, Setting, Shows},
    instrument::{Model, ms},
};

/// Siglent SDG1000X.
pub(super) const SDG1000X: Sdg = Sdg;

/// The least sine: 2 mV peak to peak.
const MIN_AMPLITUDE: Volts = Volts(1.0e-3);
/// Its frequency while nothing is driven.
const QUIET_FREQ: Hertz = Hertz(1000.0);

/// Relative rounding of a frequency that is read back.
const FREQ_DIGITS: f64 = 1.0e-6;
/// An amplitude is read back to four digits or 0.1 mV; wider, and the least amplitude would pass
/// for half of it.
const AMPLITUDE_STEP_V: f64 = 2.5e-4;
/// A millivolt, 2 mA of a supply of ±20 A.
const OFFSET_TOLERANCE_V: f64 = 1.0e-3;

/// Points of a wave's table.
const WAVE_POINTS: usize = 16_384;
const WAVE_FULL_SCALE: f64 = 32_767.0;
/// Most periods of a burst: the programming guide has 1 to 1 000 000.
const BURST_PERIODS: u32 = 1_000_000;

pub(super) struct Sdg;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(
        "C#:OUTP?",
        "output",
        Says::States(&[
            (Shows::Text("OUTP ON"), "on"),
            (Shows::Text("OUTP OFF"), "off"),
        ]),
    ),
    Setting::state(
        "C#:OUTP?",
        "assumed load",
        Says::States(&[
            (Shows::Text("LOAD,HZ"), "an open circuit"),
            (Shows::Text("LOAD,50"), "50 Ω"),
        ]),
    ),
    Setting::state(
        "C#:OUTP?",
        "polarity",
        Says::States(&[
            (Shows::Text("PLRT,NOR"), "normal"),
            (Shows::Text("PLRT,INVT"), "inverted"),
        ]),
    ),
    Setting::state(
        "C#:BSWV?",
        "waveform",
        Says::States(&[
            (Shows::Field("WVTP", "SINE"), "a sine"),
            (Shows::Field("WVTP", "ARB"), "a loaded one"),
            (Shows::Field("WVTP", "DC"), "a constant voltage"),
            (Shows::Field("WVTP", "SQUARE"), "a square"),
            (Shows::Field("WVTP", "RAMP"), "a ramp"),
            (Shows::Field("WVTP", "PULSE"), "pulses"),
            (Shows::Field("WVTP", "NOISE"), "noise"),
        ]),
    ),
    Setting::state(
        "C#:BTWV?",
        "burst",
        Says::States(&[
            (Shows::Text("STATE,ON"), "on"),
            (Shows::Text("STATE,OFF"), "off"),
        ]),
    )
    .optional("whether a burst of an earlier client is on; no burst is used, and"),
    Setting::state(
        "C#:BTWV?",
        "end of a burst",
        Says::States(&[
            (Shows::Field("GATE_NCYC", "NCYC"), "counted"),
            (Shows::Field("GATE_NCYC", "GATE"), "that of a gate"),
        ]),
    ),
    Setting::state(
        "C#:BTWV?",
        "trigger of a burst",
        Says::States(&[
            (Shows::Field("TRSR", "MAN"), "a command"),
            (Shows::Field("TRSR", "INT"), "its own clock"),
            (Shows::Field("TRSR", "EXT"), "an external signal"),
        ]),
    ),
    Setting::state("C#:ARWV?", "loaded wave", CHOSEN),
];

impl Model for Sdg {
    fn key(&self) -> &'static str {
        "siglent-sdg1000x"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(10),
            error_query: None,
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("SIGLENT")
            && identity.model.starts_with("SDG")
            && identity.model.contains('X')
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
        let outp = |arguments: &str, expect| set(channel, "OUTP", arguments, expect);
        if on {
            // With 50 Ω set, an open analog input would see twice the requested volts; inverted, it
            // would charge instead of discharge.
            let true_volts = || vec![contains("LOAD,HZ"), contains("PLRT,NOR")];
            let on = [vec![contains("OUTP ON")], true_volts()].concat();
            return vec![
                outp("PLRT,NOR", Expect::All(true_volts())),
                outp("ON", Expect::All(on)),
            ];
        }
        vec![
            outp("OFF", contains("OUTP OFF")),
            outp("LOAD,HZ", contains("LOAD,HZ")),
        ]
    }

    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange> {
        let peak_to_peak_v = 2.0 * sine.amplitude.value();
        vec![basic_wave(
            channel,
            sine,
            Amplitude {
                vpp: peak_to_peak_v,
                tolerance_v: 1.0e-3 * peak_to_peak_v + AMPLITUDE_STEP_V,
            },
        )]
    }

    fn wave_steps(&self) -> Option<usize> {
        Some(WAVE_POINTS)
    }

    fn wave(&self, channel: u8, wave: &Wave) -> Vec<Exchange> {
        let (freq_hz, peak_to_peak_v, offset_v) = (
            wave.freq.value(),
            2.0 * wave.amplitude.value(),
            wave.offset.value(),
        );
        let name = &wave.name;
        if wave.steps.is_empty() || !WAVE_POINTS.is_multiple_of(wave.steps.len()) {
            let reason = format!(
                "expected a divisor of {WAVE_POINTS} as the number of steps, found {}",
                wave.steps.len()
            );
            return vec![Exchange::Refuse {
                message: format!("C{channel}:WVDT"),
                reason,
            }];
        }
        let fields = vec![
            ("FRQ", freq_hz, FREQ_DIGITS * freq_hz + 1.0e-6),
            (
                "AMP",
                peak_to_peak_v,
                1.0e-3 * peak_to_peak_v + AMPLITUDE_STEP_V,
            ),
            ("OFST", offset_v, OFFSET_TOLERANCE_V),
        ];
        vec![
            Exchange::Data {
                head: format!(
                    "C{channel}:WVDT \
                    WVNM,{name},FREQ,{freq_hz:.6},AMPL,{peak_to_peak_v:.4},OFST,{offset_v:.4},PHASE,0,WAVEDATA,"
                ),
                data: wave_data(&wave.steps),
            },
            // The shape itself cannot be read back: some models hang on the question.
            set(
                channel,
                "ARWV",
                &format!("NAME,{name}"),
                Expect::Contains(format!("NAME,{name}")),
            ),
            Exchange::Set {
                message: format!(
                    "C{channel}:BSWV \
                    WVTP,ARB,FRQ,{freq_hz:.6},AMP,{peak_to_peak_v:.4},OFST,{offset_v:.4},PHSE,0"
                ),
                read_back: format!("C{channel}:BSWV?"),
                expect: Expect::All(vec![
                    Expect::FieldWord("WVTP", "ARB"),
                    Expect::Fields(fields),
                ]),
            },
        ]
    }

    fn most_periods(&self) -> Option<u32> {
        Some(BURST_PERIODS)
    }

    /// Assumed: switching bursts off ends a burst that is still running, and the signal begins at
    /// its phase with the trigger.
    fn burst(&self, channel: u8, periods: Option<u32>) -> Vec<Exchange> {
        let state = |arguments: &str, expect| set(channel, "BTWV", arguments, expect);
        let Some(periods) = periods else {
            return vec![state("STATE,OFF", contains("STATE,OFF"))];
        };
        let armed = Expect::All(vec![
            contains("STATE,ON"),
            Expect::FieldWord("GATE_NCYC", "NCYC"),
            Expect::FieldWord("TRSR", "MAN"),
            // A burst that begins elsewhere leaves another level behind it than the offset.
            Expect::Fields(vec![
                ("TIME", f64::from(periods), 0.5),
                ("STPS", 0.0, PHASE_TOLERANCE_DEG),
                ("DLAY", 0.0, DELAY_TOLERANCE_S),
            ]),
        ]);
        vec![
            Exchange::send(format!("C{channel}:BTWV STATE,OFF")),
            state(
                &format!("STATE,ON,GATE_NCYC,NCYC,TRSR,MAN,STPS,0,DLAY,0,TIME,{periods}"),
                armed,
            ),
            Exchange::send(format!("C{channel}:BTWV MTRIG")),
        ]
    }

    fn direct(&self, channel: u8, offset: Volts) -> Vec<Exchange> {
        let least = Sine {
            freq: QUIET_FREQ,
            amplitude: MIN_AMPLITUDE,
            offset,
        };
        vec![basic_wave(
            channel,
            &least,
            Amplitude {
                vpp: 0.5 * QUIET_VPP,
                tolerance_v: 0.5 * QUIET_VPP,
            },
        )]
    }

    fn quiet(&self, channel: u8, offset: Volts) -> Vec<Exchange> {
        let mut script = self.direct(channel, offset);
        script.push(set(channel, "OUTP", "PLRT,NOR", contains("PLRT,NOR")));
        script.extend(
            ["BTWV", "SWWV", "MDWV"]
                .map(|modifier| set(channel, modifier, "STATE,OFF", contains("STATE,OFF"))),
        );
        script
    }
}

/// How the amplitude of a sine is read back.
#[derive(Clone, Copy)]
struct Amplitude {
    /// Peak to peak, V.
    vpp: f64,
    /// Tolerance, V.
    tolerance_v: f64,
}

/// Returns the command for a sine whose amplitude is read back as specified.
fn basic_wave(channel: u8, sine: &Sine, read_back: Amplitude) -> Exchange {
    let (freq_hz, peak_to_peak_v, offset_v) = (
        sine.freq.value(),
        2.0 * sine.amplitude.value(),
        sine.offset.value(),
    );
    let fields = vec![
        ("FRQ", freq_hz, FREQ_DIGITS * freq_hz + 1.0e-6),
        ("AMP", read_back.vpp, read_back.tolerance_v),
        ("OFST", offset_v, OFFSET_TOLERANCE_V),
    ];
    // A value that is not a number is refused and not sent.
    let number = if peak_to_peak_v.is_finite() {
        Expect::All(Vec::new())
    } else {
        Expect::Fields(vec![("AMP", peak_to_peak_v, 0.0)])
    };
    Exchange::Set {
        message: format!(
            "C{channel}:BSWV \
            WVTP,SINE,FRQ,{freq_hz:.6},AMP,{peak_to_peak_v:.4},OFST,{offset_v:.4},PHSE,0"
        ),
        read_back: format!("C{channel}:BSWV?"),
        expect: Expect::All(vec![
            Expect::FieldWord("WVTP", "SINE"),
            Expect::Fields(fields),
            number,
        ]),
    }
}

/// Returns the whole table: each step held for its share of it, little-endian, full scale ±32767. A
/// byte that would end the message is avoided by the nearest number without one, which is at most
/// 128 steps of the converter off.
fn wave_data(steps: &[f64]) -> Vec<u8> {
    let hold = WAVE_POINTS / steps.len();
    let free = |value: i16| {
        !value
            .to_le_bytes()
            .iter()
            .any(|byte| ENDS_MESSAGES.contains(byte))
    };
    let sendable = |value: i16| {
        (0..=i16::MAX).find_map(|off| {
            [value.checked_sub(off), value.checked_add(off)]
                .into_iter()
                .flatten()
                .find(|near| free(*near))
        })
    };
    let point = |step: &f64| {
        sendable((step.clamp(-1.0, 1.0) * WAVE_FULL_SCALE).round() as i16)
            .unwrap_or(0)
            .to_le_bytes()
    };
    steps
        .iter()
        .flat_map(|step| std::iter::repeat_n(point(step), hold))
        .flatten()
        .collect()
}

/// Returns a command of the channel, read back by its own bare query.
fn set(channel: u8, header: &str, arguments: &str, expect: Expect) -> Exchange {
    Exchange::Set {
        message: format!("C{channel}:{header} {arguments}"),
        read_back: format!("C{channel}:{header}?"),
        expect,
    }
}

fn contains(text: &str) -> Expect {
    Expect::Contains(text.to_owned())
}
