//! Circuit description codes, the notation of pyimpspec and DearEIS (version 5.1) → a circuit, with
//! the values in the code as starts of a fit.
//!
//! ```text
//! code     = [ "!V=1!" ] series
//! series   = item { item }                 one after the other
//! item     = "[" series "]"  |  "(" item item { item } ")"  |  element
//! element  = symbol [ "{" [ value { "," value } ] [ ":" label ] "}" ]
//! value    = name "=" number [ "F" ] [ "/" lower [ "/" upper ] ]
//! ```
//! Elements are numbered from 1 in their kind, as pyimpspec's plots do; labels are not kept, nor are
//! limits, for the fit takes its limits from the data. One of our parameters may be made of several,
//! such as a pore's resistance of that per length and the length: it is known where all of them
//! are, and held where all that are written are held.

use super::element::ElementKind;
use super::parse::{Cursor, MAX_DEPTH, MAX_ELEMENTS, ParseError};
use super::{Circuit, Element, Node, ParameterKind};
use std::f64::consts::FRAC_1_SQRT_2;

/// A circuit as a user wrote it, with the values in the text.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenCircuit {
    /// The circuit.
    pub circuit: Circuit,
    /// Start values of a fit as (index of the parameter, value).
    pub guess: Vec<(usize, f64)>,
    /// Values that a fit holds, as (index of the parameter, value).
    pub constants: Vec<(usize, f64)>,
}

/// A symbol of the notation with its parameters, and the value that pyimpspec holds where none is
/// written.
struct Symbol {
    name: &'static str,
    parameters: &'static [(&'static str, Option<f64>)],
}

const fn symbol(name: &'static str, parameters: &'static [(&'static str, Option<f64>)]) -> Symbol {
    Symbol { name, parameters }
}

const HALF: (&str, Option<f64>) = ("n", Some(0.5));
const LENGTH: (&str, Option<f64>) = ("L", Some(1.0));

/// Symbols that are read. `Tlm` with circuits in its braces is not among them.
const SYMBOLS: [Symbol; 21] = [
    symbol("R", &[("R", None)]),
    symbol("C", &[("C", None)]),
    symbol("L", &[("L", None)]),
    symbol("La", &[("L", None), ("n", None)]),
    symbol("Q", &[("Y", None), ("n", None)]),
    symbol("W", &[("Y", None), HALF]),
    symbol("Wo", &[("Y", None), ("B", None), HALF]),
    symbol("Ws", &[("Y", None), ("B", None), HALF]),
    symbol("G", &[("Y", None), ("k", None), HALF]),
    symbol("Ga", &[("R", None), ("tau", None), HALF]),
    symbol(
        "H",
        &[("dC", None), ("tau", None), ("a", None), ("b", None)],
    ),
    symbol(
        "Ha",
        &[("R", None), ("tau", None), ("a", None), ("b", None)],
    ),
    symbol("K", &[("R", None), ("tau", None)]),
    symbol("Zarc", &[("R", None), ("tau", None), ("n", None)]),
    symbol(
        "Ls",
        &[
            ("R_i", None),
            ("R_r", None),
            ("Y", None),
            ("n", None),
            ("d", None),
        ],
    ),
    symbol("Tlmbo", &[("R_i", None), ("Y", None), ("n", None), LENGTH]),
    symbol("Tlmbs", &[("R_i", None), ("Y", None), ("n", None), LENGTH]),
    symbol(
        "Tlmbq",
        &[
            ("R_i", None),
            ("Y", None),
            ("n", None),
            ("Y_B", None),
            ("n_B", None),
            LENGTH,
        ],
    ),
    symbol(
        "Tlmno",
        &[
            ("R_i", None),
            ("R_ct", None),
            ("Y", None),
            ("n", None),
            LENGTH,
        ],
    ),
    symbol(
        "Tlmns",
        &[
            ("R_i", None),
            ("R_ct", None),
            ("Y", None),
            ("n", None),
            LENGTH,
        ],
    ),
    symbol(
        "Tlmnq",
        &[
            ("R_i", None),
            ("R_ct", None),
            ("Y", None),
            ("n", None),
            ("R_B", None),
            ("Y_B", None),
            ("n_B", None),
            LENGTH,
        ],
    ),
];

/// A value in the braces of an element.
#[derive(Debug, Clone, Copy)]
struct Value {
    value: f64,
    held: bool,
}

/// Values of one element by the names of its parameters.
struct Values<'a> {
    symbol: &'a Symbol,
    given: Vec<(usize, Value)>,
}

/// How one of our parameters follows from those of the notation.
struct Made {
    from: &'static [&'static str],
    make: fn(&[f64]) -> f64,
}

const fn made(from: &'static [&'static str], make: fn(&[f64]) -> f64) -> Made {
    Made { from, make }
}

fn same(v: &[f64]) -> f64 {
    v[0]
}

fn product(v: &[f64]) -> f64 {
    v.iter().product()
}

fn quotient(v: &[f64]) -> f64 {
    v[0] / v[1]
}

impl Values<'_> {
    fn index(&self, name: &str) -> Option<usize> {
        let mut parameters = self.symbol.parameters.iter();
        parameters.position(|(known, _)| *known == name)
    }

    /// Returns the value of a parameter from the text.
    fn written(&self, name: &str) -> Option<Value> {
        let index = self.index(name)?;
        let mut given = self.given.iter();
        given
            .find(|(given, _)| *given == index)
            .map(|(_, value)| *value)
    }

    /// Returns the value of a parameter from the text, or the one that pyimpspec holds.
    fn of(&self, name: &str) -> Option<Value> {
        self.written(name).or_else(|| {
            let value = self.symbol.parameters[self.index(name)?].1?;
            Some(Value { value, held: true })
        })
    }

    /// Returns whether the exponent n is the half that the plain elements have.
    fn is_half(&self) -> bool {
        self.of("n").is_some_and(|n| n.held && n.value == 0.5)
    }

    /// Our kind of element and how its parameters are made.
    ///
    /// The equations are those that pyimpspec documents. Its code for `Ls` differs from them
    /// (√(R_i·R_r) in the argument of coth where its documentation has √(R_i/R_r)); of those two
    /// only the documented one has consistent units, and with R_r = 1 they agree.
    fn kind(&self) -> (ElementKind, Vec<Made>) {
        use ElementKind as Kind;
        let half = self.is_half();
        let through = |name: &'static [&'static str]| made(name, same);
        match self.symbol.name {
            "R" => (Kind::R, vec![through(&["R"])]),
            "C" => (Kind::C, vec![through(&["C"])]),
            "L" => (Kind::L, vec![through(&["L"])]),
            "La" => (Kind::La, vec![through(&["L"]), through(&["n"])]),
            "Q" => (Kind::Cpe, vec![through(&["Y"]), through(&["n"])]),
            "W" if half => (Kind::W, vec![made(&["Y"], |v| FRAC_1_SQRT_2 / v[0])]),
            "W" => (Kind::Cpe, vec![through(&["Y"]), through(&["n"])]),
            "Wo" | "Ws" if half => {
                let kind = if self.symbol.name == "Wo" {
                    Kind::Wo
                } else {
                    Kind::Ws
                };
                let level = made(&["B", "Y"], |v| (v[0] / v[1]).sqrt());
                (kind, vec![level, through(&["B"])])
            }
            // coth((Bs)ⁿ)/(Ys)ⁿ is a pore of the exponent 2n: R = (B/Y)ⁿ, R·Q = B²ⁿ.
            "Wo" | "Ws" => {
                let kind = if self.symbol.name == "Wo" {
                    Kind::Tlmq
                } else {
                    Kind::Tlmbs
                };
                let level = made(&["B", "Y", "n"], |v| (v[0] / v[1]).powf(v[2]));
                let storage = made(&["B", "Y", "n"], |v| (v[0] * v[1]).powf(v[2]));
                (kind, vec![level, storage, made(&["n"], |v| 2.0 * v[0])])
            }
            "G" => {
                let level = made(&["Y", "k", "n"], |v| 1.0 / (v[0] * v[1].powf(v[2])));
                let time = made(&["k"], |v| 1.0 / v[0]);
                if half {
                    (Kind::G, vec![level, time])
                } else {
                    (Kind::Ga, vec![level, time, through(&["n"])])
                }
            }
            "Ga" if half => (Kind::G, vec![through(&["R"]), through(&["tau"])]),
            "Ga" => (
                Kind::Ga,
                vec![through(&["R"]), through(&["tau"]), through(&["n"])],
            ),
            "K" => (Kind::K, vec![through(&["R"]), through(&["tau"])]),
            "Zarc" => (
                Kind::Zarc,
                vec![through(&["R"]), through(&["tau"]), through(&["n"])],
            ),
            "H" | "Ha" => {
                let (kind, level) = if self.symbol.name == "H" {
                    (Kind::H, through(&["dC"]))
                } else {
                    (Kind::Ha, through(&["R"]))
                };
                (
                    kind,
                    vec![level, through(&["tau"]), through(&["a"]), through(&["b"])],
                )
            }
            "Ls" => (
                Kind::Ls,
                vec![
                    made(&["R_i", "d"], product),
                    made(&["R_r", "d"], quotient),
                    made(&["Y", "d", "R_r"], |v| v[0] * v[1] / v[2]),
                    through(&["n"]),
                ],
            ),
            name => Self::pore(name),
        }
    }

    /// Returns the pores: those that block have a resistance of the whole pore and a storage per
    /// length squared, the others both per length.
    fn pore(name: &str) -> (ElementKind, Vec<Made>) {
        use ElementKind as Kind;
        let blocking = || {
            vec![
                made(&["R_i"], same),
                made(&["Y", "L"], |v| v[0] * v[1] * v[1]),
                made(&["n"], same),
            ]
        };
        let end = || [made(&["Y_B"], same), made(&["n_B"], same)];
        let transfer = || {
            vec![
                made(&["R_i", "L"], product),
                made(&["R_ct", "L"], quotient),
                made(&["Y", "L"], product),
                made(&["n"], same),
            ]
        };
        match name {
            "Tlmbo" => (Kind::Tlmq, blocking()),
            "Tlmbs" => (Kind::Tlmbs, blocking()),
            "Tlmbq" => (Kind::Tlmbq, blocking().into_iter().chain(end()).collect()),
            "Tlmno" => (Kind::Ls, transfer()),
            "Tlmns" => (Kind::Tlmns, transfer()),
            _ => {
                let last = [made(&["R_B"], same)].into_iter().chain(end());
                (Kind::Tlmnq, transfer().into_iter().chain(last).collect())
            }
        }
    }
}

/// Returns whether a text is in this notation: it has brackets, braces, or a parenthesis that does
/// not belong to `p(`.
pub(super) fn is_code(text: &str) -> bool {
    let mut before = ' ';
    text.chars().any(|c| {
        let found = matches!(c, '[' | '{' | '!') || (c == '(' && before != 'p');
        if !c.is_whitespace() {
            before = c;
        }
        found
    })
}

/// Reads a circuit description code.
pub(super) fn read(text: &str) -> Result<WrittenCircuit, ParseError> {
    let mut reader = Reader {
        cursor: Cursor::new("circuit description code", text),
        counts: Vec::new(),
        elements: 0,
        parameters: 0,
        guess: Vec::new(),
        constants: Vec::new(),
    };
    if reader.cursor.take('!') {
        reader.cursor.run(|c| c != '!');
        if !reader.cursor.take('!') {
            return Err(reader.cursor.fail("\"!\" after the version"));
        }
    }
    let root = reader.series(0)?;
    reader.cursor.skip_blanks();
    if reader.cursor.peek().is_some() {
        return Err(reader.cursor.fail("an element, \"[\", \"(\" or the end"));
    }
    Ok(WrittenCircuit {
        circuit: Circuit::new(root),
        guess: reader.guess,
        constants: reader.constants,
    })
}

/// The reader: a cursor, its counters, and the values found so far.
struct Reader {
    cursor: Cursor,
    counts: Vec<(ElementKind, usize)>,
    elements: usize,
    parameters: usize,
    guess: Vec<(usize, f64)>,
    constants: Vec<(usize, f64)>,
}

impl Reader {
    fn series(&mut self, depth: usize) -> Result<Node, ParseError> {
        let mut items = Vec::new();
        self.items(depth, &mut items)?;
        Ok(if items.len() == 1 {
            items.remove(0)
        } else {
            // Brackets within brackets have no further meaning.
            let flat = items.into_iter().flat_map(|item| match item {
                Node::Series(children) => children,
                other => vec![other],
            });
            Node::Series(flat.collect())
        })
    }

    /// Takes one or more items.
    fn items(&mut self, depth: usize, items: &mut Vec<Node>) -> Result<(), ParseError> {
        loop {
            self.cursor.skip_blanks();
            match self.cursor.peek() {
                Some(open @ ('[' | '(')) => {
                    if depth == MAX_DEPTH {
                        let expected = format!("at most {MAX_DEPTH} levels of brackets");
                        return Err(self.cursor.fail(&expected));
                    }
                    self.cursor.take(open);
                    items.push(self.inner(open, depth + 1)?);
                }
                Some(c) if c.is_alphabetic() => items.push(self.element()?),
                _ if items.is_empty() => {
                    return Err(self.cursor.fail("an element such as R, \"[\" or \"(\""));
                }
                _ => return Ok(()),
            }
        }
    }

    fn inner(&mut self, open: char, depth: usize) -> Result<Node, ParseError> {
        let (node, close) = if open == '[' {
            (self.series(depth)?, ']')
        } else {
            let mut branches = Vec::new();
            self.items(depth, &mut branches)?;
            if branches.len() < 2 {
                return Err(self.cursor.fail("a second element in parallel"));
            }
            (Node::Parallel(branches), ')')
        };
        if self.cursor.take(close) {
            Ok(node)
        } else {
            Err(self.cursor.fail(&format!("an element or \"{close}\"")))
        }
    }

    fn element(&mut self) -> Result<Node, ParseError> {
        let start = self.cursor.index;
        let symbol = self.symbol()?;
        if self.elements == MAX_ELEMENTS {
            let expected = format!("at most {MAX_ELEMENTS} elements");
            return Err(self.cursor.fail_at(start, &expected, "one more".to_owned()));
        }
        self.elements += 1;
        let given = if self.cursor.take('{') {
            self.values(symbol)?
        } else {
            Vec::new()
        };
        let values = Values { symbol, given };
        let (kind, made) = values.kind();
        let first = self.parameters;
        self.parameters += kind.parameters().len();
        for (k, made) in made.iter().enumerate() {
            self.take_value(&values, made, start, first + k, &kind.parameters()[k])?;
        }
        let number = match self.counts.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => {
                *count += 1;
                *count
            }
            None => {
                self.counts.push((kind, 1));
                1
            }
        };
        Ok(Node::Element(Element {
            kind,
            name: format!("{}{number}", kind.name()),
            first,
        }))
    }

    /// Returns the longest symbol that comes next.
    fn symbol(&mut self) -> Result<&'static Symbol, ParseError> {
        let start = self.cursor.index;
        let found = SYMBOLS
            .iter()
            .filter(|symbol| self.cursor.comes(symbol.name))
            .max_by_key(|symbol| symbol.name.len());
        if let Some(symbol) = found {
            self.cursor.index += symbol.name.len();
            // No other symbol starts with `Tlm`, but `Wx` starts with W: the rest must not be part
            // of a word.
            if !self.cursor.peek().is_some_and(char::is_lowercase) {
                return Ok(symbol);
            }
        }
        self.cursor.index = start;
        let first = self.cursor.run(char::is_uppercase);
        let word = first + &self.cursor.run(char::is_lowercase);
        let known = SYMBOLS.map(|symbol| symbol.name).join(", ");
        Err(self.cursor.fail_at(
            start,
            &format!("one of the symbols {known}"),
            format!("{:?}", word.chars().take(8).collect::<String>()),
        ))
    }

    /// Returns the values in braces, the opening one taken.
    fn values(&mut self, symbol: &Symbol) -> Result<Vec<(usize, Value)>, ParseError> {
        let mut given: Vec<(usize, Value)> = Vec::new();
        loop {
            self.cursor.skip_blanks();
            if self.cursor.take(':') {
                self.cursor.run(|c| c != '}');
            }
            if self.cursor.take('}') {
                return Ok(given);
            }
            let start = self.cursor.index;
            let name = self.cursor.run(|c| c.is_alphanumeric() || c == '_');
            let index = symbol
                .parameters
                .iter()
                .position(|(known, _)| *known == name)
                .filter(|index| given.iter().all(|(known, _)| known != index));
            let Some(index) = index else {
                let known: Vec<&str> = symbol.parameters.iter().map(|(name, _)| *name).collect();
                let expected = format!("each of {} once, or \"}}\"", known.join(", "));
                return Err(self.cursor.fail_at(start, &expected, format!("{name:?}")));
            };
            if !self.cursor.take('=') {
                return Err(self.cursor.fail("\"=\" and a value"));
            }
            given.push((index, self.value()?));
            self.cursor.skip_blanks();
            // Limits are passed over.
            self.cursor.run(|c| !matches!(c, ',' | ':' | '}'));
            self.cursor.take(',');
        }
    }

    fn value(&mut self) -> Result<Value, ParseError> {
        self.cursor.skip_blanks();
        let start = self.cursor.index;
        let digits = self
            .cursor
            .run(|c| c.is_ascii_digit() || matches!(c, '.' | '+' | '-' | 'e' | 'E'));
        let Ok(value) = digits.parse::<f64>() else {
            let met = format!("{digits:?}");
            return Err(self.cursor.fail_at(start, "a number", met));
        };
        let held = self.cursor.take('F');
        Ok(Value { value, held })
    }

    /// Stores the value of one of our parameters if the text contains all its parts; `start` is the
    /// position of the element.
    fn take_value(
        &mut self,
        values: &Values,
        made: &Made,
        start: usize,
        index: usize,
        kind: &ParameterKind,
    ) -> Result<(), ParseError> {
        let parts: Vec<Value> = made
            .from
            .iter()
            .filter_map(|name| values.of(name))
            .collect();
        let written: Vec<Value> = made
            .from
            .iter()
            .filter_map(|name| values.written(name))
            .collect();
        // A value missing from the text is free, unless pyimpspec holds it.
        if parts.len() < made.from.len() || written.is_empty() {
            return Ok(());
        }
        let numbers: Vec<f64> = parts.iter().map(|part| part.value).collect();
        let value = (made.make)(&numbers);
        let (lower, upper) = kind.bounds;
        if !(lower..=upper).contains(&value) {
            let expected = format!(
                "values of {} that give a parameter from {lower:e} to {upper:e} {}",
                made.from.join(", "),
                kind.unit
            );
            let met = format!("{value:e}");
            return Err(self.cursor.fail_at(start, expected.trim_end(), met));
        }
        if written.iter().all(|part| part.held) {
            self.constants.push((index, value));
        } else {
            self.guess.push((index, value));
        }
        Ok(())
    }
}
