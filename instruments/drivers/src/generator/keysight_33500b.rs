//! Keysight (Agilent) 33500B: a command tree for each channel, an error queue that reports adjusted
//! settings, and an output load setting that scales every voltage.

use instruments_domain::units::{Hertz, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, DELAY_TOLERANCE_S, Dialect, PHASE_TOLERANCE_DEG, QUIET_VPP, Sine, Wave};
use crate::{
    exchange::{CHOSEN, Exchange, Expect, Identity, ON_OFF, Says, Setting, Shows},
    instrument::{Model, ms},
};

/// Keysight 33500B.
pub(super) const B33500: Keysight = Keysight;

/// The least sine into an open circuit: 2 mV peak to peak.
const MIN_AMPLITUDE: Volts = Volts(1.0e-3);
/// Its frequency while nothing is driven.
const QUIET_FREQ: Hertz = Hertz(1000.0);
/// Relative rounding of a frequency that is read back.
const FREQ_DIGITS: f64 = 1.0e-6;
/// Amplitudes have four digits; wider, and the least amplitude would pass for half of it.
const AMPLITUDE_STEP_V: f64 = 2.5e-4;
/// Most points of a wave that are sent: a million fit into the memory, but as text they take seven
/// bytes each.
const WAVE_POINTS: usize = 65_536;
/// Fewest points of a wave.
const WAVE_FEWEST: usize = 8;
const WAVE_FULL_SCALE: f64 = 32_767.0;
/// Most periods of a burst: the user's guide has 1 to 100 000 000.
const BURST_PERIODS: u32 = 100_000_000;
/// A millivolt, 2 mA of a supply of ±20 A.
const OFFSET_TOLERANCE_V: f64 = 1.0e-3;

pub(super) struct Keysight;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch("OUTP#?", "output", ON_OFF),
    Setting::state(
        "OUTP#:LOAD?",
        "assumed load",
        Says::States(&[(Shows::Text("E+37"), "an open circuit")]),
    ),
    Setting::state(
        "OUTP#:POL?",
        "polarity",
        Says::States(&[
            (Shows::Word("NORM"), "normal"),
            (Shows::Word("NORMAL"), "normal"),
            (Shows::Word("INV"), "inverted"),
            (Shows::Word("INVERTED"), "inverted"),
        ]),
    ),
    Setting::state(
        "SOUR#:VOLT:UNIT?",
        "unit of the amplitude",
        Says::States(&[
            (Shows::Word("VPP"), "volts peak to peak"),
            (Shows::Word("VRMS"), "effective volts"),
            (Shows::Word("DBM"), "dBm"),
        ]),
    ),
    Setting::state(
        "SOUR#:FUNC?",
        "waveform",
        Says::States(&[
            (Shows::Word("SIN"), "a sine"),
            (Shows::Word("SINUSOID"), "a sine"),
            (Shows::Word("ARB"), "a loaded one"),
            (Shows::Word("DC"), "a constant voltage"),
            (Shows::Word("SQU"), "a square"),
            (Shows::Word("RAMP"), "a ramp"),
            (Shows::Word("PULS"), "pulses"),
            (Shows::Word("NOIS"), "noise"),
        ]),
    ),
    Setting::number("SOUR#:FREQ?", "frequency", "Hz"),
    Setting::number("SOUR#:VOLT?", "amplitude", "Vpp"),
    Setting::number("SOUR#:VOLT:OFFS?", "offset", "V"),
    Setting::number("SOUR#:FUNC:ARB:SRAT?", "rate of the loaded wave", "Sa/s"),
    Setting::state("SOUR#:FUNC:ARB?", "loaded wave", CHOSEN),
    Setting::state(
        "SOUR#:FUNC:ARB:FILT?",
        "filter of the loaded wave",
        Says::States(&[
            (Shows::Word("OFF"), "off"),
            (Shows::Word("NORM"), "normal"),
            (Shows::Word("STEP"), "that for steps"),
        ]),
    ),
    Setting::state("SOUR#:BURS:STAT?", "burst", ON_OFF),
    Setting::state(
        "SOUR#:BURS:MODE?",
        "end of a burst",
        Says::States(&[
            (Shows::Word("TRIG"), "counted"),
            (Shows::Word("TRIGGERED"), "counted"),
            (Shows::Word("GAT"), "that of a gate"),
        ]),
    ),
    Setting::state(
        "TRIG#:SOUR?",
        "trigger of a burst",
        Says::States(&[
            (Shows::Word("BUS"), "a command"),
            (Shows::Word("IMM"), "its own clock"),
            (Shows::Word("EXT"), "an external signal"),
            (Shows::Word("TIM"), "a timer"),
        ]),
    ),
    Setting::number("SOUR#:BURS:NCYC?", "number of periods of a burst", ""),
    Setting::number("SOUR#:BURS:PHAS?", "phase at which a burst begins", "°"),
    Setting::number("TRIG#:DEL?", "delay of a burst", "s"),
];

impl Model for Keysight {
    fn key(&self) -> &'static str {
        "keysight-33500b"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(2),
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        let maker = &identity.maker;
        // 33509B to 33522B, and the 33600A with the same tree.
        let model = identity.model.starts_with("335") || identity.model.starts_with("336");
        (maker.starts_with("KEYSIGHT") || maker.starts_with("AGILENT"))
            && model
            && identity.model.len() >= 6
    }
}

fn number(message: String, header: &str, value: f64, tolerance: f64) -> Exchange {
    if value.is_finite() {
        return Exchange::number(message, format!("{header}?"), value, tolerance);
    }
    Exchange::Refuse {
        message: header.to_owned(),
        reason: format!("expected a finite number to send, found {value}"),
    }
}

impl Dialect for Keysight {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            freq_range: (Hertz(1.0e-6), Hertz(20.0e6)),
            min_amplitude: MIN_AMPLITUDE,
            max_peak: Volts(10.0),
            freq_step: Hertz(1.0e-6),
        }
    }

    fn output(&self, channel: u8, on: bool) -> Vec<Exchange> {
        let switch = Exchange::switch(&format!("OUTP{channel}"), on);
        // With 50 Ω set, an open analog input would see twice the requested volts; inverted, it
        // would charge instead of discharge.
        let load = Exchange::Set {
            message: format!("OUTP{channel}:LOAD INF"),
            read_back: format!("OUTP{channel}:LOAD?"),
            // An open circuit is answered as 9.9E+37 Ω.
            expect: Expect::Contains("E+37".to_owned()),
        };
        let polarity = Exchange::word(
            format!("OUTP{channel}:POL NORM"),
            format!("OUTP{channel}:POL?"),
            &["NORM", "NORMAL"],
        );
        if on {
            vec![load, polarity, switch]
        } else {
            vec![switch, load]
        }
    }

    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange> {
        let source = format!("SOUR{channel}");
        let (freq_hz, peak_to_peak_v, offset_v) = (
            sine.freq.value(),
            2.0 * sine.amplitude.value(),
            sine.offset.value(),
        );
        vec![
            Exchange::word(
                format!("{source}:VOLT:UNIT VPP"),
                format!("{source}:VOLT:UNIT?"),
                &["VPP"],
            ),
            Exchange::word(
                format!("{source}:FUNC SIN"),
                format!("{source}:FUNC?"),
                &["SIN", "SINUSOID"],
            ),
            number(
                format!("{source}:FREQ {freq_hz:.6}"),
                &format!("{source}:FREQ"),
                freq_hz,
                FREQ_DIGITS * freq_hz + 1.0e-6,
            ),
            number(
                format!("{source}:VOLT {peak_to_peak_v:.4}"),
                &format!("{source}:VOLT"),
                peak_to_peak_v,
                1.0e-3 * peak_to_peak_v.abs() + AMPLITUDE_STEP_V,
            ),
            number(
                format!("{source}:VOLT:OFFS {offset_v:.4}"),
                &format!("{source}:VOLT:OFFS"),
                offset_v,
                OFFSET_TOLERANCE_V,
            ),
        ]
    }

    fn wave_steps(&self) -> Option<usize> {
        Some(WAVE_POINTS)
    }

    /// Sends converter values as text, so that no byte of them can end the message. Assumed: ± full
    /// scale of the converter is ± half the amplitude, and a selected wave begins with its first
    /// point.
    fn wave(&self, channel: u8, wave: &Wave) -> Vec<Exchange> {
        let source = format!("SOUR{channel}");
        let (count, name) = (wave.steps.len(), &wave.name);
        if !(WAVE_FEWEST..=WAVE_POINTS).contains(&count)
            || wave.steps.iter().any(|step| !step.is_finite())
        {
            let reason =
                format!("expected {WAVE_FEWEST} to {WAVE_POINTS} finite steps, found {count}");
            return vec![Exchange::Refuse {
                message: format!("{source}:DATA:ARB:DAC"),
                reason,
            }];
        }
        let (rate_hz, peak_to_peak_v, offset_v) = (
            wave.freq.value() * count as f64,
            2.0 * wave.amplitude.value(),
            wave.offset.value(),
        );
        let mut data = format!("{source}:DATA:ARB:DAC {name}");
        for step in &wave.steps {
            data.push_str(&format!(
                ",{}",
                (step.clamp(-1.0, 1.0) * WAVE_FULL_SCALE).round() as i16
            ));
        }
        let tolerance_v = 1.0e-3 * peak_to_peak_v.abs() + AMPLITUDE_STEP_V;
        let [unit, least] = still(&source);
        vec![
            // The wave that is output at present may be cleared; this leaves a sine of its
            // amplitude.
            unit,
            least,
            // A name that is there already is refused.
            Exchange::send(format!("{source}:DATA:VOL:CLE")),
            Exchange::send(data),
            Exchange::Set {
                message: format!("{source}:FUNC:ARB {name}"),
                read_back: format!("{source}:FUNC:ARB?"),
                expect: Expect::Contains(name.clone()),
            },
            // A step is held until the next, not smoothed.
            Exchange::word(
                format!("{source}:FUNC:ARB:FILT OFF"),
                format!("{source}:FUNC:ARB:FILT?"),
                &["OFF"],
            ),
            number(
                format!("{source}:FUNC:ARB:SRAT {rate_hz:.6}"),
                &format!("{source}:FUNC:ARB:SRAT"),
                rate_hz,
                FREQ_DIGITS * rate_hz + 1.0e-6,
            ),
            number(
                format!("{source}:VOLT:OFFS {offset_v:.4}"),
                &format!("{source}:VOLT:OFFS"),
                offset_v,
                OFFSET_TOLERANCE_V,
            ),
            // The function before the amplitude, because otherwise a sine would get this amplitude.
            Exchange::word(
                format!("{source}:FUNC ARB"),
                format!("{source}:FUNC?"),
                &["ARB"],
            ),
            number(
                format!("{source}:VOLT {peak_to_peak_v:.4}"),
                &format!("{source}:VOLT"),
                peak_to_peak_v,
                tolerance_v,
            ),
        ]
    }

    fn most_periods(&self) -> Option<u32> {
        Some(BURST_PERIODS)
    }

    /// Assumed: switching bursts off ends a burst that is still running, and the signal begins at
    /// phase zero with its trigger.
    fn burst(&self, channel: u8, periods: Option<u32>) -> Vec<Exchange> {
        let source = format!("SOUR{channel}:BURS");
        let state = |on| Exchange::switch(&format!("{source}:STAT"), on);
        let Some(periods) = periods else {
            return vec![state(false)];
        };
        vec![
            Exchange::word(
                format!("{source}:MODE TRIG"),
                format!("{source}:MODE?"),
                &["TRIG", "TRIGGERED"],
            ),
            Exchange::word(
                format!("TRIG{channel}:SOUR BUS"),
                format!("TRIG{channel}:SOUR?"),
                &["BUS"],
            ),
            number(
                format!("{source}:NCYC {periods}"),
                &format!("{source}:NCYC"),
                f64::from(periods),
                0.5,
            ),
            // A burst that begins elsewhere leaves another level behind it than the offset.
            number(
                format!("{source}:PHAS 0"),
                &format!("{source}:PHAS"),
                0.0,
                PHASE_TOLERANCE_DEG,
            ),
            number(
                format!("TRIG{channel}:DEL 0"),
                &format!("TRIG{channel}:DEL"),
                0.0,
                DELAY_TOLERANCE_S,
            ),
            Exchange::send(format!("{source}:STAT OFF")),
            state(true),
            Exchange::send(format!("TRIG{channel}")),
        ]
    }

    fn direct(&self, channel: u8, offset: Volts) -> Vec<Exchange> {
        let source = format!("SOUR{channel}");
        // The amplitude before the function, because otherwise a sine would get that of the
        // previous wave.
        let mut script = still(&source).to_vec();
        let sine = self.sine(
            channel,
            &Sine {
                freq: QUIET_FREQ,
                amplitude: MIN_AMPLITUDE,
                offset,
            },
        );
        let amplitude = format!("{source}:VOLT?");
        // Its amplitude is as small as it gets already.
        let sets_amplitude = |exchange: &Exchange| -> bool {
            matches!(exchange, Exchange::Set { read_back, .. } if *read_back == amplitude)
        };
        script.extend(
            sine.into_iter()
                .filter(|exchange| !sets_amplitude(exchange)),
        );
        script
    }

    fn quiet(&self, channel: u8, offset: Volts) -> Vec<Exchange> {
        let mut script = self.direct(channel, offset);
        let modifiers = ["BURS", "SWE", "AM", "FM"];
        script
            .extend(modifiers.map(|modifier| {
                Exchange::switch(&format!("SOUR{channel}:{modifier}:STAT"), false)
            }));
        script
    }
}

/// Sets the smallest amplitude, regardless of the waveform.
fn still(source: &str) -> [Exchange; 2] {
    let least_v = 2.0 * MIN_AMPLITUDE.value();
    [
        Exchange::word(
            format!("{source}:VOLT:UNIT VPP"),
            format!("{source}:VOLT:UNIT?"),
            &["VPP"],
        ),
        Exchange::Set {
            message: format!("{source}:VOLT {least_v:.4}"),
            read_back: format!("{source}:VOLT?"),
            expect: Expect::Number {
                value: 0.5 * QUIET_VPP,
                tolerance: 0.5 * QUIET_VPP,
            },
        },
    ]
}
