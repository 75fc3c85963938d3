//! sigrok's session (`.sr`): a ZIP archive with a text `metadata` and, for each analog channel,
//! pieces `analog-1-CHANNEL-PIECE` of little-endian 32-bit floats. Layout: sigrok's wiki, "File
//! format:Sigrok/v2".
//!
//! The samples of all channels are copied once to a temporary file. The format does not state their
//! unit; the reader assumes volts, as from a scope.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::Path;

use zip::ZipArchive;

use super::raw::{self, Form, Layout, RawFile};
use super::table;
use super::{ScopeError, ScopeRecord};

const KIND: &str = "sigrok session";
const METADATA: &str = "metadata";
/// First bytes of a ZIP archive.
pub(super) const MAGIC: &[u8] = b"PK\x03\x04";
/// Maximum size of the text.
const MOST_TEXT: u64 = 1 << 20;
/// Maximum size of all samples: an hour of four channels at 250 kHz.
const MOST_BYTES: u64 = 16 << 30;
/// Number of samples from which the step of the quantisation is determined.
const LOOKED_AT: usize = 20_000;
/// Bytes of a sample.
const WIDTH: usize = 4;

/// Contents of the text.
#[derive(Debug, Default, PartialEq)]
struct Metadata {
    rate: String,
    /// Number and name of each analog channel.
    analog: Vec<(u32, String)>,
    devices: usize,
}

impl Metadata {
    fn of(text: &str) -> Self {
        let mut read = Self::default();
        for line in text.lines().map(str::trim) {
            if line.starts_with("[device ") {
                read.devices += 1;
            }
            let Some((key, value)) = line.split_once('=') else {
                continue;
            };
            let number = key.strip_prefix("analog").and_then(|n| n.parse().ok());
            match number {
                Some(number) => read.analog.push((number, value.to_owned())),
                None if key == "samplerate" => value.clone_into(&mut read.rate),
                None => {}
            }
        }
        read.analog.sort();
        read
    }

    /// Samples per second: `1 MHz`, `500000`.
    fn samples_per_s(&self) -> Option<f64> {
        let unit_at = self.rate.find(|c: char| c.is_ascii_alphabetic());
        let (number, unit) = self.rate.split_at(unit_at.unwrap_or(self.rate.len()));
        let factor = match unit.trim() {
            "" | "Hz" => 1.0,
            "kHz" => 1.0e3,
            "MHz" => 1.0e6,
            "GHz" => 1.0e9,
            _ => return None,
        };
        let rate = factor * number.trim().parse::<f64>().ok()?;
        (rate.is_finite() && rate > 0.0).then_some(rate)
    }
}

/// Opens a session; returns `None` for another archive.
pub(super) fn open(path: &Path) -> Result<Option<ScopeRecord>, ScopeError> {
    let wrong = ScopeError::about(path, KIND);
    let Ok(mut archive) = ZipArchive::new(ScopeError::opened(path)?) else {
        return Ok(None);
    };
    if archive.index_for_name(METADATA).is_none() || archive.index_for_name("version").is_none() {
        return Ok(None);
    }
    let mut text = String::new();
    archive
        .by_name(METADATA)
        .map_err(std::io::Error::from)
        .and_then(|part| part.take(MOST_TEXT).read_to_string(&mut text))
        .map_err(|error| wrong(METADATA, "a text", error.to_string()))?;
    let metadata = Metadata::of(&text);
    if metadata.devices != 1 {
        return Err(wrong("devices", "one", metadata.devices.to_string()));
    }
    if metadata.analog.is_empty() {
        let met = "none: logic levels give no impedance".to_owned();
        return Err(wrong("channels", "analog ones", met));
    }
    let rate = metadata.samples_per_s().ok_or_else(|| {
        let expected = "a number with Hz, kHz, MHz or GHz";
        wrong("samplerate", expected, format!("{:?}", metadata.rate))
    })?;
    let io = |action| {
        move |source| ScopeError::Io {
            file: path.to_owned(),
            action,
            source,
        }
    };
    let file = raw::unnamed_file().map_err(io("make a temporary file"))?;
    let mut spill = Spill {
        writer: BufWriter::new(file),
        left: MOST_BYTES,
        written: 0,
        seen: Vec::new(),
    };
    let (mut channels, mut samples) = (Vec::new(), None);
    for (number, name) in &metadata.analog {
        let at = spill.written;
        spill.seen.clear();
        spill
            .channel(&mut archive, *number)
            .map_err(|met| wrong("samples", "numbers of a channel", format!("{name}: {met}")))?;
        let count = (spill.written - at) / WIDTH as u64;
        if *samples.get_or_insert(count) != count || count == 0 {
            let expected = "as many of each channel, and more than none";
            return Err(wrong("samples", expected, format!("{count} of {name}")));
        }
        channels.push(Layout {
            at,
            stride: WIDTH,
            form: Form::Float,
            scale: None,
            lsb_v: table::step(&spill.seen),
            level_v: spill.seen.first().copied().unwrap_or(0.0),
        });
    }
    let file = spill.writer.into_inner();
    let file = file.map_err(|error| io("write a temporary file")(error.into_error()))?;
    let names = metadata.analog.into_iter().map(|(_, name)| name).collect();
    Ok(Some(ScopeRecord {
        kind: KIND,
        interval_s: rate.recip(),
        samples: usize::try_from(samples.unwrap_or(0)).unwrap_or(0),
        names,
        raw: RawFile {
            path: path.to_owned(),
            file,
            channels,
        },
    }))
}

/// A temporary file of samples, channel after channel.
struct Spill {
    writer: BufWriter<File>,
    /// Bytes left up to the maximum.
    left: u64,
    written: u64,
    /// First samples of the channel.
    seen: Vec<f64>,
}

impl Spill {
    /// Adds all pieces of a channel.
    fn channel(&mut self, archive: &mut ZipArchive<File>, number: u32) -> Result<(), String> {
        for piece in 1_u32.. {
            let name = format!("analog-1-{number}-{piece}");
            if archive.index_for_name(&name).is_none() {
                break;
            }
            let part = archive.by_name(&name);
            let mut part = part.map_err(|error| format!("{name}: {error}"))?;
            self.piece(&mut part)
                .map_err(|error| format!("{name}: {error}"))?;
        }
        Ok(())
    }

    fn piece(&mut self, part: &mut impl Read) -> Result<(), String> {
        let mut buffer = vec![0; 1 << 16];
        let mut kept = 0;
        loop {
            let count = part
                .read(&mut buffer[kept..])
                .map_err(|error| error.to_string())?;
            if count == 0 {
                break;
            }
            let filled = kept + count;
            let whole = filled - filled % WIDTH;
            self.samples(&buffer[..whole])?;
            buffer.copy_within(whole..filled, 0);
            kept = filled - whole;
        }
        if kept == 0 {
            Ok(())
        } else {
            Err(format!("it ends within a sample of {WIDTH} bytes"))
        }
    }

    fn samples(&mut self, bytes: &[u8]) -> Result<(), String> {
        let length = bytes.len() as u64;
        self.left = self
            .left
            .checked_sub(length)
            .ok_or_else(|| format!("more than {MOST_BYTES} bytes"))?;
        for sample in bytes.chunks_exact(WIDTH) {
            let value = sample.try_into().map_or(f32::NAN, f32::from_le_bytes);
            if !value.is_finite() {
                let at = self.written / WIDTH as u64;
                return Err(format!(
                    "sample {at} of all is {value}: a record with gaps gives no impedance"
                ));
            }
            if self.seen.len() < LOOKED_AT {
                self.seen.push(f64::from(value));
            }
        }
        self.written += length;
        self.writer
            .write_all(bytes)
            .map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_read_with_their_unit() {
        for (rate, expected) in [
            ("1 MHz", Some(1.0e6)),
            ("500000000 Hz", Some(5.0e8)),
            ("12.5 kHz", Some(12.5e3)),
            ("250000", Some(2.5e5)),
            ("1 furlong", None),
            ("0 Hz", None),
            ("", None),
        ] {
            let metadata = Metadata::of(&format!("[device 1]\nsamplerate={rate}\n"));
            assert_eq!(metadata.samples_per_s(), expected, "{rate}");
        }
    }
}
