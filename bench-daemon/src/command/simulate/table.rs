//! `eis-bench simulate --table`: one row for each model and profile.

use std::path::{Path, PathBuf};

use analysis::{
    batch::{TableModel, is_table_of_models, read_models},
    formats::read_profile,
    forward::{
        Demand, ForwardError, Profile, ScaleOptions, SimModel, SimOptions, Summary, largest_scale,
        simulate,
    },
    given::GivenModel,
    map::Outside,
    rows::{Cell, ResultColumn, ResultRow},
};

use super::input::{
    SimulateArgs, beyond, check_euler, options, source_of_ocv, state, usage, window,
};
use crate::command::batch::{Items, Job, paths, work};
use bench_core::safety::failure::Failure;
use bench_evaluate::files;

/// Simulations of one part: some seconds of work.
const PART: usize = 1024;

/// A model that carries a profile.
struct Load {
    model_id: String,
    model: Result<GivenModel, String>,
    /// Number of the profile.
    profile: usize,
}

/// Each model with each profile.
struct Loads {
    models: Vec<TableModel>,
    /// The model of a file that is not a table.
    single: Option<GivenModel>,
    profiles: usize,
    next: usize,
    identity: String,
}

impl Loads {
    fn count(&self) -> usize {
        self.models.len().max(usize::from(self.single.is_some())) * self.profiles
    }
}

impl Items for Loads {
    type Item = Load;

    fn identity(&self) -> Result<String, Failure> {
        Ok(self.identity.clone())
    }

    fn share(&self) -> f64 {
        self.next as f64 / self.count().max(1) as f64
    }

    fn next(&mut self) -> Result<Option<Load>, Failure> {
        if self.next == self.count() {
            return Ok(None);
        }
        let (number, profile) = (self.next / self.profiles, self.next % self.profiles);
        self.next += 1;
        let load = if let Some(model) = &self.single {
            Load {
                model_id: model.name.clone(),
                model: Ok(model.clone()),
                profile,
            }
        } else {
            let row = &self.models[number];
            let typed =
                |erm| GivenModel::typed(&row.spectrum_id, erm).map_err(|error| error.to_string());
            Load {
                model_id: row.spectrum_id.clone(),
                model: row.model.clone().and_then(typed),
                profile,
            }
        };
        Ok(Some(load))
    }
}

/// Simulates each profile with each model of a table of fits, or with the one model.
pub(super) fn table(args: &SimulateArgs, table: &Path) -> Result<(), Failure> {
    for (name, given) in [
        ("--json", args.json),
        ("--out", args.out.is_some()),
        ("--dcir-ohm", args.dcir_ohm.is_some()),
    ] {
        if given {
            return Err(Failure::Usage(format!(
                "{name}: expected no --table beside it: a table has one row for each simulation"
            )));
        }
    }
    let window = window(args)?;
    beyond(args)?;
    let paths = paths::files_of(&args.profiles, "profiles")?;
    let mut profiles = Vec::new();
    for path in &paths {
        profiles.push(read_profile(path, &args.read.options()).map_err(usage)?);
    }
    let named: Vec<&PathBuf> = paths
        .iter()
        .chain(&args.model.model)
        .chain(&args.ocv)
        .collect();
    let identity: Result<String, Failure> = named
        .into_iter()
        .map(|path| paths::identity(path))
        .collect();
    let of_fits = args
        .model
        .model
        .as_deref()
        .filter(|path| is_table_of_models(path));
    let (models, single) = match of_fits {
        Some(path) => (read_models(path).map_err(usage)?, None),
        None => (Vec::new(), Some(args.model.read(args.ocv.as_deref())?)),
    };
    let curve = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let mut loads = Loads {
        models,
        single,
        profiles: profiles.len(),
        next: 0,
        identity: identity?,
    };
    let pack = args.pack.pack()?;
    let job = Job {
        table,
        call: format!("simulate {args:?}"),
        columns: columns(),
        part: PART,
        noun: ["simulation", "simulations"],
    };
    let run = |load: &Load| -> Result<(Summary, Option<f64>), Failure> {
        let given = load.model.clone().map_err(Failure::Usage)?;
        let file = given.with_ocv(curve.clone());
        let ocv = source_of_ocv(args, &file, &load.model_id)?;
        let model = files::sim_model(&file, ocv, pack, args.ambient_degc)?;
        let state = state(args, &model)?;
        let profile = &profiles[load.profile];
        check_euler(args, &model, profile)?;
        // The figures come from the steps of the solver, so rows of a trace are not needed.
        let options = SimOptions {
            max_step_s: args.step_s.unwrap_or(f64::INFINITY),
            ..options(args, profile, window)?
        };
        let run = simulate(&model, &state, profile, &options).map_err(usage)?;
        let scale = ScaleOptions {
            window,
            ..ScaleOptions::for_profile(profile)
        };
        let factor = if args.largest_factor {
            factor(&model, &state, profile, &scale).map_err(usage)?
        } else {
            None
        };
        Ok((run.summary, factor))
    };
    let row = |load: &Load| vec![row(load, &profiles[load.profile], run(load))];
    work(job, &mut loads, row, |_, _| Ok(()))
}

/// Returns the largest factor on the profile that keeps the window, or `None` for a load
/// resistance.
fn factor(
    model: &SimModel,
    state: &analysis::forward::SimState,
    profile: &Profile,
    scale: &ScaleOptions,
) -> Result<Option<f64>, ForwardError> {
    match profile.demand {
        Demand::Resistance => Ok(None),
        Demand::Power | Demand::Current => {
            largest_scale(model, state, profile, scale).map(|limit| Some(limit.factor))
        }
    }
}

/// A column of numbers, and the quantity of a simulation that it shows.
type Figure = (&'static str, fn(&Summary) -> f64);

/// Columns of numbers.
const NUMBERS: [Figure; 15] = [
    ("min_ccv_v", |s| s.min_ccv_v),
    ("min_ccv_time_s", |s| s.min_ccv_time_s),
    ("max_ccv_v", |s| s.max_ccv_v),
    ("max_ccv_time_s", |s| s.max_ccv_time_s),
    ("margin_low_v", |s| s.margin_low_v),
    ("margin_high_v", |s| s.margin_high_v),
    ("energy_j", |s| s.energy_j),
    ("charge_c", |s| s.charge_coulomb),
    ("heat_j", |s| s.heat_j),
    ("peak_power_w", |s| s.peak_power_w),
    ("lowest_power_w", |s| s.lowest_power_w),
    ("peak_current_a", |s| s.peak_current_a),
    ("lowest_current_a", |s| s.lowest_current_a),
    ("soc_min", |s| s.soc_min.unwrap_or(f64::NAN)),
    ("soc_max", |s| s.soc_max.unwrap_or(f64::NAN)),
];

fn columns() -> Vec<ResultColumn> {
    let mut columns = vec![
        ResultColumn::text("spectrum_id"),
        ResultColumn::text("profile"),
    ];
    columns.extend(NUMBERS.map(|(name, _)| ResultColumn::number(name)));
    columns.push(ResultColumn::number("largest_factor"));
    columns.extend(["warning_codes", "warnings", "error"].map(ResultColumn::text));
    columns
}

fn row(
    load: &Load,
    profile: &Profile,
    result: Result<(Summary, Option<f64>), Failure>,
) -> ResultRow {
    let mut cells = vec![Cell::text(&load.model_id), Cell::text(&profile.name)];
    let (warnings, error) = match result {
        Ok((summary, factor)) => {
            cells.extend(NUMBERS.map(|(_, of)| Cell::finite(of(&summary))));
            cells.push(Cell::Number(factor));
            (warnings(&summary), None)
        }
        Err(failure) => {
            cells.extend(NUMBERS.map(|_| Cell::Number(None)));
            cells.push(Cell::Number(None));
            (Vec::new(), Some(failure.to_string()))
        }
    };
    let list = |of: fn(&(&'static str, String)) -> String, between: &str| {
        warnings.iter().map(of).collect::<Vec<_>>().join(between)
    };
    cells.push(Cell::text(list(|warning| warning.0.to_owned(), ";")));
    cells.push(Cell::text(list(|warning| warning.1.clone(), "; ")));
    cells.push(Cell::Text(error.clone()));
    ResultRow {
        cells,
        error,
        has_warnings: !warnings.is_empty(),
        fitted: None,
    }
}

/// Returns the warnings of a summary, as codes and text.
fn warnings(summary: &Summary) -> Vec<(&'static str, String)> {
    let mut found = Vec::new();
    if let Some(first) = summary.infeasible.first() {
        let (time_s, asked_w, had_w) = (first.time_s, first.power_w, first.available_w);
        found.push((
            "infeasible",
            format!("at {time_s:.4} s {asked_w:.1} W were requested, {had_w:.1} W were available"),
        ));
    }
    if summary.margin_low_v < 0.0 {
        let below_v = -summary.margin_low_v;
        let words = format!("a cell falls {below_v:.3} V below its lower limit");
        found.push(("below_window", words));
    }
    if summary.margin_high_v < 0.0 {
        let above_v = -summary.margin_high_v;
        let words = format!("a cell rises {above_v:.3} V above its upper limit");
        found.push(("above_window", words));
    }
    if let Some(outside) = summary.outside_map.filter(Outside::is_outside) {
        found.push(("outside_map", outside.to_string()));
    }
    if let Some(soc) = summary.soc_min.filter(|soc| *soc < 0.0) {
        found.push((
            "below_empty",
            format!("the state of charge falls to {soc:.3}"),
        ));
    }
    if let Some(soc) = summary.soc_max.filter(|soc| *soc > 1.0) {
        found.push((
            "above_full",
            format!("the state of charge rises to {soc:.3}"),
        ));
    }
    found
}
