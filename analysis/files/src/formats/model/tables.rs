//! The numbers of a cell as every language writes them: nodes, knots, resistances, activation
//! energies. A model of one point is a map of one temperature.

use super::text::{Mark, Style, number};
use analysis_model::{
    map::{CellMap, GAS_J_PER_MOL_K, Surface, TEMPERATURES_DEGC, ZERO_DEGC_K},
    model::Erm,
    ocv::OcvCurve,
};

/// Distance of the temperatures of tables with straight lines between, K.
const TABLE_STEP_K: f64 = 0.1;
/// Reach of these tables beyond the nodes, K.
const TABLE_BEYOND_K: f64 = 20.0;

/// Returns the map with the same behaviour as a model of one point.
pub(super) fn map_of(erm: &Erm, temperature_degc: f64) -> CellMap {
    let surface = |r_ohm: f64| Surface {
        activation_j_per_mol: 0.0,
        r_ohm: vec![vec![r_ohm; 2]],
        sigma_ohm: Vec::new(),
    };
    let branches = erm.branches.iter().map(|b| analysis_model::map::MapBranch {
        extrapolated: false,
        tau_s: b.time_constant_s(),
        resistance: surface(b.r_ohm),
    });
    CellMap {
        soc: vec![0.0, 1.0],
        temperature_degc: vec![temperature_degc],
        series: surface(erm.r_ohm),
        branches: branches.collect(),
        ocv_offset_v: vec![0.0; 2],
        ocv_v_per_k: vec![0.0; 2],
        ocv_temperature_degc: temperature_degc,
        most_current_a: None,
        charge_transfer: None,
        thermal: None,
        voltage_error: None,
    }
}

/// Returns the marks of a map.
pub(super) fn marks(map: &CellMap, style: Style) -> Vec<Mark> {
    let surfaces: Vec<&Surface> = std::iter::once(&map.series)
        .chain(map.branches.iter().map(|branch| &branch.resistance))
        .collect();
    let activation = surfaces
        .iter()
        .map(|s| s.activation_j_per_mol / GAS_J_PER_MOL_K);
    let r_ohm = surfaces
        .iter()
        .flat_map(|s| s.r_ohm.iter().flatten().copied());
    let thermal = map
        .thermal
        .map_or((0.0, 0.0), |t| (t.capacity_j_per_k, t.resistance_k_per_w));
    let nodes = &map.temperature_degc;
    let within = |degc: f64| {
        let (least, most) = TEMPERATURES_DEGC.into_inner();
        number(degc.clamp(least, most) + ZERO_DEGC_K)
    };
    let moves = surfaces.iter().any(|s| s.activation_j_per_mol != 0.0)
        || map.ocv_v_per_k.iter().any(|v| *v != 0.0)
        || nodes.len() > 1;
    let step_k = if moves { TABLE_STEP_K } else { TABLE_BEYOND_K };
    vec![
        ("@MAP_SOC@", map.soc.len().to_string()),
        ("@MAP_DEGC@", nodes.len().to_string()),
        ("@LIST_MAP_SOC@", style.list(map.soc.iter().copied())),
        ("@LIST_MAP_DEGC@", style.list(nodes.iter().copied())),
        ("@LIST_ACTIVATION@", style.list(activation)),
        ("@LIST_R_OHM@", style.list(r_ohm)),
        (
            "@LIST_TAU@",
            style.list(map.branches.iter().map(|branch| branch.tau_s)),
        ),
        (
            "@LIST_OFFSET@",
            style.list(map.ocv_offset_v.iter().copied()),
        ),
        ("@LIST_PER_K@", style.list(map.ocv_v_per_k.iter().copied())),
        ("@OCV_DEGC@", number(map.ocv_temperature_degc)),
        ("@HEAT@", number(thermal.0)),
        ("@THERMAL@", number(thermal.1)),
        ("@TRANSFERS@", map.transfer_count().to_string()),
        (
            "@TRANSFER_V@",
            number(map.charge_transfer.map_or(0.0, |law| law.voltage_v)),
        ),
        ("@RC@", map.branches.len().to_string()),
        ("@T_STEP_K@", number(step_k)),
        ("@T_LOW_K@", within(nodes[0] - TABLE_BEYOND_K)),
        (
            "@T_HIGH_K@",
            within(nodes[nodes.len() - 1] + TABLE_BEYOND_K),
        ),
    ]
}

/// Returns SOC between and at the knots of a curve, so close that straight lines between them stay
/// within a tolerance, V, of the curve.
pub(super) fn dense_soc(curve: &OcvCurve, tolerance_v: f64) -> Vec<f64> {
    let mut dense = Vec::new();
    for k in 1..curve.soc.len() {
        let (low, high) = (curve.soc[k - 1], curve.soc[k]);
        let width = high - low;
        let rise = curve.ocv_v[k] - curve.ocv_v[k - 1];
        let (m0, m1) = (width * curve.slope_v[k - 1], width * curve.slope_v[k]);
        // The second derivative of a cubic is largest at an end.
        let start_v = 2.0 * (3.0 * rise - 2.0 * m0 - m1);
        let end_v = start_v + 6.0 * (m0 + m1 - 2.0 * rise);
        let bend_v = start_v.abs().max(end_v.abs());
        let parts = (bend_v / (8.0 * tolerance_v)).sqrt().ceil().max(1.0);
        let count = parts as u32;
        dense.extend((0..count).map(|j| low + width * f64::from(j) / parts));
    }
    let last = curve.soc.last().copied();
    // Beyond the last knot the curve is a straight line, which the last two points must have.
    let beyond = last.map(|last| [last, last + 1.0]);
    let before = curve.soc.first().map(|first| first - 1.0);
    before
        .into_iter()
        .chain(dense)
        .chain(beyond.into_iter().flatten())
        .collect()
}
