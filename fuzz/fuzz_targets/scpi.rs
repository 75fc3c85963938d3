//! Arbitrary bytes through every reader of the codec. The bounded test of `instruments::scpi` runs
//! the same body.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| instruments::scpi::exercise(data));
