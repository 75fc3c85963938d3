//! The oscilloscope that digitises the four probe channels.
//!
//! No state of an earlier session is trusted: transfer start, stride, width and format survive
//! disconnects on these instruments, so every download sets them again, and uses the scaling of the
//! same acquisition.

mod contract;
mod download;
mod rigol_dho;
mod siglent_sds;

pub use download::Chosen;

use instruments_link::link::LinkError;

use crate::{
    exchange::{Exchange, changes, check_in_turn, keep},
    instrument::Instrument,
};
pub use contract::{Capabilities, Dialect, Intent, Preamble, Queries, Trigger, Vertical, Waveform};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sds::SDS800X_HD, &rigol_dho::DHO800];

/// Frames come in at most ten status polls a second; older Siglents crash under faster ones.
const POLL_S: f64 = 0.1;
/// Polls before a stop is given up.
const POLLS: usize = 50;

/// An oscilloscope on its link.
pub type Scope = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Capabilities of the model.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Executes one intent.
    ///
    /// # Errors
    /// The error of the first message that was refused or whose read-back was wrong.
    pub async fn set(&mut self, intent: &Intent) -> Result<(), LinkError> {
        self.play_and_keep(&self.dialect.script(intent), intent)
            .await?;
        // The level of the trigger and the run have no read-back. An entry may also be of an earlier
        // client, so that it is a remark; a record that is not of this acquisition is refused.
        let unread = matches!(intent, Intent::Arm | Intent::Roll);
        if unread && self.link.profile().errors_on_demand {
            for entry in self.link.drain_errors().await? {
                self.link.note(&format!("its error queue held: {entry}"));
            }
        }
        Ok(())
    }

    /// As [`Self::set`], but sends only the settings that do not stand already. Those that stand are
    /// read back in turn by [`Self::check_in_turn`].
    ///
    /// # Errors
    /// As [`Self::set`].
    pub async fn set_changes(&mut self, intent: &Intent) -> Result<(), LinkError> {
        let script = changes(&self.standing, &self.dialect.script(intent));
        self.play_and_keep(&script, intent).await
    }

    /// Reads back one of the settings that stand, in turn, and changes nothing. Returns a
    /// description of a difference; after it all settings are sent again.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn check_in_turn(&mut self) -> Result<Option<String>, LinkError> {
        let settings = self.dialect.settings();
        check_in_turn(&mut self.link, settings, &mut self.standing).await
    }

    /// Forgets the settings that stand, so that all are sent again: a person may have used the panel.
    pub fn forget_settings(&mut self) {
        self.standing.clear();
    }

    async fn play_and_keep(
        &mut self,
        script: &[Exchange],
        intent: &Intent,
    ) -> Result<(), LinkError> {
        let played = self.play(script).await;
        match intent {
            // After a failure the scope may have restarted: nothing is known to stand.
            _ if played.is_err() => self.standing.clear(),
            // What starts and stops an acquisition is no setting.
            Intent::Arm | Intent::Roll | Intent::Stop => {}
            _ => {
                let transfer = matches!(intent, Intent::Transfer { .. } | Intent::Page { .. });
                keep(&mut self.standing, script, !transfer);
            }
        }
        played
    }

    /// Stops the scope and waits until it reports that it has stopped.
    ///
    /// # Errors
    /// The link's errors; a scope that does not stop.
    pub async fn stop(&mut self) -> Result<(), LinkError> {
        self.set(&Intent::Stop).await?;
        let queries = self.dialect.queries();
        let mut answer = String::new();
        for _ in 0..POLLS {
            answer = self.link.query(queries.status).await?;
            if answer.trim().eq_ignore_ascii_case(queries.stopped) {
                return Ok(());
            }
            self.link.clock().clone().sleep_s(POLL_S).await;
        }
        Err(LinkError::unexpected(
            self.link.name(),
            queries.status,
            &answer,
            "the stopped state within 5 s",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments_domain::units::{Seconds, Volts};

    #[test]
    fn the_time_base_holds_the_span_in_one_two_five_steps() {
        let scope = siglent_sds::SDS800X_HD.capabilities();
        for (span_s, expected) in [
            (50.0, 5.0),
            (50.1, 10.0),
            (5.0 / 300.0, 2.0e-3),
            (1.0, 0.1),
            (0.0101, 2.0e-3),
            (10_000.0, 1000.0),
        ] {
            let met = scope.time_per_div(Seconds(span_s)).value();
            assert!(
                (met - expected).abs() < 1.0e-9 * expected,
                "{span_s} s: {met} s/div, expected {expected}"
            );
        }
    }

    #[test]
    fn an_offset_beyond_the_limit_of_a_fine_scale_asks_for_a_coarser_one() {
        let scope = siglent_sds::SDS800X_HD.capabilities();
        assert_eq!(
            scope.scale_for_offset(Volts(0.08), Volts(-3.8)),
            Volts(0.08)
        );
        let coarser = scope.scale_for_offset(Volts(0.004), Volts(-3.8));
        assert!(
            coarser.value() > 0.005 && scope.offset_limit(coarser).value() >= 3.8,
            "{coarser}"
        );
    }
}
