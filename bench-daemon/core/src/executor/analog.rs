//! A bipolar supply without a link: the program commands it through the generator alone. What its
//! own meters would show, the scope shows: no current at the command of zero, and a step of the
//! command that moves the current by the right amount in the right direction. A supply that is
//! switched off, has another gain or another polarity is found before anything else is driven.

use instruments::{
    fixture::Fixture,
    units::{Amps, Hertz, Ohms, Seconds},
};

use super::{
    ExecuteError, Executor, Rig,
    crest::{difference, mean},
    require,
    state::Level,
};
use crate::record::Event;
use bench_plan::{interlock::NO_CURRENT_A, plan::Depth};

/// Greatest step of the command that tests gain and sign, A; at most half of the limit.
const TEST_A: Amps = Amps(0.25);
/// Greatest relative deviation of the current from this step.
const FOLLOWS: f64 = 0.25;
/// Share of the step below which no current follows it.
const NOTHING: f64 = 0.1;
/// Time after which the supply follows the step, s.
const SETTLE_S: Seconds = Seconds(0.3);
/// Points of a record of a level if the plan states none.
const LEVEL_POINTS: u64 = 10_000;

/// What a person must do with the supply, after the request to change the fixture.
pub(super) const BY_HAND: &str = " The bipolar supply is analog: the program does not switch it. \
The generator commands zero. Switch the supply off at its panel before you reach into the jig, and \
on again before you confirm.";

impl Rig<'_> {
    /// Sets the generator of an analog supply to its zero command and switches its output on. From
    /// then on the output stays on, because without its offset the zero error of the supply would
    /// flow.
    pub(super) async fn hold_zero(&mut self) -> Result<(), ExecuteError> {
        let error = self.bench.error("generator");
        let zero = self.setup.wiring.command_offset_v;
        let generator = require(&mut self.bench.instruments.generator, "generator")?;
        let answers = generator.look().await.map_err(&error)?;
        if answers.iter().all(|answer| answer.as_scripted) {
            // Sets what can be set only while it is off: the assumed load.
            generator.output(false).await.map_err(&error)?;
        }
        generator.quiet(zero).await.map_err(&error)?;
        generator.output(true).await.map_err(&error)?;
        self.no_burst();
        Ok(())
    }
}

impl Executor<'_> {
    /// Checks an analog supply that the generator holds at zero: the scope must show no current,
    /// and a step of the command must be followed. Afterwards the command is zero again.
    pub(super) async fn test_analog(
        &mut self,
        fixture: Fixture,
        limit_a: Amps,
        allowed_a: Amps,
        depth: Option<Depth>,
    ) -> Result<(), ExecuteError> {
        let points = depth.map_or(LEVEL_POINTS, |depth| depth.record_points);
        let step_a = TEST_A.min(0.5 * limit_a);
        self.headroom(fixture, Hertz::ZERO, step_a)?;
        let zero = self.level(fixture, points).await?;
        if zero.amps.abs() > allowed_a + zero.unsure_a {
            return Err(ExecuteError::Disobeyed {
                what: "analog supply with its command at zero".to_owned(),
                expected: format!(
                    "less than {:.3} A by the scope",
                    (allowed_a + zero.unsure_a).0
                ),
                met: format!("{:+.3} A: adjust wiring.command_offset", zero.amps.0),
            });
        }
        self.rig.command(step_a).await?;
        self.rig.wait_watching(SETTLE_S, "idle", fixture).await?;
        let stepped = self.level(fixture, points).await;
        // Whatever was measured, the step ends here.
        self.rig.command(Amps::ZERO).await?;
        self.rig.wait_watching(SETTLE_S, "idle", fixture).await?;
        let moved_a = stepped?.amps - zero.amps;
        followed(step_a, moved_a)?;
        let text = format!(
            "bipolar supply (analog): {step_a:+.3} commanded, {moved_a:+.4} measured by the \
            scope; {:+.3} A ± {:.3} A at the command of zero",
            zero.amps.0, zero.unsure_a.0
        );
        self.rig.recorder.event(Event::Bench, &text)?;
        self.direct.analog_zero = Some(zero);
        self.scope.forget();
        Ok(())
    }

    /// Returns the command to zero and checks by the scope that no current is left.
    pub(super) async fn end_analog(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        self.rig.power_down().await?;
        let Some(zero) = self.direct.analog_zero.take() else {
            return Ok(());
        };
        self.scope.forget();
        let left = self.level(fixture, LEVEL_POINTS).await;
        self.scope.forget();
        let left_a = left?.amps - zero.amps;
        if left_a.abs() <= NO_CURRENT_A {
            return Ok(());
        }
        Err(ExecuteError::Disobeyed {
            what: "analog supply after its command returned to zero".to_owned(),
            expected: format!("less than {NO_CURRENT_A} by the scope"),
            met: format!("{left_a:+.3}: switch it off at its panel"),
        })
    }

    /// Records the shunt at a steady command, on the scales for one ampere.
    async fn level(&mut self, fixture: Fixture, points: u64) -> Result<Level, ExecuteError> {
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            self.first_ranges(fixture, Amps(1.0), &scope).await?;
        }
        let waveforms = self.record_steady(fixture, points).await?;
        let [below, above, ..] = waveforms.as_slice() else {
            return Err(ExecuteError::Signal {
                freq_hz: Hertz::ZERO,
                reason: "not four channels".to_owned(),
            });
        };
        let unsure_v = self.rig.offset_error_v(below) + self.rig.offset_error_v(above);
        let r_ohm = self.rig.setup.wiring.shunt.r_ohm;
        Ok(Level {
            amps: Amps(mean(&difference(above, below)) / r_ohm),
            unsure_a: unsure_v / Ohms(r_ohm),
        })
    }
}

/// Checks that the current followed a step of the command, and names the likely mistake if it did
/// not.
fn followed(step_a: Amps, moved_a: Amps) -> Result<(), ExecuteError> {
    let ratio = moved_a / step_a;
    if (ratio - 1.0).abs() <= FOLLOWS {
        return Ok(());
    }
    let hint = if ratio.abs() < NOTHING {
        "is the supply switched on, in current mode, and its analog input connected to \
        wiring.generator_channel?"
            .to_owned()
    } else if (ratio + 1.0).abs() <= FOLLOWS {
        "the sign of instruments.supply4q.gain is wrong, or the shunt's probes are swapped"
            .to_owned()
    } else {
        format!("instruments.supply4q.gain would have to be {ratio:.3} times as large")
    };
    Err(ExecuteError::Disobeyed {
        what: "analog supply, a step of its command".to_owned(),
        expected: format!("{step_a:+.3} by the scope, within {:.0} %", 100.0 * FOLLOWS),
        met: format!("{moved_a:+.4}: {hint}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_is_not_followed_names_the_likely_mistake() {
        let met = |moved_a: Amps| {
            followed(Amps(0.25), moved_a).map_err(|error| match error {
                ExecuteError::Disobeyed { met, .. } => met,
                other => other.to_string(),
            })
        };
        assert_eq!(
            [met(Amps(0.25)), met(Amps(0.19)), met(Amps(0.31))],
            [Ok(()), Ok(()), Ok(())]
        );
        for (moved_a, hint) in [
            (
                -0.25,
                "-0.2500 A: the sign of instruments.supply4q.gain is wrong",
            ),
            (0.01, "+0.0100 A: is the supply switched on"),
            (
                0.5,
                "+0.5000 A: instruments.supply4q.gain would have to be 2.000 times",
            ),
            (
                -0.5,
                "-0.5000 A: instruments.supply4q.gain would have to be -2.000 times",
            ),
            (f64::NAN, "+NaN A: "),
        ] {
            let text = met(Amps(moved_a)).unwrap_err();
            assert!(text.contains(hint) || moved_a.is_nan(), "{moved_a}: {text}");
        }
    }
}
