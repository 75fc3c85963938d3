use super::*;

fn surface(rows: &[[f64; 3]]) -> Surface {
    Surface {
        activation_j_per_mol: 30e3,
        r_ohm: rows.iter().map(|row| row.to_vec()).collect(),
        sigma_ohm: Vec::new(),
    }
}

fn map() -> CellMap {
    CellMap {
        soc: vec![0.1, 0.5, 0.9],
        temperature_degc: vec![0.0, 25.0],
        series: surface(&[[0.04, 0.03, 0.032], [0.02, 0.015, 0.016]]),
        branches: vec![MapBranch {
            extrapolated: false,
            tau_s: 10.0,
            resistance: surface(&[[0.02, 0.01, 0.0], [0.01, 0.005, 0.0]]),
        }],
        ocv_offset_v: vec![0.01, 0.0, -0.01],
        ocv_v_per_k: vec![0.0, 1e-4, 2e-4],
        ocv_temperature_degc: 25.0,
        most_current_a: None,
        charge_transfer: None,
        thermal: None,
        voltage_error: None,
    }
}

#[test]
fn a_map_meets_its_nodes_and_is_linear_in_soc_between_them() {
    let map = map();
    map.validate().unwrap();
    let series = |soc, degc| map.resistance_ohm(&map.series, &map.place(soc, degc));
    for (j, degc) in [0.0, 25.0].into_iter().enumerate() {
        for (k, soc) in [0.1, 0.5, 0.9].into_iter().enumerate() {
            assert!((series(soc, degc) - map.series.r_ohm[j][k]).abs() < 1e-15);
        }
    }
    assert!((series(0.3, 25.0) - 0.0175).abs() < 1e-15);
}

/// Expected values by hand: exp(30000/8.314462618·(1/263.15 − 1/273.15)) = 1.651980.
#[test]
fn beyond_the_nodes_a_resistance_follows_arrhenius_and_the_distance_is_stated() {
    let map = map();
    let at = map.place(0.05, -10.0);
    assert!((map.resistance_ohm(&map.series, &at) / 0.04 - 1.651_980).abs() < 1e-5);
    assert!((at.outside.soc - 0.05).abs() < 1e-12);
    assert!((at.outside.temperature_k - 10.0).abs() < 1e-12);
    let inside = map.place(0.4, 12.0);
    assert_eq!(inside.outside, Outside::default());
}

#[test]
fn weights_are_the_resistance() {
    let map = map();
    for (soc, degc) in [(0.3, 12.0), (0.95, 30.0), (0.0, -20.0), (0.5, 25.0)] {
        let at = map.place(soc, degc);
        let sum: f64 = map
            .weights(&at, 30e3)
            .iter()
            .map(|(j, k, w)| w * map.series.r_ohm[*j][*k])
            .sum();
        assert!((sum - map.resistance_ohm(&map.series, &at)).abs() < 1e-15);
    }
}

#[test]
fn one_temperature_is_a_map_by_arrhenius_alone() {
    let mut one = map();
    one.temperature_degc = vec![25.0];
    for s in [&mut one.series, &mut one.branches[0].resistance] {
        s.r_ohm.remove(0);
    }
    one.validate().unwrap();
    let r = |degc| one.resistance_ohm(&one.series, &one.place(0.5, degc));
    assert!((r(25.0) - 0.015).abs() < 1e-15 && r(0.0) > 0.03 && r(40.0) < 0.01);
}

#[test]
fn the_correction_of_the_ocv_follows_soc_and_temperature() {
    let map = map();
    let at = map.place(0.7, 15.0);
    assert!((map.ocv_correction_v(&at, 15.0) - (-0.005 - 10.0 * 1.5e-4)).abs() < 1e-15);
}

#[test]
fn what_is_not_a_map_is_refused_by_field() {
    type Break = fn(&mut CellMap);
    let cases: [(Break, &str); 9] = [
        (|m| m.soc = vec![0.5], "soc: expected 2 values"),
        (|m| m.soc[1] = 0.1, "soc[1]"),
        (
            |m| m.temperature_degc = vec![273.15, 298.15],
            "temperature_degc[0]: expected temperatures from -60 to 120 °C that rise (not kelvin), met 273.15",
        ),
        (
            |m| m.temperature_degc = vec![25.0, 25.0],
            "temperature_degc[1]",
        ),
        (
            |m| m.series.r_ohm[0][1] = -0.01,
            "series.r_ohm[0]: expected ohms, zero or more",
        ),
        (
            |m| m.series.r_ohm[0][1] = 0.0,
            "series.r_ohm: expected ohms above zero",
        ),
        (
            |m| m.branches[0].resistance.r_ohm[1].truncate(2),
            "branches[0].resistance.r_ohm[1]: expected 3",
        ),
        (|m| m.branches[0].tau_s = 0.0, "branches[0].tau_s"),
        (
            |m| {
                m.thermal = Some(Thermal {
                    capacity_j_per_k: 0.0,
                    resistance_k_per_w: 1.0,
                });
            },
            "thermal.capacity_j_per_k",
        ),
    ];
    for (damage, text) in cases {
        let mut broken = map();
        damage(&mut broken);
        let message = broken.validate().unwrap_err().to_string();
        assert!(message.contains(text), "{text}: {message}");
    }
}

/// Expected values by hand: 0.12 V over 15 mΩ and 5 mΩ is 2·3 A at 25 °C; at 5 °C the thermal voltage is
/// 278.15/298.15 of that, and the exchange current of 20 mΩ 2.7988 A; 2·3·asinh(10/6) = 7.7028.
#[test]
fn charge_transfer_bends_the_current_of_fast_branches() {
    let law = ChargeTransfer {
        voltage_v: 0.12,
        slowest_s: 20.0,
    };
    assert!((law.exchange_a(0.02, 25.0) - 3.0).abs() < 1e-12);
    assert!((law.exchange_a(0.02, 5.0) - 2.7988).abs() < 1e-4);
    let mut map = map();
    map.charge_transfer = Some(law);
    let fast = MapBranch {
        extrapolated: false,
        tau_s: 0.5,
        resistance: surface(&[[0.015; 3]; 2]),
    };
    map.branches.insert(0, fast);
    map.validate().unwrap();
    assert_eq!(map.transfer_count(), 2);
    let drive = |tau_s: f64, current_a: f64| {
        let values = map.values(0.5, 25.0, &mut [0.0; 2]);
        values.drive(tau_s, 0.01, current_a)
    };
    assert_eq!(drive(50.0, 10.0), Drive::new(None, 0.01, 10.0));
    assert_eq!(drive(0.5, 10.0), Drive::new(Some(3.0), 0.01, 10.0));
    // A steady branch has the voltage b·asinh(i/(2·i₀)), and loses that times the current.
    for (current_a, v) in [(10.0, 0.077_027_74), (1e-3, 1e-5), (-3000.0, -0.414_465_38)] {
        let fast = drive(0.5, current_a);
        assert!(
            (fast.leaking_v(v) / fast.driven_v - 1.0).abs() < 1e-6,
            "{fast:?}"
        );
        assert!((fast.lost_w(v, 0.01) / (current_a * v) - 1.0).abs() < 1e-6);
    }
    assert!((drive(50.0, 10.0).lost_w(0.1, 0.01) - 1.0).abs() < 1e-12);
    map.charge_transfer = Some(ChargeTransfer {
        voltage_v: 0.0,
        ..law
    });
    let message = map.validate().unwrap_err().to_string();
    assert!(message.contains("charge_transfer.voltage_v"), "{message}");
}

#[test]
fn values_are_those_of_each_surface_and_of_the_law() {
    let mut map = map();
    map.series.activation_j_per_mol = 15e3;
    map.charge_transfer = Some(ChargeTransfer {
        voltage_v: 0.06,
        slowest_s: 3.0,
    });
    for (tau_s, rows) in [
        (2.0, [[0.012, 0.006, 0.0], [0.004, 0.002, 0.0]]),
        (1.0, [[0.002, 0.006, 0.003], [0.001, 0.002, 0.0]]),
    ] {
        let resistance = surface(&rows);
        map.branches.insert(
            0,
            MapBranch {
                extrapolated: false,
                tau_s,
                resistance,
            },
        );
    }
    assert_eq!(map.transfer_count(), 2);
    let mut ohm = [0.0; 3];
    for (soc, degc) in [(0.3, 12.0), (0.95, 30.0), (0.0, -20.0), (0.5, 25.0)] {
        let (values, at) = (map.values(soc, degc, &mut ohm), map.place(soc, degc));
        assert_eq!(values.r_ohm, map.resistance_ohm(&map.series, &at));
        assert_eq!(values.correction_v, map.ocv_correction_v(&at, degc));
        assert_eq!(values.outside, at.outside);
        for (branch, ohm) in map.branches.iter().zip(&ohm) {
            assert_eq!(*ohm, map.resistance_ohm(&branch.resistance, &at));
        }
        // Each branch of charge transfer has its share of 60 mV; at least 10 µΩ count.
        let twice_a = 0.06 * (degc + 273.15) / 298.15 / (ohm[0] + ohm[1]).max(1e-5);
        for (branch, ohm) in map.branches.iter().zip(&ohm) {
            let met_v = values.drive(branch.tau_s, *ohm, 1.0).bend_v;
            if branch.tau_s <= 3.0 {
                assert!(
                    (met_v / (twice_a * ohm.max(1e-5)) - 1.0).abs() < 1e-12,
                    "{met_v}"
                );
            } else {
                assert!(met_v.is_infinite());
            }
        }
    }
}

#[test]
fn a_current_beyond_the_logs_is_named() {
    let mut map = map();
    assert_eq!(map.current_remark(1e3), None, "no log, no range");
    map.most_current_a = Some(9.0);
    map.validate().unwrap();
    assert_eq!(map.current_remark(-9.0), None);
    let remark = map.current_remark(-40.0).unwrap();
    assert!(
        remark.contains("up to 40.0 A, the logs of the map 9.0 A"),
        "{remark}"
    );
    map.most_current_a = Some(0.0);
    assert!(map.validate().is_err());
}
