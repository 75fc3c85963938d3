//! Configuration: files as typed (`raw`), read with line numbers (`source`) and units
//! (`quantity`), checked once (`resolve`, `check`). The resulting experiment is complete and
//! within the limits of cell and instruments; nothing is energised before that check.

use std::sync::Arc;

use instruments::units::Seconds;

use crate::plan::{CampaignRun, Specimen};

mod bench;
mod bias;
mod campaign;
mod check;
pub mod erm_text;
mod identity;
mod interlock;
mod limits;
mod map;
mod map_places;
mod multisine;
mod ocv_soc;
mod quality;
pub mod quantity;
mod raw;
mod raw_bench;
mod raw_map;
mod raw_multisine;
mod raw_ocv_soc;
mod raw_pulses;
mod raw_quality;
mod resolve;
mod resolve_bench;
pub mod schema;
mod section;
mod simulation;
mod source;
mod supply4q;
mod trace;

pub use bench::{
    ANALOG, ANSWER_S, Analog, Bench, Doctor, Guardian, Instrument, Instruments, Jig, Simulation,
    Thermostat, Wiring,
};
pub use campaign::Campaign;
pub use check::{LOAD_CUT_OFF_V, check_frames};
pub use identity::Identity;
pub use map::{CHARGE_LEAST_DEGC, MapLegs, MapProcedure};
pub use map_places::{MapPlace, MapTemperature};
pub use multisine::{Band, Multisine};
pub use ocv_soc::OcvSoc;
pub use resolve::resolve_cell;
pub use resolve::{load_experiment, resolve_experiment};
pub use resolve_bench::resolve_bench;
pub use resolve_bench::{load_any_bench, load_bench};
pub use section::{
    Acceptance, Cell, Eis, EisBias, Fit, FixtureCheck, Order, SocReset, Temperature, Tolerance,
};
pub use source::{ConfigError, Copies, Fence, FieldPlace, Source};
pub use trace::{AFTER_WAVE_S, BEFORE_S};
pub use trace::{Segment, Trace};

/// A complete experiment.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// Its name: run folders are called after it.
    pub name: String,
    /// Seed of the simulation and of the searches of the fits.
    pub seed: u64,
    /// The bench.
    pub bench: Bench,
    /// The cell.
    pub cell: Cell,
    /// The one cell that is measured, where the experiment names it.
    pub specimen: Option<Arc<Specimen>>,
    /// Holding a temperature first, if asked for.
    pub temperature: Option<Temperature>,
    /// Checking the bench with control impedances first, if asked for.
    pub fixture_check: Option<FixtureCheck>,
    /// Bringing the cell to a known state of charge first, if asked for.
    pub soc_reset: Option<SocReset>,
    /// Finding the open-circuit voltage over the state of charge, if asked for.
    pub ocv_soc: Option<OcvSoc>,
    /// The sweeps, if there are any.
    pub eis: Option<Eis>,
    /// Many frequencies at once, if asked for.
    pub multisine: Option<Multisine>,
    /// Points of charge and temperature, if there are any.
    pub map: Option<MapProcedure>,
    /// Several cells, each measured several times, if there are any.
    pub campaign: Option<Campaign>,
    /// Current steps, in the order in which each round runs them.
    pub traces: Vec<Trace>,
    /// The fits.
    pub fit: Fit,
    /// The order of the fitted model that is diagnosed with the run's own data at its end, where
    /// that is asked for.
    pub diagnosed_rc: Option<usize>,
    /// Automatic retries after something has ended it.
    pub auto_resume: AutoResume,
    /// The files that this was read from.
    pub sources: Vec<Source>,
}

impl Experiment {
    /// A run of the campaign or a point of the map, by its number.
    pub fn run(&self, number: usize) -> Option<CampaignRun> {
        let of_map = self.map.as_ref().and_then(|map| map.run(number));
        of_map.or_else(|| self.campaign.as_ref()?.run(number))
    }
}

/// When an interrupted run continues automatically. It never continues after a limit of the cell
/// was touched, or if an output is not known to be off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AutoResume {
    /// How often after faults of the wire, which pass.
    pub passing: usize,
    /// The wait before that, s.
    pub pause_s: Seconds,
    /// How often after other things that an instrument did.
    pub most: usize,
    /// The wait before that, s.
    pub after_s: Seconds,
}
