//! Cells with maps side by side: everything the inner loop touches.

use super::super::cell::{BatchCell, BatchOutcome};
use super::super::law::{BEND, CLAMPED, CURRENT, LOAD, LaneDemand, TANGENT, current};
use super::super::ocv_piece::{LaneCurve, Row};
use super::super::plan::Plan;
use super::super::tally::Tally;
use super::tables::{ChargeAndWarmth, LaneMap, Piece, Surface};
use crate::forward::law::{Beyond, Demand};
use crate::forward::model::{Mapped, OcvSource, SimModel, SimState};
use analysis_model::map::{BranchStep, CellMap, Drive, Outside};

/// A cell with a map.
#[derive(Debug, Clone, Copy)]
pub(in crate::forward) struct MapCell<'a> {
    model: &'a SimModel,
    mapped: &'a Mapped,
    curve: LaneCurve<'a>,
    /// Factor of the demand.
    scale: f64,
}

impl<'a> MapCell<'a> {
    /// Returns a cell whose demand has a factor, if its model has a map.
    pub(in crate::forward) fn of(model: &'a SimModel, scale: f64) -> Option<Self> {
        let OcvSource::Curve(curve) = &model.ocv else {
            return None;
        };
        let series = f64::from(model.pack.series);
        Some(Self {
            model,
            mapped: model.mapped.as_ref()?,
            curve: LaneCurve { curve, series },
            scale,
        })
    }

    fn map(&self) -> &'a CellMap {
        &self.mapped.map
    }

    /// Temperature in a state, °C: without a heat capacity that of the surroundings.
    fn degc(&self, state: &SimState) -> f64 {
        let moving = self.map().thermal.and(state.temperature_degc);
        moving.unwrap_or(self.mapped.ambient_degc)
    }

    /// Returns what a second and a watt do to the temperature over the surroundings over a step: the
    /// share that stays, and K/W.
    fn warmed(&self, step_s: f64) -> [f64; 2] {
        let Some(thermal) = self.map().thermal else {
            return [0.0; 2];
        };
        let pack = self.model.pack;
        let cells = f64::from(pack.series) * f64::from(pack.parallel);
        let rate = step_s / (thermal.capacity_j_per_k * thermal.resistance_k_per_w);
        let lost = -(-rate).exp_m1();
        [1.0 - lost, lost * thermal.resistance_k_per_w / cells]
    }
}

/// W cells with maps. A block has L numbers, L/W branches of each cell: one of many cells, or eight of
/// one.
#[derive(Debug, Clone)]
pub(in crate::forward) struct MapLanes<'a, const W: usize, const L: usize> {
    cells: [MapCell<'a>; W],
    pub(super) fixed: Fixed<W>,
    pub(super) now: Now<W>,
    pub(super) piece: Piece<W>,
    pub(super) blocks: Vec<Block<L>>,
    pub(super) gains: Vec<Gains<W, L>>,
    /// Room for the resistances at the corners of a piece.
    ohm: [Vec<f64>; 4],
    pub(super) tally: Tally<W>,
}

/// What stays.
#[derive(Debug, Clone)]
pub(super) struct Fixed<const W: usize> {
    pub(super) interconnect: Row<W>,
    /// Factor of the demand.
    pub(super) scale: Row<W>,
    /// Temperature of the surroundings, °C.
    pub(super) ambient: Row<W>,
    /// Smallest resistance of a branch in its bend and its heat, Ω.
    pub(super) floor: Row<W>,
    pub(super) law: Law,
    /// Branches of charge transfer, which come first, and their blocks.
    bent_branches: usize,
    pub(super) bent_blocks: usize,
    /// Whether the temperature of a cell moves.
    pub(super) heated: bool,
}

/// Treatment of the demand.
#[derive(Debug, Clone, Copy)]
pub(super) struct Law {
    pub(super) kind: u8,
    /// P₀/P*, where the tangent or the bend begins, and c = √(1 − P₀/P*).
    fraction: f64,
    c: f64,
}

impl Law {
    fn new(demand: Demand, beyond: Beyond) -> Self {
        let fraction = beyond.fraction().unwrap_or(1.0);
        let kind = match (demand, beyond) {
            (Demand::Current, _) => CURRENT,
            (Demand::Resistance, _) => LOAD,
            (Demand::Power, Beyond::Extrapolate { .. }) => TANGENT,
            (Demand::Power, Beyond::Bend { .. }) => BEND,
            (Demand::Power, Beyond::Stop | Beyond::Clamp) => CLAMPED,
        };
        Self {
            kind,
            fraction,
            c: (1.0 - fraction).sqrt(),
        }
    }

    /// Returns the current at E, V, behind a resistance, Ω, under a demand, and whether the requested
    /// power exceeded the available power.
    #[inline(always)]
    pub(super) fn current<const LAW: u8>(self, e_v: f64, r_ohm: f64, demand: f64) -> (f64, bool) {
        let c = self.c;
        let tangent = if LAW == TANGENT {
            [1.0 / c, (1.0 - c) * (1.0 - c) / (4.0 * c * r_ohm)]
        } else {
            [0.0; 2]
        };
        current::<LAW>(LaneDemand {
            e_v,
            r_ohm,
            demand,
            fraction: self.fraction,
            tangent,
        })
    }
}

/// State that changes with every step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Now<const W: usize> {
    pub(super) soc: Row<W>,
    /// Temperature, °C.
    pub(super) degc: Row<W>,
    /// OCV − Σvₖ, V.
    pub(super) e: Row<W>,
    /// Series resistance with the interconnect, Ω.
    pub(super) r: Row<W>,
    /// Twice the exchange current, A.
    pub(super) twice: Row<W>,
    /// Heat of the branches in the last step, W.
    pub(super) lost: Row<W>,
    /// Lowest and highest state of charge and temperature.
    pub(super) seen_soc: [Row<W>; 2],
    pub(super) seen_degc: [Row<W>; 2],
}

/// L/W branches of each cell, one after the other.
#[derive(Debug, Clone)]
pub(super) struct Block<const L: usize> {
    pub(super) table: Surface<L>,
    pub(super) v: Row<L>,
    /// Resistance, Ω.
    pub(super) r: Row<L>,
    /// Voltage over which a branch of charge transfer bends, V.
    pub(super) bend: Row<L>,
    /// Change of the voltage with the current at the end of the step, Ω.
    pub(super) push: Row<L>,
    /// Factor of the bend: 1, or [`STRAIGHT`].
    pub(super) straight: Row<L>,
}

/// Factor of the bend of a linear branch beside bent ones of other cells.
const STRAIGHT: f64 = 1e9;

/// Action of one step length on each cell.
#[derive(Debug, Clone)]
pub(super) struct Gains<const W: usize, const L: usize> {
    pub(super) step_s: f64,
    /// SOC per ampere over the step.
    pub(super) soc: Row<W>,
    /// Share of the temperature over the surroundings that stays, and K/W.
    pub(super) warmed: [Row<W>; 2],
    pub(super) blocks: Vec<BlockGains<L>>,
}

/// Action of one step length on each branch, as [`BranchStep`] states it.
#[derive(Debug, Clone)]
pub(super) struct BlockGains<const L: usize> {
    pub(super) decay: Row<L>,
    pub(super) start: Row<L>,
    pub(super) end: Row<L>,
    pub(super) ratio: Row<L>,
    pub(super) end_share: Row<L>,
}

impl<'a, const W: usize, const L: usize> MapLanes<'a, W, L> {
    /// Prepares cells for steps of some lengths, s; their states are not yet loaded. Lanes beyond the
    /// last cell repeat it; `None` without a cell.
    pub(in crate::forward) fn new(
        given: &[MapCell<'a>],
        demand: Demand,
        beyond: Beyond,
        lengths_s: &[f64],
    ) -> Option<Self> {
        let last = *given.last()?;
        let cells: [MapCell<'a>; W] = std::array::from_fn(|l| *given.get(l).unwrap_or(&last));
        let row =
            |f: &dyn Fn(&MapCell<'a>) -> f64| -> Row<W> { std::array::from_fn(|l| f(&cells[l])) };
        let most = |f: &dyn Fn(&MapCell<'a>) -> usize| cells.iter().map(f).max().unwrap_or(0);
        let bent_branches = most(&|cell| cell.map().transfer_count());
        let branches = most(&|cell| cell.map().branches.len());
        let bent_blocks = bent_branches.div_ceil(L / W);
        let blocks = bent_blocks + (branches - bent_branches).div_ceil(L / W);
        let mut lanes = Self {
            fixed: Fixed {
                interconnect: row(&|c| c.model.pack.interconnect_ohm),
                scale: row(&|c| c.scale),
                ambient: row(&|c| c.mapped.ambient_degc),
                floor: row(&|c| c.model.pack.ratio() * Drive::LEAST_OHM),
                law: Law::new(demand, beyond),
                bent_branches,
                bent_blocks,
                heated: cells.iter().any(|c| c.map().thermal.is_some()),
            },
            now: Now {
                soc: [0.0; W],
                degc: [0.0; W],
                e: [0.0; W],
                r: [0.0; W],
                twice: [0.0; W],
                lost: [0.0; W],
                seen_soc: [[f64::INFINITY; W], [f64::NEG_INFINITY; W]],
                seen_degc: [[f64::INFINITY; W], [f64::NEG_INFINITY; W]],
            },
            piece: Piece::new(),
            blocks: vec![Block::new(); blocks],
            gains: Vec::new(),
            ohm: std::array::from_fn(|_| vec![0.0; branches]),
            tally: Tally::new(),
            cells,
        };
        lanes.gains = lengths_s.iter().map(|h| lanes.gain(*h)).collect();
        for (l, cell) in cells.iter().enumerate() {
            for k in 0..cell.map().transfer_count() {
                let (block, j) = lanes.slot(l, k);
                lanes.blocks[block].straight[j] = 1.0;
            }
        }
        Some(lanes)
    }

    /// Block and place in it of a branch of a lane.
    fn slot(&self, l: usize, branch: usize) -> (usize, usize) {
        let (bent, abreast) = (self.fixed.bent_branches, L / W);
        let (first, at) = if branch < bent {
            (0, branch)
        } else {
            (self.fixed.bent_blocks, branch - bent)
        };
        (first + at / abreast, at % abreast * W + l)
    }

    fn gain(&self, step_s: f64) -> Gains<W, L> {
        let none = BlockGains {
            decay: [0.0; L],
            start: [0.0; L],
            end: [0.0; L],
            ratio: [0.0; L],
            end_share: [0.0; L],
        };
        let mut blocks = vec![none; self.blocks.len()];
        let mut warmed = [[0.0; W]; 2];
        for (l, cell) in self.cells.iter().enumerate() {
            for (k, branch) in cell.map().branches.iter().enumerate() {
                let (block, j) = self.slot(l, k);
                let (gain, step) = (&mut blocks[block], BranchStep::new(step_s, branch.tau_s));
                gain.decay[j] = step.decay;
                gain.start[j] = step.start;
                gain.end[j] = step.end;
                gain.ratio[j] = step.ratio;
                gain.end_share[j] = step.end_share;
            }
            let [keep, warm] = cell.warmed(step_s);
            (warmed[0][l], warmed[1][l]) = (keep, warm);
        }
        let capacity = |l: usize| self.cells[l].model.capacity_coulomb();
        Gains {
            step_s,
            soc: std::array::from_fn(|l| step_s / capacity(l)),
            warmed,
            blocks,
        }
    }

    /// Puts a lane into a state.
    pub(in crate::forward) fn load(&mut self, l: usize, state: &SimState) {
        let degc = self.cells[l].degc(state);
        (self.now.soc[l], self.now.degc[l]) = (state.soc, degc);
        for (k, v) in state.v_rc_v.iter().enumerate() {
            let (block, j) = self.slot(l, k);
            self.blocks[block].v[j] = *v;
        }
        for (seen, here) in [
            (&mut self.now.seen_soc, state.soc),
            (&mut self.now.seen_degc, degc),
        ] {
            seen[0][l] = seen[0][l].min(here);
            seen[1][l] = seen[1][l].max(here);
        }
        if self.piece.is_left::<true>(l, state.soc, degc) {
            self.find_piece(l);
        }
        self.settle(l);
        if self.fixed.heated {
            self.now.lost[l] = self.lost_w(l);
        }
    }

    /// Moves every lane that has left its piece to that in which it now is.
    #[cold]
    pub(super) fn find_pieces(&mut self) {
        for l in 0..W {
            if self
                .piece
                .is_left::<true>(l, self.now.soc[l], self.now.degc[l])
            {
                self.find_piece(l);
                self.settle(l);
            }
        }
    }

    fn find_piece(&mut self, l: usize) {
        let cell = self.cells[l];
        let lane = LaneMap {
            map: cell.map(),
            curve: cell.curve,
            pack: cell.model.pack,
            heated: cell.map().thermal.is_some(),
        };
        let (mut piece, mut ohm) = (self.piece, std::mem::take(&mut self.ohm));
        let state = ChargeAndWarmth {
            soc: self.now.soc[l],
            degc: self.now.degc[l],
        };
        piece.find(l, lane, state, &mut ohm, |k, value| {
            let (block, j) = self.slot(l, k);
            value.put(&mut self.blocks[block].table, j);
        });
        (self.piece, self.ohm) = (piece, ohm);
    }

    /// Computes what follows from the state of a lane and its piece.
    fn settle(&mut self, l: usize) {
        let place = self.piece.place(l, self.now.soc[l], self.now.degc[l]);
        let series_ohm = self.piece.series_ohm::<true>(l, place);
        self.now.r[l] = series_ohm + self.fixed.interconnect[l];
        self.now.twice[l] = self.piece.twice_a::<true>(l, place);
        let mut sum_v = 0.0;
        for block in &mut self.blocks {
            for j in (l..L).step_by(W) {
                block.r[j] = block.table.at::<true>(j, place);
                block.bend[j] =
                    self.now.twice[l] * block.r[j].max(self.fixed.floor[l]) * block.straight[j];
                sum_v += block.v[j];
            }
        }
        self.now.e[l] = self.piece.ocv_v::<true>(l, place) - sum_v;
    }

    /// Heat of the branches of a lane, W.
    fn lost_w(&self, l: usize) -> f64 {
        let mut lost_w = 0.0;
        for (index, block) in self.blocks.iter().enumerate() {
            for j in (l..L).step_by(W) {
                let bend_v = if index < self.fixed.bent_blocks {
                    block.bend[j]
                } else {
                    f64::INFINITY
                };
                let drive = Drive {
                    driven_v: 0.0,
                    bend_v,
                };
                let (v, r_ohm) = (block.v[j], block.r[j].max(self.fixed.floor[l]));
                lost_w += v * drive.leaking_v(v) / r_ohm;
            }
        }
        lost_w
    }

    /// Writes the state of a lane.
    pub(in crate::forward) fn store(&self, l: usize, state: &mut SimState) {
        state.soc = self.now.soc[l];
        state.temperature_degc = Some(self.now.degc[l]);
        for (k, v) in state.v_rc_v.iter_mut().enumerate() {
            let (block, j) = self.slot(l, k);
            *v = self.blocks[block].v[j];
        }
    }

    /// Returns OCV − Σvₖ, V, and the series resistance, Ω, of a lane.
    pub(in crate::forward) fn source(&self, l: usize) -> (f64, f64) {
        (self.now.e[l], self.now.r[l])
    }

    /// Returns the distance of a lane's state from the range of its map.
    pub(in crate::forward) fn outside(&self, l: usize) -> Outside {
        self.cells[l]
            .map()
            .place(self.now.soc[l], self.now.degc[l])
            .outside
    }

    /// Returns the result of a lane, which is that of a cell.
    pub(super) fn outcome(&self, l: usize, cell: &BatchCell<'_>, plan: &Plan<'_>) -> BatchOutcome {
        let mut end = cell.state.clone();
        self.store(l, &mut end);
        let farthest = |side: usize| {
            let (soc, degc) = (self.now.seen_soc[side][l], self.now.seen_degc[side][l]);
            self.cells[l].map().place(soc, degc).outside
        };
        let outside = farthest(0).farther(farthest(1));
        self.tally.outcome(l, cell, plan, end, Some(outside))
    }
}

impl<const L: usize> Block<L> {
    fn new() -> Self {
        Self {
            table: Surface::ZERO,
            v: [0.0; L],
            r: [0.0; L],
            bend: [1.0; L],
            push: [0.0; L],
            straight: [STRAIGHT; L],
        }
    }
}
