//! Harmonics of sweeps as a table.

use std::{fmt::Write as _, path::Path};

use analysis_numeric::Covariance2;
use analysis_signal::nonlinear::HarmonicPoint;
use num_complex::Complex64;

use super::HARMONICS;
use crate::table::{Hash, Row, Table};

/// Columns of [`HARMONICS`].
pub const HARMONIC_COLUMNS: &str = "sweep,bias_a,amplitude_a,freq_hz,order,z_re,z_im,sigma_re,\
    sigma_im,cov_re_im,unit";

/// A harmonic of a sweep; order 1 is the impedance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepHarmonic {
    /// Number of the sweep among those of the cell, from 1.
    pub sweep: usize,
    /// Direct current, A, charge positive.
    pub bias_a: f64,
    /// The harmonic.
    pub point: HarmonicPoint,
}

/// Reads a table of harmonics.
///
/// # Errors
/// Text that names the file, and the line and the column if a field is not what its column holds.
pub fn read_harmonics(path: &Path) -> Result<Vec<SweepHarmonic>, String> {
    let table = Table::read(path, Hash::Row).map_err(|error| error.to_string())?;
    let columns: Vec<&str> = HARMONIC_COLUMNS.split(',').collect();
    if table.columns != columns {
        return Err(format!(
            "{}: expected the file {HARMONICS} of a run folder, with the columns {HARMONIC_COLUMNS}, found {}",
            path.display(),
            table.columns.join(",")
        ));
    }
    let harmonic = |row: &Row| {
        let expected = |column: usize, what: &str| {
            format!(
                "{}: line {}, column {}: expected {what}, found {:?}",
                path.display(),
                row.line,
                columns[column],
                row.field(column)
            )
        };
        let number = |column: usize| {
            let value = row.number(column).filter(|value| value.is_finite());
            value.ok_or_else(|| expected(column, "a number"))
        };
        let count = |column: usize| {
            let value = row.field(column).parse::<u32>().ok().filter(|n| *n > 0);
            value.ok_or_else(|| expected(column, "a whole number above zero"))
        };
        Ok(SweepHarmonic {
            sweep: count(0)? as usize,
            bias_a: number(1)?,
            point: HarmonicPoint {
                amplitude_a: number(2)?,
                freq_hz: number(3)?,
                order: count(4)?,
                z: Complex64::new(number(5)?, number(6)?),
                covariance: Covariance2 {
                    re_re: number(7)?.powi(2),
                    im_im: number(8)?.powi(2),
                    re_im: number(9)?,
                },
            },
        })
    };
    table.rows.iter().map(harmonic).collect()
}

/// Returns the table of harmonics as text.
pub fn harmonics_csv(harmonics: impl IntoIterator<Item = SweepHarmonic>) -> String {
    let mut text = format!("{HARMONIC_COLUMNS}\n");
    for SweepHarmonic {
        sweep,
        bias_a,
        point,
    } in harmonics
    {
        let covariance = point.covariance;
        let _ = writeln!(
            text,
            "{sweep},{bias_a},{},{},{},{:e},{:e},{:e},{:e},{:e},{}",
            point.amplitude_a,
            point.freq_hz,
            point.order,
            point.z.re,
            point.z.im,
            covariance.re_re.sqrt(),
            covariance.im_im.sqrt(),
            covariance.re_im,
            point.unit()
        );
    }
    text
}
