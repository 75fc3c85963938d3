//! Feeds arbitrary bytes to every reader of the codec. One body for the fuzz target and for the
//! bounded test.

use super::{
    block,
    decode::{DecoderOptions, Expect, ProgramFramer, ResponseDecoder, Terminator},
    header::Pattern,
    message::{parse_program, parse_response, response_units},
    number, status, text_of,
};

/// Parses `data` with every parser. Panics if the codec panics, or if splitting the stream changes
/// the result.
pub fn exercise(data: &[u8]) {
    let text = text_of(data);
    exercise_text(&text);
    let _ = block::parse_header(data);
    if let Ok(units) = parse_program(data) {
        for unit in &units {
            let _ = Pattern::parse(&unit.full_header())
                .map(|pattern| pattern.matches(&unit.full_header()));
            for argument in &unit.arguments {
                let _ = (
                    argument.number("V"),
                    argument.boolean(),
                    argument.is_word("MAXimum"),
                );
            }
        }
    }
    let cut = data
        .first()
        .map_or(0, |&byte| usize::from(byte) % (data.len() + 1));
    exercise_streams(data, cut);
}

fn exercise_text(text: &str) {
    let _ = number::parse_f64(text);
    let _ = number::parse_i64(text);
    let _ = number::parse_bool(text);
    let _ = number::parse_non_decimal(text);
    let _ = number::parse_quantity(text).map(|quantity| quantity.si("HZ"));
    let _ = status::parse_error(text);
    let _ = response_units(text);
    for field in parse_response(text) {
        let _ = (field.as_f64(), field.as_bool());
    }
    if let Ok(pattern) = Pattern::parse(text) {
        let _ = pattern.matches(text);
    }
}

fn exercise_streams(data: &[u8], cut: usize) {
    let (left, right) = data.split_at_checked(cut).unwrap_or((data, &[]));
    for terminator in [Terminator::Lf, Terminator::CrLf, Terminator::Cr] {
        let frames = |pieces: &[&[u8]]| {
            let mut framer = ProgramFramer::new(terminator, 64);
            pieces.iter().for_each(|piece| framer.push(piece));
            std::iter::from_fn(|| framer.pull()).collect::<Vec<_>>()
        };
        assert_eq!(
            frames(&[data]),
            frames(&[left, right]),
            "program messages depend on the cut"
        );
        for expect in [Expect::Line, Expect::Block] {
            for has_end_flag in [false, true] {
                let options = DecoderOptions {
                    terminator,
                    max_line: 64,
                    max_block: 4096,
                    strip_flow_bytes: has_end_flag,
                    has_end_flag,
                };
                let answers = |pieces: &[&[u8]]| {
                    let mut decoder = ResponseDecoder::new(options);
                    pieces.iter().for_each(|piece| decoder.push(piece));
                    decoder.end();
                    std::iter::from_fn(|| decoder.pull(expect).ok().flatten())
                        .take(data.len() + 1)
                        .collect::<Vec<_>>()
                };
                assert_eq!(
                    answers(&[data]),
                    answers(&[left, right]),
                    "answers depend on the cut"
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEDS: [&[u8]; 14] = [
        b"SOUR:VOLT 1500 mA;CURR 2;:OUTP ON;*WAI\n",
        b"DATA:ARB n,#3012a\n\x00\xffbcdefgh;x\n",
        b"C1:WF ALL,#9000000005ab\ncd\n\n",
        b"#0abc\n",
        b"#210",
        b"-113,\"Undefined header;a\"\"b\"\n",
        b"+9.91E+37,9.9E37,-1.5e-300\r\n",
        b"ROUT:SCAN (@101,103:105),((a)\n",
        b"[:SOURce<n>]:VOLTage[:LEVel[:IMMediate]]?",
        b"\x11\x1300 MANUAL STOP\r\n\r",
        b"*ESE #HFFFFFFFFFFFFFFFF,#Q,#B2\n",
        b"A 'it''s',\"\n",
        b"1E99999999999999999999,.,+,-.e\n",
        b"\xc2\xb0\xe2\x84\xa6 #19\n",
    ];

    /// A small deterministic generator, so that a failing input can be reproduced from its number.
    struct Xorshift(u64);

    impl Xorshift {
        fn below(&mut self, bound: usize) -> usize {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 % bound as u64) as usize
        }
    }

    fn input(random: &mut Xorshift) -> Vec<u8> {
        const BYTES: &[u8] = b"#0123456789:;,?*()@\"'[]<n> \t\r\n.+-eEHQBMxAUV\x00\x11\x80\xc2\xff";
        let mut data = match random.below(4) {
            0 => Vec::new(),
            _ => SEEDS[random.below(SEEDS.len())].to_vec(),
        };
        for _ in 0..random.below(12) {
            let at = random.below(data.len() + 1);
            let byte = if random.below(3) == 0 {
                random.below(256) as u8
            } else {
                BYTES[random.below(BYTES.len())]
            };
            match random.below(4) {
                0 if at < data.len() => data[at] = byte,
                1 if at < data.len() => drop(data.remove(at)),
                2 => data.truncate(at),
                _ => data.insert(at, byte),
            }
        }
        data
    }

    #[test]
    fn no_bytes_make_the_codec_panic() {
        let mut random = Xorshift(0x9e37_79b9_7f4a_7c15);
        for _ in 0..200_000 {
            let data = input(&mut random);
            let outcome = std::panic::catch_unwind(|| exercise(&data));
            assert!(
                outcome.is_ok(),
                "the codec panics on b\"{}\"",
                data.escape_ascii()
            );
        }
    }
}
