//! Derives loads, runs, split and noise from the contents of the files.

use analysis::{ocv::OcvCurve, series::TimeSeries};

use super::{
    args::InitArgs,
    findings::Findings,
    read::{self, Content, Log},
};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    investigate::proposal::{
        ChargeKnown, FoundLog, FoundSpectrum, KnownSoc, Load, LogFacts, LogSearch, Place,
        TestTemperature, check_spectra, contradictions, count_charge, estimate, fits_current,
        loads, missing, propose, rest_curve, start_model,
    },
};

/// Derives loads, runs, split and noise from the contents.
///
/// # Errors
/// The file of the OCV curve cannot be read.
pub(super) fn found(args: &InitArgs, contents: Vec<Content>) -> Result<Findings, Failure> {
    let curve = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let mut capacity_ah = args.capacity_ah;
    let (mut listed, mut logs, mut series, mut spectra) = (vec![], vec![], vec![], vec![]);
    for content in contents {
        let Content {
            mut finding,
            log,
            spectra: of_file,
        } = content;
        let has_spectra = !of_file.is_empty();
        spectra.extend(of_file.into_iter().map(|spectrum| picked(args, spectrum)));
        if let Some(log) = log {
            let found = found_log(args, &log, curve.as_ref());
            capacity_ah = capacity_ah.or(log.state.head.capacity_ah.map(|fact| fact.value));
            let usable = found.loads.iter().any(|load| load.refusal.is_none());
            // A log that contains only spectra.
            if usable || !has_spectra {
                logs.push(found);
                series.push(log.series);
            } else {
                finding.text += "; its log holds no load that can be used";
            }
        }
        listed.push(finding);
    }
    let runs = propose(&logs);
    check_spectra(&mut spectra, &runs);
    let series: Vec<&TimeSeries> = series.iter().collect();
    let has_spectrum = spectra.iter().any(|spectrum| spectrum.refusal.is_none());
    let own_curve = rest_curve(&logs, capacity_ah).filter(|_| curve.is_none());
    let known = curve.as_ref().or(own_curve.as_ref());
    let model = start_model(&series, &logs, &runs, known).filter(|_| !has_spectrum);
    Ok(Findings {
        curve: own_curve,
        model,
        files: listed,
        bench: estimate(&series),
        missing: missing(&runs, &spectra),
        logs,
        spectra,
        runs,
    })
}

/// Returns the loads of a log with their states and temperatures.
fn found_log(args: &InitArgs, log: &Log, curve: Option<&OcvCurve>) -> FoundLog {
    let search = LogSearch {
        rest_s: args.rest,
        slowest_s: args.sampling,
    };
    let mut found = loads(&log.series, log.steps.as_deref(), &search);
    let mut notes = log.remarks();
    let stated = read::stated(&args.at, &log.name);
    let head = log.state.head;
    let column = log.state.soc.as_deref().filter(|column| {
        let fits = fits_current(&log.series, column);
        notes.extend(fits.clone().err());
        fits.is_ok()
    });
    let known = ChargeKnown {
        capacity_ah: args
            .capacity_ah
            .or(curve.map(|curve| curve.capacity_ah))
            .or(head.capacity_ah.map(|fact| fact.value)),
        soc_start: stated.soc.or(args.soc_start),
        curve,
        column,
    };
    if let (Some(soc), None) = (known.soc_start, known.capacity_ah) {
        notes.push(format!(
            "the state of charge {soc} at its first row is not used: charge cannot be counted without \
             a capacity, which --capacity-ah states"
        ));
    }
    count_charge(&log.series, &mut found, known);
    for load in &mut found {
        if load.refusal.is_none() {
            load.refusal = args
                .soc
                .and_then(|soc| elsewhere(load.soc.map(|soc: KnownSoc| soc.value), soc, args.near));
        }
    }
    let stated_degc = stated.temperature_degc.or(args.temperature_degc);
    notes.extend(contradictions(
        &log.series,
        &found,
        &LogFacts {
            capacity_ah: known.capacity_ah,
            head_capacity_ah: head.capacity_ah.map(|fact| fact.value),
            soc_start: known.soc_start.filter(|_| known.capacity_ah.is_some()),
            temperature_degc: stated_degc,
            head_temperature_degc: head.temperature_degc.map(|fact| fact.value),
            column,
            curve,
        },
    ));
    FoundLog {
        file: log.file.clone(),
        name: log.name.clone(),
        lasting_s: lasting_s(&log.series),
        temperature: temperature(log, stated_degc, &found),
        notes,
        loads: found,
    }
}

/// Returns the temperature that replaces the log's own: the stated one, else that of the head if the
/// log has none.
fn temperature(log: &Log, stated_degc: Option<f64>, loads: &[Load]) -> Option<TestTemperature> {
    let logged = loads.iter().any(|load| load.temperature_degc.is_some());
    if let Some(celsius) = stated_degc {
        let source = if logged {
            "as stated, in the place of the logged one"
        } else {
            "as stated; the log holds none"
        };
        return Some(TestTemperature {
            celsius,
            source: source.to_owned(),
        });
    }
    let fact = log.state.head.temperature_degc.filter(|_| !logged)?;
    Some(TestTemperature {
        celsius: fact.value,
        source: format!("as the head of the file states in line {}", fact.line),
    })
}

/// Adds a spectrum; leaves it out if it is not at `--soc`.
fn picked(args: &InitArgs, mut spectrum: FoundSpectrum) -> FoundSpectrum {
    let Place { soc, .. } = spectrum.place;
    if let (Some(wanted), Some(_), None) = (args.soc, soc, &spectrum.refusal) {
        spectrum.refusal = elsewhere(soc, wanted, args.near);
    }
    spectrum
}

/// Returns the reason why a load or a spectrum is not at the requested state of charge.
fn elsewhere(met: Option<f64>, wanted: f64, near: f64) -> Option<String> {
    match met {
        Some(met) if (met - wanted).abs() <= near => None,
        Some(met) => Some(format!(
            "at {:.1} % SOC, not within {:.1} % of --soc {:.1} %",
            100.0 * met,
            100.0 * near,
            100.0 * wanted
        )),
        None => Some(
            "its state of charge is not known: --soc cannot pick it; state --soc-start with \
             --capacity-ah, --at NAME:soc=SOC, or --ocv"
                .to_owned(),
        ),
    }
}

fn lasting_s(series: &TimeSeries) -> f64 {
    match (series.time_s.first(), series.time_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    }
}
