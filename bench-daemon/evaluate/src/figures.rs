//! Pictures and tables that commands and the reports of runs share.

pub mod curves;
pub mod impedance;
pub mod ocv;
pub mod story;
pub mod validity;
