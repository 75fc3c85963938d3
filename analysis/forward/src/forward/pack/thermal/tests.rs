use super::*;
use proptest::prelude::*;

fn network(thermal: PackThermal, series: usize, parallel: usize) -> ThermalNetwork {
    thermal.check().unwrap();
    ThermalNetwork::new(&thermal, series * parallel, parallel)
}

fn thermal() -> PackThermal {
    PackThermal {
        path_w_per_k: 0.2,
        ..PackThermal::adiabatic(20.0, 66.0)
    }
}

/// Moves by equal steps with constant heat.
fn run(network: &mut ThermalNetwork, steps: usize, step_s: f64, cell_w: &[f64]) {
    for _ in 0..steps {
        network.begin();
        let heat = Heat {
            cell_w,
            interconnect_w: 0.0,
        };
        network.end(step_s, heat);
    }
}

/// (G + g)·u₁ = g·u₂ and (G + 2g)·u₂ − 2g·u₁ = P, by hand.
#[test]
fn a_hot_spot_in_a_row_of_three_settles_where_the_linear_system_has_it() {
    for neighbour in [0.01, 0.5, 40.0] {
        for step_s in [0.5, 20.0, 5e3] {
            let thermal = PackThermal {
                neighbour_w_per_k: neighbour,
                ..thermal()
            };
            let heat = [0.0, 3.0, 0.0];
            for (series, parallel) in [(1, 3), (3, 1)] {
                let mut row = network(thermal, series, parallel);
                run(&mut row, 60 + (2e4 / step_s) as usize, step_s, &heat);
                let share = neighbour / (0.2 + neighbour);
                let middle = 3.0 / (0.2 + 2.0 * neighbour * (1.0 - share));
                for (k, expected) in [share * middle, middle, share * middle].iter().enumerate() {
                    let met = row.over_k()[k];
                    assert!(
                        (met - expected).abs() < 1e-9 * middle,
                        "{neighbour} W/K, {step_s} s: {met} {expected}"
                    );
                }
                assert!((row.degc(1) - 20.0 - middle).abs() < 1e-8);
            }
        }
    }
}

/// The difference of two cells decays with C/(G + 2g), their mean with C/G.
#[test]
fn two_cells_even_out_at_their_rate_and_halved_steps_quarter_the_error() {
    let thermal = PackThermal {
        neighbour_w_per_k: 0.9,
        ..thermal()
    };
    let error_k = |steps: u32| {
        let mut pair = network(thermal, 1, 2);
        (pair.end_k[0], pair.end_k[1]) = (10.0, 0.0);
        run(
            &mut pair,
            steps as usize,
            40.0 / f64::from(steps),
            &[0.0, 0.0],
        );
        let sum = 10.0 * f64::exp(-40.0 * 0.2 / 66.0);
        let apart = 10.0 * f64::exp(-40.0 * 2.0 / 66.0);
        (pair.end_k[0] - 0.5 * (sum + apart)).abs()
    };
    let (coarse, fine) = (error_k(10), error_k(20));
    assert!(coarse < 0.02 && coarse / fine > 3.5, "{coarse} {fine}");
}

/// 10 s are three times as long as C/g: the difference of the two decays without a change of sign, and
/// a cell that is heated alone is the hotter one.
#[test]
fn a_strongly_coupled_pair_does_not_overshoot() {
    let coupled = |neighbour, busbar| PackThermal {
        neighbour_w_per_k: neighbour,
        busbar_w_per_k: busbar,
        ..thermal()
    };
    for thermal in [coupled(20.0, 0.0), coupled(20.0, 20.0), coupled(0.0, 500.0)] {
        for (series, parallel) in [(1, 2), (2, 1), (4, 4)] {
            let cells = series * parallel;
            let mut hot = network(thermal, series, parallel);
            hot.end_k[0] = 10.0;
            let mut heated = network(thermal, series, parallel);
            let mut heat_w = vec![0.0; cells];
            heat_w[0] = 3.0;
            for _ in 0..20 {
                run(&mut hot, 1, 10.0, &vec![0.0; cells]);
                run(&mut heated, 1, 10.0, &heat_w);
                for grid in [&hot, &heated] {
                    let over = grid.over_k();
                    let fits = |k: &f64| *k > -1e-12 && over[0] > *k - 1e-9;
                    assert!(over.iter().all(fits), "{over:?}");
                    assert!(grid.settled());
                }
            }
        }
    }
    // exp(−h·2g/C) is left of the difference after a step.
    let mut pair = network(coupled(20.0, 0.0), 1, 2);
    pair.end_k[0] = 10.0;
    run(&mut pair, 1, 10.0, &[0.0; 2]);
    let apart = pair.end_k[0] - pair.end_k[1];
    let expected = 10.0 * f64::exp(-10.0 * 40.2 / 66.0);
    assert!((apart - expected).abs() < 1e-10, "{apart} {expected}");
}

#[test]
fn the_heat_of_a_busbar_flows_into_the_two_groups_that_it_joins() {
    let thermal = PackThermal {
        busbar_w_per_k: 1e-6,
        ..PackThermal::adiabatic(20.0, 50.0)
    };
    let mut groups = network(thermal, 4, 2);
    groups.begin();
    let heat = Heat {
        cell_w: &[0.0; 8],
        interconnect_w: 12.0,
    };
    groups.end(10.0, heat);
    // Three busbars with 4 W each: 1 W into each of their four cells.
    for (k, busbars) in [1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 1.0, 1.0].iter().enumerate() {
        assert!((groups.over_k()[k] - busbars * 10.0 / 50.0).abs() < 1e-6);
    }
    // The only busbar of a single group, and none that conducts.
    for (busbar, rise_k) in [(1.0, 0.6), (0.0, 0.0)] {
        let thermal = PackThermal {
            busbar_w_per_k: busbar,
            ..thermal
        };
        let mut group = network(thermal, 1, 4);
        group.begin();
        let heat = Heat {
            cell_w: &[0.0; 4],
            interconnect_w: 12.0,
        };
        group.end(10.0, heat);
        assert!(
            group
                .over_k()
                .iter()
                .all(|over| (over - rise_k).abs() < 1e-12)
        );
    }
}

#[test]
fn a_cell_in_the_middle_is_hotter_than_one_at_the_edge_and_that_than_a_corner() {
    let thermal = PackThermal {
        neighbour_w_per_k: 0.3,
        side_share: 0.8,
        ..thermal()
    };
    let mut grid = network(thermal, 3, 3);
    run(&mut grid, 300, 10.0, &[2.0; 9]);
    let over = grid.over_k();
    assert!(
        over[4] > over[1] + 0.1 && over[1] > over[0] + 0.1,
        "{over:?}"
    );
    for mirrored in [2, 6, 8] {
        assert!((over[mirrored] - over[0]).abs() < 1e-9);
    }
    // Cells that lose all through their ends are equally warm.
    let ends = PackThermal {
        side_share: 0.0,
        ..thermal
    };
    let mut grid = network(ends, 3, 3);
    run(&mut grid, 300, 10.0, &[2.0; 9]);
    assert!(grid.over_k().iter().all(|over| (over - 10.0).abs() < 2e-3));
}

/// Two of four sides are lost in the middle of a row, one at its ends.
#[test]
fn a_side_that_faces_a_neighbour_is_lost_for_the_path() {
    let thermal = PackThermal {
        side_share: 0.8,
        ..thermal()
    };
    let mut row = network(thermal, 1, 3);
    run(&mut row, 1000, 20.0, &[2.0; 3]);
    for (over, left) in row.over_k().iter().zip([0.8, 0.6, 0.8]) {
        assert!((over - 2.0 / (0.2 * left)).abs() < 1e-7, "{over}");
    }
}

#[test]
fn a_vanishing_conductance_leaves_each_cell_alone() {
    let coupled = PackThermal {
        neighbour_w_per_k: 1e-12,
        ..thermal()
    };
    let heat = [1.0, 5.0, 0.3];
    let (mut alone, mut row) = (network(thermal(), 1, 3), network(coupled, 1, 3));
    run(&mut alone, 100, 2.0, &heat);
    run(&mut row, 100, 2.0, &heat);
    for (a, b) in alone.over_k().iter().zip(row.over_k()) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}

#[test]
fn bad_values_are_refused_by_name() {
    let good = thermal();
    let cases = [
        (
            PackThermal {
                neighbour_w_per_k: -1.0,
                ..good
            },
            "conductance between neighbours: expected zero or more in W/K, met -1",
        ),
        (
            PackThermal {
                busbar_w_per_k: f64::NAN,
                ..good
            },
            "conductance to a busbar: expected zero or more in W/K, met NaN",
        ),
        (
            PackThermal {
                path_w_per_k: f64::INFINITY,
                ..good
            },
            "conductance of a cell to the surroundings: expected zero or more in W/K, met inf",
        ),
        (
            PackThermal {
                side_share: 1.5,
                ..good
            },
            "share of the sides in the path of a cell to the surroundings: expected a number from 0 \
            to 1, met 1.5",
        ),
        (
            PackThermal {
                capacity_j_per_k: 0.0,
                ..good
            },
            "heat capacity of a cell: expected a number above 0 in J/K, met 0",
        ),
        (
            PackThermal {
                ambient_degc: 298.0,
                ..good
            },
            "temperature of the surroundings: expected -60 to 120 °C, met 298",
        ),
    ];
    for (thermal, text) in cases {
        assert_eq!(thermal.check().unwrap_err().to_string(), text);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn heat_is_stored_or_lost(
        (series, parallel) in (1usize..6, 1usize..6),
        (path, neighbour, busbar) in (
            prop::sample::select(vec![0.0, 0.05, 3.0, 500.0]),
            prop::sample::select(vec![0.0, 0.1, 20.0, 1e4]),
            prop::sample::select(vec![0.0, 0.1, 20.0, 1e4]),
        ),
        (side_share, step_s) in (0.0..1.0f64, 0.01..100.0f64),
        phase in 0.0..6.0f64,
    ) {
        let thermal = PackThermal {
            path_w_per_k: path,
            side_share,
            neighbour_w_per_k: neighbour,
            busbar_w_per_k: busbar,
            ..PackThermal::adiabatic(-5.0, 40.0)
        };
        let mut grid = network(thermal, series, parallel);
        let cells = series * parallel;
        let (mut came_j, mut lost_j) = (0.0, 0.0);
        for step in 0..50 {
            let heat = |k: usize| 2.0 + (phase + 0.3 * (step + k * k) as f64).sin();
            let cell_w: Vec<f64> = (0..cells).map(heat).collect();
            let interconnect_w = 1.0 + (0.1 * f64::from(step as u32)).cos();
            grid.begin();
            grid.end(step_s, Heat { cell_w: &cell_w, interconnect_w });
            prop_assert!(grid.settled());
            let wires_w = if busbar > 0.0 { interconnect_w } else { 0.0 };
            came_j += step_s * (cell_w.iter().sum::<f64>() + wires_w);
            lost_j += step_s * grid.lost_w();
        }
        let stored_j = 40.0 * grid.over_k().iter().sum::<f64>();
        prop_assert!(
            (came_j - lost_j - stored_j).abs() < 1e-9 * came_j,
            "{came_j} {lost_j} {stored_j}"
        );
        // No cell is colder than the surroundings or hotter than all heat of one could make it.
        prop_assert!(grid.over_k().iter().all(|over| *over > -1e-9 && *over < came_j / 40.0 + 1e-9));
    }
}
