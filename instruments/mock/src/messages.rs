//! Messages of a model whose effect the surrounding faults depend on.

/// Messages of one model that switch its output off, and its questions for measurements.
pub struct Messages {
    /// Messages that switch off an output that can move charge; `#` stands for any digit.
    pub off: &'static [&'static str],
    /// Its reply to each of them; empty if it answers queries only.
    pub off_answer: &'static str,
    /// Words of which each question for a measurement holds one.
    pub measure: &'static [&'static str],
}

impl Messages {
    /// Those of a model without an output or a meter of the cell.
    pub(crate) const NONE: Self = Self::measuring(&[]);

    /// Those of a model without an output that can move charge.
    pub(crate) const fn measuring(measure: &'static [&'static str]) -> Self {
        Self {
            off: &[],
            off_answer: "",
            measure,
        }
    }

    /// Those of a SCPI source or load with meters.
    pub(crate) const fn metered(off: &'static [&'static str]) -> Self {
        Self {
            off,
            ..Self::measuring(&["MEAS"])
        }
    }

    /// Returns whether a message switches the output off.
    pub fn switches_off(&self, message: &[u8]) -> bool {
        let same = |(pattern, met): (u8, &u8)| {
            pattern.eq_ignore_ascii_case(met) || (pattern == b'#' && met.is_ascii_digit())
        };
        let message = message.trim_ascii();
        self.off
            .iter()
            .any(|off| off.len() == message.len() && off.bytes().zip(message).all(same))
    }

    /// Returns whether a message is a measurement query.
    pub fn measures(&self, message: &[u8]) -> bool {
        let text = String::from_utf8_lossy(message).to_ascii_uppercase();
        self.measure.iter().any(|word| text.contains(word))
    }
}

#[cfg(test)]
mod tests {
    use crate::MODELS;

    #[test]
    fn every_model_that_moves_charge_knows_what_switches_it_off() {
        for known in MODELS {
            let drives = ["supply4q", "generator", "load", "supply"].contains(&known.role);
            assert_eq!(known.messages.off.is_empty(), !drives, "{}", known.key);
            let off = known.panel_off.filter(|_| drives).unwrap_or_default();
            assert!(
                !drives || known.messages.switches_off(off.as_bytes()),
                "{}",
                known.key
            );
            for other in [
                "OUTP ON",
                "OUTP?",
                "OUTP:MODE BATTERY",
                ":OUTP:OCP CH1,OFF",
                "C1:OUTP LOAD,HZ",
                "CURR 0",
                ":CURR:PROT:STAT OFF",
            ] {
                assert!(
                    !known.messages.switches_off(other.as_bytes()),
                    "{}: {other}",
                    known.key
                );
            }
        }
    }

    #[test]
    fn every_model_with_a_meter_knows_its_questions() {
        for known in MODELS {
            let meters = !["generator", "scope", "jig"].contains(&known.role);
            assert_eq!(!known.messages.measure.is_empty(), meters, "{}", known.key);
        }
    }
}
