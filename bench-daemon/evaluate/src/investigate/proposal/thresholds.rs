//! Numbers by which loads become the runs of a data set, each with its source.

use analysis::loads::CONSTANT_PART;
pub(super) use analysis::loads::SHORTEST_PULSE_S;

/// Standard deviation of the level of a run on a base, V: no rest determines it.
pub(super) const BASE_LEVEL_V: f64 = 0.02;
/// Part of a load that a model to start from is read off, s. Convention: the open-circuit voltage moves
/// little in it.
pub(super) const START_S: f64 = 60.0;
/// Minimum number of samples that determine a time constant. Convention.
pub(super) const START_SAMPLES: usize = 5;
/// Currents of repeats differ by less than this, as a fraction. As [`CONSTANT_PART`].
pub(super) const SAME_CURRENT_PART: f64 = CONSTANT_PART;
/// Durations of repeats differ by less than this, as a fraction, or by a step of the log.
pub(super) const SAME_DURATION_PART: f64 = 0.05;
/// Temperatures of repeats differ by less than this, °C: resistances by 2 % to 4 %.
pub(super) const REPEAT_TEMPERATURE_C: f64 = 1.0;
/// States of charge of repeats differ by less than this. A curve of 1 V then differs by 5 mV.
pub(super) const REPEAT_SOC: f64 = 5e-3;
/// Maximum difference of the rest voltages of repeats, V, if no state of charge is known.
pub(super) const REPEAT_V: f64 = 2e-3;
/// Temperatures of runs that are split together differ by less than this, °C.
pub(super) const STATE_TEMPERATURE_C: f64 = 3.0;
/// States of charge of runs that are split together differ by less than this: an HPPC at one state
/// of charge takes up to 4 %.
pub(super) const STATE_SOC: f64 = 0.05;
/// Fewest states of which every other one is held out: two are left to train then.
pub(super) const FEWEST_STATES: usize = 3;
/// As [`STATE_SOC`] in rest voltage, V, if no state of charge is known.
pub(super) const STATE_V: f64 = 0.03;
/// Part by which two statements of one capacity may differ. Nominal and measured capacity do by a few
/// percent.
pub(super) const SAME_CAPACITY_PART: f64 = 0.1;
