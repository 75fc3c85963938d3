//! The connection to one instrument. The layers, in reading order:
//!
//! * [`clock`]: bench time.
//! * [`wire`]: messages of the transports, without I/O.
//! * [`transport`]: bytes in and bytes out.
//! * [`transcript`]: recorded conversations.
//! * [`link`]: one exchange at a time, with deadlines, error queue and recovery.
//! * [`loopback`]: whether an address is on this machine.
//!
//! Knows no dialect and no role.

pub mod clock;
pub mod link;
pub mod loopback;
pub mod transcript;
pub mod transport;
pub mod wire;
