//! Tests of circuits: elements against other formulas and published values, strings, laws.

mod cdc;
mod element;
mod text;
