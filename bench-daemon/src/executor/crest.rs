//! What a fast current does to the cell between two readings: meters average over it, so that its crests are looked at beforehand and in the record.

use instruments::{mock::plant::Fixture, scope::Waveform};

use super::{ExecuteError, Executor};
use crate::interlock::Trip;

/// No cell for which this bench is made has more at any frequency of a sweep, Ω. Its record tells the truth a moment later.
const MOST_OHM: f64 = 0.025;
/// What noise and gains of the channels may add to a crest, V.
const MARGIN_V: f64 = 0.02;

impl Executor<'_> {
    /// Refuses a current whose crests could leave the voltage limits of the cell as it was at rest.
    pub(super) fn headroom(&self, fixture: Fixture, (freq_hz, peak_a): (f64, f64)) -> Result<(), ExecuteError> {
        let Some(rest_v) = self.idle.voltage_v.filter(|_| fixture == Fixture::Cell) else { return Ok(()) };
        let limits = &self.experiment.cell.limits;
        let (least_v, greatest_v) = (rest_v - peak_a * MOST_OHM, rest_v + peak_a * MOST_OHM);
        if least_v >= limits.min_v && greatest_v <= limits.max_v {
            return Ok(());
        }
        let reason = format!(
            "expected crests within {} V to {} V, found up to {least_v:.3} V to {greatest_v:.3} V for {peak_a} A at a cell of {rest_v:.3} V",
            limits.min_v, limits.max_v
        );
        Err(ExecuteError::Signal { freq_hz, reason })
    }

    /// Trips where a record shows the cell beyond its limits, whatever the meters have averaged.
    pub(super) fn crest(&self, fixture: Fixture, waveforms: &[Waveform; 4]) -> Result<(), ExecuteError> {
        if fixture != Fixture::Cell {
            return Ok(());
        }
        let [.., low, high] = waveforms;
        let volts = |waveform: &Waveform, code: i16| f64::from(code) * waveform.preamble.volts_per_code - waveform.preamble.offset_v;
        let cell = high.codes.iter().zip(&low.codes).map(|(high_code, low_code)| volts(high, *high_code) - volts(low, *low_code));
        let (least_v, greatest_v) = cell.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), v| (least.min(v), most.max(v)));
        let limits = &self.experiment.cell.limits;
        let (least, greatest) = (limits.min_v, limits.max_v);
        let beyond = [(least_v, least_v < least - MARGIN_V), (greatest_v, greatest_v > greatest + MARGIN_V)];
        match beyond.into_iter().find(|(_, beyond)| *beyond) {
            Some((value, _)) => {
                let time_s = self.clock.now_s();
                Err(Trip::Limit { what: "cell voltage at the crest of a record", value, unit: "V", least, greatest, time_s }.into())
            }
            None => Ok(()),
        }
    }
}
