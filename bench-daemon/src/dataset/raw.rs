//! `dataset.toml` as it is typed; nothing else reads these structures than `resolve`.

use analysis::{
    augmented::Between,
    calibration::CommonError,
    dataset::CurrentPositive,
    diagnosis::{BenchHistory, Role},
    formats::CurrentSign,
};
use serde::Deserialize;

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub(super) name: String,
    pub(super) bench: Option<BenchHistory>,
    pub(super) calibration: Option<CommonError>,
    pub(super) runs: Vec<Run>,
}

/// One `[[runs]]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Run {
    pub(super) name: Option<String>,
    pub(super) file: String,
    pub(super) kind: Kind,
    #[serde(default)]
    pub(super) fixture: Fixture,
    pub(super) cell: Option<String>,
    pub(super) fixture_ohm: Option<f64>,
    pub(super) temperature_c: Option<f64>,
    pub(super) soc: Option<f64>,
    pub(super) ocv_v: Option<f64>,
    pub(super) repeat_group: Option<String>,
    pub(super) order: Option<u32>,
    pub(super) start_s: Option<f64>,
    pub(super) role: Option<Role>,
    pub(super) current_positive: Option<CurrentPositive>,
    pub(super) current_between_samples: Option<Between>,
    pub(super) from_s: Option<f64>,
    pub(super) to_s: Option<f64>,
    pub(super) compare_from_s: Option<f64>,
    pub(super) level_sigma_v: Option<f64>,
    pub(super) from_hz: Option<f64>,
    pub(super) to_hz: Option<f64>,
    pub(super) bias_a: Option<f64>,
    pub(super) below_ohm: Option<f64>,
    pub(super) below_h: Option<f64>,
    pub(super) elapsed_s: Option<Vec<f64>>,
    pub(super) amplitude_a: Option<f64>,
    pub(super) spectrum: Option<String>,
    #[serde(default)]
    pub(super) refused_points: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    Eis,
    Time,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Fixture {
    #[default]
    Cell,
    Shunt,
    FakeCell,
}

/// The sign convention of a file whose current is positive in this direction.
pub(super) fn sign(positive: CurrentPositive) -> CurrentSign {
    match positive {
        CurrentPositive::Charge => CurrentSign::Charge,
        CurrentPositive::Discharge => CurrentSign::Discharge,
    }
}
