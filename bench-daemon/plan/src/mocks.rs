//! Parts of the simulated instruments that the daemon uses. No other file of it names them: what speaks
//! to real instruments stands apart from them.

pub use instruments::mock::{
    Device, Fault, FaultLog, Happened, MODELS, MakeError, MockOptions, Outcome, Remote, Replay,
    Schedule, check_quirks, make, make_troubled,
    plant::{HISTORY_S, SharedPlant},
    quirks::{Quirks, Value},
    serve_gpib, serve_gpib_pty, serve_hislip, serve_memory, serve_pty, serve_tcp, serve_usbtmc,
    serve_vxi11,
};
