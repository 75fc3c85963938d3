//! No mock panics, for any input.

use instruments::mock::{MODELS, MockOptions};
use proptest::prelude::*;

use crate::mocks_plant::Bench;

/// Pieces of messages, so that random texts reach deep into the trees.
fn pieces() -> impl Strategy<Value = Vec<u8>> {
    let words = prop::sample::select(vec![
        "CURR",
        "VOLT",
        ":",
        "?",
        " ",
        ";",
        ",",
        "C1:BSWV",
        "C1:OUTP",
        "LOAD",
        "AMP",
        "FRQ",
        "WAV",
        "DATA",
        "STAR",
        "POIN",
        "INT",
        "MODE",
        "CHAN1",
        "SCAL",
        "OFFS",
        "TIM",
        "TRIG",
        "RUN",
        "STOP",
        "SING",
        "1e9",
        "-1e-9",
        "9e999",
        "NAN",
        "MAX",
        "#H",
        "#15",
        "(@101:65535)",
        "(@",
        "\"",
        "'",
        "*",
        "CONF:TEMP TC,K,",
        "READ?",
        "OUT_SP_00 ",
        "IN_PV_00",
        "PRE",
        "\n",
        "MAX_OUTPUT_AMP",
        "PROB VAL,",
        "1E-300",
        "*RST",
        "INP ON",
        "LIM",
        "É",
        "\u{1}",
    ]);
    let word = words.prop_map(|word| word.as_bytes().to_vec());
    let noise = prop::collection::vec(any::<u8>(), 0..6);
    prop::collection::vec(prop_oneof![8 => word, 1 => noise], 0..24)
        .prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn no_bytes_make_a_mock_panic(messages in prop::collection::vec(pieces(), 1..5)) {
        for model in MODELS {
            // Small pages keep a capture of ten million points out of this test.
            let paged = model.quirks().any(|quirk| quirk.name == "page_points");
            let mut bench = if paged {
                Bench::with(model.key, &MockOptions::quirk("page_points", 100.0))
            } else {
                Bench::new(model.key)
            };
            for message in &messages {
                bench.now_s += 1.0;
                bench.device.handle(bench.now_s, message);
            }
        }
    }
}
