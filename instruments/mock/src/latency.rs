//! Times that instruments take to answer, as owners measured them. They are used if a bench file asks
//! for them (`latency = "measured"`), and never in virtual time unless it does.

/// Classes of messages that take different times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Class {
    /// The identity query.
    Identity,
    /// Any other query.
    Query,
    /// A block of samples.
    Waveform,
}

/// Medians of one model, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latency {
    /// Key of the model.
    pub model: &'static str,
    /// Of the identity.
    pub identity_s: f64,
    /// Of any other query.
    pub query_s: f64,
    /// Of a block of samples, beside its transfer.
    pub waveform_s: f64,
    /// Where the figures come from.
    pub source: &'static str,
}

/// Models whose times are known.
pub const MEASURED: &[Latency] = &[
    Latency {
        model: "siglent-sds800x-hd",
        identity_s: 0.023,
        query_s: 0.023,
        waveform_s: 0.137,
        source: "owner of an SDS824X HD over USBTMC: 23 ms in the median, 137 ms at the 90th percentile",
    },
    Latency {
        model: "rigol-dho800",
        identity_s: 0.130,
        query_s: 0.028,
        waveform_s: 0.035,
        source: "owners: DHO804 22 ms to 35 ms a query, DHO802 123 ms to 144 ms for *IDN?",
    },
    Latency {
        model: "kepco-bop-mg",
        identity_s: 0.025,
        query_s: 0.025,
        waveform_s: 0.025,
        source: "public driver of a BIT 802E: about 25 ms a command",
    },
    Latency {
        model: "kepco-bop-linear",
        identity_s: 0.025,
        query_s: 0.025,
        waveform_s: 0.025,
        source: "public driver of a BIT 802E: about 25 ms a command",
    },
];

impl Latency {
    /// Returns the times of a model, if they are known.
    pub fn of(model: &str) -> Option<&'static Self> {
        MEASURED.iter().find(|known| known.model == model)
    }

    /// Returns the time until the answer to a message begins, s.
    pub(super) fn of_message(&self, message: &[u8]) -> f64 {
        match class(message) {
            Class::Identity => self.identity_s,
            Class::Query => self.query_s,
            Class::Waveform => self.waveform_s,
        }
    }
}

fn class(message: &[u8]) -> Class {
    let text = String::from_utf8_lossy(message).to_ascii_uppercase();
    if text.contains("*IDN?") {
        Class::Identity
    } else if text.contains(":DATA?") {
        Class::Waveform
    } else {
        Class::Query
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_figure_has_a_source_and_each_message_a_class() {
        for known in MEASURED {
            assert!(!known.source.is_empty(), "{}", known.model);
            assert!(crate::model(known.model).is_ok(), "{}", known.model);
        }
        assert_eq!(class(b"*idn?"), Class::Identity);
        assert_eq!(class(b":WAV:DATA?"), Class::Waveform);
        assert_eq!(class(b":CHAN1:SCAL?"), Class::Query);
    }
}
