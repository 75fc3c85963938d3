//! Current and voltage over time in MATLAB's `.mat`, as the text of a cycler: the vectors `Time`,
//! `Voltage` and `Current`, alone or as fields of one structure (`meas`, in the data that Kollmeyer
//! has published).
//!
//! The layout is that of MathWorks' "MAT-File Format", Level 5: behind a head of 128 bytes elements
//! of a type, a length and bytes that are filled up to eight; compressed ones hold another. Files of
//! version 7.3 are HDF5 and are not read.

use super::error::FormatError;
use std::fmt::Write as _;
use std::io::Read as _;
use std::path::Path;

/// First bytes of a file of Level 5; one of 7.3 says `MATLAB 7.3`.
const MAGIC: &[u8] = b"MATLAB 5.0 MAT-file";
/// Bytes before the first element.
const HEAD: usize = 128;
/// Types of elements, by table 1-1 of the description.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays, by table 1-3: a structure; from double on the numbers.
const STRUCTURE: u8 = 2;
const NUMBERS: std::ops::RangeInclusive<u8> = 6..=15;
/// Most bytes that a compressed element may grow to: a day at 1 kHz of ten columns is 7 GB, which is
/// no record of a cycler.
const MOST_BYTES: u64 = 1 << 30;
/// Deepest structure within structures that is looked into.
const DEEPEST: usize = 8;

/// Names of a quantity in small letters, and the column that it becomes.
const NAMED: [(&[&str], &str); 4] = [
    (&["time", "time_s", "t"], "Time (s)"),
    (&["voltage", "voltage_v", "v"], "Voltage (V)"),
    (&["current", "current_a", "i"], "Current (A)"),
    (
        &["battery_temp_degc", "temperature_c", "temperature", "temp"],
        "Temperature (C)",
    ),
];
/// Of these the first must be there.
const NEEDED: usize = 3;

/// Vectors that stand together: variables, or fields of one structure.
type Vectors = Vec<(String, Vec<f64>)>;

/// The text of the one record of a file; nothing where it is none of MATLAB's.
///
/// # Errors
/// [`FormatError::Decode`] for a file that is cut off, or with none or several records.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<Result<String, FormatError>> {
    bytes.starts_with(MAGIC).then(|| {
        decoded(bytes).map_err(|reason| FormatError::Decode {
            file: path.to_owned(),
            kind: "a MATLAB .mat with a record over time",
            reason,
        })
    })
}

fn decoded(bytes: &[u8]) -> Result<String, String> {
    let big = match bytes.get(126..HEAD) {
        Some(b"IM") => false,
        Some(b"MI") => true,
        _ => return Err("the file ends within its head".to_owned()),
    };
    let mut reader = Reader {
        big,
        groups: Vec::new(),
        names: Vec::new(),
    };
    let variables = reader.elements(bytes.get(HEAD..).unwrap_or_default(), 0)?;
    reader.groups.push(variables);
    let records: Vec<Vec<(&str, &[f64])>> = reader.groups.iter().filter_map(record).collect();
    let [record] = records.as_slice() else {
        let (count, names) = (records.len(), reader.names.join(", "));
        return Err(format!(
            "expected vectors Time, Voltage and Current of one length once, met {count} such \
             records; its variables and fields are {names}"
        ));
    };
    let names: Vec<&str> = record.iter().map(|(name, _)| *name).collect();
    let mut text = names.join("\t") + "\n";
    for k in 0..record.first().map_or(0, |(_, values)| values.len()) {
        for (nth, (_, values)) in record.iter().enumerate() {
            // Writing to a string cannot fail; what is no number is left empty.
            let _ = match values.get(k).filter(|value| value.is_finite()) {
                Some(value) if nth > 0 => write!(text, "\t{value}"),
                Some(value) => write!(text, "{value}"),
                None => write!(text, "{}", if nth > 0 { "\t" } else { "" }),
            };
        }
        text.push('\n');
    }
    Ok(text)
}

/// The columns of a record, where the vectors are one.
fn record(vectors: &Vectors) -> Option<Vec<(&'static str, &[f64])>> {
    let find = |(names, column): &(&[&str], &'static str)| {
        let met = |name: &&str| vectors.iter().find(|(met, _)| met.to_lowercase() == *name);
        names
            .iter()
            .find_map(met)
            .map(|(_, values)| (*column, values.as_slice()))
    };
    let found: Vec<_> = NAMED.iter().map(find).collect();
    let (_, first) = found.first().copied().flatten()?;
    let whole = found[..NEEDED]
        .iter()
        .all(|one| one.is_some_and(|(_, values)| values.len() == first.len()));
    (whole && first.len() > 1).then(|| {
        found
            .into_iter()
            .flatten()
            .filter(|(_, values)| values.len() == first.len())
            .collect()
    })
}

struct Reader {
    big: bool,
    groups: Vec<Vectors>,
    /// Names of everything that was met.
    names: Vec<String>,
}

/// An element: its type and its bytes.
struct Element<'a> {
    kind: u32,
    bytes: &'a [u8],
}

impl Reader {
    /// Vectors of the arrays that follow each other.
    fn elements(&mut self, mut rest: &[u8], depth: usize) -> Result<Vectors, String> {
        let mut vectors = Vec::new();
        while rest.len() >= 8 {
            let element = self.element(&mut rest)?;
            match element.kind {
                MATRIX => vectors.extend(self.array(element.bytes, None, depth)?),
                COMPRESSED => {
                    let mut whole = Vec::new();
                    let mut decoder =
                        flate2::read::ZlibDecoder::new(element.bytes).take(MOST_BYTES);
                    let read = decoder.read_to_end(&mut whole);
                    read.map_err(|error| format!("a compressed variable: {error}"))?;
                    let mut inner = whole.as_slice();
                    let element = self.element(&mut inner)?;
                    if element.kind == MATRIX {
                        vectors.extend(self.array(element.bytes, None, depth)?);
                    }
                }
                _ => {}
            }
        }
        Ok(vectors)
    }

    /// The vector of an array of numbers; of a structure its fields go into a group of their own.
    fn array(
        &mut self,
        mut rest: &[u8],
        field: Option<&str>,
        depth: usize,
    ) -> Result<Option<(String, Vec<f64>)>, String> {
        // An empty field.
        if rest.is_empty() {
            return Ok(None);
        }
        let flags = self.element(&mut rest)?;
        let class = self.word(flags.bytes, 0)?.to_le_bytes()[0];
        let sizes = self.element(&mut rest)?;
        let count = sizes.bytes.chunks_exact(4).count();
        let sizes: Vec<u32> = (0..count)
            .map(|k| self.word(sizes.bytes, 4 * k))
            .collect::<Result<_, _>>()?;
        let own = self.element(&mut rest)?;
        let name = field.map_or_else(|| words(own.bytes), str::to_owned);
        self.names.push(name.clone());
        if class == STRUCTURE && depth < DEEPEST && sizes.iter().all(|size| *size == 1) {
            let group = self.structure(rest, depth)?;
            self.groups.push(group);
            return Ok(None);
        }
        // A vector has one size that is not one.
        if !NUMBERS.contains(&class) || sizes.iter().filter(|size| **size != 1).count() > 1 {
            return Ok(None);
        }
        let numbers = self.element(&mut rest)?;
        Ok(Some((name, self.numbers(&numbers)?)))
    }

    fn structure(&mut self, mut rest: &[u8], depth: usize) -> Result<Vectors, String> {
        let length = self.element(&mut rest)?;
        let length = self.word(length.bytes, 0)? as usize;
        let names = self.element(&mut rest)?;
        let mut vectors = Vec::new();
        for name in names.bytes.chunks_exact(length.max(1)).map(words) {
            let field = self.element(&mut rest)?;
            if field.kind == MATRIX {
                vectors.extend(self.array(field.bytes, Some(&name), depth + 1)?);
            }
        }
        Ok(vectors)
    }

    /// The next element; the rest begins behind it.
    fn element<'a>(&self, rest: &mut &'a [u8]) -> Result<Element<'a>, String> {
        let cut = || "the file ends within an element; it was cut off".to_owned();
        let tag = self.word(rest, 0)?;
        // Up to four bytes stand within the tag.
        let (kind, start, length) = if tag >> 16 == 0 {
            (tag, 8, self.word(rest, 4)? as usize)
        } else {
            (tag & 0xFFFF, 4, (tag >> 16) as usize)
        };
        let end = start + length;
        let bytes = rest.get(start..end).ok_or_else(cut)?;
        let filled = if start == 4 {
            8
        } else if kind == COMPRESSED {
            end
        } else {
            end.next_multiple_of(8)
        };
        *rest = rest.get(filled..).unwrap_or_default();
        Ok(Element { kind, bytes })
    }

    /// Numbers, which are stored in the smallest type that holds them.
    fn numbers(&self, element: &Element<'_>) -> Result<Vec<f64>, String> {
        let width = match element.kind {
            1 | 2 => 1,
            3 | 4 => 2,
            5..=7 => 4,
            9 | 12 | 13 => 8,
            other => return Err(format!("numbers of type {other}, which is not known")),
        };
        let number = |bytes: &[u8]| {
            let mut eight = [0; 8];
            for (place, byte) in bytes.iter().enumerate() {
                eight[if self.big { width - 1 - place } else { place }] = *byte;
            }
            let [a, b, c, d, ..] = eight;
            match element.kind {
                1 => f64::from(i8::from_le_bytes([a])),
                3 => f64::from(i16::from_le_bytes([a, b])),
                5 => f64::from(i32::from_le_bytes([a, b, c, d])),
                7 => f64::from(f32::from_le_bytes([a, b, c, d])),
                9 => f64::from_le_bytes(eight),
                12 => i64::from_le_bytes(eight) as f64,
                _ => u64::from_le_bytes(eight) as f64,
            }
        };
        Ok(element.bytes.chunks_exact(width).map(number).collect())
    }

    fn word(&self, bytes: &[u8], at: usize) -> Result<u32, String> {
        let four = bytes.get(at..).and_then(<[u8]>::first_chunk);
        let four = four.ok_or("the file ends within an element; it was cut off")?;
        Ok(if self.big {
            u32::from_be_bytes(*four)
        } else {
            u32::from_le_bytes(*four)
        })
    }
}

/// A name, which zeros may follow.
fn words(bytes: &[u8]) -> String {
    let name: Vec<u8> = bytes
        .iter()
        .copied()
        .take_while(|byte| *byte != 0)
        .collect();
    String::from_utf8_lossy(&name).into_owned()
}
