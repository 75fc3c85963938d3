//! Linearity and drift of the cell from its records, point by point.

use crate::support::present::significant;
use analysis::{
    report::Table,
    spectrum::{ImpedancePoint, raw_impedance},
    validity::{Drift, DriftShape, Harmonic, Record, beyond_noise},
};
use bench_plan::measure::SweepPoint;
use num_complex::Complex64;

/// Number of standard deviations below which a bend counts as noise.
const SIGNIFICANT: f64 = 4.0;

/// Returns the records of a sweep for a verdict on it.
///
/// A harmonic of the current passes through a linear cell. The nonlinear part is the rest, Vₖ −
/// Z(kω)·Iₖ, with Z from the same sweep, interpolated linearly between its points over ln ω and
/// constant beyond the last.
pub(super) fn records(points: &[SweepPoint], shunt_ohm: f64) -> Vec<Record> {
    let mut sweep: Vec<ImpedancePoint> = points
        .iter()
        .map(|point| raw_impedance(&point.phasors, shunt_ohm))
        .collect();
    sweep.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
    points
        .iter()
        .map(|point| record(point, &sweep, shunt_ohm))
        .collect()
}

fn record(point: &SweepPoint, sweep: &[ImpedancePoint], shunt_ohm: f64) -> Record {
    let [_, _, low, high] = point.phasors.volts;
    let amplitude_v = (high - low).norm();
    let harmonics = point
        .harmonics_and_drift
        .harmonics
        .iter()
        .map(|(order, phasors)| {
            let [v1, v2, v3, v4] = phasors.volts;
            let [n1, n2, n3, n4] = phasors.totals();
            let per_shunt_volt = between(sweep, phasors.freq_hz) / shunt_ohm;
            let noise = n3 + n4 + (n1 + n2).scaled(per_shunt_volt);
            Harmonic {
                order: *order,
                ratio: (v4 - v3 - per_shunt_volt * (v2 - v1)).norm() / amplitude_v,
                sigma: (0.5 * (noise.re_re + noise.im_im)).sqrt() / amplitude_v,
            }
        });
    // The part that relaxations have removed is no longer in Z.
    let bend = point
        .harmonics_and_drift
        .bend
        .filter(|_| !point.harmonics_and_drift.relaxed);
    let bend = bend.filter(|bend| bend.volts.abs() > SIGNIFICANT * bend.sigma_v);
    Record {
        freq_hz: point.phasors.freq_hz,
        harmonics: harmonics.collect(),
        drift: bend.map(|bend| Drift {
            over_amplitude: bend.volts / amplitude_v,
            periods: bend.periods,
            shape: DriftShape::Bend,
        }),
    }
}

/// Interpolates the impedance of a sweep, sorted by rising frequency, at any frequency.
fn between(sweep: &[ImpedancePoint], freq_hz: f64) -> Complex64 {
    let after = sweep.partition_point(|point| point.freq_hz < freq_hz);
    match (
        after.checked_sub(1).and_then(|before| sweep.get(before)),
        sweep.get(after),
    ) {
        (Some(a), Some(b)) => {
            a.z_ohm
                + (b.z_ohm - a.z_ohm) * ((freq_hz / a.freq_hz).ln() / (b.freq_hz / a.freq_hz).ln())
        }
        (Some(end), None) | (None, Some(end)) => end.z_ohm,
        (None, None) => Complex64::ZERO,
    }
}

/// Returns the records as a table of the report; `of` names their sweep if there are several.
pub(super) fn table(records: &[Record], of: &str) -> Table {
    let strings = |strings: &[&str]| {
        strings
            .iter()
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    let harmonic = |record: &Record, order: u32| {
        let found = record
            .harmonics
            .iter()
            .find(|harmonic| harmonic.order == order);
        found.map_or_else(
            || "–".to_owned(),
            |h| format!("{:.3} ± {:.3}", 100.0 * h.ratio, 100.0 * h.sigma),
        )
    };
    let beyond = beyond_noise(records);
    let row = |(record, beyond): (&Record, &Vec<bool>)| {
        let drift = record.drift.map_or_else(
            || "none seen".to_owned(),
            |drift| format!("{:.3}", drift.error_percent()),
        );
        let third = record
            .harmonics
            .iter()
            .zip(beyond)
            .find(|(harmonic, beyond)| harmonic.order == 3 && **beyond);
        let third = third.map_or_else(
            || "none seen".to_owned(),
            |(harmonic, _)| format!("{:.3}", harmonic.error_percent()),
        );
        vec![
            significant(record.freq_hz, 6),
            harmonic(record, 2),
            harmonic(record, 3),
            third,
            drift,
        ]
    };
    Table {
        caption: format!(
            "What the cell's records show besides the sine{of} (without what the current's \
            harmonics explain), and what it may do to Z"
        ),
        header: strings(&[
            "f / Hz",
            "2nd harmonic / % of U",
            "3rd harmonic / % of U",
            "nonlinearity: Z off by / %",
            "drift that bends: Z off by / %",
        ]),
        rows: records.iter().zip(&beyond).map(row).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::spectrum::{ChannelPhasors, PhasorVariance};
    use bench_plan::measure::{Bend, HarmonicsAndDrift};
    use instruments::fixture::Fixture;
    use instruments::units::{Hertz, Seconds};

    const SHUNT_OHM: f64 = 0.01;

    /// Returns channels for a current in amperes through the shunt and a voltage across the jig,
    /// with 1 µV of noise each.
    fn phasors(freq_hz: f64, current_a: f64, volts: Complex64) -> ChannelPhasors {
        let top = Complex64::from(0.2);
        let channels = [top, top + SHUNT_OHM * current_a, top, top + volts];
        ChannelPhasors {
            freq_hz,
            volts: channels,
            variance: [PhasorVariance::circular(1.0e-12); 4],
        }
    }

    /// 20 mΩ at 1 Hz, 10 mΩ at 4 Hz: 15 mΩ at 2 Hz. The current of 1 A has 10 % of second and of
    /// third harmonic.
    fn sweep() -> Vec<SweepPoint> {
        let point = |index: usize, freq_hz: f64, r_ohm: f64| SweepPoint {
            fixture: Fixture::Cell,
            index,
            phasors: phasors(freq_hz, 1.0, r_ohm.into()),
            volts_per_div: [1.0; 4],
            free_freq_hz: Hertz(freq_hz),
            residual_lag1: 0.0,
            harmonics_and_drift: HarmonicsAndDrift::default(),
            warnings: Vec::new(),
            time_s: Seconds(0.0),
            captures: 1,
            rechecked: 0,
            spent: bench_plan::measure::Spent::default(),
            measures: bench_plan::measure::quality::Measures::default(),
            failing: Vec::new(),
            conditions: None,
        };
        let mut points = vec![point(0, 1.0, 0.020), point(1, 4.0, 0.010)];
        let third = (0.020 - 0.010 * 3.0_f64.ln() / 4.0_f64.ln()) * 0.1;
        points[0].harmonics_and_drift.harmonics = vec![
            (2, phasors(2.0, 0.1, 0.0015.into())),
            (3, phasors(3.0, 0.1, Complex64::new(third, 0.0002))),
        ];
        points
    }

    #[test]
    fn only_what_the_current_does_not_explain_is_the_cells() {
        let found = records(&sweep(), SHUNT_OHM);
        let [second, third] = found[0].harmonics.as_slice() else {
            panic!("{found:?}")
        };
        assert!(second.ratio < 1.0e-9, "{second:?}");
        // 0.2 mV of 20 mV; √(2 + 2·1.5²) µV of 20 mV.
        assert!((third.ratio - 0.01).abs() < 1.0e-9, "{third:?}");
        assert_eq!(beyond_noise(&found), [vec![false, true], Vec::new()]);
        assert!(
            (second.sigma - 6.5_f64.sqrt() * 5.0e-5).abs() < 1.0e-9,
            "{second:?}"
        );
        let rows = table(&found, "").rows;
        assert_eq!(rows[0][2..], ["1.000 ± 0.011", "3.000", "none seen"]);
        assert_eq!(rows[1][1..], ["–", "–", "none seen", "none seen"]);
    }

    #[test]
    fn a_bend_counts_from_four_standard_deviations() {
        let mut points = sweep();
        let drift = |points: &[SweepPoint]| records(points, SHUNT_OHM)[0].drift;
        points[0].harmonics_and_drift.bend = Some(Bend {
            volts: -0.004,
            sigma_v: 0.0011,
            periods: 5.0,
        });
        assert_eq!(drift(&points), None);
        points[0].harmonics_and_drift.bend = Some(Bend {
            volts: -0.004,
            sigma_v: 0.0009,
            periods: 5.0,
        });
        let found = drift(&points).unwrap();
        assert!(
            (found.over_amplitude + 0.2).abs() < 1.0e-9
                && found.periods == 5.0
                && found.shape == DriftShape::Bend,
            "{found:?}"
        );
    }
}
