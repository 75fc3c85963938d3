//! The rig that executes a plan: the instruments, and the state for reading and judging them.

use instruments::{
    clock::Clock,
    units::{Amps, Celsius, Seconds, Volts},
};

use super::{bias::BiasState, burst::Burst, setup::Setup};
use crate::{
    bench::{Bench, BenchError},
    executor::thermostat::Thermostat,
    record::Recorder,
    watch::WatchLink,
};
use bench_plan::{
    config::Experiment,
    interlock::Interlock,
    measure::{repeated::SeenRecords, zero::Zeros},
};

/// The instruments of a run, with the state for reading and judging them.
pub struct Rig<'a> {
    /// The instruments.
    pub(super) bench: &'a mut Bench,
    /// Setup of the whole run.
    pub(super) setup: Setup,
    /// Bench time.
    pub clock: Clock,
    /// Writer of all results.
    pub recorder: &'a mut Recorder,
    /// Interlock with the allowance of the present step.
    pub(super) interlock: Interlock,
    /// Times of the last readings.
    pub(super) watching: Watching,
    /// The cell's temperature and its bath.
    pub(super) temperatures: Temperatures,
    /// Drive of the cell since the last power-up.
    pub(super) driving: Driving,
}

impl<'a> Rig<'a> {
    /// Creates a rig for a bench on which nothing was read yet.
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

/// Times of the last readings, and the next instrument to be checked.
pub(super) struct Watching {
    /// Number of readings; every tenth includes a temperature.
    pub(super) polls: u32,
    /// Bench time of the last reading of the bipolar supply, s.
    pub(super) watched_s: Seconds,
    /// Time of the last reading of the instruments that must carry no current, bench s.
    pub(super) others_s: Seconds,
    /// Number of the instrument whose settings were last read back.
    pub(super) looked: usize,
    /// Duration of the last reading of the bipolar supply, s.
    pub(super) read_s: Seconds,
    /// Duration of the last reading including all overhead, s.
    pub(super) took_s: Seconds,
    /// Last reading of the voltmeter at the jig, V.
    pub(super) shown_v: Option<Volts>,
    /// Stop requests.
    pub(super) requests: Requests,
}

impl Default for Watching {
    fn default() -> Self {
        Self {
            polls: 0,
            watched_s: Seconds::NEG_INFINITY,
            others_s: Seconds::NEG_INFINITY,
            looked: 0,
            read_s: Seconds::ZERO,
            took_s: Seconds::ZERO,
            shown_v: None,
            requests: Requests {
                ends_early: false,
                looked_s: Seconds::NEG_INFINITY,
            },
        }
    }
}

/// Stop requests within a step.
pub(super) struct Requests {
    /// Whether a request may end the present step before its end.
    pub(super) ends_early: bool,
    /// Time of the last check for such a request, bench s.
    pub(super) looked_s: Seconds,
}

/// The cell's temperature, its logger and its bath.
#[derive(Default)]
pub(super) struct Temperatures {
    /// Last temperature of the cell, °C.
    pub(super) last_degc: Option<Celsius>,
    /// Whether the logger's scan list was set; it scans nothing before.
    pub(super) logger_ready: bool,
    /// Whether the chiller was started here and must keep running.
    pub(super) chiller_runs: bool,
    /// Set-point of the bath, °C.
    pub(super) setpoint_degc: Option<Celsius>,
    /// The control loop of a bath that has none of its own.
    pub(super) thermostat: Option<Thermostat>,
}

/// Mean of a record while no direct current flows.
#[derive(Clone, Copy)]
pub(super) struct FirstMean {
    /// Scales of the shunt's channels, V per division.
    pub(super) volts_per_div: [f64; 2],
    /// Mean of the current, A.
    pub(super) zero_a: Amps,
    /// Mean relative to the zero of the channels, if that was measured, A.
    pub(super) channels_a: Option<Amps>,
}

/// Drive of the cell since the last power-up.
#[derive(Default)]
pub(super) struct Driving {
    /// How long the generator's signal continues on its own.
    pub(super) burst: Burst,
    /// Current that the present power-up allows, A.
    pub(super) powered_a: Option<Amps>,
    /// The first record since then, or on these scales.
    pub(super) first_mean: Option<FirstMean>,
    /// Change of the mean current since the first record, A.
    pub(super) mean_change_a: Amps,
    /// Whether it was reported that the bipolar supply has no limits.
    pub(super) unlimited_reported: bool,
    /// Means of the channels without a current through a cell.
    pub(super) zeros: Zeros,
    /// Records that the scope has sent so far.
    pub(super) records: SeenRecords,
    /// The direct current under the sinusoids.
    pub(super) bias: BiasState,
}

/// Seconds between two readings while current flows.
pub(super) const POLL_S: Seconds = Seconds(1.0);

/// Returns the instrument of a role, or an error if the bench lacks it.
pub(super) fn require<'b, T>(
    instrument: &'b mut Option<T>,
    role: &'static str,
) -> Result<&'b mut T, BenchError> {
    instrument.as_mut().ok_or(BenchError::Missing { role })
}
