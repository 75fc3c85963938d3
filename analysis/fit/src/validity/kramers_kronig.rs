//! The linear Kramers–Kronig test: does a ladder of RC elements, which obeys the Kramers–Kronig
//! relations by construction, describe the spectrum within its noise? (Boukamp, J. Electrochem.
//! Soc. 142 (1995) 1885; Schönleber, Klotz and Ivers-Tiffée, Electrochim. Acta 131 (2014) 20.)
//!
//! The order is chosen by their criterion µ, and then raised while the residuals are larger than
//! the noise allows: at twenty points µ often stops before the ladder can follow a *valid* spectrum
//! to its ends, which are then 4 to 10 % off. Only what no order up to five elements per decade can
//! describe is held against the spectrum. Residuals are judged by their own standard deviation (the
//! noise's, less what the ladder follows), not by a fixed percentage.

use super::ladder::{Ladder, SERIES, Whitening};
use super::noise::{Noise, NoiseSource};
use super::tail::{pair_tail, sum_tail};
use super::{DOUBTFUL_RATE, FALSE_ALARM_RATE, ValidityError};
use crate::sizes::sizes_ohm;
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use serde::Serialize;
use std::f64::consts::TAU;

/// Fewest points of a spectrum that can be tested.
pub const FEWEST_POINTS: usize = 6;
/// Limit of µ below which the ladder begins to follow the noise, as Schönleber et al. advise.
const MU_LIMIT: f64 = 0.85;
/// Factor by which the time constants reach beyond the band on either side.
const REACH: f64 = 5.0;
/// Size that a resistance of the ladder is expected to have at most, in units of the largest
/// impedance.
const LARGEST: f64 = 0.2;
const MOST_PER_DECADE: f64 = 5.0;
const MOST_ELEMENTS: usize = 60;
/// Shares of the false-alarm rate: the single points, the sum of all.
const POINTS_SHARE: f64 = 0.4;
const SUM_SHARE: f64 = 0.3;
/// Maximum share of a point's noise that the ladder may follow; above it the point is not tested.
const UNTESTED: f64 = 0.97;

/// One point's part in the test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KkPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Measured less fitted real part, % of |Z|. Of a single point that was left out: against the
    /// fit to the others.
    pub re_percent: f64,
    /// The same of the imaginary part.
    pub im_percent: f64,
    /// Standard deviation that noise alone gives to `re_percent`, %.
    pub sigma_re_percent: f64,
    /// The same for `im_percent`.
    pub sigma_im_percent: f64,
    /// Size of both residuals together in standard deviations (Mahalanobis distance).
    pub sigmas: f64,
    /// Probability of such a distance in a valid spectrum.
    pub p: f64,
    /// True if it disagrees with the others: a single point that was left out of the fit, or one of
    /// an end of the band, whose residual is that of the fit to the whole band (the fit to the rest
    /// has no meaning there).
    pub left_out: bool,
    /// False if the ladder follows the point regardless of its value.
    pub tested: bool,
}

impl KkPoint {
    /// Size of both residuals together, % of |Z|.
    pub fn percent(&self) -> f64 {
        self.re_percent.hypot(self.im_percent)
    }
}

/// Outcome of the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum KkOutcome {
    /// The whole spectrum agrees with the Kramers–Kronig relations.
    Agrees,
    /// It agrees except for single points.
    SinglePoints,
    /// It agrees except for one end of the band.
    PartOfBand,
    /// It does with the other sign of the imaginary part.
    SignSwapped,
    /// No part of it that is worth having does.
    Disagrees,
}

impl KkOutcome {
    /// Name as JSON and tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::SinglePoints => "single-points",
            Self::PartOfBand => "part-of-band",
            Self::SignSwapped => "sign-swapped",
            Self::Disagrees => "disagrees",
        }
    }
}

/// Outcome of the linear Kramers–Kronig test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KramersKronig {
    /// RC elements of the fit that is reported.
    pub order: usize,
    /// The order at which µ fell to 0.85; `None` if it stayed above.
    pub mu_order: Option<usize>,
    /// µ of the fit that is reported.
    pub mu: f64,
    /// Weighted sum of squared residuals; single points that were left out do not count.
    pub chi2: f64,
    /// Its degrees of freedom; not an integer, because the resistances are restrained.
    pub dof: f64,
    /// Probability of such a sum in a valid spectrum.
    pub p: f64,
    /// Source of the noise.
    pub noise: NoiseSource,
    /// Standard deviation of the noise, % of |Z| (median over the points).
    pub noise_percent: f64,
    /// Outcome of the test.
    pub outcome: KkOutcome,
    /// The points, by rising frequency.
    pub points: Vec<KkPoint>,
    /// Impedance of the fitted ladder at each point, Ω.
    #[serde(skip)]
    pub fitted_ohm: Vec<Complex64>,
    /// The ladder that made it: of all but single bad points.
    #[serde(skip)]
    pub(super) ladder: Ladder,
}

impl KramersKronig {
    /// The largest residual that the ladder leaves, with its point.
    pub fn worst(&self) -> Option<&KkPoint> {
        self.points
            .iter()
            .max_by(|a, b| a.percent().total_cmp(&b.percent()))
    }

    /// The real part is negative over more than half the points. Kramers–Kronig cannot see that:
    /// with Z, −Z obeys it.
    pub(super) fn is_reversed(&self) -> bool {
        2 * self.fitted_ohm.iter().filter(|z| z.re < 0.0).count() > self.points.len()
    }

    /// A single bad point that was left out.
    pub(super) fn is_single(&self, point: usize) -> bool {
        self.outcome == KkOutcome::SinglePoints && self.points[point].left_out
    }

    /// The probability below which one of the points counts against the spectrum, for a rate of
    /// false alarms per spectrum.
    pub(super) fn point_limit(points: usize, rate: f64) -> f64 {
        POINTS_SHARE * rate / points as f64
    }
}

/// The test's working memory and what it knows of one spectrum.
struct Test<'a> {
    spectrum: &'a Spectrum,
    noise: &'a Noise,
    z_ohm: Vec<Complex64>,
    ladder: Ladder,
    leverage: Vec<(f64, f64, f64)>,
    left_out: Vec<bool>,
    restraint_per_ohm: f64,
    most: usize,
}

/// Tests one spectrum against noise that is known or estimated.
///
/// ```
/// use analysis_fit::validity::{KkOutcome, Noise, kramers_kronig};
/// use analysis_model::model::{Erm, RcBranch};
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
///
/// let cell = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 30.0 }] };
/// let point = |k: i32| {
///     let freq_hz = 10.0_f64.powf(-2.0 + 0.2 * f64::from(k));
///     let (z_ohm, covariance) = (cell.impedance(freq_hz), Covariance2::circular(1e-10));
///     ImpedancePoint { freq_hz, z_ohm, covariance, amplitude_a: 1.0 }
/// };
/// let mut spectrum = Spectrum { points: (0..26).map(point).collect(), ..Spectrum::default() };
/// let test = kramers_kronig(&spectrum, &Noise::of(&spectrum, &[])?)?;
/// assert_eq!(test.outcome, KkOutcome::Agrees);
/// // The cell warms up under the slow half of the sweep: no linear, steady system does that.
/// spectrum.points.iter_mut().take(13).for_each(|p| p.z_ohm *= 0.9);
/// let test = kramers_kronig(&spectrum, &Noise::of(&spectrum, &[])?)?;
/// assert_ne!(test.outcome, KkOutcome::Agrees);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ValidityError`] for a spectrum that is none, or has fewer than [`FEWEST_POINTS`] points.
pub fn kramers_kronig(spectrum: &Spectrum, noise: &Noise) -> Result<KramersKronig, ValidityError> {
    let mut test = Test::new(spectrum, noise)?;
    let whiten = noise.whitening();
    test.ladder
        .load(&test.z_ohm, &whiten, test.restraint_per_ohm);
    let (order, mu_order) = test.choose_order();
    if !test.alarm(FALSE_ALARM_RATE) {
        return Ok(test.result(order, mu_order, KkOutcome::Agrees));
    }
    let order = test.most;
    if test.passes_with_other_sign() {
        test.leave_out(|_| false);
        return Ok(test.result(order, mu_order, KkOutcome::SignSwapped));
    }
    test.leave_out(|_| false);
    if test.leave_out_the_worst() {
        if !test.is_end_left_out() {
            return Ok(test.result(order, mu_order, KkOutcome::SinglePoints));
        }
        return Ok(test.part_of_band(mu_order));
    }
    if test.leave_out_an_end() {
        return Ok(test.part_of_band(mu_order));
    }
    test.leave_out(|_| false);
    Ok(test.result(order, mu_order, KkOutcome::Disagrees))
}

impl<'a> Test<'a> {
    fn new(spectrum: &'a Spectrum, noise: &'a Noise) -> Result<Self, ValidityError> {
        spectrum.validate()?;
        let points = spectrum.points.len();
        if points < FEWEST_POINTS {
            return Err(ValidityError::TooFewPoints {
                spectrum: spectrum.name.clone(),
                expected: FEWEST_POINTS,
                met: points,
            });
        }
        let z_ohm: Vec<Complex64> = spectrum.points.iter().map(|p| p.z_ohm).collect();
        let omega: Vec<f64> = spectrum.points.iter().map(|p| TAU * p.freq_hz).collect();
        let tau_range_s = 1.0 / (REACH * omega[points - 1])..=REACH / omega[0];
        let wanted = (MOST_PER_DECADE * (tau_range_s.end() / tau_range_s.start()).log10()).ceil()
            as usize
            + 1;
        // Two numbers a point; the restraint keeps the effective number of parameters well below
        // this one.
        let most = wanted
            .min((points + points / 2).saturating_sub(SERIES))
            .clamp(3, MOST_ELEMENTS);
        let ladder = Ladder::new(omega, tau_range_s, most);
        let leverage = Vec::with_capacity(points);
        let restraint_per_ohm =
            1.0 / (LARGEST * sizes_ohm(&spectrum.points).into_iter().fold(0.0, f64::max));
        Ok(Self {
            spectrum,
            noise,
            z_ohm,
            ladder,
            leverage,
            left_out: vec![false; points],
            restraint_per_ohm,
            most,
        })
    }

    /// Solves with rising order until µ is low and nothing is in doubt. Returns that order, and the
    /// one that µ alone would have chosen.
    fn choose_order(&mut self) -> (usize, Option<usize>) {
        let mut mu_order = None;
        for order in 3..=self.most {
            self.ladder.solve(order);
            if mu_order.is_none() && self.ladder.mu() <= MU_LIMIT {
                mu_order = Some(order);
            }
            if mu_order.is_some() && !self.alarm(DOUBTFUL_RATE) {
                return (order, mu_order);
            }
        }
        (self.most, mu_order)
    }

    /// Degrees of freedom that the ladder leaves, by the leverage of the last solution.
    fn dof(&self) -> f64 {
        let used = self.left_out.iter().filter(|out| !**out).count();
        2.0 * used as f64 - self.leverage.iter().map(|h| h.0 + h.2).sum::<f64>()
    }

    fn sum_p(&self) -> f64 {
        sum_tail(self.ladder.chi2(), self.dof(), self.noise.dof)
    }

    /// Something of the last solution is less probable than a rate of false alarms allows.
    fn alarm(&mut self, rate: f64) -> bool {
        self.ladder.leverage(&mut self.leverage);
        self.sum_p() < SUM_SHARE * rate
            || self.worst().1 < KramersKronig::point_limit(self.z_ohm.len(), rate)
    }

    /// The point that disagrees most, with its probability.
    fn worst(&self) -> (usize, f64) {
        let p = |k: &usize| {
            self.distance(*k)
                .map_or(1.0, |d2| pair_tail(d2, self.noise.dof))
        };
        (0..self.z_ohm.len())
            .filter(|k| !self.left_out[*k])
            .map(|k| (k, p(&k)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, 1.0))
    }

    /// Returns the squared distance of a point's residual in its own standard deviations; `None` if
    /// the ladder follows the point.
    fn distance(&self, point: usize) -> Option<f64> {
        let (re, im) = self.ladder.residual(point);
        distance(Complex64::new(re, im), self.left(point))
    }

    /// Covariance of a point's whitened residual: of the noise that the ladder does not follow.
    fn left(&self, point: usize) -> Covariance2 {
        let (h11, h12, h22) = self.leverage[point];
        Covariance2 {
            re_re: 1.0 - h11,
            re_im: -h12,
            im_im: 1.0 - h22,
        }
    }

    /// Solves with the highest order and without the chosen points; true if all others agree.
    fn leave_out(&mut self, chosen: impl Fn(usize) -> bool) -> bool {
        let mut whiten = self.noise.whitening();
        for (k, (out, w)) in self.left_out.iter_mut().zip(&mut whiten).enumerate() {
            *out = chosen(k);
            if *out {
                *w = Whitening::NONE;
            }
        }
        self.ladder
            .load(&self.z_ohm, &whiten, self.restraint_per_ohm);
        self.ladder.solve(self.most);
        !self.alarm(FALSE_ALARM_RATE)
    }

    /// Leaves out one point after the other, the worst first, until the others agree. Returns false
    /// if that needs more than a tenth of them, or three neighbours within the band, because then
    /// the fault is not in single points.
    fn leave_out_the_worst(&mut self) -> bool {
        let mut out = Vec::new();
        let agree = (0..(self.z_ohm.len() / 10).max(1)).any(|_| {
            out.push(self.worst().0);
            self.leave_out(|k| out.contains(&k))
        });
        agree
            && (self.is_end_left_out()
                || !self
                    .left_out
                    .windows(3)
                    .any(|run| run.iter().all(|out| *out)))
    }

    /// The points left out are those of one end of the band.
    fn is_end_left_out(&self) -> bool {
        let borders = self
            .left_out
            .windows(2)
            .filter(|pair| pair[0] != pair[1])
            .count();
        borders == 1
    }

    /// Leaves out one end of the band, as few points as possible and no more than half; false if
    /// that does not help.
    fn leave_out_an_end(&mut self) -> bool {
        let points = self.z_ohm.len();
        let most = (points / 2).min(points - FEWEST_POINTS);
        (1..=most)
            .any(|count| self.leave_out(|k| k < count) || self.leave_out(|k| k >= points - count))
    }

    fn passes_with_other_sign(&mut self) -> bool {
        let turn = |z: &mut Complex64| *z = z.conj();
        self.z_ohm.iter_mut().for_each(turn);
        let passes = self.leave_out(|_| false);
        self.z_ohm.iter_mut().for_each(turn);
        passes
    }

    /// The points left out are marked, the residuals those of the fit to all.
    fn part_of_band(mut self, mu_order: Option<usize>) -> KramersKronig {
        let end = self.left_out.clone();
        self.leave_out(|_| false);
        let order = self.most;
        let mut result = self.result(order, mu_order, KkOutcome::PartOfBand);
        result
            .points
            .iter_mut()
            .zip(end)
            .for_each(|(point, out)| point.left_out = out);
        result
    }

    fn result(
        mut self,
        order: usize,
        mu_order: Option<usize>,
        outcome: KkOutcome,
    ) -> KramersKronig {
        self.ladder.leverage(&mut self.leverage);
        let fitted_ohm = self.ladder.impedance(order);
        let points = (0..self.z_ohm.len())
            .map(|k| self.point(k, order, fitted_ohm[k]))
            .collect();
        KramersKronig {
            order,
            mu_order,
            mu: self.ladder.mu(),
            chi2: self.ladder.chi2(),
            dof: self.dof(),
            p: self.sum_p(),
            noise: self.noise.source,
            noise_percent: 100.0 * self.noise.relative(&self.spectrum.points),
            outcome,
            points,
            ladder: self.ladder,
            fitted_ohm,
        }
    }

    fn point(&self, k: usize, order: usize, fitted_ohm: Complex64) -> KkPoint {
        let residual = self.z_ohm[k] - fitted_ohm;
        let percent = 100.0 / self.z_ohm[k].norm();
        let covariance = self.noise.covariance[k];
        let left_out = self.left_out[k];
        let (share, distance) = if left_out {
            let w = self.noise.whitening()[k];
            let (p11, p12, p22) = self.ladder.prediction(k, order, w);
            let share = Covariance2 {
                re_re: 1.0 + p11,
                re_im: p12,
                im_im: 1.0 + p22,
            };
            let whitened = Complex64::new(w.a * residual.re, w.b * residual.re + w.c * residual.im);
            (share, distance(whitened, share))
        } else {
            (self.left(k), self.distance(k))
        };
        KkPoint {
            freq_hz: self.spectrum.points[k].freq_hz,
            re_percent: percent * residual.re,
            im_percent: percent * residual.im,
            sigma_re_percent: percent * (share.re_re.max(0.0) * covariance.re_re).sqrt(),
            sigma_im_percent: percent * (share.im_im.max(0.0) * covariance.im_im).sqrt(),
            sigmas: distance.unwrap_or(0.0).sqrt(),
            p: distance.map_or(1.0, |d2| pair_tail(d2, self.noise.dof)),
            left_out,
            tested: distance.is_some(),
        }
    }
}

/// Returns rᵀM⁻¹r of a residual with the covariance M; `None` if M shows that the ladder follows
/// the point.
fn distance(residual: Complex64, covariance: Covariance2) -> Option<f64> {
    let (re, im) = (residual.re, residual.im);
    let (m11, m12, m22) = (covariance.re_re, covariance.re_im, covariance.im_im);
    let determinant = m11 * m22 - m12 * m12;
    let greatest = m11.max(m22);
    let tested = greatest > 1.0 - UNTESTED && determinant > (1.0 - UNTESTED) * greatest;
    tested.then(|| (m22 * re * re - 2.0 * m12 * re * im + m11 * im * im) / determinant)
}
