//! Random and mutated input for every parser of external data: here the codec and the wire forms of
//! the transports on both sides, and in `fuzz_models` the reply parsers of the dialects, and the
//! mocks. Nothing panics, and nothing exceeds its memory bound. Whole sessions with both sides of
//! each transport are in `fuzz_sessions` and `fuzz_usbtmc`.
//!
//! `EIS_BENCH_FUZZ=10000000 cargo test -p instruments --test it fuzz -- --nocapture` sets the
//! number of inputs in each category instead of continuous integration's share;
//! `EIS_BENCH_FUZZ_SEED` selects others.

use std::collections::BTreeMap;

use instruments::{
    scpi::{
        decode::{DecoderOptions, Expect, ProgramFramer, ResponseDecoder, Terminator},
        exercise,
    },
    transcript::{Direction, Payload, Transcript},
    wire::{
        hislip::{self, Kind, Message},
        prologix::{Lines, Marked, escaped},
        rpc::{self, Call, Records, Reply},
        vxi11::{Request, Response},
    },
};

/// Continuous integration's share of inputs in each category.
pub(crate) const SHARE: u64 = 20_000;
/// Longest input, bytes; a few are longer.
const LONGEST: usize = 400;
/// Limit of the memory of the readers under test, bytes.
const LIMIT: usize = 4096;

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
        const LIKELY: &[u8] =
            b"#0123456789:;,?*()@\"'[]<>$ \t\r\n.+-eEHQBMxAUV\x00\x01\x11\x1b\x7f\x80\xff";
        if self.below(3) == 0 {
            self.next() as u8
        } else {
            LIKELY[self.below(LIKELY.len())]
        }
    }

    /// Something new, or a seed with changes: bytes replaced, removed, put in, repeated; two seeds
    /// joined; the rest cut off.
    pub(crate) fn input(&mut self, seeds: &[Vec<u8>]) -> Vec<u8> {
        let mut data = match self.below(8) {
            0 => (0..self.below(64)).map(|_| self.byte()).collect(),
            1 => [
                &seeds[self.below(seeds.len())][..],
                &seeds[self.below(seeds.len())],
            ]
            .concat(),
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
        let most = if self.below(1000) == 0 {
            20 * LONGEST
        } else {
            LONGEST
        };
        data.truncate(most);
        data
    }
}

/// Runs a category; `body` returns the largest number of bytes held.
fn category(name: &str, seeds: &[Vec<u8>], mut body: impl FnMut(&[u8], &mut Random) -> usize) {
    let (count, seed) = (
        from_environment("EIS_BENCH_FUZZ", SHARE),
        from_environment("EIS_BENCH_FUZZ_SEED", 1),
    );
    let mut random = Random(seed);
    let mut most = 0;
    for number in 0..count {
        let data = random.input(seeds);
        let held =
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| body(&data, &mut random)));
        match held {
            Ok(held) => most = most.max(held),
            Err(_) => panic!(
                "{name}: input {number} of seed {seed} makes it panic: b\"{}\"",
                data.escape_ascii()
            ),
        }
    }
    println!("fuzz {name}: {count} inputs of seed {seed}, at most {most} bytes held");
}

pub(crate) fn seeds(texts: &[&[u8]]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.to_vec()).collect()
}

/// Messages and answers of every model, as its record has them.
pub(crate) fn conversations() -> BTreeMap<String, [Vec<Vec<u8>>; 2]> {
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
    seeds.extend(
        conversations()
            .into_values()
            .flat_map(|[sent, received]| [sent, received].concat()),
    );
    let options = DecoderOptions {
        max_line: 64,
        max_block: LIMIT,
        ..DecoderOptions::default()
    };
    category("codec", &seeds, |data, random| {
        exercise(data);
        // Long-lived readers on a stream without end.
        let (mut decoder, mut framer) = (
            ResponseDecoder::new(options),
            ProgramFramer::new(Terminator::Lf, LIMIT),
        );
        let mut most = 0;
        for _ in 0..4 {
            decoder.push(data);
            framer.push(data);
            if random.below(4) == 0 {
                decoder.end();
                framer.end();
            }
            let expect = if random.below(2) == 0 {
                Expect::Line
            } else {
                Expect::Block
            };
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
        Request::CreateLink {
            device: "inst0".to_owned(),
        },
        Request::Write {
            link: 1,
            io_timeout_ms: 2000,
            flags: 8,
            data: b"*IDN?\n".to_vec(),
        },
        Request::Read {
            link: 1,
            size: 4096,
            io_timeout_ms: 2000,
            term_char: Some(b'\n'),
        },
        Request::ReadStatus { link: 1 },
        Request::DestroyLink { link: 1 },
    ];
    let responses = [
        Response::Data {
            status: instruments::wire::vxi11::Status::OK,
            reason: 4,
            data: b"1.25\n".to_vec(),
        },
        Response::Link {
            status: instruments::wire::vxi11::Status::OK,
            link: 1,
            abort_port: 1024,
            most_bytes: 65_536,
        },
    ];
    let mut seeds = Vec::new();
    for request in requests {
        let (procedure, arguments) = request.encode();
        let call = Call {
            id: 1,
            program: instruments::wire::vxi11::CORE,
            procedure,
            arguments: &arguments,
        };
        seeds.push(rpc::marked(&call.encode()));
    }
    for response in responses {
        seeds.push(rpc::marked(
            &Reply {
                id: 1,
                verdict: rpc::Verdict::Success,
                results: &response.encode(),
            }
            .encode(),
        ));
    }
    seeds.extend([
        Message::new(Kind::Initialize, 0, 0x0100_7878)
            .with(*b"hislip0")
            .encode(),
        Message::new(Kind::DataEnd, 0, hislip::FIRST_ID)
            .with(*b"*IDN?\n")
            .encode(),
        Message::new(Kind::AsyncMaxMsgSize, 0, 0)
            .with(1_u64.to_be_bytes())
            .encode(),
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
            most = [
                most,
                records.held(),
                messages.held(),
                lines.held(),
                marked.held(),
            ]
            .into_iter()
            .max()
            .unwrap();
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
            assert_eq!(
                Request::parse(procedure, &arguments, LIMIT),
                Ok(Some(request))
            );
        }
    }
    for procedure in [10, 11, 12, 13, 22, 23] {
        let Ok(Some(request)) = Request::parse(procedure, record, LIMIT) else {
            continue;
        };
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

#[test]
fn the_inputs_are_the_same_each_time() {
    let inputs = |seed| {
        let mut random = Random(seed);
        (0..50)
            .map(|_| random.input(&wire_seeds()))
            .collect::<Vec<_>>()
    };
    assert_eq!(inputs(1), inputs(1));
    assert_ne!(inputs(1), inputs(2));
}
