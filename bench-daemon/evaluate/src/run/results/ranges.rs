//! Compares the vertical ranges of the channels with those of the controls. A gain belongs to a
//! range: a correction that was measured on one range does not apply to another.

use std::collections::BTreeMap;

use analysis::{dataset, run_folder, significant::format_significant};

use crate::run::Measured;
use bench_core::{
    record::{RecordError, Recorder},
    safety::failure::Failure,
};
use bench_plan::measure::SweepPoint;

/// Relative difference below which ranges count as equal.
const SAME_RANGE: f64 = 1.0e-3;

/// A measurement: its name, its frequency, Hz, if it has one, and V/div of channels 1…4 of each
/// record.
type Ranged = (String, Vec<Scales>);

/// Frequency, Hz, and V/div.
type Scales = (Option<f64>, [f64; 4]);

/// Notes every sweep, multisine and trace of the cell on other ranges than those of a control.
///
/// # Errors
/// Fails if a capture cannot be read.
pub(super) fn warn(recorder: &mut Recorder, measured: &Measured) -> Result<(), Failure> {
    let of = |points: &[SweepPoint]| {
        points
            .iter()
            .map(|point| (Some(point.phasors.freq_hz), point.volts_per_div))
            .collect::<Vec<_>>()
    };
    let names = measured.names().into_iter().map(|name| {
        if name.is_empty() {
            "the cell".to_owned()
        } else {
            name
        }
    });
    let mut all: Vec<Ranged> = names
        .zip(&measured.points)
        .map(|(name, points)| (name, of(points)))
        .collect();
    for (number, run) in (1..).zip(&measured.multisines) {
        let lines = run
            .spectrum
            .points
            .iter()
            .map(|point| Some(point.freq_hz))
            .zip(run.volts_per_div.iter().copied());
        all.push((format!("multisine {number}"), lines.collect()));
    }
    let controls: Vec<(&str, Vec<_>)> = ["shunt", "fake_cell", "short"]
        .into_iter()
        .filter_map(|control| {
            Some((
                control,
                of(measured
                    .sweeps
                    .get(control)
                    .filter(|points| !points.is_empty())?),
            ))
        })
        .collect();
    for trace in recorder
        .index()
        .traces
        .iter()
        .filter(|_| !controls.is_empty())
    {
        // The channels keep their ranges from the frame of the zeros on.
        let zero = recorder.path(&run_folder::capture(
            &run_folder::trace_name(&trace.name, trace.repeat),
            run_folder::ZERO_FRAME,
        ));
        // Meters recorded the trace, which has no channels to correct.
        if !zero.exists() {
            continue;
        }
        let meta = dataset::read_capture(&zero)
            .map_err(RecordError::from)?
            .meta;
        all.push((
            format!("trace {}, repeat {}", trace.name, trace.repeat),
            vec![(None, meta.channels.map(|channel| channel.volts_per_div))],
        ));
    }
    differing(&all, &controls)
        .iter()
        .for_each(|text| recorder.warning(text));
    Ok(())
}

/// Returns remarks on all measurements on other ranges than those of the controls. Each remark
/// names its channels in one note; equal notes are returned once.
fn differing(all: &[Ranged], controls: &[(&str, Vec<Scales>)]) -> Vec<String> {
    let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (name, records) in all {
        let channels: Vec<String> = (0..4)
            .filter_map(|slot| channel(slot, records, controls))
            .collect();
        if !channels.is_empty() {
            texts.entry(channels.join(", ")).or_default().push(name);
        }
    }
    texts
        .into_iter()
        .map(|(text, names)| {
            format!(
                "{} measured on {text}: the correction assumes equal gain",
                names.join("; ")
            )
        })
        .collect()
}

/// Describes a channel that measured on another range than a control: its range, and those of the
/// controls.
fn channel(slot: usize, records: &[Scales], controls: &[(&str, Vec<Scales>)]) -> Option<String> {
    let mut ranges: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (control, reference) in controls {
        let Some((freq_hz, volts)) = records.iter().find(|record| other(slot, record, reference))
        else {
            continue;
        };
        let found = freq_hz
            .and_then(|freq_hz| nearest(reference, freq_hz))
            .or(reference.first().map(|(_, volts)| volts));
        let from = freq_hz.map_or_else(String::new, |freq_hz| {
            format!(" from {} Hz on", short(freq_hz))
        });
        let range = format!("{} V/div{from}", short(volts[slot]));
        ranges.entry(range).or_default().push(format!(
            "{control} {}",
            found.map_or_else(|| "none".to_owned(), |found| short(found[slot]))
        ));
    }
    let parts: Vec<String> = ranges
        .into_iter()
        .map(|(range, controls)| format!("{range} ({})", controls.join(", ")))
        .collect();
    (!parts.is_empty()).then(|| format!("channel {} at {}", slot + 1, parts.join(" and ")))
}

/// Checks whether the record has another range than the control's record nearest in frequency, or,
/// if it has no frequency, than every record of the control.
fn other(slot: usize, (freq_hz, volts): &Scales, reference: &[Scales]) -> bool {
    let same = |reference: f64| (volts[slot] / reference - 1.0).abs() <= SAME_RANGE;
    !match freq_hz {
        Some(freq_hz) => nearest(reference, *freq_hz).is_some_and(|found| same(found[slot])),
        None => reference.iter().any(|(_, found)| same(found[slot])),
    }
}

/// Formats four digits, which are enough to distinguish different ranges.
fn short(value: f64) -> String {
    format_significant(value, 4)
}

/// Returns the record of a control that is nearest in frequency.
fn nearest(reference: &[Scales], freq_hz: f64) -> Option<&[f64; 4]> {
    let away = |at: &Option<f64>| at.map_or(f64::INFINITY, |at| (at / freq_hz).ln().abs());
    reference
        .iter()
        .min_by(|a, b| away(&a.0).total_cmp(&away(&b.0)))
        .map(|(_, volts)| volts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_was_measured_on_another_range_is_named() {
        let reference = [
            (Some(1.0), [0.1, 0.1, 0.2, 0.2]),
            (Some(10.0), [0.1, 0.1, 0.2, 0.5]),
        ];
        let other = [0.1, 0.1, 0.2, 1.0];
        let all: Vec<Ranged> = vec![
            ("A_1".to_owned(), reference.to_vec()),
            (
                "A_2".to_owned(),
                vec![(Some(1.0), reference[0].1), (Some(10.0), other)],
            ),
            ("B_1".to_owned(), vec![(Some(10.0), other)]),
            // A trace may use any range of the control; a line between two points is compared with
            // the nearest.
            ("trace t".to_owned(), vec![(None, reference[1].1)]),
            ("trace u".to_owned(), vec![(None, [0.1, 0.1, 0.4, 0.2])]),
            (
                "multisine 1".to_owned(),
                vec![(Some(1.3), reference[0].1), (Some(8.0), reference[0].1)],
            ),
        ];
        let controls = [
            ("shunt", reference.to_vec()),
            ("fake_cell", reference[..1].to_vec()),
        ];
        let texts = [
            "trace u measured on channel 3 at 0.4 V/div (shunt 0.2): the correction assumes equal \
            gain",
            "multisine 1 measured on channel 4 at 0.2 V/div from 8 Hz on (shunt 0.5): the \
            correction assumes equal gain",
            "A_2; B_1 measured on channel 4 at 1 V/div from 10 Hz on (shunt 0.5): the correction \
            assumes equal gain",
        ];
        assert_eq!(differing(&all, &controls[..1]), texts);
        // Several channels and controls give one note, without the rounding errors of single
        // precision.
        let dusty: Vec<Ranged> = vec![(
            "trace v".to_owned(),
            vec![(
                None,
                [0.100_000_001_490_116_12, 0.2, 0.400_000_005_960_464_5, 0.2],
            )],
        )];
        let texts = "trace v measured on channel 2 at 0.2 V/div (shunt 0.1, fake_cell 0.1), channel \
        3 at 0.4 V/div (shunt 0.2, fake_cell 0.2): the \
                    correction assumes equal gain";
        assert_eq!(differing(&dusty, &controls), [texts]);
    }
}
