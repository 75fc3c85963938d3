//! Handles a bath that closes its own loop, once everything else is off. It moves no charge and may
//! be what cools the cell. It keeps its set-point, unless that is known to be wrong. No drive waits
//! for it. It is asked for a short time only, because it may serve another client.

use std::time::Duration;

use instruments::{chiller::Chiller, exchange::plain, units::Celsius};

use super::{
    Bench,
    error::{BenchError, wrap},
    output::BathLeft,
    roles::fresh,
};

/// Longest wait for its answers.
const ASKED: Duration = Duration::from_secs(5);

impl Bench {
    /// Connects to the bath and asks who it is.
    ///
    /// # Errors
    /// It cannot be reached, or is another model.
    pub async fn reach_bath(&mut self) -> Result<(), BenchError> {
        let Some(bath) = self.instruments.chiller.as_mut() else {
            return Ok(());
        };
        let reached = bath.reconnect_and_identify().await;
        reached.map_err(|source| wrap("chiller", self.model("chiller"), source))
    }

    /// Stops a bath that closes its loop itself, that this run has started, and that is no longer
    /// set as the run has set it: nobody knows where it goes. What became of it; nothing where it
    /// is as it should be.
    pub async fn stray_bath(&mut self) -> Option<BathLeft> {
        let bath = self
            .instruments
            .chiller
            .as_mut()
            .filter(|chiller| !chiller.is_regulated() && chiller.was_told())?;
        let asked = async {
            fresh(bath).await;
            bath.differs().await
        };
        match self.clock.deadline(ASKED, asked).await {
            Ok(Ok(None)) => None,
            Ok(Ok(Some(met))) => Some(stopped(bath, &met).await),
            Ok(Err(error)) => {
                tracing::warn!("bath: {error}");
                Some(BathLeft::astray(&format!(
                    "it was not reached: where it goes is not known: {error}"
                )))
            }
            Err(_) => Some(BathLeft::astray(&format!(
                "it did not answer within {ASKED:?}: where it goes is not known"
            ))),
        }
    }

    /// The same for a bath that another process, which is dead, had started at this set-point, °C.
    pub async fn stray_bath_of(&mut self, setpoint_c: f64) -> Option<BathLeft> {
        self.instruments
            .chiller
            .as_ref()?
            .was_left_at(Celsius(setpoint_c))
            .await;
        self.stray_bath().await
    }

    /// State of a bath that closes its own loop, for a person. A bath whose set-point lies outside
    /// the limits of the cell, °C, is stopped. Where the limits are not known it is left alone.
    /// Returns `None` on a bench without such a bath.
    pub async fn bath(&mut self, cell_c: Option<(f64, f64)>) -> Option<BathLeft> {
        let model = self.model("chiller").to_owned();
        let bath = self
            .instruments
            .chiller
            .as_mut()
            .filter(|chiller| !chiller.is_regulated())?;
        let asked = async {
            fresh(bath).await;
            Ok::<_, instruments::link::LinkError>((
                bath.setpoint().await?,
                bath.status().await?.running,
            ))
        };
        let (setpoint, running) = match self.clock.deadline(ASKED, asked).await {
            Ok(Ok((Some(setpoint), running))) => (setpoint.value(), running),
            Ok(Ok((None, _))) => return None,
            Ok(Err(error)) => {
                tracing::warn!("bath: {error}");
                return Some(BathLeft::told(format!(
                    "the bath ({model}) was not reached and keeps what it was set to: {error}"
                )));
            }
            Err(_) => {
                return Some(BathLeft::told(format!(
                    "the bath ({model}) did not answer within {ASKED:?} and keeps what it was set \
                    to"
                )));
            }
        };
        let text = plain(setpoint);
        if !running {
            return Some(BathLeft::told(format!(
                "the bath ({model}) stands still; its set-point is {text} °C"
            )));
        }
        match cell_c.filter(|(least, greatest)| !(*least..=*greatest).contains(&setpoint)) {
            None => Some(BathLeft::told(format!(
                "the bath ({model}) goes on and holds {text} °C"
            ))),
            Some((least, greatest)) => {
                let met = format!(
                    "its set-point is {text} °C, and the cell bears {} °C to {} °C",
                    plain(least),
                    plain(greatest)
                );
                Some(stopped(bath, &met).await)
            }
        }
    }
}

/// Stops a bath; where it does not stop, it is told the other ways of its dialect.
async fn stopped(bath: &mut Chiller, met: &str) -> BathLeft {
    fresh(bath).await;
    let Err(error) = bath.stop().await else {
        return BathLeft::told(format!("the bath was stopped, for {met}"));
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
