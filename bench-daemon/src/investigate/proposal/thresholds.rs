//! Numbers by which a log is cut into runs, each with its source.

/// Part of a log's greatest current below which the cell is at rest. Convention: cyclers of 0.1 %
/// of full scale read less than that at rest.
pub(super) const REST_PART: f64 = 2e-3;
/// Shortest interval without current that counts as a rest between two loads, s. Convention: zero
/// crossings of drive cycles are shorter.
pub(super) const SHORTEST_REST_S: f64 = 5.0;
/// Longest pause inside a drive cycle, s. Stops of UDDS, US06 and WLTP last less.
pub(super) const LONGEST_PAUSE_S: f64 = 120.0;
/// Maximum time of the base current that is simulated before a pulse on it, s. The voltage then
/// settles under the base: slow branches of models have time constants of minutes.
pub(super) const BASE_BEFORE_S: f64 = 600.0;
/// Part of the base before a pulse that is compared, s. Convention: it shows the level.
pub(super) const COMPARED_BEFORE_S: f64 = 30.0;
/// Longest part of the base after a pulse that belongs to its run, s. Convention.
pub(super) const BASE_AFTER_S: f64 = 120.0;
/// Standard deviation of the level of a run on a base, V: no rest determines it.
pub(super) const BASE_LEVEL_V: f64 = 0.02;
/// Fewest steps of a cycler's program that follow each other under current and are a drive cycle. In
/// an HPPC two do: a pulse, and the discharge to the next state.
pub(super) const FEWEST_OF_CHAIN: usize = 3;
/// Longest pulse that is cut from a long current that follows it, s. Convention: HPPC pulses last 10 s
/// to 30 s.
pub(super) const LONGEST_BEFORE_STEP_S: f64 = 60.0;
/// Part of a load that a model to start from is read off, s. Convention: the open-circuit voltage moves
/// little in it.
pub(super) const START_S: f64 = 60.0;
/// Minimum number of samples that determine a time constant. Convention.
pub(super) const START_SAMPLES: usize = 5;
/// Time after the start of a pulse at which its resistance is stated, s. Convention.
pub(super) const RESISTANCE_S: f64 = 1.0;
/// Longest step of a log within one segment, s. Cyclers log rests every 10 min at the slowest; a
/// longer step is a cut.
pub(super) const CUT_S: f64 = 900.0;
/// Longest part of a rest that is put before the load into its run, s. Convention: a minute shows
/// the start voltage and its drift.
pub(super) const LEAD_S: f64 = 60.0;
/// Largest residual slope of the rest before a load, V/s: 0.6 mV per minute. A run of a minute and
/// a half then drifts by less than the level error of 1 mV that the diagnosis assumes.
pub(super) const STEEPEST_V_PER_S: f64 = 1e-5;
/// Last part of a rest whose slope counts, s. Convention: as [`LEAD_S`].
pub(super) const REST_WINDOW_S: f64 = LEAD_S;
/// Last part of a rest whose median is the rest voltage, s. At [`STEEPEST_V_PER_S`] the voltage
/// moves by 0.1 mV in it.
pub(super) const REST_VOLTAGE_S: f64 = 10.0;
/// Fewest samples of a slope, for slow logs. Convention.
pub(super) const FEWEST_OF_SLOPE: usize = 5;
/// Deviation from its median up to which a current is constant, as a fraction. Half and twice the
/// current are 50 times as far away; cyclers hold 0.1 %.
pub(super) const CONSTANT_PART: f64 = 0.02;
/// Shortest constant current that is a pulse and no part of a drive cycle, s. Convention: HPPC pulses
/// last 10 s, and 5 s in short ones.
pub(super) const SHORTEST_PULSE_S: f64 = 4.0;
/// Longest constant current that is a pulse, s. Convention: HPPC pulses last 10 s to 30 s.
pub(super) const LONGEST_PULSE_S: f64 = 300.0;
/// Shortest varying current that is a drive cycle, s. Convention.
pub(super) const SHORTEST_CYCLE_S: f64 = 60.0;
/// Part by which a step of the log may exceed the slowest sampling. Stamps of cyclers jitter.
pub(super) const JITTER_PART: f64 = 0.1;
/// Fewest samples of a long discharge or charge. Convention.
pub(super) const FEWEST_OF_DISCHARGE: f64 = 50.0;
/// Band about the extreme voltage within which a limit holds it, V. Cyclers hold a few millivolts.
pub(super) const LIMIT_BAND_V: f64 = 5e-3;
/// Fraction of a segment's samples in the band at which a limit counts as reached. Convention.
pub(super) const LIMIT_PART: f64 = 0.1;
/// Fewest samples at a limit. Convention.
pub(super) const FEWEST_AT_LIMIT: usize = 3;
/// Maximum fraction of its current that remains at the end of a segment at a limit. A constant
/// current loses none.
pub(super) const LIMIT_CURRENT_PART: f64 = 0.95;
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
/// Part by which a counted state of charge may leave 0 to 1; a capacity is not known better.
pub(super) const SOC_BEYOND: f64 = 0.02;
/// Step between the codes of a channel that is looked at, in codes: beyond it the rounding of
/// decimals adds up.
pub(super) const NEAR_CODES: f64 = 8.0;
/// Fraction of the small steps of a channel that are whole codes, if it has codes. Convention.
pub(super) const CODES_PART: f64 = 0.9;
/// Distance of a step from whole codes above which it does not count as a code, in codes.
/// Convention.
pub(super) const OFF_CODE: f64 = 0.2;
/// Fewest steps that determine a code. Convention.
pub(super) const FEWEST_STEPS: usize = 20;
/// Ratio of the mean square of normal deviates without the largest tenth to that of all.
/// Mathematics: 1 − 2·1.645·φ(1.645)/0.9.
pub(super) const KEPT_VARIANCE: f64 = 0.623;
