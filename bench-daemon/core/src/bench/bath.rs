//! Handles a bath that closes its own loop, after everything else is off. The bath moves no charge
//! and may be what cools the cell. It therefore keeps its set-point unless its set-point, its
//! control, or the reading of its own sensor is wrong. No drive waits for the bath. It is queried
//! for a short time only, because it may serve another client.

use std::time::Duration;

use instruments::{
    chiller::Chiller,
    clock::Clock,
    exchange::plain,
    link::LinkError,
    units::{Celsius, Seconds},
};

use super::{
    Bench,
    error::{BenchError, wrap},
    output::BathLeft,
    roles::fresh,
};
use bench_plan::interlock::{BathFault, BathJudge, BathReading};

use crate::clock::TypedClock;

/// Longest wait for the answers of the bath.
const ASKED: Duration = Duration::from_secs(5);
/// How long a bath far from its set-point is observed to determine its direction, and the pause
/// between two readings, s.
const WATCHED_S: Seconds = Seconds(10.0);
const AGAIN_S: Seconds = Seconds(1.0);

/// Criteria for a bath beside its own settings.
#[derive(Debug, Clone, Default)]
pub struct BathOrder {
    /// Least and greatest temperature of the cell, °C, where they are known.
    pub cell_degc: Option<(Celsius, Celsius)>,
    /// Why the bath must be stopped in any case, as text.
    pub stop: Option<String>,
}

/// Result of reading the sensor of a bath.
enum SensorReading {
    /// The last temperature, °C, with no fault.
    Sound(Celsius),
    Wrong(BathFault),
    /// Reason why no reading was taken.
    Unread(String),
}

impl Bench {
    /// Connects to the bath and checks its identity.
    ///
    /// # Errors
    /// Fails if the bath cannot be reached or is another model.
    pub async fn reach_bath(&mut self) -> Result<(), BenchError> {
        let Some(bath) = self.instruments.chiller.as_mut() else {
            return Ok(());
        };
        let reached = bath.reconnect_and_identify().await;
        reached.map_err(|source| wrap("chiller", self.model("chiller"), source))
    }

    /// Stops a bath that closes its own loop and that this run has started, if its settings differ
    /// from those that the run made, if its own sensor shows that it is not under control, or if
    /// the order requires it. Returns the resulting state, or `None` if the bath was left as it is
    /// and its sensor was read.
    pub async fn stop_stray_bath(&mut self, order: &BathOrder) -> Option<BathLeft> {
        let clock = self.clock.clone();
        let bath = self
            .instruments
            .chiller
            .as_mut()
            .filter(|chiller| !chiller.is_regulated() && chiller.has_settings())?;
        if let Some(reason) = &order.stop {
            return Some(stopped(bath, reason).await);
        }
        let asked = async {
            fresh(bath).await;
            let differs = bath.differs().await?;
            Ok::<_, LinkError>((differs, bath.setpoint().await?))
        };
        match within(&clock, asked).await {
            Ok((Some(met), _)) => Some(stopped(bath, &met).await),
            Ok((None, None)) => None,
            Ok((None, Some(setpoint))) => {
                match read_sensor(bath, &clock, setpoint, order.cell_degc).await {
                    SensorReading::Sound(_) => None,
                    SensorReading::Wrong(fault) => Some(stopped(bath, &fault.to_string()).await),
                    SensorReading::Unread(why) => Some(unread(setpoint, &why)),
                }
            }
            Err(why) => {
                tracing::warn!("bath: {why}");
                Some(BathLeft::astray(&format!(
                    "it was not reached: where it goes is not known: {why}"
                )))
            }
        }
    }

    /// As `stop_stray_bath`, for a bath that another process started at this set-point, °C, before
    /// it died.
    pub async fn stop_stray_bath_of(
        &mut self,
        setpoint_degc: Celsius,
        order: &BathOrder,
    ) -> Option<BathLeft> {
        self.instruments
            .chiller
            .as_ref()?
            .was_left_at(setpoint_degc)
            .await;
        self.stop_stray_bath(order).await
    }

    /// Returns the state of a bath that closes its own loop, for a person. Stops the bath if its
    /// set-point or its sensor lies outside the limits of the cell, °C, if these are known, or if
    /// the bath moves away from its set-point. Returns `None` on a bench without such a bath.
    pub async fn bath(&mut self, cell_degc: Option<(Celsius, Celsius)>) -> Option<BathLeft> {
        let model = self.model("chiller").to_owned();
        let clock = self.clock.clone();
        let bath = self
            .instruments
            .chiller
            .as_mut()
            .filter(|chiller| !chiller.is_regulated())?;
        let asked = async {
            fresh(bath).await;
            Ok::<_, LinkError>((bath.setpoint().await?, bath.status().await?.running))
        };
        let (setpoint_degc, running) = match within(&clock, asked).await {
            Ok((Some(setpoint), running)) => (setpoint, running),
            Ok((None, _)) => return None,
            Err(why) => {
                tracing::warn!("bath: {why}");
                return Some(BathLeft::astray(&format!(
                    "it ({model}) was not reached and keeps what it was set to: {why}"
                )));
            }
        };
        let text = plain(setpoint_degc.value());
        if !running {
            return Some(BathLeft::harmless(format!(
                "the bath ({model}) stands still; its set-point is {text} °C"
            )));
        }
        if let Some((least, greatest)) =
            cell_degc.filter(|(least, greatest)| !(*least..=*greatest).contains(&setpoint_degc))
        {
            let met = format!(
                "its set-point is {text} °C, and the cell bears {} °C to {} °C",
                plain(least.value()),
                plain(greatest.value())
            );
            return Some(stopped(bath, &met).await);
        }
        Some(
            match read_sensor(bath, &clock, setpoint_degc, cell_degc).await {
                SensorReading::Sound(sensor_degc) => BathLeft::harmless(format!(
                    "the bath ({model}) goes on: set to {setpoint_degc:.1}, its sensor reads \
                {sensor_degc:.1}"
                )),
                SensorReading::Wrong(fault) => stopped(bath, &fault.to_string()).await,
                SensorReading::Unread(why) => unread(setpoint_degc, &why),
            },
        )
    }
}

/// Waits a short time for answers of a bath. Returns the reason as text if there are none.
async fn within<T>(
    clock: &Clock,
    asked: impl Future<Output = Result<T, LinkError>>,
) -> Result<T, String> {
    match clock.deadline(ASKED, asked).await {
        Ok(answered) => answered.map_err(|error| error.to_string()),
        Err(_) => Err(format!("it did not answer within {ASKED:?}")),
    }
}

/// Describes a running bath whose temperature is unknown.
fn unread(setpoint_degc: Celsius, why: &str) -> BathLeft {
    tracing::warn!("bath: {why}");
    BathLeft::astray(&format!(
        "set to {setpoint_degc:.1}; its temperature was not read"
    ))
}

/// Reads and judges the sensor of a running bath. One reading is enough if the bath is near its
/// set-point; a bath that is far from it is observed to determine its direction.
async fn read_sensor(
    bath: &mut Chiller,
    clock: &Clock,
    setpoint_degc: Celsius,
    cell_degc: Option<(Celsius, Celsius)>,
) -> SensorReading {
    let mut judge = BathJudge::leaving(cell_degc);
    let end_s = clock.now() + WATCHED_S;
    loop {
        let sensor_degc = match within(clock, bath.temperature()).await {
            Ok(celsius) => celsius,
            Err(why) => return SensorReading::Unread(why),
        };
        let reading = BathReading {
            sensor_degc: Some(sensor_degc),
            setpoint_degc,
        };
        if let Some(fault) = judge.judge(reading, clock.now()) {
            return SensorReading::Wrong(fault);
        }
        if BathJudge::is_held(reading) || clock.now() >= end_s {
            return SensorReading::Sound(sensor_degc);
        }
        clock.sleep_for(AGAIN_S).await;
    }
}

/// Stops a bath and reads back that it stopped. If it does not stop, tries the fallback methods of
/// its dialect.
async fn stopped(bath: &mut Chiller, met: &str) -> BathLeft {
    fresh(bath).await;
    let Err(error) = bath.stop().await else {
        return BathLeft::harmless(format!("the bath was stopped, read back, for {met}"));
    };
    tracing::warn!("bath: {error}");
    for way in bath.zero() {
        fresh(bath).await;
        if bath.go(&way).await.is_ok() {
            return BathLeft::astray(&format!(
                "{met}, and it does not stop ({error}); it was given {}",
                way.name
            ));
        }
    }
    BathLeft::astray(&format!(
        "{met}, and it does not stop: {error}: SWITCH IT OFF AT ITS PANEL"
    ))
}
