//! Contract between a chiller and its dialects.

use instruments_domain::units::Celsius;

use crate::{
    exchange::{Exchange, Expect, Way, leading_number},
    instrument::Model,
};

/// State of a chiller by its own answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Status {
    /// It circulates and controls.
    pub running: bool,
    /// It takes commands.
    pub remote: bool,
    /// An alarm that means the bath is not under control.
    pub alarm: Option<String>,
    /// The answer as it came.
    pub raw: String,
}

/// One model's language.
pub trait Dialect: Model {
    /// Returns the range of set-points.
    fn range(&self) -> (Celsius, Celsius);
    /// Returns the messages that set the set-point and start, or that stop.
    fn run(&self, setpoint: Option<Celsius>) -> Vec<Exchange>;
    /// Returns the commands of one pulse, if the daemon closes the loop: a positive number of
    /// seconds heats, a negative number cools, zero switches both off. The pulse ends
    /// automatically.
    fn pulse(&self, _seconds: f64) -> Option<Vec<Exchange>> {
        None
    }
    /// Ways to harm nothing while it does not stop.
    fn zero(&self) -> Vec<Way>;
    /// Queries for bath temperature and status.
    fn queries(&self) -> [&'static str; 2];
    /// Parses a reply to the first of the queries, in °C. Returns `None` if it is not a
    /// temperature.
    fn celsius(&self, answer: &str) -> Option<f64> {
        leading_number(answer)
    }
    /// Reads a status answer.
    fn status(&self, answer: &str) -> Status;
    /// Returns the query for its set-point, whose reply has the form of a temperature, or `None`
    /// for a bath without a set-point.
    fn setpoint(&self) -> Option<&'static str> {
        None
    }
    /// Returns the query whether it runs and the reply for yes, if its status leaves that open.
    fn asks_whether_it_runs(&self, _answer: &str) -> Option<(&'static str, Expect)> {
        None
    }
}

/// Set-point for a bath that does not stop, harmless to any cell, °C: room temperature.
pub(super) const HARMLESS_C: Celsius = Celsius(20.0);
