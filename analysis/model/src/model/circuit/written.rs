//! Circuits as text, in either notation.

use super::Circuit;
use super::cdc::{self, WrittenCircuit};
use super::parse::{self, ParseError};
use std::str::FromStr;

impl FromStr for Circuit {
    type Err = ParseError;

    /// Reads a circuit in either notation; values in a circuit description code are left to
    /// [`WrittenCircuit`].
    fn from_str(text: &str) -> Result<Self, ParseError> {
        WrittenCircuit::read(text).map(|written| written.circuit)
    }
}

impl WrittenCircuit {
    /// Reads a circuit in impedance.py's notation, `R0-p(R1,C1)`, which has no values, or as a
    /// circuit description code of pyimpspec, `R(RC)` or `[R{R=0.01F}(RC)]`.
    ///
    /// # Errors
    /// [`ParseError`] with the position, the expected and the actual text.
    ///
    /// ```
    /// use analysis_model::model::WrittenCircuit;
    ///
    /// let written = WrittenCircuit::read("R{R=0.01F}(R{R=0.02}C)")?;
    /// assert_eq!(written.circuit.to_string(), "R1-p(R2,C1)");
    /// assert_eq!(written.constants, [(0, 0.01)]);
    /// assert_eq!(written.guess, [(1, 0.02)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn read(text: &str) -> Result<Self, ParseError> {
        if cdc::is_code(text) {
            return cdc::read(text);
        }
        Ok(Self {
            circuit: parse::circuit(text)?,
            guess: Vec::new(),
            constants: Vec::new(),
        })
    }
}
