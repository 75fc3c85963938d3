//! The limits of the cell and the check of readings against them. The functions are pure: they
//! take readings and return a trip or nothing. [`judge`] checks a single reading; [`Interlock`]
//! also considers earlier ones: rates, charge, age, and values that do not change.

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
