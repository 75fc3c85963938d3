//! A diagnosis as a story: where, what, how sure, what next.

use std::path::Path;

use analysis::diagnosis::Verdict;
use serde::Serialize;
use utoipa::ToSchema;

use super::record::Analysis;
use crate::{settings::Settings, submission};
use bench_evaluate::{
    figures::story::{Chapter, STORY, Story as Told},
    investigate::closed_loop::verdict_named,
};
use bench_plan::support::confined_path;

/// Text of a diagnosis.
#[derive(Debug, Serialize, ToSchema)]
pub struct Story {
    /// The cell, if the run has several.
    cell: Option<String>,
    /// `nothing missing`, `missing`, `cannot tell` or `invalid data`.
    verdict: &'static str,
    /// The verdict in a sentence.
    sentence: String,
    /// Where simulation and measurement disagree.
    r#where: Vec<Passage>,
    /// Missing effects.
    what: Vec<Passage>,
    /// Certainty of the verdict.
    how_sure: Vec<Passage>,
    /// Next steps.
    next: Vec<Next>,
    /// Cautions.
    caution: Vec<String>,
}

/// A title with its text.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Passage {
    /// The title.
    title: String,
    /// The text.
    text: String,
}

/// Next steps.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Next {
    /// The title.
    title: String,
    /// The text.
    text: String,
    /// The recommended experiment, TOML, if this server can run one.
    experiment: Option<String>,
    /// Name of the experiment.
    name: Option<String>,
}

/// Conclusion of a diagnosis of one cell.
#[derive(Debug)]
pub struct Conclusion {
    /// The verdict.
    pub verdict: Verdict,
    /// The verdict as a sentence.
    pub sentence: String,
    /// Recommended experiment, if there is one that this server can run.
    pub next: Option<Recommended>,
}

/// A recommended experiment.
#[derive(Debug)]
pub struct Recommended {
    /// Its name.
    pub name: String,
    /// Its text, TOML.
    pub text: String,
}

/// Returns the conclusion of a diagnosis of one cell, or `None` if it has no results.
pub(super) fn conclusion(
    settings: &Settings,
    analysis: &Analysis,
    results: &Path,
) -> Option<Conclusion> {
    let stored: Told = serde_json::from_reader(confined_path::open(results, STORY)?).ok()?;
    let next = experiment(settings, analysis, results);
    Some(Conclusion {
        verdict: verdict_named(&stored.verdict)?,
        sentence: stored.summary,
        next: next.map(|(text, name)| Recommended { name, text }),
    })
}

/// The stories of all cells of a diagnosis.
pub(super) fn all(settings: &Settings, analysis: &Analysis, results: &Path) -> Vec<Story> {
    let files = confined_path::list(results).unwrap_or_default();
    let stories = files.into_iter().filter_map(|(path, _)| {
        let folder = path.strip_suffix(STORY)?.trim_end_matches('/').to_owned();
        let stored: Told = serde_json::from_reader(confined_path::open(results, &path)?).ok()?;
        let cell = Some(folder.clone()).filter(|folder| !folder.is_empty());
        let next = experiment(settings, analysis, &results.join(&folder));
        Some(of(&stored, cell, next))
    });
    stories.collect()
}

fn of(stored: &Told, cell: Option<String>, experiment: Option<(String, String)>) -> Story {
    let verdict = match stored.verdict.as_str() {
        "at_noise_floor" => "nothing missing",
        "explained" | "mostly" => "missing",
        "invalid" => "invalid data",
        _ => "cannot tell",
    };
    let chapter = |heading: &str| stored.sections.iter().find(|one| one.heading == heading);
    let short = |title: &str| {
        let fields = chapter("In short").map(|one| &one.fields);
        let field = fields.into_iter().flatten().find(|(name, _)| name == title);
        field.map(|(title, text)| Passage {
            title: title.clone(),
            text: text.clone(),
        })
    };
    let passages = |heading: &str| -> Vec<Passage> {
        let said = |chapter: &Chapter| {
            let text = chapter
                .text
                .iter()
                .map(|text| (chapter.heading.clone(), text.clone()));
            text.chain(chapter.fields.clone()).collect::<Vec<_>>()
        };
        let all = chapter(heading).map(said).unwrap_or_default();
        all.into_iter()
            .map(|(title, text)| Passage { title, text })
            .collect()
    };
    let mut parts = [
        ("What disagrees", "Where"),
        ("What is missing", "What"),
        ("To predict now", "How sure"),
    ]
    .map(|(question, heading)| {
        short(question)
            .into_iter()
            .chain(passages(heading))
            .collect::<Vec<Passage>>()
    });
    let [places, what, how_sure] = parts.each_mut().map(std::mem::take);
    let (experiment, name) = experiment.unzip();
    let next = short("What to do next").map(|passage| Next {
        title: passage.title,
        text: passage.text,
        experiment,
        name,
    });
    let caution = ["What to distrust", "What is odd in the data"].map(short);
    Story {
        cell,
        verdict,
        sentence: stored.summary.clone(),
        r#where: places,
        what,
        how_sure,
        next: next.into_iter().collect(),
        caution: caution
            .into_iter()
            .flatten()
            .map(|passage| passage.text)
            .collect(),
    }
}

/// Sections of the run's own experiment that hold for the recommended one too: orders that its
/// points can bear, and the controls, without which its spectrum is not corrected.
const KEPT: [&str; 2] = ["fit", "fixture_check"];

/// The recommended experiment, with the bench, the cell, the fits and the controls of the run's own
/// experiment, and its name.
fn experiment(settings: &Settings, analysis: &Analysis, folder: &Path) -> Option<(String, String)> {
    let text = std::fs::read_to_string(folder.join("next_experiment.toml")).ok()?;
    let run = analysis.runs.first()?;
    let own = submission::value_of_run(&settings.data, run)?;
    let comments: Vec<&str> = text
        .lines()
        .take_while(|line| line.starts_with('#'))
        .collect();
    let mut next: toml::Table = toml::from_str(&text).ok()?;
    for key in ["bench", "cell"] {
        next.insert(key.to_owned(), own.get(key)?.clone());
    }
    if next.contains_key("eis") {
        for key in KEPT {
            if let (false, Some(value)) = (next.contains_key(key), own.get(key)) {
                next.insert(key.to_owned(), value.clone());
            }
        }
    }
    let name = next.get("name")?.as_str()?.to_owned();
    let text = toml::to_string_pretty(&next).ok()?;
    Some((format!("{}\n{text}", comments.join("\n")), name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_story_takes_its_parts_from_the_report() {
        let chapter = |heading: &str, text: &[&str], fields: &[(&str, &str)]| Chapter {
            heading: heading.to_owned(),
            text: text.iter().map(|&text| text.to_owned()).collect(),
            fields: fields
                .iter()
                .map(|&(a, b)| (a.to_owned(), b.to_owned()))
                .collect(),
        };
        let short = [
            ("What disagrees", "after steps"),
            ("What is missing", "diffusion"),
            ("What to distrust", "the noise"),
            ("What to do next", "a longer pulse"),
        ];
        let stored = Told {
            program: String::new(),
            verdict: "explained".to_owned(),
            summary: "It is diffusion.".to_owned(),
            sections: vec![
                chapter("In short", &[], &short),
                chapter("Where", &["5 to 60 s"], &[]),
                chapter("How sure", &["9 σ"], &[("Rivals", "none")]),
            ],
        };
        let story = of(&stored, None, Some(("text".to_owned(), "next".to_owned())));
        let fields_of = |passages: &[Passage]| -> Vec<(String, String)> {
            passages
                .iter()
                .map(|one| (one.title.clone(), one.text.clone()))
                .collect()
        };
        let pairs = |all: &[(&str, &str)]| -> Vec<(String, String)> {
            all.iter()
                .map(|&(a, b)| (a.to_owned(), b.to_owned()))
                .collect()
        };
        assert_eq!(story.verdict, "missing");
        assert_eq!(
            fields_of(&story.r#where),
            pairs(&[("What disagrees", "after steps"), ("Where", "5 to 60 s")])
        );
        assert_eq!(
            fields_of(&story.what),
            pairs(&[("What is missing", "diffusion")])
        );
        assert_eq!(
            fields_of(&story.how_sure),
            pairs(&[("How sure", "9 σ"), ("Rivals", "none")])
        );
        assert_eq!(story.next[0].experiment.as_deref(), Some("text"));
        assert_eq!(story.caution, ["the noise"]);
    }
}
