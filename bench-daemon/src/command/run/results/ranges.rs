//! On which vertical ranges the channels measured. A gain belongs to a range: a correction measured on one does not hold on another.

use std::collections::BTreeMap;

use analysis::dataset;

use crate::{
    command::{Failure, run::Measured},
    executor::SweepPoint,
    record::{RecordError, Recorder},
};

/// Ranges that differ by less than this share are one.
const SAME_RANGE: f64 = 1.0e-3;

/// Something that was measured: its name, and frequency, Hz, where it has one, and V/div of channels 1…4 of each record.
type Ranged = (String, Vec<Scales>);

/// Frequency, Hz, and V/div.
type Scales = (Option<f64>, [f64; 4]);

/// Notes every sweep, multisine and trace of the cell on other ranges than those of a control.
///
/// # Errors
/// A capture that cannot be read.
pub(super) fn warn(recorder: &mut Recorder, measured: &Measured) -> Result<(), Failure> {
    let of = |points: &[SweepPoint]| points.iter().map(|point| (Some(point.phasors.freq_hz), point.volts_per_div)).collect::<Vec<_>>();
    let names = measured.names().into_iter().map(|name| if name.is_empty() { "the cell".to_owned() } else { name });
    let mut all: Vec<Ranged> = names.zip(&measured.points).map(|(name, points)| (name, of(points))).collect();
    for (number, run) in (1..).zip(&measured.multisines) {
        let lines = run.spectrum.points.iter().map(|point| Some(point.freq_hz)).zip(run.volts_per_div.iter().copied());
        all.push((format!("multisine {number}"), lines.collect()));
    }
    let controls: Vec<(&str, Vec<_>)> = ["shunt", "fake_cell", "short"]
        .into_iter()
        .filter_map(|control| Some((control, of(measured.sweeps.get(control).filter(|points| !points.is_empty())?))))
        .collect();
    for trace in recorder.index().traces.iter().filter(|_| !controls.is_empty()) {
        // The channels keep their ranges from the frame of the zeros on.
        let zero = recorder.path(&format!("captures/trace_{}_{}/zero.parquet", trace.name, trace.repeat));
        // Meters recorded it: no channel, and nothing to correct.
        if !zero.exists() {
            continue;
        }
        let meta = dataset::read_capture(&zero).map_err(RecordError::from)?.meta;
        all.push((
            format!("trace {}, repeat {}", trace.name, trace.repeat),
            vec![(None, meta.channels.map(|channel| channel.volts_per_div))],
        ));
    }
    for (control, points) in &controls {
        differing(&all, (control, points)).iter().for_each(|text| recorder.warning(text));
    }
    Ok(())
}

/// What is to be said of all that was measured on other ranges than a control's; the same of several is said once.
fn differing(all: &[Ranged], (control, reference): (&str, &[Scales])) -> Vec<String> {
    let mut said: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (name, records) in all {
        for slot in 0..4 {
            let other = |(freq_hz, volts): &&Scales| {
                let same = |reference: f64| (volts[slot] / reference - 1.0).abs() <= SAME_RANGE;
                !match freq_hz {
                    Some(freq_hz) => nearest(reference, *freq_hz).is_some_and(|found| same(found[slot])),
                    None => reference.iter().any(|(_, found)| same(found[slot])),
                }
            };
            let Some((freq_hz, volts)) = records.iter().find(other) else { continue };
            let found = freq_hz.and_then(|freq_hz| nearest(reference, freq_hz)).or(reference.first().map(|(_, volts)| volts));
            let reference_v = found.map_or(f64::NAN, |found| found[slot]);
            let from = freq_hz.map_or_else(String::new, |freq_hz| format!(" from {freq_hz:.4} Hz on"));
            let text = format!("channel {} at {} V/div and the {control} at {reference_v} V/div{from}", slot + 1, volts[slot]);
            said.entry(text).or_default().push(name);
        }
    }
    said.into_iter().map(|(text, names)| format!("{} measured on {text}: the correction assumes equal gain", names.join("; "))).collect()
}

/// The record of a control that is nearest in frequency.
fn nearest(reference: &[Scales], freq_hz: f64) -> Option<&[f64; 4]> {
    let away = |at: &Option<f64>| at.map_or(f64::INFINITY, |at| (at / freq_hz).ln().abs());
    reference.iter().min_by(|a, b| away(&a.0).total_cmp(&away(&b.0))).map(|(_, volts)| volts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_was_measured_on_another_range_is_named() {
        let reference = [(Some(1.0), [0.1, 0.1, 0.2, 0.2]), (Some(10.0), [0.1, 0.1, 0.2, 0.5])];
        let other = [0.1, 0.1, 0.2, 1.0];
        let all: Vec<Ranged> = vec![
            ("A_1".to_owned(), reference.to_vec()),
            ("A_2".to_owned(), vec![(Some(1.0), reference[0].1), (Some(10.0), other)]),
            ("B_1".to_owned(), vec![(Some(10.0), other)]),
            // Each range that the control had serves a trace; a line between its points is held against the nearest.
            ("trace t".to_owned(), vec![(None, reference[1].1)]),
            ("trace u".to_owned(), vec![(None, [0.1, 0.1, 0.4, 0.2])]),
            ("multisine 1".to_owned(), vec![(Some(1.3), reference[0].1), (Some(8.0), reference[0].1)]),
        ];
        let said = [
            "trace u measured on channel 3 at 0.4 V/div and the shunt at 0.2 V/div: the correction assumes equal gain",
            "multisine 1 measured on channel 4 at 0.2 V/div and the shunt at 0.5 V/div from 8.0000 Hz on: the correction assumes equal gain",
            "A_2; B_1 measured on channel 4 at 1 V/div and the shunt at 0.5 V/div from 10.0000 Hz on: the correction assumes equal gain",
        ];
        assert_eq!(differing(&all, ("shunt", &reference)), said);
    }
}
