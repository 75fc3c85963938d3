//! Drivers of the instruments of a battery test bench.
//!
//! [`exchange`] is what a dialect gives to its role: messages, each with what must be true after
//! it. [`instrument`] is what all roles have in common. The roles are [`supply4q`], [`generator`],
//! [`scope`], [`load`], [`supply`], [`chiller`], [`logger`] and [`jig`]. A role has one file for
//! each dialect.
//!
//! Knows no physics, no files, no configuration and no procedure.

pub mod chiller;
pub mod exchange;
pub mod generator;
pub mod instrument;
pub mod jig;
pub mod load;
pub mod logger;
pub mod scope;
pub mod supply;
pub mod supply4q;
