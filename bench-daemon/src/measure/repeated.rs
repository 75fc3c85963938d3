//! Recognises a record that the scope has sent before. Pure.
//!
//! Noise moves the last digit of a twelve-bit converter, so that two records are never alike in
//! each of their thousands of samples. One dead or clipped channel may be: all four channels
//! decide.

use std::{
    collections::HashMap,
    hash::{DefaultHasher, Hash, Hasher},
};

/// Digests of the codes of the four channels.
type Digest = [u64; 4];

/// Records that were seen, with their names.
#[derive(Debug, Default)]
pub(crate) struct SeenRecords {
    known: HashMap<Digest, String>,
}

impl SeenRecords {
    /// Remembers a record under a name; gives the name of an earlier one with the same codes. A
    /// record in which nothing moves proves nothing.
    pub(crate) fn earlier(&mut self, codes: [&[i16]; 4], name: String) -> Option<String> {
        let moves = codes
            .iter()
            .any(|channel| channel.iter().any(|code| Some(code) != channel.first()));
        if !moves {
            return None;
        }
        let digest = codes.map(|channel| {
            let mut hasher = DefaultHasher::new();
            channel.hash(&mut hasher);
            hasher.finish()
        });
        self.known.insert(digest, name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_known_again_by_all_four_channels() {
        let mut seen = SeenRecords::default();
        let (moves, other, still) = ([1, 2, 3], [1, 2, 4], [7, 7, 7]);
        let mut earlier = |codes: [&[i16]; 4], name: &str| seen.earlier(codes, name.to_owned());
        let first: [&[i16]; 4] = [&moves, &moves, &still, &moves];
        assert_eq!(earlier(first, "3 Hz"), None);
        // Three channels that are alike are chance where they are dead or clip.
        assert_eq!(earlier([&moves, &moves, &still, &other], "30 Hz"), None);
        assert_eq!(earlier(first, "300 Hz").as_deref(), Some("3 Hz"));
        assert_eq!(earlier([&still; 4], "dead"), None);
        assert_eq!(earlier([&still; 4], "dead again"), None);
    }
}
