//! Assigns cells to benches, and sets the order of the measurements.
//!
//! Each cell goes to the benches that have the fewest cells so far, and among those to the
//! benches that share the fewest cells with its other benches, so that pairs of benches are
//! compared equally often. The order on a bench is random within a round, so that a drift of the
//! bench does not appear as a difference between batches. All first visits come before all second
//! ones.

use std::collections::BTreeMap;

use analysis::numeric::Rng;

use super::{CampaignFile, CellOfCampaign};

/// A cell on a bench.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Visit {
    /// The cell.
    pub cell: CellOfCampaign,
    /// Number of the bench, from 0.
    pub bench: usize,
    /// Number of the visit of this cell to this bench, from 1; references come several times.
    pub repeat: usize,
    /// It is a reference.
    pub is_reference: bool,
}

/// Visits of a campaign, for each bench in their order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Design {
    /// One list for each bench.
    pub benches: Vec<Vec<Visit>>,
}

impl Design {
    /// Creates the design of a campaign. It is deterministic for a given file.
    pub fn of(file: &CampaignFile) -> Self {
        let mut rng = Rng::new(file.seed);
        let mut order: Vec<usize> = (0..file.cells.len()).collect();
        shuffle(&mut order, &mut rng);
        let mut rounds = vec![vec![Vec::new(); file.benches.len()]; file.benches_per_cell];
        let mut loads = Loads::new(file.benches.len());
        for cell in order {
            let mut benches = loads.choose(file.benches_per_cell, &mut rng);
            // The first bench of a cell is random, so that the order does not appear as a
            // difference either.
            shuffle(&mut benches, &mut rng);
            for (round, bench) in benches.into_iter().enumerate() {
                rounds[round][bench].push(cell);
            }
        }
        let benches = (0..file.benches.len())
            .map(|bench| {
                let cells = rounds.iter().flat_map(|round| {
                    let mut cells = round[bench].clone();
                    shuffle(&mut cells, &mut rng);
                    cells
                });
                visits(file, bench, &cells.collect::<Vec<usize>>())
            })
            .collect();
        Self { benches }
    }

    /// Number of visits.
    pub fn len(&self) -> usize {
        self.benches.iter().map(Vec::len).sum()
    }

    /// Whether there is nothing to do.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The visits of one bench: its cells with the references between them.
fn visits(file: &CampaignFile, bench: usize, cells: &[usize]) -> Vec<Visit> {
    let mut made = Vec::new();
    let mut turns = 0;
    let mut references = |made: &mut Vec<Visit>| {
        turns += 1;
        made.extend(file.references.iter().map(|cell| Visit {
            cell: cell.clone(),
            bench,
            repeat: turns,
            is_reference: true,
        }));
    };
    references(&mut made);
    for (number, cell) in (1..).zip(cells) {
        made.push(Visit {
            cell: file.cells[*cell].clone(),
            bench,
            repeat: 1,
            is_reference: false,
        });
        let is_due = file.reference_every > 0 && number % file.reference_every == 0;
        if is_due && number < cells.len() {
            references(&mut made);
        }
    }
    references(&mut made);
    made
}

/// Cells that each bench has, and that each pair of benches shares.
struct Loads {
    cells: Vec<usize>,
    pairs: BTreeMap<(usize, usize), usize>,
}

impl Loads {
    fn new(benches: usize) -> Self {
        Self {
            cells: vec![0; benches],
            pairs: BTreeMap::new(),
        }
    }

    fn choose(&mut self, number: usize, rng: &mut Rng) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::with_capacity(number);
        for _ in 0..number {
            let key = |bench: &usize| {
                let shared = chosen.iter().map(|other| self.shared(*bench, *other));
                (self.cells[*bench], shared.sum::<usize>())
            };
            let free: Vec<usize> = (0..self.cells.len())
                .filter(|bench| !chosen.contains(bench))
                .collect();
            let Some(least) = free.iter().map(key).min() else {
                return chosen;
            };
            let best: Vec<usize> = free
                .iter()
                .copied()
                .filter(|bench| key(bench) == least)
                .collect();
            let bench = best[rng.below(best.len())];
            for other in &chosen {
                *self.pairs.entry(pair(bench, *other)).or_default() += 1;
            }
            self.cells[bench] += 1;
            chosen.push(bench);
        }
        chosen
    }

    fn shared(&self, one: usize, other: usize) -> usize {
        self.pairs.get(&pair(one, other)).copied().unwrap_or(0)
    }
}

fn pair(one: usize, other: usize) -> (usize, usize) {
    (one.min(other), one.max(other))
}

/// Fisher and Yates.
fn shuffle(items: &mut [usize], rng: &mut Rng) {
    for last in (1..items.len()).rev() {
        items.swap(last, rng.below(last + 1));
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::campaign::file::BenchOfCampaign;
    use bench_plan::config::Source;

    fn file(cells: usize, benches: usize, per_cell: usize) -> CampaignFile {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("experiment.toml");
        std::fs::write(&path, "name = \"e\"\n").unwrap();
        CampaignFile {
            name: "batch".to_owned(),
            experiment: Source::read(&path).unwrap(),
            cells: (0..cells)
                .map(|at| CellOfCampaign {
                    name: format!("c{at}"),
                    ..CellOfCampaign::default()
                })
                .collect(),
            references: vec![CellOfCampaign {
                name: "ref".to_owned(),
                ..CellOfCampaign::default()
            }],
            reference_every: 10,
            benches_per_cell: per_cell,
            benches: (0..benches)
                .map(|at| BenchOfCampaign {
                    name: format!("b{at}"),
                    file: Some(PathBuf::from("b.toml")),
                })
                .collect(),
            seed: 7,
        }
    }

    #[test]
    fn benches_have_equally_many_cells_and_pairs_of_benches_share_equally_many() {
        let design = Design::of(&file(100, 5, 2));
        let mut pairs: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        let mut of_cell: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for visits in &design.benches {
            let cells: Vec<&Visit> = visits.iter().filter(|visit| !visit.is_reference).collect();
            assert_eq!(cells.len(), 40);
            for visit in cells {
                of_cell
                    .entry(&visit.cell.name)
                    .or_default()
                    .push(visit.bench);
            }
            // At the beginning, after 10, 20 and 30 cells, and at the end.
            assert_eq!(visits.len() - 40, 5);
            assert!(visits[0].is_reference && visits[visits.len() - 1].is_reference);
        }
        assert_eq!(of_cell.len(), 100);
        for benches in of_cell.values() {
            assert!(matches!(benches.as_slice(), [a, b] if a != b));
            *pairs.entry(pair(benches[0], benches[1])).or_default() += 1;
        }
        assert_eq!(pairs.len(), 10);
        assert!(
            pairs.values().all(|shared| (8..=12).contains(shared)),
            "{pairs:?}"
        );
    }

    #[test]
    fn loads_differ_by_one_at_most_and_the_same_file_gives_the_same() {
        let design = Design::of(&file(17, 4, 3));
        let loads: Vec<usize> = design
            .benches
            .iter()
            .map(|visits| visits.iter().filter(|visit| !visit.is_reference).count())
            .collect();
        assert_eq!(loads.iter().sum::<usize>(), 51);
        assert!(
            loads.iter().all(|load| (12..=13).contains(load)),
            "{loads:?}"
        );
        assert_eq!(design, Design::of(&file(17, 4, 3)));
    }
}
