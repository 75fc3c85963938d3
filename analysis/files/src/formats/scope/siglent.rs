//! Siglent's binary files V2.0, V3.0 and V4.0: a header of 2 or 4 KiB, then the codes of each
//! channel that was on, one channel after the other.
//!
//! V = ((code − middle) · V/div / codes per division − offset) · probe, verified with files of
//! known voltages; the manufacturer's description adds the offset instead.

use std::path::Path;

use super::raw::{Bytes, Form, Layout, RawFile};
use super::{ScopeError, ScopeRecord};
use analysis_signal::sine::CodeScale;

const KIND: &str = "Siglent binary";
/// Channels in the first bank of a header.
const CHANNELS: usize = 4;
/// Bytes of a value with its unit.
const VALUE: usize = 40;
/// Codes per division if the header does not state them.
const PER_DIV: f64 = 25.0;

/// Offsets of the fields of a version.
struct Fields {
    on: usize,
    volt_div: usize,
    offset: usize,
    length: usize,
    rate: usize,
    probe: usize,
    width: usize,
    order: Option<usize>,
    per_div: Option<usize>,
}

const V2: Fields = Fields {
    on: 0x04,
    volt_div: 0x14,
    offset: 0xb4,
    length: 0x1e8,
    rate: 0x1ec,
    probe: 0x240,
    width: 0x260,
    order: None,
    per_div: None,
};
const V3: Fields = Fields {
    order: Some(0x261),
    per_div: Some(0x26c),
    ..V2
};
const V4: Fields = Fields {
    on: 0x08,
    volt_div: 0x18,
    offset: 0xb8,
    length: 0x1ec,
    rate: 0x1f0,
    probe: 0x244,
    width: 0x264,
    order: Some(0x265),
    per_div: Some(0x270),
};

fn fields(bytes: &Bytes) -> Option<(&'static Fields, u64)> {
    match bytes.u32(0) {
        2 => Some((&V2, 0x800)),
        3 => Some((&V3, 0x800)),
        4 => Some((&V4, u64::from(bytes.u32(4)))),
        _ => None,
    }
}

/// Returns whether the beginning of a file matches a supported version.
pub(super) fn is_one(bytes: &Bytes) -> bool {
    fields(bytes).is_some_and(|(fields, _)| {
        let switches: Vec<u32> = (0..CHANNELS)
            .map(|channel| bytes.u32(fields.on + 4 * channel))
            .collect();
        bytes.head().len() >= 0x800 && switches.iter().all(|on| *on <= 1) && switches.contains(&1)
    })
}

/// Returns a value in SI units from the number and the following power of thousand.
fn value(bytes: &Bytes, at: usize) -> f64 {
    bytes.f64(at) * 10.0_f64.powf(3.0 * (f64::from(bytes.u32(at + 8)) - 8.0))
}

/// Opens a file that [`is_one`].
pub(super) fn open(path: &Path, bytes: &Bytes) -> Result<ScopeRecord, ScopeError> {
    let wrong = ScopeError::about(path, KIND);
    let Some((fields, data)) = fields(bytes) else {
        return Err(wrong("version", "2, 3 or 4", bytes.u32(0).to_string()));
    };
    let (rate_hz, samples) = (value(bytes, fields.rate), bytes.u32(fields.length) as usize);
    if !(rate_hz > 0.0 && rate_hz.is_finite()) {
        return Err(wrong(
            "sample rate",
            "a rate above 0 Hz",
            rate_hz.to_string(),
        ));
    }
    let big = fields.order.is_some_and(|at| bytes.u8(at) != 0);
    let (form, bits) = if bytes.u8(fields.width) == 0 {
        (Form::Byte, 8)
    } else {
        (Form::Word { big }, 16)
    };
    let (mut channels, mut names) = (Vec::new(), Vec::new());
    for number in (0..CHANNELS).filter(|number| bytes.u32(fields.on + 4 * number) == 1) {
        let per_div = fields
            .per_div
            .map_or(PER_DIV, |at| f64::from(bytes.u32(at + 4 * number)));
        let (volt_div, probe) = (
            value(bytes, fields.volt_div + VALUE * number),
            bytes.f64(fields.probe + 8 * number),
        );
        let volts_per_code = volt_div / per_div * probe;
        if !(volts_per_code > 0.0 && volts_per_code.is_finite()) {
            return Err(wrong(
                "V/div",
                "a positive scale, codes per division and probe",
                format!("{volt_div} V, {per_div}, {probe}"),
            ));
        }
        let half = if bits == 8 { 128 } else { i16::MAX };
        let scale = CodeScale {
            volts_per_code,
            offset_v: value(bytes, fields.offset + VALUE * number) * probe,
            code_min: if bits == 8 { -half } else { i16::MIN },
            code_max: if bits == 8 { half - 1 } else { half },
            code_step: 1,
        };
        let at = data + channels.len() as u64 * (samples * form.bytes()) as u64;
        channels.push(Layout {
            at,
            stride: form.bytes(),
            form,
            scale: Some(scale),
            lsb_v: None,
            level_v: 0.0,
        });
        names.push(format!("C{}", number + 1));
    }
    let end = data + channels.len() as u64 * (samples * form.bytes()) as u64;
    if samples == 0 || end > bytes.length {
        let expected = format!(
            "{} channels of {samples} samples, {end} bytes",
            channels.len()
        );
        return Err(wrong("data", &expected, format!("{} bytes", bytes.length)));
    }
    let mut raw = RawFile {
        path: path.to_owned(),
        file: ScopeError::opened(path)?,
        channels,
    };
    raw.settle_steps(samples, bits)?;
    Ok(ScopeRecord {
        kind: KIND,
        interval_s: 1.0 / rate_hz,
        samples,
        names,
        raw,
    })
}
