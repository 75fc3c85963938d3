//! LeCroy's `.trc`: a descriptor `WAVEDESC` by the template LECROY_2_3, then the codes of one
//! channel. V = gain · code − offset.

use std::path::Path;

use super::raw::{Bytes, Form, Layout, RawFile};
use super::{ScopeError, ScopeRecord};
use analysis_signal::sine::CodeScale;

const KIND: &str = "LeCroy trace";
const MARK: &[u8] = b"WAVEDESC";
/// Longest block header before the descriptor, bytes.
const WITHIN: usize = 64;
const TEMPLATE: &str = "LECROY_2_3";

/// Returns the offset of the descriptor, if the file has one.
pub(super) fn begins(bytes: &Bytes) -> Option<usize> {
    let head = bytes.head();
    head[..head.len().min(WITHIN)]
        .windows(MARK.len())
        .position(|window| window == MARK)
}

/// Opens a file whose descriptor begins at the given byte.
pub(super) fn open(path: &Path, bytes: &Bytes, at: usize) -> Result<ScopeRecord, ScopeError> {
    let wrong = ScopeError::about(path, KIND);
    let file = ScopeError::opened(path)?;
    let mut header = Bytes::at(path, &file, at as u64)?;
    let template = header.text(16, 16);
    if template != TEMPLATE {
        return Err(wrong("template", TEMPLATE, template));
    }
    // The field of the byte order reads 0 in either order for big-endian, and 1 in little-endian
    // order.
    header.big = header.u16(34) == 0;
    let big = header.big;
    let words = header.u16(32) == 1;
    let lengths: Vec<u64> = [36, 40, 44, 48, 52, 56, 60]
        .iter()
        .map(|at| u64::from(header.u32(*at)))
        .collect();
    let segments = header.u32(144);
    if segments > 1 {
        return Err(wrong(
            "segments",
            "one record",
            format!("a sequence of {segments}"),
        ));
    }
    let form = if words {
        Form::SignedWord { big }
    } else {
        Form::SignedByte
    };
    let data = at as u64 + lengths[..6].iter().sum::<u64>();
    let samples =
        (header.u32(116) as usize).min(usize::try_from(lengths[6]).unwrap_or(0) / form.bytes());
    let end = data + (samples * form.bytes()) as u64;
    if samples == 0 || end > bytes.length {
        return Err(wrong(
            "data",
            &format!("{samples} samples, {end} bytes"),
            format!("{} bytes", bytes.length),
        ));
    }
    let (gain, offset_v, interval_s) = (header.f32(156), header.f32(160), header.f32(176));
    if !(gain > 0.0 && gain.is_finite() && interval_s > 0.0 && interval_s.is_finite()) {
        return Err(wrong(
            "gain and interval",
            "positive numbers",
            format!("{gain} V and {interval_s} s"),
        ));
    }
    let bits = if words { 16 } else { 8 };
    let (code_min, code_max) = if words {
        (i16::MIN, i16::MAX)
    } else {
        (-128, 127)
    };
    let scale = CodeScale {
        volts_per_code: gain,
        offset_v,
        code_min,
        code_max,
        code_step: 1,
    };
    let layout = Layout {
        at: data,
        stride: form.bytes(),
        form,
        scale: Some(scale),
        lsb_v: None,
        level_v: 0.0,
    };
    let mut raw = RawFile {
        path: path.to_owned(),
        file,
        channels: vec![layout],
    };
    raw.settle_steps(samples, bits)?;
    let name = header.text(76, 16);
    Ok(ScopeRecord {
        kind: KIND,
        interval_s,
        samples,
        names: vec![name],
        raw,
    })
}
