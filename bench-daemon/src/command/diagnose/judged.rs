//! A data set, the model that it judges, and its diagnosis.

use std::path::{Path, PathBuf};

use analysis::{
    diagnosis::{
        self, BaseModel, ByHand, DiagnosisOptions, Finding, FindingKind, Fixture, Outcome,
        Progress, findings::inspect, gate,
    },
    given::GivenModel,
    ocv::OcvCurve,
    run_folder::JOURNAL,
};
use serde::Serialize;

use crate::command::model_args::ModelArgs;
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::{
    files,
    investigate::dataset::{Accept, Loaded, NamedFile, NamedFiles, Reading, named_files, read_as},
    run::Recorded,
};
use bench_plan::support::quoted::quoted;

/// Findings on the data of a cell.
#[derive(Debug, Serialize)]
pub(super) struct Looked<'a> {
    pub(super) cell: &'a str,
    /// Reasons why the data are unusable.
    pub(super) invalid: Vec<gate::Reason>,
    pub(super) findings: Vec<Finding>,
    pub(super) notes: Vec<String>,
}

/// Uses the corrections of these findings, too.
pub(super) fn accept(loaded: &mut Loaded, accepted: &[Accept]) {
    for kind in accepted.iter().map(|one| one.kind()) {
        if !loaded.accept.contains(&kind) {
            loaded.accept.push(kind);
        }
    }
}

/// A data set and the model that it judges.
pub(crate) struct Judged {
    pub(crate) loaded: Loaded,
    pub(crate) model: BaseModel,
    pub(super) file: GivenModel,
    pub(super) data: PathBuf,
    pub(super) named: ModelArgs,
    /// The requested file of the curve.
    ocv: Option<PathBuf>,
    /// Files that the data set named and no argument did.
    defaults: NamedFiles,
    /// Whether the model is a map, which is judged by its model at one state.
    is_of_map: bool,
    /// The selected cell, if there are several.
    specimen: Option<String>,
    /// The run folder if the diagnosis is a step of a run. File paths are reported relative to
    /// it, so that the output does not depend on the location of the folder.
    pub(super) within: Option<PathBuf>,
    /// Whether points that a quality gate has refused were requested.
    refused_points: bool,
    /// No effect is looked for.
    pub(super) base_only: bool,
    /// Suppresses progress messages.
    pub(super) quiet: bool,
    /// Effects put in or left out by hand.
    pub(super) by_hand: ByHand,
}

impl Judged {
    /// Reads model and data set. The model is that of the arguments, otherwise that of the data
    /// set. The curve is the first of: `ocv`, that of a model of the arguments, that of the data
    /// set, that of its model, or that of the cell's file of a run folder.
    pub(crate) fn read(
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
                Failure::Usage(format!("--model {}: {text}", named.display_name()))
            }
            None => Failure::Usage(format!("{}: {text}", named.display_name())),
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
        let reading = Reading {
            refused_points,
            ..Reading::default()
        };
        let loaded = read_as(data, reading)?;
        if file.map.is_some() && loaded.set.mean_state(&curve).is_none() {
            return Err(fail(
                "expected runs with a state on its OCV curve, found none",
            ));
        }
        let model = BaseModel {
            name: file.name.clone(),
            erm: file.erm.clone(),
            ocv: curve,
        };
        Ok(Self {
            loaded,
            is_of_map: file.map.is_some(),
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
            base_only: false,
            quiet: false,
            by_hand: ByHand::default(),
        })
    }

    /// Returns the same with what is put in or left out by hand.
    ///
    /// # Errors
    /// An effect to put in that the model has, or one to leave out that it does not have.
    pub(super) fn asking(self, by_hand: ByHand) -> Result<Self, Failure> {
        let own: Vec<&str> = self
            .file
            .additions
            .iter()
            .map(|a| a.name.as_str())
            .collect();
        let listed = if own.is_empty() {
            "none".to_owned()
        } else {
            own.join(", ")
        };
        if let Some(name) = by_hand.add.iter().find(|name| own.contains(*name)) {
            let reason =
                format!("--add {name}: expected an effect that the model lacks; it has {listed}");
            return Err(Failure::Usage(reason));
        }
        if let Some(name) = by_hand.without.iter().find(|name| !own.contains(*name)) {
            let reason =
                format!("--without {name}: expected one of the model's additions: {listed}");
            return Err(Failure::Usage(reason));
        }
        Ok(Self { by_hand, ..self })
    }

    /// Returns the names of the cells to diagnose separately, because a model describes one cell.
    pub(super) fn cells(&self, specimen: Option<&str>) -> Result<Vec<String>, Failure> {
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

    /// Returns the name of each cell with its data. A cell that was requested, and each of
    /// several cells, is named in the command that repeats its diagnosis.
    pub(super) fn each<'a>(
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

    /// Restricts the data to the runs of one cell, and those of the controls.
    pub(super) fn of_cell(&self, name: &str) -> Self {
        let mut set = self.loaded.set.clone();
        set.runs
            .retain(|run| !matches!(&run.fixture, Fixture::Cell(other) if other != name));
        let refused = self.loaded.refused.clone();
        let mut loaded = Loaded {
            set,
            problems: self.loaded.problems.clone(),
            notes: self.loaded.notes.clone(),
            findings: self.loaded.findings.clone(),
            accept: self.loaded.accept.clone(),
            refused,
        };
        let (mut model, mut file, ocv) = (self.model.clone(), self.file.clone(), self.ocv.clone());
        // A map is judged by its model at the state of the cell's runs.
        if let Some(state) = loaded.set.mean_state(&model.ocv)
            && let Some((at_state, notes)) = file
                .clone()
                .with_ocv(Some(model.ocv.clone()))
                .at_state(&state)
        {
            loaded.notes.extend(notes);
            model.erm = at_state.erm.clone();
            model.ocv = at_state.ocv.clone().unwrap_or(model.ocv);
            file = at_state;
        }
        let (specimen, within, refused_points) = (
            self.specimen.clone(),
            self.within.clone(),
            self.refused_points,
        );
        Self {
            loaded,
            is_of_map: self.is_of_map,
            model,
            file,
            data: self.data.clone(),
            named: self.named.clone(),
            ocv,
            defaults: self.defaults.clone(),
            specimen,
            within,
            refused_points,
            base_only: self.base_only,
            quiet: self.quiet,
            by_hand: self.by_hand.clone(),
        }
    }

    /// Returns the model's file, if it has one.
    pub(super) fn model_path(&self) -> Option<&Path> {
        let by_data_set = self.defaults.model.as_ref().map(|file| file.path.as_path());
        by_data_set.or(self.named.model.as_deref())
    }

    /// Returns the file of the curve, if it has a separate one.
    pub(super) fn ocv_path(&self) -> Option<&Path> {
        let by_data_set = self.defaults.ocv.as_ref().map(|file| file.path.as_path());
        by_data_set.or(self.ocv.as_deref())
    }

    /// Returns a path as it is printed.
    pub(super) fn printed_path(&self, path: &Path) -> String {
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

    /// Returns the command that repeats this diagnosis.
    pub(super) fn again(&self) -> String {
        let word = |path: &Path| quoted(Path::new(&self.printed_path(path)));
        let mut text = format!(
            "eis-bench diagnose {}{}",
            word(&self.data),
            self.named.again(|path| self.printed_path(path))
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
        for (word, names) in [
            ("add", &self.by_hand.add),
            ("without", &self.by_hand.without),
        ] {
            names
                .iter()
                .for_each(|name| text.push_str(&format!(" --{word} {name}")));
        }
        if let Some(specimen) = &self.specimen {
            text.push_str(&format!(" --specimen {}", quoted(Path::new(specimen))));
        }
        text
    }

    /// Runs that could not be read.
    pub(super) fn unreadable(&self) -> Vec<gate::Reason> {
        let problems = self.loaded.problems.iter();
        problems
            .map(|problem| gate::Reason::unreadable(&problem.run, &problem.text))
            .collect()
    }

    /// Findings on the files of the runs of this cell and of the controls.
    pub(super) fn findings_of_files(&self) -> impl Iterator<Item = Finding> {
        let named = |run: &String| self.loaded.set.runs.iter().any(|other| other.name == *run);
        let of_files = self.loaded.findings.iter();
        of_files
            .filter(move |finding| finding.runs.iter().all(named))
            .cloned()
    }

    /// Findings on the data, without a diagnosis.
    pub(super) fn look<'a>(&self, cell: &'a str) -> Looked<'a> {
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
    pub(super) fn diagnose(&self) -> Result<Outcome, Failure> {
        let unreadable = self.unreadable();
        let waiting = (!self.quiet).then(Waiting::shown);
        let mut options = DiagnosisOptions {
            accept: self.loaded.accept.clone(),
            given: self.file.additions.clone(),
            by_hand: self.by_hand.clone(),
            progress: waiting
                .as_ref()
                .map(|waiting| Progress::new(waiting.listener()))
                .unwrap_or_default(),
            ..DiagnosisOptions::default()
        };
        if self.base_only {
            options.candidates.clear();
        }
        let outcome = diagnosis::diagnose(&self.loaded.set, unreadable, &self.model, &options);
        if let Some(waiting) = waiting {
            waiting.end();
        }
        let mut outcome = outcome.map_err(|error| Failure::Usage(error.to_string()))?;
        let d = &mut outcome.diagnosis;
        d.findings.extend(self.findings_of_files());
        d.notes.extend(self.loaded.notes.iter().cloned());
        if !self.is_of_map {
            outcome.diagnosis.notes.extend(self.file.notes());
        }
        Ok(outcome)
    }
}

/// The curve that a data set names. A complaint names the place that names it.
fn read_named_curve(file: &NamedFile) -> Result<OcvCurve, Failure> {
    files::read_curve(&file.path).map_err(|error| {
        file.complain(format!("expected an OCV curve; {error}"))
            .into()
    })
}
