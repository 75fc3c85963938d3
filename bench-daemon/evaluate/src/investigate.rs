//! Runs as data for a diagnosis ([`dataset`]), the experiment that it recommends
//! ([`next_experiment`]), both in turn until nothing is open
//! ([`closed_loop`]), and a proposal of runs from files of a cycler ([`proposal`]).

pub mod cell_map;
pub mod closed_loop;
pub mod dataset;
pub mod next_experiment;
pub mod proposal;
