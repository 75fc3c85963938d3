//! Parameters of effects.

/// Scale on which a parameter is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// As it is.
    Linear,
    /// By its logarithm: for values above zero.
    Log,
    /// Not searched: each start is tried and stays (the number of a branch).
    Choice,
}

/// Lowest and highest value that physics and the base fit allow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Lowest value.
    pub lower: f64,
    /// Highest value.
    pub upper: f64,
}

/// Range of a value in sound cells and benches. The search extends beyond it: a value outside is
/// found, and reported with a caution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usual {
    /// Lowest and highest value.
    pub range: Range,
    /// Reason for the range, with its source.
    pub source: &'static str,
}

/// One parameter of an effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name with unit in files: `r_ohm`.
    pub name: &'static str,
    /// Unit: `Ω`; empty for a plain number.
    pub unit: &'static str,
    /// Bounds. The strength's may reach to both sides of zero or start there.
    pub range: Range,
    /// Scale of the search; a strength is always linear.
    pub scale: Scale,
    /// A typical size: the step of finite differences is a small part of it.
    pub typical: f64,
    /// Values to start from; empty for a strength, which starts at zero.
    pub starts: Vec<f64>,
    /// The parameter has no meaning and is not searched, unless the choice of this index has this
    /// value.
    pub only_with: Option<(usize, f64)>,
    /// Values in sound cells and benches; `None` if only the bounds are known.
    pub usual: Option<Usual>,
}

impl Parameter {
    /// Returns the same parameter with a usual range.
    pub(crate) fn usually(self, range: Range, source: &'static str) -> Self {
        Self {
            usual: Some(Usual { range, source }),
            ..self
        }
    }

    /// The usual range where all values from `low` to `high` lie outside it.
    pub fn unusual(&self, low: f64, high: f64) -> Option<Usual> {
        self.usual
            .filter(|u| high < u.range.lower || low > u.range.upper)
    }

    /// Returns the strength of an effect: zero is absence.
    pub fn strength(name: &'static str, unit: &'static str, range: Range, typical: f64) -> Self {
        Self {
            name,
            unit,
            range,
            scale: Scale::Linear,
            typical,
            starts: Vec::new(),
            only_with: None,
            usual: None,
        }
    }

    /// Returns a positive shape parameter searched by its logarithm from several starts.
    pub fn shape(name: &'static str, unit: &'static str, range: Range, starts: Vec<f64>) -> Self {
        let typical = starts.first().copied().unwrap_or(range.lower);
        Self {
            name,
            unit,
            range,
            scale: Scale::Log,
            typical,
            starts,
            only_with: None,
            usual: None,
        }
    }

    /// Creates a state of either sign that is searched without a transformation if the choice of an
    /// index has a value.
    pub fn state(
        name: &'static str,
        range: Range,
        starts: Vec<f64>,
        parameter: usize,
        value: f64,
    ) -> Self {
        Self {
            name,
            unit: "",
            range,
            scale: Scale::Linear,
            typical: 1.0,
            starts,
            only_with: Some((parameter, value)),
            usual: None,
        }
    }

    /// Returns a choice among whole numbers from 0 on, each tried.
    pub fn choice(name: &'static str, count: usize) -> Self {
        let starts: Vec<f64> = (0..count).map(|k| k as f64).collect();
        let range = Range {
            lower: 0.0,
            upper: count as f64,
        };
        Self {
            name,
            unit: "",
            range,
            scale: Scale::Choice,
            typical: 1.0,
            starts,
            only_with: None,
            usual: None,
        }
    }
}

/// `count` values from `low` to `high`, equally spaced on a logarithmic scale; `low` alone for a
/// count of 1.
pub(crate) fn log_grid(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    (0..count)
        .map(|k| low * (high / low).powf(k as f64 / last))
        .collect()
}
