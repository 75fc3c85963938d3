//! Instruments that can drive a trace: checks each method against the abilities of its
//! instruments, row by row.

use std::ops::RangeInclusive;

use instruments::{
    generator,
    instrument::by_key,
    load, scope, supply,
    units::{Amps, Seconds, Volts},
};

use super::{
    super::{ConfigError, check::Check, raw},
    BEFORE_S, Row,
};
use crate::plan::{LONGEST_FRAME_S, Through};

/// Shortest row of the bipolar supply, s: a step must be found in the record before the next comes.
const SHORTEST_BIPOLAR_S: Seconds = Seconds(0.5);
/// Shortest row of load and supply, s: their meters are read every second.
const SHORTEST_METERED_S: Seconds = Seconds(1.0);
/// Shortest step of a wave, s: the supply settles within a quarter of it.
const SHORTEST_WAVE_S: Seconds = Seconds(1.0e-3);
/// Longest row, s.
const LONGEST_S: Seconds = Seconds(86_400.0);
/// Minimum time without current after a wave, s: the wave is removed within it, before it
/// repeats.
const TAIL_S: Seconds = Seconds(4.0);
/// Time for which the scope records after a wave, s.
pub const AFTER_WAVE_S: Seconds = Seconds(1.0);
/// Times of rows are differences of rounded ones: a nanosecond is none.
const GRID_PER_S: f64 = 1.0e9;
/// A row may be off whole steps by this share of one.
const WHOLE: f64 = 1.0e-3;

impl Check<'_> {
    /// Returns the requested driver, or the first suitable one.
    pub(super) fn through(
        &self,
        asked: raw::Through,
        rows: &[Row],
        field: &str,
    ) -> Result<Through, ConfigError> {
        let of = |way: raw::Through| match way {
            raw::Through::Wave => self.wave(rows),
            raw::Through::LoadAndSupply => self.load_and_supply(rows),
            raw::Through::Bipolar | raw::Through::Auto => self.bipolar(rows),
        };
        if asked != raw::Through::Auto {
            return of(asked).map_err(|reason| self.complain(field, reason));
        }
        let mut reasons = Vec::new();
        for (way, name) in [
            (raw::Through::Bipolar, "bipolar"),
            (raw::Through::Wave, "wave"),
            (raw::Through::LoadAndSupply, "load_and_supply"),
        ] {
            match of(way) {
                Ok(through) => return Ok(through),
                Err(reason) => reasons.push(format!("{name}: {reason}")),
            }
        }
        Err(self.complain(
            field,
            format!("nothing on the bench can play it; {}", reasons.join("; ")),
        ))
    }

    fn bipolar(&self, rows: &[Row]) -> Result<Through, String> {
        let ((greatest_a, what), least_v) = (self.driven_a()?, self.cell.limits.min_v);
        self.present(self.bench.instruments.load.is_some(), "load")?;
        self.each(
            rows,
            SHORTEST_BIPOLAR_S,
            "the bipolar supply step by step",
            |row| within(row, least_v, -greatest_a..=greatest_a, &what),
        )?;
        Ok(Through::Bipolar)
    }

    fn wave(&self, rows: &[Row]) -> Result<Through, String> {
        let ((greatest_a, what), least_v) = (self.driven_a()?, self.cell.limits.min_v);
        self.present(self.bench.instruments.load.is_some(), "load")?;
        self.each(rows, SHORTEST_WAVE_S, "a wave of the generator", |row| {
            within(row, least_v, -greatest_a..=greatest_a, &what)
        })?;
        let generator = self
            .bench
            .instruments
            .generator
            .as_ref()
            .map_or("", |generator| generator.model.as_str());
        let most = by_key(generator::DIALECTS, generator).and_then(|dialect| dialect.wave_steps());
        let most = most
            .ok_or_else(|| format!("expected a generator that plays waves, found {generator}"))?;
        let step_s = (rows
            .iter()
            .map(|row| row.duration_s)
            .fold(Seconds::INFINITY, Seconds::min)
            .value()
            * GRID_PER_S)
            .round()
            / GRID_PER_S;
        let step_s = Seconds(step_s);
        for (index, row) in rows.iter().enumerate() {
            let steps = row.duration_s / step_s;
            if (steps - steps.round()).abs() > WHOLE {
                let found = row.duration_s;
                return Err(format!(
                    "row {}: expected a multiple of the shortest row, {step_s}, found {found}; \
                    `step` averages",
                    index + 1
                ));
            }
        }
        let length_s = BEFORE_S + rows.iter().map(|row| row.duration_s).sum::<Seconds>();
        let steps = ((length_s + TAIL_S) / step_s).ceil() as usize;
        let steps = steps.checked_next_power_of_two().unwrap_or(usize::MAX);
        if steps > most {
            let least_ms = (length_s + TAIL_S).value() / most as f64 * 1.0e3;
            return Err(format!(
                "expected at most {most} steps, which is what {generator} holds, found {steps} of \
                {} ms; `step` of {least_ms:.1} ms or more averages",
                1.0e3 * step_s.value()
            ));
        }
        let screen_s = self.screen_s(length_s + AFTER_WAVE_S);
        if screen_s > LONGEST_FRAME_S {
            return Err(format!(
                "expected a trace that a frame of {LONGEST_FRAME_S} can hold, found one of \
                {screen_s}"
            ));
        }
        Ok(Through::Wave { step_s, steps })
    }

    fn load_and_supply(&self, rows: &[Row]) -> Result<Through, String> {
        let instruments = &self.bench.instruments;
        self.present(instruments.load.is_some(), "load")?;
        let charges = rows.iter().any(|row| row.value > 0.0);
        self.present(instruments.supply.is_some() || !charges, "supply")?;
        let draws = instruments
            .load
            .as_ref()
            .and_then(|load| Some((load, by_key(load::DIALECTS, &load.model)?.capabilities())));
        let feeds = instruments.supply.as_ref().and_then(|supply| {
            Some((
                supply,
                by_key(supply::DIALECTS, &supply.model)?.capabilities(),
            ))
        });
        let least_v = self.cell.limits.min_v;
        self.each(rows, SHORTEST_METERED_S, "load and supply", |row| {
            if let (true, Some((load, can))) = (row.value < 0.0, &draws) {
                let what = format!("the load {}", load.model);
                within(row, least_v, -can.max_current..=Amps::ZERO, &what)?;
                let asked_w = if row.power {
                    row.value
                } else {
                    row.value * self.cell.limits.max_v.value()
                };
                if -asked_w > can.max_power_w {
                    return Err(format!(
                        "expected at most {} W, which {what} can take up, found {:.1} W",
                        can.max_power_w, -asked_w
                    ));
                }
            }
            if let (true, Some((supply, can))) = (row.value > 0.0, &feeds) {
                within(
                    row,
                    least_v,
                    Amps::ZERO..=can.max_current,
                    &format!("the supply {}", supply.model),
                )?;
            }
            Ok(())
        })?;
        Ok(Through::LoadAndSupply)
    }

    /// Checks every row against the shortest duration and against the limits of the driver.
    fn each(
        &self,
        rows: &[Row],
        shortest_s: Seconds,
        what: &str,
        judge: impl Fn(&Row) -> Result<(), String>,
    ) -> Result<(), String> {
        for (index, row) in rows.iter().enumerate() {
            let of_row = |reason: String| format!("row {}: {reason}", index + 1);
            if !(shortest_s * (1.0 - WHOLE)..=LONGEST_S).contains(&row.duration_s) {
                let found = row.duration_s;
                let reason = format!(
                    "expected {shortest_s} to {LONGEST_S}, which {what} can play, found \
                    {found}"
                );
                let help = match found {
                    _ if found >= shortest_s => "",
                    _ if shortest_s <= SHORTEST_WAVE_S => "; `step` averages rows",
                    _ => "; `step` averages rows, `through = \"wave\"` plays them from 1 ms on",
                };
                return Err(of_row(format!("{reason}{help}")));
            }
            judge(row).map_err(of_row)?;
        }
        Ok(())
    }

    fn present(&self, there: bool, role: &str) -> Result<(), String> {
        there.then_some(()).ok_or_else(|| {
            format!(
                "expected a section [instruments.{role}] in {}",
                self.bench_source.path().display()
            )
        })
    }

    /// Returns the largest current that the bipolar supply and its generator can drive, A. The
    /// load contains the voltmeter that measures the voltage at rest.
    pub(in crate::config) fn driven_a(&self) -> Result<(Amps, String), String> {
        let instruments = &self.bench.instruments;
        if self.bench.wiring.analog.is_some() {
            return Err(
                "expected a bipolar supply that measures its current, and the bench has an \
                analog one without a link: leave the trace out, or drive it through load and \
                charger"
                    .to_owned(),
            );
        }
        self.present(instruments.supply4q.is_some(), "supply4q")?;
        self.present(instruments.generator.is_some(), "generator")?;
        self.present(instruments.scope.is_some(), "scope")?;
        let generator = instruments.generator.as_ref();
        let can = self.bench.bipolar();
        let peak_v = generator.and_then(|generator| by_key(generator::DIALECTS, &generator.model));
        let peak_v = peak_v.map_or(Volts::ZERO, |dialect| dialect.capabilities().max_peak);
        let greatest_a = can.map_or(Amps::ZERO, |can| {
            let amps_per_volt = can.full_scale.value() / can.analog_full_scale.value();
            let headroom_v = peak_v - self.bench.wiring.command_offset_v.abs();
            can.full_scale.min(Amps(
                amps_per_volt * headroom_v.value() / self.bench.wiring.command_trim,
            ))
        });
        Ok((
            greatest_a,
            format!(
                "the bipolar supply {}",
                self.bench.bipolar_model().unwrap_or_default()
            ),
        ))
    }

    /// The time that the scope's screen spans when it is to hold at least a given span, s.
    fn screen_s(&self, span_s: Seconds) -> Seconds {
        let scope = self
            .bench
            .instruments
            .scope
            .as_ref()
            .and_then(|scope| by_key(scope::DIALECTS, &scope.model));
        scope.map_or(span_s, |scope| {
            let capabilities = scope.capabilities();
            capabilities.time_per_div(span_s) * capabilities.horizontal_div
        })
    }
}

/// The current of a row, of a power at the least voltage of the cell.
fn within(
    row: &Row,
    least_v: Volts,
    range_a: RangeInclusive<Amps>,
    what: &str,
) -> Result<(), String> {
    let amps = row.current_a(least_v);
    if range_a.contains(&amps) {
        return Ok(());
    }
    let found = if row.power {
        format!("{} W, {amps:.3} at {least_v}", row.value)
    } else {
        format!("{amps}")
    };
    let (least_a, greatest_a) = range_a.into_inner();
    Err(format!(
        "expected {least_a} to {greatest_a}, which {what} can drive, found {found}"
    ))
}
