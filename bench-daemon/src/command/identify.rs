//! `eis-bench identify`: queries which instruments answer at the configured addresses, or at any
//! others, what they can do and what is programmed into them.

mod found;
mod of_bench;
mod single;

use std::path::Path;

use found::IdentifiedInstrument;
use instruments::transport::Address;

use crate::command::printed::say_json;
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{ANALOG, load_any_bench},
    support::terminal::say,
};

/// Arguments of `identify`.
#[derive(Debug, clap::Args)]
pub struct IdentifyArgs {
    /// Bench or experiment files, and addresses of single instruments: `tcp://HOST:PORT`,
    /// `serial:/dev/PORT?baud=9600`.
    #[arg(required = true, value_name = "CONFIG|ADDRESS")]
    pub of: Vec<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Queries each instrument and prints the replies. A silent instrument does not prevent queries
/// of the others. A run, a stop or `safe` ends the queries of a bench.
///
/// # Errors
/// A mistake in a file; a bench that a process runs, whose instruments are not queried; after all
/// queries, an instrument that does not answer or whose model is unknown.
pub fn identify(args: &IdentifyArgs) -> Result<(), Failure> {
    let (mut found, mut unlinked) = (Vec::new(), Vec::new());
    for of in &args.of {
        if Path::new(of).is_file() {
            let bench = load_any_bench(Path::new(of))?;
            found.extend(of_bench::identify(&bench)?);
            unlinked.extend(bench.wiring.analog);
        } else {
            let address = of.parse::<Address>().map_err(|error| {
                Failure::Usage(format!("expected a file or an address: {error}"))
            })?;
            if matches!(address, Address::Memory { .. }) {
                return Err(Failure::Usage(format!(
                    "{address}: a memory: address exists only within a process; give the bench \
                    file of the simulated instruments instead"
                )));
            }
            found.extend(single::identify(&address)?);
        }
    }
    if args.json {
        say_json(&found)?;
    } else {
        found.iter().for_each(print);
        for supply in unlinked {
            say!(
                "supply4q   {ANALOG:<20} no link: {} A/V, rated {} A; the program cannot switch, \
                limit or read it",
                supply.amps_per_volt,
                supply.rated_a.0
            );
        }
    }
    match found.iter().filter(|found| !found.good()).count() {
        0 => Ok(()),
        wrong => {
            let listed: Vec<&str> = found
                .iter()
                .filter(|found| !found.good())
                .map(|found| found.role.unwrap_or(&found.address))
                .collect();
            Err(Failure::Unidentified {
                asked: found.len(),
                wrong,
                listed: listed.join(", "),
            })
        }
    }
}

fn print(found: &IdentifiedInstrument) {
    let IdentifiedInstrument {
        role,
        model,
        address,
        report,
        output,
        failure,
        took_s,
        could_be_forced,
    } = found;
    let (role, model) = (role.unwrap_or("-"), model.as_deref().unwrap_or("unknown"));
    let Some(report) = report else {
        say!(
            "{role:<10} {model:<20} {address:<32} {} ({took_s:.2} s)",
            failure.as_deref().unwrap_or("no answer")
        );
        return;
    };
    let verdict = if report.recognised {
        "ok"
    } else {
        "NOT THE CONFIGURED MODEL"
    };
    let verdict = if report.recognised || model != "unknown" {
        verdict
    } else {
        "NO KNOWN MODEL"
    };
    say!(
        "{role:<10} {model:<20} {address:<32} {}  [{verdict}]",
        report.identity.raw
    );
    for line in could_be_forced {
        say!("    could be tried as  {line}");
    }
    if !report.recognised {
        return;
    }
    let identity = &report.identity;
    let or_none = |text: &str| {
        if text.is_empty() {
            "not reported".to_owned()
        } else {
            text.to_owned()
        }
    };
    say!(
        "    serial number {}, firmware {}; answered within {took_s:.2} s",
        or_none(&identity.serial),
        or_none(&identity.firmware)
    );
    if let Some(output) = output {
        say!("    output    {}", output.in_words());
    }
    if let serde_json::Value::Object(fields) = &report.capabilities {
        let words: Vec<String> = fields
            .iter()
            .map(|(name, value)| format!("{} {value}", name.replace('_', " ")))
            .collect();
        say!("    can       {}", words.join("; "));
    }
    if !report.programmed.is_empty() {
        let words: Vec<String> = report
            .programmed
            .iter()
            .map(|answer| format!("{} {}", answer.question, answer.answer.trim()))
            .collect();
        say!("    programmed {}", words.join("; "));
    }
    let health = if report.health.is_empty() {
        "nothing to complain of".to_owned()
    } else {
        report.health.join("; ")
    };
    say!("    health    {health}");
}
