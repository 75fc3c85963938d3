use super::*;
use analysis_signal::series::TimeSeries;

const CAPACITY_AH: f64 = 3.0;

fn curve() -> OcvCurve {
    let soc: Vec<f64> = (0..=20).map(|k| f64::from(k) / 20.0).collect();
    let ocv_v = soc.iter().map(|z| 3.0 + z + 0.1 * z * z).collect();
    OcvCurve::monotone(CAPACITY_AH, soc, ocv_v).unwrap()
}

/// A pseudo-random number from -1 to 1.
fn noise(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Truth by explicit Euler in steps of 10 ms: R = 20 mΩ·(1 + 0.5(1 − z)²) and one branch of 15 mΩ,
/// 50 s, both with 30 kJ/mol from 25 °C. The temperature rises by 4 K over the log.
fn log(name: &str, degc: f64, seed: u64, role: Role) -> MapLog {
    let mut state = seed;
    let (mut soc, mut v_rc, mut current_a) = (1.0, 0.0, 0.0);
    let (mut time_s, mut current, mut voltage, mut temperature) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let end = 40 * 3600;
    for step in 0..end {
        let t = f64::from(step) * 0.1;
        let temperature_degc = degc + 4.0 * t / (0.1 * f64::from(end));
        if step % 70 == 0 {
            current_a = 2.0 + 4.0 * noise(&mut state);
        }
        let hotter =
            (30e3 / 8.314_462_618 * (1.0 / (temperature_degc + 273.15) - 1.0 / 298.15)).exp();
        let r0 = 0.02 * (1.0 + 0.5 * (1.0 - soc) * (1.0 - soc)) * hotter;
        let ocv_v = 3.0 + soc + 0.1 * soc * soc;
        time_s.push(t);
        current.push(current_a);
        voltage.push(ocv_v - r0 * current_a - v_rc + 1e-3 * noise(&mut state));
        temperature.push(temperature_degc);
        for _ in 0..10 {
            v_rc += 0.01 / 50.0 * (0.015 * hotter * current_a - v_rc);
            soc -= 0.01 * current_a / (3600.0 * CAPACITY_AH);
        }
        if soc < 0.08 {
            break;
        }
    }
    MapLog {
        series: TimeSeries {
            name: name.to_owned(),
            time_s,
            current_a: current,
            voltage_v: voltage,
            temperature_degc: Some(temperature),
        },
        soc_start: Some(1.0),
        temperature_degc: None,
        role,
    }
}

fn options() -> MapOptions {
    MapOptions {
        time_constants_s: vec![5.0, 50.0, 500.0],
        ..MapOptions::default()
    }
}

#[test]
fn the_map_of_a_known_cell_is_found_and_predicts_a_temperature_that_it_has_not_seen() {
    let logs = [
        log("warm", 25.0, 1, Role::Train),
        log("cold", 0.0, 2, Role::Train),
        log("between", 12.0, 3, Role::HeldOut),
    ];
    let fit = fit_map(&logs, &curve(), &options()).unwrap();
    let map = &fit.map;
    map.validate().unwrap();
    assert_eq!(map.temperature_degc.len(), 2);
    for (soc, degc) in [(0.3, 3.0), (0.6, 27.0), (0.9, 14.0)] {
        let hotter: f64 = (30e3 / 8.314_462_618 * (1.0 / (degc + 273.15) - 1.0 / 298.15_f64)).exp();
        let at = map.place(soc, degc);
        let series = map.resistance_ohm(&map.series, &at);
        let expected = 0.02 * (1.0 + 0.5 * (1.0 - soc) * (1.0 - soc)) * hotter;
        assert!(
            (series / expected - 1.0).abs() < 0.01,
            "{soc} {degc}: {series} {expected}"
        );
        let middle = map.resistance_ohm(&map.branches[1].resistance, &at);
        assert!(
            (middle / (0.015 * hotter) - 1.0).abs() < 0.1,
            "{soc} {degc}: {middle}"
        );
    }
    for score in &fit.logs {
        assert!(score.rms_v < 1.2e-3, "{score:?}");
    }
}

#[test]
fn what_cannot_be_fitted_is_refused_with_the_reason() {
    let good = || log("log", 25.0, 1, Role::Train);
    let fails = |log: MapLog| {
        fit_map(&[log], &curve(), &options())
            .unwrap_err()
            .to_string()
    };
    let mut unknown = good();
    unknown.series.temperature_degc = None;
    assert!(fails(unknown).contains("log: expected a column of temperatures"));
    let mut kelvin = good();
    kelvin.series.temperature_degc = Some(vec![298.15; kelvin.series.len()]);
    assert!(fails(kelvin).contains("is the column in kelvin?"));
    let mut start = good();
    start.soc_start = None;
    assert!(fails(start).contains("its first sample carries"));
    let mut charge = good();
    charge.soc_start = Some(0.3);
    assert!(fails(charge).contains("its charge does not close"));
    let mut reversed = good();
    reversed.series.current_a.iter_mut().for_each(|i| *i = -*i);
    reversed.soc_start = Some(0.1);
    assert!(fails(reversed).contains("found the opposite on average"));
    let mut flat = good();
    flat.series.current_a.iter_mut().for_each(|i| *i = 0.0);
    assert!(fails(flat).contains("expected a current"));
    let held_out = MapLog {
        role: Role::HeldOut,
        ..good()
    };
    assert!(fails(held_out).contains("at least one log to fit"));
    let falling = MapOptions {
        time_constants_s: vec![10.0, 5.0],
        ..options()
    };
    let error = fit_map(&[good()], &curve(), &falling)
        .unwrap_err()
        .to_string();
    assert!(error.contains("time constants: expected seconds above zero that rise"));
}

#[test]
fn a_log_at_rest_gives_its_own_start_and_short_logs_lose_slow_branches() {
    let mut rests = log("rests", 25.0, 5, Role::Train);
    rests.soc_start = None;
    rests.series.current_a[0] = 0.0;
    rests.series.voltage_v[0] = 4.1;
    let cut = 6000;
    for list in [
        &mut rests.series.time_s,
        &mut rests.series.current_a,
        &mut rests.series.voltage_v,
        rests.series.temperature_degc.as_mut().unwrap(),
    ] {
        list.truncate(cut);
    }
    let fit = fit_map(&[rests], &curve(), &options()).unwrap();
    assert_eq!(fit.map.branches.len(), 2);
    assert!(
        fit.notes
            .iter()
            .any(|note| note.contains("no branch of 500 s")),
        "{:?}",
        fit.notes
    );
    assert!(
        fit.notes
            .iter()
            .any(|note| note.contains("one temperature"))
    );
}
