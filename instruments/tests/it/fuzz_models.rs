//! Random and mutated answers for the dialects, random and mutated messages for the mocks; see
//! `fuzz`.

use instruments::{
    chiller,
    exchange::{Exchange, Identity, field, hex_word, leading_number},
    generator,
    instrument::Model,
    load, logger,
    mock::{MODELS, MockOptions},
    scope, supply, supply4q,
    units::Celsius,
};

use crate::{
    fuzz::{Random, SHARE, conversations, from_environment, seeds},
    mocks_plant::Bench,
};

/// Greatest growth of this process during the test of the mocks, bytes.
const MOST_GROWTH: usize = 256 << 20;

/// Further reading of an answer.
type More = Box<dyn Fn(&[u8], &str)>;

/// Readings that a dialect takes from its answers.
struct Reader {
    key: &'static str,
    model: &'static dyn Model,
    expects: Vec<instruments::exchange::Expect>,
    more: More,
}

fn reader(
    model: &'static dyn Model,
    script: Vec<Exchange>,
    more: impl Fn(&[u8], &str) + 'static,
) -> Reader {
    let expects = script.into_iter().filter_map(|exchange| match exchange {
        Exchange::Set { expect, .. } | Exchange::Ask { expect, .. } => Some(expect),
        _ => None,
    });
    Reader {
        key: model.key(),
        model,
        expects: expects.collect(),
        more: Box::new(more),
    }
}

fn readers() -> Vec<Reader> {
    let mut readers = Vec::new();
    let nothing = |_: &[u8], _: &str| {};
    readers.extend(supply4q::DIALECTS.iter().map(|&dialect| {
        reader(
            dialect,
            [dialect.output(true), dialect.analog(true)].concat(),
            nothing,
        )
    }));
    readers.extend(
        generator::DIALECTS
            .iter()
            .map(|&dialect| reader(dialect, dialect.output(1, true), nothing)),
    );
    readers.extend(load::DIALECTS.iter().map(|&dialect| {
        reader(
            dialect,
            [dialect.input(true), dialect.watch()].concat(),
            nothing,
        )
    }));
    readers.extend(
        supply::DIALECTS
            .iter()
            .map(|&dialect| reader(dialect, dialect.output(true), nothing)),
    );
    readers.extend(
        logger::DIALECTS
            .iter()
            .map(|&dialect| reader(dialect, dialect.configure(&[101, 102]), nothing)),
    );
    readers.extend(scope::DIALECTS.iter().map(|&dialect| {
        reader(
            dialect,
            dialect.script(&scope::Intent::Session {
                memory_points: 10_000,
            }),
            move |bytes, _| {
                let _ = dialect.preamble(bytes);
                // Two bytes a point at most.
                assert!(dialect.codes(bytes).map_or(0, |codes| codes.len()) <= bytes.len());
            },
        )
    }));
    readers.extend(chiller::DIALECTS.iter().map(|&dialect| {
        reader(dialect, dialect.run(Some(Celsius(25.0))), move |_, text| {
            let _ = (dialect.celsius(text), dialect.status(text));
        })
    }));
    readers
}

#[test]
fn fuzz_dialects() {
    let mut conversations = conversations();
    // A descriptor of the length that the Siglent scope has.
    let descriptor = [&b"WAVEDESC\0\0\0\0\0\0\0\0WAVEACE"[..], &[0x3f; 325]].concat();
    let mut common = seeds(&[
        b"1",
        b"OFF",
        b"9.91E37",
        b"0,2,1000,1,1e-9,-5e-4,0,2e-5,0,32768",
        b"C1:BSWV WVTP,SINE,FRQ,10HZ,AMP,0.1V",
        b"#H1F",
        b"[S1K040201FF",
    ]);
    common.push(descriptor);
    let readers = readers();
    let keys: Vec<&str> = readers.iter().map(|reader| reader.key).collect();
    for reader in &readers {
        let mut answers = conversations
            .remove(reader.key)
            .map_or_else(Vec::new, |[_, received]| received);
        answers.extend(common.clone());
        let share = from_environment("EIS_BENCH_FUZZ", SHARE) / readers.len() as u64 + 1;
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        for number in 0..share {
            let data = random.input(&answers);
            let read = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                read_answer(reader, &data);
            }));
            assert!(
                read.is_ok(),
                "{}: input {number} makes it panic: b\"{}\"",
                reader.key,
                data.escape_ascii()
            );
        }
        println!("fuzz dialect {}: {share} inputs", reader.key);
    }
    assert!(keys.len() > 10, "{keys:?}");
}

fn read_answer(reader: &Reader, data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let _ = reader.model.recognises(&Identity::parse(&text));
    for expect in &reader.expects {
        let _ = expect.judge(&text);
    }
    let _ = (leading_number(&text), field(&text, "AMP"), hex_word(&text));
    (reader.more)(data, &text);
}

/// Bytes of this process in memory.
fn resident() -> usize {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    statm
        .split_ascii_whitespace()
        .nth(1)
        .and_then(|pages| pages.parse::<usize>().ok())
        .unwrap_or(0)
        * 4096
}

/// Messages after which a mock has more to do: acquisitions, downloads, scans, waves.
const DEEPER: &[&[u8]] = &[
    b":TRIG:MODE AUTO",
    b":TRIG:MODE SINGLE",
    b":TRIG:RUN",
    b":TRIG:STOP",
    b":WAV:SOUR C2;:WAV:WIDT WORD;:WAV:STAR 0;:WAV:POIN 50;:WAV:INT 1",
    b":WAV:PRE?",
    b":WAV:DATA?",
    b":WAV:SOUR CHAN1;:WAV:MODE RAW;:WAV:FORM WORD;:WAV:STAR 1;:WAV:STOP 50",
    b":RUN",
    b":STOP",
    b":TIM:MAIN:SCAL 1e-3",
    b":TIM:SCAL 1e-3",
    b"CONF:TEMP TC,K,(@101:103)",
    b"READ?",
    b"C1:BSWV WVTP,SINE,FRQ,10,AMP,0.1,OFST,0",
    b"C1:WVDT WVNM,w,WAVEDATA,\x00\x01\x02\x03",
    b"SOUR1:DATA:ARB:DAC w,#14abcd",
    b"OUTP ON;:VOLT 4;:CURR 1;:MEAS:VOLT?;:MEAS:CURR?",
    b"SYST:ERR?",
    b"*CLS;*ESE 255;*ESR?;*STB?",
    b"{M140001",
    b"OUT_MODE_05 1",
];

#[test]
fn fuzz_mocks() {
    let conversations = conversations();
    let before = resident();
    let share = from_environment("EIS_BENCH_FUZZ", SHARE) / MODELS.len() as u64 + 1;
    let mut others: Vec<Vec<u8>> = conversations
        .values()
        .flat_map(|[sent, _]| sent.clone())
        .collect();
    (0..5).for_each(|_| others.extend(seeds(DEEPER)));
    for model in MODELS {
        let own = conversations
            .get(model.key)
            .map_or_else(Vec::new, |[sent, _]| sent.clone());
        // Mostly messages that it understands.
        let seeds: Vec<Vec<u8>> = own
            .iter()
            .cycle()
            .take(own.len().min(1) * 3 * others.len())
            .chain(&others)
            .cloned()
            .collect();
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        // One instrument for all inputs: its memory must not grow.
        let paged = model.quirks().any(|quirk| quirk.name == "page_points");
        let mut bench = if paged {
            Bench::with(model.key, &MockOptions::quirk("page_points", 100.0))
        } else {
            Bench::new(model.key)
        };
        let mut most = 0;
        for number in 0..share {
            let data = random.input(&seeds);
            bench.now_s += 0.5;
            let reply = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                bench.device.handle(bench.now_s, &data)
            }));
            match reply {
                Ok(reply) => most = most.max(reply.len()),
                Err(_) => panic!(
                    "{}: input {number} makes it panic: b\"{}\"",
                    model.key,
                    data.escape_ascii()
                ),
            }
            if number % 256 == 0 {
                let mut plant = bench.plant.lock().unwrap();
                (plant.actions, plant.requests, plant.searches) = Default::default();
            }
        }
        println!(
            "fuzz mock {}: {share} inputs, greatest answer {most} bytes",
            model.key
        );
    }
    let growth = resident().saturating_sub(before);
    println!("fuzz mocks: {} MiB more in memory", growth >> 20);
    assert!(growth < MOST_GROWTH, "{growth} bytes");
}
