//! Legs of direct current or of rest. Load or supply work as for a discharge and a charge; every
//! reading is judged and stored with the charge that has flowed.

use instruments::{
    load::{Discharge, Draw},
    supply::Charge,
    units::{Amps, Coulombs, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, POLL_S,
    dc::{bound, follows},
    require,
    state::Legs,
    watch::LOAD_CURRENT,
};
use bench_plan::{
    config::LOAD_CUT_OFF_V,
    interlock::{Drive, Reading},
    plan::{Flow, Leg},
};

use crate::clock::TypedClock;

/// Distance from its voltage limit within which the supply's current may fall, V.
const NEAR_LIMIT_V: Volts = Volts(0.1);
/// Number of readings after which a current that has fallen is judged: by then it has risen.
const RISEN_POLLS: u32 = 5;

impl Executor<'_> {
    pub(super) async fn leg(&mut self, leg: &Leg) -> Result<(), ExecuteError> {
        if self.direct.legs.log != Some(leg.log) {
            self.direct.legs = Legs {
                log: Some(leg.log),
                start_s: self.rig.clock.now(),
                ..Legs::default()
            };
            self.rig.temperatures.last_degc = self.rig.cell_temperature().await?;
        }
        let before_coulomb = self.direct.legs.charge_coulomb;
        match leg.flow {
            Flow::Discharge { .. } | Flow::DischargeTo { .. } => self.discharge_leg(leg).await?,
            Flow::Charge { .. } => self.charge_leg(leg).await?,
            Flow::Rest => self.rest_leg(leg).await?,
        }
        if let Flow::DischargeTo {
            below_full_coulomb, ..
        } = leg.flow
        {
            self.direct.charge_coulomb += self.direct.legs.charge_coulomb - before_coulomb;
            self.journal_charge()?;
            self.note_short(below_full_coulomb);
            if self.direct.legs.rows.is_empty() {
                return Ok(());
            }
        }
        // All or nothing; the readings of a leg that ended early are in the readings file.
        Ok(self
            .rig
            .recorder
            .legs(&leg.log.file(), &self.direct.legs.rows)?)
    }

    async fn discharge_leg(&mut self, leg: &Leg) -> Result<(), ExecuteError> {
        let (current_a, until_v, charge_coulomb) = match leg.flow {
            Flow::Discharge {
                current_a,
                until_v,
                charge_coulomb,
            } => (current_a, until_v, charge_coulomb),
            Flow::DischargeTo {
                current_a,
                until_v,
                below_full_coulomb,
                ..
            } => {
                let left_coulomb = below_full_coulomb + self.direct.charge_coulomb;
                (current_a, until_v, Some(left_coulomb))
            }
            Flow::Charge { .. } | Flow::Rest => return Ok(()),
        };
        if charge_coulomb.is_some_and(|left_coulomb| left_coulomb <= Coulombs::ZERO) {
            tracing::info!("already at its charge: nothing to discharge");
            return Ok(());
        }
        if self.rig.idle_volts("discharge").await? <= until_v {
            tracing::info!("already below {until_v}: nothing to discharge");
            return Ok(());
        }
        // As for any discharge: the load's own end lies below the daemon's end, and not below the
        // cell's limit.
        let stop_below = (until_v - LOAD_CUT_OFF_V).max(self.rig.setup.limits.min_v);
        let error = self.rig.bench.error("load");
        let load = require(&mut self.rig.bench.instruments.load, "load")?;
        load.prepare(&Discharge {
            draw: Draw::Current(current_a),
            stop_below,
        })
        .await
        .map_err(&error)?;
        load.energise().await.map_err(&error)?;
        let (start_s, from_coulomb) = (self.rig.clock.now(), self.direct.legs.charge_coulomb);
        let mut last_s = start_s;
        for poll in 1.. {
            self.rig.clock.sleep_for(POLL_S).await;
            let (volts, drawn_a) = self.rig.load_volts().await?;
            self.keep("discharge", &mut last_s, volts, -drawn_a).await?;
            if volts <= until_v
                || charge_coulomb.is_some_and(|charge_coulomb| {
                    from_coulomb - self.direct.legs.charge_coulomb >= charge_coulomb
                })
            {
                break;
            }
            self.rig
                .explained(follows("load", poll, current_a, drawn_a))
                .await?;
            bound(leg, last_s - start_s, leg.max_s, || {
                format!("the cell is at {volts:.3}")
            })?;
        }
        Ok(require(&mut self.rig.bench.instruments.load, "load")?
            .safe()
            .await
            .map_err(error)?)
    }

    /// Executes a charge. The supply has no sense leads: the drop of its leads only keeps the cell
    /// further below the limit, and decreases with the current. The load's voltmeter judges the
    /// cell itself.
    async fn charge_leg(&mut self, leg: &Leg) -> Result<(), ExecuteError> {
        let Flow::Charge {
            current_a,
            limit_v,
            cut_off_a,
            charge_coulomb,
        } = leg.flow
        else {
            return Ok(());
        };
        if self.rig.idle_volts("charge").await? >= limit_v {
            tracing::info!("already at {limit_v}: nothing to charge");
            return Ok(());
        }
        let error = self.rig.bench.error("supply");
        let supply = require(&mut self.rig.bench.instruments.supply, "supply")?;
        supply
            .prepare(&Charge {
                voltage: limit_v,
                current: current_a,
            })
            .await
            .map_err(&error)?;
        supply.energise().await.map_err(&error)?;
        let (start_s, from_coulomb) = (self.rig.clock.now(), self.direct.legs.charge_coulomb);
        let mut last_s = start_s;
        for poll in 1.. {
            self.rig.clock.sleep_for(POLL_S).await;
            let (volts, drawn_a) = self.rig.load_volts().await?;
            self.rig.no_current(LOAD_CURRENT, drawn_a)?;
            let (terminal_v, fed_a) = self.rig.read_drive(Drive::Supply).await?;
            self.keep("charge", &mut last_s, volts, fed_a).await?;
            self.rig.cross_check_charger(terminal_v, volts, fed_a)?;
            let full = poll >= RISEN_POLLS && volts > limit_v - NEAR_LIMIT_V && fed_a <= cut_off_a;
            if full
                || charge_coulomb.is_some_and(|charge_coulomb| {
                    self.direct.legs.charge_coulomb - from_coulomb >= charge_coulomb
                })
            {
                break;
            }
            if volts < limit_v - NEAR_LIMIT_V {
                self.rig
                    .explained(follows("supply", poll, current_a, fed_a))
                    .await?;
            }
            bound(leg, last_s - start_s, leg.max_s, || {
                format!("the cell is at {volts:.3} and takes {fed_a:.3}")
            })?;
        }
        Ok(require(&mut self.rig.bench.instruments.supply, "supply")?
            .safe()
            .await
            .map_err(error)?)
    }

    async fn rest_leg(&mut self, leg: &Leg) -> Result<(), ExecuteError> {
        let start_s = self.rig.clock.now();
        let mut last_s = start_s;
        while last_s - start_s < leg.max_s {
            self.rig.clock.sleep_for(POLL_S).await;
            let (volts, drawn_a) = self.rig.load_volts().await?;
            let (_, fed_a) = self.rig.read_drive(Drive::Supply).await?;
            let time_s = self.rig.clock.now();
            let temperature_degc = self.rig.temperature_now_and_then().await?;
            let reading = Reading {
                time_s,
                voltage_v: Some(volts),
                current_a: Some(fed_a - drawn_a),
                temperature_degc,
            };
            self.rig.judge("rest", reading)?;
            self.rig.idle_meters(drawn_a, fed_a).await?;
            last_s = time_s;
            // Nothing flows: the meters show their zero error.
            let last_degc = self.rig.temperatures.last_degc;
            self.direct.legs.push(time_s, volts, Amps::ZERO, last_degc);
        }
        Ok(())
    }

    /// Judges and stores a reading, and adds the charge since the last one. `amps` is positive in
    /// the charge direction.
    async fn keep(
        &mut self,
        phase: &str,
        last_s: &mut Seconds,
        volts: Volts,
        amps: Amps,
    ) -> Result<(), ExecuteError> {
        let time_s = self.rig.clock.now();
        let temperature_degc = self.rig.temperature_now_and_then().await?;
        self.rig.judge(
            phase,
            Reading {
                time_s,
                voltage_v: Some(volts),
                current_a: Some(amps),
                temperature_degc,
            },
        )?;
        self.rig.look_back().await?;
        // During a charge the load is read too, as a voltmeter.
        self.rig
            .others_off(if amps < Amps::ZERO {
                &["load"]
            } else {
                &["load", "supply"]
            })
            .await?;
        self.direct.legs.charge_coulomb += amps * (time_s - *last_s);
        *last_s = time_s;
        let last_degc = self.rig.temperatures.last_degc;
        self.direct.legs.push(time_s, volts, amps, last_degc);
        Ok(())
    }
}
