//! Compares the instruments that answer with those at the start of the run.

use instruments::clock::TimeMode;

use super::Run;
use bench_core::{
    bench::Identified,
    journal::{Entry, InstrumentIdentity},
    safety::failure::Failure,
};
use bench_plan::support::{quoted::quoted, terminal::remark};

/// Returns the instruments that differ from before, as text.
fn exchanged(before: &[InstrumentIdentity], now: &[Identified]) -> Vec<String> {
    let changes = before.iter().filter_map(|known| {
        let met = now.iter().find(|one| one.role == known.role)?;
        (!known.parsed().is_same_instrument(&met.identity)).then(|| {
            format!(
                "{} was `{}` and is `{}` now",
                known.role, known.identity, met.identity.raw
            )
        })
    });
    changes.collect()
}

impl Run<'_> {
    /// Writes the identities of all instruments into the journal when the run begins. A resumed
    /// run with other instruments is refused unless a person has accepted them: gains, offsets and
    /// corrections of the finished part belong to the old ones.
    ///
    /// # Errors
    /// [`Failure::Usage`] with roles, old and new identities.
    pub(super) fn check_instruments(&mut self, identities: &[Identified]) -> Result<(), Failure> {
        // A world in virtual time is repeated with its own instruments, bit by bit.
        if self.clock.mode() == TimeMode::Virtual {
            return Ok(());
        }
        let (before, accepted) = match &self.context {
            Some(context) => (
                context.replay.instruments.as_slice(),
                context.accepted.instruments,
            ),
            None => (&[][..], false),
        };
        let changes = exchanged(before, identities);
        let is_known = !before.is_empty();
        if is_known && changes.is_empty() {
            return Ok(());
        }
        if !changes.is_empty() {
            let text = format!(
                "expected the instruments of the finished part of this run: {}",
                changes.join("; ")
            );
            if !accepted {
                let folder = self.recorder.folder();
                return Err(Failure::Usage(format!(
                    "{}: {text}; put the old ones back, or accept the new ones with `eis-bench \
                    resume {} --accept-instruments`; the report then names both",
                    folder.display(),
                    quoted(folder)
                )));
            }
            let text = format!("accepted by a person: {text}");
            remark!("eis-bench: {text}");
            self.recorder.warning(&text);
        }
        let found = identities.iter().map(InstrumentIdentity::of).collect();
        Ok(self.recorder.journal(Entry::Instruments(found))?)
    }
}

#[cfg(test)]
mod tests {
    use instruments::exchange::Identity;

    use super::*;

    fn identified(role: &'static str, raw: &str) -> Identified {
        Identified {
            role,
            model: String::new(),
            address: String::new(),
            identity: Identity::parse(raw),
            recognised: true,
        }
    }

    #[test]
    fn only_another_instrument_is_named() {
        let before = [
            identified("supply4q", "KEPCO,BOP1KW 50-20,E156884,2.01"),
            identified(
                "supply",
                "Siglent Technologies,SPD3303X-E,SPD3XIDQ5R5553,1.01",
            ),
        ];
        let before: Vec<InstrumentIdentity> = before.iter().map(InstrumentIdentity::of).collect();
        for (supply4q, supply, expected) in [
            (
                "kepco, BOP1KW  50-20 ,E156884,2.01",
                "SIGLENT TECHNOLOGIES,SPD3303X-E,SPD3XIDQ5R5553,1.02",
                vec![],
            ),
            (
                "KEPCO,BOP1KW 50-20,E156999,2.01",
                "Siglent Technologies,SPD3303X-E,SPD3XIDQ5R5553,1.01",
                vec![
                    "supply4q was `KEPCO,BOP1KW 50-20,E156884,2.01` and is `KEPCO,BOP1KW 50-20,E156999,2.01` now",
                ],
            ),
        ] {
            let now = [
                identified("supply4q", supply4q),
                identified("supply", supply),
            ];
            assert_eq!(exchanged(&before, &now), expected, "{supply4q}");
        }
        assert_eq!(before[0].serial.as_deref(), Some("E156884"));
    }
}
