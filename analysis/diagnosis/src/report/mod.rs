//! Report of a diagnosis for a person: text for a terminal and for Markdown, and the pictures.
//!
//! The first page is plain text and the gaps; statistics and names of the code follow in the
//! details. "Where" comes before "what", and the report states what it does not claim. Everything
//! here is a string or a described picture; the caller writes the files. Not here:
//! `diagnosis.json`, which is [`Diagnosis`] itself, and any judgement.

mod by_hand;
mod catalogue;
mod findings;
mod first_page;
mod numbers;
mod page;
mod pictures;
mod predictive;
mod reserve;
mod sections;
mod shares;
#[cfg(test)]
mod tests;
mod words;

pub use catalogue::{Distinguishability, catalogue_markdown, catalogue_text};
pub use pictures::{Kind, Picture, pictures};

use super::outcome::Diagnosis;
use analysis_plot::{
    PlotError,
    report::{Level, Report, Section, Verdict},
};
use words::{after, counted, is_significant, misfit, named_title, titled};

/// Returns a diagnosis for a terminal, at most 100 characters wide.
pub fn text(d: &Diagnosis) -> String {
    sections::page(d).text()
}

/// Returns a diagnosis as Markdown; `pictures` are those of [`pictures`], expected as `NAME.png`
/// beside the text.
pub fn markdown(d: &Diagnosis, pictures: &[Picture]) -> String {
    sections::page(d).markdown(pictures)
}

/// Renders a diagnosis as a self-contained page; `pictures` are those of [`pictures`]. The caller
/// adds the origin of the data.
///
/// # Errors
/// A picture cannot be drawn.
pub fn html(d: &Diagnosis, pictures: &[Picture]) -> Result<Report, PlotError> {
    use super::outcome::Verdict as Found;
    let level = match d.verdict {
        Found::AtNoiseFloor | Found::Explained => Level::Good,
        Found::Mostly | Found::Ambiguous | Found::Unexplained => Level::Note,
        Found::Invalid => Level::Bad,
    };
    let page = sections::page(d);
    // The first section is the verdict itself.
    let verdicts = vec![Verdict {
        level,
        text: d.summary.clone(),
    }];
    let sections: Result<Vec<Section>, PlotError> = page
        .sections
        .iter()
        .skip(1)
        .map(|section| section.html(pictures))
        .collect();
    Ok(Report {
        title: page.title,
        verdicts,
        sections: sections?,
        ..Report::default()
    })
}
