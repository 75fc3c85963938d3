//! The identity of a cell: the section `[identity]` of a cell file, and `[specimen]` of an
//! experiment, which names the one cell that is measured.

use serde::{Deserialize, Serialize};

use super::source::{ConfigError, Source};
use crate::plan::Specimen;

/// Longest text of an identity, characters.
const LONGEST: usize = 200;

/// Identity of a cell, or of a kind of cell.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Serial number. Left out: not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Batch or lot that it was made in. Left out: not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<String>,
    /// Barcode on the cell, as a scanner reads it. Left out: none is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barcode: Option<String>,
    /// Maker. Left out: not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maker: Option<String>,
    /// Chemistry, positive electrode first, such as `NMC811 / graphite`. Left out: not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chemistry: Option<String>,
    /// Term of a vocabulary such as BattINFO for the kind of cell:
    /// `https://w3id.org/emmo/domain/battery#…`. Left out: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub term: Option<String>,
}

/// The individual cell that an experiment measures.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawSpecimen {
    /// Name of the cell: letters, digits and `-`.
    name: String,
    /// Serial number. Left out: that of the cell file.
    serial: Option<String>,
    /// Batch or lot that it was made in. Left out: that of the cell file.
    batch: Option<String>,
    /// Barcode on the cell, as a scanner reads it. Left out: that of the cell file.
    barcode: Option<String>,
}

impl Identity {
    /// Refuses texts that are empty, too long or of several lines, and a term that is not an
    /// address.
    pub(super) fn check(&self, source: &Source, section: &str) -> Result<(), ConfigError> {
        let fields = [
            ("serial", &self.serial),
            ("batch", &self.batch),
            ("barcode", &self.barcode),
            ("maker", &self.maker),
            ("chemistry", &self.chemistry),
            ("term", &self.term),
        ];
        for (name, text) in fields {
            let Some(text) = text else { continue };
            let field = format!("{section}.{name}");
            let length = text.trim().chars().count();
            if !(1..=LONGEST).contains(&length) || text.contains(char::is_control) {
                let reason =
                    format!("expected 1 to {LONGEST} characters in one line, found {text:?}");
                return Err(source.complain(&field, reason));
            }
            let is_address = ["https://", "http://"]
                .iter()
                .any(|scheme| text.starts_with(scheme));
            if name == "term" && (!is_address || text.contains(char::is_whitespace)) {
                let reason = format!("expected an address (https://…), found {text:?}");
                return Err(source.complain(&field, reason));
            }
        }
        Ok(())
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// That of one cell of this kind: what is known of the one goes before what is known of all.
    fn narrowed(&self, one: &RawSpecimen) -> Self {
        let or = |own: &Option<String>, known: &Option<String>| own.clone().or(known.clone());
        Self {
            serial: or(&one.serial, &self.serial),
            batch: or(&one.batch, &self.batch),
            barcode: or(&one.barcode, &self.barcode),
            ..self.clone()
        }
    }
}

impl RawSpecimen {
    /// Resolves the cell with its name and its identity.
    pub(super) fn resolve(
        &self,
        source: &Source,
        kind: &Identity,
    ) -> Result<(Specimen, Identity), ConfigError> {
        if !Specimen::is_name(&self.name) {
            let reason = format!(
                "expected a name of letters, digits and `-`, found {:?}",
                self.name
            );
            return Err(source.complain("specimen.name", reason));
        }
        let identity = kind.narrowed(self);
        identity.check(source, "specimen")?;
        let specimen = Specimen {
            number: 1,
            name: self.name.clone(),
            serial: identity.serial.clone(),
            batch: identity.batch.clone(),
            barcode: identity.barcode.clone(),
        };
        Ok((specimen, identity))
    }
}
