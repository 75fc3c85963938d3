//! Parameters of a model from measurements.
//!
//! [`validity`] judges a spectrum, [`fit`] finds the parameters of the extended Randles model and
//! of circuits, [`drt`] shows time constants, [`joint`] fits spectra and pulses together, [`map`]
//! fits resistances over state of charge and temperature, [`loads`] finds rests and loads in a log,
//! [`hppc`] makes a table of pulse resistances, [`given`] reads a model of a cell from whatever it
//! was given as, [`rows`] makes tables of many results, [`under_current`] compares sweeps under a
//! direct current with sweeps at rest, [`usage`] finds impedances in records of ordinary use,
//! [`figures`] draws fits.

pub mod drt;
pub mod figures;
pub mod fit;
pub mod given;
pub mod hppc;
pub mod joint;
pub mod loads;
pub mod map;
pub mod rows;
mod sizes;
pub mod under_current;
pub mod usage;
pub mod validity;
