//! The blocks of a circuit in series, sorted by how an ERM can have them.

use analysis_model::model::{Circuit, ElementKind, Erm, Node, RcBranch, Role};
use num_complex::Complex64;
use std::ops::RangeInclusive;

/// Points per decade at which the sign of a reactance is evaluated.
const PER_DECADE: f64 = 8.0;
/// Factor below the band at which branches in parallel that all block are compared.
const BELOW: f64 = 1e-2;

/// Behaviour of a block under a direct current.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Blocking {
    /// It ends as a capacitance.
    pub(super) stores: bool,
    /// Its impedance grows slower than a capacitance's, without end.
    pub(super) grows: bool,
}

/// The blocks, sorted.
#[derive(Debug)]
pub(super) struct Blocks<'a> {
    /// Resistances in series, Ω.
    pub(super) r_ohm: f64,
    resistors: Vec<(usize, f64)>,
    pub(super) branches: Vec<Exact>,
    /// Capacitances in series, 1/F.
    pub(super) elastance_per_f: f64,
    pub(super) inductive: Vec<&'a Node>,
    pub(super) rest: Vec<&'a Node>,
}

impl<'a> Blocks<'a> {
    pub(super) fn of(circuit: &'a Circuit, p: &[f64], omega: &RangeInclusive<f64>) -> Self {
        let root = circuit.root();
        let all: Vec<&Node> = if let Node::Series(children) = root {
            children.iter().collect()
        } else {
            vec![root]
        };
        let mut blocks = Self {
            r_ohm: 0.0,
            resistors: Vec::new(),
            branches: Vec::new(),
            elastance_per_f: 0.0,
            inductive: Vec::new(),
            rest: Vec::new(),
        };
        all.into_iter().for_each(|node| blocks.sort(node, p, omega));
        blocks.branches.sort_by(|a, b| {
            a.branch
                .time_constant_s()
                .total_cmp(&b.branch.time_constant_s())
        });
        blocks
    }

    fn sort(&mut self, node: &'a Node, p: &[f64], omega: &RangeInclusive<f64>) {
        if let Some((ElementKind::R, first)) = element(node) {
            self.r_ohm += p[first];
            self.resistors.push((first, p[first]));
        } else if let Some((ElementKind::C, first)) = element(node) {
            self.elastance_per_f += 1.0 / p[first];
        } else if let Some(branch) = exact_branch(node, p) {
            self.branches.push(branch);
        } else if is_inductive(node, p, omega) {
            self.inductive.push(node);
        } else {
            self.rest.push(node);
        }
    }

    /// The ERM of a circuit without a rest, and the logarithms of its parameters by those of the
    /// circuit's.
    pub(super) fn erm(&self, parameters: usize) -> (Erm, Vec<Vec<f64>>) {
        let row = |powers: &[(usize, f64)]| {
            let mut row = vec![0.0; parameters];
            powers
                .iter()
                .for_each(|(index, power)| row[*index] += power);
            row
        };
        let parts: Vec<(usize, f64)> = self
            .resistors
            .iter()
            .map(|(index, ohm)| (*index, ohm / self.r_ohm))
            .collect();
        let branches = self
            .branches
            .iter()
            .flat_map(|exact| [row(&exact.r_powers), row(&exact.c_powers)]);
        let jacobian = std::iter::once(row(&parts)).chain(branches).collect();
        (
            Erm {
                r_ohm: self.r_ohm,
                branches: self.branches.iter().map(|exact| exact.branch).collect(),
            },
            jacobian,
        )
    }

    /// Impedance of what is part of an ERM as it is.
    pub(super) fn exact(&self, omega: f64) -> Complex64 {
        let branch = |exact: &Exact| {
            exact.branch.r_ohm / Complex64::new(1.0, omega * exact.branch.time_constant_s())
        };
        self.r_ohm + self.branches.iter().map(branch).sum::<Complex64>()
    }

    pub(super) fn blocking(&self, p: &[f64], omega_low: f64) -> Blocking {
        together(
            self.rest
                .iter()
                .map(|node| blocking(node, p, BELOW * omega_low)),
        )
    }

    /// Returns the DC resistance of the rest, Ω; `None` if it blocks.
    pub(super) fn rest_dc_ohm(&self, p: &[f64]) -> Option<f64> {
        Some(self.rest.iter().map(|node| dc_ohm(node, p)).sum::<f64>())
            .filter(|ohm| ohm.is_finite())
    }

    /// Returns the DC resistance of all blocks that are not left out, Ω; `None` if the rest blocks.
    pub(super) fn dc_ohm(&self, p: &[f64]) -> Option<f64> {
        let exact = self.r_ohm
            + self
                .branches
                .iter()
                .map(|exact| exact.branch.r_ohm)
                .sum::<f64>();
        self.rest_dc_ohm(p).map(|rest| exact + rest)
    }
}

/// Kind and first parameter of a node that is one element.
fn element(node: &Node) -> Option<(ElementKind, usize)> {
    if let Node::Element(element) = node {
        Some((element.kind, element.first))
    } else {
        None
    }
}

/// `K`, and `p(R,C)` in either order.
fn exact_branch(node: &Node, p: &[f64]) -> Option<Exact> {
    let (r, c, c_powers) = match node {
        Node::Element(_) => {
            let (ElementKind::K, first) = element(node)? else {
                return None;
            };
            (
                first,
                p[first + 1] / p[first],
                vec![(first + 1, 1.0), (first, -1.0)],
            )
        }
        Node::Parallel(children) => {
            let [a, b] = children.as_slice() else {
                return None;
            };
            match (element(a)?, element(b)?) {
                ((ElementKind::R, r), (ElementKind::C, c))
                | ((ElementKind::C, c), (ElementKind::R, r)) => (r, p[c], vec![(c, 1.0)]),
                _ => return None,
            }
        }
        Node::Series(_) => return None,
    };
    Some(Exact {
        branch: RcBranch {
            r_ohm: p[r],
            c_f: c,
        },
        r_powers: vec![(r, 1.0)],
        c_powers,
    })
}

/// Whether a block holds an inductance and its reactance is positive over the whole band.
fn is_inductive(node: &Node, p: &[f64], omega: &RangeInclusive<f64>) -> bool {
    let (low, high) = (omega.start(), omega.end());
    let mut has = false;
    node.visit(&mut |element| has |= matches!(element.kind, ElementKind::L | ElementKind::La));
    let steps = (PER_DECADE * (high / low).log10()).ceil().max(1.0) as usize;
    has && (0..=steps).all(|k| {
        node.impedance(p, low * (high / low).powf(k as f64 / steps as f64))
            .im
            >= 0.0
    })
}

fn together(parts: impl Iterator<Item = Blocking>) -> Blocking {
    parts.fold(Blocking::default(), |all, part| Blocking {
        stores: all.stores || part.stores,
        grows: all.grows || part.grows,
    })
}

/// Behaviour of a node under a direct current. Of parallel branches that all block, the one with
/// the largest admittance at `omega` decides. A CPE beside a finite diffusion would win only at
/// frequencies far below any that matter for a cell.
fn blocking(node: &Node, p: &[f64], omega: f64) -> Blocking {
    let (stores, grows) = (
        Blocking {
            stores: true,
            grows: false,
        },
        Blocking {
            stores: false,
            grows: true,
        },
    );
    match node {
        Node::Element(element) => match element.kind {
            ElementKind::C | ElementKind::Wo | ElementKind::H => stores,
            ElementKind::W => grows,
            ElementKind::Cpe | ElementKind::Tlmq | ElementKind::Tlmbq => {
                let ideal = |k: usize| {
                    element.kind.parameters()[k].role != Role::Exponent
                        || p[element.first + k] >= 1.0
                };
                if (0..element.kind.parameters().len()).all(ideal) {
                    stores
                } else {
                    grows
                }
            }
            _ => Blocking::default(),
        },
        Node::Series(children) => together(children.iter().map(|child| blocking(child, p, omega))),
        Node::Parallel(children) => {
            let all: Vec<Blocking> = children
                .iter()
                .map(|child| blocking(child, p, omega))
                .collect();
            if all.contains(&Blocking::default()) {
                return Blocking::default();
            }
            let largest = children.iter().zip(all).min_by(|a, b| {
                a.0.impedance(p, omega)
                    .norm()
                    .total_cmp(&b.0.impedance(p, omega).norm())
            });
            largest.map_or_else(Blocking::default, |(_, blocking)| blocking)
        }
    }
}

/// Returns the resistance at zero frequency, Ω; infinite if a node blocks.
fn dc_ohm(node: &Node, p: &[f64]) -> f64 {
    match node {
        Node::Element(element) => element.kind.dc_resistance_ohm(&p[node.range()]),
        Node::Series(children) => children.iter().map(|child| dc_ohm(child, p)).sum(),
        Node::Parallel(children) => {
            1.0 / children
                .iter()
                .map(|child| 1.0 / dc_ohm(child, p))
                .sum::<f64>()
        }
    }
}

/// A branch that a circuit has as it is.
#[derive(Debug, Clone)]
pub(super) struct Exact {
    pub(super) branch: RcBranch,
    /// Indices of the parameters and powers with which they enter resistance and capacitance.
    pub(super) r_powers: Vec<(usize, f64)>,
    pub(super) c_powers: Vec<(usize, f64)>,
}
