//! Siglent SDM3055, SDM3065X: a multimeter with one input, which is channel 1 here.

use instruments_link::link::LinkProfile;

use super::Dialect;
use crate::{
    exchange::{Exchange, Identity},
    instrument::{Model, ms},
};

/// Siglent SDM3065X; the SDM3055 has the same commands.
pub(super) const SDM: SiglentSdm = SiglentSdm;

pub(super) struct SiglentSdm;

impl Model for SiglentSdm {
    fn key(&self) -> &'static str {
        "siglent-sdm3065x"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(10),
            timeout: ms(5_000),
            ..LinkProfile::scpi()
        }
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("SIGLENT")
            && ["SDM3065X", "SDM3055"]
                .iter()
                .any(|model| identity.model.starts_with(model))
    }
}

impl Dialect for SiglentSdm {
    fn has_channel(&self, channel: u16) -> bool {
        channel == 1
    }

    fn configure(&self, _: &[u16]) -> Vec<Exchange> {
        vec![
            Exchange::send("CONF:TEMP THER,KITS90"),
            // After the configuration: the unit is not part of it.
            Exchange::word("UNIT:TEMP C", "UNIT:TEMP?", &["C", "CEL"]),
            Exchange::send("TRIG:SOUR IMM"),
            Exchange::number("SAMP:COUN 1", "SAMP:COUN?", 1.0, 0.1),
        ]
    }

    fn scan(&self) -> &'static str {
        "READ?"
    }
}
