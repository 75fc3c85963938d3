//! Models of a cell: [`model`] is the extended Randles model (ERM) and circuits in general, [`ocv`]
//! the open-circuit voltage, [`map`] a cell over state of charge and temperature, [`pack`] maps a
//! cell to an SxP pack.

pub mod map;
pub mod model;
pub mod ocv;
pub mod pack;
