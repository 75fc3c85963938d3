//! Reads the project's own tables, the thesis' tables and lists of three numbers into spectra.

mod cells;
mod columns;

use super::{
    FileSpectra,
    error::FormatError,
    sweeps::{self, Key, MeasuredRow, Rows, label_value},
    text::{Row, Text},
};
use analysis_signal::spectrum::{Origin, SourcedSpectrum};
use cells::Cells;
use columns::Layout;
pub(super) use columns::unknown;

pub(super) fn parse(text: &Text<'_>) -> Result<FileSpectra, FormatError> {
    let empty = |met| {
        Err(FormatError::Empty {
            file: text.file(),
            met,
        })
    };
    let Some((first, rest)) = text.rows.split_first() else {
        return empty(if text.has_content {
            "only comments"
        } else {
            "an empty file"
        });
    };
    let (layout, named) = Layout::of(text, first)?;
    let rows = if named { rest } else { text.rows.as_slice() };
    if rows.is_empty() {
        return empty("only a header");
    }
    text.one_mark()?;
    let mut all = Rows {
        rows: Vec::new(),
        keys: layout
            .sweeps
            .iter()
            .map(|(kind, _)| Key::Column(kind))
            .collect(),
    };
    let mut kept: Vec<&Row<'_>> = Vec::new();
    for row in rows {
        let cells = Cells {
            text,
            row,
            layout: &layout,
        };
        let Some((origin, point)) = cells.read()? else {
            continue;
        };
        if sweeps::is_measured(&point) {
            kept.push(row);
        }
        let value = |(_, place): &(&str, usize)| {
            label_value(row.fields.get(*place).copied().unwrap_or_default())
        };
        all.rows.push(MeasuredRow {
            line: row.line,
            origin,
            key: layout.sweeps.iter().map(value).collect(),
            point,
        });
    }
    let stem = text.path.file_stem().map_or_else(
        || "spectrum".to_owned(),
        |s| s.to_string_lossy().into_owned(),
    );
    let mut read = sweeps::sort(text.path, all, |origin, several| {
        name(origin, &stem, several)
    })?;
    if !named {
        read.notes.extend(inductive(text, &read.spectra));
    }
    super::shared::attach(text, &kept, &mut read.spectra)?;
    super::flags::attach(text, &mut read.spectra);
    Ok(read)
}

/// Returns a remark on a list without names whose points are inductive, because the column may hold
/// −Im Z.
fn inductive(text: &Text<'_>, spectra: &[SourcedSpectrum]) -> Option<String> {
    let points = || spectra.iter().flat_map(|one| &one.spectrum.points);
    let (all, above) = (
        points().count(),
        points().filter(|p| p.z_ohm.im > 0.0).count(),
    );
    let file = text.path.file_name().unwrap_or_default().to_string_lossy();
    (all > 2 && 10 * above > 9 * all).then(|| {
        format!(
            "{file}: its list has no names and is taken as f, Re Z, Im Z; Im Z is above 0 at {above} of \
             {all} points: if the file holds −Im Z, put the line \"f,re,-im\" before the numbers"
        )
    })
}

fn name(origin: &Origin, stem: &str, several: bool) -> String {
    let text = |o: &Option<String>| o.clone().unwrap_or_default();
    let bias = match origin.bias_a {
        Some(bias) if bias != 0.0 => format!("_{bias:+}A"),
        _ => String::new(),
    };
    match &origin.fixture {
        Some(fixture) => {
            // A single control needs no number in its name.
            let number = Some(text(&origin.cell))
                .filter(|c| fixture == "cell" || c != "0")
                .unwrap_or_default();
            format!("{fixture}{number}_{}{bias}", text(&origin.repeat))
        }
        None if several => format!("{stem}{bias}"),
        None => stem.to_owned(),
    }
}
