//! Messages in both directions: program messages go to the device, response messages come back
//! (IEEE 488.2 clauses 7 and 8).
//!
//! Works on whole messages without their terminator; cutting a stream into messages is the business
//! of [`super::decode`].

mod argument;
mod command;
mod program;
mod response;

pub use argument::{Argument, MAX_CHANNELS};
pub use command::{Command, CommandError};
pub use program::{ProgramError, ProgramUnit, parse_program};
pub use response::{Field, parse_response, response_units};
