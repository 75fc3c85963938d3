//! The voltage at rest before the first current, against the curve at the stated start.

use super::finding::{Finding, FindingKind, names};
use super::scene::{Played, Scene};
use crate::data::Start;
use crate::median::median;
use crate::thresholds::{REST_CURRENT_PART, REST_LEAST_V, REST_SIGMAS, REST_SOC};

/// Rest voltage less the expected one.
struct Off {
    run: String,
    off_v: f64,
    sigma_v: f64,
    text: String,
}

pub(super) fn find(scene: &Scene<'_>) -> Vec<Finding> {
    let all: Vec<Off> = scene
        .of_cells()
        .filter_map(|played| off(scene, &played))
        .collect();
    if all.is_empty() {
        return Vec::new();
    }
    let runs: Vec<String> = all.iter().map(|off| off.run.clone()).collect();
    let worst = all
        .iter()
        .max_by(|a, b| a.off_v.abs().total_cmp(&b.off_v.abs()));
    let Some(worst) = worst else {
        return Vec::new();
    };
    let more = if all.len() > 1 {
        format!(
            "; {} records in all, by {:+.1} mV in the middle",
            all.len(),
            1e3 * median(all.iter().map(|off| off.off_v).collect())
        )
    } else {
        String::new()
    };
    vec![Finding {
        kind: FindingKind::RestVoltage,
        text: format!("{}{more}", worst.text),
        how_sure: format!(
            "{:.0} σ of noise, level and start voltage in {}",
            (worst.off_v / worst.sigma_v).abs(),
            worst.run
        ),
        effect: format!(
            "State of charge, rest or curve of {} are not what is stated. The fit takes the \
            offset for a missing effect of the curve, the level or the rest.",
            names(&runs)
        ),
        runs,
        correctable: false,
    }]
}

fn off(scene: &Scene<'_>, played: &Played<'_>) -> Option<Off> {
    let series = &played.record.series;
    let history = scene.at.set.history;
    let least_a = (REST_CURRENT_PART * played.largest_a()).max(history.map_or(0.0, |h| {
        2.0 * h.current_resolution_a + 3.0 * h.current_noise_a
    }));
    let rest = series
        .current_a
        .iter()
        .take_while(|i| i.abs() <= least_a)
        .count();
    // A logged current may lag: the last rows before it count as load.
    let rest = if rest == series.len() {
        rest
    } else {
        rest.div_ceil(2)
    };
    if rest == 0 || played.largest_a() <= 0.0 {
        return None;
    }
    let off_v = median(
        (0..rest)
            .map(|k| series.voltage_v[k] - played.expected_v[k])
            .collect(),
    );
    let noise_v = scene.at.sample_noise_v(played.record) / (rest as f64).sqrt();
    let bench_v = history.map_or(0.0, |h| {
        h.voltage_offset_v
            .hypot(h.voltage_drift_v)
            .hypot(h.start_voltage_v)
            .hypot(h.voltage_resolution_v)
    });
    let ocv_v = |soc: f64| scene.model.ocv.voltage_v(soc);
    let sigma_v = noise_v.hypot(bench_v).hypot(played.record.level_sigma_v);
    let (stated, of_soc_v) = match played.run.start {
        Start::Soc(soc) => (
            format!("the curve at the stated {:.2} % SOC", 100.0 * soc),
            [soc - REST_SOC, soc + REST_SOC]
                .map(|near| (ocv_v(near.clamp(0.0, 1.0)) - ocv_v(soc)).abs())
                .into_iter()
                .fold(0.0, f64::max),
        ),
        // Of a stated voltage nothing hangs on the curve.
        Start::Ocv(ocv_v) => (format!("the stated `ocv_v` of {ocv_v:.4} V"), 0.0),
    };
    let limit_v = (REST_SIGMAS * sigma_v).max(REST_LEAST_V) + of_soc_v;
    (off_v.abs() > limit_v).then(|| Off {
        run: played.run.name.clone(),
        off_v,
        sigma_v: sigma_v.max(f64::MIN_POSITIVE),
        text: format!(
            "{} rests at {:.4} V, {:+.1} mV from {stated}",
            played.run.name,
            median(series.voltage_v[..rest].to_vec()),
            1e3 * off_v
        ),
    })
}
