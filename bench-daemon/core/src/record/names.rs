//! Names of sweeps, points and frames in the files of a run.

use analysis_files::dataset::{Capture, CaptureMeta, ChannelMeta};
use analysis_signal::sine::CodeScale;
use instruments::{fixture::Fixture, scope::Waveform};

use bench_plan::plan::fixture_name;

/// Greatest number of sweeps that are named individually.
const MOST_SWEEPS: usize = 3;

/// Describes points of sweeps: each sweep once, with the number of its points if there are
/// several; many sweeps are counted, too.
pub(super) fn places(points: &[(String, f64)]) -> String {
    let mut sweeps: Vec<(&str, Vec<f64>)> = Vec::new();
    for (sweep, freq_hz) in points {
        match sweeps.iter_mut().find(|(known, _)| known == sweep) {
            Some((_, freqs_hz)) => freqs_hz.push(*freq_hz),
            None => sweeps.push((sweep, vec![*freq_hz])),
        }
    }
    if let ([(first, _), .., (last, _)], true) = (sweeps.as_slice(), sweeps.len() > MOST_SWEEPS) {
        let all: Vec<f64> = points.iter().map(|(_, freq_hz)| *freq_hz).collect();
        return frequencies(&format!("{} sweeps, {first} to {last}", sweeps.len()), &all);
    }
    sweeps
        .iter()
        .map(|(sweep, freqs_hz)| frequencies(sweep, freqs_hz))
        .collect::<Vec<_>>()
        .join("; ")
}

fn frequencies(sweep: &str, freqs_hz: &[f64]) -> String {
    match freqs_hz {
        [freq_hz] => format!("{sweep}, {freq_hz:.4} Hz"),
        several => {
            let (least, greatest) = several
                .iter()
                .fold((f64::INFINITY, 0.0_f64), |(least, greatest), &freq_hz| {
                    (least.min(freq_hz), greatest.max(freq_hz))
                });
            if least < greatest {
                format!(
                    "{sweep}, {} points from {least:.4} Hz to {greatest:.4} Hz",
                    several.len()
                )
            } else {
                format!("{sweep}, each at {least:.4} Hz")
            }
        }
    }
}

/// Returns the name of a sweep in file names: a control is named after its fixture, and so is a
/// sweep of the cell, with its number from the second on.
pub fn sweep_name(fixture: Fixture, repeat: usize) -> String {
    let name = fixture_name(fixture);
    match (fixture, repeat) {
        (_, 0) | (Fixture::Cell, 1) => name.to_owned(),
        (Fixture::Cell, number) => format!("{name}_{number}"),
        (_, number) => format!("{name}_sweep_{number}"),
    }
}

/// Identifies a capture.
#[derive(Debug, Clone, Copy)]
pub struct CaptureFile {
    /// Fixture in the jig.
    pub fixture: Fixture,
    /// Number of the sweep, 0 for a control.
    pub repeat: usize,
    /// Number of the point, from 0.
    pub index: usize,
    /// Number of the attempt, from 0: later ones after a change of range.
    pub attempt: usize,
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Commanded amplitude of the current, A.
    pub amplitude_a: f64,
    /// Bench time when it was downloaded, s.
    pub start_s: f64,
}

/// Converts a frame of four channels to its stored form.
pub fn capture_of(label: String, freq_hz: f64, start_s: f64, waveforms: &[Waveform; 4]) -> Capture {
    let channel = |waveform: &Waveform| ChannelMeta {
        scale: code_scale(waveform),
        volts_per_div: waveform.preamble.volts_per_div,
    };
    let channels = waveforms.each_ref().map(channel);
    let meta = CaptureMeta {
        label,
        freq_hz,
        interval_s: waveforms[0].interval_s,
        start_s,
        channels,
    };
    Capture {
        meta,
        codes: waveforms.each_ref().map(|waveform| waveform.codes.clone()),
    }
}

/// Returns the scale of a waveform's codes, which is the same on disk and in the fit.
pub fn code_scale(waveform: &Waveform) -> CodeScale {
    let preamble = &waveform.preamble;
    CodeScale {
        volts_per_code: preamble.volts_per_code,
        offset_v: preamble.offset_v,
        code_min: preamble.code_min,
        code_max: preamble.code_max,
        code_step: preamble.code_step,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_named_by_sweep_and_counted() {
        let points = [
            ("shunt", 300.0),
            ("cell", 0.1),
            ("cell", 10.0),
            ("cell", 0.5),
        ]
        .map(|(sweep, freq_hz)| (sweep.to_owned(), freq_hz));
        assert_eq!(places(&points[..1]), "shunt, 300.0000 Hz");
        assert_eq!(
            places(&points),
            "shunt, 300.0000 Hz; cell, 3 points from 0.1000 Hz to 10.0000 Hz"
        );
    }
}
