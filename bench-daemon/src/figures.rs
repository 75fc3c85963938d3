//! Pictures and tables that commands and the reports of runs share.

pub(crate) mod curves;
pub(crate) mod impedance;
pub(crate) mod ocv;
pub(crate) mod story;
pub(crate) mod validity;
