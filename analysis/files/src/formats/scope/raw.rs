//! Samples of a binary file, read in pieces.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::ScopeError;
use analysis_signal::sine::{CodeScale, Samples};

/// Bytes at the beginning of a file that are searched for headers.
const HEAD: usize = 1 << 14;
/// Number of samples from which the step of the codes is determined.
const LOOKED_AT: usize = 1 << 15;

/// A temporary file without a name: the system deletes it when it is closed, however the process
/// ends.
pub(super) fn unnamed_file() -> std::io::Result<File> {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let name = format!(
        "eis-bench-table-{}-{}",
        std::process::id(),
        NEXT.fetch_add(1, Ordering::Relaxed)
    );
    let path = std::env::temp_dir().join(name);
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create_new(true)
        .open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

/// Format of one sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// One byte from 0 to 255; 128 is the middle.
    Byte,
    /// One byte with its sign.
    SignedByte,
    /// Two bytes from 0 to 65535; 32768 is the middle.
    Word { big: bool },
    /// Two bytes with their sign.
    SignedWord { big: bool },
    /// Four bytes, volts.
    Float,
    /// Eight bytes, volts.
    Double,
}

impl Form {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::Byte | Self::SignedByte => 1,
            Self::Word { .. } | Self::SignedWord { .. } => 2,
            Self::Float => 4,
            Self::Double => 8,
        }
    }

    fn code(self, bytes: &[u8]) -> i16 {
        let word = |big: bool| {
            let pair = [
                bytes.first().copied().unwrap_or(0),
                bytes.get(1).copied().unwrap_or(0),
            ];
            if big {
                u16::from_be_bytes(pair)
            } else {
                u16::from_le_bytes(pair)
            }
        };
        let byte = bytes.first().copied().unwrap_or(0);
        match self {
            Self::Byte => i16::from(byte) - 128,
            Self::SignedByte => i16::from(byte.cast_signed()),
            Self::Word { big } => (word(big) ^ 0x8000).cast_signed(),
            Self::SignedWord { big } => word(big).cast_signed(),
            Self::Float | Self::Double => 0,
        }
    }

    fn volts(self, bytes: &[u8]) -> f64 {
        match self {
            Self::Float => <[u8; 4]>::try_from(bytes)
                .map_or(f64::NAN, |bytes| f64::from(f32::from_le_bytes(bytes))),
            _ => <[u8; 8]>::try_from(bytes).map_or(f64::NAN, f64::from_le_bytes),
        }
    }
}

/// Offset of a channel in the file, and format of its samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    /// First byte of its first sample.
    pub(super) at: u64,
    /// Bytes from one of its samples to the next.
    pub(super) stride: usize,
    /// Format of the samples.
    pub(super) form: Form,
    /// Conversion of codes to volts; `None` if the samples are volts.
    pub(super) scale: Option<CodeScale>,
    /// Step of volts, V.
    pub(super) lsb_v: Option<f64>,
    /// A sample of volts.
    pub(super) level_v: f64,
}

/// A file with its channels.
#[derive(Debug)]
pub(super) struct RawFile {
    pub(super) path: PathBuf,
    pub(super) file: File,
    pub(super) channels: Vec<Layout>,
}

impl RawFile {
    fn bytes(&self, layout: &Layout, start: usize, count: usize) -> Result<Vec<u8>, String> {
        let width = layout.form.bytes();
        let length = if count == 0 {
            0
        } else {
            (count - 1) * layout.stride + width
        };
        let mut bytes = vec![0; length];
        let at = layout.at + start as u64 * layout.stride as u64;
        self.file
            .read_exact_at(&mut bytes, at)
            .map_err(|error| format!("{}: byte {at}: {error}", self.path.display()))?;
        Ok(bytes)
    }

    fn layout(&self, channel: usize) -> Result<&Layout, String> {
        self.channels
            .get(channel)
            .ok_or_else(|| format!("{}: no channel {}", self.path.display(), channel + 1))
    }

    /// Volts of any channel.
    pub(super) fn volts_of(
        &self,
        channel: usize,
        start: usize,
        count: usize,
    ) -> Result<Vec<f64>, ScopeError> {
        let scale = self.channels.get(channel).and_then(|layout| layout.scale);
        let read = match scale {
            Some(scale) => self
                .codes(channel, start, count)
                .map(|codes| codes.into_iter().map(|code| scale.volts(code)).collect()),
            None => self.volts(channel, start, count),
        };
        read.map_err(|met| ScopeError::Layout {
            file: self.path.clone(),
            kind: "record",
            field: "samples",
            expected: format!("{count} from sample {start} on"),
            met,
        })
    }

    /// Finds the step of a channel's codes: a twelve-bit ADC uses the upper bits of sixteen.
    /// `bits`: size of a code.
    pub(super) fn settle_steps(&mut self, samples: usize, bits: u32) -> Result<(), ScopeError> {
        for channel in 0..self.channels.len() {
            let codes = self
                .codes(channel, 0, samples.min(LOOKED_AT))
                .map_err(|met| ScopeError::Layout {
                    file: self.path.clone(),
                    kind: "record",
                    field: "samples",
                    expected: format!("{samples} of channel {}", channel + 1),
                    met,
                })?;
            let zeros = codes
                .iter()
                .fold(0_i16, |all, code| all | *code)
                .trailing_zeros()
                .min(bits - 1);
            if let Some(scale) = self
                .channels
                .get_mut(channel)
                .and_then(|layout| layout.scale.as_mut())
            {
                scale.code_step = 1
                    << if codes.iter().all(|code| *code == 0) {
                        0
                    } else {
                        zeros
                    };
                scale.code_max -= scale.code_step.cast_signed() - 1;
            }
        }
        Ok(())
    }
}

impl Samples for RawFile {
    fn codes(&self, channel: usize, start: usize, count: usize) -> Result<Vec<i16>, String> {
        let layout = self.layout(channel)?;
        let bytes = self.bytes(layout, start, count)?;
        let width = layout.form.bytes();
        Ok(bytes
            .chunks(layout.stride)
            .map(|sample| layout.form.code(&sample[..width.min(sample.len())]))
            .collect())
    }

    fn volts(&self, channel: usize, start: usize, count: usize) -> Result<Vec<f64>, String> {
        let layout = self.layout(channel)?;
        let bytes = self.bytes(layout, start, count)?;
        let width = layout.form.bytes();
        Ok(bytes
            .chunks(layout.stride)
            .map(|sample| layout.form.volts(&sample[..width.min(sample.len())]))
            .collect())
    }
}

/// The beginning of a file, for reading numbers.
pub(super) struct Bytes {
    head: Vec<u8>,
    /// The whole file, bytes.
    pub(super) length: u64,
    pub(super) big: bool,
}

impl Bytes {
    pub(super) fn new(path: &Path, file: &File) -> Result<Self, ScopeError> {
        let io = |source| ScopeError::Io {
            file: path.to_owned(),
            action: "read it",
            source,
        };
        let length = file.metadata().map_err(io)?.len();
        let mut head = vec![0; HEAD.min(usize::try_from(length).unwrap_or(HEAD))];
        file.read_exact_at(&mut head, 0).map_err(io)?;
        Ok(Self {
            head,
            length,
            big: false,
        })
    }

    /// The same beginning elsewhere in the file.
    pub(super) fn at(path: &Path, file: &File, at: u64) -> Result<Self, ScopeError> {
        let io = |source| ScopeError::Io {
            file: path.to_owned(),
            action: "read it",
            source,
        };
        let length = file.metadata().map_err(io)?.len();
        let mut head =
            vec![0; HEAD.min(usize::try_from(length.saturating_sub(at)).unwrap_or(HEAD))];
        file.read_exact_at(&mut head, at).map_err(io)?;
        Ok(Self {
            head,
            length,
            big: false,
        })
    }

    pub(super) fn head(&self) -> &[u8] {
        &self.head
    }

    fn take<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut taken = [0; N];
        if let Some(bytes) = self.head.get(at..at + N) {
            taken.copy_from_slice(bytes);
        }
        if self.big {
            taken.reverse();
        }
        taken
    }

    pub(super) fn u8(&self, at: usize) -> u8 {
        u8::from_le_bytes(self.take(at))
    }

    pub(super) fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.take(at))
    }

    pub(super) fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.take(at))
    }

    pub(super) fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.take(at))
    }

    pub(super) fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.take(at)))
    }

    pub(super) fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.take(at))
    }

    /// Returns a text of fixed length, up to its first zero.
    pub(super) fn text(&self, at: usize, length: usize) -> String {
        let bytes = self.head.get(at..at + length).unwrap_or(&[]);
        let end = bytes
            .iter()
            .position(|byte| *byte == 0)
            .unwrap_or(bytes.len());
        String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
    }
}
