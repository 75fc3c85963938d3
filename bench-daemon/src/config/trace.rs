//! Currents that step: the sections `[[traces]]` against bench and cell. Whether a trace stays within the cell's limits is the plan's check.

use analysis::dataset::Role;
use instruments::{generator, instrument::by_key, supply4q};

use super::{ConfigError, Source, check::Check, raw};

/// A current that steps, and how it is recorded.
#[derive(Debug, Clone)]
pub struct Trace {
    /// Its name: files are called after it.
    pub name: String,
    /// What it is for.
    pub role: Role,
    /// Traces of one group repeat each other.
    pub repeat_group: String,
    /// How often it is played.
    pub repeat: usize,
    /// Rest before it, nothing connected, s.
    pub rest_s: f64,
    /// Open-circuit voltages at which it may begin, V.
    pub start_v: (f64, f64),
    /// Greatest resistance between current and voltmeter, Ω.
    pub resistance_max_ohm: f64,
    /// Currents, one after the other.
    pub segments: Vec<Segment>,
    /// The first mean after a step, s.
    pub first_sample_s: f64,
    /// Share of the time since the step that a further mean lasts.
    pub growth: f64,
    /// Longest time between two rows, s.
    pub longest_s: f64,
}

/// A current for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Current, A, charge positive; of a power, what it takes at the least voltage of the cell.
    pub current_a: f64,
    /// How long it flows, s.
    pub duration_s: f64,
    /// Power into the cell, W, where it is given: the current follows from the voltage when it begins.
    pub power_w: Option<f64>,
}

/// Shortest segment, s: a step must be found in the record before the next comes.
const SHORTEST_SEGMENT_S: f64 = 0.5;

impl Check<'_> {
    /// The traces, and the files that they come from.
    pub(super) fn traces(&self, raw: &[raw::Trace]) -> Result<(Vec<Trace>, Vec<Source>), ConfigError> {
        let (mut traces, mut sources): (Vec<Trace>, _) = (Vec::new(), Vec::new());
        for section in raw {
            if traces.iter().any(|trace| trace.name == section.name) {
                return Err(self.complain("traces", format!("expected names that differ, found {:?} twice", section.name)));
            }
            let (trace, source) = self.trace(section)?;
            traces.push(trace);
            sources.extend(source);
        }
        Ok((traces, sources))
    }

    fn trace(&self, raw: &raw::Trace) -> Result<(Trace, Option<Source>), ConfigError> {
        if raw.name.is_empty() || !raw.name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_')) {
            return Err(self.complain("traces.name", format!("expected a name of letters, digits, `-` and `_`, found {:?}", raw.name)));
        }
        let field = |part: &str| format!("traces.{}.{part}", raw.name);
        let greatest_a = self.greatest_a()?;
        let (segments, source) = self.segments(raw, greatest_a)?;
        let limits = &self.cell.limits;
        let [low, high] = raw.start_voltage.map(|volts| volts.si);
        if !(limits.min_v <= low && low < high && high <= limits.max_v) {
            let reason =
                format!("expected two rising voltages within {} V to {} V, found {low} V and {high} V", limits.min_v, limits.max_v);
            return Err(self.complain(&field("start_voltage"), reason));
        }
        let per_decade = self.within(&field("samples_per_decade"), raw.samples_per_decade, (2.0, 100.0), "samples")?;
        let trace = Trace {
            name: raw.name.clone(),
            role: raw.role,
            repeat_group: raw.repeat_group.clone().unwrap_or_else(|| raw.name.clone()),
            repeat: self.within(&field("repeat"), raw.repeat as f64, (1.0, 1000.0), "times").map(|_| raw.repeat)?,
            rest_s: self.within(&field("rest_first"), raw.rest_first.si, (0.0, 86_400.0), "s")?,
            start_v: (low, high),
            resistance_max_ohm: self.within(&field("resistance_max"), raw.resistance_max.si, (1.0e-4, 1.0), "Ω")?,
            segments,
            first_sample_s: self.within(&field("first_sample"), raw.first_sample.si, (2.0e-4, 1.0), "s")?,
            growth: 10.0_f64.powf(1.0 / per_decade) - 1.0,
            longest_s: self.within(&field("longest_interval"), raw.longest_interval.si, (1.0, 3600.0), "s")?,
        };
        Ok((trace, source))
    }

    /// What the bipolar supply and the generator that commands it can drive, A. The load is the voltmeter that tells the voltage at rest.
    fn greatest_a(&self) -> Result<f64, ConfigError> {
        let instruments = &self.bench.instruments;
        let supply = self.needs(instruments.supply4q.as_ref(), "supply4q", "traces")?;
        let generator = self.needs(instruments.generator.as_ref(), "generator", "traces")?;
        self.needs(instruments.scope.as_ref(), "scope", "traces")?;
        self.needs(instruments.load.as_ref(), "load", "traces")?;
        let supply = by_key(supply4q::DIALECTS, &supply.model).map(|dialect| dialect.capabilities());
        let peak_v = by_key(generator::DIALECTS, &generator.model).map_or(0.0, |dialect| dialect.capabilities().max_peak.value());
        Ok(supply.map_or(0.0, |supply| {
            let amps_per_volt = supply.full_scale.value() / supply.analog_full_scale.value();
            let headroom_v = peak_v - self.bench.wiring.command_offset_v.abs();
            supply.full_scale.value().min(amps_per_volt * headroom_v / self.bench.wiring.command_trim)
        }))
    }

    fn segments(&self, raw: &raw::Trace, greatest_a: f64) -> Result<(Vec<Segment>, Option<Source>), ConfigError> {
        let field = |part: &str| format!("traces.{}.{part}", raw.name);
        let (part, segments, source) = match (&raw.segments, &raw.file) {
            (Some(list), None) => {
                let least_v = self.cell.limits.min_v;
                let segment = |raw: &raw::Segment| match (raw.current, raw.power) {
                    (Some(current), None) => Ok(Segment { current_a: current.si, duration_s: raw.duration.si, power_w: None }),
                    (None, Some(power)) => Ok(of_power(power.si, raw.duration.si, least_v)),
                    _ => Err(self.complain(&field("segments"), "expected a current or a power, and not both")),
                };
                let segments = list.iter().map(segment).collect::<Result<_, _>>()?;
                ("segments", segments, None)
            }
            (None, Some(file)) => {
                let source =
                    self.source.open(&self.source.relative(file)).map_err(|error| self.complain(&field("file"), error.to_string()))?;
                ("file", table(&source, self.cell.limits.min_v)?, Some(source))
            }
            _ => return Err(self.complain(&field("segments"), "expected segments or a file of them, and not both")),
        };
        if segments.is_empty() {
            return Err(self.complain(&field(part), "expected at least one segment, found none"));
        }
        for Segment { current_a, duration_s, .. } in &segments {
            self.within(&field(part), *current_a, (-greatest_a, greatest_a), "A")?;
            self.within(&field(part), *duration_s, (SHORTEST_SEGMENT_S, 86_400.0), "s")?;
        }
        Ok((segments, source))
    }
}

/// A power at worst: the current that it takes at the least voltage.
fn of_power(power_w: f64, duration_s: f64, least_v: f64) -> Segment {
    Segment { current_a: power_w / least_v, duration_s, power_w: Some(power_w) }
}

/// Rows of current or power and duration under the header `current_a,duration_s` or `power_w,duration_s`.
fn table(source: &Source, least_v: f64) -> Result<Vec<Segment>, ConfigError> {
    const HEADERS: [&str; 2] = ["current_a,duration_s", "power_w,duration_s"];
    let complain =
        |line: usize, reason: String| ConfigError::Field { path: source.path().to_owned(), line, field: HEADERS[0].to_owned(), reason };
    let mut lines = source.text().lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let found = lines.next().map_or("", |(_, line)| line);
    let Some(header) = HEADERS.iter().position(|header| *header == found) else {
        return Err(complain(1, format!("expected the header {} or {}, found {found:?}", HEADERS[0], HEADERS[1])));
    };
    let row = |(line, text): (usize, &str)| {
        let numbers = text.split_once(',').and_then(|(a, b)| Some((a.trim().parse::<f64>().ok()?, b.trim().parse::<f64>().ok()?)));
        let (value, duration_s) = numbers.ok_or_else(|| complain(line, format!("expected two numbers, found {text:?}")))?;
        Ok(if header == 0 { Segment { current_a: value, duration_s, power_w: None } } else { of_power(value, duration_s, least_v) })
    };
    lines.filter(|(_, text)| !text.is_empty()).map(row).collect()
}
