//! `map --next`: what to measure next for given loads, and the experiment that measures it.

use std::path::{Path, PathBuf};

use crate::command::load_args::LoadArgs;
use analysis::{
    forward::Profile,
    map::{Choices, Fitted, Measurement, NextPlan, plan_next},
    run_folder::JOURNAL,
};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    investigate::cell_map::{
        base::{Base, folder_of},
        data::measured_places,
        offers::{Offers, check_errors},
    },
    run::Recorded,
};
use bench_plan::{
    config::{MapPlace, load_experiment},
    procedure,
    support::terminal::{remark, say},
};

/// Arguments that choose measurements.
#[derive(Debug, Clone, clap::Args)]
pub struct NextArgs {
    /// Choose this number of further spectra and pulses, each where it takes most off the predicted
    /// error of the loads per minute of bench time.
    #[arg(long, value_name = "N", requires = "under")]
    pub next: Option<std::num::NonZeroUsize>,
    /// Loads of --next.
    #[command(flatten)]
    pub loads: LoadArgs,
    /// The experiment that is to measure further points: at each temperature of its [map], with its
    /// sweep, its pulses, its rests and its limits, without the points that runs in DATA have measured
    /// [default: that of the first run folder in DATA that has a [map]]
    #[arg(long, value_name = "FILE", requires = "next")]
    pub experiment: Option<PathBuf>,
    /// Write an experiment that measures the chosen points: the other one with `points` in its [map].
    #[arg(long, value_name = "FILE", requires = "next")]
    pub write: Option<PathBuf>,
}

/// What is read for the choice before the map is fitted.
pub(super) struct Wanted {
    profiles: Vec<Profile>,
    base: Option<Base>,
    /// Points that the runs in DATA have measured.
    measured: Vec<MapPlace>,
}

/// Reads the loads and the experiment that is to measure further points.
///
/// # Errors
/// Arguments that lack another one; a file that cannot be read; an experiment without `[map]`.
pub(super) fn read(next: &NextArgs, data: &[PathBuf]) -> Result<Option<Wanted>, Failure> {
    if next.next.is_none() {
        if next.loads.under.is_empty() {
            return Ok(None);
        }
        let reason =
            "--under: expected --next, whose measurements are chosen for the loads, found none";
        return Err(Failure::Usage(reason.to_owned()));
    }
    let (runs, measured) = recorded(data)?;
    let base = match &next.experiment {
        Some(file) => Some(Base::of(&load_experiment(file, None)?)?),
        None => runs.first().cloned(),
    };
    if base.is_none() && next.write.is_some() {
        let reason = "--write: expected --experiment with a file that has a [map], or a run of such an \
            experiment in DATA, found neither";
        return Err(Failure::Usage(reason.to_owned()));
    }
    next.write.as_deref().map_or(Ok(()), refuse_existing)?;
    let profiles = next.loads.demands().read()?;
    Ok(Some(Wanted {
        profiles,
        base,
        measured,
    }))
}

/// Refuses to write over a file.
fn refuse_existing(file: &Path) -> Result<(), Failure> {
    if !file.exists() {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "--write {}: expected the name of a new file, found one that exists",
        file.display()
    )))
}

/// The experiments of the runs that have a map, and the points that they have measured.
fn recorded(data: &[PathBuf]) -> Result<(Vec<Base>, Vec<MapPlace>), Failure> {
    let (mut found, mut measured) = (Vec::new(), Vec::new());
    for folder in data.iter().filter(|path| path.join(JOURNAL).is_file()) {
        let run = Recorded::read(folder)?;
        if let Some(map) = &run.experiment().map {
            measured.extend(measured_places(folder, map)?);
            found.push(Base::of(run.experiment())?);
        }
    }
    Ok((found, measured))
}

/// Chooses the measurements.
///
/// # Errors
/// A load that cannot be simulated; no point that the experiment can measure.
pub(super) fn plan(args: &NextArgs, wanted: &Wanted, fitted: Fitted) -> Result<NextPlan, Failure> {
    let demands = args.loads.demands();
    let of_map = || fitted.fit.map.temperature_degc.clone();
    let of_base = |base: &Base| {
        base.map()
            .temperatures
            .iter()
            .map(|at| at.degc.value())
            .collect()
    };
    let degc = if demands.at_degc.is_empty() {
        wanted.base.as_ref().map_or_else(of_map, of_base)
    } else {
        demands.at_degc.clone()
    };
    let choices = match &wanted.base {
        Some(base) => {
            let mut offers = Offers::of(base)?;
            offers.forget(&wanted.measured);
            offers.notes.iter().for_each(|note| remark!("note: {note}"));
            offers.choices
        }
        None => Choices::new(fitted.ocv.capacity_ah, &Choices::SOC, &degc),
    };
    let loads = demands.loads(&wanted.profiles, &degc, fitted)?;
    let count = args.next.map_or(0, std::num::NonZeroUsize::get);
    let plan = plan_next(fitted, &loads, &choices, count)
        .map_err(|error| Failure::Usage(error.to_string()))?;
    check_errors(&plan)?;
    Ok(plan)
}

/// Writes the experiment that measures the chosen points, if requested; returns how long it takes.
///
/// # Errors
/// No point; a point that the limits of cell and bench do not allow; a file that cannot be written.
pub(super) fn write(
    args: &NextArgs,
    wanted: &Wanted,
    plan: &NextPlan,
) -> Result<Option<String>, Failure> {
    let (Some(file), Some(base)) = (&args.write, &wanted.base) else {
        return Ok(None);
    };
    let places = base.in_order(&plan.next);
    if places.is_empty() {
        let reason = "--write: no measurement lowers the error of the loads: no file was written";
        return Err(Failure::Usage(reason.to_owned()));
    }
    let text = base.text_at(file, &places)?;
    refuse_existing(file)?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    files::write_text(folder_of(file), &name, &text)?;
    let experiment = load_experiment(file, None)?;
    let plan = procedure::plan(&experiment).check(&experiment.cell.limits)?;
    let extent = plan.plan().extent();
    Ok(Some(format!(
        "{}: {} points, {:.1} h, {:.1} Ah out of the cell and {:.1} Ah into it",
        file.display(),
        places.len(),
        plan.plan().expected_s() / 3600.0,
        extent.out_coulomb / 3600.0,
        extent.into_coulomb / 3600.0
    )))
}

/// Prints the proposed measurements.
pub(super) fn print(plan: &NextPlan) {
    say!("");
    say!(
        "what to measure next: the predicted error of the loads is {:.2} mV (one standard deviation)",
        1e3 * plan.error_v
    );
    if plan.next.is_empty() {
        say!("  no measurement lowers it");
        return;
    }
    say!(
        "  {:>5}  {:>6}  {:>10}  {:>6}  {:>8}",
        "SOC",
        "T/°C",
        "what",
        "min",
        "error/mV"
    );
    let mut minutes = 0.0;
    for next in &plan.next {
        let what = match next.what {
            Measurement::Spectrum => "spectrum",
            Measurement::Pulses => "pulses",
        };
        say!(
            "  {:>5.2}  {:>6.1}  {what:>10}  {:>6.0}  {:>8.2}",
            next.soc,
            next.temperature_degc,
            next.minutes,
            1e3 * next.error_v
        );
        minutes += next.minutes;
    }
    say!("  {:.1} h of bench time", minutes / 60.0);
}
