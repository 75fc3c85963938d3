//! Formats that a model can be written in, and reasons why one cannot.

/// Formats of one text that a model can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelFormat {
    /// C99, without memory management.
    CHeader,
    /// A Python module with a model and parameters for PyBaMM's `equivalent_circuit.Thevenin`.
    PyBamm,
    /// A Python module that builds CasADi functions of one step.
    CasAdi,
    /// A MATLAB script that fills the tables of Simscape Battery.
    Simscape,
    /// A Modelica package.
    Modelica,
}

/// Reason why a model cannot be written for another program.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelExportError {
    /// Additions that a format cannot hold.
    #[error(
        "model {name}: expected additions that are RC branches for this format, met {additions}; \
        C, CasADi and an FMU hold them"
    )]
    Additions {
        /// The model.
        name: String,
        /// Their titles.
        additions: String,
    },
    /// Resistances that depend on the current.
    #[error(
        "model {name}: expected resistances that do not depend on the current for this format, met a \
        law of charge transfer; C, CasADi, PyBaMM, Modelica and an FMU hold it"
    )]
    CurrentLaw {
        /// The model.
        name: String,
    },
    /// An addition without an equation.
    #[error(
        "model {name}: expected additions whose equation holds for a cell at rest, met {addition}"
    )]
    Unwritten {
        /// The model.
        name: String,
        /// Its title.
        addition: String,
    },
    /// An addition that stands twice.
    #[error("model {name}: expected each addition once, met {addition} twice")]
    Twice {
        /// The model.
        name: String,
        /// Its title.
        addition: String,
    },
    /// Additions that are not as they must be.
    #[error("model {name}: {message}")]
    Additional {
        /// The model.
        name: String,
        /// What is wrong.
        message: String,
    },
    /// No open-circuit voltage.
    #[error(
        "model {name}: expected an open-circuit voltage over the state of charge, met none: give a \
        curve, or a voltage and a capacity"
    )]
    NoOcv {
        /// The model.
        name: String,
    },
    /// An archive that cannot be written.
    #[error("archive of the FMU: {message}")]
    Archive {
        /// What is wrong.
        message: String,
    },
}
