//! A data set as far as its files could be read.

use std::collections::BTreeMap;

use analysis::{
    calibration::CommonError,
    diagnosis::{DataSet, Finding, FindingKind, Run, RunData},
    fit::RefusedPoint,
    spectrum::FlaggedPoint,
};

use super::files::DataSetProblem;
use crate::support::present;

/// Name of the file that makes a folder a data set.
pub const DATASET_FILE: &str = "dataset.toml";

/// A data set as far as its files could be read.
#[derive(Debug)]
pub struct Loaded {
    /// The runs that could be read.
    pub set: DataSet,
    /// The runs that could not.
    pub problems: Vec<DataSetProblem>,
    /// Assumptions that had to be made.
    pub notes: Vec<String>,
    /// Oddities of the files.
    pub findings: Vec<Finding>,
    /// Findings whose correction is requested.
    pub accept: Vec<FindingKind>,
    /// Points that the quality gate of their measurement has refused, by the names of their runs,
    /// and whether they are nevertheless used.
    pub refused: Vec<RefusedPoint>,
}

/// How a data set is read.
#[derive(Debug, Clone, Copy, Default)]
pub struct Reading {
    /// Error that an inherited correction leaves; a run without its own controls cannot determine
    /// it.
    pub known: Option<CommonError>,
    /// Points that a quality gate has refused are used, too.
    pub refused_points: bool,
}

/// Points of a sweep that a quality gate has refused.
pub(super) struct Flagged {
    pub(super) run: String,
    pub(super) file: String,
    /// How many points it has.
    pub(super) points: usize,
    pub(super) flagged: Vec<FlaggedPoint>,
    /// Whether they are nevertheless used.
    pub(super) wanted: bool,
}

impl Loaded {
    /// Records the points of a sweep that a quality gate has refused.
    pub(super) fn flag(&mut self, refused: &Flagged) {
        let Flagged {
            run,
            file,
            points,
            flagged,
            ..
        } = refused;
        let fitted = refused.wanted;
        if flagged.is_empty() {
            return;
        }
        let refusals = present::refused_in_words(flagged);
        let what = if fitted {
            "are used as requested, although"
        } else {
            "and the same points of its repeats are left out:"
        };
        let asked = if fitted {
            ""
        } else {
            "; --refused-points uses them"
        };
        self.notes.push(format!(
            "{run}: {} of {points} points {what} the quality gate refused them: {refusals}{asked}",
            flagged.len()
        ));
        self.refused
            .extend(flagged.iter().map(|point| RefusedPoint {
                spectrum: run.clone(),
                file: file.clone(),
                freq_hz: point.freq_hz,
                reasons: point.reasons.clone(),
                fitted,
            }));
    }

    /// Removes points that a quality gate has refused. Repeats are compared point by point: a
    /// point that is missing in one of them is removed from the others, too. But a sweep without
    /// any remaining point does not affect the others.
    pub(crate) fn leave_out_refused(&mut self) {
        let refused = &self.refused;
        let own = |run: &Run, freq_hz: f64| {
            refused
                .iter()
                .any(|one| !one.fitted && one.spectrum == run.name && one.freq_hz == freq_hz)
        };
        let freqs = |run: &Run| {
            if let RunData::Eis(sweep) = &run.data {
                sweep.points.iter().map(|p| p.freq_hz).collect()
            } else {
                Vec::new()
            }
        };
        self.set.runs.retain(|run| {
            let all: Vec<f64> = freqs(run);
            all.is_empty() || !all.iter().all(|freq_hz| own(run, *freq_hz))
        });
        let of_group = |one: &RefusedPoint| {
            let run = self.set.runs.iter().find(|run| run.name == one.spectrum)?;
            (!one.fitted).then(|| (run.repeat_group.clone(), one.freq_hz))
        };
        let lost: Vec<(String, f64)> = refused.iter().filter_map(of_group).collect();
        for run in &mut self.set.runs {
            let RunData::Eis(sweep) = &mut run.data else {
                continue;
            };
            let own = |one: &&(String, f64)| one.0 == run.repeat_group;
            sweep.retain(|freq_hz| {
                !lost
                    .iter()
                    .filter(own)
                    .any(|(_, lost_hz)| *lost_hz == freq_hz)
            });
        }
        self.keep_common_harmonics();
        self.set
            .runs
            .retain(|run| !matches!(&run.data, RunData::Eis(sweep) if sweep.points.is_empty()));
    }

    /// Removes harmonics that another repeat lacks: repeats are compared row by row.
    fn keep_common_harmonics(&mut self) {
        let sweeps = self.set.runs.iter().filter_map(|run| match &run.data {
            RunData::Eis(sweep) => Some((run.repeat_group.as_str(), sweep)),
            RunData::Time(_) => None,
        });
        let mut common: BTreeMap<String, Vec<(u32, f64)>> = BTreeMap::new();
        for (group, sweep) in sweeps {
            let own: Vec<(u32, f64)> = sweep
                .harmonics
                .iter()
                .map(|h| (h.order, h.freq_hz))
                .collect();
            common
                .entry(group.to_owned())
                .and_modify(|all| all.retain(|one| own.contains(one)))
                .or_insert(own);
        }
        for run in &mut self.set.runs {
            if let RunData::Eis(sweep) = &mut run.data {
                let (all, before) = (&common[&run.repeat_group], sweep.harmonics.len());
                sweep
                    .harmonics
                    .retain(|h| all.contains(&(h.order, h.freq_hz)));
                let lost = before - sweep.harmonics.len();
                if lost > 0 {
                    self.notes.push(format!(
                        "{}: {lost} of {before} harmonics are left out, because a repeat lacks them",
                        run.name
                    ));
                }
            }
        }
    }
}
