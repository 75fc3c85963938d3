//! Runs as data for a diagnosis ([`dataset`]), the experiment that it recommends
//! ([`next_experiment`]), and both in turn until nothing is open ([`closed_loop`]).

pub mod closed_loop;
pub mod dataset;
pub mod next_experiment;
