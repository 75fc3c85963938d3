use super::*;
use crate::forward::{Interpolation, Method, Profile, SimModel, SimOptions, simulate};
use analysis_model::{model::RcBranch, ocv::OcvCurve, pack::Pack};
use proptest::prelude::*;

/// No heat leaves a cell of 66.5 J/K.
const THERMAL: PackThermal = PackThermal {
    ambient_degc: 25.0,
    capacity_j_per_k: 66.5,
    held: false,
    path_w_per_k: 0.0,
    side_share: 0.0,
    neighbour_w_per_k: 0.0,
    busbar_w_per_k: 0.0,
};

fn erm() -> Erm {
    let branch = |r_ohm, tau: f64| RcBranch {
        r_ohm,
        c_f: tau / r_ohm,
    };
    Erm {
        r_ohm: 0.007,
        branches: vec![
            branch(0.001, 0.004),
            branch(0.0015, 0.1),
            branch(0.003, 6.0),
        ],
    }
}

fn curve() -> OcvSource {
    OcvSource::Curve(
        OcvCurve::monotone(
            4.2,
            vec![0.0, 0.1, 0.3, 0.6, 1.0],
            vec![2.5, 3.2, 3.5, 3.8, 4.2],
        )
        .unwrap(),
    )
}

fn power(t: f64) -> f64 {
    1500.0 + 2000.0 * (0.7 * t).sin()
}

/// Returns cells whose parameters differ by a factor drawn from the list.
fn uneven(factors: &[f64]) -> Vec<Cell> {
    let cell = |f: &f64| {
        let mut erm = erm();
        erm.r_ohm *= f;
        erm.branches.iter_mut().for_each(|b| b.r_ohm *= f * f);
        Cell {
            erm,
            capacity_ratio: 2.0 - f,
            soc: 0.5 + 0.02 * (f - 1.0),
        }
    };
    factors.iter().map(cell).collect()
}

#[test]
fn identical_cells_are_the_pack_model() {
    let pack = Pack::new(16, 3, 0.03).unwrap();
    let (ocv, cell) = (
        curve(),
        Cell {
            erm: erm(),
            capacity_ratio: 1.0,
            soc: 0.6,
        },
    );
    let wiring = Wiring {
        parallel: 3,
        links: None,
        tab_ohm: 0.0,
        interconnect_ohm: 0.03,
    };
    let mut network = Network::new(&vec![cell; 48], &ocv, wiring, &THERMAL);
    let rows: Vec<(f64, f64)> = (0..=4000)
        .map(|k| f64::from(k) * 0.0025)
        .map(|t| (t, power(t)))
        .collect();
    let profile = Profile::new("test", Demand::Power, Interpolation::Linear, &rows).unwrap();
    let model = SimModel::pack(&erm(), ocv.clone(), pack).unwrap();
    let options = SimOptions {
        method: Method::Exact,
        ..SimOptions::default()
    };
    let expected = simulate(&model, &model.rest(0.6).unwrap(), &profile, &options).unwrap();
    network.look(Demand::Power, rows[0].1);
    let mut worst = (network.now.ccv_v - expected.trace.ccv_v[0]).abs();
    for (k, row) in rows.iter().enumerate().skip(1) {
        assert!(network.advance(row.0 - rows[k - 1].0, Demand::Power, row.1));
        assert_eq!(expected.trace.time_s[k], row.0);
        worst = worst.max((network.now.ccv_v - expected.trace.ccv_v[k]).abs());
        let fair = network.now.current_a / 3.0;
        assert!(network.now.cell_a.iter().all(|i| (i - fair).abs() < 1e-10));
    }
    // Both are second order in the step; 2.5 ms leave microvolts of 60 V.
    assert!(worst < 2e-4, "{worst} V");
    assert!((network.soc[0] - expected.end.soc).abs() < 1e-8);
}

/// Returns the largest difference to the error-controlled simulation of the pack when the
/// straight pieces of a zigzag are taken in this many steps each.
fn error_v(parts: u32) -> f64 {
    // 0.2 Ah, so that the state of charge moves the voltage as much as the branches do.
    let ocv = OcvSource::Curve(OcvCurve::monotone(0.2, vec![0.0, 1.0], vec![3.0, 4.2]).unwrap());
    let rows: Vec<(f64, f64)> = (0..=20)
        .map(|k| (0.4 * f64::from(k), if k % 2 == 0 { 500.0 } else { 2500.0 }))
        .collect();
    let profile = Profile::new("zigzag", Demand::Power, Interpolation::Linear, &rows).unwrap();
    let model = SimModel::pack(&erm(), ocv.clone(), Pack::new(16, 3, 0.03).unwrap()).unwrap();
    let options = SimOptions {
        tolerance_v: 1e-10,
        ..SimOptions::default()
    };
    let expected = simulate(&model, &model.rest(0.9).unwrap(), &profile, &options).unwrap();
    let cell = Cell {
        erm: erm(),
        capacity_ratio: 1.0,
        soc: 0.9,
    };
    let mut network = Network::new(
        &vec![cell; 48],
        &ocv,
        Wiring {
            parallel: 3,
            links: None,
            tab_ohm: 0.0,
            interconnect_ohm: 0.03,
        },
        &THERMAL,
    );
    network.look(Demand::Power, rows[0].1);
    let mut worst = 0.0_f64;
    for (k, pair) in rows.windows(2).enumerate() {
        for part in 1..=parts {
            let power = pair[0].1 + (pair[1].1 - pair[0].1) * f64::from(part) / f64::from(parts);
            assert!(network.advance(0.4 / f64::from(parts), Demand::Power, power));
        }
        worst = worst.max((network.now.ccv_v - expected.trace.ccv_v[k + 1]).abs());
    }
    worst
}

#[test]
fn halving_the_step_quarters_the_error() {
    let (coarse, middle, fine) = (error_v(8), error_v(16), error_v(32));
    assert!(
        coarse / middle > 3.6 && middle / fine > 3.6,
        "{coarse} V, {middle} V, {fine} V"
    );
    // Even steps of 50 ms are within a millivolt of some 55 V.
    assert!(coarse < 1e-3, "{coarse} V");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn kirchhoff_and_energy(
        factors in prop::collection::vec(0.7..1.3f64, 12),
        (parallel, tab, per_group) in (
            prop::sample::select(vec![1usize, 2, 3, 4, 6, 12]),
            0.0..0.002f64,
            0.0..0.001f64,
        ),
        share in 0.2..0.9f64,
    ) {
        let (ocv, cells) = (curve(), uneven(&factors));
        let interconnect = per_group * (12 / parallel) as f64;
        let mut network = Network::new(
            &cells,
            &ocv,
            Wiring {
                parallel,
                links: None,
                tab_ohm: tab,
                interconnect_ohm: interconnect,
            },
            &THERMAL,
        );
        let (mut chemical, mut delivered, mut lost) = (0.0, 0.0, 0.0);
        let step = 5e-4;
        let mut before: Option<[f64; 3]> = None;
        for k in 0..=4000 {
            // 12 cells of 3.6 V behind at most 21 mΩ and 12 mΩ of busbar could give 1.1 kW. The
            // start is at rest: no jump for the trapezoids to miss.
            let demand_w = share * 500.0 * (f64::from(k) * step * 2.0).sin();
            let sound = if k == 0 {
                network.look(Demand::Power, demand_w)
            } else {
                network.advance(step, Demand::Power, demand_w)
            };
            prop_assert!(sound);
            let now = &network.now;
            prop_assert!(!now.infeasible);
            prop_assert!((now.ccv_v * now.current_a - demand_w).abs() < 1e-9);
            let mut terminal = -now.current_a * interconnect;
            for (currents, voltages) in
                now.cell_a.chunks(parallel).zip(now.cell_v.chunks(parallel))
            {
                prop_assert!(
                    (currents.iter().sum::<f64>() - now.current_a).abs()
                        < 1e-11 * (1.0 + now.current_a.abs())
                );
                let bus: Vec<f64> = currents
                    .iter()
                    .zip(voltages)
                    .map(|(i, v)| v - tab * i)
                    .collect();
                prop_assert!(bus.iter().all(|v| (v - bus[0]).abs() < 1e-12 * 4.0));
                terminal += bus[0];
            }
            prop_assert!((terminal - now.ccv_v).abs() < 1e-12 * 50.0);
            let work = now
                .cell_a
                .iter()
                .zip(&network.soc)
                .map(|(i, z)| i * network.ocv_at(*z).0)
                .sum::<f64>();
            let copper = now.current_a.powi(2) * interconnect
                + now.cell_a.iter().map(|i| i * i * tab).sum::<f64>();
            let rates = [work, demand_w, copper + now.heat_w.iter().sum::<f64>()];
            if let Some(old) = before {
                chemical += 0.5 * step * (old[0] + rates[0]);
                delivered += 0.5 * step * (old[1] + rates[1]);
                lost += 0.5 * step * (old[2] + rates[2]);
            }
            before = Some(rates);
        }
        let missing = chemical - delivered - lost - network.stored_j();
        prop_assert!(
            missing.abs() < 2e-4 * chemical.abs().max(delivered.abs()).max(lost),
            "{missing} J of {chemical} J"
        );
    }
}
