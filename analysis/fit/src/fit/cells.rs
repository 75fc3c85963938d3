//! Repeated sweeps of one or more cells, and their spread frequency by frequency: between cells and
//! within them, by a one-way analysis of variance with random effects, cells with unequal numbers
//! of sweeps allowed (Searle, Casella and McCulloch, *Variance Components*, 1992, section 3.6).

use analysis_numeric::{Covariance2, stats::FDistribution};
use analysis_signal::spectrum::{ImpedancePoint, SharedError, SourcedSpectrum, Spectrum};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// The sweeps of one cell.
#[derive(Debug, Clone, PartialEq)]
pub struct CellSweeps {
    /// Name of the cell in the file.
    pub cell: String,
    /// True if a file or a name identifies the cell. Otherwise the sweep counts as a cell of its
    /// own.
    pub named: bool,
    /// Its sweeps.
    pub sweeps: Vec<Spectrum>,
}

impl CellSweeps {
    /// Groups sweeps by the cell that their files or names identify; a sweep without one is a cell
    /// of its own.
    pub fn sort(sourced: &[SourcedSpectrum]) -> Vec<Self> {
        let mut cells: Vec<(Option<&str>, Self)> = Vec::new();
        for one in sourced {
            let (key, spectrum) = (one.cell(), &one.spectrum);
            match cells.iter_mut().find(|(k, _)| k.is_some() && *k == key) {
                Some((_, cell)) => cell.sweeps.push(spectrum.clone()),
                None => {
                    let cell = key.map_or_else(|| spectrum.name.clone(), |k| format!("cell {k}"));
                    cells.push((
                        key,
                        Self {
                            cell,
                            named: key.is_some(),
                            sweeps: vec![spectrum.clone()],
                        },
                    ));
                }
            }
        }
        cells.into_iter().map(|(_, cell)| cell).collect()
    }
}

/// One quantity measured several times on several cells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Components {
    /// Mean of the cells' means, each cell counting once.
    pub mean: f64,
    /// Standard uncertainty of that mean as the mean of all such cells; `None` for a single cell.
    pub sigma_mean: Option<f64>,
    /// Standard deviation between cells without the share of the repeats; zero if the repeats
    /// explain all of it. `None` for a single cell.
    pub between: Option<f64>,
    /// 95 % interval of the standard deviation between cells (Williams, 1962), for the mean number
    /// of repeats.
    pub between_95: Option<(f64, f64)>,
    /// Standard deviation of repeats of one cell; none without repeats.
    pub within: Option<f64>,
    /// 95 % interval of the standard deviation within cells.
    pub within_95: Option<(f64, f64)>,
    /// Degrees of freedom between and within.
    pub freedom: (usize, usize),
}

/// Separates the spread between groups from that within; `None` without any value.
pub fn components(groups: &[Vec<f64>]) -> Option<Components> {
    let groups: Vec<&Vec<f64>> = groups.iter().filter(|g| !g.is_empty()).collect();
    let (a, n) = (groups.len(), groups.iter().map(|g| g.len()).sum::<usize>());
    if a == 0 {
        return None;
    }
    let mean_of = |g: &[f64]| g.iter().sum::<f64>() / g.len() as f64;
    let means: Vec<f64> = groups.iter().map(|g| mean_of(g)).collect();
    let mean = mean_of(&means);
    let (fb, fw) = (a - 1, n - a);
    let inside: f64 = groups
        .iter()
        .zip(&means)
        .map(|(g, m)| g.iter().map(|v| (v - m).powi(2)).sum::<f64>())
        .sum();
    let grand = groups
        .iter()
        .zip(&means)
        .map(|(g, m)| g.len() as f64 * m)
        .sum::<f64>()
        / n as f64;
    let across: f64 = groups
        .iter()
        .zip(&means)
        .map(|(g, m)| g.len() as f64 * (m - grand).powi(2))
        .sum();
    let ms_within = (fw > 0).then(|| inside / fw as f64);
    let ms_between = (fb > 0).then(|| across / fb as f64);
    let squares: f64 = groups.iter().map(|g| (g.len() * g.len()) as f64).sum();
    let n0 = if fb > 0 {
        (n as f64 - squares / n as f64) / fb as f64
    } else {
        n as f64
    };
    let spread_of_means =
        (fb > 0).then(|| means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / fb as f64);
    let root = |v: f64| v.max(0.0).sqrt();
    let square = |value: f64, freedom: usize| MeanSquare { value, freedom };
    Some(Components {
        mean,
        sigma_mean: spread_of_means.map(|v| root(v / a as f64)),
        between: ms_between.map(|b| root((b - ms_within.unwrap_or(0.0)) / n0)),
        between_95: ms_between
            .zip(ms_within)
            .map(|(b, w)| between_interval(square(b, fb), square(w, fw), n0)),
        within: ms_within.map(root),
        within_95: ms_within.map(|w| {
            (
                root(w / chi2_over_freedom(0.975, fw)),
                root(w / chi2_over_freedom(0.025, fw)),
            )
        }),
        freedom: (fb, fw),
    })
}

/// A mean square of the analysis of variance.
#[derive(Clone, Copy)]
struct MeanSquare {
    /// In the square of the unit of the values.
    value: f64,
    /// Degrees of freedom.
    freedom: usize,
}

/// Returns the interval of Williams and Tukey for the standard deviation between cells, from the
/// mean squares between and within them, with at least the requested level.
fn between_interval(between: MeanSquare, within: MeanSquare, n0: f64) -> (f64, f64) {
    let (b, fb, w) = (between.value, between.freedom, within.value);
    let f = |p: f64| {
        f_quantile(
            p,
            FDistribution {
                above: fb as f64,
                below: within.freedom as f64,
            },
        )
    };
    let lower = (b / chi2_over_freedom(0.975, fb)) * (1.0 - w / b * f(0.975)) / n0;
    let upper = (b / chi2_over_freedom(0.025, fb)) * (1.0 - w / b * f(0.025)) / n0;
    (lower.max(0.0).sqrt(), upper.max(0.0).sqrt())
}

/// χ² quantile over its degrees of freedom: an F quantile of infinitely many others.
fn chi2_over_freedom(p: f64, freedom: usize) -> f64 {
    f_quantile(
        p,
        FDistribution {
            above: freedom as f64,
            below: 1e8,
        },
    )
}

fn f_quantile(p: f64, distribution: FDistribution) -> f64 {
    let (mut lo, mut hi) = (1e-9f64, 1e9f64);
    for _ in 0..200 {
        let mid = (lo * hi).sqrt();
        if 1.0 - distribution.tail(mid) < p {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    (lo * hi).sqrt()
}

/// Spread of the impedance at one frequency.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrequencySpread {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Real part, Ω.
    pub re_ohm: Components,
    /// Imaginary part, Ω.
    pub im_ohm: Components,
}

/// Spread at every frequency that all sweeps have, rising.
pub fn frequency_spread(cells: &[CellSweeps]) -> Vec<FrequencySpread> {
    let Some(first) = cells.iter().flat_map(|c| &c.sweeps).next() else {
        return Vec::new();
    };
    let at = |s: &Spectrum, f: f64| {
        s.points
            .iter()
            .find(|p| (p.freq_hz - f).abs() <= 1e-9 * f)
            .map(|p| p.z_ohm)
    };
    let of = |f: f64| -> Option<FrequencySpread> {
        let values: Vec<Vec<Complex64>> = cells
            .iter()
            .map(|c| c.sweeps.iter().map(|s| at(s, f)).collect())
            .collect::<Option<_>>()?;
        let part = |part: fn(&Complex64) -> f64| {
            components(
                &values
                    .iter()
                    .map(|g| g.iter().map(part).collect())
                    .collect::<Vec<_>>(),
            )
        };
        Some(FrequencySpread {
            freq_hz: f,
            re_ohm: part(|z| z.re)?,
            im_ohm: part(|z| z.im)?,
        })
    };
    first.points.iter().filter_map(|p| of(p.freq_hz)).collect()
}

/// Returns one spectrum per cell: the mean of its sweeps, its covariance from the repeats of all
/// cells. If frequencies differ from sweep to sweep or nothing was repeated, a cell's points are
/// passed on with their own uncertainties.
pub(super) fn cell_means(cells: &[CellSweeps]) -> Vec<Spectrum> {
    let spread = frequency_spread(cells);
    let relative = |part: fn(&FrequencySpread) -> &Components| smooth_relative(&spread, part);
    let (re, im) = (relative(|f| &f.re_ohm), relative(|f| &f.im_ohm));
    let mean = |cell: &CellSweeps| -> Spectrum {
        let n = cell.sweeps.len() as f64;
        if cell.sweeps.len() == 1 && cells.iter().all(|c| c.sweeps.len() == 1) || spread.is_empty()
        {
            if let [only] = cell.sweeps.as_slice() {
                return Spectrum {
                    name: cell.cell.clone(),
                    ..only.clone()
                };
            }
            let points = cell.sweeps.iter().flat_map(|s| s.points.clone()).collect();
            return Spectrum {
                name: cell.cell.clone(),
                points,
                ..Spectrum::default()
            };
        }
        let point = |(k, f): (usize, &FrequencySpread)| {
            let here = cell
                .sweeps
                .iter()
                .flat_map(|s| &s.points)
                .filter(|p| (p.freq_hz - f.freq_hz).abs() <= 1e-9 * f.freq_hz);
            let z_ohm = here.map(|p| p.z_ohm).sum::<Complex64>() / n;
            let variance = |s: &[f64]| (s[k] * z_ohm.norm()).powi(2) / n;
            let covariance = Covariance2 {
                re_re: variance(&re),
                re_im: 0.0,
                im_im: variance(&im),
            };
            ImpedancePoint {
                freq_hz: f.freq_hz,
                z_ohm,
                covariance,
                amplitude_a: f64::NAN,
            }
        };
        with_shared(
            Spectrum::new(
                cell.cell.clone(),
                spread.iter().enumerate().map(point).collect(),
            ),
            &cell.sweeps,
        )
    };
    cells.iter().map(mean).collect()
}

/// The mean of sweeps with the errors that all of them share: repeats do not make these smaller.
fn with_shared(mut mean: Spectrum, sweeps: &[Spectrum]) -> Spectrum {
    let Some(first) = sweeps.first() else {
        return mean;
    };
    mean.less = first.less;
    let at = |sweep: &Spectrum, error: &SharedError, freq_hz: f64| {
        let index = sweep
            .points
            .iter()
            .position(|p| (p.freq_hz - freq_hz).abs() <= 1e-9 * freq_hz)?;
        sweep
            .shared
            .iter()
            .find(|other| other.name == error.name)?
            .at_ohm
            .get(index)
            .copied()
    };
    for error in &first.shared {
        let direction = |freq_hz: f64| -> Option<Complex64> {
            let all: Vec<Complex64> = sweeps
                .iter()
                .map(|sweep| at(sweep, error, freq_hz))
                .collect::<Option<_>>()?;
            Some(all.iter().sum::<Complex64>() / all.len() as f64)
        };
        let found: Option<Vec<Complex64>> =
            mean.points.iter().map(|p| direction(p.freq_hz)).collect();
        let Some(at_ohm) = found else { continue };
        for (point, direction) in mean.points.iter_mut().zip(&at_ohm) {
            point.covariance = point.covariance + Covariance2::along(*direction);
        }
        mean.shared.push(SharedError {
            name: error.name.clone(),
            at_ohm,
        });
    }
    mean
}

/// Returns the standard deviation of repeats over |Z|, averaged over neighbouring frequencies,
/// because a variance with few degrees of freedom is a poor weight.
pub(crate) fn smooth_relative(
    spread: &[FrequencySpread],
    part: fn(&FrequencySpread) -> &Components,
) -> Vec<f64> {
    const REACH: usize = 2;
    let square = |f: &FrequencySpread| {
        (part(f).within.unwrap_or(0.0) / f.re_ohm.mean.hypot(f.im_ohm.mean)).powi(2)
    };
    let of = |k: usize| {
        let near = &spread[k.saturating_sub(REACH)..(k + REACH + 1).min(spread.len())];
        (near.iter().map(square).sum::<f64>() / near.len() as f64).sqrt()
    };
    (0..spread.len()).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    #[test]
    fn file_and_name_tell_the_cell() {
        use analysis_signal::spectrum::Origin;
        let one = |name: &str, cell: Option<&str>| SourcedSpectrum {
            origin: Origin {
                cell: cell.map(str::to_owned),
                ..Origin::default()
            },
            spectrum: Spectrum {
                name: name.to_owned(),
                points: Vec::new(),
                ..Spectrum::default()
            },
            flagged: Vec::new(),
        };
        let names = [
            "cell0_0", "cell10_0", "cell0_1", "cellm2_0", "cellm2_1", "cell7", "lot_1", "lot_2",
            "cell_1", "cell0_x",
        ];
        let mut all: Vec<SourcedSpectrum> = names.iter().map(|name| one(name, None)).collect();
        all.extend([one("table", Some("0")), one("cell10_4", Some("9"))]);
        let met: Vec<(String, bool, usize)> = CellSweeps::sort(&all)
            .into_iter()
            .map(|c| (c.cell, c.named, c.sweeps.len()))
            .collect();
        let own = |name: &str| (name.to_owned(), false, 1);
        let mut expected = vec![
            ("cell 0".to_owned(), true, 3),
            ("cell 10".to_owned(), true, 1),
        ];
        expected.extend(
            [
                "cellm2_0", "cellm2_1", "cell7", "lot_1", "lot_2", "cell_1", "cell0_x",
            ]
            .map(own),
        );
        expected.push(("cell 9".to_owned(), true, 1));
        assert_eq!(met, expected);
    }

    #[test]
    fn a_small_table_by_hand() {
        // Means 2 and 6 (grand 4): between 2·4 + 2·4 = 16 over 1; within 2 + 2 = 4 over 2; n0 = 2:
        // (16 − 2)/2 = 7.
        let met = components(&[vec![1.0, 3.0], vec![5.0, 7.0]]).unwrap();
        assert_eq!((met.mean, met.freedom), (4.0, (1, 2)));
        assert!(
            (met.between.unwrap() - 7f64.sqrt()).abs() < 1e-12
                && (met.within.unwrap() - 2f64.sqrt()).abs() < 1e-12
        );
        assert!((met.sigma_mean.unwrap() - 2.0).abs() < 1e-12);
        let lone = components(&[vec![1.0]]).unwrap();
        assert_eq!(
            (lone.between, lone.within, lone.sigma_mean),
            (None, None, None)
        );
        assert!(components(&[]).is_none());
        assert_eq!(
            components(&[vec![1.0, 3.0], vec![2.0, 2.0]])
                .unwrap()
                .between,
            Some(0.0)
        );
    }

    #[test]
    fn both_spreads_come_back_inside_their_intervals() {
        // Five to seven cells with two to six sweeps each, unbalanced; the truth must lie in 95 %
        // intervals in 92 to 99 % of 400 tables.
        let (between, within, runs) = (0.8, 0.25, 400);
        let mut rng = Rng::new(4);
        let (mut hit_b, mut hit_w, mut mean_square) = (0, 0, 0.0);
        for _ in 0..runs {
            let groups: Vec<Vec<f64>> = (0..5 + rng.below(3))
                .map(|_| {
                    let cell = 10.0 + between * rng.normal();
                    (0..2 + rng.below(5))
                        .map(|_| cell + within * rng.normal())
                        .collect()
                })
                .collect();
            let met = components(&groups).unwrap();
            let inside = |(lo, hi): (f64, f64), truth: f64| i32::from(lo <= truth && truth <= hi);
            hit_b += inside(met.between_95.unwrap(), between);
            hit_w += inside(met.within_95.unwrap(), within);
            mean_square += met.between.unwrap().powi(2) / f64::from(runs);
        }
        for (name, hit) in [("between", hit_b), ("within", hit_w)] {
            assert!((368..=396).contains(&hit), "{name}: {hit} of {runs}");
        }
        assert!(
            (mean_square / between.powi(2) - 1.0).abs() < 0.15,
            "{mean_square}"
        );
    }
}
