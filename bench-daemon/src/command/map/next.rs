//! `map --next`: what to measure next for given loads.

use std::path::PathBuf;

use analysis::{
    formats::{ReadOptions, read_profile},
    forward::{Interpolation, Profile, SimModel, SimOptions, simulate},
    map::{Choices, Fitted, Load, Measurement, NextPlan, plan_next},
    pack::Pack,
};
use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::say;

/// States of charge at which each load starts.
const STARTS: [f64; 3] = [0.9, 0.5, 0.2];
/// Shortest load, s: a shorter profile is repeated.
const LEAST_LOAD_S: f64 = 600.0;
/// Longest time between two rows of a load, s.
const LONGEST_ROW_S: f64 = 30.0;
/// Duration of a step of the current, s.
const STEP_S: f64 = 1e-4;

/// Arguments that choose measurements.
#[derive(Debug, Clone, clap::Args)]
pub struct NextArgs {
    /// Choose this number of further spectra and pulses, each where it takes most off the predicted
    /// error of the loads per minute of bench time.
    #[arg(long, value_name = "N", requires = "under")]
    pub next: Option<std::num::NonZeroUsize>,
    /// A load for --next, as `simulate` reads profiles; may be given several times. It starts at
    /// 90, 50 and 20 % of charge and at each of --at-degc, and is repeated for ten minutes.
    #[arg(long, value_name = "PROFILE", requires = "next")]
    pub under: Vec<PathBuf>,
    /// Temperatures at which the loads flow and at which may be measured, °C, separated by commas
    /// [default: those of the map]
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        allow_hyphen_values = true,
        requires = "next"
    )]
    pub at_degc: Vec<f64>,
    /// Cells in series of the pack that the loads are for.
    #[arg(long, default_value_t = 1, value_name = "N", requires = "next")]
    pub series: u32,
    /// Cells in parallel of that pack.
    #[arg(long, default_value_t = 1, value_name = "N", requires = "next")]
    pub parallel: u32,
}

/// Reads the loads.
///
/// # Errors
/// A profile that cannot be read.
pub(super) fn read(args: &NextArgs) -> Result<Vec<Profile>, Failure> {
    let options = ReadOptions {
        demand: None,
        interpolation: Interpolation::Hold,
        charge_positive: false,
    };
    let profiles = args.under.iter().map(|path| read_profile(path, &options));
    profiles
        .map(|read| read.map(|profile| repeated(&profile)))
        .collect::<Result<_, _>>()
        .map_err(|error| Failure::Usage(error.to_string()))
}

/// Chooses the measurements, if requested.
///
/// # Errors
/// A load that cannot be simulated.
pub(super) fn plan(
    args: &NextArgs,
    profiles: &[Profile],
    fitted: Fitted,
) -> Result<Option<NextPlan>, Failure> {
    let Some(count) = args.next else {
        return Ok(None);
    };
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let degc = if args.at_degc.is_empty() {
        fitted.fit.map.temperature_degc.clone()
    } else {
        args.at_degc.clone()
    };
    let pack = Pack::new(args.series, args.parallel, 0.0).map_err(|error| usage(&error))?;
    let mut loads = Vec::new();
    for profile in profiles {
        for ambient_degc in &degc {
            for soc in STARTS {
                loads.push(load(profile, fitted, pack, *ambient_degc, soc)?);
            }
        }
    }
    let choices = Choices::new(fitted.ocv.capacity_ah, degc);
    plan_next(fitted, &loads, &choices, count.get())
        .map(Some)
        .map_err(|error| usage(&error))
}

/// The current of a cell under a profile that is repeated, as the map predicts it.
fn load(
    profile: &Profile,
    fitted: Fitted,
    pack: Pack,
    ambient_degc: f64,
    soc: f64,
) -> Result<Load, Failure> {
    let fail = |error: &dyn std::fmt::Display| {
        Failure::Usage(format!("--under {}: {error}", profile.name))
    };
    let (map, curve) = (fitted.fit.map.clone(), fitted.ocv.clone());
    let model = SimModel::mapped(map, curve, pack, ambient_degc).map_err(|error| fail(&error))?;
    let start = model.rest(soc).map_err(|error| fail(&error))?;
    let options = SimOptions {
        max_step_s: LONGEST_ROW_S,
        ..SimOptions::default()
    };
    let run = simulate(&model, &start, profile, &options).map_err(|error| fail(&error))?;
    if run.summary.feasible {
        let mut load = Load {
            name: profile.name.clone(),
            time_s: Vec::new(),
            current_a: Vec::new(),
            soc,
            temperature_degc: ambient_degc,
        };
        let trace = &run.trace;
        let rows = trace.time_s.iter().zip(&trace.current_a).zip(&trace.soc);
        for ((time_s, current_a), _) in rows.take_while(|(_, soc)| **soc > 0.0) {
            // The second of two rows at one time is the other side of a step.
            let last_s = load.time_s.last().copied().unwrap_or(f64::NEG_INFINITY);
            load.time_s.push(if *time_s > last_s {
                *time_s
            } else {
                last_s + STEP_S
            });
            load.current_a.push(current_a / f64::from(pack.parallel));
        }
        return Ok(load);
    }
    Err(fail(&format!(
        "expected a load that the pack can supply from {:.0} % of charge at {ambient_degc} °C, found more \
        power; check --series and --parallel",
        100.0 * soc
    )))
}

/// Repeats a profile until it lasts for a while.
fn repeated(profile: &Profile) -> Profile {
    let rows = profile.time_s.len();
    let duration_s = profile.duration_s();
    let count = (LEAST_LOAD_S / duration_s).ceil().max(1.0) as usize;
    let mut long = profile.clone();
    for k in 1..count {
        // The last row of a profile only ends it.
        long.time_s.pop();
        long.value.pop();
        let from_s = duration_s * k as f64;
        long.time_s
            .extend(profile.time_s.iter().map(|t| from_s + t));
        long.value.extend(&profile.value[..rows]);
    }
    long
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
