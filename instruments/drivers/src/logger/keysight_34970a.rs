//! Keysight/Agilent/HP 34970A, 34972A, DAQ970A.

use instruments_link::link::LinkProfile;

use super::Dialect;
use crate::{
    exchange::{Exchange, Identity},
    instrument::{Model, ms},
};

/// Keysight 34970A.
pub(super) const LOGGER_34970A: Keysight34970a = Keysight34970a;

pub(super) struct Keysight34970a;

impl Model for Keysight34970a {
    fn key(&self) -> &'static str {
        "keysight-34970a"
    }

    fn profile(&self) -> LinkProfile {
        // A scan of thermocouples takes some 100 ms a channel.
        LinkProfile {
            min_gap: ms(5),
            timeout: ms(10_000),
            ..LinkProfile::scpi()
        }
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        ["34970A", "34972A", "DAQ970A"]
            .iter()
            .any(|model| identity.model.starts_with(model))
    }
}

impl Dialect for Keysight34970a {
    fn configure(&self, channels: &[u16]) -> Vec<Exchange> {
        let list: Vec<u32> = channels.iter().copied().map(u32::from).collect();
        vec![
            Exchange::command("CONF:TEMP", |command| {
                command.word("TC").word("K").channels(&list)
            }),
            Exchange::command("UNIT:TEMP", |command| command.word("C").channels(&list)),
            Exchange::command("ROUT:SCAN", |command| command.channels(&list)),
            Exchange::send("TRIG:SOUR IMM"),
            Exchange::send("TRIG:COUN 1"),
            // Without these four the answer holds readings only.
            Exchange::send("FORM:READ:TIME OFF"),
            Exchange::send("FORM:READ:CHAN OFF"),
            Exchange::send("FORM:READ:UNIT OFF"),
            Exchange::send("FORM:READ:ALAR OFF"),
        ]
    }

    fn scan(&self) -> &'static str {
        "READ?"
    }
}
