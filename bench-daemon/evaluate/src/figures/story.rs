//! The words of a diagnosis' report as data, for a page that shows them its own way.

use analysis::report::{Part, Section};

/// The file of the report's words.
pub const STORY: &str = "story.json";

/// The words of the report, for a page that shows them its own way.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct Story {
    /// Program and version that wrote it; empty in files of before.
    #[serde(default)]
    pub program: String,
    /// The verdict, as in `diagnosis.json`.
    pub verdict: String,
    /// The conclusion as a sentence.
    pub summary: String,
    /// In the order of the report.
    pub sections: Vec<Chapter>,
}

/// A section of the report without its pictures and tables.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct Chapter {
    /// Its heading.
    pub heading: String,
    /// Its paragraphs and points.
    pub text: Vec<String>,
    /// Its field names and their texts.
    pub fields: Vec<(String, String)>,
}

impl From<Section> for Chapter {
    fn from(section: Section) -> Self {
        let mut chapter = Self {
            heading: section.heading,
            text: Vec::new(),
            fields: Vec::new(),
        };
        for part in section.parts {
            match part {
                Part::Text(text) => chapter.text.push(text),
                Part::List(points) => chapter.text.extend(points),
                Part::Fields(_, fields) => chapter.fields.extend(fields),
                Part::Table(_) | Part::Figure(_) | Part::Verbatim(_) => {}
            }
        }
        chapter
    }
}
