//! impedance.py's example file and the result its documentation prints.

use super::parse;
use crate::fit::{CircuitFit, CircuitOptions, Search, Weight, fit_circuit};
use analysis_files::formats::read_spectra;
use analysis_signal::spectrum::Spectrum;
use std::path::{Path, PathBuf};

/// The file, where this checkout has the shared data.
fn example() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = std::env::var_os("EIS_BENCH_SHARED").map_or(beside, PathBuf::from);
    let file = shared.join("data/formats/impedance_py/exampleData.csv");
    if file.exists() {
        return Some(file);
    }
    println!("skipped: no {}", file.display());
    None
}

/// As the getting-started page does: the first quadrant only, unit weights.
fn fit(spectra: &[Spectrum], options: CircuitOptions) -> CircuitFit {
    let mut spectra = spectra.to_vec();
    spectra[0].points.retain(|p| p.z_ohm.im < 0.0);
    fit_circuit(
        &spectra,
        &parse("R0-p(R1,C1)-p(R2-Wo1,C2)"),
        &CircuitOptions {
            weight: Some(Weight::Unit),
            ..options
        },
    )
    .unwrap()
}

#[test]
fn the_start_values_of_impedance_pys_page_give_its_published_parameters() {
    let Some(file) = example() else { return };
    let spectra = read_spectra(&file).unwrap();
    let guess = [0.01, 0.01, 100.0, 0.01, 0.05, 100.0, 1.0]
        .into_iter()
        .enumerate()
        .collect();
    let fit = fit(
        &spectra,
        CircuitOptions {
            guess,
            ..CircuitOptions::default()
        },
    );
    assert_eq!((fit.starts, fit.points), (1, 57));
    // Published with three significant digits. The band fixes little of the diffusion except Z₀/√τ,
    // and impedance.py stopped 0.1 % above the minimum.
    for (k, (published, tolerance)) in [
        (1.65e-2, 0.002),
        (8.68e-3, 0.001),
        (3.32, 0.001),
        (5.39e-3, 0.001),
        (6.31e-2, 0.012),
        (2.33e2, 0.025),
        (2.20e-1, 0.003),
    ]
    .into_iter()
    .enumerate()
    {
        let (name, met) = (&fit.names[k], fit.values[k]);
        assert!(
            (met / published - 1.0).abs() < tolerance,
            "{name}: published {published}, met {met}"
        );
    }
    let level = fit.values[4] / fit.values[5].sqrt();
    assert!(
        (level / (6.31e-2 / 2.33e2f64.sqrt()) - 1.0).abs() < 0.002,
        "{level}"
    );
    assert!(
        (fit.objective / 1.9428e-5 - 1.0).abs() < 1e-3,
        "{}",
        fit.objective
    );
}

#[test]
fn the_published_optimum_is_a_local_one() {
    let Some(file) = example() else { return };
    let spectra = read_spectra(&file).unwrap();
    for (search, seed) in [
        (Search::Starts, 0),
        (Search::Starts, 1),
        (Search::Starts, 2),
        (Search::Starts, 3),
        (Search::Evolution, 0),
    ] {
        let fit = fit(
            &spectra,
            CircuitOptions {
                search,
                seed,
                ..CircuitOptions::default()
            },
        );
        // 28 % below the published one; the diffusion belongs to the slower arc. Of 40 seeds of
        // both searches 38 end here, two 0.7 % above.
        assert!(
            (fit.objective / 1.403_14e-5 - 1.0).abs() < 1e-4,
            "{search:?}, seed {seed}: {} Ω²",
            fit.objective
        );
        assert!(
            (fit.values[5] / 1262.2 - 1.0).abs() < 1e-3,
            "{search:?}, seed {seed}: {:?}",
            fit.values
        );
    }
}
