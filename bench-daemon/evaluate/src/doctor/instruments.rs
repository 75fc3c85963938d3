//! Checks with every output off: which instruments answer, whether limits are accepted and read
//! back, and whether the thermometers are plausible.

use instruments::{
    load::{Discharge, Draw},
    supply::Charge,
    supply4q,
    units::{Amps, Celsius, Volts},
};

use super::{Examination, Findings, Texts, Verdict, live::LIMITS};
use bench_core::{bench::BenchError, bench::survey::InstrumentReport};

/// Plausible temperatures of a laboratory, °C, and the greatest difference between two
/// thermometers at rest, K.
const ROOM_C: (f64, f64) = (-20.0, 80.0);
const APART_K: f64 = 10.0;

/// Records the answer of one instrument, or why it did not answer.
pub fn reached(
    findings: &mut Findings,
    role: &str,
    report: Result<&InstrumentReport, String>,
    model: &str,
) -> bool {
    let id = format!("reach.{role}");
    let expected = format!("a {model}");
    match report {
        Err(error) => {
            let advice = "check that it is switched on, that its address is right, and that no \
            other client is connected to it";
            findings.judge(
                &id,
                Texts {
                    expected,
                    met: error,
                },
                false,
                advice,
            )
        }
        Ok(report) if !report.recognised => {
            let advice = "check model and address in the bench file; `eis-bench identify` lists \
            the dialects that could be forced";
            findings.judge(
                &id,
                Texts {
                    expected,
                    met: report.identity.raw.clone(),
                },
                false,
                advice,
            )
        }
        Ok(report) => {
            let healthy = report.health.is_empty();
            let met = if healthy {
                report.identity.raw.clone()
            } else {
                format!("{}; {}", report.identity.raw, report.health.join("; "))
            };
            let verdict = if healthy { Verdict::Ok } else { Verdict::Warn };
            let advice = if healthy {
                ""
            } else {
                "what was in its error queue is gone by now; look at its panel"
            };
            findings.add(&id, Texts { expected, met }, verdict, advice);
            true
        }
    }
}

impl Examination<'_> {
    /// Switches everything off, then checks limits and thermometers.
    pub(super) async fn off(&mut self) -> Result<(), BenchError> {
        let safe = self.bench.safe_state().await;
        let met = if safe.verified && !self.bench.is_unswitched() {
            "every output off and read back, no current".to_owned()
        } else {
            safe.message
        };
        let advice = "LOOK AT THE BENCH: switch off by hand what this names";
        if !self.findings.judge(
            "safe.begin",
            Texts {
                expected: "every output off and read back, no current",
                met,
            },
            safe.verified,
            advice,
        ) {
            self.findings.stop();
            return Ok(());
        }
        self.limits().await;
        self.thermometers().await?;
        self.chiller().await
    }

    /// Sets the set-point to the temperature of the bath, starts the bath and stops it again: in
    /// manual mode this family ignores commands without an error.
    async fn chiller(&mut self) -> Result<(), BenchError> {
        let (id, expected) = (
            "chiller.obeys",
            "a set-point, a start and a stop, each read back",
        );
        let error = self.bench.error("chiller");
        let Some(chiller) = self.bench.instruments.chiller.as_mut() else {
            return Ok(());
        };
        if chiller.status().await.map_err(&error)?.running && !chiller.is_regulated() {
            self.findings
                .skip(&[id], "it runs already, and is left alone", "");
            return Ok(());
        }
        let (least, greatest) = chiller.range();
        let bath = chiller.temperature().await.map_err(&error)?.value();
        let setpoint = Celsius(bath.clamp(least.value(), greatest.value()).round());
        let obeyed = chiller.start(setpoint).await;
        let stopped = chiller.stop().await;
        let good = obeyed.is_ok() && stopped.is_ok();
        let met = obeyed.and(stopped).map_or_else(
            |error| error.to_string(),
            |()| format!("at {:.0} °C, the bath at {bath:.2} °C", setpoint.value()),
        );
        self.findings.judge(
            id,
            Texts { expected, met },
            good,
            "set it to remote control on its panel, and clear its alarm",
        );
        Ok(())
    }

    async fn limits(&mut self) {
        let mut taken = Vec::new();
        if let Some(supply) = self.bench.instruments.supply4q.as_mut() {
            let limits = supply4q::Limits {
                compliance: Volts(LIMITS.0),
                current: Amps(LIMITS.1),
            };
            taken.push((
                "limits.supply4q",
                format!("{} V and {} A", LIMITS.0, LIMITS.1),
                supply.prepare(&limits).await,
            ));
        }
        if let Some(load) = self.bench.instruments.load.as_mut() {
            let discharge = Discharge {
                draw: Draw::Current(Amps(0.1)),
                stop_below: Volts(2.5),
            };
            taken.push((
                "limits.load",
                "0.1 A, none below 2.5 V".to_owned(),
                load.prepare(&discharge).await,
            ));
        }
        if let Some(supply) = self.bench.instruments.supply.as_mut() {
            let charge = Charge {
                voltage: Volts(1.0),
                current: Amps(0.1),
            };
            taken.push((
                "limits.supply",
                "1 V and 0.1 A".to_owned(),
                supply.prepare(&charge).await,
            ));
        }
        for (id, limits, outcome) in taken {
            let good = outcome.is_ok();
            let met = outcome.map_or_else(
                |error| error.to_string(),
                |()| "taken and read back".to_owned(),
            );
            if !self.findings.judge(
                id,
                Texts {
                    expected: limits,
                    met,
                },
                good,
                "no output is switched on without its limits: find out why they are not accepted",
            ) {
                self.findings.stop();
            }
        }
    }

    async fn thermometers(&mut self) -> Result<(), BenchError> {
        let mut found: Vec<(&str, f64)> = Vec::new();
        let error = self.bench.error("logger");
        if let Some(logger) = self.bench.instruments.logger.as_mut() {
            logger.configure().await.map_err(&error)?;
            let readings = logger.scan().await.map_err(error)?;
            let celsius = readings
                .iter()
                .map(|reading| reading.map_or(f64::NAN, |celsius| celsius.value()));
            found.extend(["cell", "ambient"].into_iter().zip(celsius));
        }
        let error = self.bench.error("chiller");
        if let Some(chiller) = self.bench.instruments.chiller.as_mut() {
            found.push(("bath", chiller.temperature().await.map_err(error)?.value()));
        }
        if found.is_empty() {
            self.findings.skip(
                &["meters.thermometers"],
                "the bench has none",
                "without a logger nothing watches the cell's temperature",
            );
            return Ok(());
        }
        let met: Vec<String> = found
            .iter()
            .map(|(name, celsius)| format!("{name} {celsius:.1} °C"))
            .collect();
        let odd: Vec<&str> = found
            .iter()
            .filter(|(_, c)| !(ROOM_C.0..=ROOM_C.1).contains(c))
            .map(|(name, _)| *name)
            .collect();
        let (least, most) = found
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (_, c)| {
                (a.min(*c), b.max(*c))
            });
        let (verdict, advice) = if !odd.is_empty() {
            (
                Verdict::Fail,
                format!(
                    "no temperature of a laboratory at {}: an open thermocouple, or a wrong \
                    channel",
                    odd.join(", ")
                ),
            )
        } else if most - least > APART_K {
            (
                Verdict::Warn,
                "they are far apart for a bench at rest: is each where it belongs?".to_owned(),
            )
        } else {
            (Verdict::Ok, String::new())
        };
        let expected = format!(
            "{} °C to {} °C, at most {APART_K} K apart",
            ROOM_C.0, ROOM_C.1
        );
        self.findings.add(
            "meters.thermometers",
            Texts {
                expected,
                met: met.join(", "),
            },
            verdict,
            &advice,
        );
        Ok(())
    }
}
