//! A capture that stays on disk: its codes are read in pieces, so that a record may exceed the
//! memory.

use std::fs::File;
use std::path::{Path, PathBuf};

use polars::prelude::{ParallelStrategy, ParquetReader, SerReader};

use super::DatasetError;
use super::capture::{CAPTURE_COLUMNS, CaptureMeta, codes, read_meta};
use super::disk::io_error;
use super::frame::{check_file, metadata, parquet_error};
use analysis_signal::sine::{Channel, Samples, Stored};

/// A capture on disk whose checksum was verified.
#[derive(Debug, Clone)]
pub struct CaptureFile {
    path: PathBuf,
    meta: CaptureMeta,
    samples: usize,
}

/// Opens a capture and verifies its checksum, reading it once in pieces.
///
/// # Errors
/// As [`super::read_capture`].
pub fn open_capture(path: &Path) -> Result<CaptureFile, DatasetError> {
    check_file(path)?;
    let file = File::open(path).map_err(|source| io_error(path, "read the file", source))?;
    let mut reader = ParquetReader::new(file);
    let pairs = metadata(path, &mut reader)?;
    let samples = reader
        .num_rows()
        .map_err(|source| parquet_error(path, "read it as Parquet", source))?;
    Ok(CaptureFile {
        path: path.to_owned(),
        meta: read_meta(path, &pairs)?,
        samples,
    })
}

impl CaptureFile {
    /// Conditions of the capture.
    pub fn meta(&self) -> &CaptureMeta {
        &self.meta
    }

    /// Samples of each channel.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The channels, ready to be fitted.
    pub fn channels(&self) -> [Channel<'_>; 4] {
        std::array::from_fn(|channel| {
            let scale = Some(self.meta.channels[channel].scale);
            Channel::Stored(Stored {
                samples: self,
                channel,
                start: 0,
                count: self.samples,
                scale,
                lsb_v: None,
                level_v: 0.0,
            })
        })
    }

    fn piece(&self, channel: usize, start: usize, count: usize) -> Result<Vec<i16>, DatasetError> {
        let name = CAPTURE_COLUMNS.get(channel).map_or("", |spec| spec.name);
        // Opened again each time, so that the mapping of the previous piece is released.
        let file = File::open(&self.path)
            .map_err(|source| io_error(&self.path, "read the file", source))?;
        let frame = ParquetReader::new(file)
            .with_columns(Some(vec![name.to_owned()]))
            .with_slice(Some((start, count)))
            .read_parallel(ParallelStrategy::None)
            .finish()
            .map_err(|source| parquet_error(&self.path, "decode the table", source))?;
        codes(&self.path, &frame, name)
    }
}

impl Samples for CaptureFile {
    fn codes(&self, channel: usize, start: usize, count: usize) -> Result<Vec<i16>, String> {
        self.piece(channel, start, count)
            .map_err(|error| error.to_string())
    }
}
