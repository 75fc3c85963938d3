//! Diagnoses as they may come out, one per verdict.

use crate::outcome::*;
use analysis_effects::contract::{Facts, Group};
use analysis_fit::fit::PROGRAM;
use analysis_model::model::Erm;
use num_complex::Complex64;

fn block(dimension: &'static str, part: &str, chi2: f64, p_value: f64) -> Block {
    let count = 60;
    let expected_chi2 = 57.0;
    let mean_z = (chi2 / expected_chi2 - 1.0).max(0.0).sqrt() * 3.0;
    Block {
        dimension,
        part: part.into(),
        count,
        chi2,
        expected_chi2,
        mean_z,
        p_value,
        rms: 0.45 * (chi2 / expected_chi2).sqrt(),
    }
}

pub(super) fn quiet_blocks() -> Vec<Block> {
    PARTS
        .iter()
        .enumerate()
        .map(|(k, (d, p))| block(d, p, 50.0 + 1.3 * k as f64, 1.0))
        .collect()
}

const PARTS: [(&str, &str); 17] = [
    ("time since edge", "1 s to 10 s"),
    ("time since edge", "10 s to 60 s"),
    ("time since edge", "relaxation after the pulse"),
    ("time since edge", "100 ms to 1 s"),
    ("time since edge", "below 100 ms"),
    ("frequency", "below 1 Hz, imaginary part"),
    ("frequency", "below 1 Hz, real part"),
    ("frequency", "1 Hz to 30 Hz, imaginary part"),
    ("frequency", "1 Hz to 30 Hz, real part"),
    ("frequency", "above 30 Hz, imaginary part"),
    ("frequency", "above 30 Hz, real part"),
    ("current", "largest third"),
    ("current", "middle third"),
    ("current", "smallest third"),
    ("sign", "discharge"),
    ("sign", "charge"),
    ("run order", "last third"),
];

fn loud_blocks() -> Vec<Block> {
    let sizes = [
        5200.0, 3100.0, 2400.0, 180.0, 60.0, 900.0, 400.0, 70.0, 58.0, 55.0, 52.0, 3900.0, 1200.0,
        90.0, 2600.0, 2500.0, 61.0,
    ];
    let mut blocks: Vec<Block> = PARTS
        .iter()
        .zip(sizes)
        .map(|((d, p), chi2)| {
            block(
                d,
                p,
                chi2,
                if chi2 > 95.0 {
                    10f64.powf(-chi2 / 60.0)
                } else {
                    1.0
                },
            )
        })
        .collect();
    blocks.sort_by(|a, b| a.p_value.total_cmp(&b.p_value));
    blocks
}

fn noise(from_repeats: bool) -> NoiseReport {
    let term = |name, sigma, history, z| NoiseTerm {
        name,
        sigma,
        history,
        z,
    };
    let terms = vec![
        term(
            "white noise of the voltage / V",
            0.52e-3,
            Some(0.5e-3),
            Some(0.3),
        ),
        term("level of a run / V", 0.46e-3, Some(0.5e-3), Some(-0.6)),
        term("resistance of a run / 1", 3.9e-3, Some(4e-3), Some(-0.1)),
        term("zero of the current channel / A", 0.03, Some(0.03), None),
    ];
    NoiseReport {
        from_repeats,
        terms,
    }
}

fn candidate(name: &'static str, lagrange: f64, score: Option<f64>, refused: &str) -> Candidate {
    Candidate {
        name,
        lagrange,
        lambda: score.map(|s| s + 14.2),
        score,
        refused_because: refused.into(),
    }
}

fn diffusion() -> NamedEffect {
    NamedEffect {
        name: "diffusion",
        title: "finite-length diffusion",
        group: Group::Cell,
        parameters: vec![
            FittedParameter {
                name: "r_ohm",
                value: 5.31e-3,
                sigma: Some(1.4e-4),
                interval: (5.03e-3, 5.59e-3),
                unit: "Ω",
                caution: None,
            },
            FittedParameter {
                name: "tau_s",
                value: 148.0,
                sigma: Some(11.0),
                interval: (126.0, 170.0),
                unit: "s",
                caution: None,
            },
        ],
        evidence: Evidence {
            lambda: 14210.0,
            score: 14195.8,
            share_of_excess: 0.93,
            held_out_change: -5120.0,
            integration_error: 0.004,
        },
        falsified_by: "a spectrum from 1 mHz to 100 mHz whose phase stays away from 45°".into(),
    }
}

/// Diffusion for predictions, as it is offered if it may not be named.
fn predictive() -> Predictive {
    let term = diffusion();
    Predictive {
        claim: PREDICTION_ONLY,
        lambda: 9200.0,
        score: 9185.8,
        terms: vec![PredictiveTerm {
            name: term.name,
            title: term.title,
            group: term.group,
            stands_for: "√t growth under a pulse, long relaxation",
            parameters: term.parameters,
        }],
        gap: explained().gap,
        range: Facts {
            greatest_a: 60.0,
            longest_s: 680.0,
            widest_soc: 0.12,
            ..Facts::NONE
        },
        model: Erm {
            r_ohm: 7e-3,
            branches: Vec::new(),
        },
    }
}

/// Diffusion was missing.
pub(super) fn explained() -> Diagnosis {
    Diagnosis {
        schema: DIAGNOSIS_SCHEMA,
        schema_version: DIAGNOSIS_SCHEMA_VERSION,
        program: PROGRAM,
        data_set: "p45b-bench-7".into(),
        model: "p45b-3rc".into(),
        verdict: Verdict::Explained,
        summary: "Finite-length diffusion was missing. With it the model predicts the held-out \
        runs down to their noise."
            .into(),
        effects: vec![diffusion()],
        rivals: vec![],
        blocks: loud_blocks(),
        where_after: quiet_blocks(),
        gap: vec![
            Gap {
                run: "profile B".into(),
                eis_only_mv: 13.4,
                base_mv: 6.2,
                augmented_mv: 1.3,
                floor_mv: 1.1,
                ..Gap::default()
            },
            Gap {
                run: "60 A block".into(),
                eis_only_mv: 27.9,
                base_mv: 15.1,
                augmented_mv: 2.2,
                floor_mv: 1.9,
                eis_only_with_edges_mv: 31.4,
                base_with_edges_mv: 20.3,
                augmented_with_edges_mv: 13.1,
                floor_with_edges_mv: 14.2,
                edge_samples: 6,
                augmented_share: 0.04,
            },
        ],
        gap_spectra: vec![SpectrumGap {
            run: "sweep at 3.72 V, repeat 4".into(),
            eis_only_percent: 0.92,
            base_percent: 1.41,
            augmented_percent: 0.38,
            floor_percent: 0.35,
        }],
        next_experiment: None,
        inseparable: Vec::new(),
        findings: Vec::new(),
        accepted: Vec::new(),
        notes: vec!["Run pulse_7 was left out: its first sample stands before the edge.".into()],
        quality: Quality {
            base_chi2: 15480.0,
            degrees_of_freedom: 1004.0,
            base_z: 323.0,
            augmented_chi2: 1021.0,
            augmented_z: 0.4,
        },
        noise: noise(true),
        ranking: vec![
            candidate("diffusion", 12100.0, Some(14195.8), ""),
            candidate(
                "rc_slow",
                11800.0,
                Some(11023.0),
                "explains less than diffusion",
            ),
            candidate(
                "hysteresis",
                7300.0,
                Some(4120.0),
                "held-out run \"60 A block\" gets worse \
            by 210 %",
            ),
            candidate(
                "self_heating",
                320.0,
                Some(210.5),
                "removes 2 % of the excess, 30 % are \
            needed",
            ),
            candidate(
                "soc_resistance",
                80.0,
                Some(21.0),
                "parameter k_per_soc stands at its \
            bound",
            ),
            candidate("current_offset", 12.0, Some(-3.1), "score below 8"),
            candidate("time_skew", 1.2, None, "Lagrange score too low to fit it"),
            candidate("inductance", 1.1, None, "Lagrange score too low to fit it"),
        ],
        base: None,
        augmented: None,
        given: Vec::new(),
        by_hand: None,
        predictive: None,
        shares: Vec::new(),
    }
}

/// Returns the heat or a resistance that depends on the state of charge.
pub(super) fn ambiguous() -> Diagnosis {
    let heat = NamedEffect {
        name: "self_heating",
        title: "Joule self-heating with Arrhenius resistance",
        parameters: vec![
            FittedParameter {
                name: "g_per_j",
                value: 4.5e-5,
                sigma: Some(6e-6),
                interval: (3.3e-5, 5.7e-5),
                unit: "1/J",
                caution: None,
            },
            FittedParameter {
                name: "tau_s",
                value: 900.0,
                sigma: None,
                interval: (60.0, 6000.0),
                unit: "s",
                caution: None,
            },
        ],
        evidence: Evidence {
            lambda: 41.0,
            score: 26.8,
            share_of_excess: 0.81,
            held_out_change: -9.0,
            integration_error: 0.001,
        },
        falsified_by: "a thermocouple that shows less than 0.1 K during the bursts".into(),
        ..diffusion()
    };
    Diagnosis {
        verdict: Verdict::Ambiguous,
        summary:
            "Resistance falls during long runs. Self-heating and a resistance that depends on the \
            state of charge explain it equally well."
                .into(),
        effects: vec![heat],
        rivals: vec![Rival {
            name: "soc_resistance",
            instead_of: "self_heating",
            score_gap: -2.1,
            discriminability: 0.42,
        }],
        blocks: quiet_blocks()
            .into_iter()
            .enumerate()
            .map(|(k, b)| {
                if k < 3 {
                    block(b.dimension, &b.part, 120.0, 0.002)
                } else {
                    b
                }
            })
            .collect(),
        quality: Quality {
            base_chi2: 1240.0,
            degrees_of_freedom: 1004.0,
            base_z: 5.3,
            augmented_chi2: 1021.0,
            augmented_z: 0.4,
        },
        ranking: vec![
            candidate("self_heating", 39.0, Some(26.8), ""),
            candidate(
                "soc_resistance",
                38.0,
                Some(24.7),
                "within 6 of self_heating",
            ),
            candidate("current_offset", 12.0, Some(3.1), "score below 8"),
        ],
        inseparable: Vec::new(),
        next_experiment: Some(NextExperiment {
            name: "zero_net_charge_bursts",
            description:
                "Bursts of ±100 A for 0.2 s each that leave the charge as it was, for two \
            minutes, with rest before and after."
                    .into(),
            separates: vec!["self_heating", "soc_resistance"],
            separation_sigma: 36.7,
            separation_now_sigma: 4.1,
            settles: true,
            duration_min: 14.0,
            charge_ah: 3.3,
        }),
        ..explained()
    }
}

/// No effect of the catalogue fits.
pub(super) fn unexplained() -> Diagnosis {
    let base = explained();
    let gap = base
        .gap
        .iter()
        .map(|g| Gap {
            augmented_mv: g.base_mv,
            ..g.clone()
        })
        .collect();
    let spectra = base
        .gap_spectra
        .iter()
        .map(|g| SpectrumGap {
            augmented_percent: g.base_percent,
            ..g.clone()
        })
        .collect();
    Diagnosis {
        verdict: Verdict::Unexplained,
        summary: "Something is missing at large currents within the first ten seconds that no \
        effect of the catalogue explains."
            .into(),
        effects: vec![],
        where_after: vec![],
        gap,
        gap_spectra: spectra,
        quality: Quality {
            augmented_chi2: 15480.0,
            augmented_z: 323.0,
            ..base.quality
        },
        ranking: vec![
            candidate(
                "rc_slow",
                3000.0,
                Some(2100.0),
                "removes 15 % of the excess, 30 % are \
            needed",
            ),
            candidate(
                "hysteresis",
                700.0,
                Some(420.0),
                "held-out run \"60 A block\" gets worse by \
            210 %",
            ),
            candidate("time_skew", 1.2, None, "Lagrange score too low to fit it"),
        ],
        noise: noise(false),
        predictive: Some(predictive()),
        ..base
    }
}

/// Nothing is missing.
pub(super) fn at_floor() -> Diagnosis {
    let base = unexplained();
    Diagnosis {
        verdict: Verdict::AtNoiseFloor,
        summary: "The model predicts these runs as well as repeats agree with each other.".into(),
        blocks: quiet_blocks(),
        gap: vec![Gap {
            run: "profile B".into(),
            eis_only_mv: 1.4,
            base_mv: 1.2,
            augmented_mv: 1.2,
            floor_mv: 1.1,
            ..Gap::default()
        }],
        gap_spectra: vec![],
        quality: Quality {
            base_chi2: 1010.0,
            degrees_of_freedom: 1004.0,
            base_z: 0.1,
            augmented_chi2: 1010.0,
            augmented_z: 0.1,
        },
        ranking: vec![
            candidate("current_offset", 6.1, Some(-2.0), "score below 8"),
            candidate("time_skew", 1.2, None, "Lagrange score too low to fit it"),
        ],
        noise: noise(true),
        findings: Vec::new(),
        accepted: Vec::new(),
        notes: vec![],
        predictive: None,
        ..base
    }
}

/// The data are wrong.
pub(super) fn invalid() -> Diagnosis {
    Diagnosis {
        verdict: Verdict::Invalid,
        summary: "Run pulse_3: the voltage is clipped at 4.095 V in 312 of 4500 samples; nothing \
        was fitted."
            .into(),
        effects: vec![],
        blocks: vec![],
        where_after: vec![],
        gap: vec![],
        gap_spectra: vec![],
        ranking: vec![],
        noise: NoiseReport {
            from_repeats: false,
            terms: vec![],
        },
        findings: Vec::new(),
        accepted: Vec::new(),
        notes: vec!["Set the range of channel 2 to 5 V and measure pulse_3 again.".into()],
        quality: Quality {
            base_chi2: f64::NAN,
            degrees_of_freedom: 0.0,
            base_z: f64::NAN,
            augmented_chi2: f64::NAN,
            augmented_z: f64::NAN,
        },
        ..explained()
    }
}

/// Records and spectra that fit [`explained`].
pub(super) fn runs() -> Vec<RunCurves> {
    vec![
        record("profile B", true, 1.0),
        record("60 A block", true, 2.2),
        record("pulse_3", false, 0.4),
        sweep("sweep at 3.72 V, repeat 4", true),
    ]
}

/// Returns a pulse that a diffusive model follows and the base misses; noise from a fixed linear
/// congruential generator.
fn record(name: &str, held_out: bool, size: f64) -> RunCurves {
    let mut state = 12_345u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / f64::from(u32::MAX >> 1) - 0.5) * 3.4 * 0.5e-3
    };
    let time_s: Vec<f64> = (0..9000).map(|k| f64::from(k) * 0.04).collect();
    let current_a: Vec<f64> = time_s
        .iter()
        .map(|t| {
            if (20.0..140.0).contains(t) {
                30.0 * size
            } else if (200.0..230.0).contains(t) {
                -15.0 * size
            } else {
                0.0
            }
        })
        .collect();
    let (mut slow, mut truth) = (0.0, Vec::new());
    for i in &current_a {
        slow += (i * 0.4e-3 - slow) * 0.04 / 40.0;
        truth.push(3.72 - 8e-3 * i - slow);
    }
    let measured_v: Vec<f64> = truth.iter().map(|v| v + noise()).collect();
    let base_v = truth
        .iter()
        .zip(&current_a)
        .map(|(v, i)| 0.5 * v + 0.5 * (3.72 - 8.1e-3 * i))
        .collect();
    let eis_only_v = current_a.iter().map(|i| 3.72 - 8e-3 * i).collect();
    let floor_v = current_a
        .iter()
        .map(|i| (0.8e-6 + (0.4e-4 * i).powi(2)).sqrt())
        .collect();
    let augmented_v = truth.iter().map(|v| v + 0.2e-3 * size).collect();
    RunCurves {
        name: name.into(),
        held_out,
        curves: Curves::Time {
            time_s,
            current_a,
            measured_v,
            eis_only_v,
            base_v,
            augmented_v,
            floor_v,
        },
    }
}

fn sweep(name: &str, held_out: bool) -> RunCurves {
    let freq_hz: Vec<f64> = (0..25)
        .map(|k| 0.1 * 3000f64.powf(f64::from(k) / 24.0))
        .collect();
    let rc = |f: f64, r: f64, tau: f64| {
        Complex64::new(r, 0.0) / Complex64::new(1.0, std::f64::consts::TAU * f * tau)
    };
    let truth = |f: f64| Complex64::new(7e-3, 0.0) + rc(f, 1.7e-3, 2e-3) + rc(f, 3e-3, 2.2);
    let scatter = |k: usize| 1.0 + 1.5e-3 * (k as f64 * 2.4).sin();
    let all = |z: &dyn Fn(f64) -> Complex64| -> Vec<Complex64> {
        freq_hz.iter().map(|f| z(*f)).collect()
    };
    let measured_ohm: Vec<Complex64> = freq_hz
        .iter()
        .enumerate()
        .map(|(k, f)| truth(*f) * scatter(k))
        .collect();
    let base_ohm = all(&|f| truth(f) + rc(f, 0.4e-3, 1.1) - rc(f, 0.3e-3, 0.2));
    let eis_only_ohm = all(&|f| truth(f) + rc(f, 0.15e-3, 1.1));
    let floor_ohm = measured_ohm.iter().map(|z| 2e-3 * z.norm()).collect();
    let augmented_ohm = all(&truth);
    RunCurves {
        name: name.into(),
        held_out,
        curves: Curves::Eis {
            freq_hz,
            measured_ohm,
            eis_only_ohm,
            base_ohm,
            augmented_ohm,
            floor_ohm,
        },
    }
}
