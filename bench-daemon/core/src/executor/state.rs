//! State of a run between steps, beside its instruments.

use std::sync::Arc;

use analysis_files::dataset::LegRow;
use analysis_signal::{calibration::Correction, multisine::Line};
use instruments::fixture::Fixture;

use crate::{operator::Operator, operator::progress::Progress};
use bench_plan::{
    interlock::Reading,
    measure::channels::ControlPotentials,
    plan::{CampaignRun, Log, Specimen},
};

/// The person at the bench.
pub struct Person<'a> {
    /// Asks the person who changes the fixture if no device does.
    pub operator: &'a Operator,
    /// Progress that the person at the terminal sees.
    pub progress: &'a Progress,
}

/// Position of the present stage in the run, and contents of the jig.
#[derive(Default)]
pub(super) struct Position {
    /// Fixture that was last clamped into the jig, and its cell if there are several.
    pub(super) mounted: Option<(Fixture, Option<Arc<Specimen>>)>,
    /// The cell in use, if there are several.
    pub(super) specimen: Option<Arc<Specimen>>,
    /// The run of a campaign that the present stage belongs to.
    pub(super) run: Option<CampaignRun>,
    /// Number of the sweep, 0 for a control.
    pub(super) repeat: usize,
}

/// State that steps of direct current leave for the steps after them.
#[derive(Default)]
pub(super) struct Direct {
    /// Readings of the channels without a current.
    pub(super) zero: Option<Zero>,
    /// Charge that traces have left in the cell, C.
    pub(super) charge_coulomb: f64,
    /// Reading of the bipolar supply's ammeter with its output off, A.
    pub(super) ammeter_zero_a: f64,
    /// Current of the bipolar supply while its command is zero, in a map.
    pub(super) residual: Option<Residual>,
    /// The readings of the legs so far.
    pub(super) legs: Legs,
    /// Progress of the reset of the state of charge.
    pub(super) reset: Reset,
    /// Current of an analog supply by the scope, while its command was zero at power-up.
    pub(super) analog_zero: Option<Level>,
}

/// A current that is not commanded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    /// Current, A, charge positive.
    pub(super) current_a: f64,
    /// Bench time from which it flows, s.
    pub(super) since_s: f64,
}

/// Knowledge of harness and cell beside the points.
pub struct Known {
    /// Correction of the harness for the channels.
    pub correction: Correction,
    /// Last reading of the cell before the bipolar supply was switched on.
    pub idle: Reading,
    /// Lines of multisines, with their noise and distortion, until they are taken.
    pub lines: Vec<Line>,
    /// Potentials of the channels with the controls of this run in the jig.
    pub controls: Vec<ControlPotentials>,
}

/// Progress of the reset of the state of charge.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Reset {
    /// Voltage after the rest, V, and whether it was steady.
    pub(super) rested: Option<(f64, bool)>,
    /// Shift of the end of the next charge, V.
    pub(super) shift_v: f64,
    /// Whether the cell is at its target, so that nothing remains to be done.
    pub(super) accepted: bool,
}

/// The readings of the legs of one direction.
#[derive(Default)]
pub(super) struct Legs {
    pub(super) log: Option<Log>,
    pub(super) start_s: f64,
    pub(super) charge_coulomb: f64,
    pub(super) rows: Vec<LegRow>,
}

impl Legs {
    /// Stores a reading with its bench time; a charge current is positive.
    pub(super) fn push(
        &mut self,
        time_s: f64,
        voltage_v: f64,
        current_a: f64,
        last_degc: Option<f64>,
    ) {
        self.rows.push(LegRow {
            time_s: time_s - self.start_s,
            current_a,
            voltage_v,
            temperature_degc: last_degc.unwrap_or(f64::NAN),
            charge_coulomb: self.charge_coulomb,
        });
    }
}

/// State of the channels and the voltmeter without a current.
#[derive(Debug, Clone, Copy)]
pub(super) struct Zero {
    /// Channels 1…4, V.
    pub(super) volts: [f64; 4],
    /// Voltage at rest by the voltmeter, V.
    pub(super) ocv_v: f64,
    /// Scatter of a reading of voltage and current, V and A.
    pub(super) scatter: (f64, f64),
    /// Temperature of the cell, °C.
    pub(super) temperature_degc: Option<f64>,
}

/// Mean current by the scope.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    pub(super) amps: f64,
    /// Possible error of the zeros of the two channels, A.
    pub(super) unsure_a: f64,
}
