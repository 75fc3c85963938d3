//! Additions of a diagnosis in the C header, each against the project's own simulation.

use analysis_effects::{
    augmented::{Augmented, Kept},
    contract::{Base, Facts, Group},
    effects::{catalogue, find},
};

use super::super::added::split;
use super::*;

/// Values of each effect of the cell, strong enough to be seen.
const EFFECTS: [(&str, &[f64]); 17] = [
    ("rc_slow", &[2e-3, 100.0]),
    ("diffusion", &[3e-3, 50.0]),
    ("warburg", &[2e-4]),
    ("cpe", &[0.2, 1.0]),
    ("butler_volmer", &[4e-3, 1.0]),
    ("butler_volmer_asymmetric", &[0.06, 1.0, 0.3]),
    ("self_heating", &[1.5e-3, 600.0]),
    ("entropic_heat", &[-5e-4, 66.0, 600.0]),
    ("ocv_slope", &[0.08]),
    ("ocv_curvature", &[3.0]),
    ("hysteresis", &[0.02, 60.0, 0.0, 0.0]),
    ("soc_resistance", &[-1.5]),
    ("current_asymmetry", &[0.2]),
    ("electrolyte_depletion", &[0.03, 20.0]),
    ("surface_soc", &[4e-3, 300.0]),
    ("self_discharge", &[0.9]),
    ("ageing", &[0.2, 0.0]),
];

/// The cell with effects, as a simulation and as an export take it.
pub(super) fn augmented(effects: &[(&str, &[f64])]) -> (Augmented, CellModel) {
    let cell = cell();
    let facts = Facts {
        lowest_hz: Some(0.01),
        highest_hz: Some(300.0),
        longest_s: 600.0,
        shortest_s: 0.1,
        greatest_a: 20.0,
        widest_soc: 0.3,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 3.0,
        span_s: 1000.0,
        held_out: None,
    };
    let base = Base {
        erm: cell.erm.clone(),
        ocv: cell.curve.clone(),
        facts,
    };
    let kept = effects.iter().map(|(name, p)| Kept {
        effect: find(name).unwrap(),
        p: p.to_vec(),
    });
    let whole = Augmented {
        kept: kept.collect(),
        base,
    };
    let found = split("cell", &whole).unwrap();
    let written = CellModel {
        erm: found.erm,
        added: found.added,
        ..cell
    };
    (whole, written)
}

/// Largest difference of the header to the simulation, V, and the change that the effects make, V;
/// `None` without a compiler.
fn apart(effects: &[(&str, &[f64])]) -> Option<(f64, f64)> {
    let (whole, written) = augmented(effects);
    let powers_w = [40.0, -35.0, 0.0, 75.0, 3.0, -20.0];
    let program = "int main(void) { eis_state s; eis_rest(&s, 0.6); double w;\n\
        while (scanf(\"%lf\", &w) == 1) {\n\
        for (int k = 0; k < 20000; ++k) eis_power_step(&s, w, 0.95, 0.001);\n\
        printf(\"%.17g\\n\", eis_look(&s, w, 0.95).terminal_v); }\n\
        return 0; }\n";
    let input: String = powers_w.iter().map(|w| format!("{w}\n")).collect();
    let met = run(&written, &[], program, &input)?;
    let ends = powers_w.into_iter().chain([0.0]);
    let row = |(k, power_w): (u32, f64)| (20.0 * f64::from(k), power_w);
    let rows: Vec<(f64, f64)> = (0..).zip(ends).map(row).collect();
    let given = Profile::new("steps", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let voltages = |model: &SimModel| -> Vec<f64> {
        let start = model.rest(0.6).unwrap();
        let trace = simulate(model, &start, &given, &SimOptions::default())
            .unwrap()
            .trace;
        let at = |end: f64| trace.time_s.iter().position(|t| (t - end).abs() < 1e-9);
        let ends = rows[1..].iter().map(|row| at(row.0).unwrap());
        ends.map(|row| trace.ccv_v[row]).collect()
    };
    let one = Pack::new(1, 1, 0.0).unwrap();
    let ocv = || OcvSource::Curve(whole.base.ocv.clone());
    let expected = voltages(&SimModel::augmented(&whole, ocv(), one).unwrap());
    let plain = voltages(&SimModel::cell(&whole.base.erm, ocv()).unwrap());
    let worst = |a: &mut dyn Iterator<Item = f64>| {
        a.zip(&expected)
            .fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
    };
    let apart_v = worst(&mut met.iter().map(|row| row[0]));
    Some((apart_v, worst(&mut plain.into_iter())))
}

#[test]
fn every_effect_of_a_cell_is_in_the_header_as_in_the_simulation() {
    for effect in catalogue() {
        let card = effect.card();
        let listed = EFFECTS.iter().any(|(name, _)| *name == card.name);
        assert_eq!(listed, card.group == Group::Cell, "{}", card.name);
    }
    for effect in EFFECTS {
        let Some((apart_v, change_v)) = apart(&[effect]) else {
            return;
        };
        let (apart_uv, change_mv) = (1e6 * apart_v, 1e3 * change_v);
        eprintln!("{}: {apart_uv:.2} µV of {change_mv:.1} mV", effect.0);
        assert!(apart_v < 1e-5, "{}: {apart_v} V", effect.0);
        assert!(change_v > 5e-4, "{}: {change_v} V", effect.0);
    }
}

#[test]
fn effects_act_together_in_the_header_as_in_the_simulation() {
    let together: Vec<(&str, &[f64])> = EFFECTS
        .into_iter()
        .filter(|(name, _)| *name != "butler_volmer_asymmetric" && *name != "cpe")
        .collect();
    let Some((apart_v, _)) = apart(&together) else {
        return;
    };
    eprintln!("together: {:.2} µV", 1e6 * apart_v);
    assert!(apart_v < 1e-5, "{apart_v} V");
}

#[test]
fn formats_without_an_addition_name_it() {
    let (_, linear) = augmented(&EFFECTS[..4]);
    let (_, bent) = augmented(&EFFECTS[6..8]);
    for format in [
        ModelFormat::PyBamm,
        ModelFormat::Simscape,
        ModelFormat::Modelica,
    ] {
        assert!(linear.text(format).is_ok());
        let error = bent.text(format).unwrap_err().to_string();
        let expected = "met Joule self-heating with Arrhenius resistance, entropic heat and \
            open-circuit voltage over temperature; C, CasADi and an FMU hold them";
        assert!(error.ends_with(expected), "{error}");
    }
    assert!(bent.text(ModelFormat::CasAdi).is_ok() && bent.fmu().is_ok());
    let twice = Augmented {
        kept: vec![
            Kept {
                effect: find("ocv_slope").unwrap(),
                p: vec![0.1],
            };
            2
        ],
        ..augmented(&[]).0
    };
    let error = split("cell", &twice).err().unwrap().to_string();
    assert!(error.contains("expected each addition once"), "{error}");
}
