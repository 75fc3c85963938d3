//! The C header and the CasADi module of a map.

use super::text::rows;
use analysis_model::map::{CellMap, GAS_J_PER_MOL_K, Surface};

/// The C header.
pub(super) const HEADER: &str = include_str!("map.h.in");
/// The part of the CasADi module that a map has of its own.
pub(super) const CASADI: &str = include_str!("casadi_map.py.in");

/// Returns a template with the numbers of the map; marks of other numbers stay. `none` stands for a list without
/// numbers.
pub(super) fn fill(template: &str, map: &CellMap, none: &str) -> String {
    let surfaces: Vec<&Surface> = std::iter::once(&map.series)
        .chain(map.branches.iter().map(|branch| &branch.resistance))
        .collect();
    let list = |values: Vec<f64>| match values.is_empty() {
        true => none.to_owned(),
        false => rows(&mut values.into_iter(), "    "),
    };
    let activation = surfaces
        .iter()
        .map(|s| s.activation_j_per_mol / GAS_J_PER_MOL_K);
    let r_ohm = surfaces
        .iter()
        .flat_map(|s| s.r_ohm.iter().flatten().copied());
    let tau_s = map.branches.iter().map(|branch| branch.tau_s);
    let thermal = map
        .thermal
        .map_or((0.0, 0.0), |t| (t.capacity_j_per_k, t.resistance_k_per_w));
    let pairs = [
        ("@MAP_SOC@", map.soc.len().to_string()),
        ("@MAP_DEGC@", map.temperature_degc.len().to_string()),
        ("@LIST_MAP_SOC@", list(map.soc.clone())),
        ("@LIST_MAP_DEGC@", list(map.temperature_degc.clone())),
        ("@LIST_ACTIVATION@", list(activation.collect())),
        ("@LIST_R_OHM@", list(r_ohm.collect())),
        ("@LIST_TAU@", list(tau_s.collect())),
        ("@LIST_OFFSET@", list(map.ocv_offset_v.clone())),
        ("@LIST_PER_K@", list(map.ocv_v_per_k.clone())),
        ("@OCV_DEGC@", format!("{:?}", map.ocv_temperature_degc)),
        ("@HEAT@", format!("{:?}", thermal.0)),
        ("@THERMAL@", format!("{:?}", thermal.1)),
        ("@RC@", map.branches.len().to_string()),
    ];
    let fill = |text: String, (mark, value): &(&str, String)| text.replace(mark, value);
    pairs.iter().fold(template.to_owned(), fill)
}
