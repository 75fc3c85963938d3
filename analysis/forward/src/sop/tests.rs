//! The limits against brute force, against their closed-form ends, and the laws they obey.

use super::*;
use crate::forward::{CellWindow, Demand, OcvSource, Profile, SimModel, SimOptions, simulate};
use analysis_effects::{
    augmented::{Augmented, Kept},
    contract::{Base, Facts},
    effects::find,
};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
    pack::{Pack, Sizing, SizingInput},
};
use proptest::prelude::*;

const CAPACITY_AH: f64 = 4.0;

fn erm() -> Erm {
    let branch = |r_ohm, tau: f64| RcBranch {
        r_ohm,
        c_f: tau / r_ohm,
    };
    Erm {
        r_ohm: 0.007,
        branches: vec![
            branch(0.0015, 0.05),
            branch(0.002, 1.0),
            branch(0.004, 20.0),
        ],
    }
}

/// Returns a straight OCV, so that the brute force needs no interpolation: 3.0 + 1.2·SOC.
fn straight() -> OcvSource {
    OcvSource::Curve(OcvCurve::monotone(CAPACITY_AH, vec![0.0, 1.0], vec![3.0, 4.2]).unwrap())
}

fn thesis_pack() -> Pack {
    Pack::new(16, 3, 0.03).unwrap()
}

/// Returns the lowest and highest voltage of a cell under a constant power by Runge and Kutta's
/// fourth order, per cell, with a straight falling OCV, or `None` if the power is not available.
fn extremes(pack_w: f64, (soc, duration_s): (f64, f64)) -> Option<(f64, f64)> {
    let (r, busbar, power) = (0.007, 0.03 * 3.0 / 16.0, pack_w / 48.0);
    let (rk, tau) = ([0.0015, 0.002, 0.004], [0.05, 1.0, 20.0]);
    let current = |y: &[f64; 4]| {
        let e = 3.0 + 1.2 * y[3] - y[0] - y[1] - y[2];
        let square = e * e - 4.0 * power * (r + busbar);
        (square >= 0.0).then(|| ((e - square.sqrt()) / (2.0 * (r + busbar)), e))
    };
    let slope = |y: &[f64; 4]| {
        let (i, _) = current(y)?;
        Some([
            (rk[0] * i - y[0]) / tau[0],
            (rk[1] * i - y[1]) / tau[1],
            (rk[2] * i - y[2]) / tau[2],
            -i / (3600.0 * CAPACITY_AH),
        ])
    };
    let mut y = [0.0, 0.0, 0.0, soc];
    let steps = 4000;
    let h = duration_s / f64::from(steps);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for step in 0..=steps {
        let (i, e) = current(&y)?;
        (low, high) = (low.min(e - r * i), high.max(e - r * i));
        if step < steps {
            let moved = |k: &[f64; 4], part: f64| std::array::from_fn(|n| y[n] + part * h * k[n]);
            let k1 = slope(&y)?;
            let k2 = slope(&moved(&k1, 0.5))?;
            let k3 = slope(&moved(&k2, 0.5))?;
            let k4 = slope(&moved(&k3, 1.0))?;
            y = std::array::from_fn(|n| {
                y[n] + h / 6.0 * (k1[n] + 2.0 * k2[n] + 2.0 * k3[n] + k4[n])
            });
        }
    }
    Some((low, high))
}

fn bisected(kept: impl Fn(f64) -> bool) -> f64 {
    let (mut inside, mut outside) = (0.0, 2e4);
    for _ in 0..45 {
        let middle = 0.5 * (inside + outside);
        if kept(middle) {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    inside
}

#[test]
fn as_brute_force_says() {
    let model = SimModel::pack(&erm(), straight(), thesis_pack()).unwrap();
    let mut met = Vec::new();
    for (soc, duration) in [(0.9, 0.1), (0.5, 1.0), (0.2, 10.0), (0.03, 30.0)] {
        let (discharge, charge) = most_power(
            &model,
            &model.rest(soc).unwrap(),
            duration,
            &SopOptions::default(),
        )
        .unwrap();
        let down = bisected(|p| extremes(p, (soc, duration)).is_some_and(|(low, _)| low >= 2.5));
        let up = bisected(|p| extremes(-p, (soc, duration)).is_some_and(|(_, high)| high <= 4.2));
        assert!(
            (discharge.power_w - down).abs() < 1e-6 * down,
            "SOC {soc}, {duration} s: {discharge:?}, brute force {down} W"
        );
        assert!(
            (charge.power_w + up).abs() < 1e-6 * up,
            "SOC {soc}, {duration} s: {charge:?}, brute force {up} W"
        );
        let gone = extremes(down * (1.0 + 1e-5), (soc, duration)).is_none();
        let by = if gone {
            LimitedBy::TheoreticalMaximum
        } else {
            LimitedBy::LowerVoltage
        };
        assert_eq!(
            (discharge.limited_by, charge.limited_by),
            (by, LimitedBy::UpperVoltage)
        );
        met.push(by);
    }
    // The voltage of full cells is so high that the busbars of 30 mΩ take half of it first.
    assert!(
        met.contains(&LimitedBy::TheoreticalMaximum) && met.contains(&LimitedBy::LowerVoltage),
        "{met:?}"
    );
}

/// Returns the limits of a simple-IR pack; no interconnect, so that the window at the cells is that
/// at the terminals.
fn sized(dcir_ohm: f64, cell_ocv_v: f64) -> Sizing {
    let pack = Pack::new(16, 3, 0.0).unwrap();
    Sizing::new(&SizingInput {
        pack,
        cell_ocv_v,
        dcir_ohm,
        window_v: (2.5, 4.2),
        required_v_per_w: None,
    })
    .unwrap()
}

#[test]
fn the_ends_are_the_simple_ir_model() {
    let model = SimModel::pack(
        &erm(),
        OcvSource::Constant(3.7),
        Pack::new(16, 3, 0.0).unwrap(),
    )
    .unwrap();
    for (duration, dcir) in [(1e-7, 0.007), (2000.0, 0.0145)] {
        let (discharge, charge) = most_power(
            &model,
            &model.rest(0.5).unwrap(),
            duration,
            &SopOptions::default(),
        )
        .unwrap();
        let expected = sized(dcir, 3.7);
        let (down, up) = (
            expected.peak_power_w.unwrap(),
            expected.regen_power_w.unwrap(),
        );
        assert!(
            (discharge.power_w / down - 1.0).abs() < 2e-6,
            "{duration} s: {discharge:?}, expected {down} W"
        );
        assert!(
            (charge.power_w / up - 1.0).abs() < 2e-6,
            "{duration} s: {charge:?}, expected {up} W"
        );
    }
}

#[test]
fn what_ends_the_power_is_reported() {
    let model = SimModel::pack(
        &erm(),
        OcvSource::Constant(3.7),
        Pack::new(16, 3, 0.0).unwrap(),
    )
    .unwrap();
    let rest = model.rest(0.5).unwrap();
    let wide = SopOptions {
        window: CellWindow {
            low_v: 0.5,
            high_v: 4.2,
        },
        ..SopOptions::default()
    };
    let (discharge, _) = most_power(&model, &rest, 1e-7, &wide).unwrap();
    // OCV²/4R of 59.2 V and 7 mΩ·16/3.
    let most = 59.2 * 59.2 / (4.0 * 0.007 * 16.0 / 3.0);
    assert!(
        (discharge.power_w / most - 1.0).abs() < 1e-6,
        "{discharge:?}, {most} W"
    );
    assert_eq!(discharge.limited_by, LimitedBy::TheoreticalMaximum);
    let meek = SopOptions {
        currents: CurrentLimits {
            discharge_a: 45.0,
            charge_a: 13.5,
        },
        ..SopOptions::default()
    };
    let (discharge, charge) = most_power(&model, &rest, 1e-7, &meek).unwrap();
    // 135 A out at 59.2 V − 135 A · 37.3 mΩ; 40.5 A in at 59.2 V + 40.5 A · 37.3 mΩ.
    let r = 0.007 * 16.0 / 3.0;
    assert!(
        (discharge.power_w - 135.0 * (59.2 - 135.0 * r)).abs() < 0.01,
        "{discharge:?}"
    );
    assert!(
        (charge.power_w + 40.5 * (59.2 + 40.5 * r)).abs() < 0.01,
        "{charge:?}"
    );
    assert_eq!(
        (discharge.limited_by, charge.limited_by),
        (LimitedBy::Current, LimitedBy::Current)
    );
    assert!((discharge.cell_a - 45.0).abs() < 1e-4 && (charge.cell_a - 13.5).abs() < 1e-4);
    let tight = SopOptions {
        window: CellWindow {
            low_v: 3.8,
            high_v: 4.2,
        },
        ..SopOptions::default()
    };
    let (discharge, charge) = most_power(&model, &rest, 1.0, &tight).unwrap();
    assert_eq!(
        (discharge.power_w, discharge.limited_by),
        (0.0, LimitedBy::OutsideWindow)
    );
    assert!(charge.power_w < 0.0);
    let text = most_power(&model, &rest, 0.0, &wide)
        .unwrap_err()
        .to_string();
    assert_eq!(
        text,
        "duration of the power: expected seconds above 0, met 0"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn longer_is_less_and_fuller_gives_more(
        (soc, more) in (0.05..0.6f64, 0.02..0.3f64),
        (log_t, longer) in (-2.0..1.5f64, 1.2..8.0f64),
        interconnect in 0.0..0.05f64,
    ) {
        let model = SimModel::pack(&erm(), straight(), Pack::new(8, 2, interconnect).unwrap()).unwrap();
        let duration = 10f64.powf(log_t);
        let grid = SopGrid { soc: vec![soc, soc + more], duration_s: vec![duration, duration * longer] };
        let map = sop_map(&model, &grid, &SopOptions::default()).unwrap();
        let [a, b, c, d] = &map[..] else { return Err(TestCaseError::fail("four places")) };
        for (short, long) in [(a, b), (c, d)] {
            prop_assert!(short.discharge_w > long.discharge_w && short.charge_w < long.charge_w);
        }
        for (empty, full) in [(a, c), (b, d)] {
            prop_assert!(full.discharge_w > empty.discharge_w && full.charge_w > empty.charge_w);
        }
        // With a constant OCV, the branches only delay voltage that the simple-IR model loses at
        // once.
        let level = SimModel { ocv: OcvSource::Constant(3.0 + 1.2 * soc), ..model };
        for place in sop_map(&level, &grid, &SopOptions::default()).unwrap() {
            prop_assert!(place.discharge_w > place.simple_ir_discharge_w && place.charge_w < place.simple_ir_charge_w);
        }
    }
}

/// Returns the pack of [`thesis_pack`] with additions to its cells.
fn augmented(kept: Vec<Kept>) -> SimModel {
    let facts = Facts {
        lowest_hz: Some(0.1),
        highest_hz: Some(300.0),
        longest_s: 100.0,
        shortest_s: 0.1,
        greatest_a: 40.0,
        widest_soc: 0.1,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 0.0,
        span_s: 0.0,
        held_out: None,
    };
    let OcvSource::Curve(ocv) = straight() else {
        panic!("a curve")
    };
    SimModel::augmented(
        &Augmented {
            base: Base {
                erm: erm(),
                ocv,
                facts,
            },
            kept,
        },
        straight(),
        thesis_pack(),
    )
    .unwrap()
}

#[test]
fn additions_move_the_limits_as_they_should() {
    let kept = |name: &str, p: &[f64]| {
        vec![Kept {
            effect: find(name).unwrap(),
            p: p.to_vec(),
        }]
    };
    let (plain, slow) = (
        augmented(Vec::new()),
        augmented(kept("rc_slow", &[1e-3, 3.0])),
    );
    let warm = augmented(kept("self_heating", &[1e-4, 600.0]));
    let options = SopOptions {
        accuracy: 1e-5,
        ..SopOptions::default()
    };
    let most =
        |model: &SimModel| most_power(model, &model.rest(0.5).unwrap(), 10.0, &options).unwrap();
    let (base, slower, warmer) = (most(&plain), most(&slow), most(&warm));
    assert!(
        slower.0.power_w < 0.98 * base.0.power_w && slower.1.power_w > 0.98 * base.1.power_w,
        "{slower:?} {base:?}"
    );
    // Discharge ends at the cell's lower voltage at the end: the warm cell bears more.
    assert!(
        warmer.0.power_w > 1.01 * base.0.power_w,
        "{warmer:?} {base:?}"
    );
    let profile = Profile::constant(Demand::Power, warmer.0.power_w, 10.0).unwrap();
    let run = simulate(
        &warm,
        &warm.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap();
    assert!(
        (0.0..1e-3).contains(&run.summary.margin_low_v),
        "{} V",
        run.summary.margin_low_v
    );
}
