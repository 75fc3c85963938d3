//! Demand on a cell or a pack over time.

use super::law::Demand;
use serde::Serialize;

/// Interpolation between two rows of a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// A row holds until the next (zero-order hold, as in the thesis' steps). The last row only
    /// ends the profile.
    Hold,
    /// Straight from row to row.
    Linear,
}

/// A demand over time, in steps of any size.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Name for tables and plots.
    pub name: String,
    /// Kind of the values.
    pub demand: Demand,
    /// Interpolation between the rows.
    pub interpolation: Interpolation,
    /// Times, s, rising.
    pub time_s: Vec<f64>,
    /// Demand at these times, W, A (discharge positive) or Ω.
    pub value: Vec<f64>,
    /// True where its file counted charge as positive and the sign was changed.
    pub negated: bool,
}

/// Part of a profile between two times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Start, s.
    pub(super) from_s: f64,
    /// Duration, s.
    pub(super) step_s: f64,
    /// Demand at the start.
    pub(super) from: f64,
    /// Demand at the end, before a jump.
    pub(super) to: f64,
}

/// A demand at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DemandPoint {
    /// Time, s.
    pub(super) time_s: f64,
    /// Demand, W, A or Ω.
    pub(super) demand: f64,
}

impl Piece {
    /// The demand at the start.
    pub(super) fn start(&self) -> DemandPoint {
        DemandPoint {
            time_s: self.from_s,
            demand: self.from,
        }
    }
}

/// Reason why a file or a list is not a valid profile.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// Too little.
    #[error("profile {name}: expected at least 2 rows of time and demand, met {met}")]
    TooShort {
        /// Name of the profile.
        name: String,
        /// Rows met.
        met: usize,
    },
    /// A row that cannot be.
    #[error("profile {name}, row {row} (counted from 1): expected {expected}, met {met}")]
    Row {
        /// Name of the profile.
        name: String,
        /// The row.
        row: usize,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        met: f64,
    },
}

impl Profile {
    /// Creates a profile of rows.
    ///
    /// # Errors
    /// [`ProfileError::TooShort`], or [`ProfileError::Row`] unless times rise, all is finite, and a
    /// load resistance is above zero.
    pub fn new(
        name: &str,
        demand: Demand,
        interpolation: Interpolation,
        rows: &[(f64, f64)],
    ) -> Result<Self, ProfileError> {
        if rows.len() < 2 {
            return Err(ProfileError::TooShort {
                name: name.to_owned(),
                met: rows.len(),
            });
        }
        let fail = |k: usize, expected, met| {
            Err(ProfileError::Row {
                name: name.to_owned(),
                row: k + 1,
                expected,
                met,
            })
        };
        for (k, &(time, value)) in rows.iter().enumerate() {
            if !time.is_finite() || (k > 0 && time <= rows[k - 1].0) {
                return fail(k, "a time in s later than the row before", time);
            }
            if !value.is_finite() {
                return fail(k, "a finite demand", value);
            }
            if demand == Demand::Resistance && value <= 0.0 {
                return fail(k, "a load resistance above 0 Ω", value);
            }
        }
        let (time_s, value) = rows.iter().copied().unzip();
        Ok(Self {
            name: name.to_owned(),
            demand,
            interpolation,
            time_s,
            value,
            negated: false,
        })
    }

    /// Returns a constant demand for a duration, s.
    ///
    /// # Errors
    /// As [`Profile::new`].
    pub fn constant(demand: Demand, value: f64, duration_s: f64) -> Result<Self, ProfileError> {
        Self::new(
            "constant",
            demand,
            Interpolation::Hold,
            &[(0.0, value), (duration_s, value)],
        )
    }

    /// Returns the same profile with all demands times a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            value: self.value.iter().map(|v| v * factor).collect(),
            ..self.clone()
        }
    }

    /// Returns the duration from the first to the last row, s.
    pub fn duration_s(&self) -> f64 {
        match (self.time_s.first(), self.time_s.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }

    /// Returns the largest demand: the highest value, or for a profile that only charges the most
    /// negative one. The last row of [`Interpolation::Hold`] does not count, because it only ends
    /// the profile. Returns `None` without a demand.
    pub fn peak(&self) -> Option<f64> {
        let count = self
            .value
            .len()
            .saturating_sub(usize::from(self.interpolation == Interpolation::Hold));
        let applied = self.value.iter().take(count).copied();
        let (low, high) = applied.fold((0.0_f64, 0.0_f64), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        Some(if high > 0.0 { high } else { low }).filter(|peak| *peak != 0.0)
    }

    /// Returns the pieces between the rows, none longer than `max_step_s`.
    pub(super) fn pieces(&self, max_step_s: f64) -> impl Iterator<Item = Piece> + '_ {
        (1..self.time_s.len()).flat_map(move |k| {
            let (t0, t1, v0) = (self.time_s[k - 1], self.time_s[k], self.value[k - 1]);
            let v1 = if self.interpolation == Interpolation::Linear {
                self.value[k]
            } else {
                v0
            };
            let count = parts(t1 - t0, max_step_s);
            let parts = count as f64;
            let at = move |part: f64| v0 + (v1 - v0) * part / parts;
            (0..count).map(move |part| {
                let part = part as f64;
                Piece {
                    from_s: t0 + (t1 - t0) * part / parts,
                    step_s: (t1 - t0) / parts,
                    from: at(part),
                    to: at(part + 1.0),
                }
            })
        })
    }
}

/// Returns the number of steps that a row is cut into so that none is longer than `max_step_s`.
pub(super) fn parts(row_s: f64, max_step_s: f64) -> u64 {
    if row_s <= max_step_s {
        1
    } else {
        (row_s / max_step_s * (1.0 - 1e-9)).ceil().max(1.0) as u64
    }
}
