//! The points of a map, as a table: what is measured at each, its margins and its duration.

use instruments::units::{Amps, Celsius, Coulombs, Seconds, Volts};

use super::{MapPoint, Plan, Stage, Step};
use crate::interlock::Limits;

/// A point of a map and the steps that belong to it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct PointRow {
    /// Its number, from 1.
    pub point: usize,
    /// State of charge.
    pub soc: f64,
    /// Temperature, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Celsius,
    /// What is measured.
    pub measured: Vec<String>,
    /// Lowest and highest voltage at rest that agree with the charge, V.
    pub rest_v: Option<(Volts, Volts)>,
    /// Least distance of the pulses from the lowest and from the highest voltage of the cell, V, in
    /// the worst case.
    pub margin_v: Option<(Volts, Volts)>,
    /// Expected and longest duration, s.
    pub span_s: (Seconds, Seconds),
    /// Charge into and out of the cell, C.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: (Coulombs, Coulombs),
}

impl Plan {
    /// Returns the points of a map, in order.
    pub fn points(&self, limits: &Limits) -> Vec<PointRow> {
        let mut rows: Vec<PointRow> = Vec::new();
        for stage in &self.stages {
            let Some((point, number)) = stage.point().zip(stage.run()) else {
                continue;
            };
            if rows.last().is_none_or(|row| row.point != number) {
                rows.push(PointRow::new(number, &point));
            }
            if let Some(row) = rows.last_mut() {
                row.add(stage, limits);
            }
        }
        rows
    }
}

impl PointRow {
    fn new(number: usize, point: &MapPoint) -> Self {
        Self {
            point: number,
            soc: point.soc,
            temperature_degc: point.temperature_degc,
            measured: Vec::new(),
            rest_v: None,
            margin_v: None,
            span_s: (Seconds::ZERO, Seconds::ZERO),
            charge_coulomb: (Coulombs::ZERO, Coulombs::ZERO),
        }
    }

    fn add(&mut self, stage: &Stage, limits: &Limits) {
        self.measured.extend(in_words(stage));
        for step in &stage.steps {
            self.span_s.0 += step.expected_s();
            self.span_s.1 += step.longest_s();
            match step {
                Step::Accept { band_v, .. } => self.rest_v = Some(*band_v),
                Step::Trace(trace) => {
                    let (lowest_v, highest_v) = trace.worst_v(limits);
                    self.margin_v = Some((lowest_v - limits.min_v, limits.max_v - highest_v));
                }
                _ => {}
            }
        }
        let plan = Plan {
            stages: vec![stage.clone()],
        };
        let extent = plan.extent();
        self.charge_coulomb.0 += extent.into_coulomb;
        self.charge_coulomb.1 += extent.out_coulomb;
    }

    /// Returns the row as text.
    pub fn line(&self) -> String {
        let (into_coulomb, out_coulomb) = self.charge_coulomb;
        let rest = self.rest_v.map_or_else(String::new, |(low_v, high_v)| {
            format!("; {low_v:.3} to {high_v:.3} at rest")
        });
        let margin = self.margin_v.map_or_else(String::new, |(low_v, high_v)| {
            format!(
                "; pulses at least {low_v:.3} above and {high_v:.3} below the limits of the \
                cell"
            )
        });
        format!(
            "{}, {} %, {} °C: {}{rest}{margin}; {out_coulomb:.0} out, {into_coulomb:.0} in; \
            about {:.0} min, at most {:.0} min",
            self.point,
            super::percent(self.soc),
            self.temperature_degc.0,
            self.measured.join(", "),
            (self.span_s.0 / 60.0).0,
            (self.span_s.1 / 60.0).0
        )
    }
}

/// Returns what a stage measures.
fn in_words(stage: &Stage) -> Vec<String> {
    let count = |of: fn(&Step) -> bool| stage.steps.iter().filter(|step| of(step)).count();
    let mut words = Vec::new();
    match count(|step| matches!(step, Step::Sine { .. })) {
        0 => {}
        points => words.push(format!("sweep of {points} frequencies")),
    }
    match count(|step| matches!(step, Step::Multisine(_))) {
        0 => {}
        bands => words.push(format!("multisine of {bands} bands")),
    }
    for step in &stage.steps {
        let Step::Trace(trace) = step else { continue };
        let amps: Vec<String> = trace
            .levels
            .iter()
            .filter(|level| level.current_a != Amps::ZERO)
            .map(|level| format!("{:+} A", level.current_a.0))
            .collect();
        words.push(format!("pulses of {}", amps.join(", ")));
    }
    words
}
