//! Raw captures of the oscilloscope: ADC codes in columns, their scaling in the metadata of the
//! Parquet file.
//!
//! The columns are 32 bits wide because Parquet stores 16-bit numbers that way. Numbers in the
//! metadata are text in the shortest form that reads back to the same bits, which JSON does not
//! guarantee.

use std::collections::BTreeMap;
use std::path::Path;

use polars::prelude::{Column, DataFrame, DataType};

use super::frame::{parquet_error, read_frame, write_frame};
use super::{ColumnSpec, DatasetError};
use analysis_signal::sine::{Channel, CodeScale};

/// Columns of a capture.
pub const CAPTURE_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "code_c1",
        unit: "1",
        doc: "ADC codes of channel 1; V = code · c1.volts_per_code − c1.offset_v",
    },
    ColumnSpec {
        name: "code_c2",
        unit: "1",
        doc: "ADC codes of channel 2",
    },
    ColumnSpec {
        name: "code_c3",
        unit: "1",
        doc: "ADC codes of channel 3",
    },
    ColumnSpec {
        name: "code_c4",
        unit: "1",
        doc: "ADC codes of channel 4",
    },
];

/// One capture of the four probe channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// Conditions of the capture.
    pub meta: CaptureMeta,
    /// ADC codes of channels 1…4, all of one length.
    pub codes: [Vec<i16>; 4],
}

/// Conditions of a capture.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CaptureMeta {
    /// Label of the measurement: the fixture and the point.
    pub label: String,
    /// Frequency of the excitation, Hz; 0 for direct currents.
    pub freq_hz: f64,
    /// Time between two samples, s.
    pub interval_s: f64,
    /// Bench time of sample 0, s.
    pub start_s: f64,
    /// Scaling of channels 1…4.
    pub channels: [ChannelMeta; 4],
}

/// Scaling of one channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelMeta {
    /// Meaning of the codes.
    #[serde(flatten)]
    pub scale: CodeScale,
    /// Vertical scale of the capture, V per division.
    pub volts_per_div: f64,
}

impl Capture {
    /// Returns the channels, ready to be fitted, which borrow the codes.
    pub fn channels(&self) -> [Channel<'_>; 4] {
        std::array::from_fn(|index| {
            Channel::codes(&self.codes[index], self.meta.channels[index].scale)
        })
    }
}

/// Writes a capture as Parquet, [`CAPTURE_COLUMNS`].
///
/// # Errors
/// [`DatasetError::Column`] if the channels are not of one length; [`DatasetError::Io`],
/// [`DatasetError::Parquet`].
pub fn write_capture(path: &Path, capture: &Capture) -> Result<(), DatasetError> {
    let length = capture.codes[0].len();
    let mut columns = Vec::new();
    for (spec, codes) in CAPTURE_COLUMNS.iter().zip(&capture.codes) {
        if codes.len() != length {
            let expected = format!("{length} samples as in {}", CAPTURE_COLUMNS[0].name);
            return Err(column_error(
                path,
                spec.name,
                &expected,
                codes.len().to_string(),
            ));
        }
        let codes: Vec<i32> = codes.iter().map(|code| i32::from(*code)).collect();
        columns.push(Column::new(spec.name.into(), codes));
    }
    let mut frame = DataFrame::new(length, columns)
        .map_err(|source| parquet_error(path, "arrange the columns", source))?;
    write_frame(path, &mut frame, CAPTURE_COLUMNS, pairs(&capture.meta))
}

/// Reads a capture exactly as it was written.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Checksum`], [`DatasetError::Parquet`],
/// [`DatasetError::Column`], [`DatasetError::Metadata`].
pub fn read_capture(path: &Path) -> Result<Capture, DatasetError> {
    let (frame, metadata) = read_frame(path)?;
    let meta = read_meta(path, &metadata)?;
    let [a, b, c, d] = [0, 1, 2, 3].map(|index| codes(path, &frame, CAPTURE_COLUMNS[index].name));
    Ok(Capture {
        meta,
        codes: [a?, b?, c?, d?],
    })
}

fn column_error(path: &Path, column: &str, expected: &str, found: String) -> DatasetError {
    DatasetError::Column {
        path: path.to_path_buf(),
        column: column.to_owned(),
        expected: expected.to_owned(),
        found,
    }
}

pub(super) fn codes(path: &Path, frame: &DataFrame, name: &str) -> Result<Vec<i16>, DatasetError> {
    const EXPECTED: &str = "whole numbers of 16 bits without gaps";
    let wrong = |found: String| column_error(path, name, EXPECTED, found);
    let column = frame
        .column(name)
        .map_err(|_| wrong("no such column".into()))?;
    if column.dtype() != &DataType::Int32 {
        return Err(wrong(format!("the type {}", column.dtype())));
    }
    let cells = column.i32().map_err(|error| wrong(error.to_string()))?;
    let code = |(row, cell): (usize, Option<i32>)| {
        let cell = cell.ok_or_else(|| wrong(format!("an empty cell in row {}", row + 1)))?;
        i16::try_from(cell).map_err(|_| wrong(format!("{cell} in row {}", row + 1)))
    };
    cells.iter().enumerate().map(code).collect()
}

/// Reads the metadata of a file.
pub(super) fn read_meta(
    path: &Path,
    pairs: &BTreeMap<String, String>,
) -> Result<CaptureMeta, DatasetError> {
    Metadata { path, pairs }.capture()
}

fn pairs(meta: &CaptureMeta) -> Vec<(String, String)> {
    let mut pairs = vec![
        ("label".to_owned(), meta.label.clone()),
        ("freq_hz".to_owned(), format!("{:?}", meta.freq_hz)),
        ("interval_s".to_owned(), format!("{:?}", meta.interval_s)),
        ("start_s".to_owned(), format!("{:?}", meta.start_s)),
    ];
    for (index, channel) in meta.channels.iter().enumerate() {
        let CodeScale {
            volts_per_code,
            offset_v,
            code_min,
            code_max,
            code_step,
        } = channel.scale;
        let mut put =
            |name: &str, value: String| pairs.push((format!("c{}.{name}", index + 1), value));
        put("volts_per_code", format!("{volts_per_code:?}"));
        put("offset_v", format!("{offset_v:?}"));
        put("volts_per_div", format!("{:?}", channel.volts_per_div));
        put("code_min", code_min.to_string());
        put("code_max", code_max.to_string());
        put("code_step", code_step.to_string());
    }
    pairs
}

struct Metadata<'a> {
    path: &'a Path,
    pairs: &'a BTreeMap<String, String>,
}

impl Metadata<'_> {
    fn capture(&self) -> Result<CaptureMeta, DatasetError> {
        let [a, b, c, d] = [1, 2, 3, 4].map(|number| self.channel(number));
        Ok(CaptureMeta {
            label: self.get("label", "a text")?,
            freq_hz: self.get("freq_hz", "a number")?,
            interval_s: self.get("interval_s", "a number")?,
            start_s: self.get("start_s", "a number")?,
            channels: [a?, b?, c?, d?],
        })
    }

    fn channel(&self, number: usize) -> Result<ChannelMeta, DatasetError> {
        let key = |name: &str| format!("c{number}.{name}");
        let scale = CodeScale {
            volts_per_code: self.get(&key("volts_per_code"), "a number")?,
            offset_v: self.get(&key("offset_v"), "a number")?,
            code_min: self.get(&key("code_min"), "a whole number of 16 bits")?,
            code_max: self.get(&key("code_max"), "a whole number of 16 bits")?,
            // Captures of the first version lack it.
            code_step: if self.pairs.contains_key(&key("code_step")) {
                self.get(&key("code_step"), "a whole number above 0")?
            } else {
                1
            },
        };
        Ok(ChannelMeta {
            scale,
            volts_per_div: self.get(&key("volts_per_div"), "a number")?,
        })
    }

    fn get<T: std::str::FromStr>(
        &self,
        key: &str,
        expected: &'static str,
    ) -> Result<T, DatasetError> {
        let text = self.pairs.get(key);
        let found = || text.cloned().unwrap_or_else(|| "no such entry".to_owned());
        text.and_then(|text| text.parse().ok())
            .ok_or_else(|| DatasetError::Metadata {
                path: self.path.to_path_buf(),
                key: key.to_owned(),
                expected,
                found: found(),
            })
    }
}
