//! `eis-bench simulate`: load profiles through a fitted model, as a cell or as a pack.

mod band;
mod case;
mod figure;
mod input;
mod table;

use crate::command::profile_args::taken;
use bench_core::safety::failure::Failure;
use bench_evaluate::{files, support::present::one_or_list};
use bench_plan::support::terminal::{remark, say};
use std::path::{Path, PathBuf};

use analysis::{
    dataset::write_trace_parquet,
    formats::read_profile,
    forward::{ForwardError, Infeasible, SimModel},
    given::GivenModel,
};

use case::{Assumed, Case, Output};
pub use input::SimulateArgs;
use input::{check_euler, options, source_of_ocv, state, usage, window};

/// Runs the profiles, prints what comes of them, and writes traces and plots.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn simulate(args: &SimulateArgs) -> Result<(), Failure> {
    if let Some(path) = &args.table {
        return table::table(args, path);
    }
    let (file, model) = model(args)?;
    let state = state(args, &model)?;
    let window = window(args)?;
    let mut outputs = Vec::new();
    let mut cases = Vec::new();
    for path in &args.profiles {
        let profile = read_profile(path, &args.read.options()).map_err(usage)?;
        check_euler(args, &model, &profile)?;
        let options = options(args, &profile, window)?;
        let assumed = Assumed {
            dcir_ohm: args.dcir_ohm,
            sigma_r: args.sigma_r,
        };
        let case = Case::run(&file, &model, &state, profile, options, assumed);
        let case = case.map_err(|error| match error {
            ForwardError::Unstable { .. } => Failure::Usage(format!("--step-s: {error}")),
            other => usage(other),
        })?;
        let trace = args
            .out
            .as_ref()
            .map(|folder| trace_path(folder, args.profiles.len(), &case.profile.name, &outputs));
        if let Some(trace) = &trace {
            write_trace_parquet(trace, &case.full.trace, window)
                .map_err(|error| Failure::Analysis(error.to_string()))?;
        }
        outputs.push(case.output(&file, &model, trace));
        cases.push(case);
    }
    if let Some(folder) = &args.out {
        figure::write(folder, &cases, &model, window)?;
    }
    if args.json {
        print_json(&outputs)
    } else {
        print_text(&outputs, &model, &cases, args)
    }
}

fn model(args: &SimulateArgs) -> Result<(GivenModel, SimModel), Failure> {
    let file = args.model.read(args.ocv.as_deref())?;
    let ocv = source_of_ocv(args, &file, &args.model.display_name())?;
    let pack = args.pack.pack()?;
    let model = files::sim_model(&file, ocv, pack, args.ambient_degc)?;
    if let Some(folder) = &args.out {
        files::make_folder(folder)?;
    }
    Ok((file, model))
}

/// Two profiles of one name from different folders must not share a trace.
fn trace_path(folder: &Path, profiles: usize, name: &str, earlier: &[Output]) -> PathBuf {
    let path = |number: usize| match (profiles, number) {
        (1, _) => folder.join("trace.parquet"),
        (_, 0) => folder.join(format!("{name}.trace.parquet")),
        _ => folder.join(format!("{name}-{}.trace.parquet", number + 1)),
    };
    (0..)
        .map(path)
        .find(|path| {
            earlier
                .iter()
                .all(|other| other.trace.as_ref() != Some(path))
        })
        .unwrap_or_else(|| Path::new("trace.parquet").to_owned())
}

fn print_json(outputs: &[Output]) -> Result<(), Failure> {
    let text = one_or_list(outputs).map_err(|error| Failure::Analysis(error.to_string()))?;
    say!("{text}");
    Ok(())
}

fn print_text(
    outputs: &[Output],
    model: &SimModel,
    cases: &[Case],
    args: &SimulateArgs,
) -> Result<(), Failure> {
    let (fast, slow) = (1e3 * model.erm.r_ohm, 1e3 * model.erm.dc_resistance_ohm());
    let rest = outputs
        .first()
        .zip(cases.first())
        .and_then(|(_, case)| case.full.trace.ocv_v.first().copied())
        .unwrap_or(f64::NAN);
    say!(
        "{}: {} RC, at the terminals R {fast:.2} mΩ, DC resistance {slow:.2} mΩ, OCV {rest:.2} V",
        model.pack.name(),
        model.erm.branches.len()
    );
    let dcir_mohm = 1e3 * outputs.first().map_or(f64::NAN, |o| o.simple_ir.dcir_ohm);
    let source = if args.dcir_ohm.is_some() {
        "as given"
    } else {
        "of the model"
    };
    say!(
        "cells within {} to {} V; simple IR is a DC resistance of {dcir_mohm:.2} mΩ per cell \
        alone, {source}",
        args.window.v_min,
        args.window.v_max
    );
    for case in cases {
        say!("{}", taken(&case.profile));
    }
    say!("");
    case::print_table(outputs);
    for output in outputs {
        if let Some(Infeasible {
            time_s,
            power_w,
            available_w,
            ..
        }) = &output.first_infeasible
        {
            remark!(
                "{}: at {time_s:.4} s {power_w:.1} W were requested, {available_w:.1} W were \
                available",
                output.profile
            );
        }
        if let Some(end) = &output.summary.tangent_end {
            remark!(
                "{}: the run ends at {:.4} s of its profile: see the note",
                output.profile,
                end.time_s
            );
        }
    }
    say!("");
    for output in outputs {
        say!("{}", case::sentence(output));
    }
    let mut printed: Vec<&String> = Vec::new();
    for note in outputs.iter().flat_map(|output| &output.notes) {
        if !printed.contains(&note) {
            say!("note: {note}");
            printed.push(note);
        }
    }
    say!("");
    for output in outputs {
        if let Some(trace) = &output.trace {
            say!("trace of {}: {}", output.profile, trace.display());
        }
    }
    match &args.out {
        Some(folder) => say!("plots in {}", folder.display()),
        None => say!("no trace and no plots were written; --out DIR writes them"),
    }
    Ok(())
}
