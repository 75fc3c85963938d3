//! Drivers of the instruments of a battery test bench, and simulated instruments for tests.
//!
//! The layers, in reading order: [`units`], [`fixture`] and [`clock`]; [`scpi`], the sans-IO codec;
//! [`transport`], bytes in and bytes out; [`transcript`] and [`link`], the only asynchronous layer;
//! [`exchange`] and [`instrument`], common parts of the roles; the roles ([`supply4q`],
//! [`generator`], [`scope`], [`load`], [`supply`], [`chiller`], [`logger`], [`jig`]), each with its
//! dialects; and [`mock`], devices that answer the same messages on the same kinds of port.
//!
//! Knows no physics, no files, no configuration and no procedure.

pub mod chiller;
pub mod clock;
pub mod exchange;
pub mod generator;
pub mod instrument;
pub mod jig;
pub mod link;
pub mod load;
pub mod logger;
pub mod mock;
pub mod scope;
pub mod supply;
pub mod supply4q;
pub mod transcript;
pub mod transport;
pub mod wire;

pub use instruments_domain::{fixture, units};
pub use instruments_scpi as scpi;
