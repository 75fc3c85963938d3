//! Captures to sinusoids, sinusoids to impedance, impedance to a battery model. Numbers in, numbers
//! out.
//!
//! In reading order: [`sine`] fits sinusoids to samples, [`calibration`] corrects the harness from
//! the control impedances, [`budget`] tells where the uncertainty comes from, [`spectrum`] holds
//! complex impedances with their uncertainty, [`validity`] judges them, [`model`] is the extended
//! Randles model (ERM) and circuits in general, [`fit`] finds their parameters, [`drt`] shows their
//! time constants, [`ocv`] is the voltage at rest, [`multisine`] measures many frequencies in one
//! record, [`joint`] fits the model to spectra and pulses of a [`series`] together, [`pack`] maps a
//! cell to an SxP pack, [`forward`] simulates a cell or a pack under a load, [`sop`] finds the most
//! power that can be held; [`given`] is a cell's model from whatever it was given as, fitted
//! circuits as ladders of RC too; [`thinning`] averages frames of direct currents; [`dataset`] and
//! [`formats`] are the files, [`plot`] and [`report`] the pictures, [`brief`] the numbers in words.
//!
//! Knows no sockets, no clock, no async runtime, no instrument and no simulated truth.

pub mod augmented;
pub mod brief;
pub mod budget;
pub mod calibration;
pub mod contract;
pub mod dataset;
pub mod diagnosis;
pub mod drt;
pub mod effects;
pub mod fit;
pub mod formats;
pub mod forward;
pub mod given;
pub mod joint;
pub mod model;
pub mod multisine;
pub mod numeric;
pub mod ocv;
pub mod pack;
pub mod plot;
pub mod report;
pub mod series;
pub mod sine;
pub mod sop;
pub mod spectrum;
pub mod staircase;
pub mod thinning;
pub mod validity;
