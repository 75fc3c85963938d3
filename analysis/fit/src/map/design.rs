//! The unknowns of a map, and the map that they are.

use super::nodes::{Wanted, nodes};
use super::options::{MapFitError, MapOptions};
use super::solve::{INDUCTANCE_H, Kinetics, Normal, Solved};
use super::train::Train;
use analysis_model::map::{CellMap, MapBranch, Surface};

/// Longest time constant of a branch of charge transfer, s: diffusion is slower.
pub(super) const SLOWEST_TRANSFER_S: f64 = 3.0;
/// Time constant of the branch that continues the spectra, over the reciprocal of their highest angular
/// frequency.
const CONTINUED: f64 = 0.5;
/// Shortest time constant of that branch, s: what is faster acts at once for a load.
const LEAST_CONTINUED_S: f64 = 1e-4;

/// The unknowns: surfaces by branch, temperature and SOC, then both corrections of the OCV by SOC,
/// then the inductance of the wiring in the spectra.
pub(super) struct Design {
    pub(super) soc: Vec<f64>,
    pub(super) nodes_degc: Vec<f64>,
    pub(super) taus_s: Vec<f64>,
    /// Third of the DC resistance at each temperature node, Ω.
    pub(super) unit_ohm: Vec<f64>,
    pub(super) ocv_temperature_degc: f64,
    /// Time constants that no log and no spectrum shows, s.
    pub(super) left_out_s: Vec<f64>,
    /// Highest angular frequency of the spectra, rad/s, if the first branch continues them.
    pub(super) continued_from: Option<f64>,
}

impl Design {
    /// Chooses the unknowns for the data and for places that are to be measured, as SOC and
    /// temperature in °C.
    pub(super) fn new(
        train: &Train,
        places: &[Wanted],
        options: &MapOptions,
    ) -> Result<Self, MapFitError> {
        if train.logs.is_empty() && train.sweeps.is_empty() {
            return Err(MapFitError::NoLogs);
        }
        let (lowest, highest) = places
            .iter()
            .fold(train.range_of_soc(), |(low, high), place| {
                (low.min(place.soc), high.max(place.soc))
            });
        let knots = &options.soc;
        let first = knots.partition_point(|z| *z <= lowest).saturating_sub(1);
        let last = knots.partition_point(|z| *z < highest).min(knots.len() - 1);
        // Data at one SOC lie on one knot: its neighbours follow by the priors.
        let (first, last) = if first < last {
            (first, last)
        } else {
            (first.saturating_sub(1), (last + 1).min(knots.len() - 1))
        };
        let (mut taus_s, left_out_s): (Vec<f64>, Vec<f64>) = options
            .time_constants_s
            .iter()
            .partition(|tau| train.shows(**tau));
        let beyond_s = |omega: &f64| (CONTINUED / omega).max(LEAST_CONTINUED_S);
        let continued_from = train.highest_omega().filter(|omega| {
            let tau_s = beyond_s(omega);
            tau_s * omega < 1.0 && !train.log_shows(tau_s)
        });
        if let Some(omega) = continued_from {
            taus_s.insert(0, beyond_s(&omega));
        }
        let (nodes_degc, unit_ohm) = nodes(train, places, options.node_distance_k)?;
        Ok(Self {
            soc: knots[first..=last].to_vec(),
            nodes_degc,
            taus_s,
            unit_ohm,
            ocv_temperature_degc: options.ocv_temperature_degc,
            left_out_s,
            continued_from,
        })
    }

    pub(super) fn surfaces(&self) -> usize {
        1 + self.taus_s.len()
    }

    pub(super) fn nodes(&self) -> usize {
        self.nodes_degc.len()
    }

    pub(super) fn index(&self, surface: usize, node: usize, knot: usize) -> usize {
        (surface * self.nodes() + node) * self.soc.len() + knot
    }

    /// Number of resistances; the corrections of the OCV follow them.
    pub(super) fn resistances(&self) -> usize {
        self.surfaces() * self.nodes() * self.soc.len()
    }

    /// Number of branches of charge transfer: the first ones.
    pub(super) fn transfer_count(&self) -> usize {
        self.taus_s
            .partition_point(|tau_s| *tau_s <= SLOWEST_TRANSFER_S)
    }

    /// Number of all unknowns.
    pub(super) fn count(&self) -> usize {
        self.resistances() + 2 * self.soc.len() + 1
    }

    /// Place of the inductance.
    pub(super) fn inductance(&self) -> usize {
        self.count() - 1
    }

    /// Solves for given kinetics.
    pub(super) fn solve(&self, train: &Train, kinetics: &Kinetics) -> Result<Solved, MapFitError> {
        self.equations(train, kinetics)
            .solve(self.resistances(), None)
    }

    /// Returns the equations of all rows and priors.
    pub(super) fn equations(&self, train: &Train, kinetics: &Kinetics) -> Normal {
        let mut normal = Normal::new(self.count());
        for log in &train.logs {
            let weight = |stands_s: f64, soc: f64| train.weight(stands_s, soc);
            self.add_log(log, train.lag_s, kinetics, weight, &mut |rows, y| {
                normal.add(rows, y);
            });
        }
        for sweep in &train.sweeps {
            let scale = train.scales.spectra;
            self.add_sweep(sweep, scale, kinetics, &mut |rows, y| normal.add(rows, y));
        }
        self.add_priors(kinetics, &mut normal);
        normal
    }

    pub(super) fn empty_map(&self, kinetics: &Kinetics) -> CellMap {
        let surface = |activation_j_per_mol| Surface {
            activation_j_per_mol,
            r_ohm: vec![vec![0.0; self.soc.len()]; self.nodes()],
            sigma_ohm: Vec::new(),
        };
        CellMap {
            soc: self.soc.clone(),
            temperature_degc: self.nodes_degc.clone(),
            series: surface(kinetics.series),
            branches: self
                .taus_s
                .iter()
                .enumerate()
                .map(|(k, tau_s)| MapBranch {
                    tau_s: *tau_s,
                    extrapolated: k == 0 && self.continued_from.is_some(),
                    resistance: surface(kinetics.branches),
                })
                .collect(),
            ocv_offset_v: vec![0.0; self.soc.len()],
            ocv_v_per_k: vec![0.0; self.soc.len()],
            ocv_temperature_degc: self.ocv_temperature_degc,
            most_current_a: None,
            charge_transfer: kinetics.around.as_ref().and_then(|map| map.charge_transfer),
            thermal: None,
            voltage_error: None,
        }
    }

    /// Returns the map of a solution, without standard deviations.
    pub(super) fn map(&self, kinetics: &Kinetics, solved: &Solved) -> CellMap {
        let mut map = self.empty_map(kinetics);
        let rows = |surface: usize| self.rows(surface, |k| solved.x[k].max(0.0));
        // The series resistance of a place that no row has reached may be zero; a cell's is not.
        let least_ohm = 1e-3 * self.unit_ohm.iter().fold(f64::INFINITY, |a, r| a.min(*r));
        map.series.r_ohm = rows(0);
        for r_ohm in map.series.r_ohm.iter_mut().flatten() {
            *r_ohm = r_ohm.max(least_ohm);
        }
        for (k, branch) in map.branches.iter_mut().enumerate() {
            branch.resistance.r_ohm = rows(k + 1);
        }
        let (start, knots) = (self.resistances(), self.soc.len());
        map.ocv_offset_v = (0..knots).map(|k| solved.x[start + k]).collect();
        map.ocv_v_per_k = (0..knots).map(|k| solved.x[start + knots + k]).collect();
        map
    }

    /// Returns the inductance of the wiring in the spectra, H.
    pub(super) fn inductance_h(&self, solved: &Solved) -> f64 {
        INDUCTANCE_H * solved.x[self.inductance()]
    }

    /// Writes the standard deviations of the resistances.
    pub(super) fn write_sigma(&self, map: &mut CellMap, solved: &Solved) {
        let rows = |surface: usize| self.rows(surface, |k| solved.variance[k].sqrt());
        map.series.sigma_ohm = rows(0);
        for (k, branch) in map.branches.iter_mut().enumerate() {
            branch.resistance.sigma_ohm = rows(k + 1);
        }
    }

    fn rows(&self, surface: usize, value: impl Fn(usize) -> f64) -> Vec<Vec<f64>> {
        let row = |node: usize| {
            let knots = 0..self.soc.len();
            knots
                .map(|knot| value(self.index(surface, node, knot)))
                .collect()
        };
        (0..self.nodes()).map(row).collect()
    }
}
