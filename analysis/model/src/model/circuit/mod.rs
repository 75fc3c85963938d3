//! Equivalent circuits in general: elements in series and in parallel, written as impedance.py's
//! users know them, `R0-p(R1,C1)-p(R2-Wo1,CPE1)`, or as pyimpspec's, `R(RC)([RWo]Q)`.
//!
//! Impedance with exact derivatives with respect to every parameter; no values (they are a slice
//! beside the circuit) and no fit (see `fit::fit_circuit`). Parameters are in the order of the
//! string and are named after their element: `R0`, `C1`, and `CPE1_0`, `CPE1_1` if an element has
//! several.

mod cdc;
mod element;
mod hyperbolic;
mod parse;
mod porous;
mod written;

pub use cdc::WrittenCircuit;
pub use element::{ElementKind, ParameterKind, Role};
pub use parse::{MAX_DEPTH, MAX_ELEMENTS, ParseError};

use super::Erm;
use element::MAX_PARAMETERS;
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::fmt;
use std::ops::Range;

/// One element of a circuit.
#[derive(Debug, Clone, PartialEq)]
pub struct Element {
    pub kind: ElementKind,
    /// Name as written, such as `CPE1`.
    pub(crate) name: String,
    /// Index of its first parameter.
    pub first: usize,
}

/// A circuit as a tree. The parameters of a node are one range, for they are counted in the order
/// of the string.
#[derive(Debug, Clone, PartialEq)]
pub enum Node {
    /// A single element.
    Element(Element),
    /// Two or more in series.
    Series(Vec<Node>),
    /// Two or more in parallel.
    Parallel(Vec<Node>),
}

/// An equivalent circuit without values.
///
/// ```
/// use analysis_model::model::Circuit;
///
/// let circuit: Circuit = "R0-p(R1,C1)".parse()?;
/// assert_eq!(circuit.parameter_names(), ["R0", "R1", "C1"]);
/// // At 1/(2πR₁C₁) the branch has half its resistance and as much reactance.
/// let corner_hz = 1.0 / (std::f64::consts::TAU * 0.02 * 5.0);
/// let z_ohm = circuit.impedance(&[0.01, 0.02, 5.0], corner_hz);
/// assert!((z_ohm.re - 0.02).abs() < 1e-12);
/// assert!((z_ohm.im + 0.01).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Circuit {
    root: Node,
    names: Vec<String>,
    kinds: Vec<ParameterKind>,
}

impl Circuit {
    fn new(root: Node) -> Self {
        let (mut names, mut kinds) = (Vec::new(), Vec::new());
        root.visit(&mut |element| {
            let parameters = element.kind.parameters();
            kinds.extend_from_slice(parameters);
            match parameters.len() {
                1 => names.push(element.name.clone()),
                count => names.extend((0..count).map(|k| format!("{}_{k}", element.name))),
            }
        });
        Self { root, names, kinds }
    }

    /// Returns the extended Randles model as a circuit, `R0-p(R1,C1)-…`, with its parameters.
    pub fn from_erm(erm: &Erm) -> (Self, Vec<f64>) {
        let element = |kind: ElementKind, k: usize, first| {
            Node::Element(Element {
                kind,
                name: format!("{}{k}", kind.name()),
                first,
            })
        };
        let mut blocks = vec![element(ElementKind::R, 0, 0)];
        let mut values = vec![erm.r_ohm];
        for (k, branch) in erm.branches.iter().enumerate() {
            let (r, c) = (
                element(ElementKind::R, k + 1, values.len()),
                element(ElementKind::C, k + 1, values.len() + 1),
            );
            blocks.push(Node::Parallel(vec![r, c]));
            values.extend([branch.r_ohm, branch.c_f]);
        }
        let root = if blocks.len() == 1 {
            blocks.remove(0)
        } else {
            Node::Series(blocks)
        };
        (Self::new(root), values)
    }

    /// Returns the names of the parameters, as impedance.py's.
    pub fn parameter_names(&self) -> &[String] {
        &self.names
    }

    /// Unit, role and physical range of each parameter.
    pub fn parameter_kinds(&self) -> &[ParameterKind] {
        &self.kinds
    }

    /// Returns the impedance in Ω for the parameters (all above zero, in the order of the names) at
    /// a frequency above zero in Hz; not a number for another number of parameters.
    pub fn impedance(&self, parameters: &[f64], freq_hz: f64) -> Complex64 {
        if parameters.len() != self.names.len() {
            return Complex64::new(f64::NAN, f64::NAN);
        }
        self.root.impedance(parameters, TAU * freq_hz)
    }

    /// As [`Circuit::impedance`]; writes the derivatives with respect to the parameters, Ω per the
    /// parameter's unit, to `slopes`, which must be as long as the parameters.
    pub fn jacobian(
        &self,
        parameters: &[f64],
        freq_hz: f64,
        slopes: &mut [Complex64],
    ) -> Complex64 {
        if parameters.len() != self.names.len() || slopes.len() != parameters.len() {
            return Complex64::new(f64::NAN, f64::NAN);
        }
        self.root.expand(parameters, TAU * freq_hz, slopes)
    }

    /// Outermost node of the tree.
    pub fn root(&self) -> &Node {
        &self.root
    }
}

impl fmt::Display for Circuit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.root.fmt(f)
    }
}

impl Node {
    /// Calls `f` for every element, in the order of the string.
    pub fn visit(&self, f: &mut impl FnMut(&Element)) {
        match self {
            Self::Element(element) => f(element),
            Self::Series(children) | Self::Parallel(children) => {
                children.iter().for_each(|child| child.visit(f));
            }
        }
    }

    /// Indices of its parameters.
    pub fn range(&self) -> Range<usize> {
        match self {
            Self::Element(element) => {
                element.first..element.first + element.kind.parameters().len()
            }
            Self::Series(children) | Self::Parallel(children) => {
                let first = children.first().map_or(0, |child| child.range().start);
                first..children.last().map_or(first, |child| child.range().end)
            }
        }
    }

    /// Returns the impedance at an angular frequency.
    pub fn impedance(&self, p: &[f64], omega: f64) -> Complex64 {
        match self {
            Self::Element(element) => {
                let mut unused = [Complex64::ZERO; MAX_PARAMETERS];
                let range = self.range();
                element
                    .kind
                    .expand(&p[range.clone()], omega, &mut unused[..range.len()])
            }
            Self::Series(children) => children.iter().map(|child| child.impedance(p, omega)).sum(),
            Self::Parallel(children) => children
                .iter()
                .map(|child| child.impedance(p, omega).inv())
                .sum::<Complex64>()
                .inv(),
        }
    }

    /// Returns the impedance and, in the node's range of `slopes`, its derivatives. In parallel,
    /// with Z = 1/ΣZₖ⁻¹: ∂Z/∂p = (Z/Zₖ)²·∂Zₖ/∂p.
    fn expand(&self, p: &[f64], omega: f64, slopes: &mut [Complex64]) -> Complex64 {
        match self {
            Self::Element(element) => {
                let range = self.range();
                element
                    .kind
                    .expand(&p[range.clone()], omega, &mut slopes[range])
            }
            Self::Series(children) => children
                .iter()
                .map(|child| child.expand(p, omega, slopes))
                .sum(),
            Self::Parallel(children) => {
                let mut admittance = Complex64::ZERO;
                for child in children {
                    let y = child.expand(p, omega, slopes).inv();
                    admittance += y;
                    let square = y * y;
                    slopes[child.range()]
                        .iter_mut()
                        .for_each(|slope| *slope *= square);
                }
                let z = admittance.inv();
                let square = z * z;
                slopes[self.range()]
                    .iter_mut()
                    .for_each(|slope| *slope *= square);
                z
            }
        }
    }
}

impl fmt::Display for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (children, separator) = match self {
            Self::Element(element) => return f.write_str(&element.name),
            Self::Series(children) => (children, "-"),
            Self::Parallel(children) => {
                f.write_str("p(")?;
                (children, ",")
            }
        };
        for (k, child) in children.iter().enumerate() {
            f.write_str(if k > 0 { separator } else { "" })?;
            child.fmt(f)?;
        }
        f.write_str(if matches!(self, Self::Parallel(_)) {
            ")"
        } else {
            ""
        })
    }
}

#[cfg(test)]
mod tests;
