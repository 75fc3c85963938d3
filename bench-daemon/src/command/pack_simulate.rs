//! `eis-bench pack simulate`: a profile through packs of cells that differ.

mod args;
mod cells;
mod draws;
mod heat;
mod links;
mod picture;
mod print;
mod report;

use analysis::{
    formats::read_profile,
    forward::{
        OcvSource,
        pack::{Draws, ScatterSetup, scatter, scatter_cells},
    },
    given::GivenModel,
    ocv::OcvCurve,
};

pub use args::PackSimulateArgs;
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;
use cells::{SINGLE, cell};
use report::{Start, report, spread};

/// Simulates packs and prints how they fared.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn simulate(args: &PackSimulateArgs) -> Result<(), Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let model = args.model.read(args.ocv.as_deref())?;
    let profile =
        read_profile(&args.profile, &args.read.options()).map_err(|error| usage(&error))?;
    let thermal = args.heat.thermal(model.map.as_ref())?;
    let start = start(args, &model)?;
    let cell = cell(&model, &start.ocv, thermal.ambient_degc)?;
    let pack = args.pack.pack()?;
    let links = args.links.as_deref();
    let links = links
        .map(|path| links::read_links(path, pack))
        .transpose()?;
    let setup = ScatterSetup {
        cell: &cell,
        map: model.map.as_ref(),
        ocv: &start.ocv,
        pack,
        links: links.as_ref(),
        tab_ohm: args.tab_ohm,
        soc: start.soc,
        profile: &profile,
        window: args.window.window(),
        thermal,
        max_step_s: args
            .max_step_s
            .unwrap_or_else(|| (profile.duration_s() / 2000.0).max(1e-3)),
    };
    let spread = spread(args);
    let draws = Draws {
        draws: args.draws,
        seed: args.seed,
    };
    let packs = cells::packs(args, &setup, &spread, draws)?;
    let met = match &packs {
        Some(packs) if args.cells.is_some() => scatter_cells(&setup, packs),
        _ => scatter(&setup, &spread, draws),
    };
    let met = met.map_err(|error| usage(&error))?;
    let means = cells::Means::new(args, &setup, packs.as_deref());
    let report = report(&setup, &model, args, &met, means, start.ocv_v);
    let json = serde_json::to_string_pretty(&report)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    if let Some(out) = &args.out {
        files::make_folder(out)?;
        files::write_text(out, "pack.json", &format!("{json}\n"))?;
        draws::write(out, &met)?;
        if let Some(loads) = &met.identical.links {
            links::write_loads(out, loads)?;
        }
        picture::write(out, &setup, &met)?;
    }
    if args.json {
        say!("{json}");
        return Ok(());
    }
    print::print(&report, &setup, packs.as_deref());
    if let Some(out) = &args.out {
        say!("written to {}", out.display());
    }
    Ok(())
}

/// The open-circuit voltage and the state of charge at the start.
fn start(args: &PackSimulateArgs, model: &GivenModel) -> Result<Start, Failure> {
    if model.map.is_some() {
        return start_of_map(args, model);
    }
    let on_curve = |curve: &OcvCurve, soc: f64| Start {
        ocv_v: curve.voltage_v(soc),
        ocv: OcvSource::Curve(curve.clone()),
        soc,
    };
    match (&model.ocv, args.soc, args.ocv_v) {
        (Some(curve), Some(soc), _) => Ok(on_curve(curve, soc)),
        (Some(curve), None, Some(ocv_v)) => {
            let soc = curve.soc_at(ocv_v).ok_or_else(|| {
                Failure::Usage(format!(
                    "--ocv-v {ocv_v}: the model's OCV curve does not reach it"
                ))
            })?;
            Ok(on_curve(curve, soc))
        }
        (None, None, Some(ocv_v)) if ocv_v.is_finite() && ocv_v > 0.0 => Ok(Start {
            ocv: OcvSource::Constant(ocv_v),
            soc: 0.5,
            ocv_v,
        }),
        (None, Some(_), _) => Err(Failure::Usage(format!(
            "--soc: {} holds no OCV curve; give --ocv-v, or a curve with --ocv",
            args.model.display_name()
        ))),
        _ => Err(Failure::Usage(
            "--ocv-v: expected a voltage above 0 V".to_owned(),
        )),
    }
}

/// As [`start`], with the correction of the map at the temperature of the surroundings.
fn start_of_map(args: &PackSimulateArgs, model: &GivenModel) -> Result<Start, Failure> {
    let Some(curve) = &model.ocv else {
        return Err(Failure::Usage(format!(
            "--model: expected an OCV curve for a model with a map, {} has none",
            args.model.display_name()
        )));
    };
    let ocv = OcvSource::Curve(curve.clone());
    let single = files::sim_model(model, ocv.clone(), SINGLE, args.heat.ambient_degc)?;
    let state = match (args.soc, args.ocv_v) {
        (Some(soc), _) => single
            .rest(soc)
            .map_err(|error| Failure::Usage(format!("--soc: {error}")))?,
        (None, ocv_v) => single
            .rest_at(ocv_v.unwrap_or(f64::NAN))
            .map_err(|error| Failure::Usage(format!("--ocv-v: {error}")))?,
    };
    Ok(Start {
        ocv,
        soc: state.soc,
        ocv_v: single.ocv_v(state.soc).0,
    })
}
