//! Drivers of the instruments of a battery test bench.
//!
//! [`exchange`] is the interface between a dialect and its role: messages, each with the condition
//! that must hold after it. [`instrument`] is common to all roles. The roles are [`supply4q`],
//! [`generator`], [`scope`], [`load`], [`supply`], [`chiller`], [`logger`] and [`jig`]. A role has
//! one file for each dialect.
//!
//! Contains no physics, no file access, no configuration and no procedures.

pub mod chiller;
pub mod exchange;
pub mod generator;
pub mod instrument;
pub mod jig;
pub mod load;
pub mod logger;
mod power;
pub mod scope;
pub mod supply;
pub mod supply4q;
