//! A whole discharge under the four robot profiles, one after the other until the cell is empty: the
//! C header against the project's own simulation, with sanitizers and with the times of its steps.

use std::fmt::Write as _;

use analysis_forward::forward::Beyond;

use super::super::added::split;
use super::*;

/// Powers, W, of one cell of the pack, with the time that each lasts, s: the four profiles.
fn cycle() -> Vec<(f64, f64)> {
    let names = ["gap_2m", "lateral_jump", "spin_jump", "walking"];
    let each = names.iter().flat_map(|name| {
        let rows = power::profile(name);
        let steps = rows
            .windows(2)
            .map(|pair| (pair[1].0 - pair[0].0, pair[0].1));
        steps.collect::<Vec<_>>()
    });
    each.collect()
}

/// Steps through the cycle until the time is over, and writes the voltage at the end of each row and
/// at its start; then the mean and the longest time of a step, ns, and its most.
const PROGRAM: &str = "#include <stdlib.h>\n#include <time.h>\n\
    static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t);\n\
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec; }\n\
    static double w[4000], h[4000];\n\
    int main(void) { eis_state s; eis_rest(&s, 0.98 REST); int rows, size = 0;\n\
    if (scanf(\"%d\", &rows) != 1) return 1;\n\
    while (size < 4000 && scanf(\"%lf %lf\", &h[size], &w[size]) == 2) ++size;\n\
    double sum = 0.0, most = 0.0, count = 0.0;\n\
    for (int row = 0; row < rows; ++row) { const double p = w[row % size];\n\
    double out[2]; out[0] = eis_look(&s, p, 0.95).terminal_v;\n\
    const int parts = (int)ceil(h[row % size] / PART - 1e-9);\n\
    for (int k = 0; k < parts; ++k) { const double from = now();\n\
    eis_power_step(&s, p, 0.95, AMBIENT h[row % size] / parts);\n\
    const double took = now() - from; sum += took; count += 1.0; most = took > most ? took : most; }\n\
    out[1] = eis_look(&s, p, 0.95).terminal_v; fwrite(out, sizeof out, 1, stdout); }\n\
    const double end[2] = {sum / count, most}; fwrite(end, sizeof end, 1, stdout); return 0; }\n";

/// Largest difference of the header to the simulation in a discharge, V; `None` without a compiler.
fn apart_v(name: &str, cell: &CellModel, model: &SimModel, part_s: f64) -> Option<f64> {
    let cycle = cycle();
    let cycle_s: f64 = cycle.iter().map(|row| row.0).sum();
    let cycle_j: f64 = cycle.iter().map(|row| row.0 * row.1).sum();
    // Longer than the charge lasts at the greatest voltage.
    let whole_s = 1.1 * 3600.0 * cell.curve.capacity_ah * 4.2 / (cycle_j / cycle_s);
    let mut at_s = 0.0;
    let row = |(step_s, power_w): &(f64, f64)| {
        let row = (at_s, *power_w);
        at_s += step_s;
        row
    };
    let rows: Vec<(f64, f64)> = cycle
        .iter()
        .cycle()
        .map(row)
        .take_while(|row| row.0 < whole_s)
        .collect();
    let given = Profile::new("cycle", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let options = SimOptions {
        beyond: Beyond::Extrapolate { fraction: 0.95 },
        ..SimOptions::default()
    };
    let simulated = simulate(model, &model.rest(0.98).unwrap(), &given, &options).unwrap();
    let trace = &simulated.trace;
    let mut input = format!("{}\n", rows.len() - 1);
    for (step_s, power_w) in &cycle {
        writeln!(input, "{step_s:e} {power_w:e}").unwrap();
    }
    let map = cell.map.is_some();
    let code = PROGRAM
        .replace("REST", if map { ", 25.0" } else { "" })
        .replace("AMBIENT", if map { "25.0," } else { "" })
        .replace("PART", &format!("{part_s:e}"));
    let flags = ["-fsanitize=address,undefined", "-D_POSIX_C_SOURCE=199309L"];
    let output = Program::build(cell, &flags, &code)?.run(input.into_bytes());
    let met: Vec<f64> = output
        .as_chunks::<8>()
        .0
        .iter()
        .map(|bytes| f64::from_ne_bytes(*bytes))
        .collect();
    let (mut place, mut worst_v, mut compared, mut worst_at) = (0, 0.0_f64, 0, 0.0);
    for (k, pair) in rows.windows(2).enumerate() {
        let Some(soc) = trace.soc.get(place + 1) else {
            break;
        };
        if *soc < 0.0 {
            break;
        }
        assert!((trace.time_s[place + 1] - pair[1].0).abs() < 1e-9, "{name}");
        for (shift, met) in met[2 * k..2 * k + 2].iter().enumerate() {
            let away_v = (trace.ccv_v[place + shift] - met).abs();
            if away_v > worst_v {
                (worst_v, worst_at) = (away_v, *soc);
            }
        }
        (place, compared) = (place + 1, compared + 1);
        // A jump of the demand has a second row.
        place += usize::from(trace.time_s.get(place) == trace.time_s.get(place + 1));
    }
    let time_ns = &met[2 * (rows.len() - 1)..];
    let end_soc = trace.soc[place];
    eprintln!(
        "{name}: {compared} rows to SOC {end_soc:.4}, {:.2} µV at SOC {worst_at:.3}; a step with sanitizers takes \
        {:.0} ns, at most {:.0} ns",
        1e6 * worst_v,
        time_ns[0],
        time_ns[1]
    );
    assert!(end_soc < 0.05, "{name}: {end_soc}");
    Some(worst_v)
}

/// The same cell with a part of the capacity.
fn smaller(cell: CellModel, part: f64) -> CellModel {
    let curve = OcvCurve {
        capacity_ah: part * cell.curve.capacity_ah,
        ..cell.curve
    };
    CellModel { curve, ..cell }
}

fn discharge(part: f64) {
    let one = Pack::new(1, 1, 0.0).unwrap();
    let point = smaller(cell(), part);
    let curve = OcvSource::Curve(point.curve.clone());
    let simulated = SimModel::cell(&point.erm, curve).unwrap();
    let Some(point_v) = apart_v("point", &point, &simulated, 5e-4) else {
        return;
    };
    assert!(point_v < 1e-5, "{point_v} V");
    let map = smaller(mapped(), part);
    let (surfaces, curve) = (map.map.clone().unwrap(), map.curve.clone());
    let simulated = SimModel::mapped(surfaces, curve, one, 25.0).unwrap();
    let map_v = apart_v("map", &map, &simulated, 5e-4).unwrap();
    assert!(map_v < 1e-5, "{map_v} V");
}

/// A cell of a fiftieth of the capacity, so that a few cycles empty it.
#[test]
fn headers_follow_a_discharge_of_a_small_cell() {
    discharge(0.02);
}

#[test]
#[ignore = "long drill: 2 million rows for each of two models"]
fn headers_follow_a_whole_discharge() {
    discharge(1.0);
}

#[test]
fn a_header_with_additions_follows_a_discharge_of_a_small_cell() {
    let part = 0.005;
    let effects: [(&str, &[f64]); 3] = [
        ("self_heating", &[1e-3, 600.0]),
        ("hysteresis", &[0.02, 60.0, 0.0, 0.0]),
        ("soc_resistance", &[-0.3]),
    ];
    let (mut whole, added) = additions::augmented(&effects);
    whole.base.ocv.capacity_ah *= part;
    let added = CellModel {
        added: split("cell", &whole).unwrap().added,
        ..smaller(added, part)
    };
    let curve = OcvSource::Curve(added.curve.clone());
    let one = Pack::new(1, 1, 0.0).unwrap();
    let simulated = SimModel::augmented(&whole, curve, one).unwrap();
    let Some(added_v) = apart_v("additions", &added, &simulated, 2.5e-4) else {
        return;
    };
    assert!(added_v < 1e-5, "{added_v} V");
}
