//! Names of columns: which quantity, with which sign, in which unit.

/// A quantity of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Frequency,
    Real,
    Imaginary,
    Modulus,
    Phase,
}

impl Quantity {
    /// Its name in messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Frequency => "the frequency",
            Self::Real => "the real part of Z",
            Self::Imaginary => "the imaginary part of Z",
            Self::Modulus => "the modulus of Z",
            Self::Phase => "the phase of Z",
        }
    }

    /// Content of its column with the unit, for messages.
    pub(super) fn unit(self) -> &'static str {
        match self {
            Self::Frequency => "a frequency in Hz",
            Self::Phase => "an angle in deg or rad",
            _ => "an impedance in Ω",
        }
    }
}

/// A unit in a name or under it.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Unit {
    /// None is written.
    Unstated,
    /// Factor that converts a number to Hz, Ω or rad.
    Factor(f64),
    /// A unit that is wrong for the quantity or ambiguous: as written, and the reason.
    Refused(String, &'static str),
}

/// Interpretation of the name of a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Named {
    pub(super) quantity: Quantity,
    /// −1 for a minus before the name.
    pub(super) sign: f64,
    pub(super) unit: Unit,
    /// Whether the potentiostat's program has corrected the numbers for drift.
    pub(super) drift_corrected: bool,
}

const AREA: &str = "it is normalised to an area of unknown size";
const CASE: &str = "its case does not show whether it is milli or mega";
const UNKNOWN: &str = "it is not known";

/// Parses the name of a column; returns `None` if it does not belong to a spectrum.
pub(super) fn named(name: &str) -> Option<Named> {
    let written = plain(name);
    split(&written)
        .into_iter()
        .find_map(|Split { base, unit, sure }| {
            let (quantity, sign, drift_corrected) = base_of(&base)?;
            let unit = match unit {
                None => Unit::Unstated,
                Some(text) => unit_of(quantity, &text)?,
            };
            // Any text may follow a blank or an underscore.
            let taken = sure && !short(&base) || !matches!(unit, Unit::Refused(_, UNKNOWN));
            // A bare Z is a modulus only with a unit of impedance.
            let bare = matches!(base.trim_start_matches('-'), "z" | "impedance")
                && quantity == Quantity::Modulus
                && !matches!(unit, Unit::Factor(_) | Unit::Refused(_, AREA));
            (taken && !bare).then_some(Named {
                quantity,
                sign,
                unit,
                drift_corrected,
            })
        })
}

/// Returns whether a name is that of an impedance in Digatron's exports, which are in mΩ without a
/// unit.
pub(super) fn is_of_digatron(name: &str) -> bool {
    let name = name.trim().to_lowercase();
    ["zreal1", "zimg1", "zimag1"].contains(&name.as_str())
}

/// Parses a field under a name as a unit; returns `None` if it is empty.
pub(super) fn unit_under(quantity: Quantity, field: &str) -> Option<Unit> {
    let text = plain(field);
    unit_of(quantity, text.trim_matches(['(', ')', '[', ']']))
}

/// Replaces typographic characters in a name by ASCII.
fn plain(name: &str) -> String {
    let mut text = String::new();
    for c in name.trim().chars() {
        match c {
            '′' | '’' | '‘' | '´' => text.push('\''),
            '″' | '”' | '“' => text.push('"'),
            '−' | '–' => text.push('-'),
            'Ω' | '\u{2126}' => text.push_str("ohm"),
            'μ' => text.push('µ'),
            '²' => text.push('2'),
            '·' | '⋅' | '×' => text.push('.'),
            '（' => text.push('('),
            '）' => text.push(')'),
            other => text.push(other),
        }
    }
    text.replace("''", "\"")
}

/// A notation that separates a name from its unit.
struct Split {
    base: String,
    unit: Option<String>,
    /// Whether the separator is unambiguous.
    sure: bool,
}

fn split(written: &str) -> Vec<Split> {
    let base = |text: &str| -> String {
        let joined: String = text
            .chars()
            .filter(|c| !c.is_whitespace() && *c != '_')
            .flat_map(char::to_lowercase)
            .collect();
        let joined = joined.trim_end_matches(['.', ':', ',']);
        // RelaxIS.
        joined.strip_prefix("data:").unwrap_or(joined).to_owned()
    };
    let mut ways = vec![Split {
        base: base(written),
        unit: None,
        sure: true,
    }];
    let mut way = |parts: Option<(&str, &str)>, sure: bool| {
        if let Some((name, unit)) = parts {
            ways.push(Split {
                base: base(name),
                unit: Some(
                    unit.trim()
                        .trim_matches(['(', ')', '[', ']'])
                        .trim()
                        .to_owned(),
                ),
                sure,
            });
        }
    };
    way(written.split_once('/'), true);
    way(written.rsplit_once(" in "), true);
    way(
        written
            .strip_suffix(']')
            .and_then(|text| text.rsplit_once('[')),
        true,
    );
    way(
        written
            .strip_suffix(')')
            .and_then(|text| text.rsplit_once('(')),
        true,
    );
    way(written.rsplit_once('_'), false);
    way(written.rsplit_once(char::is_whitespace), false);
    ways
}

/// Ambiguous names.
fn short(base: &str) -> bool {
    matches!(
        base.trim_start_matches('-'),
        "re" | "im"
            | "real"
            | "imag"
            | "imaginary"
            | "f"
            | "z"
            | "phase"
            | "theta"
            | "phi"
            | "angle"
            | "abs"
            | "hz"
            | "rs"
            | "xs"
            | "r"
            | "x"
    )
}

/// Suffixes of the names of corrected curves, the longer first; `DrCor` is Gamry's.
const CORRECTED: [&str; 7] = [
    "(driftcorrected)",
    "driftcorrected",
    "(corrected)",
    "corrected",
    "(corr)",
    "corr",
    "drcor",
];

/// Returns the quantity of a name without unit, its sign, and whether it is corrected for drift.
fn base_of(base: &str) -> Option<(Quantity, f64, bool)> {
    let negated = ["-", "neg.", "neg", "minus"]
        .iter()
        .find_map(|minus| base.strip_prefix(minus));
    let (sign, base) = match negated {
        Some(rest) => (-1.0, rest),
        None => (1.0, base),
    };
    // Columns of one technique in a file with others.
    let base = base.strip_prefix("eis").unwrap_or(base);
    let corrected = CORRECTED
        .iter()
        .find_map(|suffix| base.strip_suffix(suffix));
    let (drift_corrected, base) = (corrected.is_some(), corrected.unwrap_or(base));
    let quantity = match base {
        "f" | "freq" | "freqs" | "frequency" | "hz" | "frequenz" | "fréquence" | "frequence"
        | "频率" | "测试频率" | "actfreq" => Quantity::Frequency,
        // ZPlot's (a) and (b) are not units.
        "z'" | "z'(a)" | "re" | "real" | "zre" | "zreal" | "rez" | "realz" | "re(z)"
        | "real(z)" | "realpart" | "impedancereal" | "realimpedance" | "rs" | "r" | "zrealpart"
        | "zreal1" | "realteil" | "partieréelle" | "partiereelle" | "实部" | "阻抗实部"
        | "z实部" => Quantity::Real,
        "z\"" | "z\"(b)" | "im" | "imag" | "imaginary" | "zim" | "zimg" | "zimag" | "imz"
        | "imagz" | "im(z)" | "imag(z)" | "imaginarypart" | "impedanceimag"
        | "impedanceimaginary" | "imagimpedance" | "imaginaryimpedance" | "zimaginary"
        | "reactance" | "xs" | "x" | "zimagpart" | "zimg1" | "zimag1" | "imaginärteil"
        | "imaginaerteil" | "partieimaginaire" | "虚部" | "阻抗虚部" | "z虚部" => {
            Quantity::Imaginary
        }
        "|z|" | "zmod" | "zabs" | "abs" | "absz" | "mod(z)" | "abs(z)" | "modulus" | "zmodulus"
        | "magnitude" | "zmagnitude" | "impedancemodulus" | "impedancemagnitude" | "z"
        | "impedance" | "zmag" | "z-mag" | "absoluteimpedance" | "betrag" | "impedanz"
        | "impedanzbetrag" | "module" | "模值" | "阻抗模值" | "阻抗模" => {
            Quantity::Modulus
        }
        "phase" | "phase(z)" | "zphz" | "zphase" | "phasez" | "phaseangle" | "impedancephase"
        | "theta" | "phi" | "angle" | "arg(z)" | "θ" | "φ" | "theta(z)" | "phasenwinkel"
        | "相位" | "相位角" | "相角" => Quantity::Phase,
        _ => return None,
    };
    // A frequency and a modulus cannot be negative.
    let negative = sign < 0.0 && matches!(quantity, Quantity::Frequency | Quantity::Modulus);
    (!negative).then_some((quantity, sign, drift_corrected))
}

fn unit_of(quantity: Quantity, written: &str) -> Option<Unit> {
    let text: String = written.chars().filter(|c| !c.is_whitespace()).collect();
    if text.is_empty() {
        return None;
    }
    let refused = |why| Unit::Refused(written.trim().to_owned(), why);
    Some(match quantity {
        Quantity::Phase => angle(&text).map_or_else(|| refused(UNKNOWN), Unit::Factor),
        Quantity::Frequency => {
            prefixed(&text, &["hz", "hertz"]).unwrap_or_else(refused_as(&refused))
        }
        _ if text.to_lowercase().contains("cm") || text.contains("m2") || text.contains("m^2") => {
            refused(AREA)
        }
        _ => prefixed(&text, &["ohm", "ohms"]).unwrap_or_else(refused_as(&refused)),
    })
}

fn refused_as<'a>(
    refused: &'a impl Fn(&'static str) -> Unit,
) -> impl Fn(&'static str) -> Unit + 'a {
    move |why| refused(why)
}

fn angle(text: &str) -> Option<f64> {
    let degree = std::f64::consts::PI / 180.0;
    match text.to_lowercase().as_str() {
        "deg" | "deg." | "degree" | "degrees" | "°" => Some(degree),
        "rad" | "radian" | "radians" => Some(1.0),
        "mrad" => Some(1.0e-3),
        _ => None,
    }
}

/// Returns the factor of a unit with an SI prefix; else the reason why there is none.
fn prefixed(text: &str, units: &[&str]) -> Result<Unit, &'static str> {
    let lower = text.to_lowercase();
    let unit = units
        .iter()
        .find(|unit| lower.ends_with(**unit))
        .ok_or(UNKNOWN)?;
    let (prefix, symbol) = text
        .split_at_checked(text.len() - unit.len())
        .ok_or(UNKNOWN)?;
    let all_upper = symbol.chars().all(char::is_uppercase);
    let all_lower = symbol.chars().all(char::is_lowercase);
    let factor = match prefix {
        "" => 1.0,
        "k" | "K" => 1.0e3,
        // All programs write milliohms in this way; in MHZ and mhz the case applies to the whole
        // word.
        "m" if *unit != "hz" || !all_lower => 1.0e-3,
        "M" if !all_upper => 1.0e6,
        "m" | "M" => return Err(CASE),
        "µ" | "u" => 1.0e-6,
        "n" => 1.0e-9,
        "G" => 1.0e9,
        "milli" => 1.0e-3,
        _ => return Err(UNKNOWN),
    };
    Ok(Unit::Factor(factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_quantity_sign_and_unit() {
        use Quantity::{Frequency, Imaginary, Modulus, Phase, Real};
        let degree = std::f64::consts::PI / 180.0;
        for (name, quantity, sign, factor) in [
            ("Frequency (Hz)", Frequency, 1.0, Some(1.0)),
            ("freq. [kHz]", Frequency, 1.0, Some(1e3)),
            ("f/mHz", Frequency, 1.0, Some(1e-3)),
            ("Freq", Frequency, 1.0, None),
            ("Zre (ohms)", Real, 1.0, Some(1.0)),
            ("Re(Z) / mOhm", Real, 1.0, Some(1e-3)),
            ("Z' (MΩ)", Real, 1.0, Some(1e6)),
            ("Z'(a)", Real, 1.0, None),
            ("Z Real", Real, 1.0, None),
            ("-Z''", Imaginary, -1.0, None),
            ("−Z″ / Ω", Imaginary, -1.0, Some(1.0)),
            ("Z\"/ohm", Imaginary, 1.0, Some(1.0)),
            ("-Im(Z)/Ohm", Imaginary, -1.0, Some(1.0)),
            ("z_im_kohm", Imaginary, 1.0, Some(1e3)),
            ("Zreal Ohm", Real, 1.0, Some(1.0)),
            ("|Z|/Ohm", Modulus, 1.0, Some(1.0)),
            ("Impedance/Ohm", Modulus, 1.0, Some(1.0)),
            ("Phase(Z)/deg", Phase, 1.0, Some(degree)),
            ("-Phase (°)", Phase, -1.0, Some(degree)),
            ("Zphz", Phase, 1.0, None),
            ("Hz", Frequency, 1.0, None),
            ("ActFreq", Frequency, 1.0, None),
            ("Zreal1", Real, 1.0, None),
            ("Zimg1", Imaginary, 1.0, None),
            ("EIS_f_Hz", Frequency, 1.0, Some(1.0)),
            ("EIS_Z_Re_Ohm", Real, 1.0, Some(1.0)),
            ("impedance_real", Real, 1.0, None),
            ("Real Impedance / Ohm", Real, 1.0, Some(1.0)),
            ("Impedance imaginary (Ω)", Imaginary, 1.0, Some(1.0)),
            ("Rs [mOhm]", Real, 1.0, Some(1e-3)),
            ("Xs [mOhm]", Imaginary, 1.0, Some(1e-3)),
            ("Z Modulus (Ohm)", Modulus, 1.0, Some(1.0)),
            ("abs", Modulus, 1.0, None),
            ("angle (deg)", Phase, 1.0, Some(degree)),
        ] {
            let met = named(name).unwrap_or_else(|| panic!("{name}"));
            let unit = factor.map_or(Unit::Unstated, Unit::Factor);
            assert_eq!(
                (met.quantity, met.sign, met.unit),
                (quantity, sign, unit),
                "{name}"
            );
        }
        for name in [
            "Re(Y)/Ohm-1",
            "Phase(Y)/deg",
            "Re(Zce)/Ohm",
            "|Y|",
            "Time/s",
            "Z",
            "Impedance",
            "E(V)",
            "Re(I)",
            "f_max",
            "Z2 Real",
            "Phase shift (x)",
            "real time",
        ] {
            assert_eq!(named(name), None, "{name}");
        }
        for (name, why) in [
            ("Z'/Ohm·cm²", AREA),
            ("Z (mOhm cm2)", AREA),
            ("Zre (quatloos)", UNKNOWN),
            ("freq (mhz)", CASE),
            ("Zreal [MOHM]", CASE),
        ] {
            assert!(
                matches!(named(name).unwrap().unit, Unit::Refused(_, met) if met == why),
                "{name}: {:?}",
                named(name)
            );
        }
    }
}
