//! Refusals of the fit and their messages, and the files.

use super::exact;
use crate::fit::{
    Bounds, FitEntry, FitOptions, FitReport, ModelFile, Objective, PackModel, fit_erm,
};
use analysis_model::pack::Pack;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;

fn sweep() -> Spectrum {
    exact((0.007, &[(0.002, 50.0)]), 6)
}

#[test]
fn refusals_say_what_was_expected() {
    let options = FitOptions {
        rc: 1,
        ..FitOptions::default()
    };
    let spoilt = |spoil: fn(&mut Spectrum)| {
        let mut s = sweep();
        spoil(&mut s);
        vec![s]
    };
    let cases: [(Vec<Spectrum>, FitOptions, &str); 9] = [
        (
            vec![],
            options,
            "fit: expected at least one point, met none in 0 spectra",
        ),
        (
            spoilt(|s| s.points.clear()),
            options,
            "fit: expected at least one point, met none in 1 spectra",
        ),
        (
            spoilt(|s| s.points[2].freq_hz = 0.0),
            options,
            "fit: spectrum \"simulated\", point 3 (counted from 1): expected a positive finite \
            frequency in Hz, met 0",
        ),
        (
            spoilt(|s| s.points[0].z_ohm = Complex64::new(f64::NAN, 0.0)),
            options,
            "fit: spectrum \"simulated\", point 1 (counted from 1): expected a finite impedance \
            other than zero in Ω, met NaN+0i",
        ),
        (
            vec![sweep()],
            FitOptions { rc: 9, ..options },
            "fit: expected 0 to 8 RC branches, met 9",
        ),
        (
            vec![sweep(), sweep()],
            FitOptions { rc: 6, ..options },
            "fit: 6 RC branches have 13 parameters and need as many points, met 6 distinct \
            frequencies",
        ),
        (
            vec![sweep()],
            FitOptions {
                rc: 3,
                objective: Objective::Modulus,
                ..options
            },
            "fit: 3 RC branches have 7 parameters and need as many points, met 6 distinct \
            frequencies",
        ),
        (
            vec![sweep()],
            FitOptions {
                bounds: Bounds {
                    r_ohm: (0.0, 1.0),
                    ..Bounds::default()
                },
                ..options
            },
            "fit: bounds of R: expected 0 < lower < upper, both finite, met 0 to 1 Ω",
        ),
        (
            vec![sweep()],
            FitOptions {
                bounds: Bounds {
                    c_f: (1.0, f64::INFINITY),
                    ..Bounds::default()
                },
                ..options
            },
            "fit: bounds of C: expected 0 < lower < upper, both finite, met 1 to inf F",
        ),
    ];
    for (spectra, options, message) in cases {
        assert_eq!(
            fit_erm(&spectra, &options).unwrap_err().to_string(),
            message
        );
    }
}

#[test]
fn objectives_are_named_as_on_the_command_line() {
    for objective in [Objective::SumAbs, Objective::Modulus, Objective::Complex] {
        assert_eq!(objective.name().parse(), Ok(objective));
        assert_eq!(
            serde_json::to_string(&objective).unwrap(),
            format!("\"{objective}\"")
        );
    }
    let error = "sumabs".parse::<Objective>().unwrap_err();
    assert_eq!(
        error.to_string(),
        "objective: expected sum-abs, modulus or complex, met \"sumabs\""
    );
}

#[test]
fn as_many_points_as_parameters_are_enough() {
    let mut s = sweep();
    s.points.truncate(3);
    let fit = fit_erm(
        &[s],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    assert!(fit.objective < 1e-6);
    let mut one = sweep();
    one.points.truncate(1);
    let resistor = fit_erm(
        &[one],
        &FitOptions {
            rc: 0,
            ..FitOptions::default()
        },
    )
    .unwrap();
    assert!(resistor.erm.r_ohm > 0.0);
}

#[test]
fn the_report_has_the_agreed_keys() {
    let fit = fit_erm(
        &[sweep()],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    let report = FitReport {
        fits: vec![FitEntry::new(&fit, vec!["a".into()])],
    };
    let json: serde_json::Value = serde_json::to_value(&report).unwrap();
    let entry = &json["fits"][0];
    assert_eq!(entry["rc"], 1);
    assert_eq!(entry["r_ohm"], fit.erm.r_ohm);
    assert_eq!(entry["objective"], fit.objective);
    assert_eq!(entry["objective_kind"], "sum-abs");
    assert_eq!(entry["branches"][0]["r_ohm"], fit.erm.branches[0].r_ohm);
    assert_eq!(entry["branches"][0]["c_f"], fit.erm.branches[0].c_f);
    assert!((entry["dc_resistance_ohm"].as_f64().unwrap() - 0.009).abs() < 1e-8);
    assert_eq!(
        serde_json::from_value::<FitReport>(json.clone()).unwrap(),
        report
    );
}

#[test]
fn a_model_file_is_read_back_and_a_foreign_one_refused() {
    let fit = fit_erm(
        &[sweep()],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    let pack = PackModel::new(&fit.erm, Pack::THESIS).unwrap();
    let file = ModelFile::new("P45B", fit, vec!["a".into()], Some(pack));
    let text = file.to_json().unwrap();
    let back = ModelFile::from_json(&text).unwrap();
    assert_eq!(
        (back.rc, &back.spectra, back.fit.points),
        (1, &file.spectra, 6)
    );
    for (met, written) in back
        .fit
        .erm
        .log_parameters()
        .iter()
        .zip(file.fit.erm.log_parameters())
    {
        assert!((met - written).abs() < 1e-14);
    }
    assert!(back.fit.sigma.dc_resistance_ohm.is_some() && back.pack.is_some());
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (&json["pack"]["series"], &json["pack"]["parallel"]),
        (&16.into(), &3.into())
    );
    assert!(
        (json["pack"]["dc_resistance_ohm"].as_f64().unwrap() - 0.048).abs() < 1e-7,
        "{text}"
    );
    let refused = |from: &str, to: &str| {
        ModelFile::from_json(&text.replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        refused("eis-bench/model", "other"),
        "model file: expected schema \"eis-bench/model\", met \"other\""
    );
    assert_eq!(
        refused("\"schema_version\": 1", "\"schema_version\": 3"),
        "model file: expected schema version 1 to 2, met 3"
    );
    assert!(refused("{", "[").starts_with("model file: "));
    let mut dead = file;
    dead.fit.erm.r_ohm = -1.0;
    let error = ModelFile::from_json(&dead.to_json().unwrap())
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "model file: R of the ERM: expected a positive finite number in Ω, met -1"
    );
}

#[test]
fn a_model_file_that_contradicts_itself_is_refused() {
    let fit = fit_erm(
        &[sweep()],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    let file = ModelFile::new("a cell", fit, vec!["a".into()], None);
    let refused = |file: &ModelFile| {
        ModelFile::from_json(&file.to_json().unwrap())
            .unwrap_err()
            .to_string()
    };
    let order = ModelFile {
        rc: 7,
        ..file.clone()
    };
    assert_eq!(
        refused(&order),
        "model file: expected rc to be the number of fit.erm.branches, 1, met 7"
    );
    let covariance = |rows: Vec<Vec<f64>>| {
        let mut wrong = file.clone();
        wrong.fit.log_covariance = Some(rows);
        refused(&wrong)
    };
    let start =
        "model file: fit.log_covariance: expected 3 rows and columns for as many parameters, met";
    assert_eq!(
        covariance(vec![vec![1.0; 3]; 2]),
        format!("{start} 2 rows, one of 3 columns")
    );
    assert_eq!(
        covariance(vec![vec![1.0; 3], vec![1.0; 3], vec![1.0; 4]]),
        format!("{start} 3 rows, one of 4 columns")
    );
    assert_eq!(
        covariance(Vec::new()),
        format!("{start} 0 rows, one of 3 columns")
    );
}
