//! Converts Zahner's binary spectra, `.ism`, to text with frequency, modulus and phase.
//!
//! The layout follows the manufacturer's own reader, zahner_analysis 26.42 (MIT): two six-byte
//! integers, a version and the number of points minus one; then frequencies in Hz, moduli in Ω and
//! phases in rad as lists of eight-byte numbers. All are big-endian.

use super::error::FormatError;
use std::fmt::Write as _;
use std::path::Path;

/// Bytes before the lists.
const HEAD: usize = 12;
/// Bytes of a point: frequency, modulus, phase and time, and a weight of two bytes.
const POINT: usize = 4 * 8 + 2;
/// Plausible frequencies, Hz, and moduli, Ω: ten times wider on each side than the manufacturer's
/// data sheets, which state 10 µHz to 12 MHz and 1 µΩ to 1000 TΩ. The format has no magic number.
const HERTZ: std::ops::RangeInclusive<f64> = 1.0e-6..=1.2e8;
const OHM: std::ops::RangeInclusive<f64> = 1.0e-7..=1.0e16;

/// A spectrum as text, and remarks on it.
#[derive(Debug)]
pub(super) struct Decoded {
    pub(super) text: String,
    pub(super) note: Option<String>,
}

/// Returns the text of a file; `None` if its bytes are not such lists.
///
/// # Errors
/// [`FormatError::Decode`] for a file named `.ism` with other bytes.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<Result<Decoded, FormatError>> {
    let named = path
        .extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("ism"));
    match points(bytes) {
        Some(points) => Some(Ok(decoded(path, &points))),
        None if named => Some(Err(FormatError::Decode {
            file: path.to_owned(),
            kind: "a Zahner .ism",
            reason: "its numbers are not frequencies, moduli and phases; it is truncated or has \
                     another version; export it as a text list"
                .to_owned(),
        })),
        None => None,
    }
}

/// Frequency, modulus and phase of every point.
fn points(bytes: &[u8]) -> Option<Vec<[f64; 3]>> {
    let count = bytes
        .get(6..HEAD)?
        .iter()
        .fold(0_u64, |all, byte| all << 8 | u64::from(*byte));
    let count = usize::try_from(count).ok()?.checked_add(1)?;
    if count.checked_mul(POINT)?.checked_add(HEAD)? > bytes.len() {
        return None;
    }
    let lists = bytes.get(HEAD..HEAD + 3 * 8 * count)?;
    let mut numbers = lists
        .as_chunks()
        .0
        .iter()
        .map(|eight| f64::from_be_bytes(*eight));
    let mut list = || -> Vec<f64> { numbers.by_ref().take(count).collect() };
    let (freq_hz, modulus_ohm, phase_rad) = (list(), list(), list());
    let is_one = freq_hz.iter().all(|f| HERTZ.contains(f))
        && modulus_ohm.iter().all(|z| OHM.contains(z))
        && phase_rad
            .iter()
            .all(|phase| phase.abs() <= 10.0 * std::f64::consts::TAU);
    let row = |k: usize| [freq_hz[k], modulus_ohm[k], phase_rad[k]];
    is_one.then(|| (0..count).map(row).collect())
}

fn decoded(path: &Path, points: &[[f64; 3]]) -> Decoded {
    let kept = sweep(points);
    let mut text = "freq/Hz\t|Z|/Ohm\tPhase/rad\n".to_owned();
    for [freq_hz, modulus_ohm, phase_rad] in kept {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{freq_hz:?}\t{modulus_ohm:?}\t{phase_rad:?}");
    }
    Decoded {
        text,
        note: note(path, points.len() - kept.len()),
    }
}

/// Returns the sweep between the highest and the lowest frequency. The instrument starts in the
/// middle of the band and measures that part twice; the manufacturer's programs show only this
/// sweep.
pub(super) fn sweep(points: &[[f64; 3]]) -> &[[f64; 3]] {
    let place = |better: fn(f64, f64) -> bool| {
        (1..points.len()).fold(0, |best, k| {
            if better(points[k][0], points[best][0]) {
                k
            } else {
                best
            }
        })
    };
    let (low, high) = (place(|a, b| a < b), place(|a, b| a > b));
    points
        .get(low.min(high)..=low.max(high))
        .unwrap_or_default()
}

/// Returns the remark on points outside the sweep.
pub(super) fn note(path: &Path, left_out: usize) -> Option<String> {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    (left_out > 0).then(|| {
        format!(
            "{file}: {left_out} points outside the sweep from the highest to the lowest frequency, \
             which are measured twice, are left out"
        )
    })
}
