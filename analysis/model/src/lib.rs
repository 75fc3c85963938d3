//! Models of a cell: [`model`] is the extended Randles model (ERM) and circuits in general, [`ocv`]
//! the open-circuit voltage, [`pack`] maps a cell to an SxP pack.

pub mod model;
pub mod ocv;
pub mod pack;
