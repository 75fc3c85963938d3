//! Simulates a pack of 16S4P under a step of power, and determines how much power it can deliver
//! for ten seconds. Needs neither polars nor plotters:
//! `cargo run -p analysis --no-default-features --example simulate_load`

use analysis::forward::{Demand, OcvSource, Profile, SimModel, SimOptions, simulate};
use analysis::model::{Erm, RcBranch};
use analysis::pack::Pack;
use analysis::sop::{SopOptions, most_power};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let cell = Erm {
        r_ohm: 0.0064,
        branches: vec![RcBranch {
            r_ohm: 0.0020,
            c_f: 5.0,
        }],
    };
    let model = SimModel::pack(&cell, OcvSource::Constant(3.7), Pack::new(16, 4, 0.0)?)?;
    let load = Profile::constant(Demand::Power, 2000.0, 10.0)?;
    let run = simulate(&model, &model.rest(0.5)?, &load, &SimOptions::default())?;
    println!(
        "2 kW for 10 s: lowest {:.2} V, {:.0} J of heat",
        run.summary.min_ccv_v, run.summary.heat_j
    );
    let (discharge, charge) = most_power(&model, &model.rest(0.5)?, 10.0, &SopOptions::default())?;
    println!(
        "10 s: {:.0} W out, {:.0} W in",
        discharge.power_w, charge.power_w
    );
    Ok(())
}
