//! Describes the settings of an instrument for a person, if a reply is not as expected. Raw replies
//! and masks are for the log.

use instruments_scpi::{message::parse_response, number::parse_bool};

use super::expect::{Expect, field, hex_word, leading_number, plain};

/// One setting of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    /// The query for it; `#` stands for any digit.
    pub question: &'static str,
    /// Name, as in "its output is off".
    pub name: &'static str,
    /// Meaning of its answers.
    pub says: Says,
    /// The setting reports whether the instrument's output or input is on, or whether a bath is
    /// controlled.
    pub is_switch: bool,
    /// What is not known on a unit that does not answer the query; `None` if every unit must.
    pub without: Option<&'static str>,
}

/// How the answers of a setting are to be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Says {
    /// A number with this unit.
    Number(&'static str),
    /// Four hexadecimal digits at the end: hundredths of this unit in two's complement.
    Hundredths(&'static str),
    /// One of these states. Another state is only reported as not one of them.
    States(&'static [(Shows, &'static str)]),
}

/// How an answer shows a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// It is this keyword.
    Word(&'static str),
    /// It holds this text.
    Text(&'static str),
    /// Its field of this name has this keyword.
    Field(&'static str, &'static str),
    /// A status word whose bits under this mask have this value.
    Bits(u32, u32),
}

/// A switch.
pub const ON_OFF: Says = Says::States(&[
    (Shows::Word("1"), "on"),
    (Shows::Word("ON"), "on"),
    (Shows::Word("0"), "off"),
    (Shows::Word("OFF"), "off"),
]);
/// Setting whose values have no names: an error only states that it has another value.
pub const CHOSEN: Says = Says::States(&[]);

/// Fields of a generator's answers, and their units.
const FIELDS: [(&str, &str, &str); 6] = [
    ("FRQ", "frequency", "Hz"),
    ("AMP", "amplitude", "Vpp"),
    ("OFST", "offset", "V"),
    ("TIME", "number of periods of a burst", ""),
    ("STPS", "phase at which a burst begins", "°"),
    ("DLAY", "delay of a burst", "s"),
];

fn with_unit(value: f64, unit: &str) -> String {
    match unit {
        "" | "°" => format!("{}{unit}", plain(value)),
        _ => format!("{} {unit}", plain(value)),
    }
}

impl Setting {
    /// Creates a setting whose reply is a number.
    pub const fn number(question: &'static str, name: &'static str, unit: &'static str) -> Self {
        Self {
            question,
            name,
            says: Says::Number(unit),
            is_switch: false,
            without: None,
        }
    }

    /// Creates a setting that has states.
    pub const fn state(question: &'static str, name: &'static str, says: Says) -> Self {
        Self {
            question,
            name,
            says,
            is_switch: false,
            without: None,
        }
    }

    /// Creates the setting that reports whether the instrument's output or input is on, or whether
    /// a bath is controlled.
    pub const fn switch(question: &'static str, name: &'static str, says: Says) -> Self {
        Self {
            question,
            name,
            says,
            is_switch: true,
            without: None,
        }
    }

    /// Marks a setting whose query some firmware does not know; `without` is what is not known then.
    pub const fn optional(self, without: &'static str) -> Self {
        Self {
            without: Some(without),
            ..self
        }
    }

    /// Returns what is not known without the answer to a query, or `None` if it must be answered.
    pub fn missing(settings: &[Self], question: &str) -> Option<&'static str> {
        let mut asked = settings.iter().filter(|setting| setting.answers(question));
        asked.find_map(|setting| setting.without)
    }

    /// Returns whether a reply shows that a switch is on, or `None` if the query was another one.
    pub fn shows_on(&self, question: &str, answer: &str) -> Option<bool> {
        match self
            .found(answer)
            .filter(|_| self.answers(question))?
            .as_str()
        {
            "on" => Some(true),
            "off" => Some(false),
            _ => None,
        }
    }

    fn answers(&self, question: &str) -> bool {
        let same =
            |(pattern, met): (u8, u8)| pattern == met || (pattern == b'#' && met.is_ascii_digit());
        self.question.len() == question.len()
            && self.question.bytes().zip(question.bytes()).all(same)
    }

    /// Returns the expected value as text, or `None` if the expectation does not concern this
    /// setting.
    fn wanted(&self, expect: &Expect) -> Option<String> {
        match (self.says, expect) {
            (Says::Number(unit), Expect::Number { value, tolerance }) => {
                Some(number(*value, *tolerance, unit))
            }
            (Says::Number(unit), Expect::Magnitude { value, .. }) => {
                Some(format!("±{}", with_unit(*value, unit)))
            }
            (Says::Hundredths(unit), Expect::Contains(text)) => {
                hundredths(text).map(|value| with_unit(value, unit))
            }
            (Says::States(states), _) => states
                .iter()
                .find(|(shows, _)| shows.is_meant_by(expect))
                .map(|(_, word)| (*word).to_owned()),
            _ => None,
        }
    }

    /// Returns the meaning of a reply as text, or `None` if it has no known meaning.
    fn found(&self, answer: &str) -> Option<String> {
        match self.says {
            Says::Number(unit) => {
                let fields = parse_response(answer);
                let numbers: Option<Vec<String>> = fields
                    .iter()
                    .map(|field| leading_number(&field.text).map(|value| with_unit(value, unit)))
                    .collect();
                numbers
                    .filter(|numbers| !numbers.is_empty())
                    .map(|numbers| numbers.join(" and "))
            }
            Says::Hundredths(unit) => hundredths(answer).map(|value| with_unit(value, unit)),
            Says::States(states) => states
                .iter()
                .find(|(shows, _)| shows.is_in(answer))
                .map(|(_, word)| (*word).to_owned()),
        }
    }
}

impl Shows {
    fn is_in(self, answer: &str) -> bool {
        match self {
            Self::Word(word) => answer.trim().eq_ignore_ascii_case(word),
            Self::Text(text) => answer
                .to_ascii_uppercase()
                .contains(&text.to_ascii_uppercase()),
            Self::Field(key, word) => {
                field(answer, key).is_some_and(|met| met.eq_ignore_ascii_case(word))
            }
            Self::Bits(mask, bits) => hex_word(answer).is_some_and(|word| word & mask == bits),
        }
    }

    fn is_meant_by(self, expect: &Expect) -> bool {
        match (self, expect) {
            (Self::Word(word), Expect::Word(words)) => words.contains(&word),
            (Self::Word(word), Expect::Switch(on)) => parse_bool(word).is_ok_and(|met| met == *on),
            (Self::Text(text), Expect::Contains(expected)) => text == expected,
            (Self::Field(key, word), Expect::FieldWord(expected, met)) => {
                key == *expected && word == *met
            }
            (
                Self::Bits(mask, bits),
                Expect::Bits {
                    mask: other,
                    bits: met,
                },
            ) => mask == *other && bits == *met,
            _ => false,
        }
    }
}

/// Returns the set value as text. A smallest value, which each instrument rounds differently, is
/// given as the limit that it stays below.
fn number(value: f64, tolerance: f64, unit: &str) -> String {
    let at_most = value > 0.0 && (value - tolerance).abs() <= 1.0e-9 * value;
    if at_most {
        format!("at most {}", with_unit(value + tolerance, unit))
    } else {
        with_unit(value, unit)
    }
}

/// Hundredths in two's complement in the last four of eight characters.
fn hundredths(answer: &str) -> Option<f64> {
    let digits = answer.trim().get(4..8)?;
    u16::from_str_radix(digits, 16)
        .ok()
        .map(|value| f64::from(value.cast_signed()) / 100.0)
}

/// Difference between a reply and a setting, as text.
pub(super) struct Differs {
    /// State that was found, as in "its output is off".
    pub(super) found: String,
    /// State that it should have.
    pub(super) wanted: String,
    /// It was set, rather than left so.
    number: bool,
}

impl Differs {
    /// Returns the difference as text, for settings of this run, or `None` if the reply is as
    /// expected.
    pub(super) fn of(
        settings: &[Setting],
        question: &str,
        expect: &Expect,
        answer: &str,
    ) -> Option<Self> {
        expect.judge(answer).err()?;
        match expect {
            Expect::All(all) => all
                .iter()
                .find_map(|expect| Self::of(settings, question, expect, answer)),
            Expect::Fields(fields) => fields.iter().find_map(|(key, value, tolerance)| {
                Expect::Fields(vec![(key, *value, *tolerance)])
                    .judge(answer)
                    .err()?;
                let (_, name, unit) = FIELDS.iter().find(|(known, ..)| known == key)?;
                let met = field(answer, key)
                    .and_then(leading_number)
                    .map_or_else(|| "no number".to_owned(), |met| with_unit(met, unit));
                Some(Self {
                    found: format!("its {name} is {met}"),
                    wanted: number(*value, *tolerance, unit),
                    number: true,
                })
            }),
            _ => {
                let of_question = || settings.iter().filter(|setting| setting.answers(question));
                let meant =
                    of_question().find_map(|setting| Some((setting, setting.wanted(expect)?)));
                let (setting, wanted) = meant.or_else(|| {
                    of_question()
                        .next()
                        .map(|setting| (setting, "as it was set".to_owned()))
                })?;
                let number = !matches!(setting.says, Says::States(_));
                let met = setting.found(answer).filter(|met| *met != wanted);
                Some(Self {
                    found: format!(
                        "its {} is {}",
                        setting.name,
                        met.as_deref().unwrap_or("another")
                    ),
                    wanted,
                    number,
                })
            }
        }
    }
}

impl std::fmt::Display for Differs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            found,
            wanted,
            number,
        } = self;
        if *number {
            write!(f, "{found}, this run set {wanted}")
        } else {
            write!(f, "{found}, this run left it {wanted}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments_domain::units::{Amps, Celsius, Hertz, Volts};

    use crate::exchange::Exchange;

    const SETTINGS: &[Setting] = &[
        Setting::state("OUTP#?", "output", ON_OFF),
        Setting::state(
            "STAT?",
            "output",
            Says::States(&[
                (Shows::Bits(0x10, 0x10), "on"),
                (Shows::Bits(0x10, 0), "off"),
            ]),
        ),
        Setting::state(
            "STAT?",
            "coupling",
            Says::States(&[
                (Shows::Bits(0xc, 0x4), "none"),
                (Shows::Bits(0xc, 0x8), "parallel"),
            ]),
        ),
        Setting::state(
            "MODE?",
            "mode",
            Says::States(&[(Shows::Word("0"), "voltage"), (Shows::Word("1"), "current")]),
        ),
        Setting::state(
            "C#:OUTP?",
            "output",
            Says::States(&[
                (Shows::Text("OUTP ON"), "on"),
                (Shows::Text("OUTP OFF"), "off"),
            ]),
        ),
        Setting::state("WAVE?", "wave", CHOSEN),
        Setting::number("CURR?", "current", "A"),
        Setting::number("LIM?", "limit of the current", "A"),
        Setting {
            question: "{M00****",
            name: "set-point",
            says: Says::Hundredths("°C"),
            is_switch: false,
            without: None,
        },
    ];

    fn difference(question: &str, expect: &Expect, answer: &str) -> Option<String> {
        Differs::of(SETTINGS, question, expect, answer).map(|differs| differs.to_string())
    }

    #[test]
    fn what_differs_is_described_in_words_and_never_in_masks() {
        let bits = |mask, bits| Expect::Bits { mask, bits };
        let contains = |text: &str| Expect::Contains(text.to_owned());
        for (question, expect, answer, words) in [
            (
                "OUTP1?",
                Expect::Switch(true),
                "0",
                "its output is off, this run left it on",
            ),
            (
                "STAT?",
                bits(0x10, 0x10),
                "0x0004",
                "its output is off, this run left it on",
            ),
            (
                "STAT?",
                bits(0xc, 0x4),
                "0x0018",
                "its coupling is parallel, this run left it none",
            ),
            (
                "STAT?",
                bits(0xc, 0x4),
                "rubbish",
                "its coupling is another, this run left it none",
            ),
            (
                "MODE?",
                Expect::Word(&["1", "CURR"]),
                "0",
                "its mode is voltage, this run left it current",
            ),
            (
                "C1:OUTP?",
                Expect::All(vec![contains("OUTP ON")]),
                "C1:OUTP OFF,LOAD,HZ",
                "its output is off, this run left it on",
            ),
            (
                "WAVE?",
                contains("NAME,eis1"),
                "NAME,old",
                "its wave is another, this run left it as it was set",
            ),
            (
                "CURR?",
                Expect::Number {
                    value: 0.1 + 0.2,
                    tolerance: 1e-3,
                },
                "2.000000",
                "its current is 2 A, this run set 0.3 A",
            ),
            (
                "LIM?",
                Expect::Magnitude {
                    value: 2.0,
                    tolerance: 1e-3,
                },
                "2.0E1, -2.0E1",
                "its limit of the current is 20 A and -20 A, this run set ±2 A",
            ),
            (
                "{M00****",
                contains("{S0009C4"),
                "{S001B58",
                "its set-point is 70 °C, this run set 25 °C",
            ),
        ] {
            assert_eq!(
                difference(question, &expect, answer).as_deref(),
                Some(words)
            );
        }
        let fields = Expect::Fields(vec![("AMP", 2.0, 0.01), ("OFST", 0.01, 0.01)]);
        assert_eq!(
            difference("C1:BSWV?", &fields, "AMP,4V,OFST,0V").as_deref(),
            Some("its amplitude is 4 Vpp, this run set 2 Vpp")
        );
        assert_eq!(
            difference("C1:BSWV?", &fields, "AMP,2V,OFST,1V").as_deref(),
            Some("its offset is 1 V, this run set at most 0.02 V")
        );
        assert_eq!(difference("OUTP1?", &Expect::Switch(true), "ON"), None);
    }

    /// Checks that each dialect has a description for each reply that a read-back may return.
    fn judged(model: &str, settings: &[Setting], scripts: &[Vec<Exchange>]) {
        for exchange in scripts.iter().flatten() {
            let (Exchange::Set {
                read_back, expect, ..
            }
            | Exchange::Ask {
                read_back: Some((read_back, expect)),
                ..
            }) = exchange
            else {
                continue;
            };
            let wrong = ["0x8888", "9e9"]
                .into_iter()
                .find(|answer| expect.judge(answer).is_err())
                .unwrap();
            let Some(differs) = Differs::of(settings, read_back, expect, wrong) else {
                panic!("{model}: no words for `{read_back}`")
            };
            let text = differs.to_string();
            assert!(
                !text.contains(read_back.as_str()) && !text.contains("0x"),
                "{model}: {text}"
            );
        }
    }

    #[test]
    fn everything_that_is_read_back_while_current_flows_has_words() {
        for dialect in crate::supply4q::DIALECTS {
            judged(
                dialect.key(),
                dialect.settings(),
                &[dialect.analog(true), dialect.output(true)],
            );
        }
        for dialect in crate::generator::DIALECTS {
            let sine = crate::generator::Sine {
                freq: Hertz(1.0),
                amplitude: Volts(0.1),
                offset: Volts(0.0),
            };
            let scripts = [
                dialect.output(1, true),
                dialect.sine(1, &sine),
                dialect.direct(1, Volts(0.0)),
                dialect.burst(1, Some(3)),
            ];
            judged(dialect.key(), dialect.settings(), &scripts);
        }
        for dialect in crate::load::DIALECTS {
            let draw = crate::load::Draw::Current(Amps(1.0));
            judged(
                dialect.key(),
                dialect.settings(),
                &[dialect.input(true), dialect.level(draw)],
            );
        }
        for dialect in crate::supply::DIALECTS {
            let charge = crate::supply::Charge {
                voltage: Volts(4.2),
                current: Amps(1.0),
            };
            judged(
                dialect.key(),
                dialect.settings(),
                &[dialect.prepare(&charge), dialect.output(true)],
            );
        }
        for dialect in crate::chiller::DIALECTS
            .iter()
            .filter(|dialect| dialect.pulse(0.0).is_none())
        {
            judged(
                dialect.key(),
                dialect.settings(),
                &[dialect.run(Some(Celsius(25.0)))],
            );
        }
    }
}
