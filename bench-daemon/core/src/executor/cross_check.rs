//! Compares meters that measure the same quantity: voltmeter and scope, voltmeter and charger
//! terminals, supply ammeter and shunt. A meter whose value does not change although its noise
//! would change it counts as broken.

use instruments::{
    scope::Waveform,
    units::{Amps, Ohms, Volts},
};

use super::{
    ExecuteError, Rig,
    crest::{OFFSET_GAIN, difference, mean},
};
use bench_plan::interlock::{NO_CURRENT_A, Quantity, Stuck};

/// Offset and noise of a DC voltmeter at a cell, V, and its gain error (bench loads and
/// supplies: 0.05 % and 0.02 % of the range of 36 V, and more for their leads).
const VOLTMETER_V: Volts = Volts(0.02);
const VOLTMETER_GAIN: f64 = 0.005;
/// Leads of a charger without sense leads, Ω: 2 m of 1.5 mm², two contacts and a fuse.
const LEADS_OHM: Ohms = Ohms(0.1);
/// How far the effective value by the supply's readings may be from that by the shunt, as a share:
/// readings a second apart of a period of five.
const EFFECTIVE: f64 = 0.3;

impl Rig<'_> {
    /// Returns an error if a meter does not change although its noise would change it.
    pub(super) async fn check_stuck_meter(&mut self) -> Result<(), ExecuteError> {
        let Some(Stuck {
            quantity,
            times,
            value,
        }) = self.interlock.stuck()
        else {
            return Ok(());
        };
        let (what, meter, value, other) = match quantity {
            Quantity::Temperature => {
                let bath_degc = self.watch_bath().await.ok().flatten();
                let bath = bath_degc.map(|celsius| format!("; the bath is at {celsius:.2}"));
                (
                    "cell temperature",
                    "the logger",
                    format!("{value} °C"),
                    bath,
                )
            }
            Quantity::Voltage => {
                let (meter, other) = self.other_volts().await;
                (
                    "cell voltage",
                    meter,
                    format!("{value} V"),
                    other.map(|(name, volts)| format!("; {name} shows {volts:.3}")),
                )
            }
            Quantity::Current => ("cell current", "its meter", format!("{value} A"), None),
        };
        Err(ExecuteError::Frozen {
            what,
            meter,
            times: times + 1,
            value,
            other: other.unwrap_or_default(),
        })
    }

    /// Returns the role whose voltmeter is in use, and the reading of another one.
    async fn other_volts(&mut self) -> (&'static str, Option<(&'static str, Volts)>) {
        let Some(supply) = self.bench.instruments.supply4q.as_mut() else {
            return ("the load", None);
        };
        // The message is more useful than a second error.
        let shown = supply.measure().await.ok().map(|(volts, _)| volts);
        if self.bench.instruments.load.is_some() {
            ("the load", shown.map(|volts| ("the bipolar supply", volts)))
        } else {
            ("the bipolar supply", None)
        }
    }

    /// Compares the mean of the scope's record of the cell with the voltmeter.
    pub(super) fn cross_check_scope(
        &self,
        [_, _, low, high]: &[Waveform; 4],
        amplitude_v: Volts,
    ) -> Result<(), ExecuteError> {
        let Some(shown_v) = self.watching.shown_v else {
            return Ok(());
        };
        let offsets_v: Volts = [low, high]
            .iter()
            .map(|waveform| Volts(OFFSET_GAIN * waveform.preamble.offset_v.abs()))
            .sum();
        let scope_v = Volts(mean(&difference(high, low)));
        let meter_v = VOLTMETER_V + VOLTMETER_GAIN * shown_v.abs();
        let allowed_v = meter_v
            + offsets_v
            + self.offset_error_v(high)
            + self.offset_error_v(low)
            + amplitude_v;
        if (scope_v - shown_v).abs() <= allowed_v {
            return Ok(());
        }
        Err(ExecuteError::Disagree {
            what: "cell voltage",
            one: format!("mean of the scope's record {scope_v:.3}"),
            other: format!("voltmeter {shown_v:.3}"),
            allowed: format!("{allowed_v:.3}"),
        })
    }

    /// Compares the charger's terminal voltage during a charge with the cell's voltage plus the
    /// drop of its leads.
    pub(super) fn cross_check_charger(
        &self,
        terminal_v: Volts,
        cell_v: Volts,
        amps: Amps,
    ) -> Result<(), ExecuteError> {
        let meters_v = 2.0 * (VOLTMETER_V + VOLTMETER_GAIN * cell_v.abs());
        let (drop_v, half_v) = (0.5 * LEADS_OHM * amps.abs(), 0.5 * LEADS_OHM * amps.abs());
        if (terminal_v - cell_v - drop_v).abs() <= half_v + meters_v {
            return Ok(());
        }
        let allowed = format!("{meters_v:.3}, and what {amps:.2} drop in {LEADS_OHM} of leads");
        let (one, other) = (
            format!("charger's terminals {terminal_v:.3}"),
            format!("voltmeter {cell_v:.3}"),
        );
        Err(ExecuteError::Disagree {
            what: "cell voltage",
            one,
            other,
            allowed,
        })
    }

    /// Compares the effective current from the supply's own readings of a period, if they follow
    /// it, with the amplitude in the record.
    pub(super) fn cross_check_supply(
        &self,
        supply_a: Option<Amps>,
        amplitude_a: Amps,
    ) -> Result<(), ExecuteError> {
        let Some(supply_a) = supply_a else {
            return Ok(());
        };
        let shunt_a = amplitude_a / std::f64::consts::SQRT_2;
        let allowed = EFFECTIVE * shunt_a + NO_CURRENT_A;
        if (supply_a - shunt_a).abs() <= allowed {
            return Ok(());
        }
        let (one, other) = (
            format!("shunt {shunt_a:.3} effective"),
            format!("bipolar supply's own readings {supply_a:.3}"),
        );
        Err(ExecuteError::Disagree {
            what: "current",
            one,
            other,
            allowed: format!("{allowed:.3}"),
        })
    }
}
