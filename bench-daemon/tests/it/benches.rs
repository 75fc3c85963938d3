//! Instruments of other manufacturers in the same roles: the same experiment gives the same
//! impedances.

use bench_daemon::command::run::run_experiment;
use bench_plan::config::load_experiment;

use crate::{
    configuration::configs,
    support::{BENCH, EXPERIMENT, Files, demo, json, program},
};

const BENCHES: [(&str, &[&str]); 3] = [
    (
        "benches/demo.toml",
        &[
            "BOP1KW",
            "SDG1032X",
            "SDS824X HD",
            "SDL1020X-E",
            "SPD3303X",
            "JULABO",
            "34970A",
        ],
    ),
    (
        "benches/second.toml",
        &[
            "FAST-PS", "33522B", "DHO824", "DL3021", "E36312A", "{S0009C4", "SDM3065X",
        ],
    ),
    (
        "benches/mixed.toml",
        &[
            "BOP1KW", "33522B", "DHO824", "DL3021", "E36312A", "{S0009C4", "34970A",
        ],
    ),
];

#[test]
#[ignore = "long drill"]
fn benches_of_first_of_second_and_of_mixed_models_measure_the_same_cell() {
    let folder = tempfile::tempdir().unwrap();
    let measured = BENCHES.map(|(bench, models)| {
        let experiment = load_experiment(&demo(), Some(&configs().join(bench))).unwrap();
        let run = folder.path().join(bench);
        let finished = run_experiment(&experiment, &run).unwrap();
        let manifest = std::fs::read_to_string(run.join("manifest.json")).unwrap();
        for model in models {
            assert!(
                manifest.contains(model),
                "{model} is not in the manifest of {bench}: {manifest}"
            );
        }
        finished.measured.spectrum.points
    });
    for (first, second) in [(0, 1), (0, 2), (1, 2)] {
        let (ours, others) = (&measured[first], &measured[second]);
        assert_eq!((ours.len(), others.len()), (20, 20));
        let chi2: f64 = ours
            .iter()
            .zip(others)
            .map(|(a, b)| {
                assert_eq!(a.freq_hz, b.freq_hz);
                let off = a.z_ohm - b.z_ohm;
                off.re.powi(2) / (a.covariance.re_re + b.covariance.re_re)
                    + off.im.powi(2) / (a.covariance.im_im + b.covariance.im_im)
            })
            .sum();
        // 40 degrees of freedom: mean 40, standard deviation 9; the correction's share of the
        // uncertainty is common, so smaller values are usual.
        println!(
            "{} against {}: {chi2:.1}",
            BENCHES[first].0, BENCHES[second].0
        );
        assert!(
            chi2 < 80.0,
            "{} against {}: {chi2}",
            BENCHES[first].0,
            BENCHES[second].0
        );
    }
}

#[test]
fn a_bench_of_second_models_plays_a_campaign_with_a_reset_before_every_sweep() {
    let second = std::fs::read_to_string(configs().join("benches/second.toml")).unwrap();
    let files = Files::brief(3).append(
        EXPERIMENT,
        "[campaign]\nrepeats = 2\ncells = [{ name = \"A\" }]",
    );
    files.write(BENCH, &second);
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    assert_eq!(
        (
            finished.measured.spectrum.name.as_str(),
            finished.measured.repeats.len()
        ),
        ("A_1", 1)
    );
    assert!(
        finished.summary.contains("campaign: 2 spectra"),
        "{}",
        finished.summary
    );
    let campaign = json(&files.path("run/campaign.json"));
    assert!(
        campaign["runs"]
            .as_array()
            .unwrap()
            .iter()
            .all(|run| run["soc_missed"] == false),
        "{campaign}"
    );
    // Settings that its bipolar supply does not accept are listed in the summary and the plan.
    assert!(
        finished.summary.contains(
            "takes no compliance and no current limit; its own set-point limits are -20 V to 20 V"
        ),
        "{}",
        finished.summary
    );
    let plan = &program(&["plan".as_ref(), files.experiment().as_os_str()]).stdout;
    assert!(
        plan.contains("no programmable limit of current or voltage"),
        "{plan}"
    );
}
