//! Impedance from cross spectra of current and voltage.

use std::f64::consts::TAU;

use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;
use rayon::prelude::*;

use super::{
    grid::{Piece, pieces as pieces_of, without_line},
    lag::{Lag, LagFit, LagKind, fit_lag},
    record::{UsageError, UsageRecord},
    result::{CellUsage, RefusedBand, Usage},
    string::string,
};

/// Shortest window, samples: its highest frequency is a fifth of the sampling rate.
const SHORTEST: usize = 32;
/// Pairs of bins of a window that are evaluated, in periods over the window; the next longer window
/// begins an octave below.
const BINS: [[usize; 2]; 2] = [[4, 5], [6, 7]];
/// Fewest windows of a length.
const FEWEST_WINDOWS: usize = 8;
/// Independent estimates that one window and a pair of bins contribute: windows overlap by half, and
/// neighbouring bins of a Hann window correlate.
const INDEPENDENT: f64 = 1.3;
/// Greatest relative uncertainty of an impedance that is stated.
const GREATEST: f64 = 0.1;
/// Least relative uncertainty: what the interpolation between jittered stamps and the load within an
/// interval leave.
const LEAST: f64 = 0.01;

/// Sums of spectra over windows and a pair of bins.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    current: f64,
    voltage: f64,
    cross: Complex64,
    windows: usize,
}

/// Estimates the impedance of each cell, and compares the cells of a string.
///
/// # Errors
/// [`UsageError`] for an invalid record, or a current without power at any frequency.
pub fn usage(record: &UsageRecord) -> Result<Usage, UsageError> {
    record.check()?;
    let (interval_s, pieces) = pieces_of(record);
    let lag_of = |cells: &[CellUsage]| {
        let spectra: Vec<&Spectrum> = cells.iter().map(|cell| &cell.spectrum).collect();
        fit_lag(&spectra, interval_s)
    };
    let mut cells = estimate(record, &pieces, interval_s)?;
    let mut lag = lag_of(&cells).filter(LagFit::is_certain).map(|fit| fit.lag);
    if let Some(lag) = &mut lag {
        let mut left = *lag;
        if lag.kind == LagKind::Delay {
            let without = |lag_s: f64| {
                let earlier = record.with_current_earlier(lag_s);
                estimate(&earlier, &pieces_of(&earlier).1, interval_s)
            };
            // The windows of the two channels differ by the delay, which lowers the impedance: the
            // record is read again without it, twice, because what is left shows better then.
            for _ in 0..2 {
                let rest = lag_of(&without(lag.lag_s)?);
                if let Some(rest) = rest.filter(|rest| rest.lag.kind == LagKind::Delay) {
                    lag.lag_s += rest.lag.lag_s;
                    lag.sigma_s = rest.lag.sigma_s;
                }
            }
            cells = without(lag.lag_s)?;
            left = Lag { lag_s: 0.0, ..*lag };
        }
        for cell in &mut cells {
            left.remove(&mut cell.spectrum);
            cell.refuse_uncertain();
        }
        check_power(&cells)?;
    }
    let names: Vec<&str> = record.cells.iter().map(|cell| cell.name.as_str()).collect();
    let samples: usize = pieces.iter().map(|piece| piece.current_a.len()).sum();
    Ok(Usage {
        interval_s,
        length_s: samples as f64 * interval_s,
        lag,
        cells,
        string: string(&names, &pieces, interval_s),
    })
}

/// Estimates the impedances as the channels of a record show them; `pieces` are those of the record.
fn estimate(
    record: &UsageRecord,
    pieces: &[Piece],
    interval_s: f64,
) -> Result<Vec<CellUsage>, UsageError> {
    let halves = [
        record.part(0, record.time_s.len() / 2),
        record.part(record.time_s.len() / 2, record.time_s.len()),
    ]
    .map(|half| pieces_of(&half).1);
    let cell = |index: usize| {
        let name = &record.cells[index].name;
        let (spectrum, refused) = impedance(name, pieces, index, interval_s);
        let [first, second] = halves
            .each_ref()
            .map(|half| impedance(name, half, index, interval_s).0);
        CellUsage {
            spectrum,
            refused,
            change: change(&first, &second),
        }
    };
    let cells: Vec<CellUsage> = (0..record.cells.len()).into_par_iter().map(cell).collect();
    check_power(&cells)?;
    Ok(cells)
}

/// Refuses cells of which no impedance is left.
fn check_power(cells: &[CellUsage]) -> Result<(), UsageError> {
    if cells.iter().any(|cell| !cell.spectrum.points.is_empty()) {
        return Ok(());
    }
    let tried = cells
        .first()
        .map_or(&[][..], |cell| cell.refused.as_slice());
    Err(UsageError::NoPower {
        expected_percent: 100.0 * GREATEST,
        from_hz: tried.first().map_or(f64::NAN, |band| band.freq_hz),
        to_hz: tried.last().map_or(f64::NAN, |band| band.freq_hz),
    })
}

impl CellUsage {
    /// Refuses points whose uncertainty has become too great.
    fn refuse_uncertain(&mut self) {
        let relative = |p: &ImpedancePoint| {
            let both = p.covariance.re_re + p.covariance.im_im;
            both.sqrt() / p.magnitude_ohm()
        };
        let points = std::mem::take(&mut self.spectrum.points);
        let (kept, refused) = points
            .into_iter()
            .partition::<Vec<_>, _>(|point| relative(point) <= GREATEST);
        self.spectrum.points = kept;
        self.refused.extend(refused.iter().map(|point| RefusedBand {
            freq_hz: point.freq_hz,
            uncertainty: relative(point),
        }));
        self.refused.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
    }
}

/// Returns the impedance of one cell by rising frequency, and the frequencies that are refused.
fn impedance(
    name: &str,
    pieces: &[Piece],
    cell: usize,
    interval_s: f64,
) -> (Spectrum, Vec<RefusedBand>) {
    let longest = pieces
        .iter()
        .map(|piece| piece.current_a.len())
        .max()
        .unwrap_or(0);
    let lengths = std::iter::successors(Some(SHORTEST), |length| Some(2 * length));
    let lengths: Vec<usize> = lengths.take_while(|length| *length <= longest).collect();
    let (mut points, mut refused) = (Vec::new(), Vec::new());
    for length in lengths.into_iter().rev() {
        for bins in BINS {
            let sums = sums(pieces, cell, length, bins);
            let freq_hz = 0.5 * (bins[0] + bins[1]) as f64 / (length as f64 * interval_s);
            let coherence = sums.cross.norm_sqr() / (sums.current * sums.voltage);
            if sums.windows == 0 {
                continue;
            }
            let z_ohm = sums.cross / sums.current;
            let uncertainty = uncertainty(coherence, sums.windows);
            if sums.windows < FEWEST_WINDOWS || uncertainty > GREATEST {
                refused.push(RefusedBand {
                    freq_hz,
                    uncertainty,
                });
                continue;
            }
            points.push(ImpedancePoint {
                freq_hz,
                z_ohm,
                covariance: Covariance2::circular(0.5 * (uncertainty * z_ohm.norm()).powi(2)),
                amplitude_a: f64::NAN,
            });
        }
    }
    (Spectrum::new(name.to_owned(), points), refused)
}

/// Returns the relative standard uncertainty of an impedance: its scatter over the windows, and its bias.
///
/// Noise of the current sensor lowers the impedance by its share of the current's power, noise of the
/// voltage does not; the coherence does not tell the two apart, so all of what it lacks counts as bias.
fn uncertainty(coherence: f64, windows: usize) -> f64 {
    if !coherence.is_finite() {
        // A current that is zero throughout.
        return f64::INFINITY;
    }
    let lacking = (1.0 - coherence).max(0.0);
    let scatter = (lacking / (coherence * INDEPENDENT * windows as f64)).sqrt();
    scatter.hypot(lacking).max(LEAST)
}

/// Sums over all windows of a length that overlap by half, without a straight line in each.
fn sums(pieces: &[Piece], cell: usize, length: usize, bins: [usize; 2]) -> Sums {
    let window: Vec<f64> = (0..length)
        .map(|k| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / length as f64).cos())
        .collect();
    let mut all = Sums::default();
    for piece in pieces {
        let voltage_v = &piece.voltages_v[cell];
        let count = piece.current_a.len();
        let mut from = 0;
        while from + length <= count {
            let current = without_line(&piece.current_a[from..from + length]);
            let voltage = without_line(&voltage_v[from..from + length]);
            for bin in bins {
                let i = transformed(&current, &window, bin);
                let u = transformed(&voltage, &window, bin);
                all.current += i.norm_sqr();
                all.voltage += u.norm_sqr();
                all.cross += u * i.conj();
            }
            all.windows += 1;
            from += length / 2;
        }
    }
    all
}

fn transformed(values: &[f64], window: &[f64], bin: usize) -> Complex64 {
    let turn = Complex64::cis(-TAU * bin as f64 / values.len() as f64);
    let mut phase = Complex64::ONE;
    let mut sum = Complex64::ZERO;
    for (value, weight) in values.iter().zip(window) {
        sum += phase * (value * weight);
        phase *= turn;
    }
    sum
}

/// Returns the mean relative change of |Z| between two spectra, weighted by its uncertainty.
fn change(first: &Spectrum, second: &Spectrum) -> Option<[f64; 2]> {
    let pairs = first.points.iter().filter_map(|a| {
        let b = second
            .points
            .iter()
            .find(|b| (b.freq_hz / a.freq_hz - 1.0).abs() < 1e-6)?;
        let relative = |p: &ImpedancePoint| p.magnitude_sigma_ohm() / p.magnitude_ohm();
        let variance = relative(a).powi(2) + relative(b).powi(2);
        Some(((b.magnitude_ohm() / a.magnitude_ohm()).ln(), variance))
    });
    let (sum, weight) = pairs.fold((0.0, 0.0), |(sum, weight), (value, variance)| {
        (sum + value / variance, weight + variance.recip())
    });
    (weight > 0.0).then(|| [sum / weight, weight.sqrt().recip()])
}
