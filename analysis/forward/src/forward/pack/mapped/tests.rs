use super::*;
use crate::forward::pack::network::{Cell, Network};
use crate::forward::{Interpolation, OcvSource, Profile, SimModel, SimOptions, simulate};
use analysis_model::{
    map::{ChargeTransfer, MapBranch, Surface, Thermal},
    pack::Pack,
};

fn curve() -> OcvCurve {
    OcvCurve::monotone(
        3.0,
        vec![0.0, 0.1, 0.3, 0.6, 1.0],
        vec![2.6, 3.2, 3.5, 3.8, 4.2],
    )
    .unwrap()
}

/// Resistances that double at low charge and triple in the cold.
fn map() -> CellMap {
    let surface = |r_ohm: f64, activation_j_per_mol: f64| Surface {
        activation_j_per_mol,
        r_ohm: vec![
            vec![6.0 * r_ohm, 3.0 * r_ohm, 3.0 * r_ohm],
            vec![2.0 * r_ohm, r_ohm, r_ohm],
        ],
        sigma_ohm: Vec::new(),
    };
    let branch = |tau_s, r_ohm| MapBranch {
        extrapolated: false,
        tau_s,
        resistance: surface(r_ohm, 35e3),
    };
    CellMap {
        soc: vec![0.1, 0.5, 0.9],
        temperature_degc: vec![0.0, 25.0],
        series: surface(0.018, 15e3),
        branches: vec![branch(0.8, 0.01), branch(20.0, 0.012)],
        ocv_offset_v: vec![0.01, 0.0, -0.01],
        ocv_v_per_k: vec![1e-4, 0.0, -1e-4],
        ocv_temperature_degc: 25.0,
        most_current_a: None,
        charge_transfer: Some(ChargeTransfer {
            voltage_v: 0.06,
            slowest_s: 3.0,
        }),
        thermal: Some(Thermal {
            capacity_j_per_k: 40.0,
            resistance_k_per_w: 5.0,
        }),
        voltage_error: None,
    }
}

/// The path and the capacity of the map.
fn thermal(ambient_degc: f64) -> PackThermal {
    PackThermal {
        path_w_per_k: 0.2,
        ..PackThermal::adiabatic(ambient_degc, 40.0)
    }
}

fn cell(r: f64, soc: f64) -> MappedCell {
    MappedCell {
        r,
        rk: vec![r; 2],
        tau: vec![1.0; 2],
        capacity_ratio: 1.0,
        soc,
    }
}

fn wiring(parallel: usize) -> Wiring<'static> {
    Wiring {
        parallel,
        links: None,
        tab_ohm: 0.0,
        interconnect_ohm: 0.0,
    }
}

fn profile(demand: Demand, rows: &[(f64, f64)]) -> Profile {
    Profile::new("load", demand, Interpolation::Hold, rows).unwrap()
}

/// Runs a profile in steps of equal parts of its pieces; returns the voltages before and after each.
fn play(cells: &mut dyn Cells, profile: &Profile, max_step_s: f64, parts: u32) -> Vec<f64> {
    let (mut last, mut ccv_v) = (None, Vec::new());
    for piece in profile.pieces(max_step_s) {
        if last != Some(piece.from) {
            assert!(cells.look(profile.demand, piece.from));
            ccv_v.push(cells.now().ccv_v);
        }
        last = Some(piece.to);
        for part in 1..=parts {
            let demand = piece.from + (piece.to - piece.from) * f64::from(part) / f64::from(parts);
            assert!(cells.advance(piece.step_s / f64::from(parts), profile.demand, demand));
        }
        ccv_v.push(cells.now().ccv_v);
    }
    ccv_v
}

/// Pieces no longer than the first step of `simulate`, so that both take the same steps.
#[test]
fn a_pack_of_one_cell_is_the_single_cell() {
    let rows = [
        (0.0, 30.0),
        (30.0, 4.0),
        (50.0, -12.0),
        (70.0, 45.0),
        (110.0, 2.0),
        (130.0, 2.0),
    ];
    for (demand, ambient_degc) in [
        (Demand::Power, 10.0),
        (Demand::Current, -3.0),
        (Demand::Power, 30.0),
    ] {
        let scale = if demand == Demand::Power { 1.0 } else { 0.25 };
        let profile = profile(demand, &rows).scaled(scale);
        let (map, curve, thermal) = (map(), curve(), thermal(ambient_degc));
        let one = Pack::new(1, 1, 0.0).unwrap();
        let model = SimModel::mapped(map.clone(), curve.clone(), one, ambient_degc).unwrap();
        let options = SimOptions {
            max_step_s: 0.2,
            ..SimOptions::default()
        };
        let start = model.rest(0.7).unwrap();
        let expected = simulate(&model, &start, &profile, &options).unwrap();
        let parts = expected.summary.steps / profile.pieces(0.2).count() as u64;
        let common = Common {
            map: &map,
            curve: &curve,
            wiring: wiring(1),
            thermal: &thermal,
        };
        let mut network = MapNetwork::new(vec![cell(1.0, 0.7)], common);
        let met = play(&mut network, &profile, 0.2, parts as u32);
        assert_eq!(met.len(), expected.trace.ccv_v.len());
        let apart = met.iter().zip(&expected.trace.ccv_v);
        let worst = apart.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        assert!(worst < 1e-9, "{demand:?}: {worst:e} V in {parts} parts");
        let degc = expected.end.temperature_degc.unwrap();
        let met_degc = network.thermal.degc(0);
        assert!((met_degc - degc).abs() < 1e-8, "{:e}", met_degc - degc);
        assert!(degc > ambient_degc + 3.0, "{degc}");
        let (left, outside) = (
            network.left().unwrap(),
            expected.summary.outside_map.unwrap(),
        );
        assert!((left.temperature_k - outside.temperature_k).abs() < 1e-8);
        // The step of the command: 65 ms instead of 25 to 100 ms.
        let mut coarse = MapNetwork::new(vec![cell(1.0, 0.7)], common);
        let met = play(&mut coarse, &profile, 0.2, 3);
        let apart = met.iter().zip(&expected.trace.ccv_v);
        let worst = apart.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        assert!(worst < 1e-4, "{worst:e} V");
    }
}

#[test]
fn equal_cells_in_parallel_are_one_cell_at_their_part_of_the_current() {
    let (map, curve, thermal) = (map(), curve(), thermal(5.0));
    let rows = [(0.0, 8.0), (20.0, -3.0), (40.0, 12.0), (60.0, 0.0)];
    let common = |parallel| Common {
        map: &map,
        curve: &curve,
        wiring: wiring(parallel),
        thermal: &thermal,
    };
    let mut one = MapNetwork::new(vec![cell(1.0, 0.6)], common(1));
    let mut five = MapNetwork::new(vec![cell(1.0, 0.6); 5], common(5));
    let single = play(&mut one, &profile(Demand::Current, &rows), 0.5, 1);
    let whole = profile(Demand::Current, &rows).scaled(5.0);
    let shared = play(&mut five, &whole, 0.5, 1);
    for (a, b) in single.iter().zip(&shared) {
        assert!((a - b).abs() < 1e-10, "{a} {b}");
    }
    for k in 0..5 {
        assert!((five.now.cell_a[k] - one.now.cell_a[0]).abs() < 1e-10);
        assert!((five.thermal.degc(k) - one.thermal.degc(0)).abs() < 1e-10);
        assert!((five.soc()[k] - one.soc()[0]).abs() < 1e-13);
    }
}

/// At the first instant the branches are empty: currents are as the conductances, 1/(R + tab).
#[test]
fn the_first_shares_are_those_of_kirchhoff() {
    let (map, curve, thermal) = (map(), curve(), thermal(25.0));
    let common = Common {
        map: &map,
        curve: &curve,
        wiring: Wiring {
            tab_ohm: 0.002,
            ..wiring(3)
        },
        thermal: &thermal,
    };
    let cells = [0.5, 1.0, 2.0].map(|r| cell(r, 0.5));
    let mut network = MapNetwork::new(cells.to_vec(), common);
    assert!(network.look(Demand::Current, 30.0));
    // 18 mΩ at 25 °C and half charge.
    let conductance = [0.5, 1.0, 2.0].map(|r| 1.0 / (0.018 * r + 0.002));
    let sum: f64 = conductance.iter().sum();
    for (met, g) in network.now.cell_a.iter().zip(conductance) {
        assert!((met - 30.0 * g / sum).abs() < 1e-10, "{met}");
    }
    // Later they settle where the whole resistances and the states of charge balance: the strong
    // cell has given more charge.
    for _ in 0..2000 {
        assert!(network.advance(0.1, Demand::Current, 30.0));
        let current_a: f64 = network.now.cell_a.iter().sum();
        assert!((current_a - 30.0).abs() < 1e-9);
        let at_busbar = network.now.cell_a.iter().zip(&network.now.cell_v);
        for (i, v) in at_busbar {
            assert!((v - 0.002 * i - network.now.ccv_v).abs() < 1e-12 * 4.0);
        }
    }
    let soc = network.soc();
    assert!(soc[0] < soc[1] && soc[1] < soc[2], "{soc:?}");
    assert!(network.thermal.degc(0) > network.thermal.degc(2) + 1.0);
}

/// A map whose nodes are equal and do not follow temperature is a model of one point.
#[test]
fn a_map_of_equal_nodes_is_the_model_of_one_point_for_cells_that_differ() {
    let mut map = map();
    let surfaces = map.branches.iter_mut().map(|branch| &mut branch.resistance);
    for surface in surfaces.chain([&mut map.series]) {
        surface.activation_j_per_mol = 0.0;
        surface.r_ohm = vec![vec![surface.r_ohm[1][1]; 3]; 2];
    }
    (map.ocv_offset_v, map.ocv_v_per_k) = (vec![0.0; 3], vec![0.0; 3]);
    map.charge_transfer = None;
    let (curve, thermal) = (curve(), thermal(15.0));
    let erm = map.model_at(0.4, 40.0);
    let ocv = OcvSource::Curve(curve.clone());
    let wiring = Wiring {
        parallel: 3,
        links: None,
        tab_ohm: 0.001,
        interconnect_ohm: 0.004,
    };
    let factors = [0.8, 1.0, 1.3, 1.1, 0.95, 1.05];
    let mapped = factors.map(|f: f64| MappedCell {
        r: f,
        rk: vec![f, 1.0 / f],
        tau: vec![f * f, 1.0],
        capacity_ratio: 2.0 - f,
        soc: 0.5,
    });
    let plain = factors.map(|f: f64| {
        let mut erm = erm.clone();
        erm.r_ohm *= f;
        erm.branches[0].r_ohm *= f;
        erm.branches[0].c_f *= f;
        erm.branches[1].r_ohm /= f;
        erm.branches[1].c_f *= f;
        Cell {
            erm,
            capacity_ratio: 2.0 - f,
            soc: 0.5,
        }
    });
    let common = Common {
        map: &map,
        curve: &curve,
        wiring,
        thermal: &thermal,
    };
    let mut a = MapNetwork::new(mapped.to_vec(), common);
    let mut b = Network::new(&plain, &ocv, wiring, &thermal);
    let load = profile(
        Demand::Power,
        &[(0.0, 120.0), (15.0, -40.0), (30.0, 200.0), (60.0, 0.0)],
    );
    let (met, expected) = (play(&mut a, &load, 0.25, 1), play(&mut b, &load, 0.25, 1));
    for (a, b) in met.iter().zip(&expected) {
        assert!((a - b).abs() < 1e-7, "{a} {b}");
    }
    for k in 0..6 {
        assert!((a.now().cell_a[k] - b.now().cell_a[k]).abs() < 1e-5);
        assert!((a.thermal().degc(k) - b.thermal().degc(k)).abs() < 1e-5);
    }
}

#[test]
fn heat_of_the_load_is_stored_in_the_cells_or_lost_and_a_warm_cell_resists_less() {
    let (map, curve) = (map(), curve());
    for (path, neighbour, busbar) in [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.1, 2.0, 5.0)] {
        let thermal = PackThermal {
            path_w_per_k: path,
            neighbour_w_per_k: neighbour,
            busbar_w_per_k: busbar,
            ..thermal(0.0)
        };
        let common = Common {
            map: &map,
            curve: &curve,
            wiring: Wiring {
                parallel: 2,
                links: None,
                tab_ohm: 0.001,
                interconnect_ohm: 0.02,
            },
            thermal: &thermal,
        };
        let cells = [0.9, 1.1, 1.0, 1.2, 0.8, 1.0].map(|r| cell(r, 0.8));
        let mut network = MapNetwork::new(cells.to_vec(), common);
        assert!(network.look(Demand::Current, 8.0));
        let at_start = network.found.values[0].r_ohm;
        let (mut came_j, mut lost_j) = (0.0, 0.0);
        let mut heat_w = network.now.heat_w.iter().sum::<f64>();
        // The heat of the tabs reaches the cells in any case.
        let wires = |network: &MapNetwork<'_>| {
            let tabs_w = network
                .now
                .cell_a
                .iter()
                .map(|i| 0.001 * i * i)
                .sum::<f64>();
            let joint_w = 0.02 * network.now.current_a.powi(2);
            tabs_w + if busbar > 0.0 { joint_w } else { 0.0 }
        };
        heat_w += wires(&network);
        for _ in 0..1200 {
            assert!(network.advance(0.5, Demand::Current, 8.0));
            let now_w = network.now.heat_w.iter().sum::<f64>() + wires(&network);
            came_j += 0.25 * (heat_w + now_w);
            lost_j += 0.5 * network.thermal.lost_w();
            heat_w = now_w;
        }
        assert_eq!(network.unsettled(), 0);
        let stored_j = 40.0 * network.thermal.over_k().iter().sum::<f64>();
        assert!(
            (came_j - lost_j - stored_j).abs() < 1e-9 * came_j,
            "{came_j} {lost_j} {stored_j}"
        );
        assert!(network.found.values[0].r_ohm < 0.95 * at_start);
    }
}

/// A cell with twice the resistance has half the exchange current: at half the current it is half as
/// bent, and each of its branches has the voltage of the other cell.
#[test]
fn the_factor_of_a_resistance_of_charge_transfer_divides_its_exchange_current() {
    let (map, curve) = (map(), curve());
    let thermal = PackThermal {
        held: true,
        ..thermal(25.0)
    };
    let common = Common {
        map: &map,
        curve: &curve,
        wiring: wiring(1),
        thermal: &thermal,
    };
    let [weak, strong] = [(2.0, 10.0), (1.0, 20.0)].map(|(factor, current_a)| {
        let mut cell = cell(factor, 0.5);
        // Both move by the same state of charge.
        cell.capacity_ratio = 1.0 / factor;
        let mut network = MapNetwork::new(vec![cell], common);
        assert!(network.look(Demand::Current, current_a));
        for _ in 0..50 {
            assert!(network.advance(0.2, Demand::Current, current_a));
        }
        network
    });
    for (a, b) in weak.end.v.iter().zip(&strong.end.v) {
        assert!((a - b).abs() < 1e-9 * b, "{a} {b}");
    }
    // 10 mΩ at 20 A, far below 0.2 V because the law bends it.
    assert!(strong.end.v[0] < 0.15, "{}", strong.end.v[0]);
    assert!((2.0 * weak.now.heat_w[0] / strong.now.heat_w[0] - 1.0).abs() < 1e-9);
    assert!(weak.thermal.degc(0) == 25.0 && weak.now.heat_w[0] > 0.0);
}

/// Two uneven cells that conduct heat to each other, with the whole map: second order.
#[test]
fn halved_steps_quarter_the_error_of_uneven_cells_that_conduct() {
    let (map, curve) = (map(), curve());
    let thermal = PackThermal {
        neighbour_w_per_k: 0.5,
        busbar_w_per_k: 0.2,
        ..thermal(5.0)
    };
    let common = Common {
        map: &map,
        curve: &curve,
        wiring: Wiring {
            tab_ohm: 0.001,
            interconnect_ohm: 0.005,
            ..wiring(2)
        },
        thermal: &thermal,
    };
    // A ramp: at a jump of the current the branches are driven by a line and not by a step.
    let end = |steps: u32| {
        let mut network = MapNetwork::new(vec![cell(0.7, 0.7), cell(1.4, 0.7)], common);
        assert!(network.look(Demand::Current, 4.0));
        for step in 1..=steps {
            let part = f64::from(step) / f64::from(steps);
            assert!(network.advance(60.0 / f64::from(steps), Demand::Current, 4.0 + 6.0 * part));
        }
        assert_eq!(network.unsettled(), 0);
        let now = network.now();
        [
            now.ccv_v,
            now.cell_a[0],
            network.thermal.degc(0),
            network.thermal.degc(1),
        ]
    };
    let (exact, coarse, fine) = (end(7680), end(240), end(480));
    let errors = |met: [f64; 4]| {
        let error = |k: usize| (met[k] - exact[k]).abs();
        [error(0), error(1), error(2).max(error(3))]
    };
    for (coarse, fine) in errors(coarse).into_iter().zip(errors(fine)) {
        assert!((3.5..5.0).contains(&(coarse / fine)), "{coarse:e} {fine:e}");
    }
    assert!(exact[2] > 6.0 && exact[2] - exact[3] > 0.05, "{exact:?}");
}
