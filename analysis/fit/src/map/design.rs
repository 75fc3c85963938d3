//! Logs as linear equations of the map's unknowns.

use super::options::{MapFitError, MapLog, MapOptions};
use super::solve::{Energies, Normal, Solved};
use analysis_model::{
    map::{BranchStep, CellMap, MapBranch, Surface, TEMPERATURES_DEGC, arrhenius},
    ocv::OcvCurve,
};
use analysis_signal::series::Role;
use nalgebra::{DMatrix, DVector};

/// Error of the model that the weights assume, V, and the time over which it is correlated, s.
pub(super) const ERROR_V: f64 = 0.01;
pub(super) const CORRELATION_S: f64 = 10.0;
/// Error of the counted charge, as SOC: where the OCV is steep, the voltage says less.
const SOC_ERROR: f64 = 0.005;
/// Rows of a log at most.
const MOST_ROWS: usize = 15_000;
/// Rows that are added at once.
const CHUNK: usize = 512;
/// Standard deviations of the priors: bend over 0.1 SOC and difference between two temperatures of
/// a resistance, as shares of a third of the DC resistance.
const BEND: f64 = 0.3;
const UNLIKE: f64 = 0.3;
/// Standard deviation of the correction of the OCV, V, and of its change with temperature, V/K.
const OCV_V: f64 = 0.01;
const OCV_V_PER_K: f64 = 0.0005;
/// Current below which a cell is at rest, as a part of the capacity per hour.
const REST_C_RATE: f64 = 0.01;
/// SOC beyond which counted charge is wrong.
const SOC_BEYOND: (f64, f64) = (-0.1, 1.1);

/// A log with its state at each sample.
#[derive(Debug, Clone)]
pub(super) struct Log {
    pub(super) name: String,
    pub(super) role: Role,
    pub(super) time_s: Vec<f64>,
    pub(super) current_a: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    pub(super) temperature_degc: Vec<f64>,
    pub(super) soc: Vec<f64>,
    /// OCV of the curve, V.
    pub(super) ocv_v: Vec<f64>,
    pub(super) temperature_measured: bool,
}

impl Log {
    pub(super) fn new(log: &MapLog, ocv: &OcvCurve) -> Result<Self, MapFitError> {
        let series = &log.series;
        let name = series.name.clone();
        if !series.current_a.iter().any(|i| i.abs() > 1e-3) {
            return Err(MapFitError::NoCurrent { log: name });
        }
        let measured = series.temperature_degc.as_deref().and_then(filled);
        let temperature_measured = measured.is_some();
        let temperature_degc = match (measured, log.temperature_degc) {
            (Some(column), _) => column,
            (None, Some(degc)) => vec![degc; series.len()],
            (None, None) => return Err(MapFitError::Temperature { log: name }),
        };
        if let Some(met) = temperature_degc
            .iter()
            .find(|t| !TEMPERATURES_DEGC.contains(*t))
        {
            let kelvin = (200.0..400.0).contains(met);
            let hint = if kelvin {
                ": is the column in kelvin?"
            } else {
                ""
            };
            return Err(MapFitError::NoCell {
                log: name,
                met: *met,
                hint,
            });
        }
        let soc = counted(log, ocv)?;
        Ok(Self {
            role: log.role,
            ocv_v: soc.iter().map(|z| ocv.voltage_v(*z)).collect(),
            time_s: series.time_s.clone(),
            current_a: series.current_a.clone(),
            voltage_v: series.voltage_v.clone(),
            temperature_measured,
            temperature_degc,
            soc,
            name,
        })
    }

    pub(super) fn len(&self) -> usize {
        self.time_s.len()
    }

    pub(super) fn mean_degc(&self) -> f64 {
        self.temperature_degc.iter().sum::<f64>() / self.len() as f64
    }

    /// Power that the overpotential turns into heat at a sample, W.
    pub(super) fn heat_w(&self, k: usize) -> f64 {
        self.current_a[k] * (self.ocv_v[k] - self.voltage_v[k])
    }
}

/// Temperatures with the last one known in place of a missing one; `None` if all are missing.
fn filled(column: &[f64]) -> Option<Vec<f64>> {
    let mut last = *column.iter().find(|t| t.is_finite())?;
    let known = column.iter().map(|t| {
        if t.is_finite() {
            last = *t;
        }
        last
    });
    Some(known.collect())
}

/// SOC at each sample, by counting the charge.
fn counted(log: &MapLog, ocv: &OcvCurve) -> Result<Vec<f64>, MapFitError> {
    let series = &log.series;
    let name = || series.name.clone();
    let (current_a, rest_v) = (series.current_a[0], series.voltage_v[0]);
    let start = match log.soc_start {
        Some(soc) => soc,
        None if current_a.abs() > REST_C_RATE * ocv.capacity_ah => {
            return Err(MapFitError::Start {
                log: name(),
                current_a,
            });
        }
        None => ocv.soc_at(rest_v).ok_or_else(|| MapFitError::RestVoltage {
            log: name(),
            met_v: rest_v,
            low_v: ocv.ocv_v[0],
            high_v: ocv.ocv_v[ocv.ocv_v.len() - 1],
        })?,
    };
    let capacity_coulomb = 3600.0 * ocv.capacity_ah;
    let mut soc = vec![start];
    for k in 1..series.len() {
        let h = series.time_s[k] - series.time_s[k - 1];
        let moved = 0.5 * h * (series.current_a[k - 1] + series.current_a[k]) / capacity_coulomb;
        let met = soc[k - 1] - moved;
        if !(SOC_BEYOND.0..=SOC_BEYOND.1).contains(&met) {
            let capacity_ah = ocv.capacity_ah;
            return Err(MapFitError::Charge {
                log: name(),
                met,
                capacity_ah,
                start,
            });
        }
        soc.push(met);
    }
    Ok(soc)
}

/// The unknowns: surfaces by branch, temperature and SOC, then both corrections of the OCV by SOC.
pub(super) struct Design {
    soc: Vec<f64>,
    nodes_degc: Vec<f64>,
    taus_s: Vec<f64>,
    /// Third of the DC resistance at each temperature node, Ω.
    unit_ohm: Vec<f64>,
    ocv_temperature_degc: f64,
    /// Time constants that the logs are too short or too coarse for, s.
    left_out_s: Vec<f64>,
}

impl Design {
    pub(super) fn new(train: &[&Log], options: &MapOptions) -> Result<Self, MapFitError> {
        if train.is_empty() {
            return Err(MapFitError::NoLogs);
        }
        let lowest = train
            .iter()
            .flat_map(|log| &log.soc)
            .fold(f64::INFINITY, |a, z| a.min(*z));
        let highest = train
            .iter()
            .flat_map(|log| &log.soc)
            .fold(f64::NEG_INFINITY, |a, z| a.max(*z));
        let knots = &options.soc;
        let first = knots.partition_point(|z| *z <= lowest).saturating_sub(1);
        let last = knots.partition_point(|z| *z < highest).min(knots.len() - 1);
        if last <= first {
            return Err(MapFitError::Singular(
                "their SOC stays at or beyond one knot",
            ));
        }
        let longest_s = train
            .iter()
            .map(|log| log.time_s[log.len() - 1] - log.time_s[0])
            .fold(0.0, f64::max);
        let shortest_s = train
            .iter()
            .map(|log| median_step_s(log))
            .fold(f64::INFINITY, f64::min);
        let (taus_s, left_out_s) = options
            .time_constants_s
            .iter()
            .partition(|tau| **tau >= shortest_s && **tau <= 0.5 * longest_s);
        let (nodes_degc, unit_ohm) = nodes(train, options.node_distance_k)?;
        Ok(Self {
            soc: knots[first..=last].to_vec(),
            nodes_degc,
            taus_s,
            unit_ohm,
            ocv_temperature_degc: options.ocv_temperature_degc,
            left_out_s,
        })
    }

    fn surfaces(&self) -> usize {
        1 + self.taus_s.len()
    }

    fn nodes(&self) -> usize {
        self.nodes_degc.len()
    }

    fn index(&self, surface: usize, node: usize, knot: usize) -> usize {
        (surface * self.nodes() + node) * self.soc.len() + knot
    }

    /// Number of resistances; the corrections of the OCV follow them.
    fn resistances(&self) -> usize {
        self.surfaces() * self.nodes() * self.soc.len()
    }

    /// Solves for given activation energies.
    pub(super) fn solve(
        &self,
        train: &[&Log],
        ocv: &OcvCurve,
        energies: Energies,
    ) -> Result<Solved, MapFitError> {
        let count = self.resistances() + 2 * self.soc.len();
        let mut normal = Normal::new(count);
        for log in train {
            self.add_log(log, ocv, energies, &mut normal);
        }
        self.add_priors(energies, &mut normal);
        normal.solve(self.resistances())
    }

    fn empty_map(&self, energies: Energies) -> CellMap {
        let surface = |activation_j_per_mol| Surface {
            activation_j_per_mol,
            r_ohm: vec![vec![0.0; self.soc.len()]; self.nodes()],
            sigma_ohm: Vec::new(),
        };
        CellMap {
            soc: self.soc.clone(),
            temperature_degc: self.nodes_degc.clone(),
            series: surface(energies.series),
            branches: self
                .taus_s
                .iter()
                .map(|tau_s| MapBranch {
                    tau_s: *tau_s,
                    resistance: surface(energies.branches),
                })
                .collect(),
            ocv_offset_v: vec![0.0; self.soc.len()],
            ocv_v_per_k: vec![0.0; self.soc.len()],
            ocv_temperature_degc: self.ocv_temperature_degc,
            thermal: None,
        }
    }

    /// Adds the rows of a log: its overpotential is the sum of the unknowns times their columns.
    fn add_log(&self, log: &Log, ocv: &OcvCurve, energies: Energies, normal: &mut Normal) {
        let map = self.empty_map(energies);
        let (resistances, count) = (self.resistances(), normal.right.len());
        let per_surface = self.nodes() * self.soc.len();
        let mut filtered = vec![0.0; per_surface * self.taus_s.len()];
        let every = log.len().div_ceil(MOST_ROWS);
        let mut last_s = log.time_s[0];
        let mut rows = DMatrix::<f64>::zeros(CHUNK, count);
        let mut right = DVector::<f64>::zeros(CHUNK);
        let mut filled = 0;
        let mut before = [(0, 0, 0.0); 4];
        for k in 0..log.len() {
            let (soc, degc, i) = (log.soc[k], log.temperature_degc[k], log.current_a[k]);
            let at = map.place(soc, degc);
            let driven = map
                .weights(&at, energies.branches)
                .map(|(node, knot, w)| (node, knot, w * i));
            if k > 0 {
                let step_s = log.time_s[k] - log.time_s[k - 1];
                let parts = filtered.chunks_exact_mut(per_surface).zip(&self.taus_s);
                for (states, tau_s) in parts {
                    let step = BranchStep::new(step_s, *tau_s);
                    advance(states, self.soc.len(), step, [before, driven]);
                }
            }
            before = driven;
            if k % every != 0 {
                continue;
            }
            // A row stands for the time since the one before it, up to the correlation time.
            let stands_s = (log.time_s[k] - last_s).min(CORRELATION_S);
            last_s = log.time_s[k];
            let slope_v = ocv.slope_v(soc);
            let w = (stands_s / CORRELATION_S).sqrt() / ERROR_V.hypot(SOC_ERROR * slope_v);
            let mut row = rows.row_mut(filled);
            row.fill(0.0);
            for (node, knot, share) in map.weights(&at, energies.series) {
                row[self.index(0, node, knot)] -= w * share * i;
            }
            for (place, state) in filtered.iter().enumerate() {
                row[per_surface + place] = -w * state;
            }
            for (knot, share) in map.soc_weights(&at) {
                row[resistances + knot] += w * share;
                row[resistances + self.soc.len() + knot] +=
                    w * share * (degc - self.ocv_temperature_degc);
            }
            right[filled] = w * (log.voltage_v[k] - log.ocv_v[k]);
            filled += 1;
            if filled == CHUNK {
                normal.add(&rows, &right);
                filled = 0;
            }
        }
        if filled > 0 {
            normal.add(
                &rows.rows(0, filled).into_owned(),
                &right.rows(0, filled).into_owned(),
            );
        }
    }

    fn add_priors(&self, energies: Energies, normal: &mut Normal) {
        let (knots, resistances) = (self.soc.len(), self.resistances());
        let bends: Vec<[(usize, f64); 3]> = (1..knots - 1).map(|k| bend(&self.soc, k)).collect();
        for surface in 0..self.surfaces() {
            for (node, unit_ohm) in self.unit_ohm.iter().enumerate() {
                for terms in &bends {
                    normal.expect_zero(&terms.map(|(knot, factor)| {
                        (self.index(surface, node, knot), factor / (BEND * unit_ohm))
                    }));
                }
            }
            let energy = if surface == 0 {
                energies.series
            } else {
                energies.branches
            };
            for node in 1..self.nodes() {
                // In units of either node, so that a ratio by Arrhenius' law costs nothing.
                let factor = arrhenius(energy, self.nodes_degc[node - 1], self.nodes_degc[node]);
                let sigma_ohm = UNLIKE * self.unit_ohm[node - 1];
                for knot in 0..knots {
                    normal.expect_zero(&[
                        (self.index(surface, node - 1, knot), 1.0 / sigma_ohm),
                        (self.index(surface, node, knot), -factor / sigma_ohm),
                    ]);
                }
            }
        }
        for (start, sigma) in [(resistances, OCV_V), (resistances + knots, OCV_V_PER_K)] {
            for terms in &bends {
                normal.expect_zero(&terms.map(|(knot, factor)| (start + knot, factor / sigma)));
            }
            for knot in 0..knots {
                normal.expect_zero(&[(start + knot, 1.0 / sigma)]);
            }
        }
    }

    /// Returns the map of a solution, without standard deviations.
    pub(super) fn map(&self, energies: Energies, solved: &Solved) -> CellMap {
        let mut map = self.empty_map(energies);
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

    /// Writes the standard deviations of the resistances, times a factor.
    pub(super) fn write_sigma(&self, map: &mut CellMap, solved: &Solved, scale: f64) {
        let rows = |surface: usize| self.rows(surface, |k| scale * solved.variance[k].sqrt());
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

    /// Remarks on what the logs do not show.
    pub(super) fn notes(&self, map: &CellMap, train: &[&Log], capacity_ah: f64) -> Vec<String> {
        let mut notes = Vec::new();
        if !self.left_out_s.is_empty() {
            let list: Vec<String> = self.left_out_s.iter().map(|t| format!("{t} s")).collect();
            notes.push(format!(
                "no branch of {}: the logs are too short or too coarse for it",
                list.join(", ")
            ));
        }
        for log in train {
            let current_a = log.current_a[0];
            if current_a.abs() > REST_C_RATE * capacity_ah {
                notes.push(format!(
                    "{} begins under {current_a:.2} A: its branches are taken as at rest there",
                    log.name
                ));
            }
        }
        if self.nodes() == 1 {
            notes.push(format!(
                "one temperature ({:.1} °C): other temperatures follow Arrhenius' law from it",
                self.nodes_degc[0]
            ));
        }
        if map.thermal.is_none() {
            notes.push(
                "the temperatures do not show the heat of the cell: a simulation keeps it at the \
                temperature of its surroundings"
                    .to_owned(),
            );
        }
        if train
            .iter()
            .all(|log| log.current_a.iter().all(|i| *i > -1e-3))
        {
            notes.push(
                "no log charges the cell: its charge is predicted by its discharge".to_owned(),
            );
        }
        notes
    }
}

/// Moves the filtered columns of one branch over a step.
fn advance(
    states: &mut [f64],
    knots: usize,
    step: BranchStep,
    driven: [[(usize, usize, f64); 4]; 2],
) {
    states.iter_mut().for_each(|state| *state *= step.decay);
    for (list, gain) in driven.into_iter().zip([step.start, step.end]) {
        for (node, knot, value) in list {
            states[node * knots + knot] += gain * value;
        }
    }
}

/// Second difference over 0.1 SOC at a knot.
fn bend(soc: &[f64], k: usize) -> [(usize, f64); 3] {
    let (left, right) = (soc[k] - soc[k - 1], soc[k + 1] - soc[k]);
    let (a, b) = (0.1 / left, 0.1 / right);
    [(k - 1, a), (k, -a - b), (k + 1, b)]
}

fn median_step_s(log: &Log) -> f64 {
    let mut steps: Vec<f64> = log.time_s.windows(2).map(|w| w[1] - w[0]).collect();
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Temperature nodes, °C, and a third of the DC resistance at each, Ω.
fn nodes(train: &[&Log], distance_k: f64) -> Result<(Vec<f64>, Vec<f64>), MapFitError> {
    let mut logs = train.to_vec();
    logs.sort_by(|a, b| a.mean_degc().total_cmp(&b.mean_degc()));
    let (mut means, mut units) = (Vec::new(), Vec::new());
    let mut rest = &logs[..];
    while let Some(first) = rest.first() {
        let near = |log: &&&Log| log.mean_degc() - first.mean_degc() < distance_k;
        let (group, after) = rest.split_at(rest.iter().take_while(near).count());
        let samples = group
            .iter()
            .flat_map(|log| (0..log.len()).map(move |k| (log, k)));
        let (lost, square) = samples.fold((0.0, 0.0), |(lost, square), (log, k)| {
            let current_a = log.current_a[k];
            (lost + log.heat_w(k), square + current_a * current_a)
        });
        if lost <= 0.0 {
            let log = first.name.clone();
            return Err(MapFitError::NoLoss { log });
        }
        means.push(group.iter().map(|log| log.mean_degc()).sum::<f64>() / group.len() as f64);
        units.push(lost / square / 3.0);
        rest = after;
    }
    Ok((means, units))
}
