//! The record of a point of a spectrum: four channels over time with the fitted sinusoid, the
//! residual, and the amplitudes of all frequencies in the residual.

use std::path::Path;

use analysis::{
    dataset::{Capture, read_capture},
    run_folder::{self, Archived, CAMPAIGN, CAPTURES, SPECTRA},
    sine::{self, FitOptions, Record},
};
use serde::Serialize;
use utoipa::ToSchema;

use bench_plan::{measure::HARMONICS, support::confined_path};

/// Largest file that is opened for a picture, bytes.
const LARGEST: u64 = 64 * 1024 * 1024;
/// Maximum number of samples in a picture. Each interval is represented by its minimum and
/// maximum.
const MOST: usize = 2000;

/// Record of a point.
#[derive(Debug, Serialize, ToSchema)]
pub struct CaptureView {
    /// Frequency, Hz.
    freq_hz: f64,
    /// Label of the record.
    label: String,
    /// Its file in the run folder.
    path: String,
    /// Samples of each channel.
    samples: usize,
    /// Time between two samples, s.
    interval_s: f64,
    /// The four channels.
    channels: Vec<ChannelView>,
    /// Amplitudes of all frequencies, by channel.
    spectrum: Vec<AmplitudeView>,
}

/// A channel over time.
#[derive(Debug, Serialize, ToSchema)]
pub struct ChannelView {
    /// Its name.
    name: String,
    /// Unit of its values.
    unit: &'static str,
    /// Amplitude of the fitted sinusoid, V zero to peak.
    amplitude_v: f64,
    /// Root mean square of the residual of the fit, V.
    residual_rms_v: f64,
    /// Number of samples at the limits of the converter.
    clipped_samples: usize,
    /// Time since sample 0, s.
    time_s: Vec<f64>,
    /// Measured, V.
    value: Vec<f64>,
    /// Fitted, V.
    fit: Vec<f64>,
    /// Measured minus fitted, V.
    residual: Vec<f64>,
}

/// Amplitudes in a channel.
#[derive(Debug, Serialize, ToSchema)]
pub struct AmplitudeView {
    /// Name of the channel.
    name: String,
    /// Unit of the amplitudes.
    unit: &'static str,
    /// Frequencies, Hz.
    freq_hz: Vec<f64>,
    /// Amplitudes, V zero to peak.
    amplitude: Vec<f64>,
}

/// The folder of the captures of a spectrum.
fn folder_of(run: &Path, spectrum: &str) -> String {
    let name = spectrum.trim_start_matches("raw_");
    let of_campaign = name
        .strip_prefix(SPECTRA)
        .and_then(|rest| rest.strip_prefix('/'));
    if let Some(name) = of_campaign {
        return campaign_run(run, name).unwrap_or_else(|| name.to_owned());
    }
    match name.strip_prefix("spectrum") {
        Some("") => "cell".to_owned(),
        Some(rest) if rest[1..].chars().all(|c| c.is_ascii_digit()) => format!("cell{rest}"),
        Some(rest) => rest[1..].to_owned(),
        None => name.to_owned(),
    }
}

/// Captures of a campaign are numbered by its runs.
fn campaign_run(run: &Path, name: &str) -> Option<String> {
    let file = confined_path::open(run, CAMPAIGN)?;
    let campaign: serde_json::Value = serde_json::from_reader(file).ok()?;
    let wanted = run_folder::campaign_spectrum(name);
    let runs = campaign["runs"].as_array()?;
    let number = runs.iter().find(|run| run["file"] == wanted.as_str())?["number"].as_u64()?;
    Some(if number == 1 {
        "cell".to_owned()
    } else {
        format!("cell_{number}")
    })
}

/// The last record of a point, as its path in the run folder.
fn path_of(run: &Path, spectrum: &str, freq_hz: f64) -> Option<String> {
    let folder = format!("{CAPTURES}/{}", folder_of(run, spectrum));
    let wanted = format!("_{freq_hz:.6}Hz");
    let entries = std::fs::read_dir(run.join(&folder)).ok()?.flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    // Attempts are numbered; of ten or more the longer name is the later one.
    let last = names
        .filter(|name| name.starts_with("point") && name.contains(&wanted))
        .max_by_key(|name| (name.len(), name.clone()))?;
    Some(format!("{folder}/{last}"))
}

/// Describes where the record of a point was moved to, or returns `None` if it was not moved.
fn moved(run: &Path, spectrum: &str, freq_hz: f64) -> Option<String> {
    let folder = format!("{CAPTURES}/{}/point", folder_of(run, spectrum));
    let wanted = format!("_{freq_hz:.6}Hz");
    let list = Archived::read(run).ok()??;
    let of_point = |path: &str| path.starts_with(&folder) && path.contains(&wanted);
    let absent = list.absent(run);
    let found = absent.iter().any(|file| of_point(&file.path));
    found.then(|| list.words())
}

/// Returns the record of a point.
///
/// # Errors
/// In words: there is none, it cannot be read, or it cannot be fitted.
pub fn view(run: &Path, spectrum: &str, freq_hz: f64) -> Result<CaptureView, String> {
    let missing = || match moved(run, spectrum, freq_hz) {
        Some(words) => format!("the record of {freq_hz} Hz of {spectrum} was {words}"),
        None => format!("no record of {freq_hz} Hz of {spectrum} is kept in this run"),
    };
    let path = path_of(run, spectrum, freq_hz).ok_or_else(missing)?;
    let file = confined_path::open(run, &path).ok_or_else(missing)?;
    let bytes = file.metadata().map_err(|error| error.to_string())?.len();
    if bytes > LARGEST {
        return Err(format!(
            "{path}: expected at most {LARGEST} bytes for a picture, found {bytes}"
        ));
    }
    drop(file);
    let capture = read_capture(&run.join(&path)).map_err(|error| error.to_string())?;
    of(&capture, path)
}

fn of(capture: &Capture, path: String) -> Result<CaptureView, String> {
    let (channels, interval_s) = (capture.channels(), capture.meta.interval_s);
    let record = Record {
        channels: &channels,
        interval_s,
    };
    let options = FitOptions {
        harmonics: HARMONICS.to_vec(),
        ..FitOptions::default()
    };
    let fit = sine::fit_known_frequency(&record, capture.meta.freq_hz, &options)
        .map_err(|error| format!("{path}: {error}"))?;
    let mut views = Vec::new();
    let mut amplitudes = Vec::new();
    for (number, (codes, meta)) in capture.codes.iter().zip(&capture.meta.channels).enumerate() {
        let name = format!("channel {}", number + 1);
        let volts: Vec<f64> = codes.iter().map(|code| meta.scale.volts(*code)).collect();
        let model = |k: usize| {
            fit.value_v(number, k as f64 * interval_s)
                .unwrap_or(f64::NAN)
        };
        let shown = extremes(&volts, MOST);
        let of_shown = |value: &dyn Fn(usize) -> f64| shown.iter().map(|k| value(*k)).collect();
        let channel = &fit.channels[number];
        views.push(ChannelView {
            name: name.clone(),
            unit: "V",
            amplitude_v: channel.phasor.norm(),
            residual_rms_v: channel.residual_rms_v,
            clipped_samples: channel.clipped_samples,
            time_s: of_shown(&|k| k as f64 * interval_s),
            value: of_shown(&|k| volts[k]),
            fit: of_shown(&model),
            residual: of_shown(&|k| volts[k] - model(k)),
        });
        let lines = sine::amplitudes(&volts, interval_s);
        let heights: Vec<f64> = lines.iter().map(|line| line.1).collect();
        let kept: Vec<(f64, f64)> = extremes(&heights, MOST)
            .into_iter()
            .map(|k| lines[k])
            .collect();
        let (freq_hz, amplitude) = kept.into_iter().unzip();
        amplitudes.push(AmplitudeView {
            name,
            unit: "V",
            freq_hz,
            amplitude,
        });
    }
    Ok(CaptureView {
        freq_hz: capture.meta.freq_hz,
        label: capture.meta.label.clone(),
        path,
        samples: capture.codes[0].len(),
        interval_s,
        channels: views,
        spectrum: amplitudes,
    })
}

/// Returns the indices of about `most` values: all of them, or the minimum and maximum of each
/// interval.
fn extremes(values: &[f64], most: usize) -> Vec<usize> {
    if values.len() <= most {
        return (0..values.len()).collect();
    }
    let length = values.len().div_ceil(most / 2);
    let of_stretch = |(number, stretch): (usize, &[f64])| {
        let place = |pick: fn(&f64, &f64) -> bool| {
            let mut best = 0;
            for (k, value) in stretch.iter().enumerate() {
                if pick(value, &stretch[best]) {
                    best = k;
                }
            }
            number * length + best
        };
        let (low, high) = (place(|a, b| a < b), place(|a, b| a > b));
        if low == high {
            vec![low]
        } else {
            vec![low.min(high), low.max(high)]
        }
    };
    values
        .chunks(length)
        .enumerate()
        .flat_map(of_stretch)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_peak_is_lost_where_samples_are_too_many() {
        let mut values = vec![0.0; 10_000];
        values[1234] = 5.0;
        values[7777] = -5.0;
        let shown = extremes(&values, 100);
        assert!(shown.len() <= 100 && shown.contains(&1234) && shown.contains(&7777));
        assert!(shown.windows(2).all(|pair| pair[0] < pair[1]), "{shown:?}");
        assert_eq!(extremes(&values[..50], 100).len(), 50);
    }

    #[test]
    fn a_spectrum_leads_to_the_folder_of_its_captures() {
        let run = tempfile::tempdir().unwrap();
        let campaign = r#"{"runs":[{"number":7,"file":"spectra/B_2.csv"}]}"#;
        std::fs::write(run.path().join(CAMPAIGN), campaign).unwrap();
        let found = [
            "raw_shunt",
            "spectrum",
            "spectrum_2",
            "spectrum_fake_cell",
            "spectra/B_2",
        ]
        .map(|name| folder_of(run.path(), name));
        assert_eq!(found, ["shunt", "cell", "cell_2", "fake_cell", "cell_7"]);
    }
}
