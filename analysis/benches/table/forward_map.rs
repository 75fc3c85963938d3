//! Steps per second of cells with a map, under a tenth of the profile of [`super::forward`].
//!
//! The map of six branches is fitted to real pulses
//! (`fixtures/data/cells/panasonic_18650pf_25C/map_6rc.json`); these pulses show neither heat nor a
//! resistance that falls under current, so that the bent and the heated cell have laws of common size.
//! The map of ten has all time constants of a fit: the four that the pulses do not show get resistances
//! of the neighbour.

use analysis::forward::{BatchCell, BatchOptions, Profile, SimModel, SimState, simulate_batch};
use analysis::map::{CellMap, ChargeTransfer, MapBranch, Thermal};
use analysis::ocv::OcvCurve;
use analysis::pack::Pack;

use crate::{Row, Unit, best_s};

const CELLS: usize = 64;
const RUNS: usize = 5;
/// Factor of the profile's demand: 3 to 16 W.
const SCALE: f64 = 0.1;

/// Laws of a cell.
#[derive(Clone, Copy)]
struct Laws {
    bent: bool,
    heated: bool,
}

/// Returns the figures.
pub(crate) fn rows(profile: &Profile) -> Vec<Row> {
    let fitted = Fitted::read();
    let cases = [
        (6, false, false),
        (6, true, false),
        (6, false, true),
        (6, true, true),
    ];
    let more = [
        (3, false, false),
        (3, true, false),
        (10, false, false),
        (10, true, false),
        (10, true, true),
    ];
    let mut rows = Vec::new();
    for (branches, bent, heated) in cases.into_iter().chain(more) {
        let model = fitted.model(branches, Laws { bent, heated });
        let name = format!(
            "a map of {branches} branches, {}{}",
            if bent { "bent" } else { "linear" },
            if heated { ", with heat" } else { "" }
        );
        let plain = branches == 6 && !bent && !heated;
        for (cells, what) in [(1, "one cell"), (CELLS, "64 in lockstep")] {
            let work = if plain { "forward-map" } else { "" };
            let figure = steps_per_s(&model, cells, profile);
            rows.push(Row::new(
                work,
                &format!("{what}, {name}"),
                figure,
                Unit::PerSecond("steps"),
            ));
        }
    }
    rows
}

struct Fitted {
    map: CellMap,
    ocv: OcvCurve,
}

impl Fitted {
    fn read() -> Self {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../fixtures/data/cells/panasonic_18650pf_25C/map_6rc.json"
        );
        let text = std::fs::read_to_string(path).unwrap();
        let file: serde_json::Value = serde_json::from_str(&text).unwrap();
        Self {
            map: serde_json::from_value(file["map"].clone()).unwrap(),
            ocv: serde_json::from_value(file["ocv"].clone()).unwrap(),
        }
    }

    fn model(&self, branches: usize, laws: Laws) -> SimModel {
        let mut map = self.map.clone();
        match branches {
            3 => map.branches = [0, 2, 4].map(|k| map.branches[k].clone()).to_vec(),
            10 => {
                let beside = |tau_s: f64, k: usize| MapBranch {
                    extrapolated: false,
                    tau_s,
                    resistance: map.branches[k].resistance.clone(),
                };
                let fast = [0.002, 0.01, 0.05].map(|tau_s| beside(tau_s, 1));
                let slow = beside(6000.0, 5);
                map.branches = fast.into_iter().chain(map.branches).chain([slow]).collect();
            }
            _ => {}
        }
        map.charge_transfer = laws.bent.then_some(ChargeTransfer {
            voltage_v: 0.06,
            slowest_s: 3.0,
        });
        map.thermal = laws.heated.then_some(Thermal {
            capacity_j_per_k: 45.0,
            resistance_k_per_w: 8.0,
        });
        let one = Pack::new(1, 1, 0.0).unwrap();
        SimModel::mapped(map, self.ocv.clone(), one, 15.0).unwrap()
    }
}

/// Cell-steps per second of processor time of equal cells at different scales.
fn steps_per_s(model: &SimModel, cells: usize, profile: &Profile) -> f64 {
    let state: SimState = model.rest(0.5).unwrap();
    let cells: Vec<BatchCell<'_>> = (0..cells)
        .map(|k| BatchCell {
            model,
            state: &state,
            scale: SCALE * (1.0 - 0.001 * k as f64),
        })
        .collect();
    let one_core = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let seconds = one_core.install(|| {
        best_s(RUNS, || {
            let outcomes = simulate_batch(&cells, profile, &BatchOptions::default()).unwrap();
            assert!(
                outcomes
                    .iter()
                    .all(|o| o.infeasible_s.is_none() && o.min_ccv_v > 2.5)
            );
        })
    });
    ((profile.time_s.len() - 1) * cells.len()) as f64 / seconds
}
