//! `eis-bench diagnose`: where a model and a data set disagree, what is missing, and whether adding
//! it closes the gap.

use std::path::{Path, PathBuf};

use analysis::{
    diagnosis::{
        self, BaseModel, DiagnosisOptions, Finding, FindingKind, Fixture, Outcome, Verdict,
        findings::inspect, gate, report,
    },
    given::GivenModel,
    ocv::OcvCurve,
    run_folder::{self, JOURNAL, SUMS},
};
use serde::Serialize;

use super::model_args::{DatasetModelArgs, ModelArgs};
use crate::{
    config::Experiment,
    files,
    investigate::dataset::{Accept, Loaded, NamedFile, NamedFiles, Reading, named_files, read_as},
    investigate::next_experiment::{Setting, experiment_file},
    operator::progress::Waiting,
    run::{Finished, Recorded},
    safety::failure::Failure,
    support::hash,
    support::present::{one_or_list, quoted},
    support::sums,
    support::terminal::say,
};

/// Arguments of `diagnose`.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// The data set: a folder with `dataset.toml`, or a run folder.
    #[arg(value_name = "DATASET")]
    pub data: PathBuf,
    /// The model to be judged.
    #[command(flatten)]
    pub model: DatasetModelArgs,
    /// The OCV curve, as `ocv --out` writes it (`ocv.json`), where the model file holds none or
    /// another is wanted [default: `ocv` of dataset.toml]
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// Write `diagnosis.html`, `diagnosis.json`, `diagnosis.md` with its pictures and, where
    /// effects were added, `model_augmented.json` and, where no name is certain,
    /// `model_predictive.json` into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The bench's file: with --cell and --out, the recommended run is written as
    /// `next_experiment.toml` for it.
    #[arg(long, value_name = "FILE", requires_all = ["cell", "out"])]
    pub bench: Option<PathBuf>,
    /// The cell's file, for the same.
    #[arg(long, value_name = "FILE", requires = "bench")]
    pub cell: Option<PathBuf>,
    /// The one cell of a campaign that is meant [default: each of them by itself].
    #[arg(long, value_name = "NAME")]
    pub specimen: Option<String>,
    /// Use points that the quality gate of their measurement refused, too.
    #[arg(long)]
    pub refused_points: bool,
    /// Use the correction of this finding on the data in the place of the raw data; every result
    /// says so.
    #[arg(long, value_name = "FINDING", value_enum)]
    pub accept: Vec<Accept>,
    /// Look at the data only: what is odd in them and what makes them unusable, within a second and
    /// without a diagnosis.
    #[arg(long, conflicts_with_all = ["out", "accept"])]
    pub findings: bool,
    /// Print JSON; of several cells, a list.
    #[arg(long)]
    pub json: bool,
}

/// Diagnoses, prints, and writes into a folder if asked to.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written;
/// [`Failure::Invalid`], once everything is told, where the data cannot be diagnosed. Any other
/// verdict is a result and no error.
pub fn diagnose(args: &DiagnoseArgs) -> Result<(), Failure> {
    let mut judged = Judged::read(
        &args.data,
        &ModelArgs::from(&args.model),
        args.ocv.as_deref(),
        args.refused_points,
    )?;
    accept(&mut judged.loaded, &args.accept);
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
            say!(
                "{}",
                serde_json::to_string_pretty(&diagnoses)
                    .map_err(|error| Failure::Analysis(error.to_string()))?
            );
        }
    }
    // Everything is told and written by now; whoever reads nothing but the exit code must know.
    match outcomes
        .iter()
        .find(|outcome| outcome.diagnosis.verdict == Verdict::Invalid)
    {
        Some(outcome) => Err(Failure::Invalid(outcome.diagnosis.summary.clone())),
        None => Ok(()),
    }
}

/// Findings on the data of a cell.
#[derive(Debug, Serialize)]
struct Looked<'a> {
    cell: &'a str,
    /// Reasons why the data are unusable.
    invalid: Vec<gate::Reason>,
    findings: Vec<Finding>,
    notes: Vec<String>,
}

/// Prints what was found.
///
/// # Errors
/// [`Failure::Invalid`], once everything is told, where the data of a cell cannot be diagnosed.
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

/// Diagnoses a finished run where its experiment asks for that, and renews its hashes. A process
/// that dies meanwhile leaves a whole run.
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

/// The last step of a run that asks for it: its own data against one of its own models, each cell
/// by itself, written below its folder. In words; a diagnosis that cannot be made costs nothing of
/// what was measured.
fn of_run(run: &Path, rc: usize) -> String {
    let told = diagnose_run(run, rc)
        .unwrap_or_else(|failure| vec![format!("could not be made: {failure}")]);
    told.iter()
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

/// Where the diagnosis of a cell is written: of several each has a folder of its own.
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

/// Uses the corrections of these findings, too.
fn accept(loaded: &mut Loaded, accepted: &[Accept]) {
    for kind in accepted.iter().map(|one| one.kind()) {
        if !loaded.accept.contains(&kind) {
            loaded.accept.push(kind);
        }
    }
}

/// A data set and the model that it judges.
pub(super) struct Judged {
    pub(super) loaded: Loaded,
    pub(super) model: BaseModel,
    file: GivenModel,
    data: PathBuf,
    named: ModelArgs,
    /// The file that the curve was asked for from.
    ocv: Option<PathBuf>,
    /// Files that the data set named and no argument did.
    defaults: NamedFiles,
    /// The one cell that is meant, where there are several.
    specimen: Option<String>,
    /// The run folder of which it is a step: what it tells of files is told from there, so that a
    /// run is the same in whichever folder.
    within: Option<PathBuf>,
    /// It was asked for points that a quality gate has refused.
    refused_points: bool,
}

impl Judged {
    /// Reads both. The model is that of the arguments, else that of the data set. The curve is that
    /// of `ocv`, of a model of the arguments, of the data set, of its model, or of the cell's file
    /// of a run folder.
    pub(super) fn read(
        data: &Path,
        named: &ModelArgs,
        ocv: Option<&Path>,
        refused_points: bool,
    ) -> Result<Self, Failure> {
        let NamedFiles {
            model: in_set,
            ocv: curve_in_set,
        } = named_files(data)?;
        let named_model = in_set.filter(|_| named.is_absent());
        let fail = |text: &str| match &named_model {
            Some(file) => Failure::from(file.complain(text)),
            None if named.model.is_some() => {
                Failure::Usage(format!("--model {}: {text}", named.told()))
            }
            None => Failure::Usage(format!("{}: {text}", named.told())),
        };
        let file = match &named_model {
            Some(file) => named.read_named(file)?,
            None if named.is_absent() => {
                return Err(Failure::Usage(format!(
                    "{}: expected --model, --erm, or `model` in its dataset.toml, found none",
                    data.display()
                )));
            }
            None => named.read(None)?,
        };
        let without_curve = ocv.is_none() && (named_model.is_some() || file.ocv.is_none());
        let named_ocv = curve_in_set.filter(|_| without_curve);
        let given = match (ocv, &named_ocv) {
            (Some(path), _) => Some(files::read_curve(path)?),
            (None, Some(file)) => Some(read_named_curve(file)?),
            (None, None) => None,
        };
        let mut curve = given.or_else(|| file.ocv.clone());
        if curve.is_none() && data.join(JOURNAL).is_file() {
            curve = Recorded::read(data)?.ocv().cloned();
        }
        let curve = curve
            .ok_or_else(|| fail("expected an OCV curve in it, found none; give one with --ocv"))?;
        if !file.additions.is_empty() {
            return Err(fail(
                "expected a model without additions: the diagnosis starts from the extended \
                Randles model alone",
            ));
        }
        let model = BaseModel {
            name: file.name.clone(),
            erm: file.erm.clone(),
            ocv: curve,
        };
        let reading = Reading {
            refused_points,
            ..Reading::default()
        };
        Ok(Self {
            loaded: read_as(data, reading)?,
            model,
            file,
            data: data.to_owned(),
            named: named.clone(),
            ocv: ocv.map(Path::to_owned),
            defaults: NamedFiles {
                model: named_model,
                ocv: named_ocv,
            },
            specimen: None,
            within: None,
            refused_points,
        })
    }

    /// The names of the cells that are to be judged, each by itself: a model is one cell's.
    fn cells(&self, specimen: Option<&str>) -> Result<Vec<String>, Failure> {
        let mut cells: Vec<String> = Vec::new();
        for run in &self.loaded.set.runs {
            if let Fixture::Cell(name) = &run.fixture
                && !cells.contains(name)
            {
                cells.push(name.clone());
            }
        }
        match specimen {
            Some(wanted) if !cells.iter().any(|cell| cell == wanted) => {
                Err(Failure::Usage(format!(
                    "--specimen: expected one of {}, found {wanted}",
                    cells.join(", ")
                )))
            }
            Some(wanted) => Ok(vec![wanted.to_owned()]),
            // Without any run of a cell there is still something to be said.
            None if cells.is_empty() => Ok(vec![String::new()]),
            None => Ok(cells),
        }
    }

    /// Each cell by itself, with its name; the one that was asked for, and each of several, is
    /// named in the command that repeats it.
    fn each<'a>(
        &'a self,
        cells: &'a [String],
        asked: Option<&'a str>,
    ) -> impl Iterator<Item = (&'a str, Self)> {
        cells.iter().map(move |name| {
            let specimen = asked
                .or((cells.len() > 1).then_some(name))
                .map(str::to_owned);
            (
                name.as_str(),
                Self {
                    specimen,
                    ..self.of_cell(name)
                },
            )
        })
    }

    /// The same with the runs of one cell, and those of the controls.
    fn of_cell(&self, name: &str) -> Self {
        let mut set = self.loaded.set.clone();
        set.runs
            .retain(|run| !matches!(&run.fixture, Fixture::Cell(other) if other != name));
        let refused = self.loaded.refused.clone();
        let loaded = Loaded {
            set,
            problems: self.loaded.problems.clone(),
            notes: self.loaded.notes.clone(),
            findings: self.loaded.findings.clone(),
            accept: self.loaded.accept.clone(),
            refused,
        };
        let (model, file, ocv) = (self.model.clone(), self.file.clone(), self.ocv.clone());
        let (specimen, within, refused_points) = (
            self.specimen.clone(),
            self.within.clone(),
            self.refused_points,
        );
        Self {
            loaded,
            model,
            file,
            data: self.data.clone(),
            named: self.named.clone(),
            ocv,
            defaults: self.defaults.clone(),
            specimen,
            within,
            refused_points,
        }
    }

    /// The model's file, where it has one.
    fn model_path(&self) -> Option<&Path> {
        let by_data_set = self.defaults.model.as_ref().map(|file| file.path.as_path());
        by_data_set.or(self.named.model.as_deref())
    }

    /// The file of the curve, where it has one of its own.
    fn ocv_path(&self) -> Option<&Path> {
        let by_data_set = self.defaults.ocv.as_ref().map(|file| file.path.as_path());
        by_data_set.or(self.ocv.as_deref())
    }

    /// A path as it is told.
    fn told(&self, path: &Path) -> String {
        match self
            .within
            .as_ref()
            .and_then(|folder| path.strip_prefix(folder).ok())
        {
            Some(below) if below.as_os_str().is_empty() => ".".to_owned(),
            Some(below) => below.display().to_string(),
            None => path.display().to_string(),
        }
    }

    /// The command that gives the same diagnosis.
    fn again(&self) -> String {
        let word = |path: &Path| quoted(Path::new(&self.told(path)));
        let mut text = format!(
            "eis-bench diagnose {}{}",
            word(&self.data),
            self.named.again(|path| self.told(path))
        );
        if let Some(ocv) = &self.ocv {
            text.push_str(&format!(" --ocv {}", word(ocv)));
        }
        if self.refused_points {
            text.push_str(" --refused-points");
        }
        if self.loaded.accept.contains(&FindingKind::CurrentFilter) {
            text.push_str(" --accept current_filter");
        }
        if let Some(specimen) = &self.specimen {
            text.push_str(&format!(" --specimen {}", quoted(Path::new(specimen))));
        }
        text
    }

    /// Runs that could not be read.
    fn unreadable(&self) -> Vec<gate::Reason> {
        let problems = self.loaded.problems.iter();
        problems
            .map(|problem| gate::Reason::unreadable(&problem.run, &problem.text))
            .collect()
    }

    /// Findings on the files of the runs of this cell and of the controls.
    fn findings_of_files(&self) -> impl Iterator<Item = Finding> {
        let named = |run: &String| self.loaded.set.runs.iter().any(|other| other.name == *run);
        let of_files = self.loaded.findings.iter();
        of_files
            .filter(move |finding| finding.runs.iter().all(named))
            .cloned()
    }

    /// Findings on the data, without a diagnosis.
    fn look<'a>(&self, cell: &'a str) -> Looked<'a> {
        let (report, mut findings) = inspect(&self.loaded.set, &self.model);
        findings.extend(self.findings_of_files());
        let mut invalid = self.unreadable();
        invalid.extend(report.invalid);
        let notes = report
            .notes
            .into_iter()
            .chain(self.loaded.notes.iter().cloned());
        Looked {
            cell,
            invalid,
            findings,
            notes: notes.collect(),
        }
    }

    /// The diagnosis of what could be read; what could not makes the data invalid.
    fn diagnose(&self) -> Result<Outcome, Failure> {
        let unreadable = self.unreadable();
        let waiting = Waiting::shown();
        let outcome = diagnosis::diagnose(
            &self.loaded.set,
            unreadable,
            &self.model,
            &DiagnosisOptions {
                accept: self.loaded.accept.clone(),
                progress: waiting.listener(),
                ..DiagnosisOptions::default()
            },
        );
        waiting.end();
        let mut outcome = outcome.map_err(|error| Failure::Usage(error.to_string()))?;
        let d = &mut outcome.diagnosis;
        d.findings.extend(self.findings_of_files());
        d.notes.extend(self.loaded.notes.iter().cloned());
        outcome.diagnosis.notes.extend(self.file.notes());
        Ok(outcome)
    }
}

/// The curve that a data set names. A complaint names the place that names it.
fn read_named_curve(file: &NamedFile) -> Result<OcvCurve, Failure> {
    files::read_curve(&file.path).map_err(|error| {
        file.complain(format!(
            "expected an OCV curve as `ocv --out` writes it; {error}"
        ))
        .into()
    })
}

/// The recommended run as an experiment file, where there is one, and a bench and a cell for it.
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

/// The diagnosis as one page of HTML, with what it takes to repeat it.
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
            judged.told(path),
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
            "diagnosis.json beside this page".to_owned(),
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

/// Report, pictures, and the augmented model where there is one.
fn write(folder: &Path, outcome: &Outcome, judged: &Judged) -> Result<(), Failure> {
    files::make_folder(folder)?;
    files::write_text(folder, "diagnosis.json", &(json(outcome)? + "\n"))?;
    let d = &outcome.diagnosis;
    let pictures = report::pictures(d, &outcome.curves);
    files::write_pictures(folder, &pictures)?;
    files::write_text(folder, "diagnosis.md", &report::markdown(d, &pictures))?;
    files::write_text(folder, "diagnosis.html", &page(outcome, judged, &pictures)?)?;
    let base = judged.file.clone().with_ocv(Some(judged.model.ocv.clone()));
    files::write_augmented(folder, &base, outcome, &judged.loaded.refused)
}
