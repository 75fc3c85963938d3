//! Builds the command line of an analysis. Input from a peer is validated, and is never parsed as
//! an option.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use analysis::{
    fit::MAX_RC,
    run_folder::{self, INDEX},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{error::AnalysisError, joined::joined};
use crate::{find, jobs, settings::Settings, spectra, submission};
use bench_evaluate::{files, run::slope_of_spectrum};
use bench_plan::support::confined_path;

/// Most runs of an analysis.
const MOST_RUNS: usize = 50;
/// Longest circuit, characters.
const LONGEST_CIRCUIT: usize = 500;

/// Kind of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum AnalysisKind {
    /// Fit of the extended Randles model or of a circuit.
    Fit,
    /// Kramers–Kronig and other tests.
    Kk,
    /// Search for the effect that the model lacks.
    Diagnose,
}

impl AnalysisKind {
    /// The command.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fit => "fit",
            Self::Kk => "kk",
            Self::Diagnose => "diagnose",
        }
    }
}

/// Options of an analysis; each belongs to one kind.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// For a fit: orders, such as `1,2,3`, `all` or `auto`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rc: Option<String>,
    /// For a fit: a circuit instead of the extended Randles model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub circuit: Option<String>,
    /// For a fit: `sum-abs`, `modulus` or `complex`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<String>,
    /// For a test: whether to compute the distribution of relaxation times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drt: Option<bool>,
    /// For a diagnosis: number of RC pairs of the run's model. Left out: that of the recommended model, or the
    /// highest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<u8>,
    /// For a diagnosis: one cell of a campaign. Left out: each cell separately.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cell: Option<String>,
}

/// Request for an analysis.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Its kind.
    pub kind: AnalysisKind,
    /// The runs, 1 to 50. For a diagnosis: a campaign, optionally followed by recommended
    /// experiments on the same cell, as one data set.
    pub runs: Vec<String>,
    /// Names of spectra of the run, to select some of its cells; for a single run only.
    #[serde(default)]
    pub spectra: Vec<String>,
    /// Options.
    #[serde(default)]
    pub options: Options,
}

fn unfit<T>(text: impl Into<String>) -> Result<T, AnalysisError> {
    Err(AnalysisError::Unfit(text.into()))
}

/// Returns the arguments after the program name.
///
/// # Errors
/// [`AnalysisError::Unfit`] in words that name the field.
pub(super) fn arguments(
    settings: &Settings,
    request: &Request,
    out: &Path,
) -> Result<Vec<String>, AnalysisError> {
    if request.runs.is_empty() || request.runs.len() > MOST_RUNS {
        return unfit(format!(
            "runs: expected 1 to {MOST_RUNS}, found {}",
            request.runs.len()
        ));
    }
    if request.runs.len() > 1 && !request.spectra.is_empty() {
        return unfit("spectra: expected one run to choose them from, found several");
    }
    if request.runs.iter().collect::<BTreeSet<_>>().len() < request.runs.len() {
        return unfit("runs: expected different runs, found one twice");
    }
    for run in &request.runs {
        if confined_path::folder(&settings.runs(), run).is_none() {
            return unfit(format!(
                "runs: expected names of runs that have begun, found {run:?}"
            ));
        }
    }
    if request.kind == AnalysisKind::Diagnose {
        return diagnose(settings, request, out);
    }
    let mut arguments = vec![request.kind.name().to_owned()];
    let inputs = inputs(settings, request, out)?;
    match request.kind {
        AnalysisKind::Fit => {
            fit(&request.options, &mut arguments)?;
            arguments.extend(inputs.iter().filter_map(Input::slope));
        }
        AnalysisKind::Kk => kk(&request.options, &mut arguments)?,
        AnalysisKind::Diagnose => {}
    }
    arguments.push(format!("--out={}", out.display()));
    arguments.push("--".to_owned());
    arguments.extend(inputs.iter().map(|input| input.read.display().to_string()));
    Ok(arguments)
}

fn fit(options: &Options, arguments: &mut Vec<String>) -> Result<(), AnalysisError> {
    only(options, &["rc", "circuit", "objective"])?;
    if let Some(circuit) = &options.circuit {
        let plain = |c: char| c.is_ascii_graphic() || c == ' ';
        if circuit.is_empty() || circuit.len() > LONGEST_CIRCUIT || !circuit.chars().all(plain) {
            return unfit(format!(
                "options.circuit: expected 1 to {LONGEST_CIRCUIT} ASCII characters"
            ));
        }
        if options.rc.is_some() {
            return unfit("options.rc: expected no orders beside a circuit");
        }
        arguments.push(format!("--circuit={circuit}"));
    }
    if let Some(rc) = &options.rc {
        let digit = |order: &str| {
            order
                .parse::<usize>()
                .ok()
                .filter(|order| (1..=MAX_RC).contains(order))
        };
        let parsed: Option<Vec<usize>> = rc.split(',').map(digit).collect();
        let plain = rc.chars().all(|c| c.is_ascii_digit() || c == ',');
        let different =
            |orders: Vec<usize>| orders.iter().collect::<BTreeSet<_>>().len() == orders.len();
        let orders = plain && parsed.is_some_and(different);
        if !orders && rc != "all" && rc != "auto" {
            return unfit(format!(
                "options.rc: expected orders such as 1,2,3, `all` or `auto`, found {rc:?}"
            ));
        }
        arguments.push(format!("--rc={rc}"));
    }
    if let Some(objective) = &options.objective {
        if !["sum-abs", "modulus", "complex"].contains(&objective.as_str()) {
            return unfit(format!(
                "options.objective: expected `sum-abs`, `modulus` or `complex`, found {objective:?}"
            ));
        }
        arguments.push(format!("--objective={objective}"));
    }
    Ok(())
}

fn kk(options: &Options, arguments: &mut Vec<String>) -> Result<(), AnalysisError> {
    only(options, &["drt"])?;
    if options.drt == Some(true) {
        arguments.push("--drt".to_owned());
    }
    // Several spectra may belong to several cells, so they are not treated as repeats.
    arguments.push("--separate".to_owned());
    Ok(())
}

fn diagnose(
    settings: &Settings,
    request: &Request,
    out: &Path,
) -> Result<Vec<String>, AnalysisError> {
    only(&request.options, &["order", "cell"])?;
    let ([run, later @ ..], true) = (request.runs.as_slice(), request.spectra.is_empty()) else {
        return unfit("spectra: expected no choice of spectra for a diagnosis, found one");
    };
    let folder = settings.runs().join(run);
    let model = model_of(&folder, request.options.order)?;
    let mut arguments = vec![
        AnalysisKind::Diagnose.name().to_owned(),
        format!("--model={}", model.display()),
        format!("--out={}", out.display()),
    ];
    let mut data = folder;
    if !later.is_empty() {
        if request.options.cell.is_some() {
            return unfit(
                "options.cell: expected no choice of a cell with several runs, found one",
            );
        }
        let set = joined(settings, &request.runs, &out.with_file_name("in"))?;
        let ocv = set.ocv.map(|path| format!("--ocv={}", path.display()));
        arguments.extend(ocv);
        data = set.folder;
    }
    let cells = find::cells_of_run(&settings.data, run);
    if let Some(cell) = &request.options.cell {
        if !cells.iter().any(|known| known.name == *cell) {
            return unfit(format!(
                "options.cell: expected a cell of the run, found {cell:?}"
            ));
        }
        arguments.push(format!("--specimen={cell}"));
    }
    // The next experiment is written for one cell.
    if (cells.len() <= 1 || request.options.cell.is_some())
        && let Some(job) = jobs::read(&settings.data, run)
        && let Some(bench) = settings.bench(&job.item.bench)
        && let Some(cell) = submission::cell_file(&settings.data, run)
    {
        arguments.push(format!("--bench={}", bench.path.display()));
        arguments.push(format!("--cell={}", cell.display()));
    }
    arguments.push("--".to_owned());
    arguments.push(data.display().to_string());
    Ok(arguments)
}

/// The run's model of an order; without one, the recommended model, or that of the highest order.
fn model_of(folder: &Path, order: Option<u8>) -> Result<PathBuf, AnalysisError> {
    let given = order.map(usize::from);
    let wanted = given.or_else(|| files::recommended_order(folder));
    let all = (1..=MAX_RC)
        .rev()
        .filter(|rc| wanted.is_none_or(|wanted| wanted == *rc));
    let path = all
        .map(|rc| folder.join(run_folder::model(rc)))
        .find(|path| path.is_file());
    let wanted = order.map_or_else(String::new, |order| format!(" with {order} RC pairs"));
    path.ok_or_else(|| {
        AnalysisError::Unfit(format!(
            "options.order: expected a model{wanted} in the run, found none: fit one first"
        ))
    })
}

/// Refuses options of another kind.
fn only(options: &Options, allowed: &[&str]) -> Result<(), AnalysisError> {
    let given =
        serde_json::to_value(options).map_err(|error| AnalysisError::Io(error.to_string()))?;
    let other = given
        .as_object()
        .and_then(|all| all.keys().find(|key| !allowed.contains(&key.as_str())));
    match other {
        Some(key) => unfit(format!(
            "options.{key}: expected one of {}, found another",
            allowed.join(", ")
        )),
        None => Ok(()),
    }
}

/// A spectrum that an analysis reads.
struct Input {
    /// The file that is read: the one of the run, or its copy.
    read: PathBuf,
    /// The file of the run.
    of_run: PathBuf,
}

impl Input {
    /// Returns the argument with the slope of the open-circuit voltage, which a copy does not
    /// have.
    fn slope(&self) -> Option<String> {
        let slope = slope_of_spectrum(&self.of_run).filter(|_| self.read != self.of_run)?;
        let slope = slope.at.slope;
        Some(format!(
            "--slope-of={}={},{}",
            self.read.display(),
            slope.v_per_coulomb,
            slope.sigma_v_per_coulomb
        ))
    }
}

/// Returns the input spectra. Those of one run are read in place; those of several runs are
/// copied to file names that contain the run.
fn inputs(settings: &Settings, request: &Request, out: &Path) -> Result<Vec<Input>, AnalysisError> {
    let mut found = Vec::new();
    for run in &request.runs {
        let folder = settings.runs().join(run);
        let files = chosen_files(&folder, &request.spectra)?;
        if files.is_empty() {
            return unfit(format!(
                "runs: expected runs with a corrected spectrum of a cell, found none in {run}"
            ));
        }
        // A fit uses the errors that points share.
        let read = |file: &str| {
            let shared = folder.join(run_folder::shared_spectrum(file));
            let is_shared = request.kind == AnalysisKind::Fit && shared.is_file();
            if is_shared { shared } else { folder.join(file) }
        };
        found.extend(files.into_iter().map(|file| (run, read(&file), file)));
    }
    if request.runs.len() == 1 {
        return Ok(found
            .into_iter()
            .map(|(_, path, _)| Input {
                read: path.clone(),
                of_run: path,
            })
            .collect());
    }
    let copies = out.with_file_name("in");
    let failed = |error: std::io::Error| AnalysisError::Io(error.to_string());
    std::fs::create_dir_all(&copies).map_err(failed)?;
    let copy = |(run, path, file): (&String, PathBuf, String)| {
        let name = file.replace('/', "-");
        let to = copies.join(format!("{run}-{name}"));
        std::fs::copy(&path, &to).map_err(failed)?;
        Ok(Input {
            read: to,
            of_run: path,
        })
    };
    found.into_iter().map(copy).collect()
}

/// The files of the spectra that are meant, else of all corrected ones of cells.
fn chosen_files(folder: &Path, wanted: &[String]) -> Result<Vec<String>, AnalysisError> {
    let known = spectra::stamps(folder);
    if !wanted.is_empty() {
        let file = |name: &String| {
            let file = format!("{name}.csv");
            if known.contains_key(&file) {
                Ok(file)
            } else {
                unfit(format!(
                    "spectra: expected names of spectra of the run, found {name:?}"
                ))
            }
        };
        return wanted.iter().map(file).collect();
    }
    let index = confined_path::open(folder, INDEX)
        .and_then(|file| serde_json::from_reader::<_, analysis::dataset::RunIndex>(file).ok());
    let sweeps = index.into_iter().flat_map(|index| index.sweeps);
    let of_cells = sweeps.filter(|sweep| sweep.fixture == "cell" && sweep.corrected);
    Ok(of_cells
        .map(|sweep| sweep.file)
        .filter(|file| known.contains_key(file))
        .collect())
}

/// As a person would type it.
pub(super) fn in_words(arguments: &[String]) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:".contains(c);
    let quoted = |argument: &String| {
        if argument.chars().all(plain) {
            argument.clone()
        } else {
            format!("'{}'", argument.replace('\'', r"'\''"))
        }
    };
    let words: Vec<String> = arguments.iter().map(quoted).collect();
    format!("eis-bench {}", words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_another_kind_are_refused() {
        let options = Options {
            drt: Some(true),
            ..Options::default()
        };
        let message = fit(&options, &mut Vec::new()).unwrap_err().to_string();
        assert_eq!(
            message,
            "options.drt: expected one of rc, circuit, objective, found another"
        );
    }

    #[test]
    fn what_is_typed_stays_one_argument() {
        let mut arguments = Vec::new();
        let circuit = Some("R0-p(R1,C1) --seed 3".to_owned());
        fit(
            &Options {
                circuit,
                ..Options::default()
            },
            &mut arguments,
        )
        .unwrap();
        assert_eq!(arguments, ["--circuit=R0-p(R1,C1) --seed 3"]);
        assert_eq!(
            in_words(&arguments),
            "eis-bench '--circuit=R0-p(R1,C1) --seed 3'"
        );
        let highest = Options {
            rc: Some("8".to_owned()),
            ..Options::default()
        };
        assert!(fit(&highest, &mut Vec::new()).is_ok());
        for rc in ["", "0", "9", "1,,2", "1,1", "+1", "all;rm", "12"] {
            let options = Options {
                rc: Some(rc.to_owned()),
                ..Options::default()
            };
            assert!(fit(&options, &mut Vec::new()).is_err(), "{rc:?}");
        }
    }
}
