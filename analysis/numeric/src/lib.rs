//! Numerical methods for the rest of the analysis: small linear algebra, minimisers, random
//! numbers, tails of distributions, covariances. Knows no battery.

mod covariance;
mod global;
pub mod linalg;
mod local;
pub mod mixed;
mod rng;
pub mod significant;
pub mod stats;

pub use covariance::Covariance2;
pub use global::{Columns, DeOptions, Evolution, Member, Strategy, differential_evolution};
pub use local::{LocalOptions, Minimum, Smooth, minimise};
pub use rng::Rng;
