//! Against closed forms: in balanced tables the estimates of REML are those of the analysis of
//! variance, where those are not negative.

use super::*;
use crate::Rng;

/// Cells that are each measured on every bench, so often.
struct Crossed {
    values: Vec<f64>,
    cells: Vec<usize>,
    benches: Vec<usize>,
}

fn crossed(cells: usize, benches: usize, sds: [f64; 3], seed: u64) -> Crossed {
    let mut rng = Rng::new(seed);
    let of_cell: Vec<f64> = (0..cells).map(|_| sds[0] * rng.normal()).collect();
    let of_bench: Vec<f64> = (0..benches).map(|_| sds[1] * rng.normal()).collect();
    let mut made = Crossed {
        values: Vec::new(),
        cells: Vec::new(),
        benches: Vec::new(),
    };
    for (cell, shared) in of_cell.iter().enumerate() {
        for (bench, offset) in of_bench.iter().enumerate() {
            made.values
                .push(10.0 + shared + offset + sds[2] * rng.normal());
            made.cells.push(cell);
            made.benches.push(bench);
        }
    }
    made
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    values.sum::<f64>() / n
}

fn squares(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    values.iter().map(|x| (x - centre).powi(2)).sum()
}

impl Crossed {
    fn fit(&self) -> Mixed {
        self.by(fit_mixed)
    }

    fn by(&self, fit: impl Fn(&Grouped<'_>) -> Result<Mixed, MixedError>) -> Mixed {
        let factors = [
            Factor {
                name: "cell",
                levels: &self.cells,
            },
            Factor {
                name: "bench",
                levels: &self.benches,
            },
        ];
        let grouped = Grouped {
            values: &self.values,
            variances: &[],
            covariates: &[],
            factors: &factors,
        };
        fit(&grouped).unwrap()
    }

    /// Returns the standard deviations by the analysis of variance: cell, bench, residual.
    fn by_analysis_of_variance(&self, cells: usize, benches: usize) -> [f64; 3] {
        let of = |levels: &[usize], count: usize| -> Vec<f64> {
            (0..count)
                .map(|level| {
                    let rows = levels.iter().zip(&self.values);
                    mean(rows.filter(|(l, _)| **l == level).map(|(_, y)| *y))
                })
                .collect()
        };
        let (c, b) = (cells as f64, benches as f64);
        let between_cells = b * squares(&of(&self.cells, cells));
        let between_benches = c * squares(&of(&self.benches, benches));
        let rest = squares(&self.values) - between_cells - between_benches;
        let residual = rest / ((c - 1.0) * (b - 1.0));
        [
            ((between_cells / (c - 1.0) - residual) / b).max(0.0).sqrt(),
            ((between_benches / (b - 1.0) - residual) / c)
                .max(0.0)
                .sqrt(),
            residual.sqrt(),
        ]
    }
}

#[test]
fn a_balanced_table_gives_the_analysis_of_variance() {
    for seed in 1..6 {
        let table = crossed(12, 5, [1.0, 0.4, 0.2], seed);
        let fit = table.fit();
        let expected = table.by_analysis_of_variance(12, 5);
        for (component, expected) in fit.components.iter().zip(expected) {
            assert!(
                (component.sd - expected).abs() < 1e-5,
                "{seed} {component:?} {expected}"
            );
            assert!(component.low < component.sd && component.sd < component.high);
        }
        let centre = mean(table.values.iter().copied());
        assert!((fit.fixed[0].value - centre).abs() < 1e-9);
    }
}

#[test]
fn an_estimate_is_the_fit_without_intervals() {
    let crossed = crossed(6, 4, [0.5, 0.3, 0.2], 11);
    let (fit, estimate) = (crossed.fit(), crossed.by(estimate_mixed));
    for (one, other) in fit.components.iter().zip(&estimate.components) {
        assert_eq!(one.sd, other.sd);
        assert!(one.low <= one.sd && other.low.is_nan() && other.high.is_nan());
    }
    assert_eq!(
        (&fit.fixed, &fit.levels),
        (&estimate.fixed, &estimate.levels)
    );
}

#[test]
fn a_component_that_is_not_there_is_zero_and_its_interval_begins_there() {
    let found: Vec<Mixed> = (1..9)
        .map(|seed| crossed(20, 4, [1.0, 0.0, 0.3], seed).fit())
        .collect();
    let benches = found.iter().map(|fit| &fit.components[1]);
    assert!(benches.clone().all(|bench| bench.low == 0.0));
    assert!(benches.clone().any(|bench| bench.sd < 1e-3));
    assert!(benches.clone().all(|bench| bench.high < 0.6));
}

#[test]
fn a_nested_unbalanced_table_with_a_covariate_finds_what_made_it() {
    let (mut values, mut covariate) = (Vec::new(), Vec::new());
    let (mut batches, mut cells) = (Vec::new(), Vec::new());
    let mut rng = Rng::new(5);
    for batch in 0..60 {
        let of_batch = 0.8 * rng.normal();
        for _ in 0..3 + batch % 4 {
            let cell = cells.last().map_or(0, |last| last + 1);
            let of_cell = 0.5 * rng.normal();
            for _ in 0..2 + cell % 3 {
                let x = 25.0 + 5.0 * rng.normal();
                values.push(3.0 - 0.1 * x + of_batch + of_cell + 0.2 * rng.normal());
                covariate.push(x);
                batches.push(batch);
                cells.push(cell);
            }
        }
    }
    let factors = [
        Factor {
            name: "batch",
            levels: &batches,
        },
        Factor {
            name: "cell",
            levels: &cells,
        },
    ];
    let grouped = Grouped {
        values: &values,
        variances: &[],
        covariates: &[&covariate],
        factors: &factors,
    };
    let fit = fit_mixed(&grouped).unwrap();
    for (component, truth) in fit.components.iter().zip([0.8, 0.5, 0.2]) {
        assert!(
            component.low < truth && truth < component.high,
            "{component:?}"
        );
        assert!(component.high / component.low < 2.0, "{component:?}");
    }
    for (fixed, truth) in fit.fixed.iter().zip([3.0, -0.1]) {
        assert!(
            (fixed.value - truth).abs() < 3.0 * fixed.sigma,
            "{fixed:?} {truth}"
        );
    }
}

#[test]
fn known_variances_are_taken_out_of_the_residual_and_an_outlier_is_seen() {
    let mut table = crossed(30, 4, [1.0, 0.3, 0.5], 3);
    for row in 0..4 {
        table.values[4 * 7 + row] += 8.0;
    }
    let variances = vec![0.25; table.values.len()];
    let factors = [
        Factor {
            name: "cell",
            levels: &table.cells,
        },
        Factor {
            name: "bench",
            levels: &table.benches,
        },
    ];
    let grouped = Grouped {
        values: &table.values,
        variances: &variances,
        covariates: &[],
        factors: &factors,
    };
    let fit = fit_mixed(&grouped).unwrap();
    assert!(fit.components[2].sd < 0.2, "{:?}", fit.components);
    let worst = (0..30).max_by(|a, b| {
        let z = |at: &usize| fit.levels[0][*at].z.abs();
        z(a).total_cmp(&z(b))
    });
    assert_eq!(worst, Some(7));
    assert!(fit.levels[0][7].z > 3.5);
}

#[test]
fn what_cannot_be_is_refused() {
    let one = Grouped {
        values: &[1.0, 1.0, 1.0, 1.0],
        variances: &[],
        covariates: &[],
        factors: &[],
    };
    assert_eq!(fit_mixed(&one), Err(MixedError::Exact));
    let two = Grouped {
        values: &[1.0, f64::NAN, 1.0, 1.0],
        ..one
    };
    assert_eq!(fit_mixed(&two), Err(MixedError::Value(1)));
    let few = Grouped {
        values: &[1.0, 2.0],
        ..one
    };
    assert_eq!(fit_mixed(&few), Err(MixedError::Few(3)));
    let factors = [Factor {
        name: "bench",
        levels: &[0, 1],
    }];
    let short = Grouped {
        values: &[1.0, 2.0, 3.0, 4.0],
        factors: &factors,
        ..one
    };
    assert_eq!(
        fit_mixed(&short),
        Err(MixedError::Length("bench".to_owned()))
    );
}

/// Share of the intervals that hold the truth.
#[test]
#[ignore = "long drill"]
fn intervals_hold_the_truth_as_often_as_they_say() {
    const TABLES: u64 = 400;
    let truth = [1.0, 0.3, 0.4];
    let mut inside = [0usize; 3];
    for seed in 1000..1000 + TABLES {
        let fit = crossed(40, 5, truth, seed).fit();
        for (at, component) in fit.components.iter().enumerate() {
            inside[at] += usize::from(component.low <= truth[at] && truth[at] <= component.high);
        }
    }
    let share = inside.map(|n| n as f64 / TABLES as f64);
    eprintln!("cell, bench, residual: {share:?} of {TABLES} intervals of 95 %");
    // 0.95 less three standard deviations of such a share, and a point for five benches.
    assert!(share.iter().all(|share| *share > 0.905), "{share:?}");
}
