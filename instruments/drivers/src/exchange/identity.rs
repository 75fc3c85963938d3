//! Identity of an instrument: its reply to the identity query.

use instruments_scpi::message::parse_response;

/// An identity, split into its parts.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Identity {
    /// The whole answer.
    pub raw: String,
    /// First field: the maker.
    pub maker: String,
    /// Second field: the model.
    pub model: String,
    /// Third field: the serial number; may be empty.
    pub serial: String,
    /// The rest: firmware.
    pub firmware: String,
}

impl Identity {
    /// Splits an `*IDN?` answer at its commas; answers without commas (old Kepco cards, Julabo)
    /// give maker and model by their first blank, `#VER:model:firmware` is CAENels', and `{S00`
    /// with four digits is Huber's set-point.
    pub fn parse(raw: &str) -> Self {
        // Older Siglent firmware repeats the header of the query.
        let raw = without_prefix(raw.trim(), "*IDN ").unwrap_or(raw.trim());
        let raw = raw.trim().to_owned();
        if let Some((model, firmware)) =
            without_prefix(&raw, "#VER:").map(|rest| rest.split_once(':').unwrap_or((rest, "")))
        {
            let (model, firmware) = (model.to_owned(), firmware.to_owned());
            return Self {
                raw,
                maker: "CAENels".to_owned(),
                model,
                serial: String::new(),
                firmware,
            };
        }
        // The reply is the set-point, which does not identify the unit.
        if without_prefix(&raw, "{S00").is_some() {
            return Self {
                raw,
                maker: "Huber".to_owned(),
                model: "PB".to_owned(),
                serial: String::new(),
                firmware: String::new(),
            };
        }
        let fields: Vec<String> = parse_response(&raw)
            .into_iter()
            .map(|field| field.text.trim().to_owned())
            .collect();
        let (maker, model, serial, firmware) = match fields.as_slice() {
            [maker, model, serial, rest @ ..] => {
                (maker.clone(), model.clone(), serial.clone(), rest.join(","))
            }
            _ => {
                let (maker, model) = raw.split_once(' ').unwrap_or((raw.as_str(), ""));
                (
                    maker.to_owned(),
                    model.to_owned(),
                    String::new(),
                    String::new(),
                )
            }
        };
        Self {
            raw,
            maker,
            model,
            serial,
            firmware,
        }
    }

    /// Returns the identity in capitals and with single spaces, none beside a comma: the form in
    /// which identities are compared.
    #[must_use]
    pub fn folded(&self) -> Self {
        Self {
            raw: fold(&self.raw),
            maker: canonical(fold(&self.maker)),
            model: fold(&self.model),
            serial: fold(&self.serial),
            firmware: fold(&self.firmware),
        }
    }

    /// Returns whether both replies belong to one instrument. Case and runs of spaces do not
    /// matter. If both report a serial number, maker, model and serial number decide: firmware may
    /// be updated. Otherwise everything that they report decides.
    pub fn is_same_instrument(&self, other: &Self) -> bool {
        let (one, other) = (self.folded(), other.folded());
        let named = |identity: &Self| (identity.maker.clone(), identity.model.clone());
        let numbered = one.has_serial() || other.has_serial();
        named(&one) == named(&other)
            && one.has_serial() == other.has_serial()
            && if numbered {
                one.serial == other.serial
            } else {
                one.firmware == other.firmware
            }
    }

    /// Returns whether the instrument reports a serial number: `0` counts as missing.
    pub fn has_serial(&self) -> bool {
        self.serial.chars().any(|c| !matches!(c, '0' | ' ' | '-'))
    }

    /// Returns whether a web server answered: the status line of HTTP/1.
    pub fn is_web_server(&self) -> bool {
        self.raw.starts_with("HTTP/1.")
    }
}

/// Makers by other names than their own: the families by which older Siglent firmware names itself.
const MAKERS: &[(&str, &[&str])] = &[("SIGLENT", &["SDG", "SDS", "SPD", "SDL", "SDM"])];

/// Returns the maker's own name.
fn canonical(maker: String) -> String {
    let known = MAKERS
        .iter()
        .find(|(_, names)| names.contains(&maker.as_str()));
    known.map_or(maker, |(name, _)| (*name).to_owned())
}

/// Converts a text to capitals, with single spaces and none beside a comma.
pub fn fold(text: &str) -> String {
    let fields = text.split(',').map(|field| {
        let words: Vec<&str> = field.split_whitespace().collect();
        words.join(" ")
    });
    fields.collect::<Vec<_>>().join(",").to_uppercase()
}

/// Returns the text after a prefix, in any case.
fn without_prefix<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let (head, rest) = text.split_at_checked(prefix.len())?;
    head.eq_ignore_ascii_case(prefix).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn case_and_spaces_do_not_make_another_instrument_and_a_serial_number_does() {
        let bop = "KEPCO,BOP1KW 50-20,E156884,2.01";
        for (one, other, same) in [
            (bop, "kepco , Bop1kw  50-20 ,e156884, 2.01", true),
            (bop, "KEPCO,BOP1KW 50-20,E156884,2.07", true),
            (bop, "KEPCO,BOP1KW 50-20,E156885,2.01", false),
            (bop, "KEPCO,BOP1KW 100-10,E156884,2.01", false),
            (bop, "KEPCO,BOP1KW 50-20,0,2.01", false),
            (
                "HEWLETT-PACKARD,34970A,0,13-2-2",
                "Hewlett-Packard,34970A, 0,13-2-2",
                true,
            ),
            (
                "HEWLETT-PACKARD,34970A,0,13-2-2",
                "HEWLETT-PACKARD,34970A,,13-2-2",
                true,
            ),
            (
                "HEWLETT-PACKARD,34970A,0,13-2-2",
                "HEWLETT-PACKARD,34970A,0,13-2-3",
                false,
            ),
            ("JULABO CF31 VERSION 5.0", "Julabo  CF31 version 5.0", true),
            ("JULABO CF31 VERSION 5.0", "JULABO CF31 VERSION 5.1", false),
            (
                "#VER:FAST-PS 2020-400:1.5.9",
                "#ver:fast-ps  2020-400:1.5.9",
                true,
            ),
            ("{S0009C4", "{S001388", true),
        ] {
            let (first, second) = (Identity::parse(one), Identity::parse(other));
            assert_eq!(first.is_same_instrument(&second), same, "{one} | {other}");
            assert_eq!(second.is_same_instrument(&first), same, "{other} | {one}");
        }
    }

    #[test]
    fn spellings_of_a_maker_fold() {
        for (answer, maker, model) in [
            (
                "*IDN SDG,SDG1032X,SDG1XABC,1.01.01.33R1B6",
                "SIGLENT",
                "SDG1032X",
            ),
            (
                "*idn SDS,SDS824X HD,SDS08A0X,4.8.12",
                "SIGLENT",
                "SDS824X HD",
            ),
            (
                "Siglent,SDL1020X-E,SDL13G,1.1.1.22",
                "SIGLENT",
                "SDL1020X-E",
            ),
            (
                "siglent technologies,SPD3303X,SPD3X,1.01",
                "SIGLENT TECHNOLOGIES",
                "SPD3303X",
            ),
            (
                "Rigol Technologies,dho804,DHO8A,00.01.03",
                "RIGOL TECHNOLOGIES",
                "DHO804",
            ),
        ] {
            let identity = Identity::parse(answer).folded();
            assert_eq!(
                (identity.maker.as_str(), identity.model.as_str()),
                (maker, model)
            );
        }
        let (one, other) = ("*IDN SDG,SDG1032X,7,1.0", "Siglent,SDG1032X,7,1.0");
        assert!(Identity::parse(one).is_same_instrument(&Identity::parse(other)));
    }

    #[test]
    fn a_web_server_is_not_an_instrument() {
        assert!(Identity::parse("HTTP/1.1 400 Bad Request").is_web_server());
        assert!(!Identity::parse("HTTP Instruments,X1,7,1.0").is_web_server());
    }

    #[test]
    fn identities_of_every_shape_are_read() {
        let kepco = Identity::parse("KEPCO,BOP1KW 50-20 ,E156884, 2.01");
        assert_eq!(
            (
                kepco.maker.as_str(),
                kepco.model.as_str(),
                kepco.serial.as_str()
            ),
            ("KEPCO", "BOP1KW 50-20", "E156884")
        );
        let card = Identity::parse("KEPCO BOP BIT232 REV. 3.1");
        assert_eq!(
            (card.maker.as_str(), card.model.as_str()),
            ("KEPCO", "BOP BIT232 REV. 3.1")
        );
        let spd =
            Identity::parse("Siglent Technologies,SPD3303X-E,SPD3XIDQ5R5553,1.01.01.02.07R2,V3.0");
        assert_eq!(spd.firmware, "1.01.01.02.07R2,V3.0");
    }
}
