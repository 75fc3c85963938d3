//! Makes a checked, frozen experiment from a peer's request. Files are read within the
//! configuration folder only, and the plan is checked. All checked files are copied into the data
//! folder, so that later changes of a file do not alter the submission.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use analysis::dataset::write_atomically;

use super::{settings::Settings, shelf};
use bench_plan::{
    config::{self, ConfigError, Experiment, Fence, Source, resolve_experiment},
    procedure,
};

/// Folder of the experiments within the configuration folder.
const EXPERIMENTS: &str = "experiments";
/// Maximum length of an experiment name; the name of the run appends a number.
const LONGEST_NAME: usize = 60;

/// A submission that was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// No experiment of this name.
    #[error("expected the name of an experiment, found {0:?}; GET /api/v1/experiments lists them")]
    Unknown(String),
    /// A field is not as expected.
    #[error("{0}")]
    Mistake(ConfigError),
    /// The request cannot be run.
    #[error("{0}")]
    Unfit(String),
    /// It cannot be kept.
    #[error("{0}")]
    Kept(String),
}

/// The experiment that is asked for.
#[derive(Debug, Clone, Copy)]
pub struct ExperimentRequest<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its text; `None` for the text of the file of this name.
    pub text: Option<&'a str>,
    /// The bench; `None` for the one that the experiment names.
    pub bench: Option<&'a str>,
}

/// An experiment that may be run.
pub struct Submission {
    /// The experiment, on the bench that will run it.
    pub experiment: Experiment,
    /// Expected duration of its plan, bench s.
    pub expected_s: f64,
    /// Longest possible duration, bench s.
    pub longest_s: f64,
    fence: Arc<Fence>,
}

/// Returns the text of an experiment by its name.
///
/// # Errors
/// No such experiment; a file that cannot be read.
fn text_of(settings: &Settings, name: &str) -> Result<String, Refused> {
    let file = shelf::read(settings, shelf::FileKind::Experiments, name, None)
        .map_err(|error| Refused::Kept(error.to_string()))?;
    file.map(|file| file.text)
        .ok_or_else(|| Refused::Unknown(name.to_owned()))
}

impl Submission {
    /// Checks a requested experiment.
    ///
    /// # Errors
    /// Reason why it cannot be run.
    pub fn new(settings: &Settings, request: ExperimentRequest<'_>) -> Result<Self, Refused> {
        let ExperimentRequest { name, text, bench } = request;
        let text = text.map_or_else(|| text_of(settings, name), |text| Ok(text.to_owned()))?;
        let path = settings
            .configs
            .join(EXPERIMENTS)
            .join(format!("{name}.toml"));
        let bench = chosen(settings, &path, &text, bench)?;
        let also = std::iter::once(bench.path.clone())
            .chain(
                bench
                    .simulation
                    .iter()
                    .map(|section| section.scenario.clone()),
            )
            .collect();
        let fence = Arc::new(Fence {
            below: settings.configs.clone(),
            also,
            instead: shelf::changed(settings).map_err(|error| Refused::Kept(error.to_string()))?,
        });
        let unfit = |error: &dyn std::fmt::Display| Refused::Unfit(error.to_string());
        let experiment = resolve_experiment(Source::fenced(&path, text, &fence), Some(&bench.path))
            .map_err(Refused::Mistake)?;
        if experiment.bench.sha256 != bench.sha256 {
            return Err(Refused::Unfit(shelf::restart(&bench.name)));
        }
        if experiment.name.len() > LONGEST_NAME {
            return Err(Refused::Unfit(format!(
                "expected a name of at most {LONGEST_NAME} letters, found {}",
                experiment.name.len()
            )));
        }
        let plan = procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .map_err(|error| unfit(&format!("the plan is refused: {error}")))?;
        let (expected_s, longest_s) = (plan.plan().expected_s(), plan.plan().longest_s());
        Ok(Self {
            experiment,
            expected_s: expected_s.0,
            longest_s: longest_s.0,
            fence,
        })
    }

    /// Copies the checked files into the data folder.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn freeze(&self, folder: &Path) -> Result<(), Refused> {
        let kept = |error: &dyn std::fmt::Display| Refused::Kept(error.to_string());
        for source in &self.experiment.sources {
            // The bench and its scenario are not copied: the state lies beside the bench file,
            // and the guardian reads the same file.
            let name = self
                .fence
                .relative(source.path())
                .filter(|_| !self.fence.also.iter().any(|path| path == source.path()));
            let Some(name) = name else { continue };
            let path = folder.join(name);
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent).map_err(|error| kept(&error))?;
            }
            write_atomically(&path, source.text().as_bytes()).map_err(|error| kept(&error))?;
        }
        // Hash of the bench file when the plan was checked: a run on a changed bench does not
        // begin.
        let sha256 = &self.experiment.bench.sha256;
        write_atomically(&folder.join(shelf::BENCH_SHA256), sha256.as_bytes())
            .map_err(|error| kept(&error))
    }
}

/// The frozen experiment in such a folder.
pub fn frozen(folder: &Path) -> Option<PathBuf> {
    let mut entries = std::fs::read_dir(folder.join(EXPERIMENTS)).ok()?.flatten();
    entries
        .find(|entry| entry.path().extension().is_some_and(|end| end == "toml"))
        .map(|entry| entry.path())
}

/// Returns the text of the experiment of a run as it was submitted, with its path.
pub fn of_run(data: &Path, run: &str) -> Option<(PathBuf, String)> {
    let path = frozen(&data.join("submitted").join(run))?;
    let text = std::fs::read_to_string(&path).ok()?;
    Some((path, text))
}

/// Returns the submitted experiment of a run as values.
pub fn value_of_run(data: &Path, run: &str) -> Option<toml::Value> {
    toml::from_str(&of_run(data, run)?.1).ok()
}

/// Returns the submitted cell file of a run.
pub fn cell_file(data: &Path, run: &str) -> Option<PathBuf> {
    let (path, text) = of_run(data, run)?;
    let experiment: toml::Value = toml::from_str(&text).ok()?;
    let cell = experiment.get("cell")?.as_str()?;
    path.parent()?.join(cell).canonicalize().ok()
}

/// Returns the bench of this name, or the bench that the experiment names, if it belongs to the
/// server.
fn chosen<'a>(
    settings: &'a Settings,
    path: &Path,
    text: &str,
    bench: Option<&str>,
) -> Result<&'a config::Bench, Refused> {
    #[derive(serde::Deserialize)]
    struct Names {
        bench: String,
    }
    let known = || {
        settings
            .benches
            .iter()
            .map(|bench| bench.name.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    };
    if let Some(name) = bench {
        return settings.bench(name).ok_or_else(|| {
            Refused::Unfit(format!(
                "bench: expected one of {}, found {name:?}",
                known()
            ))
        });
    }
    let names: Names =
        toml::from_str(text).map_err(|error| Refused::Unfit(error.message().to_owned()))?;
    let named = path
        .parent()
        .unwrap_or(path)
        .join(&names.bench)
        .canonicalize()
        .ok();
    let same = |bench: &&config::Bench| named.is_some() && bench.path.canonicalize().ok() == named;
    let found = settings.benches.iter().find(same);
    found.ok_or_else(|| {
        Refused::Unfit(format!(
            "the experiment names a bench that this server does not have ({}): choose one with \
        `bench`",
            known()
        ))
    })
}
