//! Instruments of other makers in the same roles: the same experiment gives the same impedances.

use bench_daemon::{command::run::run_experiment, config::load_experiment};

use crate::{configuration::configs, support::demo};

#[test]
fn a_bench_of_other_makers_measures_the_same_cell() {
    let folder = tempfile::tempdir().unwrap();
    let measured = ["benches/demo.toml", "benches/mixed.toml"].map(|bench| {
        let experiment = load_experiment(&demo(), Some(&configs().join(bench))).unwrap();
        let run = folder.path().join(bench);
        let finished = run_experiment(&experiment, &run).unwrap();
        (finished.measured.spectrum.points, std::fs::read_to_string(run.join("manifest.json")).unwrap())
    });
    let [(ours, _), (others, manifest)] = &measured;
    for maker in ["33522B", "DHO824", "DL3021", "E36312A", "{S0009C4"] {
        assert!(manifest.contains(maker), "{maker} is not in the manifest: {manifest}");
    }
    assert_eq!((ours.len(), others.len()), (20, 20));
    let chi2: f64 = ours
        .iter()
        .zip(others)
        .map(|(a, b)| {
            assert_eq!(a.freq_hz, b.freq_hz);
            let off = a.z_ohm - b.z_ohm;
            off.re.powi(2) / (a.covariance.re_re + b.covariance.re_re) + off.im.powi(2) / (a.covariance.im_im + b.covariance.im_im)
        })
        .sum();
    // 40 degrees of freedom: mean 40, standard deviation 9; the correction's share of the uncertainty is common, so that less is usual.
    assert!(chi2 < 80.0, "{chi2}");
}
