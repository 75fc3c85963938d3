//! Report of a diagnosis for a person: words for a terminal and for Markdown, and the pictures.
//!
//! The first page is plain words and the gaps; statistics and names of the code follow in the
//! details. "Where" comes before "what", and what is not claimed is said. Everything here is a string or a
//! described picture; who called writes the files. What is not here: `diagnosis.json`, which is
//! [`Diagnosis`] itself, and any judgement.

mod catalogue;
mod findings;
mod first_page;
mod numbers;
mod page;
mod pictures;
mod predictive;
mod reserve;
mod sections;
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

/// A diagnosis for a terminal, at most 100 characters wide.
pub fn text(d: &Diagnosis) -> String {
    sections::page(d).text()
}

/// A diagnosis as Markdown; `pictures` are those of [`pictures`], expected as `NAME.png` beside the
/// text.
pub fn markdown(d: &Diagnosis, pictures: &[Picture]) -> String {
    sections::page(d).markdown(pictures)
}

/// A diagnosis as a page that opens by itself; `pictures` are those of [`pictures`]. Where it comes
/// from is the caller's to add.
///
/// # Errors
/// A picture that cannot be drawn.
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
