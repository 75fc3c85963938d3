//! Summary of one run, its cells, and its campaign as a table, from its record and its folder. The
//! catalogue searches across runs.

use std::path::Path;

use analysis::{
    dataset::RunIndex,
    run_folder::{self, CAMPAIGN, INDEX},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    jobs::{self, Job},
    notebook::{About, Notebook},
    spectra, submission,
};
use bench_core::safety::failure::REFUSED_CODE;

/// A cell of a run.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
pub struct RunCell {
    /// Its name.
    pub name: String,
    /// Its serial number, if the experiment states it.
    pub serial: Option<String>,
}

/// Reliability of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RunVerdict {
    /// Finished; no point was refused.
    Good,
    /// Finished, with refused points or another remark.
    Doubtful,
    /// A person stopped it before it finished.
    Stopped,
    /// Not finished.
    Failed,
    /// In progress.
    #[serde(rename = "in work")]
    InWork,
}

/// Summary of a run.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Card {
    /// Its name.
    pub run: String,
    /// The bench.
    pub bench: String,
    /// The experiment.
    pub experiment: String,
    /// Name of the person who submitted it.
    pub by: String,
    /// Time of submission, s since 1970.
    pub submitted_unix_s: f64,
    /// Time of its end, s since 1970.
    pub ended_unix_s: Option<f64>,
    /// Description of its end.
    pub how: String,
    /// The same as a keyword.
    pub verdict: RunVerdict,
    /// The measured cells.
    pub cells: Vec<RunCell>,
    /// Number of its spectra; only corrected ones if there are any.
    pub spectra: usize,
    /// True if it measures several cells or repeats.
    pub campaign: bool,
    /// Tags that users have added.
    pub tags: Vec<String>,
    /// Number of notes.
    pub notes: usize,
}

/// Summarises a run that this server began.
pub fn card(data: &Path, notebook: &Notebook, job: &Job) -> Card {
    let entries = notebook.read(About::Run(&job.item.run));
    let folder = data.join("runs").join(&job.item.run);
    let experiment = submission::value_of_run(data, &job.item.run);
    let campaign = experiment.as_ref().and_then(|value| value.get("campaign"));
    let refused = Some(i32::from(REFUSED_CODE));
    let (how, verdict) = match &job.ended {
        None => ("in work".to_owned(), RunVerdict::InWork),
        Some(ended) if ended.stopped => (ended.how.clone(), RunVerdict::Stopped),
        Some(ended) if !ended.finished => (ended.how.clone(), RunVerdict::Failed),
        Some(ended) if ended.how == "finished" && ended.code != refused => {
            (ended.how.clone(), RunVerdict::Good)
        }
        Some(ended) => (ended.how.clone(), RunVerdict::Doubtful),
    };
    let files = spectra::stamps(&folder);
    let corrected = files
        .keys()
        .filter(|file| !run_folder::is_raw(file))
        .count();
    Card {
        run: job.item.run.clone(),
        bench: job.item.bench.clone(),
        experiment: job.item.experiment.clone(),
        by: job.item.by.clone(),
        submitted_unix_s: job.item.submitted_unix_s,
        ended_unix_s: job.ended.as_ref().map(|ended| ended.unix_s),
        how,
        verdict,
        cells: cells_of(&folder, experiment.as_ref()),
        spectra: if corrected > 0 {
            corrected
        } else {
            files.len()
        },
        campaign: campaign.is_some(),
        tags: entries.tags,
        notes: entries.notes.len(),
    }
}

/// Temperature of the cell before its first sweep, °C.
pub fn temperature_degc(folder: &Path) -> Option<f64> {
    index(folder)?
        .sweeps
        .iter()
        .find(|sweep| sweep.fixture == "cell")?
        .temperature_degc
}

/// The cells of a run that was begun here.
pub fn cells_of_run(data: &Path, run: &str) -> Vec<RunCell> {
    cells_of(
        &data.join("runs").join(run),
        submission::value_of_run(data, run).as_ref(),
    )
}

/// The cells that an experiment names one by one, or else its specimen, or else the one that the folder
/// or the file of the cell names.
fn cells_of(folder: &Path, experiment: Option<&toml::Value>) -> Vec<RunCell> {
    let text = |value: &toml::Value, key: &str| value.get(key)?.as_str().map(str::to_owned);
    let named = experiment.and_then(|value| value.get("campaign")?.get("cells")?.as_array());
    if let Some(named) = named {
        let cell = |value: &toml::Value| {
            Some(RunCell {
                name: text(value, "name")?,
                serial: text(value, "serial"),
            })
        };
        return named.iter().filter_map(cell).collect();
    }
    let index = index(folder)
        .map(|index| index.cell)
        .filter(|name| !name.is_empty());
    let file = || {
        let path = text(experiment?, "cell")?;
        Path::new(&path).file_stem()?.to_str().map(str::to_owned)
    };
    let specimen = experiment.and_then(|value| value.get("specimen"));
    let stated = |key| text(specimen?, key);
    let name = stated("name").or(index).or_else(file);
    let serial = stated("serial");
    let one = |name| RunCell { name, serial };
    name.map(one).into_iter().collect()
}

/// The index of a run folder.
fn index(folder: &Path) -> Option<RunIndex> {
    serde_json::from_str(&std::fs::read_to_string(folder.join(INDEX)).ok()?).ok()
}

/// A campaign as a table of cells and repeats.
#[derive(Debug, Serialize, ToSchema)]
pub struct Matrix {
    /// Its cells.
    cells: Vec<RunCell>,
    /// Number of repeats of each.
    repeats: usize,
    /// Its runs, by number.
    runs: Vec<MatrixRun>,
}

/// A run of a campaign.
#[derive(Debug, Serialize, ToSchema)]
pub struct MatrixRun {
    /// Its number.
    number: usize,
    /// The cell.
    cell: String,
    /// Number of the repeat, from 1.
    repeat: usize,
    /// `done`, `in work` or `to do`.
    state: &'static str,
    /// Name of its spectrum.
    spectrum: Option<String>,
    /// `good` or `doubtful`; null before it is judged.
    verdict: Option<RunVerdict>,
    /// Verdict and remarks as text.
    words: String,
}

/// Returns the campaign of a run, or `None` if the run is not a campaign.
pub fn campaign(data: &Path, run: &str) -> Option<Matrix> {
    let folder = data.join("runs").join(run);
    let experiment = submission::value_of_run(data, run)?;
    let campaign = experiment.get("campaign")?;
    let cells = cells_of(&folder, Some(&experiment));
    let repeats = usize::try_from(campaign.get("repeats")?.as_integer()?).ok()?;
    let robin = campaign.get("order").and_then(toml::Value::as_str) == Some("round_robin");
    let judged: serde_json::Value = std::fs::read_to_string(folder.join(CAMPAIGN))
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default();
    let judged = |file: &str| {
        judged["runs"]
            .as_array()?
            .iter()
            .find(|run| run["file"] == file)
            .cloned()
    };
    let going = jobs::read(data, run).is_some_and(|job| job.ended.is_none());
    let mut runs: Vec<MatrixRun> = Vec::new();
    for (place, cell) in cells.iter().enumerate() {
        for repeat in 1..=repeats {
            let name = format!("{}_{repeat}", cell.name);
            let file = run_folder::campaign_spectrum(&name);
            let found = folder.join(&file).is_file();
            let judged = judged(&file);
            let text = |key: &str| {
                judged
                    .as_ref()
                    .and_then(|run| run[key].as_str().map(str::to_owned))
            };
            let mut words: Vec<String> = text("validity").into_iter().collect();
            let notes = judged
                .as_ref()
                .and_then(|run| run["notes"].as_array().cloned());
            words.extend(
                notes
                    .iter()
                    .flatten()
                    .filter_map(|note| note.as_str().map(str::to_owned)),
            );
            let good = |run: &serde_json::Value| {
                if run["validity"] == "good" && run["soc_missed"] != true {
                    RunVerdict::Good
                } else {
                    RunVerdict::Doubtful
                }
            };
            runs.push(MatrixRun {
                number: if robin {
                    (repeat - 1) * cells.len() + place
                } else {
                    place * repeats + repeat - 1
                } + 1,
                cell: cell.name.clone(),
                repeat,
                state: if found { "done" } else { "to do" },
                spectrum: found.then(|| file.trim_end_matches(".csv").to_owned()),
                verdict: judged.as_ref().map(good),
                words: words.join("; "),
            });
        }
    }
    runs.sort_by_key(|run| run.number);
    // Runs may be reordered; by default the next run is the first one without a spectrum.
    if let Some(next) = runs
        .iter_mut()
        .find(|run| run.state == "to do")
        .filter(|_| going)
    {
        next.state = "in work";
    }
    Some(Matrix {
        cells,
        repeats,
        runs,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_that_an_experiment_names_is_distinguished_from_another_of_its_kind() {
        let folder = tempfile::tempdir().unwrap();
        let cells = |text: &str| {
            let experiment: toml::Value = toml::from_str(text).unwrap();
            cells_of(folder.path(), Some(&experiment))
        };
        let cell = |name: &str, serial: Option<&str>| RunCell {
            name: name.to_owned(),
            serial: serial.map(str::to_owned),
        };
        let file = "cell = \"../cells/p45b.toml\"\n";
        assert_eq!(cells(file), [cell("p45b", None)]);
        let specimen = format!("{file}[specimen]\nname = \"A-17\"\nserial = \"S9\"\n");
        assert_eq!(cells(&specimen), [cell("A-17", Some("S9"))]);
        let campaign = format!("{file}[campaign]\ncells = [{{ name = \"B1\" }}]\n");
        assert_eq!(cells(&campaign), [cell("B1", None)]);
    }
}
