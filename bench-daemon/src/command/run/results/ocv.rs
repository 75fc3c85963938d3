//! The open-circuit voltage of a finished run: from the files of its legs to table, curve, picture and what is known of their errors.

use analysis::{
    dataset::{self, LegRow},
    ocv::{Interrupted, Interruption, OcvExtraction, OcvOptions, OcvPolynomial, Reach, compensated, extract, interrupted},
    series::TimeSeries,
};
use serde::Serialize;

use crate::{
    command::{Failure, ocv::write as write_curve},
    config::{Experiment, OcvSoc},
    plan::Log,
    record::{RecordError, Recorder},
};

/// After a change of the current the voltage is not that of a steady load for so long, s: six time constants of the slowest branch of the thesis' cell.
const SETTLE_S: f64 = 30.0;

/// Everything that is known of the curve, `ocv_found.json`.
#[derive(Debug, Serialize)]
struct Found<'a> {
    extraction: &'a OcvExtraction,
    interruptions: &'a [Interruption],
    /// Half the range of the resistances of the interruptions, Ω.
    dcir_spread_ohm: Option<f64>,
    reach: Reach,
    /// The curve never falls.
    monotone: bool,
}

/// Evaluates the legs, where there are any; returns what the summary says of them.
pub(super) fn write(recorder: &mut Recorder, experiment: &Experiment) -> Result<String, Failure> {
    let Some(ocv) = &experiment.ocv_soc else { return Ok(String::new()) };
    let down = read(recorder, Log::Discharge)?;
    let up = ocv.both_directions.then(|| read(recorder, Log::Charge)).transpose()?;
    let options = options(experiment, ocv, &down)?;
    let failed = |error: analysis::ocv::ExtractError| Failure::Analysis(format!("{}: {error}", Log::Discharge.file()));
    let mut found = extract(&down.steady, up.as_ref().map(|up| &up.steady), &options).map_err(failed)?;
    let limits_v = options.limits_v;
    let (curve, reach) = found.curve.reaching(limits_v);
    (found.capacity_ah, found.curve) = (curve.capacity_ah, curve);
    found.polynomial = ocv.polynomial.and_then(|order| OcvPolynomial::through(&found.curve, order));
    // What lies between the ends under load and the limits at rest was carried on.
    found.warnings.retain(|warning| !(warning.starts_with("the discharge ended") && reach.below > 0.0));
    found.warnings.retain(|warning| !(warning.starts_with("the discharge began") && reach.above > 0.0));
    let points: Vec<(f64, f64)> =
        compensated(&down.steady, &options).map_err(failed)?.into_iter().map(|(soc, volts)| (reach.soc(soc), volts)).collect();
    write_curve(recorder.folder(), &experiment.cell.name, (&points, &found))?;
    let known = Found {
        extraction: &found,
        interruptions: &down.interruptions,
        dcir_spread_ohm: down.resistance_ohm().map(|(_, spread_ohm)| spread_ohm),
        reach,
        monotone: found.curve.ocv_v.windows(2).all(|pair| pair[1] >= pair[0]),
    };
    recorder.json("ocv_found.json", &known)?;
    found.warnings.iter().for_each(|warning| recorder.warning(&format!("OCV: {warning}")));
    Ok(words(&known, down.resistance_ohm()))
}

/// Reads the legs of one direction; discharge counts positive from here on.
fn read(recorder: &Recorder, log: Log) -> Result<Interrupted, Failure> {
    let rows = dataset::read_legs_csv(&recorder.path(log.file())).map_err(RecordError::from)?;
    let of = |value: fn(&LegRow) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
    let series = TimeSeries {
        name: log.file().to_owned(),
        time_s: of(|row| row.time_s),
        current_a: of(|row| -row.current_a),
        voltage_v: of(|row| row.voltage_v),
        temperature_c: None,
    };
    Ok(interrupted(&series, &of(|row| -row.charge_c), SETTLE_S))
}

fn options(experiment: &Experiment, ocv: &OcvSoc, down: &Interrupted) -> Result<OcvOptions, Failure> {
    let missing =
        || Failure::Analysis("no interruption tells the resistance that the discharge is compensated with: set ocv_soc.dcir".to_owned());
    let measured = down.resistance_ohm().map(|(ohm, _)| ohm);
    let limits = &experiment.cell.limits;
    Ok(OcvOptions {
        dcir_ohm: ocv.dcir_ohm.or(measured).ok_or_else(missing)?,
        limits_v: (limits.min_v, limits.max_v),
        ..OcvOptions::default()
    })
}

fn words(known: &Found<'_>, measured: Option<(f64, f64)>) -> String {
    let found = known.extraction;
    let mut lines = vec![format!(
        "OCV: {:.4} Ah between the limits at rest, {:.2} % of it carried on beyond the discharge at {:.3} A",
        found.capacity_ah,
        100.0 * (known.reach.below + known.reach.above),
        found.current_a
    )];
    lines.push(format!(
        "OCV: compensated by {:.2} mΩ; {}",
        1.0e3 * found.dcir_ohm,
        measured.map_or_else(
            || "no interruption".to_owned(),
            |(ohm, spread)| format!("{} interruptions show {:.2} ± {:.2} mΩ", known.interruptions.len(), 1.0e3 * ohm, 1.0e3 * spread)
        )
    ));
    let rises = if known.monotone { "rises everywhere" } else { "FALLS somewhere" };
    lines.push(format!(
        "OCV: scatter about the spline {:.2} mV, its own uncertainty {:.3} mV; it {rises}",
        1.0e3 * found.noise_v,
        1.0e3 * found.sigma_v
    ));
    if let Some(p) = &found.polynomial {
        let (order, rms, max) = (p.order, 1.0e3 * p.rms_v, 1.0e3 * p.max_v);
        lines.push(format!("OCV: polynomial of order {order}: rms error {rms:.2} mV, largest {max:.1} mV; {}", p.statement()));
    }
    if let Some(h) = &found.charge {
        lines.push(format!(
            "OCV: half the difference of both directions is {:.2} mV, at most {:.2} mV at SOC {:.2}",
            1.0e3 * h.median_v,
            1.0e3 * h.max_v,
            h.max_at_soc
        ));
    }
    lines.join("\n") + "\n"
}
