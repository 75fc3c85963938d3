//! Binary files (`.bin`) of Keysight, and of Rigol, which took over the layout: a file header, then
//! for each channel a header, a data header and its samples as floats in volts.

use std::path::Path;

use super::raw::{Bytes, Form, Layout, RawFile};
use super::{ScopeError, ScopeRecord};

/// First bytes, and the kind of the file.
const MARKS: [(&[u8], &str); 2] = [(b"RG", "Rigol binary"), (b"AG", "Keysight binary")];
/// Maximum number of waveforms of a file: four analog channels, digital channels, results of
/// mathematics.
const MOST: u32 = 64;

/// Returns the kind of a file from its first bytes.
pub(super) fn kind(bytes: &Bytes) -> Option<&'static str> {
    let begins = |(mark, _): &&(&[u8], &str)| bytes.head().starts_with(mark);
    MARKS.iter().find(begins).map(|(_, kind)| *kind)
}

/// Opens a file of a kind.
pub(super) fn open(
    path: &Path,
    bytes: &Bytes,
    of: &'static str,
) -> Result<ScopeRecord, ScopeError> {
    let wrong = ScopeError::about(path, of);
    // Since version 3, the sizes of file and buffer have eight bytes.
    let (count, mut at, wide) = match &bytes.head().get(2..4) {
        Some(b"01" | b"02" | b"10") => (bytes.u32(8), 12_u64, false),
        Some(b"03") => (bytes.u32(12), 16_u64, true),
        other => return Err(wrong("version", "01, 02, 03 or 10", format!("{other:?}"))),
    };
    if !(1..=MOST).contains(&count) {
        return Err(wrong("number of waveforms", "1 to 64", count.to_string()));
    }
    let file = ScopeError::opened(path)?;
    let (mut channels, mut names, mut shape): (Vec<Layout>, Vec<String>, Option<(usize, f64)>) =
        (Vec::new(), Vec::new(), None);
    for _ in 0..count {
        let header = Bytes::at(path, &file, at)?;
        let (size, points, interval_s) = (
            u64::from(header.u32(0)),
            header.u32(12) as usize,
            header.f64(32),
        );
        let data = Bytes::at(path, &file, at + size)?;
        let (head, kind, width) = (u64::from(data.u32(0)), data.u16(4), data.u16(6));
        let length = if wide {
            data.u64(8)
        } else {
            u64::from(data.u32(8))
        };
        if size < 100 || head < 12 || (at + size + head).saturating_add(length) > bytes.length {
            return Err(wrong(
                "waveform",
                "headers and samples within the file",
                format!("{size}, {head} and {length} bytes from {at} on"),
            ));
        }
        // Digital channels and other waveforms are skipped.
        if width == 4 && kind <= 5 && (points as u64) * 4 <= length {
            let shape = *shape.get_or_insert((points, interval_s));
            if shape != (points, interval_s)
                || interval_s.is_nan()
                || interval_s <= 0.0
                || points == 0
            {
                return Err(wrong(
                    "waveform",
                    "samples as those of the first",
                    format!("{points} samples every {interval_s} s"),
                ));
            }
            let level_v = Bytes::at(path, &file, at + size + head)?.f32(0);
            channels.push(Layout {
                at: at + size + head,
                stride: 4,
                form: Form::Float,
                scale: None,
                lsb_v: None,
                level_v,
            });
            names.push(header.text(112, 16));
        }
        at += size + head + length;
    }
    let Some((samples, interval_s)) = shape else {
        return Err(wrong(
            "waveforms",
            "at least one of samples in volts",
            "none".to_owned(),
        ));
    };
    Ok(ScopeRecord {
        kind: of,
        interval_s,
        samples,
        names,
        raw: RawFile {
            path: path.to_owned(),
            file,
            channels,
        },
    })
}
