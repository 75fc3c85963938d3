//! Rigol DHO800 (and 900, 1000, 4000): the preamble is a line of text, codes are unsigned and not
//! left-justified, and points are counted from one. Every point must be fetched; the driver
//! discards the unwanted ones.
//!
//! It accepts only bare numbers, without units. Every setting is read back. Its guide of April 2025
//! has an error queue (3.24.3, page 268); older firmware may lack it, so that it is read once per
//! acquisition, for the messages that no query reads back, and may be missing.

use instruments_domain::units::{Seconds, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Dialect, Intent, Preamble, Queries};
use crate::{
    exchange::{Exchange, Expect, Identity, ON_OFF, Setting},
    instrument::{Model, ms},
};

/// Rigol DHO800.
pub(super) const DHO800: Dho = Dho;

/// Codes per division of a 16-bit sample.
const CODES_PER_DIV: f64 = 7500.0;
/// Zero of the signed codes that are kept, in the unsigned ones that come.
const CENTRE: u16 = 1 << 15;
/// From one step of the 12-bit converter to the next: its calibrated values are spread over 16
/// bits, about 433 of them to a division.
const CODE_STEP: u16 = 17;
/// Greatest memory depth that every member has with four channels on: DHO802 and DHO804 refuse 10 M.
const MOST_POINTS: u64 = 1_000_000;
/// Points in one page.
const PAGE: u64 = 250_000;
/// Greatest |offset| by scale at the 1× probe. Data sheet of the DHO1000 family, taken for this
/// one: check it on the first real unit; a wrong entry shows as a read-back error, never as a wrong
/// voltage.
const OFFSET_LIMITS: &[(Volts, Volts)] = &[
    (Volts(65.0e-3), Volts(1.0)),
    (Volts(260.0e-3), Volts(8.0)),
    (Volts(2.65), Volts(20.0)),
    (Volts(10.0), Volts(100.0)),
];

pub(super) struct Dho;

/// A setting that some firmware does not know.
const SETTINGS: &[Setting] = &[
    Setting::state(":CHAN#:INV?", "inversion of a channel", ON_OFF)
        .optional("whether a channel is inverted at the panel, which the controls show,"),
];

impl Model for Dho {
    fn key(&self) -> &'static str {
        "rigol-dho800"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(10),
            error_query: Some(":SYSTem:ERRor?"),
            errors_on_demand: true,
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("RIGOL") && identity.model.starts_with("DHO")
    }
}

impl Dialect for Dho {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            per_div: (Volts(0.5e-3), Volts(10.0)),
            offset_limits: OFFSET_LIMITS,
            half_range_div: f64::from(CENTRE) / CODES_PER_DIV,
            horizontal_div: 10.0,
            max_time_per_div: Seconds(500.0),
            thins_out: false,
            most_points: MOST_POINTS,
        }
    }

    fn script(&self, intent: &Intent) -> Vec<Exchange> {
        match intent {
            Intent::Session { memory_points } => {
                if *memory_points > MOST_POINTS {
                    let reason = format!(
                        "expected at most {MOST_POINTS} points, the depth of a DHO802 or DHO804 with \
                        four channels, found {memory_points}"
                    );
                    let message = ":ACQ:MDEP".to_owned();
                    return vec![Exchange::Refuse { message, reason }];
                }
                let (word, points) = depth(*memory_points);
                vec![
                    Exchange::word(":ACQ:TYPE NORM", ":ACQ:TYPE?", &["NORM"]),
                    Exchange::number(format!(":ACQ:MDEP {word}"), ":ACQ:MDEP?", points, 0.5),
                ]
            }
            Intent::Vertical(vertical) => {
                let (n, scale, offset) = (
                    vertical.channel,
                    vertical.per_div.value(),
                    vertical.offset.value(),
                );
                vec![
                    Exchange::switch(&format!(":CHAN{n}:DISP"), true),
                    Exchange::word(
                        format!(":CHAN{n}:COUP DC"),
                        format!(":CHAN{n}:COUP?"),
                        &["DC"],
                    ),
                    Exchange::word(
                        format!(":CHAN{n}:BWL 20M"),
                        format!(":CHAN{n}:BWL?"),
                        &["20M"],
                    ),
                    Exchange::switch(&format!(":CHAN{n}:INV"), false),
                    // Without the vernier the scale snaps to 1, 2, 5.
                    Exchange::switch(&format!(":CHAN{n}:VERN"), true),
                    Exchange::number(
                        format!(":CHAN{n}:PROB 1"),
                        format!(":CHAN{n}:PROB?"),
                        1.0,
                        1.0e-6,
                    ),
                    Exchange::number(
                        format!(":CHAN{n}:SCAL {scale:.5E}"),
                        format!(":CHAN{n}:SCAL?"),
                        scale,
                        0.02 * scale,
                    ),
                    // The limit of the offset depends on the scale, so the scale comes first.
                    Exchange::number(
                        format!(":CHAN{n}:OFFS {offset:.5E}"),
                        format!(":CHAN{n}:OFFS?"),
                        offset,
                        0.25 * scale,
                    ),
                ]
            }
            Intent::Timebase(per_div) => {
                let per_div = per_div.value();
                vec![
                    Exchange::word(":TIM:MODE MAIN", ":TIM:MODE?", &["MAIN"]),
                    Exchange::number(
                        format!(":TIM:MAIN:SCAL {per_div:.2E}"),
                        ":TIM:MAIN:SCAL?",
                        per_div,
                        1.0e-3 * per_div,
                    ),
                    Exchange::number(":TIM:MAIN:OFFS 0", ":TIM:MAIN:OFFS?", 0.0, 1.0e-3 * per_div),
                ]
            }
            Intent::Trigger(trigger) => {
                let source = format!("CHAN{}", trigger.channel);
                vec![
                    Exchange::word(":TRIG:MODE EDGE", ":TRIG:MODE?", &["EDGE"]),
                    Exchange::Set {
                        message: format!(":TRIG:EDGE:SOUR {source}"),
                        read_back: ":TRIG:EDGE:SOUR?".to_owned(),
                        expect: Expect::Contains(source),
                    },
                    Exchange::word(":TRIG:EDGE:SLOP POS", ":TRIG:EDGE:SLOP?", &["POS"]),
                    Exchange::send(format!(":TRIG:EDGE:LEV {:.5E}", trigger.level.value())),
                ]
            }
            Intent::Arm => vec![
                Exchange::word(":TRIG:SWE NORM", ":TRIG:SWE?", &["NORM"]),
                Exchange::send(":RUN"),
            ],
            Intent::Roll => vec![
                Exchange::word(":TRIG:SWE AUTO", ":TRIG:SWE?", &["AUTO"]),
                Exchange::send(":RUN"),
            ],
            Intent::Stop => vec![Exchange::send(":STOP")],
            Intent::Transfer { channel, .. } => {
                let source = format!("CHAN{channel}");
                vec![
                    Exchange::Set {
                        message: format!(":WAV:SOUR {source}"),
                        read_back: ":WAV:SOUR?".to_owned(),
                        expect: Expect::Contains(source),
                    },
                    // Switches to the screen's format and back; otherwise the number of points of
                    // an earlier memory depth remains.
                    Exchange::word(":WAV:MODE NORM", ":WAV:MODE?", &["NORM"]),
                    Exchange::word(":WAV:MODE RAW", ":WAV:MODE?", &["RAW"]),
                    Exchange::word(":WAV:FORM WORD", ":WAV:FORM?", &["WORD"]),
                ]
            }
            Intent::Page { start, total } => {
                let end = (start + PAGE).min(*total);
                vec![
                    Exchange::number(
                        format!(":WAV:STAR {}", start + 1),
                        ":WAV:STAR?",
                        (start + 1) as f64,
                        0.5,
                    ),
                    Exchange::number(format!(":WAV:STOP {end}"), ":WAV:STOP?", end as f64, 0.5),
                ]
            }
        }
    }

    fn beside(&self, channel: u8, _: u64) -> Vec<Exchange> {
        let source = format!("CHAN{channel}");
        vec![Exchange::Set {
            message: format!(":WAV:SOUR {source}"),
            read_back: ":WAV:SOUR?".to_owned(),
            expect: Expect::Contains(source),
        }]
    }

    fn queries(&self) -> Queries {
        Queries {
            status: ":TRIG:STAT?",
            stopped: "STOP",
            points: ":ACQ:MDEP?",
            preamble: ":WAV:PRE?",
            data: ":WAV:DATA?",
        }
    }

    fn preamble_is_text(&self) -> bool {
        true
    }

    fn preamble(&self, text: &[u8]) -> Result<Preamble, String> {
        let fields: Option<Vec<f64>> = std::str::from_utf8(text).ok().and_then(|text| {
            text.trim()
                .split(',')
                .map(|field| field.trim().parse().ok())
                .collect()
        });
        let Some(
            [
                format,
                kind,
                _,
                _,
                interval_s,
                origin_s,
                _,
                volts_per_code,
                origin,
                reference,
            ],
        ) = fields.and_then(|fields| <[f64; 10]>::try_from(fields).ok())
        else {
            return Err("ten numbers".to_owned());
        };
        if format != 1.0 || kind != 2.0 {
            return Err("16-bit samples of the memory (1,2,…)".to_owned());
        }
        if ![interval_s, volts_per_code]
            .iter()
            .all(|scale| *scale > 0.0 && scale.is_finite())
        {
            return Err(
                "scales above zero: no frame was completed since the scope was armed".to_owned(),
            );
        }
        Ok(Preamble {
            // Its third field counts one page; the record is as long as the memory.
            points: 0,
            volts_per_code,
            offset_v: (origin + reference - f64::from(CENTRE)) * volts_per_code,
            volts_per_div: volts_per_code * CODES_PER_DIV,
            interval_s,
            // Delay of the first point; the role, which has the number of points, converts it to
            // that of the centre.
            delay_s: origin_s,
            code_min: i16::MIN,
            code_max: i16::MAX,
            code_step: CODE_STEP,
        })
    }

    fn codes(&self, block: &[u8]) -> Result<Vec<i16>, String> {
        let (pairs, rest) = block.as_chunks::<2>();
        if rest.is_empty() {
            Ok(pairs
                .iter()
                .map(|pair| u16::from_le_bytes(*pair).wrapping_sub(CENTRE).cast_signed())
                .collect())
        } else {
            Err("two bytes a sample".to_owned())
        }
    }
}

/// Returns the smallest memory depth that holds `points` points, and its name.
fn depth(points: u64) -> (&'static str, f64) {
    match points {
        0..=1_000 => ("1k", 1.0e3),
        1_001..=10_000 => ("10k", 1.0e4),
        10_001..=100_000 => ("100k", 1.0e5),
        _ => ("1M", 1.0e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signed_codes_mean_the_volts_that_unsigned_ones_meant() {
        // The scaling of a DHO824's published capture at 0.05 V/div.
        let preamble = DHO800
            .preamble(b"1,2,10000,1,4.000000E-7,-2.000000E-3,0,6.6667E-6,-22718,32768")
            .unwrap();
        let volts = |code: u16| {
            f64::from(code.wrapping_sub(CENTRE).cast_signed()) * preamble.volts_per_code
                - preamble.offset_v
        };
        let direct = |code: f64| (code + 22718.0 - 32768.0) * 6.6667E-6;
        for code in [9965_u16, 32768, 55480, 0, 65535] {
            assert!(
                (volts(code) - direct(f64::from(code))).abs() < 1.0e-12,
                "{code}"
            );
        }
        assert!((preamble.volts_per_div - 0.05).abs() < 1.0e-6);
        for (text, expected) in [
            ("1,2,3", "ten numbers"),
            (
                "0,2,1000,1,1e-8,0,0,4e-3,0,128",
                "16-bit samples of the memory (1,2,…)",
            ),
            (
                "1,2,1000,1,0,0,0,0,0,32768",
                "scales above zero: no frame was completed since the scope was armed",
            ),
        ] {
            assert_eq!(DHO800.preamble(text.as_bytes()).unwrap_err(), expected);
        }
    }
}
