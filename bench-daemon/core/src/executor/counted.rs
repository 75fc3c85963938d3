//! The charge that a map counts: what each part of it moves, and its record in the journal.

use instruments::units::Coulombs;

use super::{ExecuteError, Executor, state::Residual};
use crate::{clock::TypedClock, journal::Entry, record::RecordError};
use bench_plan::plan::MapPoint;

impl Executor<'_> {
    /// Returns the point of the map that the present stage belongs to.
    pub(super) fn point(&self) -> Option<MapPoint> {
        self.position.run.as_ref().and_then(|run| run.point)
    }

    /// Records the counted charge in the journal.
    pub(super) fn journal_charge(&mut self) -> Result<(), RecordError> {
        let charge_coulomb = self.direct.charge_coulomb;
        self.rig.recorder.journal(Entry::Charge { charge_coulomb })
    }

    /// Notes that a discharge has ended at its voltage before the charge of the point.
    pub(super) fn note_short(&mut self, below_full_coulomb: Coulombs) {
        let short_coulomb = below_full_coulomb + self.direct.charge_coulomb;
        let Some(point) = self
            .point()
            .filter(|point| short_coulomb > point.within_coulomb)
        else {
            return;
        };
        let text = format!(
            "the discharge ended at its voltage, {short_coulomb:.0} before the {:.0} C of the \
            point: it is measured at a higher charge",
            point.below_full_coulomb.0
        );
        let text = self.of_run(&text);
        self.rig.recorder.warning(&text);
    }

    /// Measures the current that is left of the bipolar supply while its command is zero: it flows
    /// under all sinusoids of a point.
    pub(super) async fn begin_count(&mut self) -> Result<(), ExecuteError> {
        self.direct.residual = None;
        if self.point().is_none() || self.rig.setup.wiring.analog.is_some() {
            return Ok(());
        }
        let Some(first_a) = self.rig.read_supply4q().await?.current_a else {
            return Ok(());
        };
        let mean_a = self.rig.mean_of_supply(first_a).await?;
        self.direct.residual = Some(Residual {
            current_a: mean_a - self.direct.ammeter_zero_a,
            since_s: self.rig.clock.now(),
        });
        Ok(())
    }

    /// Counts the charge of that current until now.
    pub(super) fn end_count(&mut self) -> Result<(), RecordError> {
        let Some(residual) = self.direct.residual.take() else {
            return Ok(());
        };
        let span_s = self.rig.clock.now() - residual.since_s;
        self.direct.charge_coulomb += residual.current_a * span_s;
        self.journal_charge()
    }
}
