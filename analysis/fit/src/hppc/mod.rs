//! Pulse resistances of a hybrid pulse power characterisation (HPPC), and the power that follows from
//! them.
//!
//! For each pulse of a log the resistance is the change of the voltage over the change of the current,
//! R(t) = (V₀(t) − V(t)) / (I − I₀), as IEC 62660-1 and the FreedomCAR Battery Test Manual define it.
//! V₀(t) is the trend of the rest before the pulse, continued to the time t after its start. Time
//! counts from the last row before the current. Every resistance is of one row of the log: nothing is
//! interpolated, and what cannot be stated carries its reason.
//!
//! The power at a voltage limit is V_min (OCV − V_min) / R for a discharge and
//! V_max (V_max − OCV) / R for a charge.

mod figure;
mod options;
mod pulse;
mod result;
mod search;
mod trend;

pub use figure::chart;
pub use options::{HppcError, HppcOptions, Limits};
pub use result::{
    Direction, Found, Hppc, LeastPower, LeftOutLoad, OpenCircuit, Pulse, PulseState, Resistance,
    StateAxis,
};
pub use search::{Log, hppc};

#[cfg(test)]
mod coverage_tests;
#[cfg(test)]
mod tests;
