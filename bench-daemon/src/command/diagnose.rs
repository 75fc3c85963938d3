//! `eis-bench diagnose`: finds where a model and a data set disagree, which effect is missing,
//! and whether adding it closes the gap.

mod args;
mod judged;
mod table;

use crate::command::printed::say_json;
use std::path::{Path, PathBuf};

use analysis::{
    diagnosis::{ByHand, Outcome, Verdict, report},
    run_folder::{self, DIAGNOSIS, SUMS},
};

pub use args::DiagnoseArgs;
pub(crate) use judged::Judged;
use judged::{Looked, accept};

use super::model_args::ModelArgs;
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    figures::story::{Chapter, STORY, Story},
    files,
    investigate::next_experiment::{Setting, experiment_file},
    run::Finished,
    support::present::one_or_list,
};
use bench_plan::{
    config::Experiment,
    support::{hash, sums, terminal::say},
};

/// Diagnoses, prints, and writes into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written;
/// [`Failure::Invalid`], after all output, if the data cannot be diagnosed. Any other verdict is
/// a result and not an error.
pub fn diagnose(args: &DiagnoseArgs) -> Result<(), Failure> {
    if let Some(path) = &args.table {
        return table::table(args, path);
    }
    let [data] = args.data.as_slice() else {
        let met = args.data.len();
        let reason = format!("expected one data set, or several with --table, found {met}");
        return Err(Failure::Usage(reason));
    };
    let mut judged = Judged::read(data, &args.model, args.ocv.as_deref(), args.refused_points)?;
    accept(&mut judged.loaded, &args.accept);
    let judged = judged.asking(ByHand {
        add: args.add.clone(),
        without: args.without.clone(),
    })?;
    let cells = judged.cells(args.specimen.as_deref())?;
    if args.bench.is_some() && cells.len() > 1 {
        let reason = format!(
            "--bench: expected one cell to write its next experiment for, found {}; choose with \
            --specimen",
            cells.join(", ")
        );
        return Err(Failure::Usage(reason));
    }
    if args.findings {
        let looked = judged.each(&cells, args.specimen.as_deref());
        let looked: Vec<Looked<'_>> = looked.map(|(name, one)| one.look(name)).collect();
        return tell_findings(&looked, args.json);
    }
    let mut outcomes = Vec::new();
    for (name, judged) in judged.each(&cells, args.specimen.as_deref()) {
        let folder = args.out.as_ref().map(|out| below(out, &cells, name));
        let outcome = judged.diagnose()?;
        if let Some(folder) = &folder {
            write(folder, &outcome, &judged)?;
            write_next(folder, &outcome, &judged, args)?;
        }
        if !args.json {
            if cells.len() > 1 {
                say!("cell {name}:");
            }
            say!("{}", report::text(&outcome.diagnosis));
            if let Some(folder) = &folder {
                say!("written to {}", folder.display());
            }
        }
        outcomes.push(outcome);
    }
    match outcomes.as_slice() {
        _ if !args.json => {}
        [one] => say!("{}", json(one)?),
        several => {
            let diagnoses: Vec<_> = cells
                .iter()
                .zip(several)
                .map(|(cell, one)| serde_json::json!({"cell": cell, "diagnosis": one.diagnosis}))
                .collect();
            say_json(&diagnoses)?;
        }
    }
    // All output is printed and written by now; the exit code must report invalid data, too.
    match outcomes
        .iter()
        .find(|outcome| outcome.diagnosis.verdict == Verdict::Invalid)
    {
        Some(outcome) => Err(Failure::Invalid(outcome.diagnosis.summary.clone())),
        None => Ok(()),
    }
}

/// Prints the findings.
///
/// # Errors
/// [`Failure::Invalid`], after all output, if the data of a cell cannot be diagnosed.
fn tell_findings(all: &[Looked<'_>], as_json: bool) -> Result<(), Failure> {
    if as_json {
        let text = one_or_list(all).map_err(|error| Failure::Analysis(error.to_string()))?;
        say!("{text}");
    } else {
        for looked in all {
            if all.len() > 1 {
                say!("cell {}:", looked.cell);
            }
            for reason in &looked.invalid {
                say!("unusable: {reason}");
            }
            for found in &looked.findings {
                let runs = found.runs.join(", ");
                say!(
                    "{runs}: {} ({}); {}",
                    found.text,
                    found.how_sure,
                    found.effect
                );
            }
            if looked.invalid.is_empty() && looked.findings.is_empty() {
                say!("nothing odd was found in the data");
            }
            for note in &looked.notes {
                say!("note: {note}");
            }
        }
    }
    let invalid: Vec<String> = all
        .iter()
        .flat_map(|l| &l.invalid)
        .map(ToString::to_string)
        .collect();
    if invalid.is_empty() {
        Ok(())
    } else {
        Err(Failure::Invalid(invalid.join("; ")))
    }
}

/// Folder of the diagnosis that a run makes of itself.
const IN_RUN: &str = "diagnosis";

/// Diagnoses a finished run if its experiment requests it, and updates its hashes. A crash in the
/// meantime leaves a complete run.
///
/// # Errors
/// Hashes that cannot be written.
pub(crate) fn finished(
    experiment: &Experiment,
    folder: &Path,
    finished: &mut Finished,
) -> Result<(), Failure> {
    if let Some(rc) = experiment.diagnosed_rc {
        finished.summary.push_str(&of_run(folder, rc));
        sums::write(folder)?;
    }
    Ok(())
}

/// Performs the last step of a run that requests it: diagnoses the run's own data against one of
/// its own models, each cell separately, and writes the results below its folder. Returns the
/// outcome in words. A failed diagnosis does not affect the measured data.
fn of_run(run: &Path, rc: usize) -> String {
    let lines = diagnose_run(run, rc)
        .unwrap_or_else(|failure| vec![format!("could not be made: {failure}")]);
    lines
        .iter()
        .map(|line| format!("diagnosis:  {line}\n"))
        .collect()
}

fn diagnose_run(run: &Path, rc: usize) -> Result<Vec<String>, Failure> {
    let mut all = Judged::read(
        run,
        &ModelArgs::file(run.join(run_folder::model(rc))),
        None,
        false,
    )?;
    all.within = Some(run.to_owned());
    let cells = all.cells(None)?;
    let step = |(name, judged): (&str, Judged)| {
        let folder = below(&run.join(IN_RUN), &cells, name);
        let prefix = if cells.len() > 1 {
            format!("cell {name}: ")
        } else {
            String::new()
        };
        let outcome = judged
            .diagnose()
            .and_then(|outcome| write(&folder, &outcome, &judged).map(|()| outcome));
        match outcome {
            Ok(outcome) => format!(
                "{prefix}{}; {}",
                outcome.diagnosis.summary,
                folder.join("diagnosis.html").display()
            ),
            Err(failure) => format!("{prefix}could not be made: {failure}"),
        }
    };
    Ok(all.each(&cells, None).map(step).collect())
}

/// Returns the folder of a cell's diagnosis: with several cells, each has a separate folder.
fn below(out: &Path, cells: &[String], name: &str) -> PathBuf {
    if cells.len() > 1 {
        out.join(name)
    } else {
        out.to_owned()
    }
}

fn json(outcome: &Outcome) -> Result<String, Failure> {
    serde_json::to_string_pretty(&outcome.diagnosis)
        .map_err(|error| Failure::Analysis(error.to_string()))
}

/// Writes the recommended run as an experiment file, if there is one, and a bench and a cell for
/// it.
fn write_next(
    folder: &Path,
    outcome: &Outcome,
    judged: &Judged,
    args: &DiagnoseArgs,
) -> Result<(), Failure> {
    let (Some(bench), Some(cell), Some(next), false) = (
        &args.bench,
        &args.cell,
        &outcome.diagnosis.next_experiment,
        outcome.next_runs.is_empty(),
    ) else {
        return Ok(());
    };
    let whole = |path: &Path| {
        let found = path
            .canonicalize()
            .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
        Ok::<String, Failure>(found.display().to_string())
    };
    let (bench, cell) = (whole(bench)?, whole(cell)?);
    let erm = outcome
        .diagnosis
        .augmented
        .as_ref()
        .unwrap_or(&judged.model.erm);
    let setting = Setting {
        bench: &bench,
        cell: &cell,
        ocv: &judged.model.ocv,
        resistance_ohm: erm.dc_resistance_ohm(),
    };
    files::write_text(
        folder,
        "next_experiment.toml",
        &experiment_file(next, &outcome.next_runs, &setting),
    )
}

/// Formats the diagnosis as one HTML page, with the data needed to repeat it.
fn page(
    outcome: &Outcome,
    judged: &Judged,
    pictures: &[report::Picture],
) -> Result<String, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
    let mut page = report::html(&outcome.diagnosis, pictures).map_err(|error| failed(&error))?;
    let hashed = |path: &Path| {
        let sum = if path.is_file() {
            hash::sha256_of(path).ok()
        } else {
            None
        };
        format!(
            "{}{}",
            judged.printed_path(path),
            sum.map_or_else(String::new, |sum| format!(", SHA-256 {sum}"))
        )
    };
    let dataset = judged.data.join("dataset.toml");
    let data = if dataset.is_file() {
        dataset
    } else {
        judged.data.join(SUMS)
    };
    let text = judged.file.to_json().map_err(|error| failed(&error))?;
    page.provenance = vec![
        (
            "program".to_owned(),
            format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
        ),
        (
            "data".to_owned(),
            if data.is_file() {
                hashed(&data)
            } else {
                hashed(&judged.data)
            },
        ),
        (
            "model".to_owned(),
            judged
                .model_path()
                .map_or_else(|| judged.named.erm.clone().unwrap_or_default(), hashed),
        ),
        (
            "seed".to_owned(),
            "none: the same files give the same diagnosis".to_owned(),
        ),
        (
            "everything in numbers".to_owned(),
            format!("{DIAGNOSIS} beside this page"),
        ),
        (
            if judged.within.is_some() {
                "to repeat it, in the run folder"
            } else {
                "to repeat it"
            }
            .to_owned(),
            judged.again(),
        ),
    ];
    if let Some(ocv) = judged.ocv_path() {
        page.provenance
            .insert(3, ("open-circuit voltage".to_owned(), hashed(ocv)));
    }
    page.files = vec![("model".to_owned(), text)];
    if let Ok(text) = std::fs::read_to_string(judged.data.join("dataset.toml")) {
        page.files.push(("dataset.toml".to_owned(), text));
    }
    page.to_html().map_err(|error| failed(&error))
}

fn story(outcome: &Outcome) -> Result<String, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
    let diagnosis = &outcome.diagnosis;
    let report = report::html(diagnosis, &[]).map_err(|error| failed(&error))?;
    let verdict = serde_json::to_value(diagnosis.verdict).map_err(|error| failed(&error))?;
    let story = Story {
        program: diagnosis.program.to_owned(),
        verdict: verdict.as_str().unwrap_or_default().to_owned(),
        summary: diagnosis.summary.clone(),
        sections: report.sections.into_iter().map(Chapter::from).collect(),
    };
    let text = serde_json::to_string_pretty(&story).map_err(|error| failed(&error))?;
    Ok(text + "\n")
}

/// Writes report, pictures, and the augmented model if there is one.
fn write(folder: &Path, outcome: &Outcome, judged: &Judged) -> Result<(), Failure> {
    files::make_folder(folder)?;
    files::write_text(folder, DIAGNOSIS, &(json(outcome)? + "\n"))?;
    let d = &outcome.diagnosis;
    let pictures = report::pictures(d, &outcome.curves);
    files::write_pictures(folder, &pictures)?;
    files::write_text(folder, "diagnosis.md", &report::markdown(d, &pictures))?;
    files::write_text(folder, "diagnosis.html", &page(outcome, judged, &pictures)?)?;
    files::write_text(folder, STORY, &story(outcome)?)?;
    let base = judged.file.clone().with_ocv(Some(judged.model.ocv.clone()));
    files::write_augmented(folder, &base, outcome, &judged.loaded.refused)
}
