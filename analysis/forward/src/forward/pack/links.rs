//! Resistances between the cells of a pack as a network.
//!
//! Between its nodes lie links, and cells as sources Eₖ behind Rₖ. With L, the Laplacian weighted by the
//! conductances of all of them, the voltages of the nodes over `pack-` obey Kirchhoff's current law
//! L·φ = Σ(Eₖ/Rₖ)·(1₊ − 1₋) − I·1_pack₊, so that φ = φ_open − I·φ_unit: the pack is a source of φ_open at
//! `pack+` behind φ_unit there.

mod loads;
mod path;

pub(super) use loads::LinkWatch;
pub use loads::{LinkLoad, LinkLoads};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::collections::BTreeMap;

/// Least resistance of a link, Ω: less is lost in the rounding of the equations.
const LEAST_LINK_OHM: f64 = 1e-7;
/// Most nodes: the equations are dense.
const MOST_NODES: usize = 2000;
/// Current of a cell without load over that of its short circuit, and error of the open-circuit voltage in
/// cells: above, a pack is not wired in series.
const AT_REST: f64 = 1e-6;

/// Numbers of the nodes at the terminals of the pack.
const MINUS: usize = 0;
const PLUS: usize = 1;

/// Resistance between two nodes. A node is a terminal of the pack (`pack-`, `pack+`), a terminal of a cell
/// by its group and place from 1 (`1.3-`, `16.2+`), or any other name.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// One node.
    pub from: String,
    /// The other node.
    pub to: String,
    /// Resistance, Ω.
    pub r_ohm: f64,
    /// Heat capacity, J/K, for its temperature without cooling.
    pub heat_j_per_k: Option<f64>,
}

/// Reason why links are no pack.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LinksError {
    /// A link that cannot be.
    #[error("expected {expected}, met {met}")]
    Link {
        /// Its number from 0.
        index: usize,
        /// Allowed values.
        expected: String,
        /// The value met.
        met: String,
    },
    /// A node to which no link leads.
    #[error("expected a link to {node}, met none")]
    Unlinked {
        /// Its name.
        node: String,
    },
    /// A node without a way to `pack-`.
    #[error("expected a path of links and cells from pack- to {node}, met none")]
    Apart {
        /// Its name.
        node: String,
    },
    /// Cells that discharge each other without a load.
    #[error(
        "expected no current without a load, met one through cell {cell}, which the links short or join to \
        cells of another group"
    )]
    Short {
        /// The cell with the largest current.
        cell: String,
    },
    /// Another number of cells between the terminals.
    #[error("expected {series} cells in series from pack- to pack+, met {met:.3}")]
    Series {
        /// Cells in series of the pack.
        series: u32,
        /// Cells met.
        met: f64,
    },
    /// Too many nodes.
    #[error("expected at most {MOST_NODES} nodes, met {met}")]
    Nodes {
        /// Nodes met.
        met: usize,
    },
}

/// Links between the cells of a pack, which join them in groups in series.
#[derive(Debug, Clone, PartialEq)]
pub struct Links {
    links: Vec<Link>,
    /// Names of the nodes, from `pack-` and `pack+`.
    nodes: Vec<String>,
    /// Nodes of each link.
    ends: Vec<[usize; 2]>,
    /// Terminals of each cell, − and +, group by group.
    cells: Vec<[usize; 2]>,
    /// Groups in series.
    series: u32,
}

impl Links {
    /// Returns the links of a pack.
    ///
    /// # Errors
    /// [`LinksError`] for a link that cannot be, or if the links do not join all cells in `series` groups.
    pub fn new(links: Vec<Link>, series: u32, parallel: u32) -> Result<Self, LinksError> {
        let mut nodes = vec!["pack-".to_owned(), "pack+".to_owned()];
        let mut cells = Vec::new();
        for group in 1..=series {
            for place in 1..=parallel {
                cells.push([nodes.len(), nodes.len() + 1]);
                nodes.extend(["-", "+"].map(|sign| format!("{group}.{place}{sign}")));
            }
        }
        let terminals = nodes.len();
        let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
        for (number, name) in nodes.iter().enumerate() {
            numbers.insert(name.clone(), number);
        }
        let mut ends = Vec::new();
        for (index, link) in links.iter().enumerate() {
            check_link(index, link)?;
            let mut number = |name: &str| {
                if let Some(number) = numbers.get(name) {
                    return Ok(*number);
                }
                if is_terminal(name) {
                    let last = &nodes[terminals - 1];
                    return Err(LinksError::Link {
                        index,
                        expected: format!("a terminal of a cell from 1.1- to {last}"),
                        met: name.to_owned(),
                    });
                }
                numbers.insert(name.to_owned(), nodes.len());
                nodes.push(name.to_owned());
                Ok(nodes.len() - 1)
            };
            ends.push([number(&link.from)?, number(&link.to)?]);
        }
        if nodes.len() > MOST_NODES {
            return Err(LinksError::Nodes { met: nodes.len() });
        }
        if let Some(node) = (0..terminals).find(|node| !ends.as_flattened().contains(node)) {
            let node = nodes[node].clone();
            return Err(LinksError::Unlinked { node });
        }
        let met = Self {
            links,
            nodes,
            ends,
            cells,
            series,
        };
        met.check_paths()?;
        met.check_at_rest()?;
        Ok(met)
    }

    /// Returns the number of links.
    pub fn count(&self) -> usize {
        self.links.len()
    }

    /// Returns the resistance that the links have together, as one in series with equal cells of a
    /// resistance, Ω.
    pub fn equivalent_ohm(&self, cell_ohm: f64) -> f64 {
        let (zeros, each_ohm) = (
            vec![0.0; self.cells.len()],
            vec![cell_ohm; self.cells.len()],
        );
        let mut recent = Recent::default();
        let Some(solved) = self.solve(&mut recent, &zeros, &each_ohm) else {
            return f64::NAN;
        };
        // In groups that share their busbars, each has cell_ohm/P.
        let series = f64::from(self.series);
        let parallel = self.cells.len() as f64 / series;
        solved.source().1 - series / parallel * cell_ohm
    }

    fn check_paths(&self) -> Result<(), LinksError> {
        let mut reached = vec![false; self.nodes.len()];
        reached[MINUS] = true;
        loop {
            let mut grown = false;
            for [a, b] in self.ends.iter().chain(&self.cells) {
                if reached[*a] != reached[*b] {
                    (reached[*a], reached[*b], grown) = (true, true, true);
                }
            }
            if !grown {
                break;
            }
        }
        match reached.iter().position(|reached| !reached) {
            Some(apart) => Err(LinksError::Apart {
                node: self.nodes[apart].clone(),
            }),
            None => Ok(()),
        }
    }

    /// Checks that equal cells rest without a load, and that as many as the pack has lie in series.
    fn check_at_rest(&self) -> Result<(), LinksError> {
        let (series, ones) = (self.series, vec![1.0; self.cells.len()]);
        let mut recent = Recent::default();
        let Some(solved) = self.solve(&mut recent, &ones, &ones) else {
            let met = f64::NAN;
            return Err(LinksError::Series { series, met });
        };
        let (mut cell_a, mut link_a) = (ones.clone(), vec![0.0; self.count()]);
        self.write_currents(solved, &ones, 0.0, &mut cell_a, &mut link_a);
        let largest = |a: &usize, b: &usize| cell_a[*a].abs().total_cmp(&cell_a[*b].abs());
        if let Some(most) = (0..cell_a.len()).max_by(largest)
            && cell_a[most].abs() > AT_REST
        {
            let plus = &self.nodes[self.cells[most][1]];
            let cell = plus.trim_end_matches('+').to_owned();
            return Err(LinksError::Short { cell });
        }
        let met = solved.source().0;
        if (met - f64::from(series)).abs() > AT_REST {
            return Err(LinksError::Series { series, met });
        }
        Ok(())
    }

    /// Solves for the voltages of the nodes, from the voltages, V, and the resistances, Ω, of the cells; a
    /// recent solution for the same resistances spares their factors. `None` if the equations have no solution.
    pub(super) fn solve<'s>(
        &self,
        recent: &'s mut Recent,
        e_v: &[f64],
        behind_ohm: &[f64],
    ) -> Option<&'s Solved> {
        let solved = recent.find(behind_ohm, || self.factorise(behind_ohm))?;
        let sources = self.cells.iter().zip(e_v).zip(behind_ohm);
        let mut open_v = DVector::zeros(self.nodes.len() - 1);
        for (([minus, plus], e_v), r_ohm) in sources {
            let current_a = e_v / r_ohm;
            for (node, current_a) in [(*plus, current_a), (*minus, -current_a)] {
                if node != MINUS {
                    open_v[node - 1] += current_a;
                }
            }
        }
        solved.factor.solve_mut(&mut open_v);
        solved.open_v = open_v;
        Some(solved)
    }

    /// The Laplacian without the row and column of `pack-`, and its solution for 1 A into `pack+`.
    fn factorise(&self, behind_ohm: &[f64]) -> Option<Solved> {
        let size = self.nodes.len() - 1;
        let mut laplacian = DMatrix::zeros(size, size);
        let links = self
            .ends
            .iter()
            .zip(self.links.iter().map(|link| link.r_ohm));
        let cells = self.cells.iter().zip(behind_ohm.iter().copied());
        for ([a, b], r_ohm) in links.chain(cells) {
            let siemens = 1.0 / r_ohm;
            for node in [*a, *b] {
                if node != MINUS {
                    laplacian[(node - 1, node - 1)] += siemens;
                }
            }
            if *a != MINUS && *b != MINUS {
                laplacian[(a - 1, b - 1)] -= siemens;
                laplacian[(b - 1, a - 1)] -= siemens;
            }
        }
        let factor = Cholesky::new(laplacian)?;
        let mut unit_v = DVector::zeros(size);
        unit_v[PLUS - 1] = 1.0;
        factor.solve_mut(&mut unit_v);
        Some(Solved {
            behind_ohm: behind_ohm.to_vec(),
            factor,
            open_v: DVector::zeros(size),
            unit_v,
        })
    }

    /// Writes the currents of cells (discharge positive) and of links, A, under a current of the pack, from
    /// the voltages of the cells that were solved, V.
    pub(super) fn write_currents(
        &self,
        solved: &Solved,
        e_v: &[f64],
        current_a: f64,
        cell_a: &mut [f64],
        link_a: &mut [f64],
    ) {
        let at = |node: usize| match node {
            MINUS => 0.0,
            node => solved.open_v[node - 1] - current_a * solved.unit_v[node - 1],
        };
        for (k, [minus, plus]) in self.cells.iter().enumerate() {
            cell_a[k] = (e_v[k] - (at(*plus) - at(*minus))) / solved.behind_ohm[k];
        }
        let links = link_a.iter_mut().zip(&self.links).zip(&self.ends);
        for ((link_a, link), [from, to]) in links {
            *link_a = (at(*from) - at(*to)) / link.r_ohm;
        }
    }

    /// Returns the heat of all links, W, from their currents, A.
    pub(super) fn heat_w(&self, link_a: &[f64]) -> f64 {
        let links = self.links.iter().zip(link_a);
        links.map(|(link, i)| link.r_ohm * i * i).sum()
    }
}

/// Refuses a link that cannot be.
fn check_link(index: usize, link: &Link) -> Result<(), LinksError> {
    let fail = |expected: &str, met: String| {
        let expected = expected.to_owned();
        Err(LinksError::Link {
            index,
            expected,
            met,
        })
    };
    if let Some(met) = [&link.from, &link.to].iter().find(|name| name.is_empty()) {
        return fail("the name of a node", format!("{met:?}"));
    }
    if link.from == link.to {
        return fail("two nodes", format!("{} twice", link.from));
    }
    if !(link.r_ohm.is_finite() && link.r_ohm >= LEAST_LINK_OHM) {
        return fail("a resistance of 1e-7 Ω or more", link.r_ohm.to_string());
    }
    if let Some(met) = link.heat_j_per_k
        && !(met.is_finite() && met > 0.0)
    {
        return fail("a heat capacity above 0 J/K", met.to_string());
    }
    Ok(())
}

/// Returns whether a name is that of a terminal of a cell in any pack.
fn is_terminal(name: &str) -> bool {
    let cell = name.strip_suffix(['+', '-']);
    let parts = cell.and_then(|cell| cell.split_once('.'));
    parts.is_some_and(|(group, place)| {
        let number = |text: &str| text.parse::<u32>().is_ok();
        number(group) && number(place)
    })
}

/// The last two solutions: a step takes the resistances to its end and those of an instant in turn.
#[derive(Debug, Clone, Default)]
pub(super) struct Recent([Option<Solved>; 2]);

impl Recent {
    /// Returns the solution for resistances, Ω, that is known, or else a new one in the place of the older.
    fn find(
        &mut self,
        behind_ohm: &[f64],
        factorise: impl FnOnce() -> Option<Solved>,
    ) -> Option<&mut Solved> {
        let Self([last, older]) = self;
        let is_known = |solved: &Option<Solved>| {
            let solved = solved.as_ref();
            solved.is_some_and(|solved| solved.behind_ohm == behind_ohm)
        };
        if !is_known(last) {
            std::mem::swap(last, older);
        }
        if !is_known(last) {
            *last = factorise();
        }
        last.as_mut()
    }
}

/// Voltages of the nodes for resistances of the cells.
#[derive(Debug, Clone)]
pub(super) struct Solved {
    behind_ohm: Vec<f64>,
    factor: Cholesky<f64, Dyn>,
    /// Without a load, V.
    open_v: DVector<f64>,
    /// Fall under 1 A from the pack, V.
    unit_v: DVector<f64>,
}

impl Solved {
    /// Returns the voltage of the pack without a load, V, and its resistance, Ω.
    pub(super) fn source(&self) -> (f64, f64) {
        (self.open_v[PLUS - 1], self.unit_v[PLUS - 1])
    }
}

#[cfg(test)]
mod tests;
