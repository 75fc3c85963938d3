//! The law of power of the C headers: against the project's own simulation, in its derivatives, and
//! on random states.

use analysis_forward::forward::Beyond;

use super::*;

/// Cells of the thesis' pack of 16S3P, over which the power of the robot is divided.
pub(super) const CELLS: f64 = 48.0;

/// Times, s, and powers, W, of one cell of the pack.
pub(super) fn profile(name: &str) -> Vec<(f64, f64)> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/data/profiles");
    let text = std::fs::read_to_string(format!("{root}/{name}.csv")).unwrap();
    let number = |word: &str| word.parse::<f64>().unwrap();
    let row = |line: &str| {
        let (time_s, power_w) = line.split_once(',').unwrap();
        (number(time_s), number(power_w) / CELLS)
    };
    text.lines().skip(1).map(row).collect()
}

/// Powers beyond P*, with charge and rest between.
fn beyond_the_most() -> Vec<(f64, f64)> {
    let powers_w = [
        100.0, 430.0, -60.0, 455.0, 0.0, 490.0, 520.0, -5.0, 440.0, 1.0,
    ];
    let row = |(k, power_w): (u32, &f64)| (f64::from(k) * 0.003, *power_w);
    (0..).zip(&powers_w).map(row).collect()
}

#[test]
fn a_header_under_power_gives_what_the_simulation_gives_on_five_profiles() {
    let program = "int main(void) { eis_state s; eis_rest(&s, 0.6); double w, f, h; int n;\n\
        while (scanf(\"%lf %lf %lf %d\", &w, &f, &h, &n) == 4) {\n\
        eis_node a = eis_look(&s, w, f), b = a;\n\
        for (int k = 0; k < n; ++k) { b = eis_power_step(&s, w, f, h / n);\n\
        if (k == 0 && b.terminal_v != a.terminal_v) return 1; }\n\
        b = eis_look(&s, w, f);\n\
        printf(\"%.17g %.17g %.17g %.17g %.17g\\n\", a.terminal_v, b.terminal_v, b.current_a,\n\
        b.low_v, b.high_v); } return 0; }\n";
    let cell = cell();
    let model = SimModel::cell(&cell.erm, OcvSource::Curve(cell.curve.clone())).unwrap();
    let robot = ["gap_2m", "lateral_jump", "spin_jump", "walking"];
    let profiles = robot.map(|name| (name, [0.95, 1e-4], profile(name)));
    let bent = ("bent", [0.9, 2e-5], beyond_the_most());
    // On the tangent a current moves more with the voltage, and the steps must be shorter.
    let tangent = ("beyond", [0.9, 2e-5], beyond_the_most());
    for (name, [fraction, longest_s], rows) in profiles.into_iter().chain([tangent, bent]) {
        let step = |pair: &[(f64, f64)]| {
            let step_s = pair[1].0 - pair[0].0;
            let parts = (step_s / longest_s - 1e-9).ceil();
            format!("{:e} {fraction} {step_s:e} {parts}\n", pair[0].1)
        };
        let input: String = rows.windows(2).map(step).collect();
        let (order, beyond) = match name {
            "bent" => ("-DEIS_ORDER=2", Beyond::Bend { fraction }),
            _ => ("-DEIS_ORDER=1", Beyond::Extrapolate { fraction }),
        };
        let Some(met) = run(&cell, &[order], program, &input) else {
            return;
        };
        let given = Profile::new(name, Demand::Power, Interpolation::Hold, &rows).unwrap();
        let options = SimOptions {
            beyond,
            ..SimOptions::default()
        };
        let simulated = simulate(&model, &model.rest(0.6).unwrap(), &given, &options).unwrap();
        let trace = &simulated.trace;
        let (mut row, mut worst_v) = (0, 0.0_f64);
        for (pair, met) in rows.windows(2).zip(&met) {
            worst_v = worst_v.max((trace.ccv_v[row] - met[0]).abs());
            row += 1;
            assert!((trace.time_s[row] - pair[1].0).abs() < 1e-9, "{name}");
            worst_v = worst_v.max((trace.ccv_v[row] - met[1]).abs());
            let power_w = met[1] * met[2];
            assert!((trace.power_w[row] - power_w).abs() < 2e-3, "{name}");
            assert!(
                (met[3] - (met[1] - 2.5)).abs() < 1e-12 && (met[4] - (4.2 - met[1])).abs() < 1e-12
            );
            // A jump of the demand has a second row.
            let next = row + 1;
            row += usize::from(trace.time_s.get(next) == trace.time_s.get(row));
        }
        eprintln!("{name}: {} steps, {:.2} µV", met.len(), 1e6 * worst_v);
        assert!(
            met.len() == rows.len() - 1 && worst_v < 1e-5,
            "{name}: {worst_v} V"
        );
        assert_eq!(simulated.summary.feasible, robot.contains(&name), "{name}");
    }
}

#[test]
fn a_header_of_a_map_under_power_gives_what_the_simulation_gives() {
    let powers_w = [40.0, 5.0, -30.0];
    let program = "int main(void) { eis_state s; eis_rest(&s, 0.95, 20.0); double w;\n\
        while (scanf(\"%lf\", &w) == 1) {\n\
        for (int k = 0; k < 600; ++k) eis_power_step(&s, w, 0.95, 20.0, 0.1);\n\
        printf(\"%.17g %.17g\\n\", eis_look(&s, w, 0.95).terminal_v, s.temperature_degc); }\n\
        return 0; }\n";
    let cell = mapped();
    let input: String = powers_w.iter().map(|w| format!("{w}\n")).collect();
    let Some(met) = run(&cell, &[], program, &input) else {
        return;
    };
    let map = cell.map.clone().unwrap();
    let one = Pack::new(1, 1, 0.0).unwrap();
    let model = SimModel::mapped(map, cell.curve, one, 20.0).unwrap();
    let row = |(k, power_w): (u32, f64)| (60.0 * f64::from(k), power_w);
    let rows: Vec<(f64, f64)> = (0..)
        .zip(powers_w.into_iter().chain([0.0]))
        .map(row)
        .collect();
    let given = Profile::new("steps", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let start = model.rest(0.95).unwrap();
    let simulated = simulate(&model, &start, &given, &SimOptions::default()).unwrap();
    let trace = &simulated.trace;
    for (end, met) in rows[1..].iter().zip(&met) {
        let row = trace
            .time_s
            .iter()
            .position(|t| (t - end.0).abs() < 1e-9)
            .unwrap();
        let apart_v = (trace.ccv_v[row] - met[0]).abs();
        assert!(apart_v < 1e-5, "{} s: {apart_v} V", end.0);
    }
    let warm_degc = simulated.end.temperature_degc.unwrap();
    assert!(
        warm_degc > 21.0 && (met[2][1] - warm_degc).abs() < 1e-3,
        "{warm_degc} {met:?}"
    );
}

/// Random numbers and a state; the header says by its macros whether it is that of a map.
const RANDOM: &str = "static unsigned long long seed = 88172645463325252ULL;\n\
    static double any(double low, double high) {\n\
    seed ^= seed << 13; seed ^= seed >> 7; seed ^= seed << 17;\n\
    return low + (high - low) * (double)(seed >> 11) / 9007199254740992.0; }\n\
    int main(void) { int wrong = 0, beyond = 0, low = 0;\n\
    for (int n = 0; n < 1000000; ++n) { eis_state s;\n\
    s.soc = any(-0.3, 1.3);\n\
    for (int k = 0; k < EIS_RC; ++k) s.branch_v[k] = any(-1.0, 2.0);\n\
    double w = pow(10.0, any(-3.0, 5.0)) * (any(0.0, 1.0) < 0.3 ? -1.0 : 1.0);\n\
    double h = pow(10.0, any(-6.0, 2.0)), f = any(0.05, 0.9999);\n\
    TEMPERATURE\n\
    const eis_source from = eis_source_of(&s, w);\n\
    beyond += w > 0.25 * from.e_v * from.e_v / from.r_ohm; low += from.e_v <= 0.0;\n\
    const eis_node a = eis_power_step(&s, w, f, AMBIENT h), b = eis_look(&s, w, f);\n\
    int fine = isfinite(s.soc) && isfinite(a.current_a) && isfinite(a.terminal_v)\n\
    && isfinite(a.low_v) && isfinite(a.high_v) && isfinite(b.current_a)\n\
    && isfinite(b.terminal_v) && (a.current_a > 0.0) == (w > 0.0);\n\
    for (int k = 0; k < EIS_RC; ++k) fine = fine && isfinite(s.branch_v[k]);\n\
    wrong += !fine; }\n\
    printf(\"%d %d %d\\n\", wrong, beyond, low); return 0; }\n";

#[test]
fn a_million_random_states_and_powers_give_numbers() {
    let degc = "s.temperature_degc = any(-60.0, 120.0);";
    for (cell, temperature, ambient) in [(cell(), "", ""), (mapped(), degc, "20.0,")] {
        let program = RANDOM
            .replace("TEMPERATURE", temperature)
            .replace("AMBIENT", ambient);
        for order in ["-DEIS_ORDER=1", "-DEIS_ORDER=2"] {
            let Some(met) = run(&cell, &[order], &program, "") else {
                return;
            };
            eprintln!("{order}: {met:?}");
            let [wrong, beyond, low] = met[0][..] else {
                panic!("{met:?}")
            };
            assert_eq!(wrong, 0.0);
            assert!(beyond > 1e5 && low > 1e4, "{met:?}");
        }
    }
}

#[test]
fn the_second_order_joins_with_its_curvature_and_costs_nothing_below_p0() {
    // Current of 3.7 V behind 10 mΩ around P₀ = 0.95 P*, at P* and beyond.
    let program = "int main(void) { const double e = 3.7, r = 0.01, most = 0.25 * e * e / r;\n\
        const double share[8] = {0.9, 0.9499, 0.95, 0.9501, 0.9503, 0.9504, 1.0, 1.2};\n\
        for (int k = 0; k < 8; ++k)\n\
        printf(\"%.17g\\n\", e - r * eis_law_a(e, r, share[k] * most, 0.95));\n\
        return 0; }\n";
    let voltages = |order| run(&cell(), &[order], program, "");
    let (Some(first), Some(second)) = (voltages("-DEIS_ORDER=1"), voltages("-DEIS_ORDER=2")) else {
        return;
    };
    let v = |met: &[Vec<f64>]| met.iter().map(|row| row[0]).collect::<Vec<f64>>();
    let (first, second) = (v(&first), v(&second));
    let root = |share: f64| 0.5 * 3.7 * (1.0 + (1.0 - share).sqrt());
    for (k, share) in [0.9, 0.9499, 0.95].into_iter().enumerate() {
        assert!((first[k] - root(share)).abs() < 1e-13 && first[k] == second[k]);
    }
    // The straight line of equation 4.13.
    let c = 0.05_f64.sqrt();
    let line = |share: f64| 0.5 * 3.7 * (1.0 + c - (share - 0.95) / (2.0 * c));
    assert!((first[5] - line(0.9504)).abs() < 1e-13 && (first[6] - line(1.0)).abs() < 1e-13);
    // At P* the tangent lies 206.8 mV above the curve, the second order 172.4 mV.
    assert!((first[6] - root(1.0) - 0.2068).abs() < 5e-5, "{}", first[6]);
    assert!(
        (second[6] - root(1.0) - 0.1724).abs() < 5e-5,
        "{}",
        second[6]
    );
    // Behind P* both go on straight, the second order 1.25 times as steeply.
    let slope = -0.5 * 3.7 / (2.0 * c);
    assert!((first[7] - first[6] - 0.2 * slope).abs() < 1e-12);
    assert!((second[7] - second[6] - 1.25 * 0.2 * slope).abs() < 1e-12);
    // Behind P₀ the curvature falls to zero along a straight line, from that of the curve.
    let away = |step: f64| {
        line(0.95 + step)
            - 0.5 * 3.7 * step * step / (8.0 * c.powi(3)) * (1.0 - step / (3.0 * 0.05))
    };
    for (k, step) in [(3, 1e-4), (4, 3e-4), (5, 4e-4)] {
        assert!(
            (second[k] - away(step)).abs() < 1e-12,
            "{} {}",
            second[k],
            away(step)
        );
    }
}
