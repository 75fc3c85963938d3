//! Newtypes for everything that is sent to an instrument, so that volts cannot be sent where
//! amperes are meant. SI throughout.
//!
//! ```
//! use instruments_domain::units::{Amps, Volts};
//!
//! let (limit, current) = (Volts(4.2), Amps(1.5));
//! assert_eq!(limit.to_string(), "4.2 V");
//! assert_eq!(current.value(), 1.5);
//! ```

use std::fmt;

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $symbol:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default, serde::Serialize, serde::Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub f64);

        impl $name {
            /// The bare number in SI.
            pub const fn value(self) -> f64 {
                self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $symbol))
            }
        }
    };
}

unit!(
    /// Electric potential, V.
    Volts,
    "V"
);
unit!(
    /// Electric current, A.
    Amps,
    "A"
);
unit!(
    /// Frequency, Hz.
    Hertz,
    "Hz"
);
unit!(
    /// Time, s.
    Seconds,
    "s"
);
unit!(
    /// Temperature, °C.
    Celsius,
    "°C"
);
unit!(
    /// Resistance, Ω.
    Ohms,
    "Ω"
);
unit!(
    /// Power, W.
    Watts,
    "W"
);
