//! The pack explorer: simulates a load on a pack of cells of a fitted model, fast enough to
//! follow a slider.

use std::{
    cmp::Ordering,
    path::Path,
    sync::{Mutex, PoisonError},
};

use analysis::{
    fit::MAX_RC,
    forward::{
        Beyond, CellWindow, Demand, Interpolation, OcvSource, Profile, SimOptions, Simulation,
        simulate,
    },
    given::GivenModel,
    map::{CellMap, Outside},
    ocv::OcvCurve,
    pack::Pack,
    run_folder,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    find,
    jobs::{Job, Jobs},
    settings::Settings,
    submission,
};
use bench_evaluate::files::{self, read_model};
use bench_plan::{
    config::{Source, erm_text, resolve_cell},
    support::confined_path,
};

/// Rows of an answer at most, besides jumps.
const ROWS: f64 = 500.0;
/// Duration of a constant power, s.
const CONSTANT_S: f64 = 10.0;
/// Most cells in series and in parallel.
const MOST_CELLS: u32 = 1000;
/// Maximum number of runs whose models are listed, the latest first.
const MOST_RUNS: usize = 200;
/// Largest factor on a profile.
const LARGEST_SCALE: f64 = 100.0;
/// Larger differences from the temperature of the measurement are reported, K.
const NEAR_K: f64 = 2.0;

/// Text of a profile of the repository.
macro_rules! profile {
    ($name:literal) => {
        include_str!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../fixtures/data/profiles/",
            $name,
            ".csv"
        ))
    };
}
/// Measured power of a legged robot over time (see `fixtures/data/profiles/README.md`), W.
const PROFILES: [(&str, &str); 4] = [
    ("walking", profile!("walking")),
    ("lateral_jump", profile!("lateral_jump")),
    ("spin_jump", profile!("spin_jump")),
    ("gap_2m", profile!("gap_2m")),
];

/// A load on a pack.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// The cell.
    model: CellModel,
    /// Cells in series, 1 to 1000.
    series: u32,
    /// Cells in parallel, 1 to 1000.
    parallel: u32,
    /// State of charge at the start, 0 to 1; needs a model with an open-circuit voltage.
    #[serde(default)]
    soc: Option<f64>,
    /// Open-circuit voltage of a cell at the start, V, instead of `soc`.
    #[serde(default)]
    ocv_v: Option<f64>,
    /// Temperature of the surroundings and of the cells at the start, °C; left out: 25 °C. A model
    /// without a map does not depend on it: it is compared with that of the measurement.
    #[serde(default)]
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<f64>,
    /// `walking`, `lateral_jump`, `spin_jump`, `gap_2m` or `constant`.
    profile: String,
    /// Constant power, W, discharge positive.
    #[serde(default)]
    power_w: Option<f64>,
    /// Factor on the profile, above 0 to 100.
    #[serde(default)]
    scale: Option<f64>,
    /// Lowest voltage of the pack, V. Left out: 2.5 V for each cell in series.
    #[serde(default)]
    voltage_min_v: Option<f64>,
    /// Highest voltage of the pack, V. Left out: 4.2 V for each cell in series.
    #[serde(default)]
    voltage_max_v: Option<f64>,
    /// Greatest current of the pack, A. Left out: no limit.
    #[serde(default)]
    current_max_a: Option<f64>,
}

/// The model of a cell: of a run, or as text.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum CellModel {
    /// A model of a run.
    OfRun {
        /// The run.
        run: String,
        /// The model's file without its ending, such as `model_4rc` or `map`.
        name: String,
    },
    /// A model as text.
    Typed {
        /// Text, such as `6.43 mΩ; 1.51 mΩ, 0.553 F`.
        erm: String,
    },
}

/// Response of the pack to the load.
#[derive(Debug, Serialize, ToSchema)]
pub struct UnderLoad {
    /// Time, s.
    time_s: Vec<f64>,
    /// Power at the terminals, W, discharge positive.
    power_w: Vec<f64>,
    /// Voltage at the terminals, V.
    voltage_v: Vec<f64>,
    /// Current, A, discharge positive.
    current_a: Vec<f64>,
    /// Lowest voltage, V.
    lowest_v: f64,
    /// Time of the lowest voltage, s.
    at_s: f64,
    /// Highest voltage, V.
    highest_v: f64,
    /// Greatest current, A.
    highest_a: f64,
    /// Heat in the resistances, J.
    heat_j: f64,
    /// Distance of the lowest voltage from the lower limit, V; negative below it.
    margin_v: f64,
    /// Distance of the highest voltage from the upper limit, V; negative above it.
    margin_high_v: f64,
    /// Distance of the current from its limit, A; negative beyond it; null without a limit.
    margin_a: Option<f64>,
    /// True if all power was delivered within all limits.
    kept: bool,
    /// The result in a sentence.
    words: String,
    /// Limitations of the answer.
    cautions: Vec<String>,
}

/// A model that a run has fitted.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunModel {
    /// The run.
    run: String,
    /// The model's file without its ending.
    name: String,
    /// Number of its RC pairs.
    order: usize,
    /// Temperature of the cell during the measurement, °C.
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<f64>,
    /// State of charge during the measurement, if known.
    soc: Option<f64>,
    /// True if it includes the open-circuit voltage over the state of charge.
    ocv: bool,
    /// Range of a model with a map over charge and temperature; absent for a model of one point.
    #[serde(skip_serializing_if = "Option::is_none")]
    map: Option<MapRange>,
}

/// Range in which a map was measured.
#[derive(Debug, Serialize, ToSchema)]
pub struct MapRange {
    /// Lowest state of charge, 0 to 1.
    soc_low: f64,
    /// Highest state of charge, 0 to 1.
    soc_high: f64,
    /// Lowest temperature, °C.
    #[serde(rename = "temperature_low_c")]
    temperature_low_degc: f64,
    /// Highest temperature, °C.
    #[serde(rename = "temperature_high_c")]
    temperature_high_degc: f64,
}

impl MapRange {
    fn of(map: &CellMap) -> Option<Self> {
        Some(Self {
            soc_low: *map.soc.first()?,
            soc_high: *map.soc.last()?,
            temperature_low_degc: *map.temperature_degc.first()?,
            temperature_high_degc: *map.temperature_degc.last()?,
        })
    }
}

/// The model that was read last, by run and name: it is asked again and again.
#[derive(Debug, Default)]
pub struct LastModel(Mutex<Option<(String, String, GivenModel)>>);

/// All models of runs, of the latest run first.
pub fn models(settings: &Settings, jobs: &Jobs) -> Vec<RunModel> {
    let of_run = |job: Job| {
        let run = job.item.run;
        let folder = settings.runs().join(&run);
        let temperature_degc = find::temperature_degc(&folder);
        let curve = ocv(settings, &run).is_some();
        let files = (1..=MAX_RC).rev().map(run_folder::model);
        let files = std::iter::once(run_folder::MAP.to_owned()).chain(files);
        files.filter_map(move |file| {
            let model = read_model(&folder.join(&file), None).ok()?;
            let map = model.map.as_ref();
            Some(RunModel {
                run: run.clone(),
                name: file.trim_end_matches(".json").to_owned(),
                order: map.map_or(model.erm.branches.len(), |map| map.branches.len()),
                temperature_degc: temperature_degc.filter(|_| map.is_none()),
                soc: None,
                ocv: curve || model.ocv.is_some(),
                map: map.and_then(MapRange::of),
            })
        })
    };
    jobs.latest()
        .filter(|job| job.ended.as_ref().is_some_and(|ended| ended.finished))
        .take(MOST_RUNS)
        .flat_map(of_run)
        .collect()
}

/// A profile by its name.
fn profile(load: &Load) -> Result<Profile, String> {
    let scale = load.scale.unwrap_or(1.0);
    if !(scale > 0.0 && scale <= LARGEST_SCALE) {
        return Err(format!(
            "scale: expected a factor above 0, at most {LARGEST_SCALE}, found {scale}"
        ));
    }
    if load.profile == "constant" {
        let power_w = load
            .power_w
            .ok_or("power_w: expected a power for the constant profile, found none")?;
        let profile = Profile::constant(Demand::Power, power_w, CONSTANT_S);
        return profile
            .map(|profile| profile.scaled(scale))
            .map_err(|error| error.to_string());
    }
    let Some((name, text)) = PROFILES.iter().find(|(name, _)| *name == load.profile) else {
        let names: Vec<&str> = PROFILES.iter().map(|(name, _)| *name).collect();
        return Err(format!(
            "profile: expected one of {}, constant, found {:?}",
            names.join(", "),
            load.profile
        ));
    };
    let row = |line: &str| {
        let (time, power) = line.split_once(',')?;
        Some((time.parse().ok()?, power.parse().ok()?))
    };
    let rows: Vec<(f64, f64)> = text.lines().filter_map(row).collect();
    Profile::new(name, Demand::Power, Interpolation::Hold, &rows)
        .map(|profile| profile.scaled(scale))
        .map_err(|error| error.to_string())
}

/// The model, and the temperature at which it was measured.
fn model(
    settings: &Settings,
    last: &LastModel,
    wanted: &CellModel,
) -> Result<(GivenModel, Option<f64>), String> {
    match wanted {
        CellModel::Typed { erm } => {
            let erm = erm_text::parse(erm).map_err(|error| format!("model.erm: {error}"))?;
            let model = GivenModel::typed("typed", erm);
            Ok((model.map_err(|error| format!("model.erm: {error}"))?, None))
        }
        CellModel::OfRun { run, name } => {
            let folder = confined_path::folder(&settings.runs(), run)
                .ok_or_else(|| format!("model.run: expected a run, found {run:?}"))?;
            let temperature_degc = find::temperature_degc(&folder);
            let mut known = last.0.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((_, _, model)) = known
                .as_ref()
                .filter(|last| (&last.0, &last.1) == (run, name))
            {
                return Ok((model.clone(), temperature_degc));
            }
            let model = of_file(&folder, name)?;
            let curve = model.ocv.clone().or_else(|| ocv(settings, run));
            let model = model.with_ocv(curve);
            *known = Some((run.clone(), name.clone(), model.clone()));
            Ok((model, temperature_degc))
        }
    }
}

fn of_file(folder: &Path, name: &str) -> Result<GivenModel, String> {
    let file = format!("{name}.json");
    let known = run_folder::is_model(&file) || file == run_folder::MAP;
    if !known || confined_path::open(folder, &file).is_none() {
        return Err(format!(
            "model.name: expected a model of the run, found {name:?}"
        ));
    }
    read_model(&folder.join(&file), None).map_err(|error| format!("model.name: {error}"))
}

/// Returns the open-circuit voltage that the cell's file states.
fn ocv(settings: &Settings, run: &str) -> Option<OcvCurve> {
    let file = submission::cell_file(&settings.data, run)?;
    resolve_cell(&Source::read(&file).ok()?).ok()?.ocv
}

/// Simulates a load on a pack.
///
/// # Errors
/// In words that name the field.
pub fn under_load(settings: &Settings, last: &LastModel, load: &Load) -> Result<UnderLoad, String> {
    for (field, count) in [("series", load.series), ("parallel", load.parallel)] {
        if !(1..=MOST_CELLS).contains(&count) {
            return Err(format!(
                "{field}: expected 1 to {MOST_CELLS}, found {count}"
            ));
        }
    }
    let profile = profile(load)?;
    let (given, measured_degc) = model(settings, last, &load.model)?;
    let ocv = match (&given.ocv, load.ocv_v) {
        (Some(curve), _) => OcvSource::Curve(curve.clone()),
        (None, Some(ocv_v)) => OcvSource::Constant(ocv_v),
        (None, None) => {
            return Err(
                "ocv_v: expected an open-circuit voltage, because the model has no curve"
                    .to_owned(),
            );
        }
    };
    let pack = Pack::new(load.series, load.parallel, 0.0).map_err(|error| error.to_string())?;
    let ambient_degc = load.temperature_degc.unwrap_or(files::AMBIENT_DEGC);
    let model =
        files::sim_model(&given, ocv, pack, ambient_degc).map_err(|error| error.to_string())?;
    let state = match (load.soc, load.ocv_v) {
        (Some(soc), None) => model.rest(soc).map_err(|error| format!("soc: {error}"))?,
        (None, Some(ocv_v)) => model
            .rest_at(ocv_v)
            .map_err(|error| format!("ocv_v: {error}"))?,
        _ => return Err("soc, ocv_v: expected one of them".to_owned()),
    };
    let series = f64::from(load.series);
    let window = CellWindow {
        low_v: load
            .voltage_min_v
            .unwrap_or(CellWindow::THESIS.low_v * series),
        high_v: load
            .voltage_max_v
            .unwrap_or(CellWindow::THESIS.high_v * series),
    };
    if window.low_v.partial_cmp(&window.high_v) != Some(Ordering::Less) {
        return Err(format!(
            "voltage_min_v, voltage_max_v: expected a lower below a higher voltage, found {} and {} V",
            window.low_v, window.high_v
        ));
    }
    let options = SimOptions {
        beyond: Beyond::Stop,
        max_step_s: profile.duration_s() / ROWS,
        window: CellWindow {
            low_v: window.low_v / series,
            high_v: window.high_v / series,
        },
        ..SimOptions::default()
    };
    let run = simulate(&model, &state, &profile, &options).map_err(|error| error.to_string())?;
    let mut cautions = given.warnings;
    if let Some(map) = &given.map {
        let cell_a = run.summary.most_current_a() / f64::from(pack.parallel);
        cautions.extend(map.current_remark(cell_a));
        let outside = run.summary.outside_map.filter(Outside::is_outside);
        cautions.extend(
            outside.map(|outside| {
                format!("the load {outside}; there the resistances are extrapolated")
            }),
        );
    } else if let Some(wanted_degc) = load.temperature_degc {
        cautions.extend(temperature(wanted_degc, measured_degc));
    }
    Ok(build_reply(run, window, load.current_max_a, cautions))
}

/// Returns a remark if the requested temperature of the cells differs from that of the
/// measurement.
fn temperature(wanted_degc: f64, measured_degc: Option<f64>) -> Option<String> {
    match measured_degc {
        Some(measured_degc) if (wanted_degc - measured_degc).abs() <= NEAR_K => None,
        Some(measured_degc) => Some(format!(
            "the model was measured at {measured_degc:.1} °C and is used as it is: at {wanted_degc:.1} °C \
             the resistance is another one; choose a run at that temperature"
        )),
        None => Some(format!(
            "the temperature of the model is not known: nothing is changed for {wanted_degc:.1} °C"
        )),
    }
}

/// Builds the reply; `window` is that of the pack.
fn build_reply(
    run: Simulation,
    window: CellWindow,
    current_max_a: Option<f64>,
    cautions: Vec<String>,
) -> UnderLoad {
    let Simulation { summary, trace, .. } = run;
    let (margin_v, margin_high_v) = (
        window.margin_low_v(summary.min_ccv_v),
        window.margin_high_v(summary.max_ccv_v),
    );
    let highest_a = summary.peak_current_a.max(-summary.lowest_current_a);
    let margin_a = current_max_a.map(|limit| limit - highest_a);
    let words = if let Some(first) = summary.infeasible.first() {
        format!(
            "at {:.3} s {:.0} W were requested, {:.0} W are available: the simulation ends there",
            first.time_s, first.power_w, first.available_w
        )
    } else if margin_v < 0.0 {
        format!(
            "the voltage falls to {:.1} V at {:.2} s: {:.1} V below the limit",
            summary.min_ccv_v, summary.min_ccv_time_s, -margin_v
        )
    } else if margin_high_v < 0.0 {
        format!(
            "the voltage rises to {:.1} V at {:.2} s: {:.1} V above the limit",
            summary.max_ccv_v, summary.max_ccv_time_s, -margin_high_v
        )
    } else if let Some(margin_a) = margin_a.filter(|margin| *margin < 0.0) {
        format!(
            "the current reaches {highest_a:.0} A: {:.0} A above the limit",
            -margin_a
        )
    } else {
        format!(
            "the voltage falls to {:.1} V at {:.2} s: {margin_v:.1} V above the limit",
            summary.min_ccv_v, summary.min_ccv_time_s
        )
    };
    UnderLoad {
        kept: summary.feasible
            && margin_v.min(margin_high_v) >= 0.0
            && margin_a.is_none_or(|margin| margin >= 0.0),
        time_s: trace.time_s,
        power_w: trace.power_w,
        voltage_v: trace.ccv_v,
        current_a: trace.current_a,
        lowest_v: summary.min_ccv_v,
        at_s: summary.min_ccv_time_s,
        highest_v: summary.max_ccv_v,
        highest_a,
        heat_j: summary.heat_j,
        margin_v,
        margin_high_v,
        margin_a,
        words,
        cautions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_profile_can_be_read_and_another_one_is_refused() {
        let load = |name: &str| Load {
            model: CellModel::Typed {
                erm: "6 mΩ".to_owned(),
            },
            series: 16,
            parallel: 3,
            soc: None,
            ocv_v: Some(3.7),
            temperature_degc: None,
            profile: name.to_owned(),
            power_w: None,
            scale: Some(0.5),
            voltage_min_v: None,
            voltage_max_v: None,
            current_max_a: None,
        };
        for (name, text) in PROFILES {
            let found = profile(&load(name)).unwrap();
            assert_eq!(found.time_s.len(), text.lines().count() - 1, "{name}");
        }
        let message = profile(&load("running")).unwrap_err();
        assert!(
            message.starts_with("profile: expected one of walking, "),
            "{message}"
        );
        let message = profile(&load("constant")).unwrap_err();
        assert!(
            message.starts_with("power_w: expected a power"),
            "{message}"
        );
    }

    #[test]
    fn another_temperature_than_measured_is_reported() {
        assert_eq!(temperature(25.5, Some(25.0)), None);
        assert!(
            temperature(-10.0, Some(25.0))
                .unwrap()
                .contains("measured at 25.0 °C")
        );
        assert!(temperature(25.0, None).is_some());
    }
}
