//! The rows of a trace: typed as segments, or from a file of one of three kinds.

use analysis_files::formats::{ReadOptions, first_bare_row, parse_profile};
use analysis_forward::forward::{Demand, Interpolation};

use instruments::units::{Amps, Seconds, Volts, Watts};

use super::{
    super::{ConfigError, Source, check::Check, raw},
    Segment,
};

/// A requested current or power for a duration; charge positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    /// A or W.
    pub(super) value: f64,
    /// It is a power.
    pub(super) power: bool,
    /// How long, s.
    pub(super) duration_s: Seconds,
}

impl Row {
    /// The current that it takes at a voltage of the cell, A.
    pub(super) fn current_a(&self, volts: Volts) -> Amps {
        if self.power {
            Watts(self.value) / volts
        } else {
            Amps(self.value)
        }
    }

    /// Describes the first invalid row.
    pub(super) fn first_wrong(rows: &[Self]) -> Option<String> {
        rows.iter()
            .enumerate()
            .find_map(|(index, row)| Some(format!("row {}: {}", index + 1, row.judge().err()?)))
    }

    /// Numbers, and a time in which something can flow.
    fn judge(&self) -> Result<(), String> {
        let (value, duration_s) = (self.value, self.duration_s);
        if !value.is_finite() {
            return Err(format!(
                "expected a finite {}, found {value}",
                if self.power { "power" } else { "current" }
            ));
        }
        if !(duration_s > Seconds::ZERO && duration_s.is_finite()) {
            return Err(format!("expected a duration above 0 s, found {duration_s}"));
        }
        Ok(())
    }

    /// A power at worst: the current that it takes at the least voltage.
    pub(super) fn segment(&self, least_v: Volts) -> Segment {
        Segment {
            current_a: self.current_a(least_v),
            duration_s: self.duration_s,
            power_w: self.power.then_some(Watts(self.value)),
        }
    }
}

impl Check<'_> {
    /// The rows, and the file that they come from.
    pub(super) fn rows(&self, raw: &raw::Trace) -> Result<(Vec<Row>, Option<Source>), ConfigError> {
        let field = |part: &str| format!("traces.{}.{part}", raw.name);
        let (part, mut rows, source) = match (&raw.segments, &raw.file, &raw.pulses) {
            (None, None, Some(pulses)) => ("pulses", self.pulses(&field("pulses"), pulses)?, None),
            (Some(list), None, None) => {
                let row = |raw: &raw::Segment| match (raw.current, raw.power) {
                    (Some(current), None) => Ok(Row {
                        value: current.si,
                        power: false,
                        duration_s: Seconds(raw.duration.si),
                    }),
                    (None, Some(power)) => Ok(Row {
                        value: power.si,
                        power: true,
                        duration_s: Seconds(raw.duration.si),
                    }),
                    _ => Err(self.complain(
                        &field("segments"),
                        "expected a current or a power, and not both",
                    )),
                };
                (
                    "segments",
                    list.iter().map(row).collect::<Result<Vec<_>, _>>()?,
                    None,
                )
            }
            (None, Some(file), None) => {
                let source = self
                    .source
                    .open(&self.source.relative(file))
                    .map_err(|error| self.complain(&field("file"), error.to_string()))?;
                ("file", table(&source)?, Some(source))
            }
            _ => {
                return Err(self.complain(
                    &field("segments"),
                    "expected segments or a file of them, and not both, or pulses in their place",
                ));
            }
        };
        if rows.is_empty() {
            return Err(self.complain(&field(part), "expected at least one segment, found none"));
        }
        if let Some(reason) = Row::first_wrong(&rows) {
            let of = source.as_ref().map_or_else(String::new, |source| {
                format!("{}: ", source.path().display())
            });
            return Err(self.complain(&field(part), of + &reason));
        }
        let scale = self.within(
            &field("scale"),
            raw.scale.unwrap_or(1.0),
            -1.0e3..=1.0e3,
            "(factor)",
        )?;
        if scale == 0.0 {
            return Err(self.complain(
                &field("scale"),
                "expected a factor other than 0, with which nothing would flow",
            ));
        }
        rows.iter_mut().for_each(|row| row.value *= scale);
        Ok((rows, source))
    }

    /// Each amplitude out of the cell and into it, with a relaxation behind either.
    pub(super) fn pulses(&self, field: &str, raw: &raw::Pulses) -> Result<Vec<Row>, ConfigError> {
        let row = |value: f64, duration_s: Seconds| Row {
            value,
            power: false,
            duration_s,
        };
        let mut rows = Vec::new();
        for amplitude in &raw.amplitudes {
            let amps = self.within(
                &format!("{field}.amplitudes"),
                amplitude.si,
                1.0e-3..=1.0e3,
                "A",
            )?;
            for current_a in [-amps, amps] {
                rows.extend([
                    row(current_a, Seconds(raw.duration.si)),
                    row(0.0, Seconds(raw.relaxation.si)),
                ]);
            }
        }
        Ok(rows)
    }
}

/// Rows of current or power (charge positive) and duration under the header `current_a,duration_s`
/// or `power_w,duration_s`; else a profile over time as `simulate` reads it, which counts discharge
/// as positive unless the header is a cycler's.
fn table(source: &Source) -> Result<Vec<Row>, ConfigError> {
    const HEADERS: [&str; 2] = ["current_a,duration_s", "power_w,duration_s"];
    let complain = |line: usize, reason: String| ConfigError::Field {
        path: source.path().to_owned(),
        line,
        field: HEADERS[0].to_owned(),
        reason,
    };
    let mut lines = source
        .text()
        .lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.trim()));
    let found = lines.next().map_or("", |(_, line)| line);
    // `simulate` takes bare rows for a power out of the cell; what flows through a cell is not
    // guessed.
    if let Some((line, row)) = first_bare_row(profile_text(source)) {
        let row: String = row.chars().take(80).collect();
        return Err(complain(line, format!("{WANTED}, found {row:?}")));
    }
    let Some(header) = HEADERS.iter().position(|header| *header == found) else {
        return profile(source).map_err(|reason| {
            let (first, second) = (HEADERS[0], HEADERS[1]);
            complain(
                1,
                format!(
                    "expected the header {first} or {second}, found {found:?}; nor is \
            it a profile over time: {reason}"
                ),
            )
        });
    };
    let row = |(line, text): (usize, &str)| {
        let numbers = text.split_once(',').and_then(|(a, b)| {
            Some((a.trim().parse::<f64>().ok()?, b.trim().parse::<f64>().ok()?))
        });
        let (value, duration_s) = numbers
            .ok_or_else(|| complain(line, format!("expected two numbers, found {text:?}")))?;
        let row = Row {
            value,
            power: header == 1,
            duration_s: Seconds(duration_s),
        };
        row.judge()
            .map_err(|reason| complain(line, reason))
            .map(|()| row)
    };
    lines
        .filter(|(_, text)| !text.is_empty())
        .map(row)
        .collect()
}

/// Message for a file without a header.
const WANTED: &str = "expected a header that says what the columns are and which way it flows: \
current_a,duration_s or power_w,duration_s \
                      with charge positive, time_s,current_a or time_s,power_w with discharge \
                      positive";

fn profile_text(source: &Source) -> &str {
    source.text().trim_start_matches('\u{feff}')
}

/// Each row holds until the next; the last one only marks the end of the profile.
fn profile(source: &Source) -> Result<Vec<Row>, String> {
    let options = ReadOptions {
        demand: None,
        interpolation: Interpolation::Hold,
        charge_positive: false,
    };
    let profile = parse_profile(source.path(), "profile", profile_text(source), &options)
        .map_err(|error| error.to_string())?;
    let power = match profile.demand {
        Demand::Power => true,
        Demand::Current => false,
        Demand::Resistance => {
            return Err("expected powers or currents, found resistances of a load".to_owned());
        }
    };
    let held = profile.time_s.windows(2).zip(&profile.value);
    Ok(held
        .map(|(pair, value)| Row {
            value: 0.0 - value,
            power,
            duration_s: Seconds(pair[1] - pair[0]),
        })
        .collect())
}
