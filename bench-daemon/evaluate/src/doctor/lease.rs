//! Checks that the guardian switches off when the daemon hangs. Another process takes the bench,
//! switches the output on at zero current, and stops itself.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use instruments::{
    clock::Clock,
    fixture::Fixture,
    supply4q,
    transport::MemoryHub,
    units::{Amps, Volts},
};
use nix::sys::signal::{Signal, raise};

use super::{Findings, Texts, Verdict, live::LIMITS};
use bench_core::{
    bench::{Bench, BenchError, Connections},
    operator::progress::Progress,
    safety::bench_lease::BenchLease,
    safety::failure::Failure,
    safety::guardian::Charge,
    safety::state::State,
};
use bench_plan::{config, plan::Plan, support::terminal::say};

/// Message of the other process.
const ON: &str = "on";
/// Time that the guardian has for switching off after the lease, s.
const PATIENCE_S: f64 = 60.0;
const POLL_S: f64 = 0.2;

/// Checks the lease; no other process may hold the bench or be connected to it. `folder` is the
/// folder of the report.
pub async fn lease(
    findings: &mut Findings,
    config: &config::Bench,
    clock: &Clock,
    folder: &Path,
    fixture: Fixture,
) {
    let id = "guardian.lease";
    let expected = format!(
        "everything off after {} s of silence of the daemon",
        config.guardian.lease_s.0
    );
    let advice = "do not leave the bench alone: nothing would switch it off when the daemon dies; \
    see guardian.log in the state folder";
    match drill(config, clock, folder, fixture).await {
        Ok(took_s) => {
            let met = format!("off and read back {took_s:.1} s after the guardian stepped in");
            findings.judge(id, Texts { expected, met }, true, "");
        }
        Err(reason) => {
            findings.add(
                id,
                Texts {
                    expected,
                    met: reason,
                },
                Verdict::Fail,
                advice,
            );
            findings.stop();
        }
    }
}

async fn drill(
    config: &config::Bench,
    clock: &Clock,
    folder: &Path,
    fixture: Fixture,
) -> Result<f64, String> {
    let state = State::of(config)
        .map_err(|error| error.to_string())?
        .ok_or("the bench is simulated in this process")?;
    let mut child = start(config, folder, fixture)
        .map_err(|error| format!("the other process cannot be started: {error}"))?;
    let message = child
        .stdout
        .take()
        .and_then(|out| BufReader::new(out).lines().next())
        .and_then(Result::ok);
    let outcome = if message.as_deref() == Some(ON) {
        switched_off(&state, clock, config.guardian.lease_s.0).await
    } else {
        Err(format!(
            "the other process did not come as far as to hang: {}",
            message.unwrap_or_default()
        ))
    };
    // The process is dead by now or no longer needed; without it its guardian switches off.
    let _ = child.kill();
    let _ = child.wait();
    let took_s = outcome?;
    look(config, clock).await?;
    Ok(took_s)
}

fn start(config: &config::Bench, folder: &Path, fixture: Fixture) -> std::io::Result<Child> {
    Command::new("/proc/self/exe")
        .arg("doctor")
        .arg(&config.path)
        .args([
            "--yes",
            "--hang",
            "--fixture",
            bench_plan::plan::fixture_name(fixture),
        ])
        .arg("--out")
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
}

/// Waits for the guardian's report; returns the time that it took.
async fn switched_off(state: &State, clock: &Clock, lease_s: f64) -> Result<f64, String> {
    let end_s = clock.machine_s() + lease_s + PATIENCE_S;
    let mut last = serde_json::Value::Null;
    while clock.machine_s() < end_s {
        let text = std::fs::read_to_string(state.path("guardian.json")).unwrap_or_default();
        last = serde_json::from_str(&text).unwrap_or_default();
        if last["status"] == "verified" {
            return last["took_s"]
                .as_f64()
                .ok_or_else(|| "the guardian does not say how long it took".to_owned());
        }
        clock.sleep_s(POLL_S).await;
    }
    Err(format!(
        "the guardian is {}",
        last["status"].as_str().unwrap_or("not there")
    ))
}

/// Queries every output that can move charge, without changing anything.
async fn look(config: &config::Bench, clock: &Clock) -> Result<(), String> {
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: std::collections::BTreeMap::new(),
    };
    let mut bench = Bench::unconnected(config, &connections).map_err(|error| error.to_string())?;
    bench.connect().await.map_err(|error| error.to_string())?;
    let error = bench.error("supply4q");
    if let Some(supply) = bench.instruments.supply4q.as_mut() {
        let answers = supply
            .look()
            .await
            .map_err(|source| error(source).to_string())?;
        if let Some(answer) = answers.iter().find(|answer| !answer.as_scripted) {
            return Err(format!(
                "supply4q: {} says {} after the guardian had reported that all is off",
                answer.question, answer.answer
            ));
        }
    }
    for (_, read) in bench.read_back().await {
        let (_, amps) = read.map_err(|error| error.to_string())?;
        if amps.abs() > bench_plan::interlock::NO_CURRENT_A {
            return Err(format!("{amps:.3} still flow"));
        }
    }
    Ok(())
}

/// Runs the other process of the check: takes the bench, switches the output on at zero current,
/// reports this, and stops itself.
///
/// # Errors
/// Fails if any of these steps fails.
pub async fn hold(
    config: &config::Bench,
    sha256: String,
    clock: &Clock,
    folder: &Path,
) -> Result<(), Failure> {
    let progress = Progress::new(&Plan { stages: Vec::new() });
    let charge = Charge {
        bench: config,
        run: folder,
        window_v: super::COPPER_WINDOW_V,
        cell_degc: None,
        sha256,
    };
    let lease = BenchLease::take_for(&charge, [clock, clock], progress.doing()).await?;
    let connections = Connections {
        clock: clock.clone(),
        hub: MemoryHub::new(),
        taps: std::collections::BTreeMap::new(),
    };
    let mut bench = Bench::open(config, &connections).await?;
    bench.identify_strictly().await?;
    let on = output_on(config, &mut bench).await;
    if on.is_ok() {
        say!("{ON}");
        let _ = raise(Signal::SIGSTOP);
    }
    // The process gets here only if it could not switch on, or if it was resumed.
    let safe = bench.made_safe().await;
    let read = bench.close();
    let outcome = on.map_err(Failure::from);
    lease
        .end(safe.map_err(Failure::from).and(outcome), read)
        .await
}

async fn output_on(config: &config::Bench, bench: &mut Bench) -> Result<(), BenchError> {
    let (error, of_supply) = (bench.error("generator"), bench.error("supply4q"));
    let generator = bench
        .instruments
        .generator
        .as_mut()
        .ok_or(BenchError::Missing { role: "generator" })?;
    generator.output(false).await.map_err(&error)?;
    generator
        .quiet(config.wiring.command_offset_v)
        .await
        .map_err(&error)?;
    generator.output(true).await.map_err(&error)?;
    let supply = bench
        .instruments
        .supply4q
        .as_mut()
        .ok_or(BenchError::Missing { role: "supply4q" })?;
    let limits = supply4q::Limits {
        compliance: Volts(LIMITS.0),
        current: Amps(LIMITS.1),
    };
    supply.prepare(&limits).await.map_err(&of_supply)?;
    supply.energise().await.map_err(of_supply)
}
