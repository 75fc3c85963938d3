//! Numbers by which a log is cut into rests and loads, each with its source.

/// Part of a log's greatest current below which the cell is at rest. Convention: cyclers of 0.1 %
/// of full scale read less than that at rest.
pub(crate) const REST_PART: f64 = 2e-3;
/// Shortest interval without current that counts as a rest between two loads, s. Convention: zero
/// crossings of drive cycles are shorter.
pub(crate) const SHORTEST_REST_S: f64 = 5.0;
/// Longest pause inside a drive cycle, s. Stops of UDDS, US06 and WLTP last less.
pub(crate) const LONGEST_PAUSE_S: f64 = 120.0;
/// Longest part of the base current that is played before a pulse on it, s. The voltage then settles
/// under the base: slow branches of models have time constants of minutes.
pub(crate) const BASE_BEFORE_S: f64 = 600.0;
/// Part of the base before a pulse that is compared, s. Convention: it shows the level.
pub(crate) const COMPARED_BEFORE_S: f64 = 30.0;
/// Longest part of the base after a pulse that belongs to its run, s. Convention.
pub(crate) const BASE_AFTER_S: f64 = 120.0;
/// Fewest steps of a cycler's program that follow each other under current and are a drive cycle. In
/// an HPPC two do: a pulse, and the discharge to the next state.
pub(crate) const FEWEST_OF_CHAIN: usize = 3;
/// Longest pulse that is cut from a long current that follows it, s. Convention: HPPC pulses last 10 s
/// to 30 s.
pub(crate) const LONGEST_BEFORE_STEP_S: f64 = 60.0;
/// Time after the start of a pulse at which its resistance is stated, s. Convention.
pub(crate) const RESISTANCE_S: f64 = 1.0;
/// Longest step of a log within one segment, s. Cyclers log rests every 10 min at the slowest; a
/// longer step is a cut.
pub(crate) const CUT_S: f64 = 900.0;
/// Longest part of a rest that is put before the load into its run, s. Convention: a minute shows
/// the start voltage and its drift.
pub(crate) const LEAD_S: f64 = 60.0;
/// Largest residual slope of the rest before a load, V/s: 0.6 mV per minute. A run of a minute and
/// a half then drifts by less than the level error of 1 mV that the diagnosis assumes.
pub(crate) const STEEPEST_V_PER_S: f64 = 1e-5;
/// Last part of a rest whose slope counts, s. Convention: as [`LEAD_S`].
pub(crate) const REST_WINDOW_S: f64 = LEAD_S;
/// Last part of a rest whose median is the rest voltage, s. At [`STEEPEST_V_PER_S`] the voltage
/// moves by 0.1 mV in it.
pub(crate) const REST_VOLTAGE_S: f64 = 10.0;
/// Fewest samples of a slope, for slow logs. Convention.
pub(crate) const FEWEST_OF_SLOPE: usize = 5;
/// Deviation from its median up to which a current is constant, as a fraction. Half and twice the
/// current are 50 times as far away; cyclers hold 0.1 %.
pub const CONSTANT_PART: f64 = 0.02;
/// Shortest constant current that is a pulse and no part of a drive cycle, s. Convention: HPPC pulses
/// last 10 s, and 5 s in short ones.
pub const SHORTEST_PULSE_S: f64 = 4.0;
/// Longest constant current that is a pulse, s. Convention: HPPC pulses last 10 s to 30 s.
pub const LONGEST_PULSE_S: f64 = 300.0;
/// Shortest varying current that is a drive cycle, s. Convention.
pub(crate) const SHORTEST_CYCLE_S: f64 = 60.0;
/// Part by which a step of the log may exceed the slowest sampling. Stamps of cyclers jitter.
pub(crate) const JITTER_PART: f64 = 0.1;
/// Fewest samples of a long discharge or charge. Convention.
pub(crate) const FEWEST_OF_DISCHARGE: f64 = 50.0;
/// Band about the extreme voltage within which a limit holds it, V. Cyclers hold a few millivolts.
pub(crate) const LIMIT_BAND_V: f64 = 5e-3;
/// Fraction of a segment's samples in the band at which a limit counts as reached. Convention.
pub(crate) const LIMIT_PART: f64 = 0.1;
/// Fewest samples at a limit. Convention.
pub(crate) const FEWEST_AT_LIMIT: usize = 3;
/// Maximum fraction of its current that remains at the end of a segment at a limit. A constant
/// current loses none.
pub(crate) const LIMIT_CURRENT_PART: f64 = 0.95;
/// Part by which a counted state of charge may leave 0 to 1; a capacity is not known better.
pub(crate) const SOC_BEYOND: f64 = 0.02;
/// Step between the codes of a channel that is looked at, in codes: beyond it the rounding of
/// decimals adds up.
pub(crate) const NEAR_CODES: f64 = 8.0;
/// Fraction of the small steps of a channel that are whole codes, if it has codes. Convention.
pub(crate) const CODES_PART: f64 = 0.9;
/// Distance of a step from whole codes above which it does not count as a code, in codes.
/// Convention.
pub(crate) const OFF_CODE: f64 = 0.2;
/// Fewest steps that determine a code. Convention.
pub(crate) const FEWEST_STEPS: usize = 20;
/// Ratio of the mean square of normal deviates without the largest tenth to that of all.
/// Mathematics: 1 − 2·1.645·φ(1.645)/0.9.
pub(crate) const KEPT_VARIANCE: f64 = 0.623;
