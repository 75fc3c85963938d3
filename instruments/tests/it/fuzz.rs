//! Random and mutated input for everything that reads what others write: the codec, the wire forms of the transports on both sides, what the dialects make
//! of answers, the mocks. Nothing panics, and nothing holds more than its bound. Whole sessions with both sides of each transport are in `fuzz_sessions`.
//!
//! `EIS_BENCH_FUZZ=10000000 cargo test -p instruments --test it fuzz -- --nocapture` takes so many inputs in each category instead of continuous
//! integration's share; `EIS_BENCH_FUZZ_SEED` chooses others.

use std::collections::BTreeMap;

use instruments::{
    chiller,
    exchange::{Exchange, Identity, field, hex_word, leading_number},
    generator,
    instrument::Model,
    load, logger,
    mock::{MODELS, MockOptions},
    scope,
    scpi::{
        decode::{DecoderOptions, Expect, ProgramFramer, ResponseDecoder, Terminator},
        exercise,
    },
    supply, supply4q,
    transcript::{Direction, Payload, Transcript},
    units::Celsius,
    wire::{
        hislip::{self, Kind, Message},
        prologix::{Lines, Marked, escaped},
        rpc::{self, Call, Records, Reply},
        vxi11::{Request, Response},
    },
};

use crate::mocks_plant::Bench;

/// Continuous integration's share of inputs in each category.
pub(crate) const SHARE: u64 = 20_000;
/// Longest input, bytes; a few are longer.
const LONGEST: usize = 400;
/// Limit of what the readers under test may hold, bytes.
const LIMIT: usize = 4096;
/// Greatest growth of this process during the test of the mocks, bytes.
const MOST_GROWTH: usize = 256 << 20;

pub(crate) fn from_environment(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.replace('_', "").parse().unwrap())
}

/// `SplitMix64` (Steele, Lea, Flood 2014).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    fn byte(&mut self) -> u8 {
        const LIKELY: &[u8] = b"#0123456789:;,?*()@\"'[]<>$ \t\r\n.+-eEHQBMxAUV\x00\x01\x11\x1b\x7f\x80\xff";
        if self.below(3) == 0 { self.next() as u8 } else { LIKELY[self.below(LIKELY.len())] }
    }

    /// Something new, or a seed with changes: bytes replaced, removed, put in, repeated; two seeds joined; the rest cut off.
    pub(crate) fn input(&mut self, seeds: &[Vec<u8>]) -> Vec<u8> {
        let mut data = match self.below(8) {
            0 => (0..self.below(64)).map(|_| self.byte()).collect(),
            1 => [&seeds[self.below(seeds.len())][..], &seeds[self.below(seeds.len())]].concat(),
            _ => seeds[self.below(seeds.len())].clone(),
        };
        for _ in 0..self.below(6) {
            let at = self.below(data.len() + 1);
            match self.below(7) {
                0 => data.truncate(at),
                1 | 2 if at < data.len() => data[at] = self.byte(),
                3 if at < data.len() => drop(data.remove(at)),
                4 if at < data.len() => data[at] ^= 1 << self.below(8),
                5 => {
                    let from = self.below(at + 1);
                    let piece = data[from..at].to_vec();
                    data.splice(at..at, piece);
                }
                _ => data.insert(at, self.byte()),
            }
        }
        let most = if self.below(1000) == 0 { 20 * LONGEST } else { LONGEST };
        data.truncate(most);
        data
    }
}

/// Plays a category; `body` gives the bytes that were held most.
fn category(name: &str, seeds: &[Vec<u8>], mut body: impl FnMut(&[u8], &mut Random) -> usize) {
    let (count, seed) = (from_environment("EIS_BENCH_FUZZ", SHARE), from_environment("EIS_BENCH_FUZZ_SEED", 1));
    let mut random = Random(seed);
    let mut most = 0;
    for number in 0..count {
        let data = random.input(seeds);
        let held = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| body(&data, &mut random)));
        match held {
            Ok(held) => most = most.max(held),
            Err(_) => panic!("{name}: input {number} of seed {seed} makes it panic: b\"{}\"", data.escape_ascii()),
        }
    }
    println!("fuzz {name}: {count} inputs of seed {seed}, at most {most} bytes held");
}

fn seeds(texts: &[&[u8]]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.to_vec()).collect()
}

/// Messages and answers of every model, as its record has them.
fn conversations() -> BTreeMap<String, [Vec<Vec<u8>>; 2]> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/data/transcripts");
    let mut conversations = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "txt") {
            let transcript = Transcript::parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
            let mut both = [Vec::new(), Vec::new()];
            for record in transcript.records {
                let bytes = match record.payload {
                    Payload::Text(text) => text.into_bytes(),
                    Payload::Block(block) => block.bytes.unwrap_or_default(),
                };
                match record.direction {
                    Direction::Sent => both[0].push(bytes),
                    Direction::Received => both[1].push(bytes),
                    _ => {}
                }
            }
            conversations.insert(path.file_stem().unwrap().to_str().unwrap().to_owned(), both);
        }
    }
    assert!(conversations.len() > 10, "{conversations:?}");
    conversations
}

#[test]
fn fuzz_codec() {
    let mut seeds = seeds(&[
        b"SOUR:VOLT 1500 mA;CURR 2;:OUTP ON;*WAI\n",
        b"DATA:ARB n,#3012a\n\x00\xffbcdefgh;x\n",
        b"C1:WF ALL,#9000000005ab\ncd\n\n",
        b"#0abc\n",
        b"#49999abc",
        b"+9.91E+37,9.9E37,-1.5e-300\r\n",
        b"[:SOURce<n>]:VOLTage[:LEVel[:IMMediate]]?",
        b"*ESE #HFFFFFFFFFFFFFFFF,#Q,#B2\n",
        b"A 'it''s',\"\n",
    ]);
    seeds.extend(conversations().into_values().flat_map(|[sent, received]| [sent, received].concat()));
    let options = DecoderOptions { max_line: 64, max_block: LIMIT, ..DecoderOptions::default() };
    category("codec", &seeds, |data, random| {
        exercise(data);
        // Long-lived readers on a stream without end.
        let (mut decoder, mut framer) = (ResponseDecoder::new(options), ProgramFramer::new(Terminator::Lf, LIMIT));
        let mut most = 0;
        for _ in 0..4 {
            decoder.push(data);
            framer.push(data);
            if random.below(4) == 0 {
                decoder.end();
                framer.end();
            }
            let expect = if random.below(2) == 0 { Expect::Line } else { Expect::Block };
            while let Ok(Some(_)) = decoder.pull(expect) {}
            while framer.pull().is_some() {}
            most = most.max(decoder.buffered()).max(framer.held());
        }
        assert!(most <= LIMIT + 128, "{most} bytes held");
        most
    });
}

fn wire_seeds() -> Vec<Vec<u8>> {
    let requests = [
        Request::CreateLink { device: "inst0".to_owned() },
        Request::Write { link: 1, io_timeout_ms: 2000, flags: 8, data: b"*IDN?\n".to_vec() },
        Request::Read { link: 1, size: 4096, io_timeout_ms: 2000, term_char: Some(b'\n') },
        Request::ReadStatus { link: 1 },
        Request::DestroyLink { link: 1 },
    ];
    let responses = [
        Response::Data { status: instruments::wire::vxi11::Status::OK, reason: 4, data: b"1.25\n".to_vec() },
        Response::Link { status: instruments::wire::vxi11::Status::OK, link: 1, abort_port: 1024, most_bytes: 65_536 },
    ];
    let mut seeds = Vec::new();
    for request in requests {
        let (procedure, arguments) = request.encode();
        let call = Call { id: 1, program: instruments::wire::vxi11::CORE, procedure, arguments: &arguments };
        seeds.push(rpc::marked(&call.encode()));
    }
    for response in responses {
        seeds.push(rpc::marked(&Reply { id: 1, verdict: rpc::Verdict::Success, results: &response.encode() }.encode()));
    }
    seeds.extend([
        Message::new(Kind::Initialize, 0, 0x0100_7878).with(*b"hislip0").encode(),
        Message::new(Kind::DataEnd, 0, hislip::FIRST_ID).with(*b"*IDN?\n").encode(),
        Message::new(Kind::AsyncMaxMsgSize, 0, 0).with(1_u64.to_be_bytes()).encode(),
        b"++mode 1\n++addr 9\n++read eoi\n++ver\n".to_vec(),
        escaped(b"DATA #14a\nb\x1b+\n"),
        b"1.25\nPrologix 1.0\r\n\r\nProlog".to_vec(),
    ]);
    seeds
}

#[test]
fn fuzz_wire() {
    category("wire forms", &wire_seeds(), |data, random| {
        let mut records = Records::new(LIMIT);
        let mut messages = hislip::Messages::new(LIMIT);
        let mut lines = Lines::new(LIMIT);
        let mut marked = Marked::new(b"Prologix 1.0\r\n".to_vec());
        let mut most = 0;
        let (left, right) = data.split_at(random.below(data.len() + 1));
        for piece in [left, right] {
            records.push(piece);
            while let Ok(Some(record)) = records.pull() {
                read_record(&record);
            }
            messages.push(piece);
            while let Ok(Some(message)) = messages.pull() {
                assert_eq!(reread(&message), message);
            }
            lines.push(piece);
            while lines.pull().is_some() {}
            marked.push(piece);
            while marked.pull().1 {}
            most = [most, records.held(), messages.held(), lines.held(), marked.held()].into_iter().max().unwrap();
        }
        // Whatever has no mark in front, too.
        read_record(data);
        assert!(most <= LIMIT + 2 * data.len(), "{most} bytes held");
        most
    });
}

/// As the server reads it, and as the client does.
fn read_record(record: &[u8]) {
    if let Ok(call) = Call::parse(record) {
        assert_eq!(Call::parse(&call.encode()), Ok(call));
        if let Ok(Some(request)) = Request::parse(call.procedure, call.arguments, LIMIT) {
            let (procedure, arguments) = request.encode();
            assert_eq!(Request::parse(procedure, &arguments, LIMIT), Ok(Some(request)));
        }
    }
    for procedure in [10, 11, 12, 13, 22, 23] {
        let Ok(Some(request)) = Request::parse(procedure, record, LIMIT) else { continue };
        let _ = Response::parse(&request, record, LIMIT);
        if let Ok(reply) = Reply::parse(record) {
            let _ = Response::parse(&request, reply.results, LIMIT);
        }
    }
}

fn reread(message: &Message) -> Message {
    let mut messages = hislip::Messages::new(LIMIT);
    messages.push(&message.encode());
    messages.pull().unwrap().unwrap()
}

/// What else is read of an answer.
type More = Box<dyn Fn(&[u8], &str)>;

/// What a dialect reads of what it is answered.
struct Reader {
    key: &'static str,
    model: &'static dyn Model,
    expects: Vec<instruments::exchange::Expect>,
    more: More,
}

fn reader(model: &'static dyn Model, script: Vec<Exchange>, more: impl Fn(&[u8], &str) + 'static) -> Reader {
    let expects = script.into_iter().filter_map(|exchange| match exchange {
        Exchange::Set { expect, .. } | Exchange::Ask { expect, .. } => Some(expect),
        _ => None,
    });
    Reader { key: model.key(), model, expects: expects.collect(), more: Box::new(more) }
}

fn readers() -> Vec<Reader> {
    let mut readers = Vec::new();
    let nothing = |_: &[u8], _: &str| {};
    readers
        .extend(supply4q::DIALECTS.iter().map(|&dialect| reader(dialect, [dialect.output(true), dialect.analog(true)].concat(), nothing)));
    readers.extend(generator::DIALECTS.iter().map(|&dialect| reader(dialect, dialect.output(1, true), nothing)));
    readers.extend(load::DIALECTS.iter().map(|&dialect| reader(dialect, [dialect.input(true), dialect.watch()].concat(), nothing)));
    readers.extend(supply::DIALECTS.iter().map(|&dialect| reader(dialect, dialect.output(true), nothing)));
    readers.extend(logger::DIALECTS.iter().map(|&dialect| reader(dialect, dialect.configure(&[101, 102]), nothing)));
    readers.extend(scope::DIALECTS.iter().map(|&dialect| {
        reader(dialect, dialect.script(&scope::Intent::Session { memory_points: 10_000 }), move |bytes, _| {
            let _ = dialect.preamble(bytes);
            // Two bytes a point at most.
            assert!(dialect.codes(bytes).map_or(0, |codes| codes.len()) <= bytes.len());
        })
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
        let mut answers = conversations.remove(reader.key).map_or_else(Vec::new, |[_, received]| received);
        answers.extend(common.clone());
        let share = from_environment("EIS_BENCH_FUZZ", SHARE) / readers.len() as u64 + 1;
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        for number in 0..share {
            let data = random.input(&answers);
            let read = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| read_answer(reader, &data)));
            assert!(read.is_ok(), "{}: input {number} makes it panic: b\"{}\"", reader.key, data.escape_ascii());
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
    statm.split_ascii_whitespace().nth(1).and_then(|pages| pages.parse::<usize>().ok()).unwrap_or(0) * 4096
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
    let mut others: Vec<Vec<u8>> = conversations.values().flat_map(|[sent, _]| sent.clone()).collect();
    (0..5).for_each(|_| others.extend(seeds(DEEPER)));
    for model in MODELS {
        let own = conversations.get(model.key).map_or_else(Vec::new, |[sent, _]| sent.clone());
        // Mostly what it understands.
        let seeds: Vec<Vec<u8>> = own.iter().cycle().take(own.len().min(1) * 3 * others.len()).chain(&others).cloned().collect();
        let mut random = Random(from_environment("EIS_BENCH_FUZZ_SEED", 1));
        // One instrument for all: what it keeps must not grow.
        let paged = model.quirks().any(|quirk| quirk.name == "page_points");
        let mut bench = if paged { Bench::with(model.key, &MockOptions::quirk("page_points", 100.0)) } else { Bench::new(model.key) };
        let mut most = 0;
        for number in 0..share {
            let data = random.input(&seeds);
            bench.now_s += 0.5;
            let reply = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| bench.device.handle(bench.now_s, &data)));
            match reply {
                Ok(reply) => most = most.max(reply.len()),
                Err(_) => panic!("{}: input {number} makes it panic: b\"{}\"", model.key, data.escape_ascii()),
            }
            if number % 256 == 0 {
                let mut plant = bench.plant.lock().unwrap();
                (plant.actions, plant.requests, plant.searches) = Default::default();
            }
        }
        println!("fuzz mock {}: {share} inputs, greatest answer {most} bytes", model.key);
    }
    let growth = resident().saturating_sub(before);
    println!("fuzz mocks: {} MiB more in memory", growth >> 20);
    assert!(growth < MOST_GROWTH, "{growth} bytes");
}

#[test]
fn the_inputs_are_the_same_each_time() {
    let inputs = |seed| {
        let mut random = Random(seed);
        (0..50).map(|_| random.input(&wire_seeds())).collect::<Vec<_>>()
    };
    assert_eq!(inputs(1), inputs(1));
    assert_ne!(inputs(1), inputs(2));
}
