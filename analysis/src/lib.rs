//! Captures to sinusoids, sinusoids to impedance, impedance to a battery model. Numbers in, numbers out.
//!
//! In reading order: [`sine`] fits sinusoids to samples, [`calibration`] corrects the harness from the control impedances, [`spectrum`] holds
//! complex impedances with their uncertainty, [`model`] is the extended Randles model (ERM), [`fit`] finds its parameters, [`ocv`] is its voltage at rest, [`pack`] maps a cell
//! to an SxP pack, [`forward`] simulates
//! a cell or a pack under a load, [`sop`] asks for the most power that can be held; [`dataset`] and [`formats`] are the files, [`plot`] and [`report`] the pictures.
//!
//! Knows no sockets, no clock, no async runtime, no instrument and no simulated truth.

pub mod calibration;
pub mod dataset;
pub mod fit;
pub mod formats;
pub mod forward;
pub mod model;
pub mod ocv;
pub mod pack;
pub mod plot;
pub mod report;
pub mod sine;
pub mod sop;
pub mod spectrum;
