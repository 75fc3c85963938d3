//! The rig that a plan is played on: the instruments, and what reading and judging them needs.

use instruments::clock::Clock;

use super::{burst::Burst, setup::Setup};
use crate::{
    bench::{Bench, BenchError},
    config::Experiment,
    executor::thermostat::Thermostat,
    interlock::Interlock,
    measure::{repeated::SeenRecords, zero::Zeros},
    record::Recorder,
    watch::WatchLink,
};

/// The instruments of a run, with everything that reading and judging them needs.
pub struct Rig<'a> {
    /// The instruments.
    pub(super) bench: &'a mut Bench,
    /// Setup that holds for the whole run.
    pub(super) setup: Setup,
    /// Bench time.
    pub(crate) clock: Clock,
    /// Where everything is written.
    pub(crate) recorder: &'a mut Recorder,
    /// Interlock with the allowance of the step in work.
    pub(super) interlock: Interlock,
    /// When what was read last.
    pub(super) watching: Watching,
    /// The cell's temperature and its bath.
    pub(super) temperatures: Temperatures,
    /// Drive of the cell since the last power-up.
    pub(super) driving: Driving,
}

impl<'a> Rig<'a> {
    /// Makes a rig of a bench on which nothing was read yet.
    pub fn new(
        bench: &'a mut Bench,
        experiment: &Experiment,
        clock: Clock,
        recorder: &'a mut Recorder,
        watch: Option<WatchLink>,
    ) -> Self {
        Self {
            bench,
            setup: Setup::of(experiment, watch),
            clock,
            recorder,
            interlock: Interlock::new(
                experiment.cell.interlock,
                experiment.cell.limits,
                experiment.bench.instruments.logger.is_some(),
            ),
            watching: Watching::default(),
            temperatures: Temperatures::default(),
            driving: Driving::default(),
        }
    }
}

/// When what was read last, and whose turn is next.
pub(super) struct Watching {
    /// Readings so far; every tenth takes a temperature.
    pub(super) polls: u32,
    /// Bench time of the last reading of the bipolar supply, s.
    pub(super) watched_s: f64,
    /// When those that are to carry nothing were read last, bench s.
    pub(super) others_s: f64,
    /// Number of the instrument whose settings were read back last.
    pub(super) looked: usize,
    /// How long the last reading of the bipolar supply took, s.
    pub(super) read_s: f64,
    /// How long the last reading with everything around it took, s.
    pub(super) took_s: f64,
    /// Last reading of the voltmeter at the jig, V.
    pub(super) shown_v: Option<f64>,
    /// Requests to end.
    pub(super) requests: Requests,
}

impl Default for Watching {
    fn default() -> Self {
        Self {
            polls: 0,
            watched_s: f64::NEG_INFINITY,
            others_s: f64::NEG_INFINITY,
            looked: 0,
            read_s: 0.0,
            took_s: 0.0,
            shown_v: None,
            requests: Requests {
                ends_early: false,
                looked_s: f64::NEG_INFINITY,
            },
        }
    }
}

/// Requests to end in the middle of a step.
pub(super) struct Requests {
    /// The step in work may be ended in its middle on request.
    pub(super) ends_early: bool,
    /// When it was looked for such a request last, bench s.
    pub(super) looked_s: f64,
}

/// The cell's temperature, its logger and its bath.
#[derive(Default)]
pub(super) struct Temperatures {
    /// The cell's temperature when it was read last, °C.
    pub(super) last_c: Option<f64>,
    /// The logger scans nothing before it was told what.
    pub(super) logger_ready: bool,
    /// The chiller was started here, and is to go on running.
    pub(super) chiller_runs: bool,
    /// Setpoint of the bath, °C.
    pub(super) setpoint_c: Option<f64>,
    /// The loop of a bath that has none of its own.
    pub(super) thermostat: Option<Thermostat>,
}

/// Mean of a record while no direct current flows.
#[derive(Clone, Copy)]
pub(super) struct FirstMean {
    /// Scales of the shunt's channels, V per division.
    pub(super) volts_per_div: [f64; 2],
    /// Mean of the current, A.
    pub(super) zero_a: f64,
    /// The same by the zero of the channels, where that was measured, A.
    pub(super) channels_a: Option<f64>,
}

/// Drive of the cell since the last power-up.
#[derive(Default)]
pub(super) struct Driving {
    /// How long the generator's signal goes on by itself.
    pub(super) burst: Burst,
    /// Current that the power-up in work allows, A.
    pub(super) powered_a: Option<f64>,
    /// The first record since then, or on these scales.
    pub(super) first_mean: Option<FirstMean>,
    /// By how much the mean of the current has changed since the first record, A.
    pub(super) mean_change_a: f64,
    /// It was said that the bipolar supply is not bounded.
    pub(super) told: bool,
    /// Means of the channels while no current flowed through a cell.
    pub(super) zeros: Zeros,
    /// Records that the scope has sent.
    pub(super) records: SeenRecords,
}

/// Seconds between two readings while current flows.
pub(super) const POLL_S: f64 = 1.0;

/// The instrument of a role, or a complaint that the bench lacks it.
pub(super) fn require<'b, T>(
    instrument: &'b mut Option<T>,
    role: &'static str,
) -> Result<&'b mut T, BenchError> {
    instrument.as_mut().ok_or(BenchError::Missing { role })
}
