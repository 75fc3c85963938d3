//! The archive against a store in memory that fails in every way that a store can.

mod faults;
mod made;
mod moved;
mod pushed;
mod tables;
