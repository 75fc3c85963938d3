//! The hottest path through the links of a pack.

use super::{Links, MINUS, PLUS};

impl Links {
    /// Returns the hottest path: of all that follow the current from `pack-` to `pack+`, its nodes on the one
    /// whose links have the most heat together.
    pub(super) fn hottest_path(&self, cell_a: &[f64], link_a: &[f64]) -> Vec<usize> {
        // The current of a cell leaves its plus terminal, and enters the pack at `pack-`.
        let cells = self
            .cells
            .iter()
            .zip(cell_a)
            .map(|(ends, i)| (ends, *i, 0.0));
        let links = self.links.iter().zip(&self.ends).zip(link_a);
        let links = links.map(|((link, ends), i)| (ends, *i, link.r_ohm * i * i));
        let all: Vec<(&[usize; 2], f64, f64)> = cells.chain(links).collect();
        let entering = |([a, b], i, _): &(&[usize; 2], f64, f64)| {
            i * (f64::from(*a == MINUS) - f64::from(*b == MINUS))
        };
        let backwards = all.iter().map(entering).sum::<f64>() < 0.0;
        let mut away = vec![Vec::new(); self.nodes.len()];
        for ([a, b], i, heat_w) in all {
            let (from, to) = if (i < 0.0) == backwards {
                (a, b)
            } else {
                (b, a)
            };
            away[*from].push((*to, heat_w));
        }
        let mut search = HottestPath {
            away,
            best: vec![None; self.nodes.len()],
        };
        search.heat_to_plus_w(MINUS);
        let mut path = vec![MINUS];
        while let Some((_, Some(next))) = path.last().and_then(|node| search.best[*node]) {
            path.push(next);
        }
        path
    }
}

/// Search of the hottest path.
struct HottestPath {
    /// From each node in the direction of the current: the next node, and the heat on the way, W.
    away: Vec<Vec<(usize, f64)>>,
    /// Of each node that was searched the heat to `pack+`, W, −∞ without a way there, and the next node.
    best: Vec<Option<(f64, Option<usize>)>>,
}

impl HottestPath {
    /// Returns the heat from a node to `pack+`, W.
    fn heat_to_plus_w(&mut self, node: usize) -> f64 {
        if node == PLUS {
            return 0.0;
        }
        if let Some((heat_w, _)) = self.best[node] {
            return heat_w;
        }
        // A node is not on its own way: cells that charge each other make circles.
        self.best[node] = Some((f64::NEG_INFINITY, None));
        for (next, heat_w) in self.away[node].clone() {
            let whole_w = heat_w + self.heat_to_plus_w(next);
            if self.best[node].is_some_and(|(most_w, _)| whole_w > most_w) {
                self.best[node] = Some((whole_w, Some(next)));
            }
        }
        self.best[node].map_or(f64::NEG_INFINITY, |(heat_w, _)| heat_w)
    }
}
