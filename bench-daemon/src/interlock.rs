//! Limits of what the cell may be exposed to, and the check of a reading against them. Pure:
//! readings in, a trip or nothing out. [`judge`] looks at one reading, [`Interlock`] also at those
//! before it: rates, charge, age, and values that do not move.

mod ages;
mod allowance;
mod bath;
mod charge;
mod drives;
mod history;
mod limits;
mod meters;
mod noise;
mod period;
mod temperatures;
mod thermometers;

pub use allowance::{Allowance, Mean, Settings};
pub use bath::{BathFault, BathJudge, BathReading};
pub use drives::{Drive, Drives};
pub use history::Interlock;
pub use limits::{CURRENT_MARGIN, Limits, NO_CURRENT_A, Reading, Trip, judge};
pub use meters::{Quantity, Stuck};
pub use thermometers::{ThermometerFault, ThermometerJudge, ThermometerReadings};
