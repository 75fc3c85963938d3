//! Reads and judges the bath of the cell by its own sensor, and compares the cell's thermometer with
//! it.

use instruments::{
    link::LinkError,
    units::{Celsius, Kelvins},
};

use super::{ExecuteError, Rig};
use bench_plan::interlock::{BathReading, ThermometerReadings};

use crate::clock::TypedClock;

/// Greatest difference by which a cell that carries no current for long may be colder than the
/// bath, because of heat that its mounting conducts, K.
const COLDER_K: Kelvins = Kelvins(10.0);
/// Allowed warming of a cell under a periodic current, K. It is half of the distance from 20 °C to
/// 60 °C, above which cells must not be discharged. Under a large direct current the cell may warm
/// by the whole distance.
const WARMER_K: Kelvins = Kelvins(20.0);

impl Rig<'_> {
    /// Reads the own sensor of a bath that this run has started, records the reading and judges it.
    /// Returns `None` if no bath was started, or if the sensor gives no temperature.
    pub(super) async fn watch_bath(&mut self) -> Result<Option<Celsius>, ExecuteError> {
        let error = self.bench.error("chiller");
        let Some(chiller) = self
            .bench
            .instruments
            .chiller
            .as_mut()
            .filter(|_| self.temperatures.chiller_runs)
        else {
            return Ok(None);
        };
        let sensor_degc = match chiller.temperature().await {
            Ok(celsius) => Some(celsius),
            Err(LinkError::Unexpected { .. }) => None,
            Err(failed) => return Err(error(failed).into()),
        };
        self.recorder
            .bath(sensor_degc, self.temperatures.setpoint_degc);
        // If the daemon closes the loop, the bath is judged there.
        if self.temperatures.thermostat.is_none() {
            self.judge_bath(sensor_degc)?;
        }
        Ok(sensor_degc)
    }

    /// Judges a reading of the bath's own sensor, °C.
    pub(super) fn judge_bath(&mut self, sensor_degc: Option<Celsius>) -> Result<(), ExecuteError> {
        let Some(setpoint_degc) = self.temperatures.setpoint_degc else {
            return Ok(());
        };
        let reading = BathReading {
            sensor_degc,
            setpoint_degc,
        };
        match self.interlock.judge_bath(reading, self.clock.now()) {
            Some(trip) => Err(trip.into()),
            None => Ok(()),
        }
    }

    /// Checks the bath, and compares the cell's thermometer with it: a bath that holds the cell
    /// has about the same temperature. The two are not compared while nothing can flow or the
    /// temperature is to change. A bath whose loop the daemon closes is then read by
    /// [`Self::regulate`]. Returns the reading of the bath's sensor, °C.
    pub(super) async fn cross_check_bath(&mut self) -> Result<Option<Celsius>, ExecuteError> {
        let judged = self.interlock.is_live() && !self.interlock.tempering();
        let cell_degc = self
            .temperatures
            .last_degc
            .filter(|celsius| celsius.is_finite() && judged);
        if cell_degc.is_none() && self.temperatures.thermostat.is_some() {
            return Ok(None);
        }
        let bath_degc = self.watch_bath().await?;
        if let Some((cell_degc, bath_degc)) = cell_degc.zip(bath_degc) {
            self.compare_with_bath(cell_degc, bath_degc)?;
        }
        Ok(bath_degc)
    }

    /// Judges one reading of all thermometers.
    pub(super) fn judge_thermometers(
        &mut self,
        readings: ThermometerReadings,
    ) -> Result<(), ExecuteError> {
        let now_s = self.clock.now();
        match self.interlock.judge_thermometers(readings, now_s) {
            Some(trip) => Err(trip.into()),
            None => Ok(()),
        }
    }

    fn compare_with_bath(
        &self,
        cell_degc: Celsius,
        bath_degc: Celsius,
    ) -> Result<(), ExecuteError> {
        let warmer_k = if self.interlock.allowed_mean().is_some() {
            WARMER_K
        } else {
            Kelvins::INFINITY
        };
        if (-COLDER_K..=warmer_k).contains(&(cell_degc - bath_degc)) {
            return Ok(());
        }
        Err(ExecuteError::Disagree {
            what: "temperature",
            one: format!("thermocouple on the cell {cell_degc:.2}"),
            other: match self.temperatures.setpoint_degc {
                Some(setpoint_degc) => {
                    format!("bath {bath_degc:.2} (set to {setpoint_degc:.1})")
                }
                None => format!("bath {bath_degc:.2}"),
            },
            allowed: match warmer_k.is_finite() {
                true => {
                    format!("{warmer_k} where the cell is warmer, {COLDER_K} where it is colder")
                }
                false => format!("{COLDER_K} where the cell is colder"),
            },
        })
    }
}
