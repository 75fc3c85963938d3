//! Signals that end on their own: the generator receives the number of periods that a step needs,
//! and then stays at its offset, even if no message can reach it any more. If the model has no
//! bursts or does not execute the command, only the daemon and the guardian can end the signal.

mod state;

use instruments::{
    link::LinkError,
    units::{Hertz, Seconds},
};

use super::{ExecuteError, Rig, require};

use crate::clock::TypedClock;
pub(super) use state::Burst;

/// Time after which a supply follows its command and its reading shows it, s; the clocks of a
/// burst of one hour differ by less.
const FADES_S: Seconds = Seconds(1.0);
/// Factor by which a burst that was too short is lengthened.
const LONGER: f64 = 2.0;
/// How often a burst is lengthened for one point.
pub(super) const MOST_LONGER: usize = 6;

impl Rig<'_> {
    /// Starts the signal that the generator is set to, for whole periods that last `needed_s` plus
    /// the leeway, if the generator has bursts.
    pub(super) async fn begin_signal(
        &mut self,
        freq_hz: Hertz,
        needed_s: Seconds,
    ) -> Result<(), ExecuteError> {
        self.begin_periods(
            freq_hz,
            ((needed_s + self.driving.burst.leeway_s) * freq_hz).ceil(),
        )
        .await
    }

    /// Starts a burst of this number of periods.
    pub(super) async fn begin_periods(
        &mut self,
        freq_hz: Hertz,
        wanted: f64,
    ) -> Result<(), ExecuteError> {
        let error = self.bench.error("generator");
        let wiring = &self.setup.wiring;
        let generator = require(&mut self.bench.instruments.generator, "generator")?;
        let most = generator.most_periods().filter(|most| {
            wiring.bursts && !self.driving.burst.refused && wanted <= f64::from(*most)
        });
        let periods = most.map(|_| wanted as u32);
        let begun_s = self.clock.now();
        (self.driving.burst.ends_s, self.driving.burst.ended_s) =
            (Seconds::INFINITY, Seconds::INFINITY);
        // The burst begins at its own phase, independently of the previous one.
        self.interlock.lose_period();
        if periods.is_none() && !self.driving.burst.on {
            return Ok(());
        }
        match generator.burst(periods).await {
            Ok(()) => {}
            Err(
                message @ (LinkError::ReadBack { .. }
                | LinkError::ErrorQueue { .. }
                | LinkError::Refused { .. }
                | LinkError::Unexpected { .. }),
            ) if periods.is_some() => {
                generator.burst(None).await.map_err(&error)?;
                self.driving.burst.refused = true;
                let text = format!(
                    "generator: takes no bursts ({message}): its signal ends by the daemon and the \
                    guardian alone"
                );
                self.recorder.warning(&text);
                return Ok(());
            }
            Err(failed) => return Err(error(failed).into()),
        }
        self.driving.burst.on = periods.is_some();
        if let Some(periods) = periods {
            let lasts_s = f64::from(periods) / freq_hz;
            (self.driving.burst.ends_s, self.driving.burst.ended_s) =
                (begun_s + lasts_s, self.clock.now() + lasts_s + FADES_S);
        }
        Ok(())
    }

    /// Leaves the burst mode, in which the generator may ignore a change of its offset.
    pub(super) async fn end_burst(&mut self) -> Result<(), ExecuteError> {
        if self.driving.burst.on {
            let error = self.bench.error("generator");
            let generator = require(&mut self.bench.instruments.generator, "generator")?;
            generator.burst(None).await.map_err(error)?;
        }
        self.no_burst();
        Ok(())
    }

    /// Resets the burst state, because the generator is set to its smallest sine and has no signal
    /// that could end.
    pub(super) fn no_burst(&mut self) {
        (
            self.driving.burst.on,
            self.driving.burst.ends_s,
            self.driving.burst.ended_s,
        ) = (false, Seconds::INFINITY, Seconds::INFINITY);
    }

    /// Checks whether a record that ends at `end_s` would miss a part of the signal. If so, the
    /// next burst is lengthened.
    pub(super) fn falls_short(&mut self, end_s: Seconds) -> bool {
        let short = end_s > self.driving.burst.ends_s;
        if short {
            self.driving.burst.leeway_s = LONGER * self.driving.burst.leeway_s;
        }
        short
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::interlock::Reading;
    use instruments::units::Amps;

    #[test]
    fn a_current_behind_the_end_of_a_burst_is_an_error_and_before_it_is_none() {
        let burst = Burst {
            ends_s: Seconds(100.0),
            ended_s: Seconds(101.0),
            on: true,
            ..Burst::default()
        };
        let under = |burst: &Burst, time_s, amps, steady_a| {
            burst
                .over(
                    &Reading {
                        time_s,
                        current_a: amps,
                        ..Reading::default()
                    },
                    steady_a,
                )
                .map_err(|error| error.to_string())
        };
        let read = |burst: &Burst, time_s, amps| under(burst, time_s, amps, Amps(0.0));
        for (time_s, amps) in [(100.5, Some(1.0)), (103.5, Some(-0.25)), (103.5, None)] {
            assert_eq!(read(&burst, Seconds(time_s), amps.map(Amps)), Ok(()));
        }
        let text = "generator: expected its burst to have ended 2.5 s ago, measured -0.500 A";
        assert_eq!(
            read(&burst, Seconds(103.5), Some(Amps(-0.5))),
            Err(text.to_owned())
        );
        // The burst stays at a direct current of 5 A: its end is no end of the current.
        assert_eq!(
            under(&burst, Seconds(103.5), Some(Amps(5.2)), Amps(5.0)),
            Ok(())
        );
        assert!(under(&burst, Seconds(103.5), Some(Amps(6.0)), Amps(5.0)).is_err());
        assert!(under(&burst, Seconds(103.5), Some(Amps(0.0)), Amps(5.0)).is_err());
        // A signal without an end is not over.
        assert_eq!(
            read(&Burst::default(), Seconds(103.5), Some(Amps(1.0))),
            Ok(())
        );
    }
}
