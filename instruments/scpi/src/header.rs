//! Headers in the notation of the manuals, compared with headers as they are sent (SCPI-1999 volume
//! 1, 6.2: long or short form exactly, in any case; nodes in brackets may be left out; a numeric
//! suffix that is left out is 1).

use super::excerpt;

/// Optional groups of one pattern; each doubles the ways to write it.
const MAX_OPTIONAL: u32 = 8;

/// A pattern that could not be read. A mistake of the program's own tables, not of an instrument.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a header in manual notation such as `[:SOURce<n>]:VOLTage[:LEVel]?`, found \
    `{pattern}`: {reason}"
)]
pub struct PatternError {
    pattern: String,
    reason: &'static str,
}

/// A header in manual notation: `[:SOURce<n>]:VOLTage[:LEVel][:IMMediate]`,
/// `MEASure:CURRent[:DC]?`, `*IDN?`.
///
/// Capitals are the short form. `<n>` marks a node that accepts a numeric suffix; a node without it
/// accepts only 1. A pattern that ends in `?` matches queries only; any other pattern matches
/// commands only.
///
/// ```
/// use instruments_scpi::header::Pattern;
/// # fn main() -> Result<(), instruments_scpi::header::PatternError> {
/// let voltage = Pattern::parse("[:SOURce<n>]:VOLTage?")?;
/// assert_eq!(voltage.matches("SOUR2:VOLT?"), Some(vec![2]));
/// assert_eq!(voltage.matches("voltage?"), Some(vec![1]));
/// assert_eq!(voltage.matches("VOLTA?"), None);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    nodes: Vec<Node>,
    /// The ways to write the header, as indices into `nodes`.
    ways: Vec<Vec<usize>>,
    query: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Node {
    short: String,
    long: String,
    numbered: bool,
}

impl Pattern {
    /// Reads a pattern.
    ///
    /// # Errors
    /// [`PatternError`] when brackets do not pair up, a node is empty or not written in capitals
    /// first, or more than eight groups are optional.
    pub fn parse(pattern: &str) -> Result<Self, PatternError> {
        let fail = |reason| PatternError {
            pattern: excerpt(pattern.as_bytes()),
            reason,
        };
        let (body, query) = pattern
            .strip_suffix('?')
            .map_or((pattern, false), |body| (body, true));
        if body.matches('[').count() > MAX_OPTIONAL as usize {
            return Err(fail("more than eight optional groups"));
        }
        let mut parser = PatternParser {
            rest: body,
            nodes: Vec::new(),
        };
        let ways = parser.group(0).map_err(fail)?;
        if !parser.rest.is_empty() {
            return Err(fail("a bracket is closed that was not opened"));
        }
        let ways: Vec<Vec<usize>> = ways.into_iter().filter(|way| !way.is_empty()).collect();
        if ways.is_empty() {
            Err(fail("the header has no node"))
        } else {
            Ok(Self {
                nodes: parser.nodes,
                ways,
                query,
            })
        }
    }

    /// Compares a header as sent (a leading colon and a final `?` included) with the pattern.
    /// Returns the numeric suffixes of the nodes marked `<n>` in their order, with 1 for an omitted
    /// suffix or node, or `None` if the header is another one.
    pub fn matches(&self, header: &str) -> Option<Vec<u32>> {
        let (body, query) = header
            .strip_suffix('?')
            .map_or((header, false), |body| (body, true));
        if query != self.query {
            return None;
        }
        let body = body.strip_prefix(':').unwrap_or(body);
        self.ways.iter().find_map(|way| self.matches_way(way, body))
    }

    fn matches_way(&self, way: &[usize], header: &str) -> Option<Vec<u32>> {
        let mut suffixes = vec![1; self.nodes.len()];
        let mut parts = header.split(':');
        for &index in way {
            let suffix = self.nodes.get(index)?.matches(parts.next()?)?;
            *suffixes.get_mut(index)? = suffix;
        }
        if parts.next().is_some() {
            return None;
        }
        Some(
            self.nodes
                .iter()
                .zip(suffixes)
                .filter(|(node, _)| node.numbered)
                .map(|(_, suffix)| suffix)
                .collect(),
        )
    }
}

impl Node {
    fn parse(text: &str) -> Result<Self, &'static str> {
        let (name, numbered) = text
            .strip_suffix("<n>")
            .map_or((text, false), |name| (name, true));
        let bare = name.strip_prefix('*').unwrap_or(name);
        if bare.is_empty()
            || !bare
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        {
            return Err(
                "a node is empty or holds other characters than letters, digits and underscores",
            );
        }
        let short_len = name
            .bytes()
            .take_while(|byte| !byte.is_ascii_lowercase())
            .count();
        let (short, tail) = name.split_at(short_len);
        if bare.starts_with(|first: char| first.is_ascii_lowercase())
            || tail.bytes().any(|byte| byte.is_ascii_uppercase())
        {
            return Err("a node is not written in capitals first, small letters after");
        }
        Ok(Self {
            short: short.to_owned(),
            long: name.to_ascii_uppercase(),
            numbered,
        })
    }

    /// Returns the suffix with which `mnemonic` is this node.
    fn matches(&self, mnemonic: &str) -> Option<u32> {
        let is_name = |name: &str| {
            name.eq_ignore_ascii_case(&self.short) || name.eq_ignore_ascii_case(&self.long)
        };
        // First as a whole, since names such as `CH1` end in a digit of their own.
        if is_name(mnemonic) {
            return Some(1);
        }
        let name = mnemonic.trim_end_matches(|c: char| c.is_ascii_digit());
        let suffix = mnemonic
            .get(name.len()..)
            .and_then(|digits| digits.parse::<u32>().ok())?;
        (is_name(name) && (self.numbered || suffix == 1)).then_some(suffix)
    }
}

struct PatternParser<'a> {
    rest: &'a str,
    nodes: Vec<Node>,
}

impl PatternParser<'_> {
    /// Reads nodes and groups up to the bracket that closes this one; answers every way to write
    /// them.
    fn group(&mut self, depth: u32) -> Result<Vec<Vec<usize>>, &'static str> {
        let mut ways: Vec<Vec<usize>> = vec![Vec::new()];
        loop {
            if let Some(rest) = self.rest.strip_prefix('[') {
                self.rest = rest;
                let inner = self.group(depth + 1)?;
                self.rest = self
                    .rest
                    .strip_prefix(']')
                    .ok_or("a bracket is not closed")?;
                let without = ways.clone();
                ways = joined(&ways, &inner);
                ways.extend(without);
            } else if self.rest.is_empty() || self.rest.starts_with(']') {
                return if depth > 0 && ways == [Vec::new()] {
                    Err("an empty pair of brackets")
                } else {
                    Ok(ways)
                };
            } else {
                let text = self.rest.strip_prefix(':').unwrap_or(self.rest);
                let end = text.find([':', '[', ']']).unwrap_or(text.len());
                let (node, rest) = text.split_at(end);
                // `[SOURce:]VOLTage`, with the colon inside the bracket, is a spelling of manuals
                // too.
                self.rest = if rest == ":" || rest.starts_with(":]") {
                    rest.get(1..).unwrap_or("")
                } else {
                    rest
                };
                self.nodes.push(Node::parse(node)?);
                let index = self.nodes.len() - 1;
                ways.iter_mut().for_each(|way| way.push(index));
            }
        }
    }
}

fn joined(heads: &[Vec<usize>], tails: &[Vec<usize>]) -> Vec<Vec<usize>> {
    heads
        .iter()
        .flat_map(|head| {
            tails
                .iter()
                .map(|tail| head.iter().chain(tail).copied().collect())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matches(pattern: &str, header: &str) -> Option<Vec<u32>> {
        Pattern::parse(pattern).unwrap().matches(header)
    }

    #[test]
    fn long_and_short_forms_match_and_nothing_between() {
        let pattern = "[:SOURce<n>]:VOLTage[:LEVel][:IMMediate]";
        let table = [
            ("volt", Some(1)),
            ("VOLTAGE", Some(1)),
            (":Volt", Some(1)),
            ("sour1:volt", Some(1)),
            ("SOURCE2:VOLT:LEV:IMM", Some(2)),
            ("sour12:voltage:immediate", Some(12)),
            ("VOLTA", None),
            ("VOL", None),
            ("SOURC:VOLT", None),
            ("VOLT2", None),
            ("VOLT:IMM:LEV", None),
            ("VOLT?", None),
            ("VOLT:", None),
            ("::VOLT", None),
            ("SOUR:", None),
            ("", None),
            ("SOUR99999999999:VOLT", None),
        ];
        for (header, suffix) in table {
            assert_eq!(
                matches(pattern, header),
                suffix.map(|suffix| vec![suffix]),
                "{header}"
            );
        }
    }

    #[test]
    fn suffixes_queries_and_nested_groups() {
        assert_eq!(
            matches(":CHANnel<n>:MEASure<n>?", "CHAN3:MEAS?"),
            Some(vec![3, 1])
        );
        assert_eq!(matches("*IDN?", "*idn?"), Some(vec![]));
        assert_eq!(matches("*IDN?", "*IDN"), None);
        assert_eq!(matches("INSTrument:CH1", "inst:ch1"), Some(vec![]));
        assert_eq!(
            matches("VOLTage[:LEVel[:IMMediate]]", "VOLT:LEV:IMM"),
            Some(vec![])
        );
        assert_eq!(
            matches("VOLTage[:LEVel[:IMMediate]]", "VOLT:IMM"),
            None,
            "an inner node needs its outer one"
        );
        assert_eq!(matches("[SOURce:]VOLTage", "SOUR:VOLT"), Some(vec![]));
        assert_eq!(matches("[SOURce:]VOLTage", "VOLT"), Some(vec![]));
        assert_eq!(matches("OUT_SP_00", "out_sp_00"), Some(vec![]));
    }

    #[test]
    fn mistaken_patterns_say_what_is_wrong() {
        let table = [
            ("", "the header has no node"),
            ("[:SOURce", "a bracket is not closed"),
            ("SOURce]", "a bracket is closed that was not opened"),
            ("A::B", "a node is empty"),
            ("source", "capitals first"),
            ("SOurCE", "capitals first"),
            ("A[]", "an empty pair of brackets"),
            (
                "A[:B][:B][:B][:B][:B][:B][:B][:B][:B]",
                "more than eight optional groups",
            ),
            ("A B", "other characters"),
        ];
        for (pattern, reason) in table {
            let message = Pattern::parse(pattern).unwrap_err().to_string();
            assert!(
                message.contains(reason) && message.contains(pattern),
                "{pattern}: {message}"
            );
        }
    }
}
