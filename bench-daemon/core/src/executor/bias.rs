//! A direct current under the sinusoids of a sweep: ramps it by the generator's offset, measures it
//! and the zero error of the drive, sets the scope for records about it, and brings back the charge
//! that it has moved.
//!
//! The shunt measures the current: the channels are recorded with every output off, with the output
//! on at zero, and at the direct current, on the same ranges. The error of a gain is then the same in
//! both directions, so that the returned charge is free of it.

mod state;

use instruments::{
    fixture::Fixture,
    units::{Amps, Coulombs, Hertz, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, POLL_S, Rig,
    crest::{channel_volts, mean},
    require,
};
use crate::{clock::TypedClock, record::Event};
use bench_plan::plan::{Bias, RAMP_STEP_S, Recharge, Step, ramp_steps};
pub(super) use state::BiasState;

/// Points per channel of a record at one direct current.
const RECORD_POINTS: u64 = 10_000;
/// Greatest deviation of the direct current from its command, as a share and in A.
const FOLLOWS: (f64, Amps) = (0.05, Amps(0.1));
/// Greatest deviation of a reading of the supply's meter from the command, as a share and in A.
const METER_FOLLOWS: (f64, Amps) = (0.1, Amps(0.3));
/// Standard deviations of a gain of a channel on a range that the controls have not measured, after
/// the correction and without one (data sheets of 12-bit scopes: 0.5 % to 1 %).
const GAIN_SIGMA: (f64, f64) = (0.003, 0.006);
/// Standard deviation of the mean of a record, A.
const MEAN_SIGMA_A: Amps = Amps(2.0e-3);
/// Standard deviations within which the current must follow its command.
const CERTAIN: f64 = 3.0;
/// Shortest time for which a recharge drives its current, s.
const SHORTEST_RECHARGE_S: Seconds = Seconds(30.0);
/// Time for which a recharge settles before its current is measured, s.
const RECHARGE_SETTLE_S: Seconds = Seconds(5.0);

impl Rig<'_> {
    /// Returns the generator's offset for a direct current, V: trimmed, without the zero error of the
    /// drive.
    pub(super) fn offset_v(&self, current_a: Amps) -> Volts {
        let wiring = &self.setup.wiring;
        wiring.command_v(current_a - self.driving.bias.zero_a) + wiring.command_offset_v
    }

    /// Ramps the direct current and watches each step.
    async fn ramp(&mut self, to_a: Amps) -> Result<(), ExecuteError> {
        let from_a = self.driving.bias.commanded_a;
        let (now_s, flowing_a) = (self.clock.now(), self.driving.bias.met.current_a);
        self.driving.bias.count(now_s, flowing_a);
        // The last sinusoid ends first, then the burst that it was.
        self.command(from_a).await?;
        self.end_burst().await?;
        let steps = ramp_steps(from_a, to_a);
        for step in 1..=steps {
            let level_a = if step == steps {
                to_a
            } else {
                from_a + (to_a - from_a) * step as f64 / steps as f64
            };
            self.command_bias(level_a).await?;
            self.clock.sleep_for(RAMP_STEP_S).await;
            self.watch("bias", Fixture::Cell).await?;
        }
        Ok(())
    }

    /// Commands a direct current. The charge so far counts with the current so far.
    async fn command_bias(&mut self, level_a: Amps) -> Result<(), ExecuteError> {
        self.command(level_a).await?;
        let (now_s, flowing_a) = (self.clock.now(), self.driving.bias.met.current_a);
        let bias = &mut self.driving.bias;
        bias.count(now_s, flowing_a);
        (bias.commanded_a, bias.met.current_a, bias.meter_a) = (level_a, level_a, level_a);
        self.interlock.steady(level_a);
        Ok(())
    }

    /// Waits at the direct current and checks every reading against the command. The mean of the
    /// readings becomes the current by the supply's meter.
    async fn hold(&mut self, seconds: Seconds) -> Result<(), ExecuteError> {
        let end_s = self.clock.now() + seconds;
        let (mut sum_a, mut count) = (Amps::ZERO, 0.0);
        while self.clock.now() < end_s {
            let left_s = end_s - self.clock.now();
            self.clock.sleep_for(left_s.min(POLL_S)).await;
            let reading = self.watch("bias", Fixture::Cell).await?;
            let Some(amps) = reading.current_a else {
                continue;
            };
            let followed = self.meter_follows(amps);
            self.explained(followed).await?;
            (sum_a, count) = (sum_a + amps, count + 1.0);
        }
        if count > 0.0 {
            self.driving.bias.meter_a = sum_a / count;
            self.interlock.steady(sum_a / count);
        }
        Ok(())
    }

    fn meter_follows(&self, amps: Amps) -> Result<(), ExecuteError> {
        let (commanded_a, (share, least_a)) = (self.driving.bias.commanded_a, METER_FOLLOWS);
        if (amps - commanded_a).abs() <= share * commanded_a.abs() + least_a {
            return Ok(());
        }
        Err(ExecuteError::Disobeyed {
            what: "direct current by the supply's meter".to_owned(),
            expected: format!("{commanded_a:.3}"),
            met: format!("{amps:.3}"),
        })
    }
}

impl Executor<'_> {
    /// Records the channels with every output off.
    pub(super) async fn bias_zero(&mut self, plan: &Bias) -> Result<(), ExecuteError> {
        let now_s = self.rig.clock.now();
        let range_a = plan.from_a.abs().max(plan.to_a.abs()) + plan.amplitude_a;
        self.rig.driving.bias = BiasState::begin(plan.most_coulomb, range_a, now_s);
        let off_v = self.record_means().await?;
        self.rig.driving.bias.off_v = Some(off_v);
        Ok(())
    }

    /// Changes the direct current. At a new one, measures it and sets the scope for records about it.
    pub(super) async fn bias(&mut self, plan: &Bias) -> Result<(), ExecuteError> {
        if plan.from_a == Amps::ZERO {
            self.bias_headroom(plan)?;
            self.cancel_zero().await?;
        }
        self.rig.ramp(plan.to_a).await?;
        if plan.to_a == Amps::ZERO {
            return Ok(());
        }
        self.rig.hold(plan.settle_s).await?;
        self.measure_bias().await?;
        self.centre_on_bias(plan.amplitude_a).await
    }

    /// Refuses a direct current under which the cell could leave its voltage limits, from its voltage
    /// at rest.
    fn bias_headroom(&self, plan: &Bias) -> Result<(), ExecuteError> {
        let Some(rest_v) = self.known.idle.voltage_v else {
            return Ok(());
        };
        let limits = &self.rig.setup.limits;
        let (down_v, up_v) = plan.swing_v(limits);
        let (least_v, greatest_v) = (rest_v + down_v, rest_v + up_v);
        if least_v >= limits.min_v && greatest_v <= limits.max_v {
            return Ok(());
        }
        Err(ExecuteError::Disobeyed {
            what: format!("cell before a direct current of {:+} A", plan.to_a.0),
            expected: format!(
                "a voltage at rest from which {} V to {} V cannot be left",
                limits.min_v.0, limits.max_v.0
            ),
            met: format!("{rest_v:.3}, at worst {least_v:.3} to {greatest_v:.3}"),
        })
    }

    /// Measures the current at a command of zero, and cancels it from now on.
    async fn cancel_zero(&mut self) -> Result<(), ExecuteError> {
        let (zero_a, _) = self.record_current().await?;
        let now_s = self.rig.clock.now();
        let bias = &mut self.rig.driving.bias;
        bias.count(now_s, zero_a);
        bias.zero_a += zero_a;
        let text = format!("direct current with the command at zero: {zero_a:+.4}, cancelled");
        Ok(self.rig.recorder.event(Event::Check, &text)?)
    }

    /// Measures the direct current and refuses one that does not follow its command.
    async fn measure_bias(&mut self) -> Result<(), ExecuteError> {
        let (met_a, sigma_a) = self.record_current().await?;
        let commanded_a = self.rig.driving.bias.commanded_a;
        let (share, least_a) = FOLLOWS;
        let allowed_a = share * commanded_a.abs() + least_a + CERTAIN * sigma_a;
        if (met_a - commanded_a).abs() > allowed_a {
            let disobeyed = Err(ExecuteError::Disobeyed {
                what: "direct current by the shunt".to_owned(),
                expected: format!("{commanded_a} within {allowed_a:.3}"),
                met: format!("{met_a:.3}: adjust wiring.command_trim"),
            });
            return self.rig.explained(disobeyed).await;
        }
        let now_s = self.rig.clock.now();
        let bias = &mut self.rig.driving.bias;
        bias.met.base_a = met_a;
        bias.met.sigma_a = sigma_a;
        bias.meet(now_s, met_a);
        let text = format!("direct current {commanded_a:+}: {met_a:+.4} ± {sigma_a:.4}");
        Ok(self.rig.recorder.event(Event::Check, &text)?)
    }

    /// Sets the ranges of the sinusoids with the means of the channels in their centres, and records
    /// the channels on them: a direct current that starts with a sinusoid shows as a change.
    async fn centre_on_bias(&mut self, amplitude_a: Amps) -> Result<(), ExecuteError> {
        let means_v = self.record_means().await?;
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        let scales = self.rig.setup.wiring.scale_per_ampere_v;
        let per_div_v = scales.map(|scale_v| Volts(scale_v * amplitude_a.value()));
        self.scope.centre_on(per_div_v, means_v, &scope);
        self.scope.trigger_at(means_v);
        let waveforms = self.record_steady(Fixture::Cell, RECORD_POINTS).await?;
        self.rig.keep_bias_zero(&waveforms);
        (self.rig.driving.first_mean, self.rig.driving.mean_change_a) = (None, Amps::ZERO);
        Ok(())
    }

    /// Returns the direct current since every output was off, A, and its standard deviation.
    async fn record_current(&mut self) -> Result<(Amps, Amps), ExecuteError> {
        let means_v = self.record_means().await?;
        let off_v = self.rig.driving.bias.off_v.unwrap_or([Volts::NAN; 4]);
        let changed_v = [0, 1, 2, 3].map(|slot: usize| means_v[slot] - off_v[slot]);
        let correction = &self.known.correction;
        let (current_a, _) = correction.direct(changed_v.map(Volts::value));
        let gain_sigma = if correction.reduced_chi2.is_some() {
            GAIN_SIGMA.0
        } else {
            GAIN_SIGMA.1
        };
        let gains_a = gain_sigma * changed_v[0].value().hypot(changed_v[1].value())
            / self.rig.setup.wiring.shunt.r_ohm;
        if !current_a.is_finite() {
            return Err(ExecuteError::Disobeyed {
                what: "direct current by the shunt".to_owned(),
                expected: "a record of the channels with every output off before".to_owned(),
                met: "none".to_owned(),
            });
        }
        Ok((Amps(current_a), Amps(gains_a.hypot(MEAN_SIGMA_A.value()))))
    }

    /// Records the channels on ranges that hold the direct current and a sinusoid; returns their
    /// means, V.
    async fn record_means(&mut self) -> Result<[Volts; 4], ExecuteError> {
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        let range_a = self.rig.driving.bias.range_a;
        self.first_ranges(Fixture::Cell, range_a, &scope).await?;
        let waveforms = self.record_steady(Fixture::Cell, RECORD_POINTS).await?;
        if let Some(waveform) = waveforms
            .iter()
            .find(|waveform| waveform.clipped_share() > 0.0)
        {
            let per_div_v = waveform.preamble.volts_per_div;
            return Err(ExecuteError::Disobeyed {
                what: format!("channel {} at a direct current", waveform.channel),
                expected: format!("a signal within its range at {per_div_v} V/div"),
                met: "one that clips: expected a coarser wiring.scale_per_ampere".to_owned(),
            });
        }
        let means_v: Vec<Volts> = waveforms
            .iter()
            .map(|waveform| Volts(mean(&channel_volts(waveform))))
            .collect();
        means_v.try_into().map_err(|_| ExecuteError::Signal {
            freq_hz: Hertz::ZERO,
            reason: "not four channels".to_owned(),
        })
    }

    /// Brings back the charge that the direct current has moved.
    pub(super) async fn recharge(&mut self, plan: &Recharge) -> Result<(), ExecuteError> {
        let moved_coulomb = self.moved_coulomb();
        if moved_coulomb.abs() <= plan.within_coulomb {
            return Ok(());
        }
        if moved_coulomb.value() * plan.current_a.value() > 0.0 {
            return Err(not_back(plan, moved_coulomb));
        }
        let most_a = plan
            .current_a
            .abs()
            .min(moved_coulomb.abs() / SHORTEST_RECHARGE_S);
        let current_a = Amps(most_a.value().copysign(plan.current_a.value()));
        self.cancel_zero().await?;
        self.rig.ramp(current_a).await?;
        self.rig.hold(RECHARGE_SETTLE_S).await?;
        self.measure_bias().await?;
        let down_coulomb = self.ramp_down_coulomb();
        let left_s = -(self.moved_coulomb() + down_coulomb) / self.rig.driving.bias.met.current_a;
        if left_s > plan.max_s {
            return Err(ExecuteError::Bound {
                step: plan.to_string(),
                max_s: plan.max_s,
                state: format!("{left_s:.0} are needed at {current_a:.3}"),
            });
        }
        self.rig.hold(left_s.max(Seconds::ZERO)).await?;
        self.rig.ramp(Amps::ZERO).await?;
        let left_coulomb = self.moved_coulomb();
        let text = format!(
            "charge moved by the direct current: {moved_coulomb:+.1}, {left_coulomb:+.2} after \
            its return"
        );
        self.rig.recorder.event(Event::Check, &text)?;
        if left_coulomb.abs() <= plan.within_coulomb {
            Ok(())
        } else {
            Err(not_back(plan, left_coulomb))
        }
    }

    /// Returns the charge that a direct current has moved up to now, C.
    pub(super) fn moved_coulomb(&self) -> Coulombs {
        self.rig.driving.bias.moved_coulomb(self.rig.clock.now())
    }

    /// Returns the charge that the ramp from the present direct current to zero moves, C.
    fn ramp_down_coulomb(&self) -> Coulombs {
        let (current_a, steps) = (
            self.rig.driving.bias.met.current_a,
            ramp_steps(self.rig.driving.bias.commanded_a, Amps::ZERO),
        );
        // Each step takes a reading, too.
        let step_s = RAMP_STEP_S + self.rig.watching.read_s;
        0.5 * current_a * step_s * (steps as f64 - 1.0)
    }

    /// Ramps up again after a pause, if a direct current was in force at a step.
    pub(super) async fn resume_bias(&mut self, before: &[Step]) -> Result<(), ExecuteError> {
        let last = before.iter().rev().find_map(|step| match step {
            Step::Bias(bias) => Some(*bias),
            _ => None,
        });
        let Some(bias) = last.filter(|bias| bias.to_a != Amps::ZERO) else {
            return Ok(());
        };
        let step = Step::Bias(Bias {
            from_a: Amps::ZERO,
            ..bias
        });
        self.rig.begin(Fixture::Cell, &step);
        if let Step::Bias(bias) = step {
            self.bias(&bias).await?;
        }
        Ok(())
    }

    /// Refuses to measure a point while another direct current is in force than the plan states.
    pub(super) fn check_bias(&self, planned_a: Amps) -> Result<(), ExecuteError> {
        let commanded_a = self.rig.driving.bias.commanded_a;
        if commanded_a == planned_a {
            return Ok(());
        }
        Err(ExecuteError::Disobeyed {
            what: "direct current under a point".to_owned(),
            expected: format!("{planned_a}"),
            met: format!("{commanded_a} as commanded"),
        })
    }

    /// Reports the charge that a sweep leaves in the cell, or misses, because it ended early.
    pub(super) fn report_moved_charge(&mut self) {
        let moved_coulomb = self.moved_coulomb();
        if self.rig.driving.bias.off_v.is_some() && moved_coulomb != Coulombs::ZERO {
            self.rig.recorder.warning(&format!(
                "the direct current of the sweep has moved {moved_coulomb:+.1}, which were not \
                brought back"
            ));
        }
    }
}

fn not_back(plan: &Recharge, left_coulomb: Coulombs) -> ExecuteError {
    ExecuteError::Disobeyed {
        what: "recharge".to_owned(),
        expected: format!("the charge back within {:.1} C", plan.within_coulomb.0),
        met: format!("{left_coulomb:+.1}"),
    }
}
