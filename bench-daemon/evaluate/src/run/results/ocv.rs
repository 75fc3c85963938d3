//! Evaluates the open-circuit voltage of a finished run: table, curve, picture and known errors,
//! from the files of its legs.

use analysis::{
    dataset::{self, LegRow},
    ocv::{
        Interrupted, Interruption, OcvExtraction, OcvOptions, OcvPolynomial, Reach, compensated,
        extract, interrupted,
    },
    report::Table,
    run_folder::{OCV, OCV_FOUND},
    series::TimeSeries,
};
use serde::Serialize;

use instruments::units::Ohms;

use crate::{
    figures::ocv::{picture, write as write_curve},
    support::present::significant,
};
use bench_core::{
    record::{RecordError, Recorder},
    safety::failure::Failure,
};
use bench_plan::{
    config::{Experiment, OcvSoc},
    plan::Log,
};

use super::multisine_and_trace::{Shown, draw};

/// Time after a change of the current in which the voltage differs from that of a steady load, s:
/// six time constants of the slowest branch of the thesis' cell.
const SETTLE_S: f64 = 30.0;

/// Number of standard deviations of the interruptions' resistances above which they contradict a
/// given resistance.
const CONTRADICTS: f64 = 3.0;

/// All results about the curve, `ocv_found.json`.
#[derive(Debug, Serialize)]
struct OcvFindings<'a> {
    extraction: &'a OcvExtraction,
    interruptions: &'a [Interruption],
    /// Half the range of the resistances of the interruptions, Ω.
    dcir_spread_ohm: Option<f64>,
    reach: Reach,
    /// Whether the curve never falls.
    monotone: bool,
}

/// Evaluates the legs, if there are any; returns text for the summary, and adds to the report.
pub(super) fn write(
    recorder: &mut Recorder,
    experiment: &Experiment,
    shown: &mut Shown,
) -> Result<String, Failure> {
    let Some(ocv) = &experiment.ocv_soc else {
        return Ok(String::new());
    };
    let down = read(recorder, Log::Discharge)?;
    let up = ocv
        .both_directions
        .then(|| read(recorder, Log::Charge))
        .transpose()?;
    let options = options(experiment, ocv, &down)?;
    let failed = |error: analysis::ocv::ExtractError| {
        Failure::Analysis(format!("{}: {error}", Log::Discharge.file()))
    };
    let mut found =
        extract(&down.steady, up.as_ref().map(|up| &up.steady), &options).map_err(failed)?;
    let limits_v = options.limits_v;
    let (curve, reach) = found.curve.reaching(limits_v.0..=limits_v.1);
    (found.capacity_ah, found.curve) = (curve.capacity_ah, curve);
    found.polynomial = ocv
        .polynomial
        .and_then(|order| OcvPolynomial::through(&found.curve, order));
    // The range between the ends under load and the limits at rest was extrapolated.
    found
        .warnings
        .retain(|warning| !(warning.starts_with("the discharge ended") && reach.below > 0.0));
    found
        .warnings
        .retain(|warning| !(warning.starts_with("the discharge began") && reach.above > 0.0));
    found
        .warnings
        .extend(ocv.dcir_ohm.and_then(|ohm| contradicted(ohm.0, &down)));
    let points: Vec<(f64, f64)> = compensated(&down.steady, &options)
        .map_err(failed)?
        .into_iter()
        .map(|(soc, volts)| (reach.soc(soc), volts))
        .collect();
    write_curve(recorder.folder(), &found)?;
    let caption =
        "Open-circuit voltage over the state of charge, its slope, and the samples less the curve."
            .to_owned();
    shown.figures.push(draw(
        recorder,
        "ocv",
        &picture(&experiment.cell.name, &points, &found),
        caption,
    )?);
    shown.tables.extend(tables(&found, &down.interruptions));
    let known = OcvFindings {
        extraction: &found,
        interruptions: &down.interruptions,
        dcir_spread_ohm: down.resistance_ohm().map(|(_, spread_ohm)| spread_ohm),
        reach,
        monotone: found.curve.ocv_v.windows(2).all(|pair| pair[1] >= pair[0]),
    };
    recorder.json(OCV_FOUND, &known)?;
    found
        .warnings
        .iter()
        .for_each(|warning| recorder.warning(&format!("OCV: {warning}")));
    Ok(describe(&known, down.resistance_ohm()))
}

/// Reads the legs of one direction; from here on, discharge counts positive.
fn read(recorder: &Recorder, log: Log) -> Result<Interrupted, Failure> {
    let rows = dataset::read_legs_csv(&recorder.path(&log.file())).map_err(RecordError::from)?;
    let of = |value: fn(&LegRow) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
    let series = TimeSeries {
        name: log.file().into_owned(),
        time_s: of(|row| row.time_s),
        current_a: of(|row| -row.current_a),
        voltage_v: of(|row| row.voltage_v),
        temperature_degc: None,
    };
    Ok(interrupted(
        &series,
        &of(|row| -row.charge_coulomb),
        SETTLE_S,
    ))
}

fn options(
    experiment: &Experiment,
    ocv: &OcvSoc,
    down: &Interrupted,
) -> Result<OcvOptions, Failure> {
    let missing = || {
        Failure::Analysis(
            "the discharge has no interruption that gives the resistance for its compensation: set \
        ocv_soc.dcir"
                .to_owned(),
        )
    };
    let measured = down.resistance_ohm().map(|(ohm, _)| ohm);
    let limits = &experiment.cell.limits;
    Ok(OcvOptions {
        dcir_ohm: (ocv.dcir_ohm.or(measured.map(Ohms)).ok_or_else(missing)?).0,
        limits_v: (limits.min_v.0, limits.max_v.0),
        ..OcvOptions::default()
    })
}

fn tables(found: &OcvExtraction, interruptions: &[Interruption]) -> [Table; 2] {
    let strings = |strings: &[&str]| {
        strings
            .iter()
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    let at = |tenth: i32| {
        let soc = 0.1 * f64::from(tenth);
        let (ocv_v, slope_v) = found.curve.at(soc);
        vec![
            format!("{soc:.1}"),
            format!("{ocv_v:.4}"),
            significant(slope_v, 3),
        ]
    };
    let pause = |pause: &Interruption| {
        vec![
            significant(pause.charge_coulomb / 3600.0, 4),
            significant(pause.current_a, 4),
            format!(
                "{:.3} ± {:.3}",
                1.0e3 * pause.resistance_ohm,
                1.0e3 * pause.sigma_ohm
            ),
            significant(pause.rest_s, 3),
        ]
    };
    [
        Table {
            caption: format!("Open-circuit voltage; all of it is in {OCV}"),
            header: strings(&["SOC", "OCV / V", "slope / V"]),
            rows: (0..=10).map(at).collect(),
        },
        Table {
            caption: "Interruptions of the discharge and the resistance that they show (± one \
            standard deviation of the samples)"
                .to_owned(),
            header: strings(&["drawn / Ah", "current / A", "resistance / mΩ", "pause / s"]),
            rows: interruptions.iter().map(pause).collect(),
        },
    ]
}

/// Returns a remark on a given resistance, Ω, if the interruptions show another one.
fn contradicted(given_ohm: f64, down: &Interrupted) -> Option<String> {
    let (measured_ohm, _) = down.resistance_ohm()?;
    let most_a = down
        .interruptions
        .iter()
        .map(|pause| pause.current_a.abs())
        .fold(0.0, f64::max);
    let large: Vec<&Interruption> = down
        .interruptions
        .iter()
        .filter(|pause| pause.current_a.abs() >= 0.5 * most_a)
        .collect();
    let mean_square = |of: &dyn Fn(&Interruption) -> f64, count: usize| {
        large.iter().map(|pause| of(pause).powi(2)).sum::<f64>() / count as f64
    };
    let own = mean_square(&|pause| pause.sigma_ohm, large.len());
    // A change of the resistance with the charge is not an error of its value, but part of what a
    // single number for all charges cannot describe.
    let scatter = if large.len() > 1 {
        mean_square(
            &|pause| pause.resistance_ohm - measured_ohm,
            large.len() - 1,
        )
    } else {
        0.0
    };
    let sigma_ohm = own.max(scatter).sqrt();
    let off = (given_ohm - measured_ohm).abs() / sigma_ohm;
    (off > CONTRADICTS).then(|| {
        format!(
            "ocv_soc.dcir is {:.2} mΩ, and {} interruptions show {:.2} ± {:.2} mΩ: the curve is \
            off by {:.1} mV",
            1.0e3 * given_ohm,
            large.len(),
            1.0e3 * measured_ohm,
            1.0e3 * sigma_ohm,
            1.0e3 * (measured_ohm - given_ohm).abs() * most_a
        )
    })
}

fn describe(known: &OcvFindings<'_>, measured: Option<(f64, f64)>) -> String {
    let found = known.extraction;
    let mut lines = vec![format!(
        "OCV: {:.4} Ah between the limits at rest, {:.2} % of it carried on beyond the discharge \
        at {:.3} A",
        found.capacity_ah,
        100.0 * (known.reach.below + known.reach.above),
        found.current_a
    )];
    lines.push(format!(
        "OCV: compensated by {:.2} mΩ; {}",
        1.0e3 * found.dcir_ohm,
        measured.map_or_else(
            || "no interruption".to_owned(),
            |(ohm, spread)| format!(
                "{} interruptions show {:.2} ± {:.2} mΩ",
                known.interruptions.len(),
                1.0e3 * ohm,
                1.0e3 * spread
            )
        )
    ));
    let rises = if known.monotone {
        "rises everywhere"
    } else {
        "FALLS somewhere"
    };
    lines.push(format!(
        "OCV: scatter about the spline {:.2} mV, its own uncertainty {:.3} mV; it {rises}",
        1.0e3 * found.noise_v,
        1.0e3 * found.sigma_v
    ));
    if let Some(p) = &found.polynomial {
        let (order, rms, max) = (p.order, 1.0e3 * p.rms_v, 1.0e3 * p.max_v);
        lines.push(format!(
            "OCV: polynomial of order {order}: rms error {rms:.2} mV, largest {max:.1} mV; {}",
            p.statement()
        ));
    }
    if let Some(h) = &found.charge {
        lines.push(format!(
            "OCV: half the difference of both directions is {:.2} mV, at most {:.2} mV at SOC \
            {:.2}",
            1.0e3 * h.median_v,
            1.0e3 * h.max_v,
            h.max_at_soc
        ));
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_given_resistance_is_held_against_the_interruptions() {
        let pause = |(resistance_ohm, current_a): (f64, f64)| Interruption {
            charge_coulomb: 0.0,
            current_a,
            resistance_ohm,
            sigma_ohm: 1.0e-4,
            rest_s: 60.0,
        };
        let steady = TimeSeries {
            name: String::new(),
            time_s: Vec::new(),
            current_a: Vec::new(),
            voltage_v: Vec::new(),
            temperature_degc: None,
        };
        let down = |pauses: &[(f64, f64)]| Interrupted {
            steady: steady.clone(),
            interruptions: pauses.iter().copied().map(pause).collect(),
        };
        // The small current of the tail carries no information about the large one.
        let three = down(&[(0.025, 1.0), (0.026, 1.0), (0.027, 1.0), (0.060, 0.2)]);
        for (given_ohm, expected) in [
            (0.026, false),
            (0.0285, false),
            (0.0295, true),
            (0.015, true),
        ] {
            assert_eq!(
                contradicted(given_ohm, &three).is_some(),
                expected,
                "{given_ohm}"
            );
        }
        let text = contradicted(0.015, &three).unwrap();
        assert_eq!(
            text,
            "ocv_soc.dcir is 15.00 mΩ, and 3 interruptions show 26.00 ± 1.00 mΩ: the curve is off \
            by 11.0 mV"
        );
        assert!(
            contradicted(0.0202, &down(&[(0.020, 1.0)])).is_none()
                && contradicted(0.0204, &down(&[(0.020, 1.0)])).is_some()
        );
        assert!(contradicted(0.015, &down(&[])).is_none());
    }
}
