//! Checks that need a current: on copper in the place of the cell, at most half an ampere, around
//! zero.

use analysis::{
    calibration::{KnownImpedance, Priors},
    sine::{self, Channel, FitOptions, Record},
    spectrum::ChannelPhasors,
};
use instruments::{
    fixture::Fixture,
    generator::Sine,
    scope::Waveform,
    supply::Charge,
    supply4q::{self, Holds},
    units::{Amps, Hertz, Volts},
};

use super::{
    Examination, Texts, Verdict,
    probes::{KnownResistance, Loop},
    scope::Level,
    steps::{self, Step},
};
use crate::doctor::fixture_check;
use bench_core::{bench::BenchError, record::code_scale};
use bench_plan::interlock::NO_CURRENT_A;

/// Compliance voltage and current that are programmed into the bipolar supply.
pub(super) const LIMITS: (f64, f64) = (2.0, 1.0);
/// The current of the first touch and of the test, A.
const FIRST_A: f64 = 0.05;
const TEST_A: f64 = 0.5;
/// Currents of the supply with its command at zero, A: the first is worth a remark, the second is
/// the limit.
const ZERO_A: (f64, f64) = (0.05, 0.2);
/// Greatest current of the first test, A: ten times the expected one.
const FIRST_MOST_A: f64 = 0.5;
/// Voltage below which a control stays with every output off, V.
const COPPER_V: f64 = 0.2;
/// Wait after each change of the command, s, and number of readings in a mean.
const SETTLE_S: f64 = 0.3;
const READINGS: usize = 5;
/// Greatest offset and noise of a channel without signal, divisions.
const OFFSET_DIV: f64 = 1.0;
const NOISE_DIV: f64 = 0.05;
/// Frequency of the sine, Hz, and greatest relative deviation that the scope may find.
const SINE_HZ: f64 = 10.0;
const TIMEBASE: f64 = 2.0e-3;
/// Accuracy of a limit, as a share and in A.
const KEPT: (f64, f64) = (0.1, 0.03);
/// Limit of the bipolar supply's current, and the commanded current that exceeds it, A.
const AGAINST: (f64, f64) = (0.1, 0.3);

/// Means of the readings of all meters.
#[derive(Debug, Clone, Copy)]
struct MeterMeans {
    amps: f64,
    volts: f64,
    load_v: Option<f64>,
    levels: [Level; 4],
}

impl Examination<'_> {
    pub(super) async fn live(&mut self, fixture: Fixture) -> Result<(), BenchError> {
        if !self.no_cell().await? || !self.zero().await? || !self.first().await? {
            self.findings.stop();
            return Ok(());
        }
        if self.step(fixture).await? {
            self.sine().await?;
        } else {
            self.findings.stop();
            return Ok(());
        }
        self.bipolar_limit().await?;
        self.charger_limit().await?;
        self.safe().await
    }

    /// Checks that the jig has no voltage before anything else: a bar across a cell is a dead
    /// short.
    async fn no_cell(&mut self) -> Result<bool, BenchError> {
        let error = self.bench.error("load");
        if let Some(load) = self.bench.instruments.load.as_mut() {
            load.watch().await.map_err(error)?;
        }
        let volts = self.jig_v().await?;
        self.zero_v = self
            .frame()
            .await?
            .each_ref()
            .map(|waveform| Level::of(waveform).mean_v);
        let texts = Texts {
            expected: format!("less than {COPPER_V} V at the jig with every output off"),
            met: format!("{volts:.3} V"),
        };
        // A reading that is not a number is refused, too.
        let advice =
            "take the cell out of the jig: the control belongs in its place, never beside it";
        Ok(self
            .findings
            .judge("fixture.no_cell", texts, volts.abs() <= COPPER_V, advice))
    }

    async fn jig_v(&mut self) -> Result<f64, BenchError> {
        let error = self.bench.error("load");
        if let Some(load) = self.bench.instruments.load.as_mut() {
            return Ok(load.measure().await.map_err(error)?.0.value());
        }
        Ok(self
            .supply4q()?
            .measure()
            .await
            .map_err(self.bench.error("supply4q"))?
            .0
            .value())
    }

    /// Switches the output on at zero, and checks the current and the channels.
    async fn zero(&mut self) -> Result<bool, BenchError> {
        self.up(LIMITS.1).await?;
        let seen = self.see().await?;
        let off = seen.amps.abs();
        let volts_per_amp = self.volts_per_amp()?;
        let offset = self.config.wiring.command_offset_v - Volts(seen.amps * volts_per_amp);
        let advice = format!(
            "wiring.command_offset = \"{:.0} mV\" would bring it to zero",
            1.0e3 * offset.value()
        );
        let verdict = if off <= ZERO_A.0 {
            Verdict::Ok
        } else if off <= ZERO_A.1 {
            Verdict::Warn
        } else {
            Verdict::Fail
        };
        let advice = if verdict == Verdict::Ok {
            String::new()
        } else {
            advice
        };
        let texts = Texts {
            expected: format!("less than {} A with the command at zero", ZERO_A.0),
            met: format!("{:+.4} A", seen.amps),
        };
        self.findings.add("zero.current", texts, verdict, &advice);
        self.channels(&seen.levels);
        Ok(verdict != Verdict::Fail)
    }

    fn channels(&mut self, levels: &[Level; 4]) {
        let micro = |of: fn(&Level) -> f64| {
            levels
                .iter()
                .map(|level| format!("{:.0}", 1.0e6 * of(level)))
                .collect::<Vec<_>>()
                .join(", ")
        };
        let channels = |odd: fn(&Level) -> bool| -> Vec<String> {
            levels
                .iter()
                .zip(1..)
                .filter(|(level, _)| odd(level))
                .map(|(_, number)| format!("C{number}"))
                .collect()
        };
        let dead = channels(|level| level.sigma_v <= 0.0);
        let loud = channels(|level| level.sigma_v > NOISE_DIV * level.per_div_v);
        let texts = Texts {
            expected: format!("some, and below {NOISE_DIV} divisions rms"),
            met: format!("{} µV of C1 … C4", micro(|level| level.sigma_v)),
        };
        let (good, advice) = if dead.is_empty() {
            (
                loud.is_empty(),
                format!(
                    "{}: a loose ground, or mains: look at the leads and where they run",
                    loud.join(", ")
                ),
            )
        } else {
            (
                false,
                format!(
                    "{}: not a single code of noise: the channel is off, frozen, or its lead is \
                    not plugged in",
                    dead.join(", ")
                ),
            )
        };
        self.findings.judge("scope.noise", texts, good, &advice);
        let far = channels(|level| level.mean_v.abs() > OFFSET_DIV * level.per_div_v);
        let texts = Texts {
            expected: format!("within {OFFSET_DIV} divisions of zero"),
            met: format!("{} µV of C1 … C4", micro(|level| level.mean_v)),
        };
        let advice = format!(
            "{}: let the scope adjust itself (self-calibration) and look at the lead",
            far.join(", ")
        );
        self.findings
            .judge("scope.offset", texts, far.is_empty(), &advice);
    }

    /// Starts with a small current: with a gain that is ten times too large, half an ampere would
    /// be five.
    async fn first(&mut self) -> Result<bool, BenchError> {
        let before = self.see().await?;
        self.command(FIRST_A).await?;
        let after = self.see().await?;
        self.command(0.0).await?;
        let by_meter = (after.amps - before.amps).abs();
        let [first, second, ..] =
            [0, 1, 2, 3].map(|slot| after.levels[slot].mean_v - before.levels[slot].mean_v);
        let by_shunt = (second - first).abs() / self.config.wiring.shunt.r_ohm;
        let texts = Texts {
            expected: format!("at most {FIRST_MOST_A} A for a command of {FIRST_A} A"),
            met: format!("{by_meter:.3} A by the ammeter, {by_shunt:.3} A by the shunt"),
        };
        let advice = "the drive is far too strong: check model and range of the supply, and the \
        factor of the generator";
        // A probe with a wrong factor makes a small current appear large; two probes that agree
        // are trusted.
        Ok(self.findings.judge(
            "drive.first",
            texts,
            by_meter <= FIRST_MOST_A && by_shunt.min(by_meter * 10.0) <= FIRST_MOST_A,
            advice,
        ))
    }

    async fn step(&mut self, fixture: Fixture) -> Result<bool, BenchError> {
        self.command(TEST_A).await?;
        let up = self.see().await?;
        self.command(-TEST_A).await?;
        let down = self.see().await?;
        self.command(0.0).await?;
        let step = Step {
            wanted_a: 2.0 * TEST_A,
            ammeter_a: up.amps - down.amps,
            supply_v: up.volts - down.volts,
            load_v: up.load_v.zip(down.load_v).map(|(up, down)| up - down),
            channels_v: [0, 1, 2, 3].map(|slot| up.levels[slot].mean_v - down.levels[slot].mean_v),
            trim: self.config.wiring.command_trim,
        };
        let known = |known: KnownImpedance| KnownResistance {
            ohm: known.r_ohm,
            sigma_ohm: known.r_sigma_ohm,
        };
        let circuit = Loop {
            fixture,
            shunt: known(self.config.wiring.shunt),
            control: known(fixture_check::known(self.config, fixture)),
            gain_sigma: Priors::default().gain_sigma,
        };
        Ok(steps::judge(&mut self.findings, &circuit, &step))
    }

    async fn sine(&mut self) -> Result<(), BenchError> {
        let amplitude = Volts(TEST_A * self.volts_per_amp()?);
        let sine = Sine {
            freq: Hertz(SINE_HZ),
            amplitude,
            offset: self.config.wiring.command_offset_v,
        };
        let error = self.bench.error("generator");
        self.generator()?.sine(&sine).await.map_err(error)?;
        self.clock.sleep_s(SETTLE_S).await;
        let waveforms = self.frame().await?;
        self.command(0.0).await?;
        let expected = (format!("{TEST_A} A of amplitude"), format!("{SINE_HZ} Hz"));
        let Some((volts, freq_hz)) = fitted(&waveforms) else {
            let advice =
                "no sine is found in the record: look at the generator's function and the cable";
            self.findings.add(
                "drive.sine",
                Texts {
                    expected: expected.0,
                    met: "no sine",
                },
                Verdict::Fail,
                advice,
            );
            return Ok(());
        };
        let amps = volts / self.config.wiring.shunt.r_ohm;
        let advice = "a steady command is followed and a sine is not: the generator's amplitude is \
        of another kind (peak to peak, 50 Ω), or the supply is slow";
        let good = (amps / TEST_A - 1.0).abs() <= 0.15;
        self.findings.judge(
            "drive.sine",
            Texts {
                expected: expected.0,
                met: format!("{amps:.4} A"),
            },
            good,
            advice,
        );
        let good = (freq_hz / SINE_HZ - 1.0).abs() <= TIMEBASE;
        let advice =
            "scope and generator disagree about time: which of them is on an external clock?";
        self.findings.judge(
            "scope.timebase",
            Texts {
                expected: expected.1,
                met: format!("{freq_hz:.4} Hz"),
            },
            good,
            advice,
        );
        Ok(())
    }

    /// Checks whether the supply's own limit applies while the analog input commands the current,
    /// which no manual guarantees.
    async fn bipolar_limit(&mut self) -> Result<(), BenchError> {
        let id = "limit.bipolar";
        if self.supply4q()?.capabilities().holds != Holds::CurrentAndVoltage {
            self.findings.skip(
                &[id],
                "this model has no limit of the current beside its rating",
                "nothing but a fuse bounds it",
            );
            return Ok(());
        }
        let (limit_a, command_a) = AGAINST;
        self.up(limit_a).await?;
        self.command(command_a).await?;
        let amps = self.see().await?.amps;
        self.down().await?;
        let kept = amps.abs() <= limit_a * (1.0 + KEPT.0) + KEPT.1;
        let advice = "the limit does not bound the analog input of this unit: nothing but the \
        plan, the interlock and a fuse bound its current";
        let texts = Texts {
            expected: format!("at most {limit_a} A, against a command of {command_a} A"),
            met: format!("{amps:.3} A"),
        };
        self.findings.add(
            id,
            texts,
            if kept { Verdict::Ok } else { Verdict::Warn },
            if kept { "" } else { advice },
        );
        Ok(())
    }

    async fn charger_limit(&mut self) -> Result<(), BenchError> {
        let id = "limit.charger";
        self.down().await?;
        let error = self.bench.error("supply");
        let Some(supply) = self.bench.instruments.supply.as_mut() else {
            self.findings.skip(&[id], "the bench has no charger", "");
            return Ok(());
        };
        let charge = Charge {
            voltage: Volts(1.0),
            current: Amps(AGAINST.0),
        };
        supply.prepare(&charge).await.map_err(&error)?;
        supply.energise().await.map_err(&error)?;
        self.clock.sleep_s(1.0).await;
        let measured = supply.measure().await;
        supply.safe().await.map_err(&error)?;
        let (volts, amps) = measured.map_err(error)?;
        let met = format!("{:.3} A at {:.3} V", amps.value(), volts.value());
        let expected = format!("{} A into copper, far below 1 V", AGAINST.0);
        let most_a = AGAINST.0 * (1.0 + KEPT.0) + KEPT.1;
        if amps.value() > most_a || volts.value() > 0.9 {
            let advice = "the charger does not keep its current limit, or drives into an open \
            circuit: do not charge a cell with it";
            self.findings
                .judge(id, Texts { expected, met }, false, advice);
            self.findings.stop();
        } else if amps.value() < 0.5 * AGAINST.0 {
            let advice = "its current does not flow: look at its leads to the jig";
            self.findings
                .add(id, Texts { expected, met }, Verdict::Warn, advice);
        } else {
            self.findings.judge(id, Texts { expected, met }, true, "");
        }
        Ok(())
    }

    /// Switches everything off while a current flows, as a run would do it, and then queries each
    /// instrument.
    async fn safe(&mut self) -> Result<(), BenchError> {
        if self.findings.stopped().is_some() {
            return Ok(());
        }
        self.up(LIMITS.1).await?;
        self.command(AGAINST.0).await?;
        let flowed = self.see().await?.amps;
        let safe = self.bench.safe_state().await;
        let mut wrong: Vec<String> = if safe.verified {
            Vec::new()
        } else {
            vec![safe.message]
        };
        macro_rules! look {
            ($role:literal, $field:ident) => {
                let error = self.bench.error($role);
                if let Some(instrument) = self.bench.instruments.$field.as_mut() {
                    let answers = instrument.look().await.map_err(error)?;
                    let other = answers.iter().filter(|answer| !answer.as_scripted);
                    wrong.extend(other.map(|answer| {
                        format!("{}: {} says {}", $role, answer.question, answer.answer)
                    }));
                }
            };
        }
        look!("supply4q", supply4q);
        look!("generator", generator);
        look!("load", load);
        look!("supply", supply);
        let levels = self.frame().await?.each_ref().map(Level::of);
        let shunt_a = (levels[1].mean_v - self.zero_v[1] - levels[0].mean_v + self.zero_v[0])
            / self.config.wiring.shunt.r_ohm;
        if shunt_a.abs() > NO_CURRENT_A.0 {
            wrong.push(format!("the shunt still carries {shunt_a:.3} A"));
        }
        let met = if wrong.is_empty() {
            format!(
                "from {flowed:.3} A to every output off, {:.1} mA by the shunt",
                1.0e3 * shunt_a
            )
        } else {
            wrong.join("; ")
        };
        let advice = "LOOK AT THE BENCH: what is named here did not go off";
        if !self.findings.judge(
            "safe.state",
            Texts {
                expected: "every output off and read back, no current by any meter",
                met,
            },
            wrong.is_empty(),
            advice,
        ) {
            self.findings.stop();
        }
        Ok(())
    }

    /// Switches the bipolar supply on at zero, with a current limit.
    async fn up(&mut self, limit_a: f64) -> Result<(), BenchError> {
        let offset = self.config.wiring.command_offset_v;
        let (error, of_supply) = (self.bench.error("generator"), self.bench.error("supply4q"));
        let generator = self.generator()?;
        generator.output(false).await.map_err(&error)?;
        generator.quiet(offset).await.map_err(&error)?;
        let limits = supply4q::Limits {
            compliance: Volts(LIMITS.0),
            current: Amps(limit_a),
        };
        self.supply4q()?
            .prepare(&limits)
            .await
            .map_err(&of_supply)?;
        self.generator()?.output(true).await.map_err(error)?;
        self.supply4q()?.energise().await.map_err(of_supply)?;
        self.clock.sleep_s(SETTLE_S).await;
        Ok(())
    }

    async fn down(&mut self) -> Result<(), BenchError> {
        self.bench.drive_off().await
    }

    /// Sends a constant command.
    async fn command(&mut self, amps: f64) -> Result<(), BenchError> {
        let offset = self.config.wiring.command_offset_v + Volts(amps * self.volts_per_amp()?);
        let error = self.bench.error("generator");
        self.generator()?.quiet(offset).await.map_err(error)?;
        self.clock.sleep_s(SETTLE_S).await;
        Ok(())
    }

    async fn see(&mut self) -> Result<MeterMeans, BenchError> {
        let levels = self.frame().await?.each_ref().map(Level::of);
        let (mut amps, mut volts, mut load_v) = (0.0, 0.0, 0.0);
        let (of_supply, of_load) = (self.bench.error("supply4q"), self.bench.error("load"));
        for _ in 0..READINGS {
            let (supply_v, supply_a) = self.supply4q()?.measure().await.map_err(&of_supply)?;
            (volts, amps) = (volts + supply_v.value(), amps + supply_a.value());
            if let Some(load) = self.bench.instruments.load.as_mut() {
                load_v += load.measure().await.map_err(&of_load)?.0.value();
            }
        }
        let mean = |sum: f64| sum / READINGS as f64;
        Ok(MeterMeans {
            amps: mean(amps),
            volts: mean(volts),
            load_v: self.bench.instruments.load.is_some().then(|| mean(load_v)),
            levels,
        })
    }

    /// Returns the command per ampere from the bench file, V.
    fn volts_per_amp(&mut self) -> Result<f64, BenchError> {
        self.supply4q()?;
        Ok(self.config.wiring.command_v(Amps(1.0)).0)
    }

    fn supply4q(&mut self) -> Result<&mut instruments::supply4q::Supply4q, BenchError> {
        self.bench
            .instruments
            .supply4q
            .as_mut()
            .ok_or(BenchError::Missing { role: "supply4q" })
    }

    fn generator(&mut self) -> Result<&mut instruments::generator::Generator, BenchError> {
        self.bench
            .instruments
            .generator
            .as_mut()
            .ok_or(BenchError::Missing { role: "generator" })
    }
}

/// Returns the amplitude across the shunt, V, and the frequency of a free fit, Hz.
fn fitted(waveforms: &[Waveform; 4]) -> Option<(f64, f64)> {
    let channels: Vec<Channel<'_>> = waveforms
        .iter()
        .map(|waveform| Channel::codes(&waveform.codes, code_scale(waveform)))
        .collect();
    let record = Record {
        channels: &channels,
        interval_s: waveforms[0].interval_s,
    };
    let options = FitOptions::default();
    let free = sine::fit_free_frequency(&record, Some(SINE_HZ), &options).ok()?;
    let fit = sine::fit_known_frequency(&record, SINE_HZ, &options).ok()?;
    let lsb_v = [0, 1, 2, 3].map(|slot: usize| {
        f64::from(waveforms[slot].preamble.code_step) * waveforms[slot].preamble.volts_per_code
    });
    let [first, second, ..] = ChannelPhasors::from_codes(&fit, lsb_v).ok()?.volts;
    Some(((second - first).norm(), free.freq_hz))
}
