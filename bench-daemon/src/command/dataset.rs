//! `eis-bench dataset init`: a `dataset.toml` for spectra and logs of a cycler.

mod args;
mod findings;
mod print;
mod read;

use crate::command::printed::say_json;
use std::collections::BTreeMap;

use analysis::{dataset, formats::CurrentSign, series::TimeSeries};

use crate::{
    files,
    investigate::{
        dataset::{DATASET_FILE, read_dataset},
        proposal::{
            ChargeKnown, FoundLog, LogSearch, Named, check_spectra, count_charge, dataset_text,
            estimate, loads, propose,
        },
    },
    record::RecordError,
    safety::failure::Failure,
    support::terminal::say,
};
use args::{Act, InitArgs};
use findings::Findings;
use read::Content;

pub use args::DatasetArgs;

/// Makes a data set.
///
/// # Errors
/// An argument that is not as expected; a `dataset.toml` that is there already; no usable run.
pub fn dataset(args: &DatasetArgs) -> Result<(), Failure> {
    match &args.act {
        Act::Init(args) => init(args),
    }
}

fn init(args: &InitArgs) -> Result<(), Failure> {
    let target = args.out.join(DATASET_FILE);
    if !args.dry_run && target.exists() {
        return Err(Failure::Usage(format!(
            "{}: expected no such file, found one: nothing is written over; choose another folder \
            with --out",
            target.display()
        )));
    }
    check(args)?;
    let contents = read::read_all(args)?;
    let findings = found(args, contents)?;
    let text = dataset_text(
        &named(args)?,
        &findings.logs,
        &findings.runs,
        &findings.spectra,
        &findings.bench,
    );
    if args.json {
        say_json(&findings)?;
    } else {
        print::findings(&findings);
    }
    let used = findings.runs.len()
        + findings
            .spectra
            .iter()
            .filter(|spectrum| spectrum.refusal.is_none())
            .count();
    if used == 0 {
        return Err(Failure::Usage(format!(
            "expected at least one run or spectrum that can be used, found none; nothing is \
            written{}",
            commonest(&findings)
        )));
    }
    if args.dry_run {
        if !args.json {
            say!("\n{text}");
        }
        return Ok(());
    }
    files::make_folder(&args.out)?;
    dataset::write_atomically(&target, text.as_bytes()).map_err(RecordError::from)?;
    let read = read_dataset(&target)?;
    if let Some(problem) = read.problems.first() {
        return Err(Failure::Usage(format!(
            "{}: written, but not usable: {problem}",
            target.display()
        )));
    }
    if !args.json {
        say!(
            "\nwritten and read back: {}, {} runs; next: eis-bench diagnose {} --model MODEL",
            target.display(),
            read.set.runs.len(),
            args.out.display()
        );
    }
    Ok(())
}

/// Refuses numbers that cannot be.
fn check(args: &InitArgs) -> Result<(), Failure> {
    let fail = |option: &str, expected: &str, met: f64| {
        Err(Failure::Usage(format!(
            "--{option}: expected {expected}, met {met}"
        )))
    };
    if let Some(ah) = args.capacity_ah.filter(|ah| !(*ah > 0.0 && ah.is_finite())) {
        return fail("capacity-ah", "a capacity above 0 Ah", ah);
    }
    if let Some(soc) = args.soc_start.filter(|soc| !(0.0..=1.0).contains(soc)) {
        return fail("soc-start", "a state of charge from 0 to 1", soc);
    }
    if let Some(soc) = args.soc.filter(|soc| !(0.0..=1.0).contains(soc)) {
        return fail("soc", "a state of charge from 0 to 1", soc);
    }
    if !(args.near > 0.0 && args.near <= 1.0) {
        return fail("near", "a distance above 0 up to 1", args.near);
    }
    if args.soc.is_some() && args.soc_start.is_none() && args.ocv.is_none() && args.at.is_empty() {
        return Err(Failure::Usage(
            "--soc: expected --soc-start with --capacity-ah, --at NAME:soc=…, or --ocv beside it, met \
            none: the state of charge of the loads is not known"
                .to_owned(),
        ));
    }
    if args.soc_start.is_some() && args.capacity_ah.is_none() && args.ocv.is_none() {
        return Err(Failure::Usage(
            "--soc-start: expected --capacity-ah or --ocv beside it, met neither: charge cannot be \
            counted without a capacity"
                .to_owned(),
        ));
    }
    let band = [("from-hz", args.from_hz), ("to-hz", args.to_hz)];
    for (option, hz) in band {
        if let Some(hz) = hz.filter(|hz| !(*hz > 0.0 && hz.is_finite())) {
            return fail(option, "a frequency above 0 Hz", hz);
        }
    }
    match args.temperature_c.filter(|celsius| !celsius.is_finite()) {
        Some(celsius) => fail("temperature-c", "a finite temperature", celsius),
        None => Ok(()),
    }
}

fn named(args: &InitArgs) -> Result<Named, Failure> {
    let ocv = args
        .ocv
        .as_deref()
        .map(|path| read::from_folder(path, &args.out))
        .transpose()?;
    Ok(Named {
        name: args.cell.clone(),
        cell: args.cell.clone(),
        ocv,
        current_positive: args.positive.map(|sign| match sign {
            CurrentSign::Charge => "charge",
            CurrentSign::Discharge => "discharge",
        }),
        rest_s: args.rest,
    })
}

/// Derives loads, runs, split and noise from the contents.
fn found(args: &InitArgs, contents: Vec<Content>) -> Result<Findings, Failure> {
    let curve = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let search = LogSearch {
        rest_s: args.rest,
        slowest_s: args.sampling,
    };
    let (mut listed, mut logs, mut series, mut spectra) = (vec![], vec![], vec![], vec![]);
    for content in contents {
        listed.push(content.finding);
        spectra.extend(content.spectra);
        let Some(log) = content.log else { continue };
        let stated = read::stated(&args.at, &log.name);
        let mut found = loads(&log.series, &search);
        let known = ChargeKnown {
            capacity_ah: args.capacity_ah,
            soc_start: stated.soc.or(args.soc_start),
            curve: curve.as_ref(),
        };
        count_charge(&log.series, &mut found, known);
        let temperature_c = stated.temperature_c.or(args.temperature_c);
        for load in &mut found {
            if load.refusal.is_none() {
                load.refusal = args.soc.and_then(|soc| elsewhere(load.soc, soc, args.near));
            }
            if load.refusal.is_none() && load.temperature_c.or(temperature_c).is_none() {
                load.refusal = Some(
                    "no temperature: the log holds none, --temperature-c states it".to_owned(),
                );
            }
        }
        logs.push(FoundLog {
            file: log.file,
            name: log.name,
            lasting_s: lasting_s(&log.series),
            temperature_c,
            loads: found,
        });
        series.push(log.series);
    }
    let runs = propose(&logs);
    check_spectra(&mut spectra, &runs);
    let series: Vec<&TimeSeries> = series.iter().collect();
    Ok(Findings {
        files: listed,
        bench: estimate(&series),
        logs,
        spectra,
        runs,
    })
}

/// The reason for which most loads are left out, as the end of a message.
fn commonest(findings: &Findings) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for reason in findings
        .logs
        .iter()
        .flat_map(|log| &log.loads)
        .filter_map(|load| load.refusal.as_deref())
    {
        *counts.entry(reason).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|(_, count)| *count);
    most.map_or_else(String::new, |(reason, count)| {
        format!("; {count} loads are left out because: {reason}")
    })
}

/// Why a load is not one at a state of charge.
fn elsewhere(met: Option<f64>, wanted: f64, near: f64) -> Option<String> {
    match met {
        Some(met) if (met - wanted).abs() <= near => None,
        Some(met) => Some(format!(
            "at {:.1} % SOC, not within {:.1} % of --soc {:.1} %",
            100.0 * met,
            100.0 * near,
            100.0 * wanted
        )),
        None => Some("its state of charge is not known: --soc cannot pick it".to_owned()),
    }
}

fn lasting_s(series: &TimeSeries) -> f64 {
    match (series.time_s.first(), series.time_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    }
}
