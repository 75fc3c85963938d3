//! Stores results on disk as they arrive, and merges them into one table.
//!
//! While the table `results.parquet` is being made, the folder `results.parquet.parts` beside it
//! holds `call.txt`, which identifies the call, and one Parquet file for each finished part. A part
//! is written to a temporary file and renamed, so that it is either complete or absent.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use polars::prelude::{
    CsvWriter, DataFrame, KeyValueMetadata, ParquetReader, ParquetWriter, PolarsError, SerReader,
    SerWriter,
};

use analysis_fit::fit::PROGRAM;
use analysis_fit::rows::{ResultColumn, ResultRow};

use super::error::BatchError;
use super::results::frame;
use crate::dataset::write_atomically;

/// File that identifies the call.
const CALL: &str = "call.txt";

/// Form of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Csv,
    Parquet,
}

/// Path of a table of results, and the call that makes it.
#[derive(Debug, Clone)]
pub struct PartsPlan {
    /// The table: `.parquet` or `.csv`.
    pub out: PathBuf,
    /// All inputs that determine the results, as text: a call with other inputs must not continue
    /// these parts.
    pub call: String,
    /// Columns of the table.
    pub columns: Vec<ResultColumn>,
}

/// Results on disk that become one table.
#[derive(Debug)]
pub struct Parts {
    plan: PartsPlan,
    form: Form,
    folder: PathBuf,
}

impl Parts {
    /// Creates the parts of a table, or continues those of the same call.
    ///
    /// # Errors
    /// [`BatchError`]: a name that is neither `.parquet` nor `.csv`, a table that already exists,
    /// parts of another call, a folder that cannot be written.
    pub fn begin(plan: PartsPlan) -> Result<Self, BatchError> {
        let out = &plan.out;
        let extension = out.extension().and_then(|extension| extension.to_str());
        let form = match extension {
            Some("parquet") => Form::Parquet,
            Some("csv") => Form::Csv,
            _ => {
                return Err(BatchError::Row {
                    path: out.clone(),
                    place: "name".to_owned(),
                    expected: "a table named .parquet or .csv",
                    met: extension.unwrap_or("no extension").to_owned(),
                });
            }
        };
        let taken = |path: &Path, met: String| BatchError::Taken {
            path: path.to_path_buf(),
            met,
        };
        if out.exists() {
            return Err(taken(out, "a file; nothing is written over".to_owned()));
        }
        let mut folder = out.clone().into_os_string();
        folder.push(".parts");
        let folder = PathBuf::from(folder);
        let call = folder.join(CALL);
        if folder.exists() {
            let met = fs::read_to_string(&call).map_err(|source| io(&call, READ, source))?;
            if met != plan.call {
                return Err(taken(&folder, format!("the parts of `{}`", met.trim())));
            }
        } else {
            fs::create_dir_all(&folder).map_err(|source| io(&folder, "make the folder", source))?;
            write_atomically(&call, plan.call.as_bytes())?;
        }
        Ok(Self { plan, form, folder })
    }

    /// Returns whether a part is done.
    pub fn is_done(&self, part: usize) -> bool {
        self.path(part).exists()
    }

    /// Writes a part.
    ///
    /// # Errors
    /// [`BatchError`] for a folder that cannot be written.
    pub fn write(&self, part: usize, rows: &[ResultRow]) -> Result<(), BatchError> {
        let path = self.path(part);
        let failed = |source| parquet(&path, "encode the results", source);
        let mut frame = frame(&self.plan.columns, rows).map_err(failed)?;
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes)
            .set_parallel(false)
            .finish(&mut frame)
            .map_err(failed)?;
        Ok(write_atomically(&path, &bytes)?)
    }

    /// Merges the first `count` parts into the table, and removes them.
    ///
    /// # Errors
    /// [`BatchError`] if a part cannot be read or the table cannot be written; the parts are then
    /// kept.
    pub fn finish(self, count: usize) -> Result<(), BatchError> {
        let out = &self.plan.out;
        let hidden = self.folder.join("table");
        let file = File::create(&hidden).map_err(|source| io(&hidden, WRITE, source))?;
        match self.form {
            Form::Parquet => self.as_parquet(&file, count)?,
            Form::Csv => self.as_csv(&file, count)?,
        }
        file.sync_all()
            .and_then(|()| fs::rename(&hidden, out))
            .map_err(|source| io(out, WRITE, source))?;
        fs::remove_dir_all(&self.folder)
            .map_err(|source| io(&self.folder, "remove the parts", source))
    }

    fn as_parquet(&self, file: &File, count: usize) -> Result<(), BatchError> {
        let failed = |source| parquet(&self.plan.out, "write the table", source);
        let schema = frame(&self.plan.columns, &[]).map_err(failed)?;
        let program = vec![("program".to_owned(), PROGRAM.to_owned())];
        let mut writer = ParquetWriter::new(BufWriter::new(file))
            .set_parallel(false)
            .with_key_value_metadata(Some(KeyValueMetadata::from_static(program)))
            .batched(schema.schema())
            .map_err(failed)?;
        for part in 0..count {
            writer.write_batch(&self.read(part)?).map_err(failed)?;
        }
        writer.finish().map_err(failed).map(|_| ())
    }

    fn as_csv(&self, file: &File, count: usize) -> Result<(), BatchError> {
        let failed = |source| parquet(&self.plan.out, "write the table", source);
        let mut empty = frame(&self.plan.columns, &[]).map_err(failed)?;
        CsvWriter::new(file).finish(&mut empty).map_err(failed)?;
        for part in 0..count {
            CsvWriter::new(file)
                .include_header(false)
                .finish(&mut self.read(part)?)
                .map_err(failed)?;
        }
        Ok(())
    }

    fn read(&self, part: usize) -> Result<DataFrame, BatchError> {
        let path = self.path(part);
        let file = File::open(&path).map_err(|source| io(&path, READ, source))?;
        ParquetReader::new(file)
            .finish()
            .map_err(|source| parquet(&path, "decode the results", source))
    }

    fn path(&self, part: usize) -> PathBuf {
        self.folder.join(format!("{part:06}.parquet"))
    }
}

const READ: &str = "read the file";
const WRITE: &str = "write the file";

fn io(path: &Path, action: &'static str, source: std::io::Error) -> BatchError {
    BatchError::Io {
        path: path.to_path_buf(),
        action,
        source,
    }
}

fn parquet(path: &Path, action: &'static str, source: PolarsError) -> BatchError {
    BatchError::Parquet {
        path: path.to_path_buf(),
        action,
        source,
    }
}
