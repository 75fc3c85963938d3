//! Searches runs by their properties, and returns the history of a cell over its runs. The data
//! come from the records and folders of the runs; data that can no longer change are cached.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use analysis::{
    dataset::RunIndex,
    run_folder::{self, CAMPAIGN, INDEX},
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    jobs::{self, Begun, Job, Jobs},
    notebook::{About, Notebook},
    spectra::{self, Point, Spectrum},
    submission,
};
use bench_core::safety::failure::REFUSED_CODE;

/// Default number of runs in one reply.
const MOST: usize = 100;

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

/// Summary of a run in a list.
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

/// Conditions on runs; all of them must hold.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Wanted {
    /// Words that occur in the name, experiment, bench, cells, tags or notes of the run.
    pub text: Option<String>,
    /// Name or serial number of a cell.
    pub cell: Option<String>,
    /// Serial number of a cell, as stated by the experiment.
    pub serial: Option<String>,
    /// Name of a bench.
    pub bench: Option<String>,
    /// `good`, `doubtful`, `failed` or `in work`.
    pub verdict: Option<RunVerdict>,
    /// A tag.
    pub tag: Option<String>,
    /// Submitted at this time or later, s since 1970.
    pub from_s: Option<f64>,
    /// Submitted before this time, s since 1970.
    pub to_s: Option<f64>,
    /// Maximum number of runs, the latest first.
    #[param(minimum = 1, maximum = 1000)]
    pub most: Option<u16>,
    /// Name of the run after which the answer begins: `more` of the previous answer.
    pub after: Option<String>,
}

/// The matching runs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Found {
    /// Summaries, the latest first.
    pub found: Vec<Card>,
    /// Position of the next part, if more runs exist.
    pub more: Option<String>,
    /// Number of all matching runs.
    pub number: usize,
    /// All cells of all runs.
    pub cells: Vec<String>,
    /// All benches of all runs.
    pub benches: Vec<String>,
    /// All tags of all runs.
    pub tags: Vec<String>,
}

/// Cards of runs that have ended, by name.
#[derive(Debug, Default)]
pub struct Finder {
    ended: Mutex<BTreeMap<Arc<str>, Arc<Card>>>,
}

/// Locations of runs and their records.
#[derive(Debug, Clone, Copy)]
pub struct Places<'a> {
    /// The data folder.
    pub data: &'a Path,
    /// Runs that were begun here.
    pub jobs: &'a Jobs,
    /// Notes and tags.
    pub notebook: &'a Notebook,
}

impl Finder {
    /// All runs that were begun here, the latest first, with the texts of their notes.
    fn all(&self, places: Places<'_>) -> Vec<(Arc<Card>, String)> {
        let begun = places.jobs.begun();
        let told = begun.iter().filter_map(|begun| {
            let card = self.card(places, begun)?;
            Some(with_entries(card, places.notebook))
        });
        told.collect()
    }

    /// One run.
    pub fn of(&self, places: Places<'_>, job: &Job) -> Card {
        let card = Arc::new(made(places.data, job));
        Arc::unwrap_or_clone(with_entries(card, places.notebook).0)
    }

    /// A run that has ended is read once.
    fn card(&self, places: Places<'_>, begun: &Begun) -> Option<Arc<Card>> {
        let known = self.known().get(&begun.run).cloned();
        let is_same = |card: &Arc<Card>| card.ended_unix_s == begun.ended_unix_s;
        if let Some(card) = known.filter(|card| begun.ended_unix_s.is_some() && is_same(card)) {
            return Some(card);
        }
        let job = jobs::read(places.data, &begun.run)?;
        let card = Arc::new(made(places.data, &job));
        if card.ended_unix_s.is_some() {
            self.known().insert(begun.run.clone(), card.clone());
        }
        Some(card)
    }

    fn known(&self) -> MutexGuard<'_, BTreeMap<Arc<str>, Arc<Card>>> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The runs that are wanted.
    pub fn find(&self, places: Places<'_>, wanted: &Wanted) -> Found {
        let all = self.all(places);
        let [mut cells, mut benches, mut tags] = [const { BTreeSet::new() }; 3];
        for (card, _) in &all {
            cells.extend(card.cells.iter().map(|cell| cell.name.as_str()));
            benches.insert(card.bench.as_str());
            tags.extend(card.tags.iter().map(String::as_str));
        }
        let [cells, benches, tags] =
            [cells, benches, tags].map(|of| of.into_iter().map(str::to_owned).collect());
        let met = all
            .iter()
            .filter(|(card, notes)| wanted.is_met(card, notes));
        let mut found: Vec<&Arc<Card>> = met.map(|(card, _)| card).collect();
        let number = found.len();
        if let Some(after) = &wanted.after
            && let Some(place) = found.iter().position(|card| card.run == *after)
        {
            found.drain(..=place);
        }
        let most = wanted.most.map_or(MOST, usize::from);
        let more = (found.len() > most).then(|| found[most - 1].run.clone());
        found.truncate(most);
        let found = found.into_iter().map(|card| Card::clone(card)).collect();
        Found {
            found,
            more,
            number,
            cells,
            benches,
            tags,
        }
    }

    /// All cells of all runs, by name.
    pub fn cells(&self, places: Places<'_>) -> Vec<KnownCell> {
        let mut cells: BTreeMap<String, KnownCell> = BTreeMap::new();
        for (card, _) in self.all(places) {
            for cell in &card.cells {
                let known = cells.entry(cell.name.clone()).or_insert_with(|| KnownCell {
                    cell: cell.name.clone(),
                    serial: None,
                    runs: 0,
                    first_unix_s: card.submitted_unix_s,
                    last_unix_s: card.submitted_unix_s,
                });
                known.serial = known.serial.take().or_else(|| cell.serial.clone());
                known.runs += 1;
                known.first_unix_s = known.first_unix_s.min(card.submitted_unix_s);
            }
        }
        cells.into_values().collect()
    }

    /// Returns the history of a cell over its runs, or `None` if no run has measured it.
    pub fn cell(&self, places: Places<'_>, cell: &str) -> Option<CellHistory> {
        let all = self.all(places).into_iter().map(|(card, _)| card);
        let runs: Vec<Card> = all
            .filter(|card| card.cells.iter().any(|one| one.name == cell))
            .map(Arc::unwrap_or_clone)
            .collect();
        if runs.is_empty() {
            return None;
        }
        let of_cell = runs
            .iter()
            .flat_map(|card| &card.cells)
            .filter(|one| one.name == cell);
        let serials: BTreeSet<String> = of_cell.filter_map(|one| one.serial.clone()).collect();
        let mut history: Vec<Moment> = runs
            .iter()
            .flat_map(|card| moments(places.data, card, cell))
            .collect();
        history.sort_by(|a, b| a.unix_s.total_cmp(&b.unix_s));
        Some(CellHistory {
            cell: cell.to_owned(),
            serials: serials.into_iter().collect(),
            history,
            notes: places.notebook.read(About::Cell(cell)).notes,
            runs,
        })
    }
}

impl Wanted {
    fn is_met(&self, card: &Card, notes: &str) -> bool {
        let same = |wanted: &Option<String>, found: &str| {
            wanted.as_deref().is_none_or(|wanted| wanted == found)
        };
        let cell = |wanted: &String| {
            let named =
                |cell: &RunCell| cell.name == *wanted || cell.serial.as_ref() == Some(wanted);
            card.cells.iter().any(named)
        };
        let serial = |wanted: &String| {
            let mut cells = card.cells.iter();
            cells.any(|cell| cell.serial.as_ref() == Some(wanted))
        };
        same(&self.bench, &card.bench)
            && self.verdict.is_none_or(|verdict| verdict == card.verdict)
            && self.tag.as_ref().is_none_or(|tag| card.tags.contains(tag))
            && self.cell.as_ref().is_none_or(cell)
            && self.serial.as_ref().is_none_or(serial)
            && self.from_s.is_none_or(|from| card.submitted_unix_s >= from)
            && self.to_s.is_none_or(|to| card.submitted_unix_s < to)
            && self
                .text
                .as_deref()
                .is_none_or(|text| card.says(notes, text))
    }
}

impl Card {
    /// Returns whether every word occurs in the data of the run.
    fn says(&self, notes: &str, words: &str) -> bool {
        let mut all = [
            &self.run,
            &self.bench,
            &self.experiment,
            &self.by,
            &self.how,
        ]
        .map(String::as_str)
        .join("\n");
        for cell in &self.cells {
            all.push_str(&format!(
                "\n{}\n{}",
                cell.name,
                cell.serial.as_deref().unwrap_or_default()
            ));
        }
        let all = format!("{all}\n{}\n{notes}", self.tags.join("\n")).to_lowercase();
        words
            .to_lowercase()
            .split_whitespace()
            .all(|word| all.contains(word))
    }
}

/// Returns the card with its notes and tags, and the texts of the notes.
fn with_entries(mut card: Arc<Card>, notebook: &Notebook) -> (Arc<Card>, String) {
    let entries = notebook.read(About::Run(&card.run));
    if entries.notes.is_empty() && entries.tags.is_empty() {
        return (card, String::new());
    }
    let told = Arc::make_mut(&mut card);
    told.tags = entries.tags;
    told.notes = entries.notes.len();
    let notes: Vec<String> = entries.notes.into_iter().map(|note| note.text).collect();
    (card, notes.join("\n"))
}

fn made(data: &Path, job: &Job) -> Card {
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
        tags: Vec::new(),
        notes: 0,
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
    let told = |key| text(specimen?, key);
    let name = told("name").or(index).or_else(file);
    let serial = told("serial");
    let one = |name| RunCell { name, serial };
    name.map(one).into_iter().collect()
}

/// The index of a run folder.
fn index(folder: &Path) -> Option<RunIndex> {
    serde_json::from_str(&std::fs::read_to_string(folder.join(INDEX)).ok()?).ok()
}

/// A cell that runs have measured.
#[derive(Debug, Serialize, ToSchema)]
pub struct KnownCell {
    /// Its name.
    cell: String,
    /// Its serial number, if an experiment states it.
    serial: Option<String>,
    /// Number of runs with it.
    runs: usize,
    /// Time of submission of the first of them, s since 1970.
    first_unix_s: f64,
    /// Time of submission of the last of them, s since 1970.
    last_unix_s: f64,
}

/// A cell over its runs.
#[derive(Debug, Serialize, ToSchema)]
pub struct CellHistory {
    /// Its name.
    cell: String,
    /// Serial numbers that its runs state.
    serials: Vec<String>,
    /// Its spectra, by time.
    history: Vec<Moment>,
    /// Notes of users about it.
    notes: Vec<super::notebook::Note>,
    /// Its runs, the latest first.
    runs: Vec<Card>,
}

/// A spectrum of a cell with its time.
#[derive(Debug, Serialize, ToSchema)]
pub struct Moment {
    /// The run.
    run: String,
    /// Number of the repeat in a campaign.
    repeat: Option<usize>,
    /// Time of the measurement, s since 1970; that of the submission if the run was in virtual
    /// time.
    unix_s: f64,
    /// The bench.
    bench: String,
    /// Name of the spectrum in the run.
    spectrum: String,
    /// Verdict from refused points.
    verdict: RunVerdict,
    /// Real part where the imaginary part changes its sign, Ω; otherwise at the highest frequency.
    r_high_ohm: f64,
    /// Its standard uncertainty, Ω.
    r_high_sigma_ohm: Option<f64>,
    /// Its frequency, Hz.
    at_high_hz: f64,
    /// Real part at the lowest frequency, Ω.
    r_low_ohm: f64,
    /// Its standard uncertainty, Ω.
    r_low_sigma_ohm: Option<f64>,
    /// Its frequency, Hz.
    at_low_hz: f64,
}

/// The corrected spectra of a cell in a run.
fn moments(data: &Path, card: &Card, cell: &str) -> Vec<Moment> {
    let folder = data.join("runs").join(&card.run);
    let Some(index) = index(&folder) else {
        return Vec::new();
    };
    let started = run_folder::started_unix_s(&folder);
    // A sweep names its cell if the run has several; otherwise it belongs to the only one.
    let only = match card.cells.as_slice() {
        [one] => &one.name,
        _ => &index.cell,
    };
    let of_cell = index.sweeps.iter().filter(|sweep| {
        let name = sweep.cell.as_ref().unwrap_or(only);
        let at_rest = sweep.bias_a == 0.0;
        sweep.fixture == "cell" && sweep.corrected && at_rest && name == cell
    });
    let moment = |sweep: &analysis::dataset::SweepEntry| {
        let spectrum = spectra::read(&folder, &sweep.file)?;
        let high = crossing(&spectrum)?;
        let low = spectrum.points.first()?;
        Some(Moment {
            run: card.run.clone(),
            repeat: card.campaign.then_some(sweep.repeat),
            unix_s: started.map_or(card.submitted_unix_s, |start| start + sweep.start_time_s),
            bench: card.bench.clone(),
            spectrum: spectrum.name.clone(),
            verdict: if sweep.flagged.is_empty() {
                RunVerdict::Good
            } else {
                RunVerdict::Doubtful
            },
            r_high_ohm: high.re_ohm,
            r_high_sigma_ohm: high.re_sigma_ohm,
            at_high_hz: high.freq_hz,
            r_low_ohm: low.re_ohm,
            r_low_sigma_ohm: low.re_sigma_ohm,
            at_low_hz: low.freq_hz,
        })
    };
    of_cell.filter_map(moment).collect()
}

/// Returns the point at which the imaginary part changes its sign, interpolated between its
/// neighbours, or otherwise the point of the highest frequency.
fn crossing(spectrum: &Spectrum) -> Option<Point> {
    let between = spectrum.points.windows(2).rev().find_map(|pair| {
        let [low, high] = pair else { return None };
        if !(low.im_ohm < 0.0 && high.im_ohm >= 0.0) {
            return None;
        }
        let share = -low.im_ohm / (high.im_ohm - low.im_ohm);
        let mix = |a: f64, b: f64| a + share * (b - a);
        Some(Point {
            freq_hz: (mix(low.freq_hz.ln(), high.freq_hz.ln())).exp(),
            re_ohm: mix(low.re_ohm, high.re_ohm),
            im_ohm: 0.0,
            re_sigma_ohm: low
                .re_sigma_ohm
                .zip(high.re_sigma_ohm)
                .map(|(a, b)| a.max(b)),
            ..high.clone()
        })
    });
    between.or_else(|| spectrum.points.last().cloned())
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

    fn card(run: &str) -> Card {
        Card {
            run: run.to_owned(),
            bench: "demo".to_owned(),
            experiment: "thesis".to_owned(),
            by: "ann".to_owned(),
            submitted_unix_s: 100.0,
            ended_unix_s: None,
            how: "in work".to_owned(),
            verdict: RunVerdict::InWork,
            cells: vec![RunCell {
                name: "A".to_owned(),
                serial: Some("P45B-17".to_owned()),
            }],
            spectra: 0,
            campaign: false,
            tags: vec!["aged".to_owned()],
            notes: 1,
        }
    }

    #[test]
    fn every_condition_counts_and_words_are_sought_everywhere() {
        let met = |wanted: Wanted| wanted.is_met(&card("thesis-3"), "Swollen at the seam");
        let text = |text: &str| Wanted {
            text: Some(text.to_owned()),
            ..Wanted::default()
        };
        assert!(met(Wanted::default()) && met(text("P45b THESIS seam aged")));
        assert!(!met(text("seam panasonic")));
        let cell = |cell: &str| Wanted {
            cell: Some(cell.to_owned()),
            ..Wanted::default()
        };
        assert!(met(cell("A")) && met(cell("P45B-17")) && !met(cell("P45B")));
        assert!(met(Wanted {
            from_s: Some(100.0),
            to_s: Some(100.1),
            ..Wanted::default()
        }));
        assert!(!met(Wanted {
            to_s: Some(100.0),
            ..Wanted::default()
        }));
        assert!(!met(Wanted {
            verdict: Some(RunVerdict::Good),
            ..Wanted::default()
        }));
        assert!(!met(Wanted {
            tag: Some("new".to_owned()),
            ..Wanted::default()
        }));
    }

    #[test]
    fn a_cell_that_an_experiment_names_is_told_from_another_of_its_kind() {
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

    #[test]
    fn resistance_at_the_change_of_sign_lies_between_its_points() {
        let point = |freq_hz, re_ohm, im_ohm| Point {
            freq_hz,
            re_ohm,
            im_ohm,
            re_sigma_ohm: Some(1e-6),
            im_sigma_ohm: None,
            verdict: None,
        };
        let points = vec![
            point(1.0, 3.0, -1.0),
            point(100.0, 2.0, -0.25),
            point(10_000.0, 1.0, 0.75),
        ];
        let mut spectrum = Spectrum {
            name: "s".to_owned(),
            corrected: true,
            points,
        };
        let found = crossing(&spectrum).unwrap();
        assert!((found.re_ohm - 1.75).abs() < 1e-12 && (found.freq_hz - 316.227_766).abs() < 1e-3);
        spectrum.points.pop();
        assert_eq!(crossing(&spectrum).unwrap().freq_hz, 100.0);
    }
}
