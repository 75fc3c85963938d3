use super::log::Counts;
use super::*;
use crate::loads::Counted;
use analysis_signal::series::TimeSeries;
use num_complex::Complex64;

const CAPACITY_AH: f64 = 3.0;

pub(super) fn curve() -> OcvCurve {
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
pub(super) fn log(name: &str, degc: f64, seed: u64, role: Role) -> MapLog {
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
        net_ah: None,
        temperature_degc: None,
        role,
    }
}

pub(super) fn of_logs(logs: impl Into<Vec<MapLog>>) -> MapData {
    MapData {
        logs: logs.into(),
        spectra: Vec::new(),
    }
}

pub(super) fn options() -> MapOptions {
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
    let fit = fit_map(&of_logs(logs), &curve(), &options()).unwrap();
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
        fit_map(&of_logs([log]), &curve(), &options())
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
    assert!(fails(held_out).contains("at least one log or spectrum to fit"));
    let falling = MapOptions {
        time_constants_s: vec![10.0, 5.0],
        ..options()
    };
    let error = fit_map(&of_logs([good()]), &curve(), &falling)
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
    let cut = 4000;
    for list in [
        &mut rests.series.time_s,
        &mut rests.series.current_a,
        &mut rests.series.voltage_v,
        rests.series.temperature_degc.as_mut().unwrap(),
    ] {
        list.truncate(cut);
    }
    let fit = fit_map(&of_logs([rests]), &curve(), &options()).unwrap();
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

/// Spectrum of the truth of [`log`] at one state, with an inductance of 50 nH.
fn spectrum(soc: f64, degc: f64, factor: f64) -> MapSpectrum {
    let hotter = (30e3 / 8.314_462_618 * (1.0 / (degc + 273.15) - 1.0 / 298.15)).exp();
    let r0 = 0.02 * (1.0 + 0.5 * (1.0 - soc) * (1.0 - soc)) * hotter;
    let slope_v = 1.0 + 0.2 * soc;
    let points = (0..14).map(|k| {
        let freq_hz = 0.001 * 2.5f64.powi(k);
        let s = Complex64::new(0.0, std::f64::consts::TAU * freq_hz);
        let stored = slope_v / (s * 3600.0 * CAPACITY_AH);
        let z_ohm = factor * (r0 + 0.015 * hotter / (1.0 + 50.0 * s)) + 50e-9 * s + stored;
        MapPoint {
            freq_hz,
            z_ohm,
            sigma_ohm: None,
        }
    });
    MapSpectrum {
        name: format!("z{soc}_{degc}"),
        role: Role::Train,
        soc,
        temperature_degc: degc,
        points: points.collect(),
    }
}

#[test]
fn spectra_alone_give_the_map_and_one_that_contradicts_its_neighbours_is_named() {
    let states = [0.1, 0.3, 0.5, 0.7, 0.9]
        .into_iter()
        .flat_map(|z| [(z, 5.0), (z, 25.0)]);
    let mut data = MapData {
        logs: Vec::new(),
        spectra: states.map(|(z, degc)| spectrum(z, degc, 1.0)).collect(),
    };
    let fit = fit_map(&data, &curve(), &options()).unwrap();
    let at = fit.map.place(0.6, 15.0);
    let hotter: f64 = (30e3 / 8.314_462_618 * (1.0 / 288.15 - 1.0 / 298.15_f64)).exp();
    let series = fit.map.resistance_ohm(&fit.map.series, &at);
    let expected = 0.02 * (1.0 + 0.5 * 0.4 * 0.4) * hotter;
    assert!(
        (series / expected - 1.0).abs() < 0.03,
        "{series} {expected}"
    );
    for score in &fit.spectra {
        assert!(
            score.rms_part < 0.01 && score.left_out.unwrap().part < 0.1,
            "{score:?}"
        );
    }
    assert!(
        fit.notes.iter().all(|note| !note.contains("contradicts")),
        "{:?}",
        fit.notes
    );
    // Two folders may name their spectra alike: each keeps its own error.
    let parts = |data: &MapData| -> Vec<f64> {
        let fit = fit_map(data, &curve(), &options()).unwrap();
        fit.spectra
            .iter()
            .filter_map(|score| Some(score.left_out?.part))
            .collect()
    };
    let own = parts(&data);
    let mut alike = data.clone();
    for spectrum in &mut alike.spectra {
        spectrum.name = "point_1".to_owned();
    }
    assert_eq!(parts(&alike), own);
    data.spectra[4] = spectrum(0.5, 5.0, 2.0);
    let fit = fit_map(&data, &curve(), &options()).unwrap();
    let named: Vec<_> = fit
        .notes
        .iter()
        .filter(|note| note.contains("contradicts"))
        .collect();
    assert_eq!(named.len(), 1, "{:?}", fit.notes);
    assert!(named[0].contains("z0.5_5"), "{named:?}");
}

/// A spectrum at half charge up to 300 Hz of 10 mΩ and a constant-phase element of 10 mΩ and 10 ms.
fn dispersed(exponent: f64) -> MapSpectrum {
    let slope_v = 1.1;
    let points = (0..20).map(|k| {
        let freq_hz = 300.0 * 0.65f64.powi(k);
        let s = Complex64::new(0.0, std::f64::consts::TAU * freq_hz);
        MapPoint {
            freq_hz,
            z_ohm: 0.01
                + 0.01 / (1.0 + (0.01 * s).powf(exponent))
                + slope_v / (s * 3600.0 * CAPACITY_AH),
            sigma_ohm: None,
        }
    });
    MapSpectrum {
        name: format!("exponent {exponent}"),
        role: Role::Train,
        soc: 0.5,
        temperature_degc: 25.0,
        points: points.collect(),
    }
}

#[test]
fn a_branch_continues_spectra_to_higher_frequencies_as_far_as_their_tail_shows() {
    let fit_of = |exponent: f64| {
        let data = MapData {
            logs: Vec::new(),
            spectra: vec![dispersed(exponent)],
        };
        fit_map(&data, &curve(), &MapOptions::default()).unwrap()
    };
    for (exponent, error_ohm) in [(0.6, 0.6e-3), (0.75, 0.2e-3), (1.0, 0.3e-3)] {
        let fit = fit_of(exponent);
        let first = &fit.map.branches[0];
        assert!(first.extrapolated && (first.tau_s - 0.265e-3).abs() < 1e-6);
        assert!(!fit.map.branches[1].extrapolated);
        assert_eq!(fit.map.lasting_errors(), 3);
        let at = fit.map.place(0.5, 25.0);
        let at_once_ohm = fit.map.resistance_ohm(&fit.map.series, &at);
        assert!(
            (at_once_ohm - 0.01).abs() < error_ohm,
            "{exponent}: {at_once_ohm}"
        );
        let last = "a branch of 0.27 ms continues the spectra beyond 300 Hz";
        assert!(
            fit.notes.iter().any(|n| n.contains(last)),
            "{:?}",
            fit.notes
        );
    }
    // A log that is as fast shows such a branch itself.
    let mut fast = log("fast", 25.0, 5, Role::Train);
    fast.series.time_s.iter_mut().for_each(|t| *t *= 1e-3);
    let data = MapData {
        logs: vec![fast],
        spectra: vec![dispersed(0.75)],
    };
    let fit = fit_map(&data, &curve(), &MapOptions::default()).unwrap();
    assert_eq!(fit.map.branches[0].tau_s, 0.2e-3);
    assert!(fit.map.branches.iter().all(|branch| !branch.extrapolated));
}

#[test]
fn spectra_that_contradict_the_logs_give_way_at_the_frequencies_of_the_logs() {
    let spectra = [0.1, 0.3, 0.5, 0.7, 0.9].map(|soc| spectrum(soc, 27.0, 1.0));
    let mut data = MapData {
        logs: vec![log("drive", 25.0, 1, Role::Train)],
        spectra: spectra.to_vec(),
    };
    let fit = fit_map(&data, &curve(), &options()).unwrap();
    assert_eq!(fit.spectra_from_hz, 0.0, "{:?}", fit.notes);
    let rms_v = fit.logs[0].rms_v;
    // At rest the cell has a branch of 30 mΩ and 0.5 s that no load meets.
    for point in data.spectra.iter_mut().flat_map(|s| &mut s.points) {
        let s = Complex64::new(0.0, std::f64::consts::TAU * point.freq_hz);
        point.z_ohm += 0.03 / (1.0 + 0.5 * s);
    }
    let fit = fit_map(&data, &curve(), &options()).unwrap();
    assert!((fit.spectra_from_hz - 5.0).abs() < 1e-9, "{:?}", fit.notes);
    let note = |note: &String| note.contains("the spectra are fitted from 5.000 Hz on");
    assert!(fit.notes.iter().any(note), "{:?}", fit.notes);
    assert!(fit.logs[0].rms_v < 1.1 * rms_v, "{:?}", fit.logs);
    assert!(
        fit.spectra.iter().all(|score| score.rms_part > 0.1),
        "the points that are not fitted count as errors"
    );
}

#[test]
fn a_resistance_that_falls_under_current_is_found_and_one_that_does_not_is_straight() {
    // The truth of `log` with a further branch of 40 mΩ and 0.5 s that current bends: i₀ is 1.5 A at
    // 25 °C, with 30 kJ/mol, so that 2·i₀·R is 0.12 V.
    let mut bend = log("bent", 25.0, 7, Role::Train);
    let series = &mut bend.series;
    let mut v = 0.0;
    for k in 0..series.len() {
        series.voltage_v[k] -= v;
        let kelvin = series.temperature_degc.as_ref().unwrap()[k] + 273.15;
        let hotter = (30e3 / 8.314_462_618 * (1.0 / kelvin - 1.0 / 298.15)).exp();
        let twice_a = 3.0 / hotter * kelvin / 298.15;
        let i = series.current_a[k];
        let r_ohm = 0.04 * hotter;
        for _ in 0..10 {
            v += 0.01 / 0.5 * r_ohm * (i - twice_a * (v / (twice_a * r_ohm)).sinh());
        }
    }
    let data = MapData {
        logs: vec![bend],
        spectra: Vec::new(),
    };
    let options = MapOptions {
        time_constants_s: vec![0.5, 50.0],
        ..MapOptions::default()
    };
    let fit = fit_map(&data, &curve(), &options).unwrap();
    let law = fit
        .map
        .charge_transfer
        .expect("a resistance that falls under current");
    assert!((law.voltage_v - 0.12).abs() < 0.024, "{law:?}");
    // The noise has 0.6 mV: the map is that of its own exchange current.
    assert!(fit.logs[0].rms_v < 1e-3, "{:?}", fit.logs);
    assert!(fit.map.most_current_a.is_some_and(|most_a| most_a > 5.0));
    let straight = MapData {
        logs: vec![log("straight", 25.0, 7, Role::Train)],
        spectra: Vec::new(),
    };
    let fit = fit_map(&straight, &curve(), &options).unwrap();
    assert_eq!(fit.map.charge_transfer, None);
}

#[test]
fn a_recorder_that_reads_the_voltage_before_the_current_is_found() {
    let mut late = log("late", 25.0, 3, Role::Train);
    let (time_s, current_a) = (late.series.time_s.clone(), late.series.current_a.clone());
    // Each row has the current as it is 40 ms after its voltage.
    for k in 0..time_s.len() - 1 {
        late.series.current_a[k] = current_a[k] + 0.4 * (current_a[k + 1] - current_a[k]);
    }
    let fit = fit_map(&of_logs([late]), &curve(), &options()).unwrap();
    assert!((fit.lag_s - 0.04).abs() < 0.02, "{}", fit.lag_s);
    let punctual = fit_map(
        &of_logs([log("punctual", 25.0, 3, Role::Train)]),
        &curve(),
        &options(),
    );
    assert_eq!(punctual.unwrap().lag_s, 0.0);
}

#[test]
fn charge_goes_on_after_a_gap_by_the_counter_or_by_the_rest() {
    let whole = log("whole", 25.0, 4, Role::Train);
    let gapped = |rest: bool| {
        let mut cut = whole.clone();
        let series = &mut cut.series;
        // Half an hour of the log is lost.
        let lost = 9000..27_000;
        for list in [
            &mut series.time_s,
            &mut series.current_a,
            &mut series.voltage_v,
            series.temperature_degc.as_mut().unwrap(),
        ] {
            list.drain(lost.clone());
        }
        if rest {
            series.current_a[lost.start] = 0.0;
        }
        cut
    };
    let error = fit_map(&of_logs([gapped(false)]), &curve(), &options())
        .unwrap_err()
        .to_string();
    assert!(error.contains("whole: has a gap before 2700 s"), "{error}");
    let drawn = Counted::of(&whole.series).charge_ah;
    let mut counted = gapped(false);
    counted.net_ah = Some(
        [&drawn[..9000], &drawn[27_000..]]
            .concat()
            .iter()
            .map(|q| -q)
            .collect(),
    );
    let fit = fit_map(&of_logs([counted]), &curve(), &options()).unwrap();
    assert!(fit.logs[0].rms_v < 4e-3, "{:?}", fit.logs);
    let Counts { soc, begins, .. } = counted_soc(&gapped(true));
    assert_eq!(begins, [0, 9000]);
    let rest_v = gapped(true).series.voltage_v[9000];
    assert!((soc[9000] - curve().soc_at(rest_v).unwrap()).abs() < 1e-12);
}

fn counted_soc(log: &MapLog) -> Counts {
    log::counted(log, &curve()).unwrap()
}
