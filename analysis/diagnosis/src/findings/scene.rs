//! The view of a detector.

use crate::data::{Fixture, Run, TimeRecord};
use crate::gate::Inspection;
use crate::prepare::BaseModel;

/// The data with the expectation of the model.
pub(super) struct Scene<'a> {
    /// Runs that passed the gate.
    pub(super) at: Inspection<'a>,
    /// The model that is judged.
    pub(super) model: &'a BaseModel,
}

/// A record with the voltage expected of it.
#[derive(Clone, Copy)]
pub(super) struct Played<'a> {
    /// The run.
    pub(super) run: &'a Run,
    /// Its record.
    pub(super) record: &'a TimeRecord,
    /// Voltage expected of each sample, V.
    pub(super) expected_v: &'a [f64],
}

impl<'a> Scene<'a> {
    /// Returns all records that could be simulated.
    pub(super) fn records(&'a self) -> impl Iterator<Item = Played<'a>> {
        self.at.runs.iter().filter_map(|subject| {
            let (record, expected_v) = subject.record()?;
            Some(Played {
                run: subject.run,
                record,
                expected_v,
            })
        })
    }

    /// Returns the records of cells.
    pub(super) fn of_cells(&'a self) -> impl Iterator<Item = Played<'a>> {
        self.records()
            .filter(|played| matches!(played.run.fixture, Fixture::Cell(_)))
    }
}

impl Played<'_> {
    /// Returns the first row that is compared.
    pub(super) fn first_compared(&self) -> usize {
        let from_s = self.record.compared_from_s;
        self.record.series.time_s.partition_point(|t| *t < from_s)
    }

    /// Returns the largest current, A.
    pub(super) fn largest_a(&self) -> f64 {
        let currents = &self.record.series.current_a;
        currents.iter().fold(0.0f64, |most, i| most.max(i.abs()))
    }

    /// True for a held-out run.
    pub(super) fn is_held_out(&self) -> bool {
        self.run.is_held_out()
    }
}
