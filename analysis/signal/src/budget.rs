//! The uncertainty budget of corrected impedances: the contribution of each cause to the covariance
//! of each point.
//!
//! Causes are independent of each other, so their covariances add up to that of the point. Three
//! belong to the record (noise, rounding to codes, the drift of the cell:
//! [`crate::spectrum::PhasorVariance`]), the others to the correction ([`Source`]): the prior
//! knowledge of shunt, gains, skews, mutual inductances and controls, as far as the controls leave
//! it open, and the noise of the runs over the controls. The parts of the correction are common to
//! all measurements corrected by it.
//!
//! Along Z a covariance is an uncertainty of the magnitude, across Z one of the phase, both to
//! first order.

use std::fmt::Write as _;

use crate::{
    calibration::{Correction, Source},
    spectrum::{ChannelPhasors, ImpedancePoint},
};
use analysis_numeric::Covariance2;
use analysis_plot::{AxisSpec, Chart, Panel, Trace, TraceStyle, report::Table};

/// A cause of uncertainty.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Noise of the record.
    Noise,
    /// Rounding of the record to codes.
    Quantisation,
    /// Drift during the record that is not straight.
    Drift,
    /// A source of the correction's uncertainty.
    #[serde(untagged)]
    Correction(Source),
}

impl Cause {
    /// Returns the name in tables: lower case, with underscores.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::Quantisation => "quantisation",
            Self::Drift => "drift",
            Self::Correction(Source::Shunt) => "shunt",
            Self::Correction(Source::Gain) => "gain",
            Self::Correction(Source::Skew) => "skew",
            Self::Correction(Source::Mutual) => "mutual_inductance",
            Self::Correction(Source::FakeCell) => "fake_cell",
            Self::Correction(Source::Short) => "short",
            Self::Correction(Source::Open) => "open",
            Self::Correction(Source::ControlNoise) => "control_noise",
        }
    }

    /// Returns the index of its colour in a plot: lines of the record and broken lines of the
    /// correction may share one, the last is that of the total.
    const fn colour(self) -> usize {
        match self {
            Self::Noise | Self::Correction(Source::Mutual) => 0,
            Self::Quantisation | Self::Correction(Source::FakeCell) => 1,
            Self::Drift | Self::Correction(Source::Short) => 2,
            Self::Correction(Source::Shunt | Source::Open) => 3,
            Self::Correction(Source::Gain) => 4,
            Self::Correction(Source::Skew) => 5,
            Self::Correction(Source::ControlNoise) => TOTAL_COLOUR,
        }
    }

    /// Returns the name for people.
    const fn label(self) -> &'static str {
        match self {
            Self::Correction(Source::Mutual) => "mutual inductance",
            Self::Correction(Source::FakeCell) => "fake cell",
            Self::Correction(Source::ControlNoise) => "noise of the controls",
            other => other.name(),
        }
    }
}

/// The budget of one point.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct BudgetPoint {
    /// The corrected impedance with its whole covariance.
    pub point: ImpedancePoint,
    /// Covariance by cause, Ω², in the same order at every point; they add up to that of the point.
    pub parts: Vec<(Cause, Covariance2)>,
}

/// Budgets over frequency.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Budget {
    /// One per point.
    pub points: Vec<BudgetPoint>,
}

/// One standard deviation of magnitude and phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolarSigma {
    /// Standard deviation of the magnitude, % of the magnitude.
    pub magnitude_pct: f64,
    /// Standard deviation of the phase, degrees.
    pub phase_deg: f64,
}

impl BudgetPoint {
    /// Creates the budget of a measurement under a correction.
    ///
    /// # Examples
    /// ```
    /// use analysis_signal::budget::BudgetPoint;
    /// use analysis_signal::calibration::{Correction, KnownImpedance};
    /// use analysis_numeric::Covariance2;
    /// use analysis_signal::spectrum::{ChannelPhasors, PhasorVariance};
    ///
    /// let shunt = KnownImpedance {
    ///     r_ohm: 0.010,
    ///     r_sigma_ohm: 1e-5,
    ///     l_h: 0.0,
    ///     l_sigma_h: 1e-9,
    /// };
    /// // 1 A through shunt and cell; no control was measured.
    /// let phasors = ChannelPhasors {
    ///     freq_hz: 10.0,
    ///     volts: [0.017, 0.027, 0.039, 0.045].map(num_complex::Complex64::from),
    ///     variance: [PhasorVariance::circular(1e-12); 4],
    /// };
    /// let budget = BudgetPoint::new(&Correction::none(shunt), &phasors);
    /// let sum: Covariance2 = budget.parts.iter().map(|(_, part)| *part).sum();
    /// assert!((sum.re_re / budget.point.covariance.re_re - 1.0).abs() < 1e-9);
    /// // The unknown gains of the channels are the largest cause.
    /// let largest = budget.parts.iter().max_by(|a, b| a.1.re_re.total_cmp(&b.1.re_re));
    /// assert_eq!(largest.map(|(cause, _)| cause.name()), Some("gain"));
    /// ```
    pub fn new(correction: &Correction, phasors: &ChannelPhasors) -> Self {
        let [noise, quantisation, drift] = correction.measured_parts(phasors);
        let mut parts = vec![
            (Cause::Noise, noise),
            (Cause::Quantisation, quantisation),
            (Cause::Drift, drift),
        ];
        parts.extend(
            correction
                .parts(phasors)
                .into_iter()
                .map(|(source, part)| (Cause::Correction(source), part)),
        );
        Self {
            point: correction.apply(phasors),
            parts,
        }
    }

    /// All causes of the correction together, Ω².
    pub fn correction(&self) -> Covariance2 {
        self.parts
            .iter()
            .filter(|(cause, _)| matches!(cause, Cause::Correction(_)))
            .map(|(_, part)| *part)
            .sum()
    }

    /// Returns the standard deviations of magnitude and phase of this point for a covariance.
    pub fn polar(&self, covariance: Covariance2) -> PolarSigma {
        let point = ImpedancePoint {
            covariance,
            ..self.point
        };
        PolarSigma {
            magnitude_pct: 100.0 * point.magnitude_sigma_ohm() / point.magnitude_ohm(),
            phase_deg: point.phase_sigma_rad().to_degrees(),
        }
    }

    /// Returns the causes with the largest part in the magnitude, and in the phase.
    fn largest(&self) -> [Cause; 2] {
        let by = |value: fn(PolarSigma) -> f64| {
            let rank = |part: &&(Cause, Covariance2)| value(self.polar(part.1));
            self.parts
                .iter()
                .max_by(|a, b| rank(a).total_cmp(&rank(b)))
                .map_or(Cause::Noise, |part| part.0)
        };
        [by(|sigma| sigma.magnitude_pct), by(|sigma| sigma.phase_deg)]
    }
}

/// A value per cause, then those of the correction and of everything together.
type Columns = Vec<(&'static str, PolarSigma)>;

impl Budget {
    /// Creates the budget of measurements under a correction.
    pub fn new<'a>(
        correction: &Correction,
        phasors: impl Iterator<Item = &'a ChannelPhasors>,
    ) -> Self {
        Self {
            points: phasors
                .map(|phasors| BudgetPoint::new(correction, phasors))
                .collect(),
        }
    }

    /// Returns the causes that every point has, in order.
    fn causes(&self) -> Vec<Cause> {
        let first = self.points.first().map_or(&[][..], |point| &point.parts);
        let known = |index: &usize| {
            self.points.iter().any(|point| {
                point
                    .parts
                    .get(*index)
                    .is_some_and(|part| part.1 != Covariance2::ZERO)
            })
        };
        (0..first.len())
            .filter(known)
            .map(|index| first[index].0)
            .collect()
    }

    fn columns(&self, point: &BudgetPoint) -> Columns {
        let causes = self.causes();
        let parts = point.parts.iter().filter(|part| causes.contains(&part.0));
        let mut columns: Columns = parts
            .map(|(cause, part)| (cause.name(), point.polar(*part)))
            .collect();
        columns.push(("correction", point.polar(point.correction())));
        columns.push(("total", point.polar(point.point.covariance)));
        columns
    }

    /// As CSV: frequency, |Z| and phase, then one standard deviation of the magnitude (%) and of
    /// the phase (°) for every cause, for the correction as a whole and for all together. Causes
    /// that are nothing at every point are left out.
    pub fn to_csv(&self) -> String {
        let mut text = "freq_hz,z_abs_ohm,phase_deg".to_owned();
        for (name, _) in self
            .points
            .first()
            .map_or(Vec::new(), |point| self.columns(point))
        {
            // Writing to a string cannot fail.
            let _ = write!(text, ",{name}_pct,{name}_deg");
        }
        text.push('\n');
        for point in &self.points {
            let z = &point.point;
            let _ = write!(
                text,
                "{:?},{:?},{:?}",
                z.freq_hz,
                z.magnitude_ohm(),
                z.phase_rad().to_degrees()
            );
            for (_, sigma) in self.columns(point) {
                let _ = write!(text, ",{:.4e},{:.4e}", sigma.magnitude_pct, sigma.phase_deg);
            }
            text.push('\n');
        }
        text
    }

    /// For the report: "magnitude in % / phase in °" of every cause.
    pub fn table(&self) -> Table {
        let mut header = vec!["f / Hz".to_owned()];
        header.extend(
            self.causes()
                .into_iter()
                .map(|cause| cause.label().to_owned()),
        );
        header.extend(["correction".to_owned(), "total".to_owned()]);
        let row = |point: &BudgetPoint| {
            let mut row = vec![short(point.point.freq_hz)];
            row.extend(
                self.columns(point)
                    .into_iter()
                    .map(|(_, s)| format!("{} / {}", short(s.magnitude_pct), short(s.phase_deg))),
            );
            row
        };
        let caption =
            "Uncertainty budget: one standard deviation of |Z| in % / of the phase in °, by cause"
                .to_owned();
        Table {
            caption,
            header,
            rows: self.points.iter().map(row).collect(),
        }
    }

    /// Lines over frequency: magnitude above, phase below. Parts far below the total are not drawn.
    pub fn chart(&self, title: &str) -> Chart {
        let x = || AxisSpec::logarithmic("Frequency / Hz");
        let panel = |name: &str, labelled: bool, value: fn(PolarSigma) -> f64| {
            let top = self
                .points
                .iter()
                .map(|point| value(point.polar(point.point.covariance)))
                .fold(0.0, f64::max);
            let traces = self.traces(labelled, |point, part| {
                let value = value(point.polar(part));
                (value > top * DRAWN).then_some((point.point.freq_hz, value))
            });
            Panel {
                aspect: 0.36,
                ..Panel::new(x(), AxisSpec::logarithmic(name), traces)
            }
        };
        let mut magnitude = panel("1σ of |Z| / %", true, |sigma| sigma.magnitude_pct);
        let phase = panel("1σ of the phase / °", false, |sigma| sigma.phase_deg);
        for (above, below) in magnitude.traces.iter_mut().zip(&phase.traces) {
            if above.points.is_empty() && below.points.is_empty() {
                above.label = None;
            }
        }
        Chart::new(
            title,
            "one standard deviation by cause; solid: of the record, dashed: of the correction, \
            points: all together",
            vec![magnitude, phase],
        )
    }

    fn traces(
        &self,
        labelled: bool,
        place: impl Fn(&BudgetPoint, Covariance2) -> Option<(f64, f64)>,
    ) -> Vec<Trace> {
        let name = |words: &'static str| if labelled { words } else { "" };
        let mut traces = Vec::new();
        for cause in self.causes() {
            let part = |point: &BudgetPoint| {
                point
                    .parts
                    .iter()
                    .find(|part| part.0 == cause)
                    .and_then(|part| place(point, part.1))
            };
            let style = if matches!(cause, Cause::Correction(_)) {
                TraceStyle::Dashed
            } else {
                TraceStyle::Line
            };
            traces.push(Trace::new(
                name(cause.label()),
                cause.colour(),
                style,
                self.points.iter().filter_map(part).collect(),
            ));
        }
        let total = self
            .points
            .iter()
            .filter_map(|point| place(point, point.point.covariance))
            .collect();
        traces.push(Trace::new(
            name("total"),
            TOTAL_COLOUR,
            TraceStyle::Points,
            total,
        ));
        traces
    }

    /// Returns a summary as text: the total at the ends of the band, and its largest cause.
    pub fn in_words(&self) -> Option<String> {
        let (first, last) = (self.points.first()?, self.points.last()?);
        let end = |point: &BudgetPoint| {
            let (total, [magnitude, phase]) =
                (point.polar(point.point.covariance), point.largest());
            let (pct, deg) = (short(total.magnitude_pct), short(total.phase_deg));
            format!(
                "{pct} % (mostly {}) and {deg}° (mostly {}) at {} Hz",
                magnitude.label(),
                phase.label(),
                short(point.point.freq_hz)
            )
        };
        Some(format!(
            "uncertainty of |Z| and phase, 1σ: {}; {}",
            end(first),
            end(last)
        ))
    }
}

/// Parts below this share of the largest total are not drawn.
const DRAWN: f64 = 3e-3;
const TOTAL_COLOUR: usize = 6;

/// Two significant digits for a small number, four for a large one.
fn short(value: f64) -> String {
    let digits = if value >= 10.0 { 4 } else { 2 };
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let decimals = (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    if value.abs() < 1e-5 {
        format!("{value:.0e}")
    } else {
        format!("{value:.decimals$}")
    }
}
