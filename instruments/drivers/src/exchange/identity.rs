//! Identity of an instrument: its answer to the question who it is.

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
    /// give maker and model by their first blank, and `#VER:model:firmware` is CAENels'.
    pub fn parse(raw: &str) -> Self {
        let raw = raw.trim().to_owned();
        if let Some((model, firmware)) = raw
            .strip_prefix("#VER:")
            .map(|rest| rest.split_once(':').unwrap_or((rest, "")))
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

    /// Whether a web server answered: the status line of HTTP/1.
    pub fn is_web_server(&self) -> bool {
        self.raw.starts_with("HTTP/1.")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_web_server_is_no_instrument() {
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
