//! Siglent SDS800X HD (and 1000X HD, 2000X HD): binary 346-byte descriptor, signed left-justified
//! codes, zero-based paging.
//!
//! Read-backs show three digits until `:FORMat:DATA` is set, so that comes first wherever numbers
//! are read back. The final `0A 0A` after a block is the link's business.

use instruments_domain::units::{Seconds, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Dialect, Intent, Preamble, Queries};
use crate::{
    exchange::{CHOSEN, Exchange, Expect, Identity, Setting},
    instrument::{Model, ms},
};

/// Siglent SDS800X HD.
pub(super) const SDS800X_HD: Sds = Sds;

/// Length of the descriptor.
const DESCRIPTOR_BYTES: usize = 346;
/// Codes of a 12-bit sample, left-justified in 16 bits: the greatest is 2047 · 16.
const CODE_MAX: i16 = 2047 * 16;
/// From one 12-bit sample's code to the next.
const CODE_STEP: u16 = 16;
/// Greatest |offset| by scale at the 1× probe. Data sheet of the 2000X HD family, taken for this
/// one: check it on the first real unit; a wrong entry shows as a read-back error, never as a wrong
/// voltage.
const OFFSET_LIMITS: &[(Volts, Volts)] = &[
    (Volts(5.0e-3), Volts(1.6)),
    (Volts(10.0e-3), Volts(4.0)),
    (Volts(20.0e-3), Volts(8.0)),
    (Volts(100.0e-3), Volts(16.0)),
    (Volts(200.0e-3), Volts(80.0)),
    (Volts(1.0), Volts(160.0)),
    (Volts(10.0), Volts(400.0)),
];

pub(super) struct Sds;

/// Settings that some firmware does not know. No impedance depends on them: the phase of a point is
/// that between two channels of one record.
const SETTINGS: &[Setting] = &[
    Setting::state(":TIMebase:REFerence?", "reference of the delay", CHOSEN)
        .optional("where the trigger lies in a record"),
    Setting::number(
        ":TIMebase:REFerence:POSition?",
        "position of the reference",
        "%",
    )
    .optional("where the trigger lies in a record"),
];

impl Model for Sds {
    fn key(&self) -> &'static str {
        "siglent-sds800x-hd"
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
            && identity.model.starts_with("SDS")
            && identity.model.ends_with("HD")
    }
}

impl Dialect for Sds {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            per_div: (Volts(0.5e-3), Volts(10.0)),
            offset_limits: OFFSET_LIMITS,
            half_range_div: 32_768.0 / 7_680.0,
            horizontal_div: 10.0,
            max_time_per_div: Seconds(1000.0),
            thins_out: true,
            most_points: 10_000_000,
        }
    }

    fn script(&self, intent: &Intent) -> Vec<Exchange> {
        match intent {
            Intent::Session { memory_points } => session(*memory_points),
            Intent::Vertical(vertical) => {
                let (n, scale, offset) = (
                    vertical.channel,
                    vertical.per_div.value(),
                    vertical.offset.value(),
                );
                vec![
                    digits(),
                    Exchange::word(
                        format!(":CHANnel{n}:SWITch ON"),
                        format!(":CHANnel{n}:SWITch?"),
                        &["ON"],
                    ),
                    Exchange::word(
                        format!(":CHANnel{n}:COUPling DC"),
                        format!(":CHANnel{n}:COUPling?"),
                        &["DC"],
                    ),
                    Exchange::word(
                        format!(":CHANnel{n}:BWLimit 20M"),
                        format!(":CHANnel{n}:BWLimit?"),
                        &["20M"],
                    ),
                    Exchange::number(
                        format!(":CHANnel{n}:PROBe VALue,1.00E+00"),
                        format!(":CHANnel{n}:PROBe?"),
                        1.0,
                        1.0e-6,
                    ),
                    Exchange::number(
                        format!(":CHANnel{n}:SCALe {scale:.5E}"),
                        format!(":CHANnel{n}:SCALe?"),
                        scale,
                        0.02 * scale,
                    ),
                    // The limit of the offset depends on the scale, so the scale comes first. The
                    // descriptor contains the exact offset; this check only detects a clamped one.
                    Exchange::number(
                        format!(":CHANnel{n}:OFFSet {offset:.5E}"),
                        format!(":CHANnel{n}:OFFSet?"),
                        offset,
                        0.25 * scale,
                    ),
                ]
            }
            Intent::Timebase(per_div) => {
                let per_div = per_div.value();
                vec![
                    Exchange::number(
                        format!(":TIMebase:SCALe {per_div:.2E}"),
                        ":TIMebase:SCALe?",
                        per_div,
                        1.0e-3 * per_div,
                    ),
                    Exchange::word(
                        ":TIMebase:REFerence DELay",
                        ":TIMebase:REFerence?",
                        &["DELay", "DEL"],
                    ),
                    Exchange::number(
                        ":TIMebase:REFerence:POSition 50",
                        ":TIMebase:REFerence:POSition?",
                        50.0,
                        0.5,
                    ),
                    Exchange::number(
                        ":TIMebase:DELay 0.00E+00",
                        ":TIMebase:DELay?",
                        0.0,
                        1.0e-3 * per_div,
                    ),
                ]
            }
            Intent::Trigger(trigger) => {
                vec![
                    Exchange::word(":TRIGger:TYPE EDGE", ":TRIGger:TYPE?", &["EDGE"]),
                    source(":TRIGger:EDGE:SOURce", trigger.channel),
                    Exchange::word(
                        ":TRIGger:EDGE:SLOPe RISing",
                        ":TRIGger:EDGE:SLOPe?",
                        &["RISing"],
                    ),
                    Exchange::send(format!(":TRIGger:EDGE:LEVel {:.5E}", trigger.level.value())),
                ]
            }
            Intent::Arm => {
                vec![
                    Exchange::word(":TRIGger:MODE NORMal", ":TRIGger:MODE?", &["NORMal"]),
                    Exchange::send(":TRIGger:RUN"),
                ]
            }
            Intent::Roll => {
                vec![
                    Exchange::word(":TRIGger:MODE AUTO", ":TRIGger:MODE?", &["AUTO"]),
                    Exchange::send(":TRIGger:RUN"),
                ]
            }
            Intent::Stop => vec![Exchange::send(":TRIGger:STOP")],
            Intent::Transfer { channel, stride } => vec![
                digits(),
                // A channel that is off is not taken over: the samples would be another channel's.
                source(":WAVeform:SOURce", *channel),
                start(0),
                Exchange::send(":WAVeform:POINt 0"),
                Exchange::number(
                    format!(":WAVeform:INTerval {stride}"),
                    ":WAVeform:INTerval?",
                    *stride as f64,
                    0.5,
                ),
                Exchange::word(":WAVeform:WIDTh WORD", ":WAVeform:WIDTh?", &["WORD"]),
                Exchange::word(":WAVeform:BYTeorder LSB", ":WAVeform:BYTeorder?", &["LSB"]),
            ],
            Intent::Page { start: first, .. } => vec![start(*first)],
        }
    }

    fn beside(&self, channel: u8, stride: u64) -> Vec<Exchange> {
        let chosen = source(":WAVeform:SOURce", channel);
        // Only a record of several pages has moved the start.
        if stride > 1 {
            vec![chosen]
        } else {
            vec![chosen, start(0)]
        }
    }

    fn queries(&self) -> Queries {
        Queries {
            status: ":TRIGger:STATus?",
            stopped: "Stop",
            points: ":ACQuire:POINts?",
            preamble: ":WAVeform:PREamble?",
            data: ":WAVeform:DATA?",
        }
    }

    fn preamble(&self, block: &[u8]) -> Result<Preamble, String> {
        let descriptor = Descriptor::find(block)?;
        let volts_per_div = f64::from(descriptor.f32(156)) * f64::from(descriptor.f32(328));
        let codes_per_div = f64::from(descriptor.f32(164));
        let points = u64::try_from(descriptor.i32(116)).unwrap_or(0);
        let interval_s = f64::from(descriptor.f32(176));
        if points == 0
            || ![volts_per_div, codes_per_div, interval_s]
                .iter()
                .all(|scale| *scale > 0.0 && scale.is_finite())
        {
            return Err(
                "a descriptor with points and scales: no frame was completed since the \
            scope was armed"
                    .to_owned(),
            );
        }
        if descriptor.i16(32) != 1 || descriptor.i16(34) != 0 {
            return Err("16-bit samples with the low byte first".to_owned());
        }
        Ok(Preamble {
            points,
            volts_per_code: volts_per_div / codes_per_div,
            offset_v: f64::from(descriptor.f32(160)) * f64::from(descriptor.f32(328)),
            volts_per_div,
            interval_s,
            delay_s: descriptor.f64(180),
            code_min: i16::MIN,
            code_max: CODE_MAX,
            code_step: CODE_STEP,
        })
    }

    fn codes(&self, block: &[u8]) -> Result<Vec<i16>, String> {
        let (pairs, rest) = block.as_chunks::<2>();
        if rest.is_empty() {
            Ok(pairs.iter().map(|pair| i16::from_le_bytes(*pair)).collect())
        } else {
            Err("two bytes a sample".to_owned())
        }
    }
}

/// Selects all digits in replies.
fn digits() -> Exchange {
    Exchange::send(":FORMat:DATA DOUBle")
}

fn source(header: &str, channel: u8) -> Exchange {
    let name = format!("C{channel}");
    Exchange::Set {
        message: format!("{header} {name}"),
        read_back: format!("{header}?"),
        expect: Expect::Contains(name),
    }
}

fn start(first: u64) -> Exchange {
    Exchange::number(
        format!(":WAVeform:STARt {first}"),
        ":WAVeform:STARt?",
        first as f64,
        0.5,
    )
}

fn session(memory_points: u64) -> Vec<Exchange> {
    let depth = match memory_points {
        0..=10_000 => "10k",
        10_001..=100_000 => "100k",
        100_001..=1_000_000 => "1M",
        _ => "10M",
    };
    vec![
        digits(),
        Exchange::send(":ACQuire:TYPE NORMal"),
        Exchange::send(":ACQuire:MMANagement FMDepth"),
        Exchange::Set {
            message: format!(":ACQuire:MDEPth {depth}"),
            read_back: ":ACQuire:MDEPth?".to_owned(),
            expect: Expect::Contains(depth.to_owned()),
        },
    ]
}

/// The descriptor's fields by their offset; absent bytes read as zero.
struct Descriptor<'a>(&'a [u8]);

impl<'a> Descriptor<'a> {
    fn find(block: &'a [u8]) -> Result<Self, String> {
        if block.len() < DESCRIPTOR_BYTES {
            return Err(format!("a descriptor of at least {DESCRIPTOR_BYTES} bytes"));
        }
        if !block.starts_with(b"WAVEDESC") {
            return Err(
                "a descriptor that starts with WAVEDESC: no frame was completed since the \
            scope was armed"
                    .to_owned(),
            );
        }
        Ok(Self(block))
    }

    fn bytes<const N: usize>(&self, offset: usize) -> [u8; N] {
        self.0
            .get(offset..offset + N)
            .and_then(|slice| slice.try_into().ok())
            .unwrap_or([0; N])
    }

    fn i16(&self, offset: usize) -> i16 {
        i16::from_le_bytes(self.bytes(offset))
    }

    fn i32(&self, offset: usize) -> i32 {
        i32::from_le_bytes(self.bytes(offset))
    }

    fn f32(&self, offset: usize) -> f32 {
        f32::from_le_bytes(self.bytes(offset))
    }

    fn f64(&self, offset: usize) -> f64 {
        f64::from_le_bytes(self.bytes(offset))
    }
}
