//! `eis-bench dataset`: makes a `dataset.toml` for spectra and logs of a cycler, and checks one.

mod args;
mod check;
mod findings;
mod found;
mod print;
mod read;
mod written;

use crate::command::printed::say_json;
use std::collections::BTreeMap;

use analysis::{dataset, formats::CurrentSign};

use args::{Act, InitArgs};
use bench_core::{record::RecordError, safety::failure::Failure};
use bench_evaluate::{
    files,
    investigate::{
        dataset::{DATASET_FILE, read_dataset},
        proposal::{Named, OwnFiles, Proposal, StartModel, dataset_text},
    },
};
use bench_plan::support::terminal::say;
use findings::Findings;

pub use args::DatasetArgs;

/// Makes or checks a data set.
///
/// # Errors
/// An argument is invalid, a `dataset.toml` already exists, or the data set lacks a key or a usable
/// run.
pub fn dataset(args: &DatasetArgs) -> Result<(), Failure> {
    match &args.act {
        Act::Init(args) => init(args),
        Act::Check(args) => check::check(&args.data),
    }
}

fn init(args: &InitArgs) -> Result<(), Failure> {
    let target = args.out.join(DATASET_FILE);
    if !args.dry_run && target.exists() && !written::may_be_replaced(&target) {
        return Err(Failure::Usage(format!(
            "{}: expected no such file, found one: nothing is written over; choose another folder \
            with --out",
            target.display()
        )));
    }
    let replaces = target.exists();
    check(args)?;
    let contents = read::read_all(args)?;
    let findings = found::found(args, contents)?;
    if args.json {
        say_json(&findings)?;
    } else {
        print::findings(&findings);
    }
    if findings.logs.is_empty() && findings.spectra.is_empty() {
        return Err(Failure::Usage(
            "expected at least one log or spectrum that can be read, found none; nothing is written"
                .to_owned(),
        ));
    }
    let mut text = dataset_text(
        &named(args, &findings)?,
        &Proposal {
            logs: &findings.logs,
            runs: &findings.runs,
            spectra: &findings.spectra,
            bench: &findings.bench,
        },
    );
    let lacks = lacks(&findings);
    if args.dry_run {
        if !args.json {
            say!("\n{text}");
        }
        return lacks.map_or(Ok(()), |lacks| {
            Err(Failure::Usage(format!("the data set would lack {lacks}")))
        });
    }
    if lacks.is_some() {
        written::mark_incomplete(&mut text);
    }
    files::make_folder(&args.out)?;
    write_own(args, &findings, replaces)?;
    dataset::write_atomically(&target, text.as_bytes()).map_err(RecordError::from)?;
    if let Some(lacks) = lacks {
        return Err(Failure::Usage(format!(
            "{}: written, but it lacks {lacks}; state it and run the command again, or fill in the file",
            target.display()
        )));
    }
    let read = read_dataset(&target)?;
    if let Some(problem) = read.problems.first() {
        return Err(Failure::Usage(format!(
            "{}: written, but not usable: {problem}",
            target.display()
        )));
    }
    if !args.json {
        say!(
            "\nwritten and read back: {}, {} runs; next: {}",
            target.display(),
            read.set.runs.len(),
            next(args, &findings)
        );
    }
    Ok(())
}

/// Name of the curve through the rest voltages.
const OWN_CURVE: &str = "ocv_rests.json";
/// Name of the model to start from.
const OWN_MODEL: &str = "model_start.json";

/// Writes the curve and the model from the logs beside the data set.
fn write_own(args: &InitArgs, findings: &Findings, replaces: bool) -> Result<(), Failure> {
    let curve = findings.curve.as_ref();
    let curve = curve.and_then(|curve| serde_json::to_string(curve).ok());
    let model = findings.model.as_ref().map(StartModel::json);
    for (name, text) in [(OWN_CURVE, curve), (OWN_MODEL, model)] {
        let (path, Some(text)) = (args.out.join(name), text) else {
            continue;
        };
        if path.exists() && !replaces {
            return Err(Failure::Usage(format!(
                "{}: expected no such file, found one: nothing is written over; choose another folder \
                with --out",
                path.display()
            )));
        }
        dataset::write_atomically(&path, text.as_bytes()).map_err(RecordError::from)?;
    }
    Ok(())
}

/// Returns the commands that lead from the data set to a verdict.
fn next(args: &InitArgs, findings: &Findings) -> String {
    let out = args.out.display();
    let mut used = findings.spectra.iter().filter(|one| one.refusal.is_none());
    let curve = match (&args.ocv, &findings.curve) {
        (None, None) => " --ocv CURVE",
        _ => "",
    };
    match (&findings.model, used.next()) {
        (Some(_), _) => format!("eis-bench diagnose {out}{curve}"),
        (None, Some(_)) => format!(
            "eis-bench fit SPECTRUM --out {out}/fit, then eis-bench diagnose {out} --model \
             {out}/fit/model_NRC.json{curve}"
        ),
        (None, None) => format!("eis-bench diagnose {out} --model MODEL{curve}"),
    }
}

/// Returns what a data set lacks before `diagnose` accepts it, with the options that provide it; `None`
/// if it is complete.
fn lacks(findings: &Findings) -> Option<String> {
    let spectra = findings.spectra.iter();
    let used = spectra
        .filter(|spectrum| spectrum.refusal.is_none())
        .count();
    if findings.runs.len() + used == 0 {
        return Some(format!(
            "a run: no load and no spectrum can be used{}",
            commonest(findings)
        ));
    }
    let mut of_keys: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for one in &findings.missing {
        of_keys.entry(one.key).or_default().push(&one.option);
    }
    let words = of_keys.into_iter().map(|(key, options)| {
        let option = options.first().copied().unwrap_or_default();
        let runs = match options.len() {
            1 => "1 run".to_owned(),
            count => format!("{count} runs"),
        };
        format!("`{key}` of {runs} ({option})")
    });
    Some(words.collect::<Vec<_>>().join(" and ")).filter(|words| !words.is_empty())
}

/// Refuses numbers out of range.
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
    let band = [("from-hz", args.from_hz), ("to-hz", args.to_hz)];
    for (option, hz) in band {
        if let Some(hz) = hz.filter(|hz| !(*hz > 0.0 && hz.is_finite())) {
            return fail(option, "a frequency above 0 Hz", hz);
        }
    }
    match args.temperature_degc.filter(|celsius| !celsius.is_finite()) {
        Some(celsius) => fail("temperature-c", "a finite temperature", celsius),
        None => Ok(()),
    }
}

fn named(args: &InitArgs, findings: &Findings) -> Result<Named, Failure> {
    let ocv = args
        .ocv
        .as_deref()
        .map(|path| read::from_folder(path, &args.out))
        .transpose()?;
    Ok(Named {
        name: args.cell.clone(),
        cell: args.cell.clone(),
        ocv,
        own: OwnFiles {
            ocv: findings.curve.as_ref().map(|_| OWN_CURVE.to_owned()),
            model: findings.model.as_ref().map(|_| OWN_MODEL.to_owned()),
        },
        current_positive: args.positive.map(|sign| match sign {
            CurrentSign::Charge => "charge",
            CurrentSign::Discharge => "discharge",
        }),
        rest_s: args.rest,
    })
}

/// Returns the most frequent reason for leaving out loads, as the end of a message.
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
    most.map_or_else(String::new, |(reason, count)| match count {
        1 => format!("; 1 load is left out because: {reason}"),
        _ => format!("; {count} loads are left out because: {reason}"),
    })
}
