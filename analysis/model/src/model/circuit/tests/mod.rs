//! Tests of circuits: elements against other formulas and published values, strings, laws.

mod element;
mod text;
