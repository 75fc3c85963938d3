//! Every message of a driver is in the corpus of its model, with a source; and every query of the
//! corpus gets an answer of the stated form from the mock.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::{Arc, Mutex},
};

use fixtures::{Scenario, SimulatedBench};
use instruments::{
    chiller,
    exchange::Exchange,
    generator::{self, Sine, Wave},
    instrument::Model,
    load::{self, Discharge, Draw},
    logger,
    mock::{self, MockOptions},
    scope::{self, Intent, Trigger, Vertical},
    supply::{self, Charge},
    supply4q::{self, Limits},
    units::{Amps, Celsius, Hertz, Seconds, Volts, Watts},
};
use serde::Deserialize;

/// The messages of one model.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Corpus {
    /// Key of the model.
    model: String,
    /// What is known of its firmware and its units.
    #[serde(default)]
    notes: Vec<String>,
    /// How it answers what it does not know, for people.
    error: String,
    /// Beginning of its answer to a query that no instrument knows; empty: silence.
    unknown: String,
    /// Beginning of its first entry in the error queue after that; none: no queue that the driver reads.
    queued: Option<String>,
    message: Vec<Message>,
}

/// A message. In its texts `#` is a digit of a name, `{n}` a number, `{A|B}` one of these words, `*`
/// any text.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    /// The command, if there is one.
    send: Option<String>,
    /// The query, if there is one.
    query: Option<String>,
    /// Form of the answer.
    answer: Option<String>,
    /// Values that the command takes, for people.
    #[serde(default, rename = "range")]
    _range: String,
    /// `guide`, `owner`, `driver` or `inferred`, a colon, and where.
    source: String,
    /// Peculiarities, for people.
    #[serde(default, rename = "note")]
    _note: String,
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../instruments/corpus")
}

fn corpora() -> BTreeMap<String, Corpus> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let corpus: Corpus =
            toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        assert_eq!(corpus.model, name, "{}", path.display());
        found.insert(name, corpus);
    }
    found
}

/// Replaces numbers by `{n}` and digits of names by `#`.
fn normal(message: &str) -> String {
    if let Some(rest) = message.strip_prefix("{M") {
        return format!("{{M{}****", rest.get(..2).unwrap_or_default());
    }
    let mut normal = String::new();
    let mut rest = message;
    while let Some(first) = rest.chars().next() {
        let before = normal.chars().last();
        let starts = matches!(before, Some(' ' | ',' | '@' | ':'));
        let end = rest.find([',', ' ', ')', ':']).unwrap_or(rest.len());
        let token = &rest[..end];
        let in_header = !normal.contains(' ') && !message.starts_with("MW");
        if starts
            && !token.is_empty()
            && token.parse::<f64>().is_ok()
            && !(in_header
                && before == Some(':')
                && !message.contains(' ')
                && message.ends_with('?'))
        {
            normal.push_str("{n}");
            rest = &rest[end..];
            continue;
        }
        let is_name = first.is_ascii_digit() && before.is_some_and(|c| c.is_ascii_alphabetic());
        normal.push(if is_name { '#' } else { first });
        rest = &rest[first.len_utf8()..];
    }
    normal
}

/// Returns the texts that a pattern with choices stands for.
fn expanded(pattern: &str) -> Vec<String> {
    let choice = pattern.match_indices('{').map(|(at, _)| at).find(|at| {
        pattern[*at..]
            .split('}')
            .next()
            .is_some_and(|inner| inner.contains('|'))
    });
    let Some(at) = choice else {
        return vec![pattern.to_owned()];
    };
    let end = at + pattern[at..].find('}').unwrap();
    pattern[at + 1..end]
        .split('|')
        .flat_map(|word| expanded(&format!("{}{word}{}", &pattern[..at], &pattern[end + 1..])))
        .collect()
}

/// Checks a text against a pattern in which `*` stands for any text.
fn matches(pattern: &str, text: &str) -> bool {
    match pattern
        .split_once('*')
        .filter(|_| !pattern.contains("****") && !pattern.starts_with('*'))
    {
        None => pattern == text,
        Some((head, tail)) => {
            text.len() >= head.len() + tail.len() && text.starts_with(head) && text.ends_with(tail)
        }
    }
}

impl Corpus {
    fn holds(&self, message: &str) -> bool {
        let text = normal(message);
        self.message.iter().any(|known| {
            known
                .send
                .iter()
                .chain(&known.query)
                .flat_map(|pattern| expanded(pattern))
                .any(|pattern| matches(&pattern, &text))
        })
    }
}

/// The messages of scripts, in the order in which they are sent.
fn sent(scripts: &[Vec<Exchange>]) -> Vec<String> {
    let mut messages = Vec::new();
    for exchange in scripts.iter().flatten() {
        match exchange {
            Exchange::Send(message) => messages.push(message.clone()),
            Exchange::Set {
                message, read_back, ..
            } => messages.extend([message.clone(), read_back.clone()]),
            Exchange::Ask {
                message, read_back, ..
            } => {
                messages.push(message.clone());
                messages.extend(read_back.iter().map(|(query, _)| query.clone()));
            }
            Exchange::Data { head, .. } => messages.push(head.clone()),
            Exchange::Refuse { .. } => {}
        }
    }
    messages
}

fn common<D: Model + ?Sized>(dialect: &D) -> Vec<String> {
    let profile = dialect.profile();
    std::iter::once(dialect.identity_query())
        .chain(profile.error_query)
        .map(str::to_owned)
        .collect()
}

/// Every message of every driver, by model.
fn drivers() -> BTreeMap<&'static str, Vec<String>> {
    let mut all = BTreeMap::new();
    let ways = |ways: Vec<instruments::exchange::Way>| {
        ways.into_iter().map(|way| way.script).collect::<Vec<_>>()
    };
    let owned = |texts: &[&str]| {
        texts
            .iter()
            .map(|text| (*text).to_owned())
            .collect::<Vec<_>>()
    };
    for dialect in supply4q::DIALECTS {
        let limits = Limits {
            compliance: Volts(4.7),
            current: Amps(2.5),
        };
        let mut scripts = ways(dialect.zero());
        scripts.extend([
            dialect.output(true),
            dialect.output(false),
            dialect.prepare(&limits),
            dialect.analog(true),
            dialect.analog(false),
            dialect.remote(),
        ]);
        let mut messages = [common(*dialect), sent(&scripts), owned(&dialect.measure())].concat();
        messages.extend(dialect.own_limits().map(str::to_owned));
        messages.extend(dialect.bounds().iter().map(|bound| bound.query.to_owned()));
        all.insert(dialect.key(), messages);
    }
    for dialect in generator::DIALECTS {
        let sine = Sine {
            freq: Hertz(12.5),
            amplitude: Volts(0.5),
            offset: Volts(-0.28),
        };
        let wave = Wave::named("run", vec![0.0, 1.0], sine);
        let scripts = [
            dialect.output(1, true),
            dialect.output(1, false),
            dialect.sine(1, &sine),
            dialect.wave(1, &wave),
            dialect.burst(1, Some(12)),
            dialect.burst(1, None),
            dialect.quiet(1, Volts(0.1)),
            dialect.direct(1, Volts(0.1)),
        ];
        all.insert(dialect.key(), [common(*dialect), sent(&scripts)].concat());
    }
    for dialect in scope::DIALECTS {
        let vertical = |channel| {
            Intent::Vertical(Vertical {
                channel,
                per_div: Volts(0.05),
                offset: Volts(-3.7),
            })
        };
        let trigger = Trigger {
            channel: 2,
            level: Volts(0.01),
        };
        let intents = [
            Intent::Session {
                memory_points: 10_000,
            },
            Intent::Session {
                memory_points: 100_000,
            },
            Intent::Session {
                memory_points: 1_000_000,
            },
            vertical(1),
            vertical(4),
            Intent::Timebase(Seconds(0.01)),
            Intent::Trigger(trigger),
            Intent::Arm,
            Intent::Roll,
            Intent::Stop,
            Intent::Transfer {
                channel: 3,
                stride: 10,
            },
            Intent::Page {
                start: 10,
                total: 100,
            },
        ];
        let mut scripts: Vec<_> = intents
            .iter()
            .map(|intent| dialect.script(intent))
            .collect();
        scripts.push(dialect.beside(2, 1));
        let queries = dialect.queries();
        let asked = [
            queries.status,
            queries.points,
            queries.preamble,
            queries.data,
        ];
        all.insert(
            dialect.key(),
            [common(*dialect), sent(&scripts), owned(&asked)].concat(),
        );
    }
    for dialect in load::DIALECTS {
        let discharge = |draw| Discharge {
            draw,
            stop_below: Volts(2.5),
        };
        let mut scripts = ways(dialect.zero());
        scripts.extend([
            dialect.input(true),
            dialect.input(false),
            dialect.prepare(&discharge(Draw::Current(Amps(2.0)))),
            dialect.prepare(&discharge(Draw::Current(Amps(12.0)))),
            dialect.prepare(&discharge(Draw::Power(Watts(20.0)))),
            dialect.level(Draw::Current(Amps(1.0))),
            dialect.level(Draw::Power(Watts(1.0))),
            dialect.sense(true),
            dialect.sense(false),
            dialect.watch(),
        ]);
        let mut messages = [common(*dialect), sent(&scripts), owned(&dialect.measure())].concat();
        messages.extend(dialect.bounds().iter().map(|bound| bound.query.to_owned()));
        all.insert(dialect.key(), messages);
    }
    for dialect in supply::DIALECTS {
        let charge = Charge {
            voltage: Volts(4.2),
            current: Amps(1.5),
        };
        let mut scripts = ways(dialect.zero());
        scripts.extend([
            dialect.output(true),
            dialect.output(false),
            dialect.prepare(&charge),
            dialect.level(Amps(1.0)),
        ]);
        let mut messages = [common(*dialect), sent(&scripts), owned(&dialect.measure())].concat();
        messages.extend(dialect.bounds().iter().map(|bound| bound.query.to_owned()));
        all.insert(dialect.key(), messages);
    }
    for dialect in chiller::DIALECTS {
        let mut scripts = ways(dialect.zero());
        scripts.extend([dialect.run(Some(Celsius(25.0))), dialect.run(None)]);
        let mut messages = [common(*dialect), sent(&scripts), owned(&dialect.queries())].concat();
        messages.extend(dialect.setpoint().map(str::to_owned));
        messages.extend(sent(&dialect.pulse(5.0).into_iter().collect::<Vec<_>>()));
        messages.extend(
            dialect
                .asks_whether_it_runs("-08")
                .map(|(query, _)| query.to_owned()),
        );
        all.insert(dialect.key(), messages);
    }
    for dialect in logger::DIALECTS {
        let channels: &[u16] = if dialect.has_channel(101) {
            &[101, 102]
        } else {
            &[1]
        };
        let scripts = [dialect.configure(channels)];
        let asked = [dialect.scan().to_owned()];
        all.insert(
            dialect.key(),
            [common(*dialect), sent(&scripts), asked.to_vec()].concat(),
        );
    }
    all
}

#[test]
fn every_message_of_a_driver_is_in_the_corpus_of_its_model() {
    let corpora = corpora();
    let mut missing = BTreeSet::new();
    for (model, messages) in drivers() {
        for message in messages {
            if !corpora
                .get(model)
                .is_some_and(|corpus| corpus.holds(&message))
            {
                missing.insert(format!("{model}\t{}\t{message}", normal(&message)));
            }
        }
    }
    let missing: Vec<String> = missing.into_iter().collect();
    assert!(
        missing.is_empty(),
        "not in instruments/corpus:\n{}",
        missing.join("\n")
    );
}

/// Checks an answer against the form that the corpus states.
fn has_form(form: &str, answer: &str) -> bool {
    let number = |text: &str| text.trim().parse::<f64>().is_ok();
    let words = |list: &str| {
        list.split('|')
            .any(|word| word.eq_ignore_ascii_case(answer))
    };
    match form.split_once(' ').unwrap_or((form, "")) {
        ("number", "") => number(answer),
        ("numbers", "") => !answer.is_empty() && answer.split(',').all(number),
        ("switch", "") => words("0|1|ON|OFF"),
        ("one", list) => words(list),
        ("text", "") => !answer.is_empty(),
        ("starts", head) => answer.starts_with(head),
        ("block", "") => {
            answer.starts_with('#') && answer[1..].starts_with(|c: char| c.is_ascii_digit())
        }
        ("hex", "") => answer
            .strip_prefix("0x")
            .is_some_and(|digits| u32::from_str_radix(digits, 16).is_ok()),
        ("error", "") => answer
            .split([',', ' '])
            .next()
            .is_some_and(|code| code.parse::<i32>().is_ok()),
        _ => panic!("expected a form of an answer that is known, found {form:?}"),
    }
}

#[test]
fn every_query_of_the_corpus_gets_an_answer_of_its_form_from_the_mock() {
    let mut wrong = Vec::new();
    for (model, corpus) in corpora() {
        for message in &corpus.message {
            let Some(query) = &message.query else {
                assert!(message.send.is_some(), "{model}: a message without a text");
                assert!(
                    message.answer.is_none(),
                    "{model}: {:?} has no query",
                    message.send
                );
                continue;
            };
            let form = message
                .answer
                .as_deref()
                .unwrap_or_else(|| panic!("{model}: {query}: no form"));
            let bench = SimulatedBench::new(&Scenario::default(), 1).unwrap();
            let plant = Arc::new(Mutex::new(bench));
            let mut device = mock::make(&model, plant, &MockOptions::default()).unwrap();
            for pattern in expanded(query) {
                let text = pattern.replace('#', "1").replace("{n}", "1");
                let reply = device.handle(1.0, text.as_bytes());
                let answer = String::from_utf8_lossy(&reply).trim_end().to_owned();
                if !has_form(form, &answer) {
                    let found: String = answer.chars().take(60).collect();
                    wrong.push(format!("{model}\t{text}\t{form}\t{found}"));
                }
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "the mock answers otherwise:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn an_unknown_query_is_met_as_the_corpus_states() {
    for (model, corpus) in corpora() {
        let bench = SimulatedBench::new(&Scenario::default(), 1).unwrap();
        let plant = Arc::new(Mutex::new(bench));
        let mut device = mock::make(&model, plant, &MockOptions::default()).unwrap();
        let mut ask = |query: &str| {
            let reply = device.handle(1.0, query.as_bytes());
            String::from_utf8_lossy(&reply).trim_end().to_owned()
        };
        // A bath that echoes has variables instead of words.
        let answer = ask(if model == "huber-pb" {
            "{M7E****"
        } else {
            "NONSENSE?"
        });
        assert!(
            if corpus.unknown.is_empty() {
                answer.is_empty()
            } else {
                answer.starts_with(&corpus.unknown)
            },
            "{model}: expected {:?}, found {answer:?}",
            corpus.unknown
        );
        if let Some(queued) = &corpus.queued {
            let is_queue = |query: &&String| query.to_uppercase().contains("ERR");
            let query = corpus
                .message
                .iter()
                .filter_map(|message| message.query.as_ref())
                .find(is_queue);
            let found = ask(query.unwrap_or_else(|| panic!("{model}: no query of an error queue")));
            assert!(
                found.starts_with(queued.as_str()),
                "{model}: expected {queued:?}, found {found:?}"
            );
        }
    }
}

const KINDS: [&str; 4] = ["guide", "owner", "driver", "inferred"];

#[test]
fn every_model_has_a_corpus_and_every_entry_a_source() {
    let corpora = corpora();
    let models: Vec<&str> = drivers().into_keys().collect();
    let written: Vec<&str> = corpora.keys().map(String::as_str).collect();
    assert_eq!(written, models);
    for corpus in corpora.values() {
        assert!(!corpus.error.is_empty(), "{}", corpus.model);
        for message in &corpus.message {
            let (kind, place) = message.source.split_once(':').unwrap_or_default();
            assert!(
                KINDS.contains(&kind) && !place.trim().is_empty(),
                "{}: {:?} {:?}: source: expected one of {}, a colon and where, found {:?}",
                corpus.model,
                message.send,
                message.query,
                KINDS.join(", "),
                message.source
            );
        }
    }
}

/// The page of what rests on inference, as the corpus has it.
fn page(corpora: &BTreeMap<String, Corpus>) -> String {
    let mut text = "# What is known of the instruments\n\n\
        Every message of the drivers is in `instruments/corpus/MODEL.toml`, with its query, the form of its \
        answer and its source.\nTests hold drivers and mocks against it. This page is written from it.\n\n\
        | model | messages | guide | owner | driver | inferred |\n|---|---|---|---|---|---|\n"
        .to_owned();
    let of_kind = |corpus: &Corpus, kind: &str| {
        let is = |message: &&Message| message.source.starts_with(&format!("{kind}:"));
        corpus.message.iter().filter(is).count()
    };
    for corpus in corpora.values() {
        let counts: Vec<String> = KINDS.map(|kind| of_kind(corpus, kind).to_string()).to_vec();
        text += &format!(
            "| `{}` | {} | {} |\n",
            corpus.model,
            corpus.message.len(),
            counts.join(" | ")
        );
    }
    text += "\n*guide*: a programming guide; *owner*: seen on hardware by its owner; *driver*: a public driver or \
        test; *inferred*: neither, so check it first.\n\n## What rests on inference\n";
    for corpus in corpora.values() {
        let inferred: Vec<&Message> = corpus
            .message
            .iter()
            .filter(|message| message.source.starts_with("inferred:"))
            .collect();
        if inferred.is_empty() && corpus.notes.is_empty() {
            continue;
        }
        text += &format!("\n### `{}`\n\n", corpus.model);
        for message in inferred {
            let (_, why) = message.source.split_once(':').unwrap_or_default();
            let texts: Vec<String> = message
                .send
                .iter()
                .chain(&message.query)
                .map(|text| format!("`{text}`"))
                .collect();
            text += &format!("* {}:{why}\n", texts.join(", "));
        }
        for note in &corpus.notes {
            text += &format!("* {note}\n");
        }
    }
    text
}

#[test]
fn the_page_lists_what_rests_on_inference() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/instruments.md");
    let wanted = page(&corpora());
    if std::env::var_os("EIS_BENCH_WRITE_REFERENCE").is_some() {
        std::fs::write(&path, &wanted).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == wanted,
        "docs/instruments.md is old: run with EIS_BENCH_WRITE_REFERENCE=1"
    );
}

#[test]
fn patterns_and_numbers_are_distinguished() {
    for (message, expected) in [
        (":CHAN1:SCAL 5.00000E-2", ":CHAN#:SCAL {n}"),
        (
            "C1:BSWV WVTP,SINE,FRQ,12.5,AMP,1.0000",
            "C#:BSWV WVTP,SINE,FRQ,{n},AMP,{n}",
        ),
        ("VOLT 4.2,(@1)", "VOLT {n},(@{n})"),
        (":ACQ:MDEP 10k", ":ACQ:MDEP 10k"),
        ("{M0009C4", "{M00****"),
        ("IN_MODE_05", "IN_MODE_05"),
    ] {
        assert_eq!(normal(message), expected);
    }
    assert_eq!(expanded(":INP {ON|OFF}"), [":INP ON", ":INP OFF"]);
    assert!(matches("C#:ARWV NAME,*", "C#:ARWV NAME,run"));
    assert!(!has_form("number", "ON") && has_form("one A|B", "b") && !has_form("block", "#x"));
}
