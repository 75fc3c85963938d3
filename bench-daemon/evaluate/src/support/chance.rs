//! Random numbers for pauses, so that clients that lost one server do not reconnect at the same
//! time.

/// A number from 0 to 1.
pub fn chance() -> f64 {
    let mut byte = [128];
    // Without randomness the pause is the middle one.
    let _ = getrandom::fill(&mut byte);
    f64::from(byte[0]) / 255.0
}
