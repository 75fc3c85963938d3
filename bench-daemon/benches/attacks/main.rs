//! Attacks on a bench: the product of windows of a run and faults, on real processes and real ports,
//! with a simulated cell that records its load.
//!
//! `cargo bench --profile dev -p bench-daemon --bench attacks -- [--program PATH] [--only WORDS]
//! [--sample N] [--jobs N] [--resume] [--stated] [--list] [--out FILE.md]`; another build of the
//! program can be tested with the same attacks. Fails if the current exceeded the envelope of the
//! step for too long, if a wrong number has no flag, or if the last message was false.

#![expect(
    clippy::expect_used,
    reason = "a trial that cannot be set up has no row"
)]

mod deed;
mod job;
mod judge;
mod options;
mod scene;
mod table;
mod timeline;
mod trial;
mod window;

use std::{fmt::Write, sync::Mutex};

use deed::Attack;
use judge::Usual;
use options::Options;
use table::Row;
use trial::Play;

/// If the trial's own checks were later than this, s, a failed trial is repeated.
const BUSY_S: f64 = 0.5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let program = env!("CARGO_BIN_EXE_eis-bench");
    let options = Options::read(std::env::args().skip(1), program)?;
    let (product, skipped) = deed::product();
    let (quiet, attacks) = options.select(product);
    let mut head = format!(
        "{} attacks of {} windows",
        attacks.len(),
        window::Window::ALL.len()
    );
    for (why, count) in &skipped {
        write!(head, "\n{count} pairs are left out: {why}")?;
    }
    println!("{head}\n");
    if options.list {
        attacks
            .iter()
            .for_each(|attack| println!("{}", attack.name()));
        return Ok(());
    }
    let usual = Usual::default();
    let play = Play {
        program: &options.program,
        usual: &usual,
        resumes: options.resumes,
        stated: options.stated,
    };
    // The undisturbed runs are the reference for the others.
    let alone = quiet.first().map(|attack| play.stand(attack).took_s);
    let mut rows = play_all(&play, &quiet, options.jobs);
    let among = rows.first().map(|row| row.took_s);
    if let Some((alone_s, among_s)) = alone.zip(among) {
        println!(
            "{}: {alone_s:.1} s alone, {among_s:.1} s among {} at a time\n",
            rows[0].attack.name(),
            options.jobs
        );
    }
    rows.extend(play_all(&play, &attacks, options.jobs));
    report(&rows, &options)
}

/// Executes attacks, some concurrently; returns rows in their order.
fn play_all(play: &Play<'_>, attacks: &[Attack], jobs: usize) -> Vec<Row> {
    let (next, rows) = (
        Mutex::new(attacks.iter().enumerate()),
        Mutex::new(Vec::new()),
    );
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some((number, attack)) = next.lock().ok().and_then(|mut next| next.next())
                {
                    let mut row = play.stand(attack);
                    if !row.wrong().is_empty() && row.lag_s > BUSY_S {
                        eprintln!("the machine was busy, once more: {}", row.line());
                        row = play.stand(attack);
                    }
                    eprintln!("{}", row.line());
                    if let Ok(mut rows) = rows.lock() {
                        rows.push((number, row));
                    }
                }
            });
        }
    });
    let mut rows = rows.into_inner().unwrap_or_default();
    rows.sort_by_key(|(number, _)| *number);
    rows.into_iter().map(|(_, row)| row).collect()
}

/// Prints the table, and writes it and the rows if requested.
fn report(rows: &[Row], options: &Options) -> Result<(), Box<dyn std::error::Error>> {
    let text = format!(
        "{}\n{}\n{}",
        table::totals(rows),
        table::summary(rows),
        table::slow(rows)
    );
    println!("{text}");
    let mut lines = Row::HEAD.to_owned();
    for row in rows {
        writeln!(lines, "{}", row.line())?;
    }
    if let Some(out) = &options.out {
        std::fs::write(out, format!("{text}\n{lines}"))?;
    }
    let wrong: Vec<String> = rows
        .iter()
        .filter(|row| !row.wrong().is_empty())
        .map(|row| format!("{}: {}", row.attack.name(), row.wrong().join("; ")))
        .collect();
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
