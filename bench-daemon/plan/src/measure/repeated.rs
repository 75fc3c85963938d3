//! Detects a record that the scope has already sent. The functions are pure.
//!
//! Noise changes the last digit of a twelve-bit converter, so two records never agree in each of
//! their thousands of samples. A single dead or clipped channel may agree: all four channels are
//! compared.

use std::{
    collections::HashMap,
    hash::{DefaultHasher, Hash, Hasher},
};

/// Digests of the codes of the four channels.
pub type Digest = [u64; 4];

/// Digests of earlier records, with their names.
#[derive(Debug, Default)]
pub struct SeenRecords {
    known: HashMap<Digest, String>,
}

/// Returns the digest of a record, or `None` if no sample changes, because that proves nothing.
pub fn digest_record(codes: [&[i16]; 4]) -> Option<Digest> {
    let moves = |channel: &[i16]| channel.iter().any(|code| Some(code) != channel.first());
    codes.into_iter().any(moves).then(|| {
        codes.map(|channel| {
            let mut hasher = DefaultHasher::new();
            channel.hash(&mut hasher);
            hasher.finish()
        })
    })
}

impl SeenRecords {
    /// Stores a record under a name; returns the name of an earlier one with the same codes.
    pub fn remember(&mut self, digest: Option<Digest>, name: String) -> Option<String> {
        self.known.insert(digest?, name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_known_again_by_all_four_channels() {
        let mut seen = SeenRecords::default();
        let (moves, other, still) = ([1, 2, 3], [1, 2, 4], [7, 7, 7]);
        let mut earlier =
            |codes: [&[i16]; 4], name: &str| seen.remember(digest_record(codes), name.to_owned());
        let first: [&[i16]; 4] = [&moves, &moves, &still, &moves];
        assert_eq!(earlier(first, "3 Hz"), None);
        // Three channels may agree by chance if they are dead or clip.
        assert_eq!(earlier([&moves, &moves, &still, &other], "30 Hz"), None);
        assert_eq!(earlier(first, "300 Hz").as_deref(), Some("3 Hz"));
        assert_eq!(earlier([&still; 4], "dead"), None);
        assert_eq!(earlier([&still; 4], "dead again"), None);
    }
}
