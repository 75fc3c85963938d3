//! Additions: against a model with one more branch, a closed form, an independent integrator, the
//! player, and conservation of energy.

use super::*;
use crate::forward::scale::ScaleOptions;
use analysis_effects::{
    augmented::{Added, Augmented, Between, Grid, Kept, Player},
    contract::{Base, Branch, Card, Effect, Facts, Group, Law, Network, Parameter, Record},
    effects::find,
};

fn base(erm: Erm) -> Base {
    let facts = Facts {
        lowest_hz: Some(0.1),
        highest_hz: Some(300.0),
        longest_s: 100.0,
        shortest_s: 0.1,
        greatest_a: 40.0,
        widest_soc: 0.1,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 3.0,
        span_s: 1e4,
        held_out: None,
    };
    Base {
        erm,
        ocv: curve(),
        facts,
    }
}

fn kept(name: &str, p: &[f64]) -> Kept {
    Kept {
        effect: find(name).unwrap(),
        p: p.to_vec(),
    }
}

fn augmented(erm: Erm, kept: Vec<Kept>) -> Augmented {
    Augmented {
        base: base(erm),
        kept,
    }
}

fn sim(cell: &Augmented, pack: Pack) -> SimModel {
    SimModel::augmented(cell, OcvSource::Curve(curve()), pack).unwrap()
}

const ONE: Pack = Pack {
    series: 1,
    parallel: 1,
    interconnect_ohm: 0.0,
};

/// i = sinh(βv/R)/β on the last branch of the cell.
struct Sinh;

static SINH: Card = Card {
    name: "sinh",
    title: "a law for tests",
    group: Group::Cell,
    mechanism: "",
    state_equation: "",
    impedance: "",
    source: "",
    signature: "",
    confounders: &[],
    contains: &[],
    experiment: "",
};

impl Effect for Sinh {
    fn card(&self) -> &'static Card {
        &SINH
    }

    fn parameters(&self, _base: &Base) -> Vec<Parameter> {
        Vec::new()
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        if let Some(last) = network.branches.last_mut() {
            *last = Branch {
                law: Law::Symmetric { beta: p[0] },
                ..*last
            };
        }
    }
}

/// Misreads a quantity without any effect on the cell.
struct Misread;

impl Effect for Misread {
    fn card(&self) -> &'static Card {
        &SINH
    }

    fn parameters(&self, _base: &Base) -> Vec<Parameter> {
        Vec::new()
    }

    fn voltage(&self, _p: &[f64], _record: &Record<'_>, voltage_v: &mut [f64]) {
        voltage_v.iter_mut().for_each(|v| *v += 0.1);
    }
}

#[test]
fn a_slow_branch_is_one_more_branch() {
    let cell = augmented(thesis_cell(), vec![kept("rc_slow", &[2e-3, 30.0])]);
    let mut more = thesis_cell();
    more.branches.push(RcBranch {
        r_ohm: 2e-3,
        c_f: 30.0 / 2e-3,
    });
    let pack = Pack::new(16, 3, 0.01).unwrap();
    let expected = SimModel::pack(&more, OcvSource::Curve(curve()), pack).unwrap();
    let met = sim(&cell, pack);
    assert_eq!((met.laws(), met.erm.branches.len()), (None, 5));
    let profile = rows(
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 2000.0), (20.0, -500.0), (40.0, -500.0)],
    );
    let run = |m: &SimModel| {
        simulate(m, &m.rest(0.6).unwrap(), &profile, &SimOptions::default()).unwrap()
    };
    let (met, expected) = (run(&met), run(&expected));
    assert!(
        (met.summary.min_ccv_v - expected.summary.min_ccv_v).abs() < 1e-9,
        "{} V",
        met.summary.min_ccv_v
    );
    assert!((met.summary.heat_j - expected.summary.heat_j).abs() < 1e-6 * expected.summary.heat_j);
}

#[test]
fn the_bench_is_left_out() {
    let cell = augmented(
        thesis_cell(),
        vec![kept("current_gain", &[0.1]), kept("thermal_emf", &[1e-3])],
    );
    assert_eq!(sim(&cell, ONE), curved_cell());
    assert_eq!(
        cell.left_out(),
        [
            "gain error of the current channel",
            "drifting thermal voltage"
        ]
    );
}

/// Returns the factor on resistances of a heat kept (J): Arrhenius' law about 25 °C, 14.8 J/K per
/// Ah.
fn warm(g: f64, heat_j: f64) -> f64 {
    (-g * heat_j / (1.0 + heat_j / (14.8 * curve().capacity_ah * 298.15))).exp()
}

#[test]
fn warmth_lowers_the_resistance_as_arrhenius_says() {
    // Without loss to the surroundings: dh/dt = R·i²·f(h).
    let (g, r, i) = (2e-4, 0.012, 40.0_f64);
    let cell = augmented(
        Erm {
            r_ohm: r,
            branches: Vec::new(),
        },
        vec![kept("self_heating", &[g, 1e8])],
    );
    let model = sim(&cell, ONE);
    let profile = rows(
        Demand::Current,
        Interpolation::Hold,
        &[(0.0, i), (120.0, i)],
    );
    let options = SimOptions {
        max_step_s: 5.0,
        ..SimOptions::default()
    };
    let run = simulate(&model, &model.rest(0.9).unwrap(), &profile, &options).unwrap();
    let (mut heat_j, mut now_s) = (0.0, 0.0);
    for (k, t) in run.trace.time_s.iter().enumerate() {
        while now_s < t - 1e-9 {
            let h = (t - now_s).min(0.01);
            let middle_j = heat_j + 0.5 * h * r * i * i * warm(g, heat_j);
            heat_j += h * r * i * i * warm(g, middle_j);
            now_s += h;
        }
        let met = (run.trace.ocv_v[k] - run.trace.ccv_v[k]) / i;
        let expected = r * warm(g, heat_j);
        assert!(
            (met - expected).abs() * i < 2e-6,
            "{t} s: {met} Ω against {expected} Ω"
        );
    }
    assert!(run.trace.time_s.len() == 25);
    assert!(
        (run.summary.heat_j / heat_j - 1.0).abs() < 1e-5,
        "{} J against {heat_j} J",
        run.summary.heat_j
    );
}

/// The cell of R and two branches, the second with a law, warming, under a power: dx/dt by Runge
/// and Kutta.
struct Truth {
    beta: f64,
    g: f64,
    tau_s: f64,
    power_w: f64,
}

const R: f64 = 0.006;
const BRANCHES: [(f64, f64); 2] = [(2e-3, 0.02), (4e-3, 3.0)];

impl Truth {
    fn current(&self, y: &[f64; 4]) -> (f64, f64) {
        let (e, r) = (
            curve().voltage_v(y[0]) - y[1] - y[2],
            R * warm(self.g, y[3] / self.g),
        );
        let i = (e - (e * e - 4.0 * r * self.power_w).sqrt()) / (2.0 * r);
        (i, e - r * i)
    }

    fn slope(&self, y: &[f64; 4]) -> [f64; 4] {
        let (i, _) = self.current(y);
        let f = warm(self.g, y[3] / self.g);
        let (c1, c2) = (BRANCHES[0].1 / BRANCHES[0].0, BRANCHES[1].1 / BRANCHES[1].0);
        let through = (self.beta * y[2] / BRANCHES[1].0).sinh() / (self.beta * f);
        let heat_w = R * f * i * i + y[1] * y[1] / (BRANCHES[0].0 * f) + y[2] * through;
        [
            -i / (3600.0 * curve().capacity_ah),
            (i - y[1] / (BRANCHES[0].0 * f)) / c1,
            (i - through) / c2,
            self.g * heat_w - y[3] / self.tau_s,
        ]
    }

    fn after(&self, mut y: [f64; 4], duration_s: f64) -> f64 {
        let count = 40_000;
        let h = duration_s / f64::from(count);
        let moved = |y: &[f64; 4], k: &[f64; 4], by: f64| -> [f64; 4] {
            std::array::from_fn(|n| y[n] + by * k[n])
        };
        for _ in 0..count {
            let k1 = self.slope(&y);
            let k2 = self.slope(&moved(&y, &k1, 0.5 * h));
            let k3 = self.slope(&moved(&y, &k2, 0.5 * h));
            let k4 = self.slope(&moved(&y, &k3, h));
            y = std::array::from_fn(|n| {
                y[n] + h / 6.0 * (k1[n] + 2.0 * k2[n] + 2.0 * k3[n] + k4[n])
            });
        }
        self.current(&y).1
    }
}

fn hot() -> Augmented {
    let branches = BRANCHES
        .iter()
        .map(|(r_ohm, tau_s)| RcBranch {
            r_ohm: *r_ohm,
            c_f: tau_s / r_ohm,
        })
        .collect();
    let kept = vec![
        Kept {
            effect: &Sinh,
            p: vec![0.03],
        },
        kept("self_heating", &[5e-4, 200.0]),
    ];
    augmented(Erm { r_ohm: R, branches }, kept)
}

#[test]
fn a_held_power_agrees_with_an_integrator_of_its_own_for_cell_and_pack() {
    let truth = Truth {
        beta: 0.03,
        g: 5e-4,
        tau_s: 200.0,
        power_w: 180.0,
    };
    let expected = truth.after([0.8, 0.0, 0.0, 0.0], 20.0);
    for pack in [ONE, Pack::new(16, 3, 0.0).unwrap()] {
        let model = sim(&hot(), pack);
        assert_eq!(model.laws().unwrap(), "sinh, self_heating");
        let power_w = 180.0 * f64::from(pack.series * pack.parallel);
        let profile = Profile::constant(Demand::Power, power_w, 20.0).unwrap();
        let run = simulate(
            &model,
            &model.rest(0.8).unwrap(),
            &profile,
            &SimOptions::default(),
        )
        .unwrap();
        let met = run.trace.cell_v.last().unwrap();
        assert!(
            (met - expected).abs() < 4e-6,
            "{}: {met} V against {expected} V",
            pack.name()
        );
        let s = &run.summary;
        let balance_j = s.chemical_j - s.energy_j - s.heat_j - s.stored_j;
        assert!(
            balance_j.abs() < 1e-4 * s.heat_j,
            "{}: {balance_j} J",
            pack.name()
        );
    }
}

#[test]
fn a_current_profile_agrees_with_the_player() {
    let cell = hot();
    let model = sim(&cell, ONE);
    let time_s: Vec<f64> = (0..=300).map(|k| 0.1 * f64::from(k)).collect();
    let current_a: Vec<f64> = time_s
        .iter()
        .map(|t| {
            if *t < 10.0 {
                60.0
            } else if *t < 18.0 {
                -35.0
            } else {
                0.0
            }
        })
        .collect();
    let profile = rows(
        Demand::Current,
        Interpolation::Hold,
        &[(0.0, 60.0), (10.0, -35.0), (18.0, 0.0), (30.0, 0.0)],
    );
    let options = SimOptions {
        max_step_s: 0.1,
        ..SimOptions::default()
    };
    let run = simulate(&model, &model.rest(0.6).unwrap(), &profile, &options).unwrap();
    let record = Record {
        time_s: &time_s,
        current_a: &current_a,
        soc: 0.6,
        temperature_degc: 25.0,
        order: 0.0,
        start_s: 0.0,
        is_cell: true,
        before: &[],
    };
    let (mut voltage_v, added): (Vec<f64>, Vec<Added<'_>>) = (Vec::new(), cell.of_the_cell());
    let grid = Grid::new(&time_s, Between::Hold);
    Player::default().play(&cell.base, &added, &record, &grid, 16, &mut voltage_v);
    let mut compared = 0;
    for (t, v) in run.trace.time_s.iter().zip(&run.trace.ccv_v) {
        let k = (t / 0.1).round() as usize;
        // The simulation takes no sample just before a jump.
        if (t - 10.0).abs() > 0.05 && (t - 18.0).abs() > 0.05 {
            assert!(
                (v - voltage_v[k]).abs() < 5e-6,
                "{t} s: {v} V against {} V",
                voltage_v[k]
            );
            compared += 1;
        }
    }
    assert!(compared > 290);
}

#[test]
fn a_limit_of_the_scale_is_where_the_window_ends() {
    let model = sim(&hot(), ONE);
    let profile = rows(
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 50.0), (3.0, 20.0), (6.0, 20.0)],
    );
    let state = model.rest(0.7).unwrap();
    let options = ScaleOptions {
        accuracy: 1e-4,
        ..ScaleOptions::for_profile(&profile)
    };
    let limit = largest_scale(&model, &state, &profile, &options).unwrap();
    assert_eq!(limit.bound, ScaleBound::LowerVoltage);
    let margin = |factor: f64| {
        simulate(
            &model,
            &state,
            &profile.scaled(factor),
            &SimOptions::default(),
        )
        .unwrap()
        .summary
        .margin_low_v
    };
    assert!(
        margin(limit.factor) >= 0.0 && margin(1.001 * limit.factor) < 0.0,
        "{}",
        limit.factor
    );
}

#[test]
fn what_cannot_honour_an_addition_says_so() {
    let cell = augmented(thesis_cell(), vec![kept("self_heating", &[1e-4, 600.0])]);
    let model = sim(&cell, ONE);
    let state = model.rest(0.5).unwrap();
    let profile = Profile::constant(Demand::Power, 20.0, 1.0).unwrap();
    let thesis = SimOptions {
        method: Method::Thesis,
        ..SimOptions::default()
    };
    let batch = [BatchCell {
        model: &model,
        state: &state,
        scale: 1.0,
    }];
    let misread = augmented(
        thesis_cell(),
        vec![Kept {
            effect: &Misread,
            p: Vec::new(),
        }],
    );
    let met = "expected linear branches only, met a model with self_heating";
    let cases = [
        (simulate(&model, &state, &profile, &thesis).unwrap_err(), format!("explicit Euler: \
        {met}")),
        (simulate_batch(&batch, &profile, &BatchOptions::default()).unwrap_err(), format!("batch: {met}")),
        (sensitivity(&model, &state, &profile, Beyond::Stop, 0.1).unwrap_err(), format!("derivatives: {met}")),
        (
            SimModel::augmented(&cell, OcvSource::Constant(3.7), ONE).unwrap_err(),
            "open-circuit voltage that stays: expected a state of charge on the model's OCV curve, \
            met a model with self_heating"
                .to_owned(),
        ),
        (
            SimModel::augmented(&misread, OcvSource::Curve(curve()), ONE).unwrap_err(),
            "simulation: expected effects that act within the cell, met a model with sinh".to_owned(),
        ),
    ];
    for (error, text) in cases {
        assert_eq!(error.to_string(), text);
    }
}
