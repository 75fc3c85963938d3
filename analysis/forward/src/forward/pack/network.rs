//! Cells that are not alike, wired to a pack: cells in parallel share a voltage, groups in series
//! share a current.
//!
//! At an instant every cell is a source Eₖ = OCV − Σvⱼ behind Rₖ (its series resistance and its
//! tab). A group is then a source ΣGₖEₖ/ΣGₖ behind 1/ΣGₖ with Gₖ = 1/Rₖ, the pack the sum of its
//! groups and the interconnect, and the law of [`crate::forward::Drive`] gives its current. The
//! current of each cell follows as (Eₖ − V)/Rₖ. Over a step every current is linear; its end enters
//! the branches linearly, so that the end of the step is the same network with other Eₖ and Rₖ:
//! implicit, second order, and no iteration.

use crate::forward::{Beyond, Demand, Drive, OcvSource};
use analysis_model::model::Erm;

/// One cell in its place.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    pub(super) erm: Erm,
    /// Over that of the OCV curve.
    pub(super) capacity_ratio: f64,
    pub(super) soc: f64,
}

/// Wiring between the cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wiring {
    pub(super) parallel: usize,
    /// Between a cell and the busbar of its group, Ω.
    pub(super) tab_ohm: f64,
    /// In series with all groups, Ω.
    pub(super) interconnect_ohm: f64,
}

/// The pack at an instant.
#[derive(Debug, Clone, Default)]
pub(super) struct Look {
    pub(super) current_a: f64,
    pub(super) ccv_v: f64,
    /// The requested power exceeded the available power.
    pub(super) infeasible: bool,
    pub(super) cell_a: Vec<f64>,
    /// At the cells' own terminals, before the tab.
    pub(super) cell_v: Vec<f64>,
    /// Joule heat in each cell, W.
    pub(super) heat_w: Vec<f64>,
}

/// Branches of all cells over one step: decay, and Ω per ampere at start and end.
#[derive(Debug, Clone, Copy)]
struct Gain {
    decay: f64,
    start: f64,
    end: f64,
}

/// Cells, their wiring and their states.
pub(super) struct Network<'a> {
    ocv: &'a OcvSource,
    wiring: Wiring,
    /// Branches of a cell.
    rc: usize,
    r_ohm: Vec<f64>,
    branches: Vec<(f64, f64)>,
    capacity_coulomb: Vec<f64>,
    gains: Vec<Gain>,
    gains_step_s: f64,
    pub(super) soc: Vec<f64>,
    v_rc: Vec<f64>,
    e_v: Vec<f64>,
    behind_ohm: Vec<f64>,
    start_a: Vec<f64>,
    pub(super) now: Look,
}

impl<'a> Network<'a> {
    /// Cells at rest, group by group.
    pub(super) fn new(cells: &[Cell], ocv: &'a OcvSource, wiring: Wiring) -> Self {
        let n = cells.len();
        let rc = cells.first().map_or(0, |c| c.erm.branches.len());
        let capacity_coulomb = match ocv {
            OcvSource::Constant(_) => f64::INFINITY,
            OcvSource::Curve(curve) => 3600.0 * curve.capacity_ah,
        };
        Self {
            ocv,
            wiring,
            rc,
            r_ohm: cells.iter().map(|c| c.erm.r_ohm).collect(),
            branches: cells
                .iter()
                .flat_map(|c| c.erm.branches.iter().map(|b| (b.r_ohm, b.c_f)))
                .collect(),
            capacity_coulomb: cells
                .iter()
                .map(|c| capacity_coulomb * c.capacity_ratio)
                .collect(),
            gains: Vec::new(),
            gains_step_s: f64::NAN,
            soc: cells.iter().map(|c| c.soc).collect(),
            v_rc: vec![0.0; n * rc],
            e_v: vec![0.0; n],
            behind_ohm: vec![0.0; n],
            start_a: vec![0.0; n],
            now: Look {
                cell_a: vec![0.0; n],
                cell_v: vec![0.0; n],
                heat_w: vec![0.0; n],
                ..Look::default()
            },
        }
    }

    fn ocv_at(&self, soc: f64) -> (f64, f64) {
        match self.ocv {
            OcvSource::Constant(v) => (*v, 0.0),
            OcvSource::Curve(curve) => curve.at(soc),
        }
    }

    fn cell_branches(&self, cell: usize) -> std::ops::Range<usize> {
        cell * self.rc..(cell + 1) * self.rc
    }

    /// Computes all currents and voltages under a demand in the present state. Returns false if the
    /// pack has no voltage left.
    pub(super) fn look(&mut self, demand: Demand, value: f64) -> bool {
        for k in 0..self.soc.len() {
            let held: f64 = self.v_rc[self.cell_branches(k)].iter().sum();
            self.e_v[k] = self.ocv_at(self.soc[k]).0 - held;
            self.behind_ohm[k] = self.r_ohm[k] + self.wiring.tab_ohm;
        }
        let sound = self.solve(demand, value);
        for k in 0..self.soc.len() {
            let i = self.now.cell_a[k];
            self.now.cell_v[k] = self.e_v[k] - self.r_ohm[k] * i;
            let branches = self.v_rc[self.cell_branches(k)]
                .iter()
                .zip(&self.branches[self.cell_branches(k)]);
            self.now.heat_w[k] =
                i * i * self.r_ohm[k] + branches.map(|(v, (r, _))| v * v / r).sum::<f64>();
        }
        sound
    }

    /// Advances the state by a step, from the demand of the last [`Network::look`] to this one at
    /// its end, and evaluates the network there.
    pub(super) fn advance(&mut self, step_s: f64, demand: Demand, value: f64) -> bool {
        self.set_step(step_s);
        std::mem::swap(&mut self.start_a, &mut self.now.cell_a);
        for k in 0..self.soc.len() {
            let (i0, range) = (self.start_a[k], self.cell_branches(k));
            let gains = &self.gains[range.clone()];
            let held: f64 = gains
                .iter()
                .zip(&self.v_rc[range])
                .map(|(g, v)| g.decay * v + g.start * i0)
                .sum();
            let per_ampere = step_s / self.capacity_coulomb[k];
            // The curve is linearised about the point to which the current of the start alone would
            // lead.
            let (ocv, slope) = self.ocv_at(self.soc[k] - per_ampere * i0);
            let bend = 0.5 * slope * per_ampere;
            self.behind_ohm[k] = self.r_ohm[k]
                + self.wiring.tab_ohm
                + bend
                + gains.iter().map(|g| g.end).sum::<f64>();
            self.e_v[k] = ocv + bend * i0 - held;
        }
        let sound = self.solve(demand, value);
        for k in 0..self.soc.len() {
            let (i0, i1) = (self.start_a[k], self.now.cell_a[k]);
            for j in self.cell_branches(k) {
                let g = self.gains[j];
                self.v_rc[j] = g.decay * self.v_rc[j] + g.start * i0 + g.end * i1;
            }
            self.soc[k] -= 0.5 * step_s * (i0 + i1) / self.capacity_coulomb[k];
        }
        sound && self.look(demand, value)
    }

    /// Returns the energy in the capacitances, J.
    #[cfg(test)]
    pub(super) fn stored_j(&self) -> f64 {
        self.v_rc
            .iter()
            .zip(&self.branches)
            .map(|(v, (_, c))| 0.5 * c * v * v)
            .sum()
    }

    fn set_step(&mut self, step_s: f64) {
        // Steps read from a file differ by rounding in their last digits.
        if (step_s - self.gains_step_s).abs() <= 1e-12 * step_s {
            return;
        }
        self.gains_step_s = step_s;
        self.gains.clear();
        self.gains.extend(self.branches.iter().map(|&(r, c)| {
            let x = step_s / (r * c);
            let decay = (-x).exp();
            let mean = -(-x).exp_m1() / x;
            Gain {
                decay,
                start: r * (mean - decay),
                end: r * (1.0 - mean),
            }
        }));
    }

    /// Currents of all cells from the sources `e_v` behind `behind_ohm`.
    fn solve(&mut self, demand: Demand, value: f64) -> bool {
        let width = self.wiring.parallel;
        let groups = || {
            self.e_v
                .chunks(width)
                .zip(self.behind_ohm.chunks(width))
                .map(|(e, r)| group(e, r))
        };
        let (e_v, r_ohm) = groups().fold((0.0, self.wiring.interconnect_ohm), |(e, r), g| {
            (e + g.0, r + g.1)
        });
        if e_v.is_nan() || e_v <= 0.0 {
            return false;
        }
        let reply = Drive {
            demand,
            beyond: Beyond::Clamp,
            r_ohm,
        }
        .reply(e_v, value);
        let current = reply.current_a;
        let cells = self
            .e_v
            .chunks(width)
            .zip(self.behind_ohm.chunks(width))
            .zip(self.now.cell_a.chunks_mut(width));
        for ((e, r), i) in cells {
            let (source, inner) = group(e, r);
            let v = source - current * inner;
            for ((i, e), r) in i.iter_mut().zip(e).zip(r) {
                *i = (e - v) / r;
            }
        }
        self.now.current_a = current;
        self.now.ccv_v = e_v - current * r_ohm;
        self.now.infeasible = reply.infeasible;
        true
    }
}

/// Sources in parallel as one: its voltage, V, and its resistance, Ω.
fn group(e_v: &[f64], r_ohm: &[f64]) -> (f64, f64) {
    let (weighted, conductance) = e_v
        .iter()
        .zip(r_ohm)
        .fold((0.0, 0.0), |(e, g), (&ek, &rk)| (e + ek / rk, g + 1.0 / rk));
    (weighted / conductance, 1.0 / conductance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::{Interpolation, Method, Profile, SimModel, SimOptions, simulate};
    use analysis_model::{model::RcBranch, ocv::OcvCurve, pack::Pack};
    use proptest::prelude::*;

    fn erm() -> Erm {
        let branch = |r_ohm, tau: f64| RcBranch {
            r_ohm,
            c_f: tau / r_ohm,
        };
        Erm {
            r_ohm: 0.007,
            branches: vec![
                branch(0.001, 0.004),
                branch(0.0015, 0.1),
                branch(0.003, 6.0),
            ],
        }
    }

    fn curve() -> OcvSource {
        OcvSource::Curve(
            OcvCurve::monotone(
                4.2,
                vec![0.0, 0.1, 0.3, 0.6, 1.0],
                vec![2.5, 3.2, 3.5, 3.8, 4.2],
            )
            .unwrap(),
        )
    }

    fn power(t: f64) -> f64 {
        1500.0 + 2000.0 * (0.7 * t).sin()
    }

    /// Returns cells whose parameters differ by a factor drawn from the list.
    fn uneven(factors: &[f64]) -> Vec<Cell> {
        let cell = |f: &f64| {
            let mut erm = erm();
            erm.r_ohm *= f;
            erm.branches.iter_mut().for_each(|b| b.r_ohm *= f * f);
            Cell {
                erm,
                capacity_ratio: 2.0 - f,
                soc: 0.5 + 0.02 * (f - 1.0),
            }
        };
        factors.iter().map(cell).collect()
    }

    #[test]
    fn identical_cells_are_the_pack_model() {
        let pack = Pack::new(16, 3, 0.03).unwrap();
        let (ocv, cell) = (
            curve(),
            Cell {
                erm: erm(),
                capacity_ratio: 1.0,
                soc: 0.6,
            },
        );
        let wiring = Wiring {
            parallel: 3,
            tab_ohm: 0.0,
            interconnect_ohm: 0.03,
        };
        let mut network = Network::new(&vec![cell; 48], &ocv, wiring);
        let rows: Vec<(f64, f64)> = (0..=4000)
            .map(|k| f64::from(k) * 0.0025)
            .map(|t| (t, power(t)))
            .collect();
        let profile = Profile::new("test", Demand::Power, Interpolation::Linear, &rows).unwrap();
        let model = SimModel::pack(&erm(), ocv.clone(), pack).unwrap();
        let options = SimOptions {
            method: Method::Exact,
            ..SimOptions::default()
        };
        let expected = simulate(&model, &model.rest(0.6).unwrap(), &profile, &options).unwrap();
        network.look(Demand::Power, rows[0].1);
        let mut worst = (network.now.ccv_v - expected.trace.ccv_v[0]).abs();
        for (k, row) in rows.iter().enumerate().skip(1) {
            assert!(network.advance(row.0 - rows[k - 1].0, Demand::Power, row.1));
            assert_eq!(expected.trace.time_s[k], row.0);
            worst = worst.max((network.now.ccv_v - expected.trace.ccv_v[k]).abs());
            let fair = network.now.current_a / 3.0;
            assert!(network.now.cell_a.iter().all(|i| (i - fair).abs() < 1e-10));
        }
        // Both are second order in the step; 2.5 ms leave microvolts of 60 V.
        assert!(worst < 2e-4, "{worst} V");
        assert!((network.soc[0] - expected.end.soc).abs() < 1e-8);
    }

    /// Returns the largest difference to the error-controlled simulation of the pack when the
    /// straight pieces of a zigzag are taken in this many steps each.
    fn error_v(parts: u32) -> f64 {
        // 0.2 Ah, so that the state of charge moves the voltage as much as the branches do.
        let ocv =
            OcvSource::Curve(OcvCurve::monotone(0.2, vec![0.0, 1.0], vec![3.0, 4.2]).unwrap());
        let rows: Vec<(f64, f64)> = (0..=20)
            .map(|k| (0.4 * f64::from(k), if k % 2 == 0 { 500.0 } else { 2500.0 }))
            .collect();
        let profile = Profile::new("zigzag", Demand::Power, Interpolation::Linear, &rows).unwrap();
        let model = SimModel::pack(&erm(), ocv.clone(), Pack::new(16, 3, 0.03).unwrap()).unwrap();
        let options = SimOptions {
            tolerance_v: 1e-10,
            ..SimOptions::default()
        };
        let expected = simulate(&model, &model.rest(0.9).unwrap(), &profile, &options).unwrap();
        let cell = Cell {
            erm: erm(),
            capacity_ratio: 1.0,
            soc: 0.9,
        };
        let mut network = Network::new(
            &vec![cell; 48],
            &ocv,
            Wiring {
                parallel: 3,
                tab_ohm: 0.0,
                interconnect_ohm: 0.03,
            },
        );
        network.look(Demand::Power, rows[0].1);
        let mut worst = 0.0_f64;
        for (k, pair) in rows.windows(2).enumerate() {
            for part in 1..=parts {
                let power =
                    pair[0].1 + (pair[1].1 - pair[0].1) * f64::from(part) / f64::from(parts);
                assert!(network.advance(0.4 / f64::from(parts), Demand::Power, power));
            }
            worst = worst.max((network.now.ccv_v - expected.trace.ccv_v[k + 1]).abs());
        }
        worst
    }

    #[test]
    fn halving_the_step_quarters_the_error() {
        let (coarse, middle, fine) = (error_v(8), error_v(16), error_v(32));
        assert!(
            coarse / middle > 3.6 && middle / fine > 3.6,
            "{coarse} V, {middle} V, {fine} V"
        );
        // Even steps of 50 ms are within a millivolt of some 55 V.
        assert!(coarse < 1e-3, "{coarse} V");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn kirchhoff_and_energy(
            factors in prop::collection::vec(0.7..1.3f64, 12),
            (parallel, tab, per_group) in (
                prop::sample::select(vec![1usize, 2, 3, 4, 6, 12]),
                0.0..0.002f64,
                0.0..0.001f64,
            ),
            share in 0.2..0.9f64,
        ) {
            let (ocv, cells) = (curve(), uneven(&factors));
            let interconnect = per_group * (12 / parallel) as f64;
            let mut network = Network::new(
                &cells,
                &ocv,
                Wiring {
                    parallel,
                    tab_ohm: tab,
                    interconnect_ohm: interconnect,
                },
            );
            let (mut chemical, mut delivered, mut lost) = (0.0, 0.0, 0.0);
            let step = 5e-4;
            let mut before: Option<[f64; 3]> = None;
            for k in 0..=4000 {
                // 12 cells of 3.6 V behind at most 21 mΩ and 12 mΩ of busbar could give 1.1 kW. The
                // start is at rest: no jump for the trapezoids to miss.
                let demand_w = share * 500.0 * (f64::from(k) * step * 2.0).sin();
                let sound = if k == 0 {
                    network.look(Demand::Power, demand_w)
                } else {
                    network.advance(step, Demand::Power, demand_w)
                };
                prop_assert!(sound);
                let now = &network.now;
                prop_assert!(!now.infeasible);
                prop_assert!((now.ccv_v * now.current_a - demand_w).abs() < 1e-9);
                let mut terminal = -now.current_a * interconnect;
                for (currents, voltages) in
                    now.cell_a.chunks(parallel).zip(now.cell_v.chunks(parallel))
                {
                    prop_assert!(
                        (currents.iter().sum::<f64>() - now.current_a).abs()
                            < 1e-11 * (1.0 + now.current_a.abs())
                    );
                    let bus: Vec<f64> = currents
                        .iter()
                        .zip(voltages)
                        .map(|(i, v)| v - tab * i)
                        .collect();
                    prop_assert!(bus.iter().all(|v| (v - bus[0]).abs() < 1e-12 * 4.0));
                    terminal += bus[0];
                }
                prop_assert!((terminal - now.ccv_v).abs() < 1e-12 * 50.0);
                let work = now
                    .cell_a
                    .iter()
                    .zip(&network.soc)
                    .map(|(i, z)| i * network.ocv_at(*z).0)
                    .sum::<f64>();
                let copper = now.current_a.powi(2) * interconnect
                    + now.cell_a.iter().map(|i| i * i * tab).sum::<f64>();
                let rates = [work, demand_w, copper + now.heat_w.iter().sum::<f64>()];
                if let Some(old) = before {
                    chemical += 0.5 * step * (old[0] + rates[0]);
                    delivered += 0.5 * step * (old[1] + rates[1]);
                    lost += 0.5 * step * (old[2] + rates[2]);
                }
                before = Some(rates);
            }
            let missing = chemical - delivered - lost - network.stored_j();
            prop_assert!(
                missing.abs() < 2e-4 * chemical.abs().max(delivered.abs()).max(lost),
                "{missing} J of {chemical} J"
            );
        }
    }
}
