//! Effect of the scatter of resistances from run to run on the rows of a cell with effects.

use super::super::block::{Block, Model, Workspace};
use super::super::noise::{Prior, Shape};
use super::bench::{BLOCK, BRANCHES, Chance, HISTORY, Hidden, R0, campaign, model, record};
use crate::{Run, RunData};
use analysis_effects::{
    augmented::Added,
    contract::{Base, Facts},
    effects::find,
};
use num_complex::Complex64;

/// Returns the change of the rows per part by which all resistances are larger.
fn scatter(run: &Run, effects: &[(&str, &[f64])]) -> Vec<f64> {
    let model = model();
    let base = Base {
        erm: model.erm,
        ocv: model.ocv,
        facts: Facts {
            temperature_degc: 25.0,
            ..Facts::NONE
        },
    };
    let added: Vec<Added<'_>> = effects
        .iter()
        .map(|(name, p)| Added {
            effect: find(name).unwrap(),
            p,
        })
        .collect();
    let block = Block::new(run, &base, 0.0).unwrap();
    Shape::new(
        &block,
        &Model::new(&base, &added),
        &Prior::new(Some(HISTORY), None, &base),
        &mut Workspace::default(),
    )
    .trend(1.0)
}

fn near(met: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(met.len(), expected.len());
    let off = met
        .iter()
        .zip(expected)
        .map(|(m, e)| (m - e).abs())
        .fold(0.0, f64::max);
    assert!(
        off < tolerance,
        "off by {off}: met {met:?}, expected {expected:?}"
    );
}

#[test]
fn a_spectrum_scatters_by_the_network_of_the_cell_and_not_by_its_contact() {
    let set = campaign(1, &Hidden::default(), &Hidden::default());
    let run = set
        .runs
        .iter()
        .find(|r| matches!(r.data, RunData::Eis(_)))
        .unwrap();
    let RunData::Eis(sweep) = &run.data else {
        unreachable!()
    };
    let network = |slow: (f64, f64)| {
        let rows = sweep.points.iter().flat_map(|point| {
            let arc = |(r, tau): (f64, f64)| {
                r / Complex64::new(1.0, std::f64::consts::TAU * point.freq_hz * tau)
            };
            let z = R0 + BRANCHES.into_iter().map(arc).sum::<Complex64>() + arc(slow);
            [z.re, z.im]
        });
        rows.collect::<Vec<f64>>()
    };
    near(&scatter(run, &[]), &network((0.0, 1.0)), 1e-9);
    near(
        &scatter(run, &[("contact_resistance", &[2e-3])]),
        &network((0.0, 1.0)),
        1e-9,
    );
    near(
        &scatter(run, &[("rc_slow", &[5e-3, 47.0])]),
        &network((5e-3, 47.0)),
        1e-9,
    );
}

#[test]
fn a_record_scatters_by_what_a_charge_transfer_drops_and_not_by_the_salt() {
    let set = campaign(1, &Hidden::default(), &Hidden::default());
    let at = set
        .runs
        .iter()
        .position(|r| r.repeat_group == "block")
        .unwrap();
    let mut run = set.runs[at].clone();
    let mut series = record(BLOCK, 0.2, &Hidden::default(), &mut Chance::new(1));
    // Commanded current, without the errors of the meter.
    series.current_a.iter_mut().for_each(|i| *i = i.round());
    if let RunData::Time(time) = &mut run.data {
        time.series = series;
    }
    let plain = scatter(&run, &[]);
    near(
        &scatter(&run, &[("electrolyte_depletion", &[5e-3, 3.0])]),
        &plain,
        1e-9,
    );
    // Settled at 25 A: the second branch drops asinh(βi)/β of its resistance.
    let lowest = |rows: &[f64]| rows.iter().copied().fold(0.0, f64::min);
    let linear_v = 25.0 * (R0 + BRANCHES[0].0 + BRANCHES[1].0);
    assert!(
        (lowest(&plain) + linear_v).abs() < 1e-6 * linear_v,
        "{} V, expected {} V",
        lowest(&plain),
        -linear_v
    );
    let beta = 0.05;
    let kinetic_v = 25.0 * (R0 + BRANCHES[0].0) + BRANCHES[1].0 * (beta * 25.0_f64).asinh() / beta;
    let met_v = lowest(&scatter(&run, &[("butler_volmer", &[beta * beta, 1.0])]));
    assert!(
        (met_v + kinetic_v).abs() < 1e-5 * kinetic_v,
        "{met_v} V, expected {} V",
        -kinetic_v
    );
}
