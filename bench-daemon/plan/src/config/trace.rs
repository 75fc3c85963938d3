//! Resolves the sections `[[traces]]`, currents that step, against bench and cell. The plan checks
//! that a trace stays within the cell's limits.

mod average;
mod rows;
mod segment;
mod through;

use analysis_signal::series::Role;

use instruments::units::{Amps, Ohms, Seconds, Volts};

use super::{ConfigError, Source, check::Check, raw, raw_map};
use crate::plan::{Averaged, Through};
use rows::Row;
pub use segment::Segment;
pub use through::AFTER_WAVE_S;

/// A current that steps, and how it is recorded.
#[derive(Debug, Clone)]
pub struct Trace {
    /// Its name: files are called after it.
    pub name: String,
    /// Purpose of the trace.
    pub role: Role,
    /// Traces of one group repeat each other.
    pub repeat_group: String,
    /// Number of repetitions.
    pub repeat: usize,
    /// Rest before it, nothing connected, s.
    pub rest_s: Seconds,
    /// Open-circuit voltages at which it may begin, V.
    pub start_v: (Volts, Volts),
    /// Greatest resistance between current and voltmeter, Ω.
    pub resistance_max_ohm: Ohms,
    /// Currents, one after the other.
    pub segments: Vec<Segment>,
    /// Instruments that drive them.
    pub through: Through,
    /// Averaging of rows that are shorter than a step.
    pub averaged: Option<Averaged>,
    /// Resistance between the cell and the load's voltmeter where load and supply drive, Ω: their
    /// current flows through it.
    pub lead_ohm: Ohms,
    /// The first mean after a step, s.
    pub first_sample_s: Seconds,
    /// Share of the time since the step that a further mean lasts.
    pub growth: f64,
    /// Longest time between two rows, s.
    pub longest_s: Seconds,
}

/// Means per decade of the time since a step of these pulses: one is near any time that a table of pulse
/// resistances asks for.
const MAP_SAMPLES_PER_DECADE: f64 = 30.0;
/// Rest before the pulses of a map that is recorded, s: pulse resistances are taken from its trend.
const MAP_REST_S: Seconds = Seconds(15.0);

/// Time without current before the first row, s.
pub const BEFORE_S: Seconds = Seconds(0.5);

impl Check<'_> {
    /// The traces, and the files that they come from.
    pub(super) fn traces(
        &self,
        raw: &[raw::Trace],
    ) -> Result<(Vec<Trace>, Vec<Source>), ConfigError> {
        let (mut traces, mut sources): (Vec<Trace>, _) = (Vec::new(), Vec::new());
        for section in raw {
            if traces.iter().any(|trace| trace.name == section.name) {
                return Err(self.complain(
                    "traces",
                    format!("expected names that differ, found {:?} twice", section.name),
                ));
            }
            let (trace, source) = self.trace(section)?;
            traces.push(trace);
            sources.extend(source);
        }
        Ok((traces, sources))
    }

    /// The pulses of a map, if it has any, from a rest that is recorded. Voltages at the start and
    /// resistance depend on the point.
    pub(super) fn pulses_of_map(&self, raw: &raw_map::Raw) -> Result<Option<Trace>, ConfigError> {
        let Some(pulses) = &raw.pulses else {
            return Ok(None);
        };
        let rows = self.pulses("map.pulses", pulses)?;
        if let Some(reason) = Row::first_wrong(&rows) {
            return Err(self.complain("map.pulses", reason));
        }
        if rows.is_empty() {
            return Err(self.complain("map.pulses", "expected at least one amplitude, found none"));
        }
        let through = self.through(raw.through, &rows, "map.pulses")?;
        let least_v = self.cell.limits.min_v;
        let rest = Segment {
            current_a: Amps::ZERO,
            duration_s: MAP_REST_S,
            power_w: None,
        };
        Ok(Some(Trace {
            name: "pulses".to_owned(),
            role: Role::Train,
            repeat_group: "pulses".to_owned(),
            repeat: 1,
            rest_s: Seconds::ZERO,
            start_v: (self.cell.limits.min_v, self.cell.limits.max_v),
            resistance_max_ohm: Ohms::ZERO,
            segments: std::iter::once(rest)
                .chain(rows.iter().map(|row| row.segment(least_v)))
                .collect(),
            through,
            averaged: None,
            lead_ohm: Ohms(raw.lead_resistance.map_or(Ok(0.0), |lead| {
                self.within("map.lead_resistance", lead.si, 0.0..=0.1, "Ω")
            })?),
            first_sample_s: Seconds(2.0e-3),
            growth: 10.0_f64.powf(1.0 / MAP_SAMPLES_PER_DECADE) - 1.0,
            longest_s: Seconds(10.0),
        }))
    }

    /// Adds the direct current to every row. It has no rest in between: what flows is checked as the rows
    /// are.
    fn with_bias(&self, raw: &raw::Trace, mut rows: Vec<Row>) -> Result<Vec<Row>, ConfigError> {
        let Some(bias) = raw.bias else {
            return Ok(rows);
        };
        if let Some(row) = rows.iter().position(|row| row.power) {
            let reason = format!(
                "expected rows of currents beside it, found a power in row {}",
                row + 1
            );
            return Err(self.complain(&format!("traces.{}.bias", raw.name), reason));
        }
        rows.iter_mut().for_each(|row| row.value += bias.si);
        Ok(rows)
    }

    fn trace(&self, raw: &raw::Trace) -> Result<(Trace, Option<Source>), ConfigError> {
        if raw.name.is_empty()
            || !raw
                .name
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
        {
            return Err(self.complain(
                "traces.name",
                format!(
                    "expected a name of letters, digits, `-` and `_`, found {:?}",
                    raw.name
                ),
            ));
        }
        let field = |part: &str| format!("traces.{}.{part}", raw.name);
        let (rows, source) = self.rows(raw)?;
        let rows = self.with_bias(raw, rows)?;
        let part = if source.is_some() { "file" } else { "segments" };
        let (rows, averaged) = match raw.step {
            Some(step) => {
                let range_s = Seconds(1.0e-3)..=Seconds(3600.0);
                let step_s = self.within(&field("step"), Seconds(step.si), range_s, "s")?;
                let length_s = rows.iter().map(|row| row.duration_s).sum::<Seconds>();
                if step_s > length_s + average::ROUNDING_S {
                    let reason = format!(
                        "expected at most the {length_s} that the trace lasts, found {step_s}"
                    );
                    return Err(self.complain(&field("step"), reason));
                }
                let (rows, averaged) = average::averaged(&rows, step_s)
                    .map_err(|reason| self.complain(&field("step"), reason))?;
                (rows, averaged)
            }
            None => (rows, None),
        };
        let through = self.through(raw.through, &rows, &field(part))?;
        let least_v = self.cell.limits.min_v;
        let segments = rows.iter().map(|row| row.segment(least_v)).collect();
        let limits = &self.cell.limits;
        let [low, high] = raw.start_voltage.map(|volts| Volts(volts.si));
        if !(limits.min_v <= low && low < high && high <= limits.max_v) {
            let reason = format!(
                "expected two rising voltages within {} to {}, found {low} and {high}",
                limits.min_v, limits.max_v
            );
            return Err(self.complain(&field("start_voltage"), reason));
        }
        let per_decade = self.within(
            &field("samples_per_decade"),
            raw.samples_per_decade,
            2.0..=100.0,
            "samples",
        )?;
        let trace = Trace {
            name: raw.name.clone(),
            role: raw.role,
            repeat_group: raw.repeat_group.clone().unwrap_or_else(|| raw.name.clone()),
            repeat: self
                .within(&field("repeat"), raw.repeat as f64, 1.0..=1000.0, "times")
                .map(|_| raw.repeat)?,
            rest_s: Seconds(self.within(
                &field("rest_first"),
                raw.rest_first.si,
                0.0..=86_400.0,
                "s",
            )?),
            start_v: (low, high),
            resistance_max_ohm: Ohms(self.within(
                &field("resistance_max"),
                raw.resistance_max.si,
                1.0e-4..=1.0,
                "Ω",
            )?),
            segments,
            through,
            averaged,
            lead_ohm: Ohms(raw.lead_resistance.map_or(Ok(0.0), |lead| {
                self.within(&field("lead_resistance"), lead.si, 0.0..=0.1, "Ω")
            })?),
            first_sample_s: Seconds(self.within(
                &field("first_sample"),
                raw.first_sample.si,
                2.0e-4..=1.0,
                "s",
            )?),
            growth: 10.0_f64.powf(1.0 / per_decade) - 1.0,
            longest_s: Seconds(self.within(
                &field("longest_interval"),
                raw.longest_interval.si,
                1.0..=3600.0,
                "s",
            )?),
        };
        Ok((trace, source))
    }
}
