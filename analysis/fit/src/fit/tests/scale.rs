//! Impedances of any size and range, and data that one row spoils: neither bounds nor weights may
//! hang on the largest |Z|.

use super::{Circuit, exact, true_impedance};
use crate::fit::{
    Bounds, CellSweeps, ErmFit, FitOptions, Objective, OrderOptions, fit_erm, select_order,
};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};

/// A spectrum from 10 mHz to 100 kHz with relative noise, of which nothing is stated.
fn wide(circuit: Circuit<'_>, relative: f64) -> Spectrum {
    let mut rng = Rng::new(46);
    let point = |k: i32| {
        let freq_hz = 10f64.powf(-2.0 + 0.125 * f64::from(k));
        let z = true_impedance(circuit, freq_hz);
        let sigma = relative * z.norm();
        ImpedancePoint {
            freq_hz,
            z_ohm: z + sigma * num_complex::Complex64::new(rng.normal(), rng.normal()),
            covariance: Covariance2::UNKNOWN,
            amplitude_a: 1.0,
        }
    };
    Spectrum::new("wide", (0..57).map(point).collect())
}

fn fit(spectrum: &Spectrum, rc: usize, objective: Objective) -> ErmFit {
    let spectra = std::slice::from_ref(spectrum);
    let options = FitOptions {
        rc,
        objective,
        bounds: Bounds::for_spectra(spectra),
        seed: 0,
    };
    fit_erm(spectra, &options).unwrap()
}

fn near(met: f64, expected: f64, relative: f64) -> bool {
    (met / expected - 1.0).abs() < relative
}

#[test]
fn a_small_resistance_beside_a_large_one_is_found() {
    for ratio in [1e2, 1e3, 1e4, 1e5, 1e6] {
        let large = 0.015 * ratio;
        let circuit: Circuit<'_> = (0.015, &[(large, 0.2 / large)]);
        for objective in [Objective::SumAbs, Objective::Complex] {
            let met = fit(&wide(circuit, 0.0), 1, objective);
            assert!(
                near(met.erm.r_ohm, 0.015, 1e-5)
                    && near(met.erm.branches[0].r_ohm, large, 1e-6)
                    && near(met.erm.time_constants_s()[0], 0.2, 1e-6)
                    && met.at_bounds().is_none(),
                "{ratio}, {objective}: {met:?}"
            );
        }
    }
}

#[test]
fn the_size_of_a_cell_changes_only_the_size_of_its_model() {
    let circuit: Circuit<'_> = (0.007, &[(0.0017, 1.2), (0.0026, 200.0)]);
    for size in [1e-4, 1e-2, 7.3, 1e3, 1e6] {
        let mut spectrum = exact(circuit, 40);
        spectrum.points.iter_mut().for_each(|p| p.z_ohm *= size);
        for objective in [Objective::SumAbs, Objective::Complex] {
            let met = fit(&spectrum, 2, objective);
            let branch = |k: usize| {
                let (r, c) = circuit.1[k];
                near(met.erm.branches[k].r_ohm, size * r, 1e-5)
                    && near(met.erm.branches[k].c_f, c / size, 1e-5)
            };
            assert!(
                near(met.erm.r_ohm, size * 0.007, 1e-5) && branch(0) && branch(1),
                "{size}, {objective}: {:?}",
                met.erm
            );
        }
    }
}

#[test]
fn a_fast_branch_within_the_band_has_room_for_its_capacitance() {
    // 0.4 mF, less than the thesis' 10 mF, at 16 kHz of 100 kHz.
    let met = fit(
        &wide((0.02, &[(0.025, 4e-4), (0.01, 20.0)]), 0.0),
        2,
        Objective::Complex,
    );
    assert!(
        near(met.erm.branches[0].c_f, 4e-4, 1e-5) && met.at_bounds().is_none(),
        "{met:?}"
    );
}

#[test]
fn without_a_series_resistance_the_branches_are_counted_all_the_same() {
    for (size, noise) in [
        (1e-3, 1e-3),
        (1.0, 1e-3),
        (1e4, 1e-3),
        (1.0, 0.0),
        (1e3, 0.0),
    ] {
        let circuit: Circuit<'_> = (
            1e-9 * size,
            &[(10.0 * size, 1e-4 / size), (30.0 * size, 0.05 / size)],
        );
        let sweep = wide(circuit, noise);
        let options = OrderOptions {
            most: 4,
            bounds: Bounds::for_spectra(std::slice::from_ref(&sweep)),
            seed: 0,
        };
        let cells = [CellSweeps {
            cell: "a".into(),
            named: true,
            sweeps: vec![sweep.clone()],
        }];
        let order = select_order(&cells, &options).unwrap();
        assert_eq!(order.recommended, 2, "{size}, {noise}: {order:?}");
        let met = fit(&sweep, 2, Objective::Complex);
        assert!(
            met.erm.r_ohm < 1e-3 * size
                && near(met.erm.branches[0].r_ohm, 10.0 * size, 0.01)
                && near(met.erm.branches[1].r_ohm, 30.0 * size, 0.01)
                && met.at_bounds().is_none()
                && met.sigma.dc_resistance_ohm.is_some(),
            "{size}: {met:?}"
        );
    }
}

#[test]
fn a_resistance_that_a_branch_stands_for_is_at_its_bound() {
    // The data show only the flat top of an arc whose corner is far above the band: R and the
    // branch cannot be separated.
    let spectrum = wide((1e-9, &[(20.0, 2e-9)]), 0.0);
    let met = fit(&spectrum, 1, Objective::Complex);
    assert!(met.at_bounds().is_some(), "{met:?}");
}

#[test]
fn one_bad_row_moves_nothing_and_is_named() {
    let circuit: Circuit<'_> = (0.021, &[(0.008, 0.25), (0.012, 25.0)]);
    for factor in [1e12, 1e5, 1e3, 1e-3, 1e-6] {
        let mut spectrum = wide(circuit, 2e-4);
        spectrum.points[23].z_ohm *= factor;
        let freq_hz =
            analysis_numeric::significant::format_significant(spectrum.points[23].freq_hz, 3);
        for objective in [Objective::SumAbs, Objective::Complex] {
            let met = fit(&spectrum, 2, objective);
            // Large, it weighs as one residual of 100 %; small, as one of its neighbours.
            assert!(
                near(met.erm.r_ohm, 0.021, 0.1)
                    && near(met.erm.dc_resistance_ohm(), 0.041, 0.1)
                    && met.at_bounds().is_none(),
                "{factor}, {objective}: {:?}",
                met.erm
            );
            let named = format!("the point at {freq_hz} Hz lies");
            assert!(
                met.warnings.words().iter().any(|w| w.starts_with(&named)),
                "{factor}, {objective}: {:?}",
                met.warnings
            );
        }
    }
}

#[test]
fn a_point_that_kk_calls_bad_is_named_though_the_model_misses_it_by_more() {
    // One RC for three: the residuals are larger than what is wrong with the point.
    let mut spectrum = wide((0.02, &[(0.01, 0.1), (0.01, 5.0), (0.02, 60.0)]), 3e-4);
    spectrum.points[30].z_ohm *= 1.03;
    let met = fit(&spectrum, 1, Objective::Complex);
    assert!(
        met.warnings
            .words()
            .iter()
            .any(|w| w.starts_with("the point at 56.2 Hz lies")),
        "{:?}",
        met.warnings
    );
}

#[test]
fn an_overload_is_refused() {
    let mut spectrum = exact((0.007, &[(0.002, 50.0)]), 12);
    spectrum.points[4].z_ohm = num_complex::Complex64::new(9.9e37, 9.9e37);
    let refused = fit_erm(
        &[spectrum],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    );
    let words = refused.unwrap_err().to_string();
    assert!(
        words.starts_with(
            "fit: spectrum \"simulated\", point 5 (counted from 1): expected an impedance (9.9e37 is \
            what meters send of an overload: leave the row out), met 9.9e37"
        ),
        "{words}"
    );
}

#[test]
fn a_slow_loop_is_said_with_a_circuit_that_follows_it() {
    // −15 mΩ at 2 s beside two arcs.
    let mut spectrum = wide((0.04, &[(0.02, 0.05), (0.03, 1.0)]), 1e-3);
    for p in &mut spectrum.points {
        let x = std::f64::consts::TAU * p.freq_hz * 2.0;
        p.z_ohm -= 0.015 / num_complex::Complex64::new(1.0, x);
    }
    let met = fit(&spectrum, 2, Objective::Complex);
    let words = met.warnings.words();
    let said = words
        .iter()
        .find(|w| w.contains("a slow inductive loop"))
        .unwrap();
    let text = said.split('\'').nth(1).unwrap();
    assert_eq!(text, "R0-p(R1,C1)-p(R2,C2)-p(R3,L3)");
    let circuit = text.parse().unwrap();
    let options = crate::fit::CircuitOptions::default();
    let met = crate::fit::fit_circuit(&[spectrum.clone()], &circuit, &options).unwrap();
    for (value, expected) in met
        .values
        .iter()
        .zip([0.025, 0.02, 0.05, 0.03, 1.0, 0.015, 0.03])
    {
        assert!(near(*value, expected, 0.05), "{:?}", met.values);
    }
    // Leads of 0.3 µH are in it, too, where they show.
    let mut with_leads = spectrum.clone();
    for p in &mut with_leads.points {
        p.z_ohm.im += std::f64::consts::TAU * p.freq_hz * 3e-7;
    }
    let words = fit(&with_leads, 1, Objective::Complex).warnings.words();
    assert!(
        words
            .iter()
            .any(|w| w.contains("'L0-R0-p(R1,C1)-p(R2,L2)'")),
        "{words:?}"
    );
    // A circuit without an inductance has this remark too.
    let plain = "R0-p(R1,C1)-p(R2,C2)".parse().unwrap();
    let met = crate::fit::fit_circuit(&[spectrum], &plain, &options).unwrap();
    assert!(
        met.warnings
            .words()
            .iter()
            .any(|w| w.contains("put -p(R,L) in series")),
        "{:?}",
        met.warnings
    );
}
