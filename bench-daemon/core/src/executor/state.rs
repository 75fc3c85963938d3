//! State of a run between steps, beside its instruments.

use std::sync::Arc;

use analysis_files::dataset::LegRow;
use analysis_signal::{calibration::Correction, multisine::Line};
use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Coulombs, Seconds, Volts},
};

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
    pub(super) charge_coulomb: Coulombs,
    /// Reading of the bipolar supply's ammeter with its output off, A.
    pub(super) ammeter_zero_a: Amps,
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
    pub(super) current_a: Amps,
    /// Bench time from which it flows, s.
    pub(super) since_s: Seconds,
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
    pub(super) rested: Option<(Volts, bool)>,
    /// Shift of the end of the next charge, V.
    pub(super) shift_v: Volts,
    /// Whether the cell is at its target, so that nothing remains to be done.
    pub(super) accepted: bool,
}

/// The readings of the legs of one direction.
#[derive(Default)]
pub(super) struct Legs {
    pub(super) log: Option<Log>,
    pub(super) start_s: Seconds,
    pub(super) charge_coulomb: Coulombs,
    pub(super) rows: Vec<LegRow>,
}

impl Legs {
    /// Stores a reading with its bench time; a charge current is positive.
    pub(super) fn push(
        &mut self,
        time_s: Seconds,
        voltage_v: Volts,
        current_a: Amps,
        last_degc: Option<Celsius>,
    ) {
        self.rows.push(LegRow {
            time_s: (time_s - self.start_s).value(),
            current_a: current_a.value(),
            voltage_v: voltage_v.value(),
            temperature_degc: last_degc.unwrap_or(Celsius::NAN).value(),
            charge_coulomb: self.charge_coulomb.value(),
        });
    }
}

/// State of the channels and the voltmeter without a current.
#[derive(Debug, Clone, Copy)]
pub(super) struct Zero {
    /// Channels 1…4, V.
    pub(super) volts: [Volts; 4],
    /// Voltage at rest by the voltmeter, V.
    pub(super) ocv_v: Volts,
    /// Scatter of a reading of voltage and current, V and A.
    pub(super) scatter: (f64, f64),
    /// Temperature of the cell, °C.
    pub(super) temperature_degc: Option<Celsius>,
}

/// Mean current by the scope.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    pub(super) amps: Amps,
    /// Possible error of the zeros of the two channels, A.
    pub(super) unsure_a: Amps,
}
