//! One recommended order out of the rows of [`super::order`], with reasons in words.

use super::warning::HIGH_CHI2;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// Lower orders whose criterion is within this of the best cannot be distinguished from it: odds of
/// about one to four and a half.
const PLAUSIBLE: f64 = 3.0;
/// The same for higher orders, which must justify their additional branches.
const PLAUSIBLE_ABOVE: f64 = 1.5;
/// A cell left out counts as predicted as well as by the best order when the error is larger by no
/// more than this.
const AS_WELL: f64 = 1.05;
/// Below this probability a test speaks against an order.
const LEVEL: f64 = 0.01;

/// Evidence for and against one order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrderRow {
    /// Number of RC branches.
    pub rc: usize,
    /// Weighted sum of squares over all cells.
    pub chi2: f64,
    /// Numbers fitted, over all cells.
    pub numbers: usize,
    /// Parameters, over all cells.
    pub parameters: usize,
    /// Corrected Akaike criterion with unknown scale of the noise; the smallest is best.
    pub aicc: f64,
    /// Probability of the gain over the order below if the branch added were not there.
    pub f_test_p: Option<f64>,
    /// Mean lag-1 autocorrelation of the residuals over ln f.
    pub lag1: Option<f64>,
    /// Probability of such an autocorrelation in noise.
    pub whiteness_p: Option<f64>,
    /// Probability of such residuals if the model held and the noise were that of the repeats; none
    /// without repeats.
    pub lack_of_fit_p: Option<f64>,
    /// Root mean square of |ΔZ/Z| in predicting a cell from the others; none below three cells.
    pub left_out_cell: Option<f64>,
    /// Change of the mean square of that against the order below, with its standard error over
    /// cells.
    pub left_out_change: Option<(f64, f64)>,
    /// Parameters that are at a bound in at least half of the cells.
    #[serde(default)]
    pub held_by_bounds: Vec<String>,
    /// χ² per degree of freedom; none where the noise is not known.
    #[serde(default)]
    pub reduced_chi2: Option<f64>,
    /// True where a residual of at least one cell stands out of the others.
    #[serde(default)]
    pub stands_out: bool,
    /// Parameters that are at a bound or uncertain by more than 50 % in at least half of the cells.
    pub unidentified: Vec<String>,
}

/// Returns the recommended order, the orders that cannot be distinguished from the best, and the
/// reasons.
pub(super) fn judge(rows: &[OrderRow]) -> (usize, Vec<usize>, Vec<String>) {
    // A branch at a bound is not measured: such an order is eligible only if every order has one.
    let sound: Vec<&OrderRow> = rows
        .iter()
        .filter(|r| r.held_by_bounds.is_empty())
        .collect();
    let eligible: Vec<&OrderRow> = if sound.is_empty() {
        rows.iter().collect()
    } else {
        sound
    };
    let Some(best) = eligible.iter().min_by(|a, b| a.aicc.total_cmp(&b.aicc)) else {
        return (0, Vec::new(), Vec::new());
    };
    let tested = by_f_test(rows);
    let near = |r: &&OrderRow| {
        r.aicc
            <= best.aicc
                + if r.rc < best.rc {
                    PLAUSIBLE
                } else {
                    PLAUSIBLE_ABOVE
                }
            || r.rc == tested
    };
    let plausible: Vec<usize> = eligible
        .iter()
        .copied()
        .filter(near)
        .map(|r| r.rc)
        .collect();
    let usable = |r: &&OrderRow| plausible.contains(&r.rc) && r.unidentified.is_empty();
    let recommended = rows
        .iter()
        .filter(usable)
        .min_by(|a, b| a.aicc.total_cmp(&b.aicc))
        .unwrap_or(best);
    let mut reasons = vec![akaike(&eligible, best)];
    reasons.extend(
        rows.iter()
            .filter(|r| r.aicc < best.aicc && !r.held_by_bounds.is_empty())
            .map(at_a_bound),
    );
    reasons.push(f_test(rows, tested));
    reasons.extend(whiteness(rows));
    reasons.extend(lack_of_fit(rows));
    reasons.extend(left_out(rows));
    if !recommended.unidentified.is_empty() {
        reasons.push(format!(
            "{} RC are needed to describe the impedance, but the data do not fix {}: do not read \
            meaning into these",
            recommended.rc,
            recommended.unidentified.join(", ")
        ));
    } else if recommended.rc != best.rc {
        reasons.push(format!(
            "{} RC describe the data as well, and each cell fixes all their parameters; {} RC \
            would leave {} open",
            recommended.rc,
            best.rc,
            best.unidentified.join(", ")
        ));
    }
    if rows.last().is_some_and(|r| r.rc == best.rc && r.rc > 0) {
        reasons.push(format!(
            "{} RC is the highest order tried: more might still gain",
            best.rc
        ));
    }
    if plausible.len() > 1 {
        let list = plausible
            .iter()
            .map(usize::to_string)
            .collect::<Vec<_>>()
            .join(", ");
        reasons.push(format!("cannot tell: {list} RC are equally well supported"));
    }
    (recommended.rc, plausible, reasons)
}

/// Returns the order from which no further branch is significant.
fn by_f_test(rows: &[OrderRow]) -> usize {
    rows.iter()
        .filter(|r| r.f_test_p.is_some_and(|p| p < LEVEL))
        .map(|r| r.rc)
        .max()
        .or(rows.first().map(|r| r.rc))
        .unwrap_or(0)
}

/// Returns a sentence on an order that is refused although its criterion is smaller.
fn at_a_bound(r: &OrderRow) -> String {
    let stand = if r.held_by_bounds.len() > 1 {
        "stand"
    } else {
        "stands"
    };
    format!(
        "{} RC is not taken although its AICc is less: {} {stand} at a bound, so that a branch \
        imitates something else",
        r.rc,
        r.held_by_bounds.join(", ")
    )
}

fn akaike(rows: &[&OrderRow], best: &OrderRow) -> String {
    let next = rows
        .iter()
        .filter(|r| r.rc != best.rc)
        .min_by(|a, b| a.aicc.total_cmp(&b.aicc));
    match next {
        Some(next) if next.aicc.is_finite() => {
            format!(
                "AICc is least for {} RC; the next best, {} RC, is {:.1} above",
                best.rc,
                next.rc,
                next.aicc - best.aicc
            )
        }
        _ => format!("AICc is least for {} RC", best.rc),
    }
}

fn f_test(rows: &[OrderRow], tested: usize) -> String {
    let next = rows
        .iter()
        .find(|r| r.rc == tested + 1)
        .and_then(|r| r.f_test_p);
    let own = rows
        .iter()
        .find(|r| r.rc == tested)
        .and_then(|r| r.f_test_p);
    let own = own.map_or(String::new(), |p| {
        format!(
            "the step to {tested} RC is significant (p = {}), ",
            small(p)
        )
    });
    match next {
        Some(p) => format!(
            "F-test: {own}the step to {} RC is not (p = {})",
            tested + 1,
            small(p)
        ),
        None => format!("F-test: {own}no higher order was tried"),
    }
}

/// Returns a sentence if the residuals are noise: neighbours are uncorrelated *and* their size is
/// that of the noise, because one wrong point leaves no waves either.
fn whiteness(rows: &[OrderRow]) -> Option<String> {
    let of_size =
        |r: &&OrderRow| !r.stands_out && r.reduced_chi2.is_none_or(|chi2| chi2 <= HIGH_CHI2);
    let white = || {
        rows.iter()
            .filter(|r| r.whiteness_p.is_some_and(|p| p >= LEVEL))
    };
    match white().find(of_size) {
        None if white().next().is_some() => white().next_back().map(too_large),
        Some(r) => Some(format!(
            "residuals look like noise over ln f from {} RC on (p = {})",
            r.rc,
            small(r.whiteness_p?)
        )),
        None if rows.iter().any(|r| r.whiteness_p.is_some()) => Some(
            "residuals keep waves over ln f at every order: something other than RC branches, or \
            noise common to neighbours"
                .to_owned(),
        ),
        None => None,
    }
}

/// Returns a sentence on residuals without waves that are too large for noise.
fn too_large(r: &OrderRow) -> String {
    let size = match r.reduced_chi2.filter(|chi2| *chi2 > HIGH_CHI2) {
        Some(chi2) => format!(
            "are {:.3} times the stated uncertainty (reduced χ² {chi2:.3})",
            chi2.sqrt()
        ),
        None => "hold one that stands out of the others".to_owned(),
    };
    format!(
        "residuals keep no waves over ln f, but with {} RC they {size}: this is not noise; look \
        for points that are off and for a σ that is stated too small",
        r.rc
    )
}

fn lack_of_fit(rows: &[OrderRow]) -> Option<String> {
    let adequate = rows
        .iter()
        .find(|r| r.lack_of_fit_p.is_some_and(|p| p >= LEVEL));
    match adequate {
        Some(r) => Some(format!(
            "from {} RC on the residuals are no larger than the scatter of repeats explains",
            r.rc
        )),
        None if rows.iter().any(|r| r.lack_of_fit_p.is_some()) => Some(
            "at every order the residuals are larger than the scatter of repeats explains"
                .to_owned(),
        ),
        None => None,
    }
}

/// The smallest order that predicts a cell left out as well as the best does.
pub(super) fn for_other_cells(rows: &[OrderRow]) -> Option<&OrderRow> {
    let least = rows
        .iter()
        .filter_map(|r| r.left_out_cell)
        .fold(f64::INFINITY, f64::min);
    rows.iter()
        .find(|r| r.left_out_cell.is_some_and(|e| e <= AS_WELL * least))
}

fn left_out(rows: &[OrderRow]) -> Option<String> {
    let enough = for_other_cells(rows)?;
    let percent = |r: &OrderRow| r.left_out_cell.map(|e| 100.0 * e);
    let best = rows
        .iter()
        .filter(|r| r.left_out_cell.is_some())
        .min_by(|a, b| {
            a.left_out_cell
                .partial_cmp(&b.left_out_cell)
                .unwrap_or(Ordering::Equal)
        })?;
    Some(format!(
        "{} RC of the other cells predict a cell left out within {:.2} % rms, the best order \
        within {:.2} %: for a cell that was not measured {} RC are enough",
        enough.rc,
        percent(enough)?,
        percent(best)?,
        enough.rc
    ))
}

fn small(p: f64) -> String {
    if p < 1e-4 {
        format!("{p:.0e}")
    } else {
        format!("{p:.3}")
    }
}
