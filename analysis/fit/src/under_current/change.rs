//! The comparison itself.

use analysis_numeric::stats::FDistribution;
use analysis_signal::spectrum::{SourcedSpectrum, Spectrum};
use num_complex::Complex64;

use super::{
    base::Base,
    options::{UnderCurrentError, UnderCurrentOptions},
    result::{BranchChange, Compared, CurrentChange, PairChange, PointChange, UnderCurrent},
    solve::Solution,
    trend::trend,
    words::opposite,
};
use crate::fit::{CellSweeps, Components, components};

/// Relative uncertainty above which a branch counts as not determined.
const UNDETERMINED: f64 = 0.2;
/// Frequencies beyond the number of resistances that a sweep needs.
const SPARE: usize = 3;

/// A sweep under a direct current on its way to a result.
struct Measured<'a> {
    bias_a: f64,
    source: &'a SourcedSpectrum,
    differences: Vec<Option<Complex64>>,
    /// Number of lowest frequencies that are left out.
    low: usize,
    solution: Solution,
}

/// Compares sweeps under a direct current with sweeps at rest.
///
/// # Errors
/// [`UnderCurrentError`] if there is nothing to compare, or too little to know how certain a change is.
pub fn under_current(
    rest: &[SourcedSpectrum],
    biased: &[SourcedSpectrum],
    options: &UnderCurrentOptions,
) -> Result<UnderCurrent, UnderCurrentError> {
    let mut sources: Vec<(f64, &SourcedSpectrum)> = biased
        .iter()
        .filter_map(|source| Some((source.origin.bias_a.filter(|b| *b != 0.0)?, source)))
        .collect();
    if sources.is_empty() {
        return Err(UnderCurrentError::NoBias);
    }
    sources.sort_by(|a, b| a.0.total_cmp(&b.0));
    let cells = CellSweeps::sort(rest);
    for (_, source) in &sources {
        if own_cell(&cells, source).is_none() && cells.len() < 2 {
            return Err(UnderCurrentError::Cells {
                name: source.spectrum.name.clone(),
                cells: cells.len(),
            });
        }
    }
    let base = Base::new(&cells, options)?;
    let mut changes = Vec::new();
    let mut measured = Vec::new();
    for (bias_a, source) in sources {
        let differences = base.differences(&source.spectrum);
        let (low, flagged) = trend(&base, &differences);
        let solution = solution(&base, &differences, low, &source.spectrum)?;
        let one = Measured {
            bias_a,
            source,
            differences,
            low,
            solution,
        };
        let mut change = change(&base, &one);
        change.flagged = flagged;
        changes.push(change);
        measured.push(one);
    }
    adjust(changes.iter_mut().flat_map(|change| &mut change.branches));
    let mut pairs = if options.same_cell {
        pairs(&base, &measured)
    } else {
        Vec::new()
    };
    adjust(pairs.iter_mut().flat_map(|pair| &mut pair.branches));
    Ok(UnderCurrent {
        remarks: opposite(&changes),
        cells: cells.len(),
        sweeps: rest.len(),
        chi2_at_rest: base.chi2,
        model: base.erm,
        changes,
        pairs,
    })
}

/// Returns the cell at rest that a sweep names, if it was measured there more than once.
fn own_cell<'a>(
    cells: &'a [CellSweeps],
    source: &SourcedSpectrum,
) -> Option<(usize, &'a CellSweeps)> {
    let name = format!("cell {}", source.cell()?);
    let is_own =
        |(_, cell): &(usize, &CellSweeps)| cell.named && cell.cell == name && cell.sweeps.len() > 1;
    cells.iter().enumerate().find(is_own)
}

fn solution(
    base: &Base<'_>,
    differences: &[Option<Complex64>],
    low: usize,
    spectrum: &Spectrum,
) -> Result<Solution, UnderCurrentError> {
    let found = differences.iter().skip(low).flatten().count();
    let expected = base.resistances() + SPARE + usize::from(low > 0);
    let solved = (found >= expected)
        .then(|| base.solve(differences, low, low > 0))
        .flatten();
    solved.ok_or_else(|| UnderCurrentError::Frequencies {
        name: spectrum.name.clone(),
        expected,
        found,
    })
}

/// Compares one sweep with its own cell, or with all cells.
fn change(base: &Base<'_>, one: &Measured<'_>) -> CurrentChange {
    let at_rest = base.at_rest(one.low);
    let own = own_cell(base.cells, one.source);
    let branches = at_rest.iter().enumerate().filter_map(|(k, cells)| {
        let spread = components(cells)?;
        let share = one.solution.shares[k];
        let own_sigma = sweep_sigma(&one.solution, k, &spread);
        let (share, variance, freedom) = match own {
            Some((index, _)) => {
                let repeats = &cells[index];
                let n = repeats.len() as f64;
                let mean = repeats.iter().sum::<f64>() / n;
                let within = spread.within.unwrap_or(0.0).powi(2);
                (
                    share - mean,
                    own_sigma.powi(2) + within / n,
                    spread.freedom.1,
                )
            }
            None => {
                let number = 1.0 + spread.freedom.0 as f64;
                let between = spread.between.unwrap_or(0.0).powi(2) * (1.0 + 1.0 / number);
                (
                    share - spread.mean,
                    own_sigma.powi(2) + between,
                    spread.freedom.0,
                )
            }
        };
        Some(branch(k, share, variance.sqrt(), freedom, own_sigma))
    });
    CurrentChange {
        name: one.source.spectrum.name.clone(),
        bias_a: one.bias_a,
        compared: own.map_or(
            Compared::AllCells {
                cells: base.cells.len(),
            },
            |(_, cell)| Compared::OwnCell {
                cell: cell.cell.clone(),
            },
        ),
        branches: branches.collect(),
        chi2: one.solution.chi2,
        flagged: Vec::new(),
        left_out_hz: left_out_hz(base, &one.source.spectrum),
        points: points(base, one),
    }
}

/// Returns the uncertainty of a change by one sweep: its own noise, or the scatter of repeats if that is
/// more.
fn sweep_sigma(solution: &Solution, index: usize, spread: &Components) -> f64 {
    solution.sigma(index).max(spread.within.unwrap_or(0.0))
}

fn branch(index: usize, share: f64, sigma: f64, freedom: usize, own_sigma: f64) -> BranchChange {
    let student = FDistribution {
        above: 1.0,
        below: freedom as f64,
    };
    let p = student.tail((share / sigma).powi(2));
    BranchChange {
        name: if index == 0 {
            "R".to_owned()
        } else {
            format!("R{index}")
        },
        share,
        sigma,
        freedom,
        p,
        p_adjusted: p,
        measured: own_sigma <= UNDETERMINED,
    }
}

/// Adjusts the probabilities for the number of changes that are tested (Holm, 1979).
fn adjust<'a>(branches: impl Iterator<Item = &'a mut BranchChange>) {
    let mut tested: Vec<&mut BranchChange> = branches.filter(|b| b.measured).collect();
    tested.sort_by(|a, b| a.p.total_cmp(&b.p));
    let count = tested.len();
    let mut least = 0.0_f64;
    for (rank, branch) in tested.into_iter().enumerate() {
        least = least.max(((count - rank) as f64 * branch.p).min(1.0));
        branch.p_adjusted = least;
    }
}

/// Compares each sweep with each later one, as sweeps of one cell.
fn pairs(base: &Base<'_>, measured: &[Measured<'_>]) -> Vec<PairChange> {
    let pair = |from: &Measured<'_>, to: &Measured<'_>| {
        let low = from.low.max(to.low);
        let at_rest = base.at_rest(low);
        let solve = |one: &Measured<'_>| base.solve(&one.differences, low, low > 0);
        let (a, b) = (solve(from)?, solve(to)?);
        let branches = at_rest.iter().enumerate().filter_map(|(k, cells)| {
            let spread = components(cells)?;
            let (sa, sb) = (sweep_sigma(&a, k, &spread), sweep_sigma(&b, k, &spread));
            let share = b.shares[k] - a.shares[k];
            Some(branch(k, share, sa.hypot(sb), spread.freedom.1, sa.max(sb)))
        });
        Some(PairChange {
            from: from.source.spectrum.name.clone(),
            to: to.source.spectrum.name.clone(),
            branches: branches.collect(),
        })
    };
    let later = |index: usize| measured.iter().skip(index + 1);
    let all = measured.iter().enumerate();
    all.flat_map(|(index, from)| later(index).filter_map(move |to| pair(from, to)))
        .collect()
}

fn left_out_hz(base: &Base<'_>, spectrum: &Spectrum) -> Vec<f64> {
    let known = |freq_hz: f64| {
        let near = |at: f64| (freq_hz - at).abs() <= 1e-6 * at;
        base.spread.iter().any(|f| near(f.freq_hz))
    };
    let frequencies = spectrum.points.iter().map(|p| p.freq_hz);
    frequencies.filter(|f| !known(*f)).collect()
}

fn points(base: &Base<'_>, one: &Measured<'_>) -> Vec<PointChange> {
    let of = |(index, difference): (usize, &Option<Complex64>)| {
        let (at, z) = (&base.spread[index], (*difference)?);
        let size = base.mean_ohm(index).norm();
        let sigma = |c: &Components| c.between.unwrap_or(0.0).hypot(c.within.unwrap_or(0.0)) / size;
        Some(PointChange {
            freq_hz: at.freq_hz,
            re: z.re / size,
            im: z.im / size,
            sigma_re: sigma(&at.re_ohm),
            sigma_im: sigma(&at.im_ohm),
            kept: index >= one.low,
        })
    };
    one.differences.iter().enumerate().filter_map(of).collect()
}
