//! Attacks on a bench: real processes on real ports, a simulated cell that records what it bears.
//! For each attack one row: charge beyond what the step asked for, worst voltage and temperature,
//! time to zero, exit code, last message, and what a resumed run found.
//!
//! `cargo bench --profile dev -p bench-daemon --bench attacks -- [--program PATH] [--only WORDS]
//! [--out FILE.md]`; another build of the program can stand trial in the same attacks. Fails where
//! more than the envelope of the step flowed for too long, or where a wrong number has no flag.

#![expect(
    clippy::expect_used,
    reason = "a trial that cannot be set up has no row"
)]

mod list;
mod trial;

use std::sync::Mutex;

use list::{Attack, Deed};
use trial::{Row, Usual, stand};

/// Attacks at a time: most of each is waiting.
const AT_A_TIME: usize = 32;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut program, mut only, mut out) = (
        env!("CARGO_BIN_EXE_eis-bench").to_owned(),
        String::new(),
        None,
    );
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--program" => program = words.next().ok_or("--program: expected a path")?,
            "--only" => only = words.next().ok_or("--only: expected a part of a name")?,
            "--out" => out = Some(words.next().ok_or("--out: expected a file")?),
            "--bench" => {}
            other => {
                return Err(format!(
                    "expected --program PATH, --only WORDS or --out FILE, found {other:?}"
                )
                .into());
            }
        }
    }
    let usual = Usual::default();
    let (quiet, attacks): (Vec<Attack>, Vec<Attack>) = list::all()
        .into_iter()
        .partition(|attack| attack.deed == Deed::Nothing);
    let attacks: Vec<Attack> = attacks
        .into_iter()
        .filter(|attack| attack.name().contains(&only))
        .collect();
    let rows = Mutex::new(Vec::new());
    // What nothing does to a run is what the others are compared with.
    for some in [quiet, attacks] {
        let next = Mutex::new(some.iter().enumerate());
        std::thread::scope(|scope| {
            for _ in 0..AT_A_TIME {
                scope.spawn(|| {
                    loop {
                        let Some((number, attack)) =
                            next.lock().ok().and_then(|mut next| next.next())
                        else {
                            return;
                        };
                        let row = stand(&program, attack, &usual);
                        eprintln!("{}", row.line());
                        if let Ok(mut rows) = rows.lock() {
                            rows.push(((attack.deed != Deed::Nothing, number), row));
                        }
                    }
                });
            }
        });
    }
    let mut rows: Vec<((bool, usize), Row)> =
        rows.into_inner().map_err(|_| "a trial has panicked")?;
    rows.sort_by_key(|(number, _)| *number);
    let mut table = Row::HEAD.to_owned();
    rows.iter()
        .for_each(|(_, row)| table.push_str(&format!("{}\n", row.line())));
    println!("{table}");
    if let Some(out) = out {
        std::fs::write(out, &table)?;
    }
    let wrong: Vec<String> = rows.iter().flat_map(|(_, row)| row.wrong()).collect();
    println!(
        "{} attacks, {} with something that must not be",
        rows.len(),
        wrong.len()
    );
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(wrong.join("\n").into())
    }
}
