//! Second crash drill: points that overlap, and a trace that is one wave in the generator's
//! memory. The process dies while the generator is ahead of the journal's points, and before,
//! during and after the wave. Nothing restores the charge of the cell automatically here. A wave
//! with unknown outcome is therefore refused until a person has accepted it.
//!
//! `EIS_BENCH_CRASHES` as in the first one: `all`, or a number.

use std::{fs, path::Path};

use analysis::spectrum::ImpedancePoint;
use bench_core::journal::{self, Entry, Line};
use instruments::transcript::{Direction, Payload, Record};

use crate::{
    crash::{Fate, bound, dies, distance, every, guarded, rows, spectrum},
    resume::resume,
    support::{EXPERIMENT, Files, Ports, command, files_below, json, sent, transcript},
};

/// Bench seconds per second: a wave must be replaced within half a second of bench time.
const FACTOR: f64 = 5.0;
/// Number of crashes without the variable.
const SHARE: usize = 8;
/// One in this number of crashes is at the journal.
const JOURNAL: usize = 4;
/// How often a machine may be too slow in one run.
const PATIENCE: usize = 8;

const WAVE: &str = r#"
[[traces]]
name = "jump"
through = "wave"
rest_first = "2 s"
start_voltage = ["3.6 V", "4.0 V"]
resistance_max = "30 mΩ"
segments = [
    { current = "-2 A", duration = "0.5 s" },
    { current = "1 A", duration = "0.5 s" },
    { current = "0 A", duration = "1 s" },
]
"#;

/// Returns files with one sweep whose points overlap, and one wave.
fn files() -> Files {
    Files::short(4)
        .without(EXPERIMENT, "fixture_check")
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"10 Hz\"")
        .edit(
            EXPERIMENT,
            "extra_wait = \"1 s\"",
            "extra_wait = \"1 s\"\noverlap = true",
        )
        .append(EXPERIMENT, WAVE)
}

/// The points at which a run can die, and some points of the wave that any drill uses.
struct Points {
    exchanges: Vec<usize>,
    writes: Vec<usize>,
    wave: Vec<String>,
}

/// Returns the numbers of the lines of all transcripts together, and of the journal's writes,
/// between the first point's intent and the end of the wave.
fn points(run: &Path) -> Points {
    let lines = journal::read(run).unwrap().lines;
    let of = |text: &str| {
        let begins = |line: &Line| matches!(&line.entry, Entry::Intent { text: met, .. } if met.starts_with(text));
        lines.iter().position(begins).unwrap()
    };
    let (first, wave) = (of("point"), of("trace jump"));
    let end = wave
        + lines[wave..]
            .iter()
            .position(|line| matches!(line.entry, Entry::Done { .. }))
            .unwrap();
    let names = files_below(&run.join("transcripts"));
    let roles = names
        .iter()
        .map(|name| name.file_stem().unwrap().to_str().unwrap());
    let mut times: Vec<f64> = roles
        .flat_map(|role| transcript(run, role).records)
        .map(|record| record.time_s)
        .collect();
    times.sort_by(f64::total_cmp);
    let between = |from_s: f64, to_s: f64| -> Vec<usize> {
        (1..)
            .zip(&times)
            .filter(|(_, time_s)| (from_s..=to_s).contains(*time_s))
            .map(|(number, _)| number)
            .collect()
    };
    let (loaded_s, away_s) = wave_s(&transcript(run, "generator").records, lines[wave].time_s.0);
    let playing = between(loaded_s, away_s);
    assert!(
        !playing.is_empty(),
        "no exchange between {loaded_s} s and {away_s} s"
    );
    // The positions of the first two vary with the polls before them. At the third the wave is in
    // the index, but the journal does not yet record that it is done.
    let exchange = |third: usize| format!("exchange:{}", playing[third * playing.len() / 3]);
    Points {
        exchanges: between(lines[first].time_s.0, lines[end].time_s.0),
        // The ends of the writes of these lines: 2n − 1 before the n-th, 2n after it.
        writes: (2 * first + 1..=2 * end + 2).collect(),
        wave: vec![exchange(1), exchange(2), format!("journal:{}", 2 * end + 1)],
    }
}

/// Returns when a wave was loaded into the generator after a time, and when the least sine
/// replaced it, bench s.
fn wave_s(generator: &[Record], from_s: f64) -> (f64, f64) {
    let sent_s = |text: &str, from_s: f64| {
        let wording = |record: &Record| match &record.payload {
            Payload::Text(wording) => wording.contains(text),
            Payload::Block(block) => block.prefix.contains(text),
        };
        let mut after = generator
            .iter()
            .filter(|record| record.direction == Direction::Sent && record.time_s > from_s);
        after
            .find(|record| wording(record))
            .unwrap_or_else(|| panic!("{text:?} was not sent after {from_s} s"))
            .time_s
    };
    let loaded_s = sent_s(":WVDT ", from_s);
    (loaded_s, sent_s("WVTP,SINE", sent_s("WVTP,ARB", loaded_s)))
}

/// Returns every point, or a share distributed over them, and always some of the wave's.
fn chosen(
    Points {
        exchanges,
        writes,
        wave,
    }: &Points,
) -> Vec<String> {
    let asked = std::env::var("EIS_BENCH_CRASHES").unwrap_or_default();
    let share: usize = if asked == "all" {
        usize::MAX
    } else {
        asked.parse().unwrap_or(SHARE)
    };
    let spread = |kind: &str, points: &[usize], share: usize| {
        let share = share.clamp(1, points.len());
        (0..share)
            .map(|index| {
                format!(
                    "{kind}:{}",
                    points[(2 * index + 1) * points.len() / (2 * share)]
                )
            })
            .collect::<Vec<_>>()
    };
    let journal = share / JOURNAL;
    [
        spread("exchange", exchanges, share - journal),
        spread("journal", writes, journal),
        wave.clone(),
    ]
    .concat()
}

/// Returns the phase of the run when it died.
fn phase(run: &Path) -> &'static str {
    let lines = journal::read(run).unwrap().lines;
    let began = lines.iter().rposition(
        |line| matches!(&line.entry, Entry::Intent { text, .. } if text.starts_with("trace jump")),
    );
    let (Some(began), generator) = (began, sent(run, "generator")) else {
        let (mut intents, mut done) = (0, 0);
        for line in &lines {
            match &line.entry {
                Entry::Intent { text, .. } if text.starts_with("point") => intents += 1,
                Entry::Point(_) => done += 1,
                _ => {}
            }
        }
        return if intents > done + 1 {
            "overlapped point"
        } else {
            "point"
        };
    };
    if lines[began..]
        .iter()
        .any(|line| matches!(line.entry, Entry::Done { .. }))
    {
        return "wave is done";
    }
    let Some(loaded) = generator
        .iter()
        .rposition(|message| message.contains(":WVDT "))
    else {
        return "before the wave";
    };
    let played = generator[loaded..]
        .iter()
        .position(|message| message.contains("WVTP,ARB"));
    let read_back = transcript(run, "generator").records.iter().any(|record| {
        record.direction == Direction::Received
            && matches!(&record.payload, Payload::Text(text) if text.contains("WVTP,ARB"))
    });
    match played {
        Some(at)
            if generator[loaded + at..]
                .iter()
                .any(|message| message.contains("WVTP,SINE")) =>
        {
            "wave: end"
        }
        Some(_) if read_back => "wave: play",
        _ => "wave: upload",
    }
}

/// Checks whether a wave was begun and its end is unknown.
fn unknown(run: &Path) -> bool {
    let index = fs::read_to_string(run.join("traces.json")).unwrap_or_default();
    let mut open = false;
    for line in journal::read(run).unwrap().lines {
        match line.entry {
            Entry::Intent { text, .. } => open = text.starts_with("trace jump"),
            Entry::Done { .. } => open = false,
            _ => {}
        }
    }
    open && !index.contains("\"jump\"")
}

fn ended(run: &Path) -> bool {
    fs::read_to_string(run.join("journal.jsonl"))
        .unwrap_or_default()
        .contains("{\"ended\":{\"how\":\"finished\"}}")
}

/// Resumes the run until it is finished; returns how often a person had to accept a repetition of
/// the wave from its beginning.
#[track_caller]
fn finish(run: &Path, drill: &str, fate: &mut Fate) -> usize {
    let mut asked = 0;
    for _ in 0..PATIENCE {
        if unknown(run) {
            let refused = resume(run, &[]);
            refused.expect_code(2);
            assert!(
                refused.message().contains("(trace jump, repeat 1: ")
                    && refused.message().contains("--accept-charge"),
                "{drill}"
            );
            asked += 1;
        }
        let more: &[&str] = if unknown(run) {
            &["--accept-charge"]
        } else {
            &[]
        };
        let ended = resume(run, more);
        if ended.code == Some(0) {
            return asked;
        }
        fate.excuse(ended.message(), &format!("{drill}: {}", ended.stderr));
    }
    panic!("{drill}: the machine is too slow for {FACTOR} bench seconds in one");
}

/// Executes one crash and returns the result as a row of the table.
fn crash(drill: &str, fate: &mut Fate, (reference, agrees): (&[ImpedancePoint], f64)) -> String {
    let files = files();
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("run");
    let experiment = files.experiment();
    let died = dies(
        command(&[
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ]),
        drill,
        fate,
    );
    if !died && ended(&run) {
        return format!("{drill:<13} not reached");
    }
    let current_a = ports.world.lock().unwrap().truth_current_a();
    let (phase, before) = (phase(&run), rows(&run));
    fate.phase = phase;
    let guarded = if died {
        guarded(&files, drill)
    } else {
        "ended: too slow".to_owned()
    };
    assert_eq!(
        ports.world.lock().unwrap().truth_current_a(),
        0.0,
        "{drill}: {guarded}"
    );
    let asked = if ended(&run) {
        0
    } else {
        finish(&run, drill, fate)
    };
    for (name, rows) in &before {
        assert!(
            fs::read_to_string(run.join(name))
                .unwrap()
                .starts_with(rows.as_str()),
            "{drill}: rows of {} were lost",
            name.display()
        );
    }
    // The wave has begun once, and once more each time that a person accepted it.
    let begun = journal::read(&run).unwrap().lines;
    let jumps = |line: &&Line| matches!(&line.entry, Entry::Intent { text, .. } if text.starts_with("trace jump"));
    let begun = begun.iter().filter(jumps).count();
    assert_eq!(
        begun,
        1 + asked,
        "{drill}: a wave was repeated although the charge that it had moved was unknown"
    );
    assert_eq!(
        json(&run.join("traces.json"))["traces"]
            .as_array()
            .unwrap()
            .len(),
        1,
        "{drill}"
    );
    let sigmas = distance(&spectrum(&run, "cell"), reference);
    assert!(
        sigmas < agrees,
        "{drill}: {sigmas} standard deviations, {agrees} at most"
    );
    ports.assert_outputs_off();
    let witness = ports.world.lock().unwrap().witness();
    assert_eq!(witness.abuse, [], "{drill}: the cell left its envelope");
    let played = if asked > 0 {
        "refused, accepted"
    } else {
        "went on"
    };
    let (least_v, greatest_v) = (witness.least_v, witness.greatest_v);
    format!(
        "{drill:<13} {phase:<16} {current_a:>7.3} A | {guarded:<15} | {played:<17} | {sigmas:.1} σ \
        | cell {least_v:.3} V to {greatest_v:.3} V"
    )
}

#[test]
#[ignore = "long drill"]
fn overlapped_points_and_a_wave_that_are_killed_anywhere_lose_nothing_and_move_no_unknown_charge_again()
 {
    let files = files();
    let ports = Ports::serve(&files, FACTOR, 1);
    let whole = files.path("whole");
    let ended = files.run("whole");
    if ended.code != Some(0) {
        let mut fate = Fate::default();
        fate.excuse(ended.message(), &format!("whole: {}", ended.stderr));
        finish(&whole, "whole", &mut fate);
    }
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    drop(ports);
    let reference = spectrum(&whole, "cell");
    let all = points(&whole);
    let kills = chosen(&all);
    let agrees = bound(2 * reference.len() * kills.len());
    let head = format!(
        "bound {agrees:.2} σ; {} of {} exchanges and {} ends of writes to the journal",
        kills.len(),
        all.exchanges.len(),
        all.writes.len()
    );
    let fates = every(&kills, ("kills_ahead.txt", &head), |_, drill, fate| {
        crash(drill, fate, (&reference, agrees))
    });
    let phases: Vec<&str> = fates
        .iter()
        .filter(|fate| fate.died)
        .map(|fate| fate.phase)
        .collect();
    // As named by `phase`: upload, output, end, or after the wave.
    assert!(
        phases.iter().any(|phase| phase.starts_with("wave")),
        "expected a death in the wave, found {phases:?}"
    );
}
