//! Drivers of the instruments of a battery test bench, and simulated instruments for tests.
//!
//! This crate only re-exports the crates below it, in the order in which they depend on each other:
//!
//! * `instruments-domain` – [`units`]; [`fixture`]: the test position.
//! * `instruments-scpi` – [`scpi`]: the codec without I/O.
//! * `instruments-link` – [`clock`]: bench time; [`wire`] and [`transport`]: bytes in and bytes out;
//!   [`transcript`]: recorded conversations; [`link`]: one exchange at a time; [`loopback`]: hosts that
//!   are this machine.
//! * `instruments-drivers` – [`exchange`] and [`instrument`]: common parts of the roles; the roles
//!   [`supply4q`], [`generator`], [`scope`], [`load`], [`supply`], [`chiller`], [`logger`] and
//!   [`jig`], each with its dialects.
//! * `instruments-mock` – [`mock`]: devices that answer the same messages on the same kinds of
//!   port. It does not use the drivers.
//!
//! A question to a simulated thermometer:
//!
//! ```
//! use instruments::{
//!     clock::{Clock, TimeMode},
//!     link::{Link, LinkOptions, LinkProfile},
//!     mock::serve_memory,
//!     transcript::Tap,
//!     transport::MemoryHub,
//! };
//! # use instruments::{mock::Device, scpi::decode::Terminator};
//! # struct Thermometer;
//! # impl Device for Thermometer {
//! #     fn terminator(&self) -> Terminator {
//! #         Terminator::Lf
//! #     }
//! #     fn handle(&mut self, _now_s: f64, _message: &[u8]) -> Vec<u8> {
//! #         b"25.0\n".to_vec()
//! #     }
//! # }
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # Clock::runtime(TimeMode::Virtual)?.block_on(async {
//! let (clock, hub) = (Clock::start(TimeMode::Virtual), MemoryHub::new());
//! serve_memory(Box::new(Thermometer), &hub, "thermometer", clock.clone())?;
//! let mut link = Link::open(LinkOptions {
//!     name: "thermometer".to_owned(),
//!     address: "memory:thermometer".parse()?,
//!     profile: LinkProfile::scpi(),
//!     clock,
//!     hub,
//!     tap: Tap::none(),
//! })
//! .await?;
//! assert_eq!(link.query("MEAS:TEMP?").await?, "25.0");
//! # Ok(())
//! # })
//! # }
//! ```
//!
//! Knows no physics, no files, no configuration and no procedure.

pub use instruments_domain::{fixture, units};
pub use instruments_drivers::{
    chiller, exchange, generator, instrument, jig, load, logger, scope, supply, supply4q,
};
pub use instruments_link::{clock, link, loopback, transcript, transport, wire};
pub use instruments_mock as mock;
pub use instruments_scpi as scpi;
