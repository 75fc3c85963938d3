//! The arrays of a `.mat` of Level 5.
//!
//! The layout follows MathWorks' "MAT-File Format", Level 5: after a head of 128 bytes, elements
//! with a type, a length and bytes that are padded to a multiple of eight; compressed elements
//! contain another element. Files of version 7.3 are HDF5 and are not supported.

use std::io::Read as _;

/// Bytes before the first element.
const HEAD: usize = 128;
/// Types of elements, by table 1-1 of the description.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays, by table 1-3: a cell array, a structure; from double on the numbers.
const CELLS: u8 = 1;
const STRUCTURE: u8 = 2;
const NUMBERS: std::ops::RangeInclusive<u8> = 6..=15;
/// Maximum size of a decompressed element: a day of ten columns at 1 kHz has 7 GB, more than any
/// record of a cycler.
const MOST_BYTES: u64 = 1 << 30;
/// Maximum depth of nested structures.
const DEEPEST: usize = 8;

/// Maximum number of names of variables that are kept.
const SHOWN: usize = 30;

/// A vector and its name.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Vector {
    pub(super) name: String,
    pub(super) values: Vec<f64>,
}

/// Vectors that belong together: variables, or fields of one structure.
#[derive(Debug, Default)]
pub(super) struct Group {
    /// Their path, such as `cycle(2).data`; empty for variables.
    pub(super) path: String,
    pub(super) vectors: Vec<Vector>,
    /// Time of the measurement, s since 1970, from a date vector beside them or above them.
    pub(super) begun_s: Option<f64>,
}

/// Contents of a file.
#[derive(Debug)]
pub(super) struct Contents {
    pub(super) groups: Vec<Group>,
    /// Names of all variables, each once, up to a maximum.
    pub(super) names: Vec<String>,
}

/// Reads the arrays of a file.
///
/// # Errors
/// Returns an error if the file is truncated or does not follow the layout.
pub(super) fn read(bytes: &[u8]) -> Result<Contents, String> {
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
    let vectors = reader.elements(bytes.get(HEAD..).unwrap_or_default())?;
    reader.groups.push(Group {
        vectors,
        ..Group::default()
    });
    let Reader {
        groups, mut names, ..
    } = reader;
    if names.len() > SHOWN {
        names.truncate(SHOWN);
        names.push("…".to_owned());
    }
    Ok(Contents { groups, names })
}

/// Converts MATLAB's date vector (year, month, day, hour, minute, second) to seconds since 1970.
fn date_s(values: &[f64]) -> Option<f64> {
    let &[year, month, day, hour, minute, second] = values else {
        return None;
    };
    let fits = (1970.0..=2100.0).contains(&year)
        && (1.0..=12.0).contains(&month)
        && (1.0..=31.0).contains(&day)
        && [year, month, day].iter().all(|value| value.fract() == 0.0);
    // Count days in years that begin in March, so that the leap day is the last day.
    let (year, month) = if month > 2.0 {
        (year, month - 3.0)
    } else {
        (year - 1.0, month + 9.0)
    };
    let leaps = (year / 4.0).floor() - (year / 100.0).floor() + (year / 400.0).floor();
    let days = 365.0 * year + leaps + ((153.0 * month + 2.0) / 5.0).floor() + day - 719_469.0;
    fits.then_some(86_400.0 * days + 3600.0 * hour + 60.0 * minute + second)
}

struct Reader {
    big: bool,
    groups: Vec<Group>,
    /// Names of all variables.
    names: Vec<String>,
}

/// An element: its type and its bytes.
struct Element<'a> {
    kind: u32,
    bytes: &'a [u8],
}

/// Context of an array: a default name and the path of its parent.
#[derive(Clone, Copy)]
struct At<'a> {
    name: Option<&'a str>,
    /// Path of the parent structure, with a trailing point; empty for variables.
    path: &'a str,
    depth: usize,
}

impl Reader {
    /// Reads the vectors of consecutive arrays.
    fn elements(&mut self, mut rest: &[u8]) -> Result<Vec<Vector>, String> {
        let top = At {
            name: None,
            path: "",
            depth: 0,
        };
        let mut vectors = Vec::new();
        while rest.len() >= 8 {
            let element = self.element(&mut rest)?;
            match element.kind {
                MATRIX => vectors.extend(self.array(element.bytes, top)?),
                COMPRESSED => {
                    let mut whole = Vec::new();
                    let mut decoder =
                        flate2::read::ZlibDecoder::new(element.bytes).take(MOST_BYTES);
                    let read = decoder.read_to_end(&mut whole);
                    read.map_err(|error| format!("a compressed variable: {error}"))?;
                    let mut inner = whole.as_slice();
                    let element = self.element(&mut inner)?;
                    if element.kind == MATRIX {
                        vectors.extend(self.array(element.bytes, top)?);
                    }
                }
                _ => {}
            }
        }
        Ok(vectors)
    }

    /// Reads the vector of an array of numbers; the fields of a structure become separate groups.
    fn array(&mut self, mut rest: &[u8], at: At<'_>) -> Result<Option<Vector>, String> {
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
        let count = sizes.iter().map(|size| u64::from(*size)).product();
        let own = self.element(&mut rest)?;
        let name = at.name.map_or_else(|| words(own.bytes), str::to_owned);
        let path = format!("{}{name}", at.path);
        if !self.names.contains(&name) && self.names.len() <= SHOWN {
            self.names.push(name.clone());
        }
        if class == STRUCTURE && at.depth < DEEPEST {
            self.structure(rest, count, At { path: &path, ..at })?;
            return Ok(None);
        }
        if class == CELLS && at.depth < DEEPEST {
            self.cells(rest, At { path: &path, ..at })?;
            return Ok(None);
        }
        // A vector has exactly one dimension greater than one.
        if !NUMBERS.contains(&class) || sizes.iter().filter(|size| **size != 1).count() > 1 {
            return Ok(None);
        }
        let numbers = self.element(&mut rest)?;
        let values = self.numbers(&numbers)?;
        Ok(Some(Vector { name, values }))
    }

    /// Reads the structures of an array of the given length; each becomes a group.
    fn structure(&mut self, mut rest: &[u8], count: u64, at: At<'_>) -> Result<(), String> {
        let length = self.element(&mut rest)?;
        let length = self.word(length.bytes, 0)? as usize;
        let names = self.element(&mut rest)?;
        let names: Vec<String> = names.bytes.chunks_exact(length.max(1)).map(words).collect();
        if names.is_empty() {
            return Ok(());
        }
        for nth in 1..=count {
            let own = if count > 1 {
                format!("{}({nth})", at.path)
            } else {
                at.path.to_owned()
            };
            let within = format!("{own}.");
            let before = self.groups.len();
            let mut vectors = Vec::new();
            for name in &names {
                let field = self.element(&mut rest)?;
                if field.kind == MATRIX {
                    let at = At {
                        name: Some(name),
                        path: &within,
                        depth: at.depth + 1,
                    };
                    vectors.extend(self.array(field.bytes, at)?);
                }
            }
            self.groups.push(Group {
                path: own,
                vectors,
                begun_s: None,
            });
            let added = &mut self.groups[before..];
            let date = |vector: &Vector| date_s(&vector.values);
            let begun_s = added
                .last()
                .and_then(|own| own.vectors.iter().find_map(date));
            for group in added.iter_mut().filter(|group| group.begun_s.is_none()) {
                group.begun_s = begun_s;
            }
        }
        Ok(())
    }

    /// Looks for structures in the cells of an array.
    fn cells(&mut self, mut rest: &[u8], at: At<'_>) -> Result<(), String> {
        let mut nth = 0;
        while rest.len() >= 8 {
            let cell = self.element(&mut rest)?;
            nth += 1;
            if cell.kind == MATRIX {
                let name = format!("{{{nth}}}");
                let at = At {
                    name: Some(&name),
                    path: at.path,
                    depth: at.depth + 1,
                };
                self.array(cell.bytes, at)?;
            }
        }
        Ok(())
    }

    /// Returns the next element and the bytes after it.
    fn element<'a>(&self, rest: &mut &'a [u8]) -> Result<Element<'a>, String> {
        let cut = || "the file ends within an element; it was cut off".to_owned();
        let tag = self.word(rest, 0)?;
        // Up to four bytes are stored within the tag.
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

    /// Reads numbers, which are stored in the smallest type that can represent them.
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

/// Reads a name, which may be padded with zeros.
fn words(bytes: &[u8]) -> String {
    let name: Vec<u8> = bytes
        .iter()
        .copied()
        .take_while(|byte| *byte != 0)
        .collect();
    String::from_utf8_lossy(&name).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn date_vectors_are_seconds_since_1970() {
        for (date, expected_s) in [
            ([1970.0, 1.0, 1.0, 0.0, 0.0, 0.0], 0.0),
            ([2000.0, 2.0, 29.0, 0.0, 0.0, 0.0], 951_782_400.0),
            ([2008.0, 3.0, 1.0, 12.0, 30.0, 1.5], 1_204_374_601.5),
        ] {
            assert_eq!(date_s(&date), Some(expected_s), "{date:?}");
        }
        assert_eq!(date_s(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), None);
    }
}
