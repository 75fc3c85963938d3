//! Captures that a scope has exported, described by a TOML file: which channel is what, by which
//! shunt, at which frequency. They go through the fit and the impedance of the main job; there are
//! no controls, so that nothing is corrected.

use std::path::Path;

use analysis::{
    dataset,
    formats::scope::{ScopeRecord, open_scope},
    numeric::Covariance2,
    run_folder::SPECTRUM,
    sine::{self, Channel, FitOptions, Record},
    spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance, raw_impedance},
};
use num_complex::Complex64;
use serde::Deserialize;

use bench_core::{record::RecordError, safety::failure::Failure};
use bench_evaluate::support::present::significant;
use bench_plan::{
    config::{
        Source,
        quantity::{Duration, Frequency, Quantity, Resistance},
    },
    measure::HARMONICS,
    support::terminal::say,
};

/// Harmonics of the mains that are fitted.
const MAINS_ORDERS: u32 = 3;

/// `capture.toml` as typed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Typed {
    name: String,
    current: Pair,
    voltage: Pair,
    mains: Option<Quantity<Frequency>>,
    capture: Vec<Typing>,
}

/// A difference of two channels, or one channel; counted from 1 through the files of a capture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    plus: usize,
    minus: Option<usize>,
    /// Of the current: what it flows through.
    shunt: Option<Quantity<Resistance>>,
    /// Of the current: what a volt of the channel stands for, A.
    amps_per_volt: Option<f64>,
    /// Voltage at the probe for one volt of the channel, V: of a probe that the scope does not
    /// know.
    gain: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Typing {
    frequency: Quantity<Frequency>,
    files: Vec<String>,
    interval: Option<Quantity<Duration>>,
}

/// Replays the captures of a description.
///
/// # Errors
/// A description or a capture that is not as expected; a folder in use.
pub(super) fn replay(path: &Path, out: Option<&Path>) -> Result<(), Failure> {
    let source = Source::read(path)?;
    let typed: Typed = source.parse()?;
    let probes = Probes {
        current: Scaled::current(&source, &typed.current)?,
        voltage: Scaled::voltage(&source, &typed.voltage)?,
    };
    let mut points: Vec<ImpedancePoint> = Vec::new();
    say!(
        "{}: {} captures of {}",
        path.display(),
        typed.capture.len(),
        typed.name
    );
    say!(
        "  {:>12} {:>22} {:>18} {:>11} {:>9} {:>8}  kind",
        "f / Hz",
        "|Z| ± σ / mΩ",
        "phase ± σ / °",
        "current / A",
        "clipped",
        "samples"
    );
    for (number, capture) in (1..).zip(&typed.capture) {
        let complain = |reason: String| source.complain(&format!("capture.{number}"), reason);
        let interval_s = capture.interval.map(|interval| interval.si);
        let records: Vec<ScopeRecord> = capture
            .files
            .iter()
            .map(|file| {
                open_scope(&source.relative(file), interval_s)
                    .map_err(|error| complain(error.to_string()))
            })
            .collect::<Result<_, _>>()?;
        let (point, remark) = impedance(
            &records,
            probes,
            capture.frequency.si,
            typed.mains.map(|mains| mains.si),
        )
        .map_err(complain)?;
        tell(&point, &remark);
        points.push(point);
    }
    points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
    if let Some(out) = out {
        if std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(RecordError::NotEmpty {
                path: out.to_owned(),
            }
            .into());
        }
        std::fs::create_dir_all(out)?;
        dataset::write_spectrum_csv(&out.join(SPECTRUM), &points).map_err(RecordError::from)?;
        say!("  written: {}", out.join(SPECTRUM).display());
    }
    Ok(())
}

fn tell(point: &ImpedancePoint, remark: &Remark) {
    let with =
        |value: f64, sigma: f64, digits: usize| format!("{value:.digits$} ± {sigma:.digits$}");
    say!(
        "  {:>12} {:>22} {:>18} {:>11} {:>7.2} % {:>8}  {}",
        significant(point.freq_hz, 6),
        with(
            1.0e3 * point.magnitude_ohm(),
            1.0e3 * point.magnitude_sigma_ohm(),
            4
        ),
        with(
            point.phase_rad().to_degrees(),
            point.phase_sigma_rad().to_degrees(),
            3
        ),
        significant(point.amplitude_a, 4),
        100.0 * remark.clipped,
        remark.samples,
        remark.kind
    );
    remark.notes.iter().for_each(|note| say!("    {note}"));
}

/// One or two channels and the factor that makes a quantity of their volts.
#[derive(Debug, Clone, Copy)]
struct Scaled {
    plus: usize,
    minus: Option<usize>,
    factor: f64,
}

impl Scaled {
    fn current(source: &Source, pair: &Pair) -> Result<Self, Failure> {
        let factor = match (pair.shunt, pair.amps_per_volt, pair.gain) {
            (Some(shunt), None, None) => shunt.si.recip(),
            (None, Some(amps), None) => amps,
            _ => {
                return Err(source
                    .complain(
                        "current",
                        "expected either `shunt` or `amps_per_volt`, and no `gain`",
                    )
                    .into());
            }
        };
        Self::checked(source, "current", pair, factor)
    }

    fn voltage(source: &Source, pair: &Pair) -> Result<Self, Failure> {
        if pair.shunt.is_some() || pair.amps_per_volt.is_some() {
            return Err(source
                .complain(
                    "voltage",
                    "expected `plus`, `minus` and `gain`, found what belongs to the current",
                )
                .into());
        }
        Self::checked(source, "voltage", pair, pair.gain.unwrap_or(1.0))
    }

    fn checked(source: &Source, field: &str, pair: &Pair, factor: f64) -> Result<Self, Failure> {
        if pair.plus == 0 || pair.minus == Some(0) || pair.minus == Some(pair.plus) {
            return Err(source
                .complain(field, "expected two channels that differ, counted from 1")
                .into());
        }
        if !(factor.is_finite() && factor != 0.0) {
            return Err(source
                .complain(
                    field,
                    format!("expected a factor other than zero, found {factor}"),
                )
                .into());
        }
        Ok(Self {
            plus: pair.plus - 1,
            minus: pair.minus.map(|minus| minus - 1),
            factor,
        })
    }
}

/// The channels of current and voltage.
#[derive(Clone, Copy)]
struct Probes {
    current: Scaled,
    voltage: Scaled,
}

/// Remarks on a capture besides its impedance.
struct Remark {
    clipped: f64,
    samples: usize,
    kind: &'static str,
    notes: Vec<String>,
}

fn impedance(
    records: &[ScopeRecord],
    probes: Probes,
    freq_hz: f64,
    mains_hz: Option<f64>,
) -> Result<(ImpedancePoint, Remark), String> {
    let Probes { current, voltage } = probes;
    let first = records.first().ok_or("expected at least one file")?;
    if let Some(other) = records
        .iter()
        .find(|record| record.samples != first.samples || record.interval_s != first.interval_s)
    {
        return Err(format!(
            "expected {} samples every {} s in each file, found {} every {} s",
            first.samples, first.interval_s, other.samples, other.interval_s
        ));
    }
    let all: Vec<Channel<'_>> = records
        .iter()
        .flat_map(|record| (0..record.names.len()).filter_map(|index| record.channel(index)))
        .collect();
    let wanted: Vec<usize> = [
        Some(current.plus),
        current.minus,
        Some(voltage.plus),
        voltage.minus,
    ]
    .into_iter()
    .flatten()
    .collect();
    let missing = |index: &&usize| **index >= all.len();
    if let Some(index) = wanted.iter().find(missing) {
        return Err(format!(
            "expected a channel {}, found {} in the files",
            index + 1,
            all.len()
        ));
    }
    let channels: Vec<Channel<'_>> = wanted
        .iter()
        .filter_map(|index| all.get(*index).copied())
        .collect();
    let record = Record {
        channels: &channels,
        interval_s: first.interval_s,
    };
    let mut options = FitOptions {
        harmonics: HARMONICS.to_vec(),
        ..FitOptions::default()
    };
    if let Some(mains_hz) = mains_hz {
        options = options.with_mains(mains_hz, MAINS_ORDERS);
    }
    // The generator's clock and the scope's are two.
    let fit = sine::fit_free_frequency(&record, Some(freq_hz), &options)
        .map_err(|error| error.to_string())?;
    let of = |index: Option<usize>, factor: f64| {
        let found = index
            .and_then(|index| wanted.iter().position(|known| *known == index))
            .and_then(|place| fit.channels.get(place));
        let variance = |covariance: Covariance2| PhasorVariance {
            noise: covariance,
            ..PhasorVariance::circular(0.0)
        };
        found.map_or(
            (Complex64::ZERO, PhasorVariance::circular(0.0)),
            |channel| {
                (
                    channel.phasor * factor,
                    variance(channel.variance.scaled(Complex64::from(factor))),
                )
            },
        )
    };
    // Amperes take the place of the shunt's volts: a shunt of one ohm.
    let four = [
        of(current.minus, current.factor),
        of(Some(current.plus), current.factor),
        of(voltage.minus, voltage.factor),
        of(Some(voltage.plus), voltage.factor),
    ];
    let phasors = ChannelPhasors {
        freq_hz: fit.freq_hz,
        volts: four.map(|one| one.0),
        variance: four.map(|one| one.1),
    };
    let clipped = fit
        .channels
        .iter()
        .map(|channel| channel.clipped_samples as f64 / fit.samples as f64)
        .fold(0.0, f64::max);
    let mut notes: Vec<String> = fit.notes.iter().map(ToString::to_string).collect();
    let asked = format!(
        "the frequency is {:.6} Hz, {:+.1} ppm from what is described",
        fit.freq_hz,
        1.0e6 * (fit.freq_hz / freq_hz - 1.0)
    );
    notes.insert(0, asked);
    Ok((
        raw_impedance(&phasors, 1.0),
        Remark {
            clipped,
            samples: first.samples,
            kind: first.kind,
            notes,
        },
    ))
}
