//! Models whose resistances follow state of charge and temperature.

use super::*;
use analysis_model::map::{
    CellMap, ChargeTransfer, ErrorSource, MapBranch, Surface, Thermal, VoltageError,
};

/// The thesis' cell as a map, its resistances times `factor` of SOC and node.
pub(super) fn map(factor: impl Fn(f64, usize) -> f64, thermal: Option<Thermal>) -> CellMap {
    let (cell, soc) = (thesis_cell(), vec![0.0, 0.5, 1.0]);
    let surface = |r_ohm: f64| Surface {
        activation_j_per_mol: 30e3,
        r_ohm: (0..2)
            .map(|node| soc.iter().map(|z| r_ohm * factor(*z, node)).collect())
            .collect(),
        sigma_ohm: Vec::new(),
    };
    let mut branches: Vec<MapBranch> = cell
        .branches
        .iter()
        .map(|b| MapBranch {
            extrapolated: false,
            tau_s: b.time_constant_s(),
            resistance: surface(b.r_ohm),
        })
        .collect();
    branches.sort_by(|a, b| a.tau_s.total_cmp(&b.tau_s));
    CellMap {
        series: surface(cell.r_ohm),
        branches,
        ocv_offset_v: vec![0.0; 3],
        ocv_v_per_k: vec![0.0; 3],
        soc,
        temperature_degc: vec![0.0, 25.0],
        ocv_temperature_degc: 25.0,
        most_current_a: None,
        charge_transfer: None,
        thermal,
        voltage_error: None,
    }
}

fn load() -> Profile {
    let steps = [
        (0.0, 40.0),
        (4.0, 5.0),
        (20.0, 55.0),
        (26.0, -20.0),
        (40.0, 10.0),
        (60.0, 10.0),
    ];
    rows(Demand::Power, Interpolation::Hold, &steps)
}

/// The equal map is made of equal nodes, so its energy must not matter: it is set to zero.
#[test]
fn a_map_of_equal_nodes_is_the_model_of_one_point() {
    let mut equal = map(|_, _| 1.0, None);
    equal.series.activation_j_per_mol = 0.0;
    equal
        .branches
        .iter_mut()
        .for_each(|b| b.resistance.activation_j_per_mol = 0.0);
    for pack in [
        Pack::new(1, 1, 0.0).unwrap(),
        Pack::new(16, 3, 0.03).unwrap(),
    ] {
        let cells = f64::from(pack.series * pack.parallel);
        let demand: Vec<(f64, f64)> = load()
            .time_s
            .iter()
            .zip(&load().value)
            .map(|(t, p)| (*t, cells * p))
            .collect();
        let load = rows(Demand::Power, Interpolation::Hold, &demand);
        let mapped = SimModel::mapped(equal.clone(), curve(), pack, 10.0).unwrap();
        let plain = SimModel::pack(&thesis_cell(), OcvSource::Curve(curve()), pack).unwrap();
        let options = SimOptions {
            max_step_s: 0.5,
            ..SimOptions::default()
        };
        let run = |model: &SimModel| {
            let start = model.rest(0.6).unwrap();
            simulate(model, &start, &load, &options).unwrap()
        };
        let (a, b) = (run(&mapped), run(&plain));
        let apart = a.trace.ccv_v.iter().zip(&b.trace.ccv_v);
        let worst = apart.fold(0.0, |most: f64, (x, y)| most.max((x - y).abs()));
        assert_eq!(a.trace.ccv_v.len(), b.trace.ccv_v.len());
        assert!(worst / f64::from(pack.series) < 1e-5, "{worst}");
        assert!((a.summary.heat_j / b.summary.heat_j - 1.0).abs() < 1e-3);
        assert_eq!(a.end.temperature_degc, Some(10.0));
    }
}

/// Explicit Euler with steps of 0.2 ms on the equations as `mapped` states them.
#[test]
fn resistances_follow_charge_and_heat_as_the_equations_say() {
    let thermal = Thermal {
        capacity_j_per_k: 30.0,
        resistance_k_per_w: 5.0,
    };
    let mut map = map(
        |z, node| (2.0 - z) * if node == 0 { 2.5 } else { 1.0 },
        Some(thermal),
    );
    map.charge_transfer = Some(ChargeTransfer {
        voltage_v: 0.06,
        slowest_s: 1.0,
    });
    let model = SimModel::mapped(map.clone(), curve(), Pack::new(1, 1, 0.0).unwrap(), 5.0).unwrap();
    let load = rows(
        Demand::Current,
        Interpolation::Hold,
        &[(0.0, 20.0), (30.0, -5.0), (60.0, 30.0), (120.0, 30.0)],
    );
    let run = simulate(
        &model,
        &model.rest(0.7).unwrap(),
        &load,
        &SimOptions::default(),
    )
    .unwrap();
    let (mut soc, mut degc, mut v) = (0.7, 5.0, vec![0.0; 4]);
    let (h, mut last_v) = (2e-4, 0.0);
    for k in 0..600_000 {
        let t = h * f64::from(k);
        let i = if t < 30.0 {
            20.0
        } else if t < 60.0 {
            -5.0
        } else {
            30.0
        };
        let at = map.place(soc, degc);
        let r0 = map.resistance_ohm(&map.series, &at);
        let sum: f64 = v.iter().sum();
        last_v = curve().voltage_v(soc) - r0 * i - sum;
        let mut heat_w = r0 * i * i;
        let fast = map.branches.iter().filter(|branch| branch.tau_s <= 1.0);
        let whole_ohm: f64 = fast.map(|b| map.resistance_ohm(&b.resistance, &at)).sum();
        let twice_a = 0.06 * (degc + 273.15) / 298.15 / whole_ohm;
        for (v, branch) in v.iter_mut().zip(&map.branches) {
            let r = map.resistance_ohm(&branch.resistance, &at);
            let leaking_a = match branch.tau_s <= 1.0 {
                true => twice_a * (*v / (twice_a * r)).sinh(),
                false => *v / r,
            };
            heat_w += *v * leaking_a;
            *v += h / branch.tau_s * r * (i - leaking_a);
        }
        degc += h * (heat_w - (degc - 5.0) / 5.0) / 30.0;
        soc -= h * i / (3600.0 * curve().capacity_ah);
    }
    let met = run.trace.ccv_v.last().unwrap();
    assert!((met - last_v).abs() < 1e-4, "{met} {last_v}");
    assert!(
        (run.end.temperature_degc.unwrap() - degc).abs() < 2e-3,
        "{degc}"
    );
    assert!(degc > 15.0 && (run.end.soc - soc).abs() < 1e-5);
}

#[test]
fn a_warm_cell_gives_more_power_and_the_distance_from_the_map_is_stated() {
    let map = map(|_, node| if node == 0 { 3.0 } else { 1.0 }, None);
    let one = Pack::new(1, 1, 0.0).unwrap();
    let lowest = |degc| {
        let model = SimModel::mapped(map.clone(), curve(), one, degc).unwrap();
        simulate(
            &model,
            &model.rest(0.6).unwrap(),
            &load(),
            &SimOptions::default(),
        )
        .unwrap()
        .summary
    };
    let (cold, warm, beyond) = (lowest(0.0), lowest(25.0), lowest(-8.0));
    assert!(
        cold.min_ccv_v + 0.2 < warm.min_ccv_v,
        "{} {}",
        cold.min_ccv_v,
        warm.min_ccv_v
    );
    assert_eq!(warm.outside_map.unwrap().temperature_k, 0.0);
    assert!((beyond.outside_map.unwrap().temperature_k - 8.0).abs() < 1e-9);
}

#[test]
fn what_a_map_does_not_support_is_refused() {
    let model = SimModel::mapped(
        map(|_, _| 1.0, None),
        curve(),
        Pack::new(1, 1, 0.0).unwrap(),
        25.0,
    );
    let model = model.unwrap();
    let thesis = SimOptions {
        method: Method::Thesis,
        ..SimOptions::default()
    };
    let error = simulate(&model, &model.rest(0.6).unwrap(), &load(), &thesis).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("resistances over state of charge and temperature")
    );
    let mut broken = map(|_, _| 1.0, None);
    broken.series.r_ohm[0][0] = -1.0;
    let one = Pack::new(1, 1, 0.0).unwrap();
    let error = SimModel::mapped(broken, curve(), one, 25.0).unwrap_err();
    assert!(error.to_string().contains("series.r_ohm[0]"));
    let hot = SimModel::mapped(map(|_, _| 1.0, None), curve(), one, 300.0).unwrap_err();
    assert!(hot.to_string().contains("-60 to 120 °C"));
}

#[test]
fn a_map_that_states_its_error_gives_each_row_a_standard_deviation() {
    let stated = VoltageError {
        rest_v: 0.004,
        soc: 0.01,
        share: vec![0.2, 0.1],
        from: ErrorSource::HeldOut,
        whole_runs: None,
    };
    let mut map = map(|_, _| 1.0, None);
    map.ocv_offset_v = vec![0.02; 3];
    let run_band = |map: &CellMap, pack: Pack| {
        let model = SimModel::mapped(map.clone(), curve(), pack, 0.0).unwrap();
        let factor = f64::from(pack.parallel);
        let rows = rows(
            Demand::Current,
            Interpolation::Hold,
            &[(0.0, 0.0), (1.0, 6.0 * factor), (30.0, 0.0)],
        );
        let start = model.rest(0.6).unwrap();
        let trace = simulate(&model, &start, &rows, &SimOptions::default())
            .unwrap()
            .trace;
        let band = RunBand::new(&model, &trace, Demand::Current, RunError::Map, 0.0);
        (trace, band)
    };
    let run = |map: &CellMap, pack: Pack| run_band(map, pack).0;
    let cell = Pack::new(1, 1, 0.0).unwrap();
    assert!(run(&map, cell).cell_sigma_v.is_empty());
    map.voltage_error = Some(stated);
    let trace = run(&map, cell);
    assert_eq!(trace.cell_sigma_v.len(), trace.time_s.len());
    assert_eq!(trace.temperature_degc, vec![0.0; trace.time_s.len()]);
    for k in 0..trace.time_s.len() {
        // At 0 °C, a node, the overpotential is wrong by 20 %.
        let overpotential_v = trace.ocv_v[k] - trace.cell_v[k];
        let expected = (0.004_f64.powi(2)
            + (0.01 * curve().slope_v(trace.soc[k])).powi(2)
            + (0.2 * overpotential_v).powi(2))
        .sqrt();
        assert!((trace.cell_sigma_v[k] - expected).abs() < 1e-12, "row {k}");
    }
    let most = trace.cell_sigma_v.iter().copied().fold(0.0, f64::max);
    assert!(most > 0.015, "{most}");
    // The fastest branch is wrong by half of itself at once, and right when it has settled.
    let mut continued = map.clone();
    continued.branches[0].extrapolated = true;
    let at = map.place(trace.soc[0], 0.0);
    let lacking_v = 6.0 * map.resistance_ohm(&map.branches[0].resistance, &at);
    let after_jump = trace.current_a.iter().position(|i| *i > 5.0).unwrap();
    let with = run(&continued, cell).cell_sigma_v;
    let jump_v = trace.cell_sigma_v[after_jump].hypot(0.5 * lacking_v);
    assert!(
        (with[after_jump] - jump_v).abs() < 1e-5,
        "{jump_v} {with:?}"
    );
    let last = trace.current_a.iter().rposition(|i| *i > 5.0).unwrap();
    assert!(last > after_jump);
    assert!((with[last] - trace.cell_sigma_v[last]).abs() < 1e-9);
    // The band of the run, √χ²₄ standard deviations, with what the currents of a pack divide.
    continued.charge_transfer = Some(ChargeTransfer {
        voltage_v: 0.02,
        slowest_s: 3.0,
    });
    let mut widened = continued.clone();
    widened.voltage_error.as_mut().unwrap().whole_runs = Some(1.5);
    let (trace, band) = run_band(&widened, cell);
    let half_v = band.unwrap().half_v;
    let own_v = |k: usize| {
        let slope_v = curve().slope_v(trace.soc[k]);
        let loss_v = trace.ocv_v[k] - trace.cell_v[k];
        map.sigma_v(&map.place(trace.soc[k], 0.0), slope_v, loss_v)
            .unwrap()
    };
    let values = widened.values(trace.soc[after_jump], 0.0, &mut [0.0; 4]);
    let settled_v = values
        .drive(widened.branches[0].tau_s, lacking_v / 6.0, 6.0)
        .settled_v();
    let jump_v = 3.080_2 * (1.5 * own_v(after_jump)).hypot(0.5 * settled_v);
    assert!(
        (half_v[after_jump] - jump_v).abs() < 1e-5,
        "{jump_v} {half_v:?}"
    );
    // Later the fast branches have fallen by Butler–Volmer's law.
    let straight_v = 3.080_2 * 1.5 * own_v(last);
    assert!(
        half_v[last] > 1.000_1 * straight_v,
        "{straight_v} {half_v:?}"
    );
    // All cells of a pack are wrong in the same direction.
    let (pack, pack_band) = run_band(&widened, Pack::new(16, 3, 0.05).unwrap());
    for (one, many) in trace.cell_sigma_v.iter().zip(&pack.cell_sigma_v) {
        assert!((one - many).abs() < 1e-9, "{one} {many}");
    }
    for (one, many) in half_v.iter().zip(&pack_band.unwrap().half_v) {
        assert!((one - many).abs() < 1e-9, "{one} {many}");
    }
}
