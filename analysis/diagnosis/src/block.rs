//! A run prepared for comparison: the rows in which model and measurement are compared, and their
//! prediction.
//!
//! A spectrum has two rows per point. A record has one row per bin: the samples after an edge of
//! the current are averaged over times that grow with the time since the edge, so that a row is
//! wide where nothing happens. The model is simulated at all samples and averaged in the same way.

use super::data::{Fixture, Harmonic, Role, Run, RunData, Start, Sweep, SweepPoint};
use super::time_block::{Bin, TimeBlock};
use crate::thresholds::{ALIKE_K, ALIKE_PART, ALIKE_S, ALIKE_SOC};
use analysis_effects::{
    augmented::{Added, HarmonicPoint, Player, harmonics, impedance, network},
    contract::{Base, CommonModeImpedance, Moved, Network, Point, Record},
};
use analysis_model::ocv::OcvCurve;
use num_complex::Complex64;

/// One run as the fit sees it.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) name: String,
    pub(super) group: String,
    pub(super) role: Role,
    /// Circumstances, with the frequency of no point.
    pub(super) at: Point,
    pub(super) kind: Kind,
    /// Measured rows: Ω or V.
    pub(super) measured: Vec<f64>,
    /// Charge before it, see [`Record::before`].
    pub(super) before: Vec<Moved>,
    /// The first block that this one repeats so closely that the derivatives are equal.
    pub(super) alike: Option<usize>,
}

/// Kind of the rows, with the inputs of their prediction.
#[derive(Debug, Clone)]
pub(super) enum Kind {
    /// A spectrum: frequencies and amplitudes, then harmonics; stated sigmas of both, and the control
    /// in the jig.
    Eis {
        points: Vec<Point>,
        harmonics: Vec<HarmonicPoint>,
        sigma_ohm: Vec<Option<(f64, f64)>>,
        control_ohm: Option<f64>,
    },
    /// A record.
    Time(Box<TimeBlock>),
}

/// Current that a record is predicted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Current {
    /// As it was logged.
    Logged,
    /// Without the logger's noise.
    Driven,
}

/// The base with the effects that are added to it, and the network of both.
#[derive(Clone)]
pub(super) struct Model<'a> {
    pub(super) base: &'a Base,
    pub(super) added: &'a [Added<'a>],
    network: Network,
}

impl<'a> Model<'a> {
    pub(super) fn new(base: &'a Base, added: &'a [Added<'a>]) -> Self {
        Self {
            base,
            added,
            network: network(base, added),
        }
    }
}

/// Reason why a run cannot be prepared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DataSetError {
    /// A run without data.
    #[error("run {run:?}: expected {expected}, met {met}")]
    Run {
        /// Name of the run.
        run: String,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        met: String,
    },
    /// An effect that cannot be a part of the base.
    #[error("effect {name:?}: expected {expected}")]
    Addition {
        /// Its name.
        name: String,
        /// What was expected, as text.
        expected: &'static str,
    },
    /// A data set that cannot be diagnosed.
    #[error("data set {name:?}: expected {expected}")]
    Set {
        /// Name of the data set.
        name: String,
        /// Allowed values, as text.
        expected: &'static str,
    },
}

/// Returns the rows of a spectrum, or what was expected and met instead.
fn of_sweep(
    sweep: &Sweep,
    fixture: &Fixture,
    at: Point,
    ocv: &OcvCurve,
) -> Result<(Kind, Vec<f64>), (&'static str, String)> {
    if sweep.points.is_empty() {
        return Err(("at least one frequency", "none".to_owned()));
    }
    for (expected, count) in [
        ("a time for each point", sweep.elapsed_s.len()),
        ("a charge for each point", sweep.charge_coulomb.len()),
    ] {
        if count > 0 && count != sweep.points.len() {
            return Err((
                expected,
                format!("{count} for {} points", sweep.points.len()),
            ));
        }
    }
    // A charge that was brought back, or none: how long is not known.
    let held_s = |by_charge_s: f64| {
        if by_charge_s.is_finite() && by_charge_s > 0.0 {
            by_charge_s
        } else {
            Point::HELD_S
        }
    };
    let point = |(k, p): (usize, &SweepPoint)| {
        let charge_coulomb = sweep.charge_coulomb.get(k).copied().unwrap_or(0.0);
        Point {
            freq_hz: p.freq_hz,
            amplitude_a: p.amplitude_a,
            bias_a: sweep.bias_a,
            held_s: held_s(-charge_coulomb / sweep.bias_a),
            soc: at.soc + charge_coulomb / (3600.0 * ocv.capacity_ah),
            start_s: at.start_s + sweep.elapsed_s.get(k).copied().unwrap_or(0.0),
            ..at
        }
    };
    let points: Vec<Point> = sweep.points.iter().enumerate().map(point).collect();
    if let Some(odd) = points.iter().find(|p| !(0.0..=1.0).contains(&p.soc)) {
        return Err((
            "charges of points that lead to a state of charge from 0 to 1",
            format!("{:.3} at {} Hz", odd.soc, odd.freq_hz),
        ));
    }
    let control_ohm = match fixture {
        Fixture::Cell(_) => None,
        Fixture::Shunt(ohm) | Fixture::FakeCell(ohm) => Some(*ohm),
    };
    if control_ohm.is_some() && !sweep.harmonics.is_empty() {
        return Err(("harmonics of a cell", "those of a control".to_owned()));
    }
    let harmonic = |h: &Harmonic| {
        let is_own = |p: &&Point| p.freq_hz == h.freq_hz;
        let sigma_is_sound = h.sigma_ohm.0 > 0.0 && h.sigma_ohm.1 > 0.0;
        if !(matches!(h.order, 2 | 3) && h.amplitude_a > 0.0 && sigma_is_sound) {
            return Err((
                "harmonics of order 2 or 3 with an amplitude and standard deviations above zero",
                format!("{h:?}"),
            ));
        }
        let of_point = points.iter().find(is_own).ok_or_else(|| {
            let met = format!("none at {} Hz", h.freq_hz);
            ("a point of the spectrum for each harmonic", met)
        })?;
        Ok(HarmonicPoint {
            at: Point {
                amplitude_a: Some(h.amplitude_a),
                ..*of_point
            },
            order: h.order,
        })
    };
    let harmonics = sweep
        .harmonics
        .iter()
        .map(harmonic)
        .collect::<Result<_, _>>()?;
    let sigma_ohm = sweep.points.iter().map(|p| p.sigma_ohm);
    let kind = Kind::Eis {
        sigma_ohm: sigma_ohm
            .chain(sweep.harmonics.iter().map(|h| Some(h.sigma_ohm)))
            .collect(),
        points,
        harmonics,
        control_ohm,
    };
    let z_ohm = sweep.points.iter().map(|p| p.z_ohm);
    let z_ohm = z_ohm.chain(sweep.harmonics.iter().map(|h| h.z_ohm));
    Ok((kind, z_ohm.flat_map(|z| [z.re, z.im]).collect()))
}

impl Block {
    /// Prepares a run. The base's OCV turns a start voltage into a state of charge. Two samples of
    /// a constant current differ by `jitter_a` (one σ).
    pub(super) fn new(run: &Run, base: &Base, jitter_a: f64) -> Result<Self, DataSetError> {
        let fail = |expected, met: String| DataSetError::Run {
            run: run.name.clone(),
            expected,
            met,
        };
        let soc = match run.start {
            Start::Soc(soc) if (0.0..=1.0).contains(&soc) => soc,
            Start::Soc(soc) => return Err(fail("a state of charge from 0 to 1", soc.to_string())),
            Start::Ocv(v) => base.ocv.soc_at(v).ok_or_else(|| {
                fail(
                    "a start voltage that the model's OCV curve reaches",
                    format!("{v} V"),
                )
            })?,
        };
        let is_cell = matches!(run.fixture, Fixture::Cell(_));
        let at = Point {
            freq_hz: f64::NAN,
            amplitude_a: None,
            bias_a: 0.0,
            held_s: Point::HELD_S,
            soc,
            temperature_degc: run.temperature_degc,
            order: f64::from(run.order),
            start_s: run.start_s,
            is_cell,
            common_mode: if let RunData::Eis(sweep) = &run.data {
                sweep.common_mode
            } else {
                CommonModeImpedance::default()
            },
        };
        let (kind, measured) = match &run.data {
            RunData::Eis(sweep) => of_sweep(sweep, &run.fixture, at, &base.ocv)
                .map_err(|(expected, met)| fail(expected, met))?,
            RunData::Time(record) => {
                record
                    .series
                    .validate()
                    .map_err(|e| fail("a time series", e.to_string()))?;
                if let Some(count) = record
                    .sigma_v
                    .as_ref()
                    .map(Vec::len)
                    .filter(|count| *count != record.series.len())
                {
                    return Err(fail(
                        "a stated noise for each sample",
                        format!("{count} for {} samples", record.series.len()),
                    ));
                }
                if let Some(count) = record
                    .averaged_s
                    .as_ref()
                    .map(Vec::len)
                    .filter(|count| *count != record.series.len())
                {
                    return Err(fail(
                        "a window for each sample",
                        format!("{count} for {} samples", record.series.len()),
                    ));
                }
                if !is_cell {
                    return Err(fail(
                        "a record in time of a cell",
                        "one of a control".to_owned(),
                    ));
                }
                let time = TimeBlock::new(record, jitter_a);
                if time.bins.is_empty() {
                    return Err(fail(
                        "samples that are compared",
                        format!("none from {} s on", record.compared_from_s),
                    ));
                }
                let measured = time.average(&time.voltage_v);
                (Kind::Time(Box::new(time)), measured)
            }
        };
        Ok(Self {
            name: run.name.clone(),
            group: run.repeat_group.clone(),
            role: run.role,
            at,
            kind,
            measured,
            before: Vec::new(),
            alike: None,
        })
    }

    /// Returns the measured size of the impedance that a row of a spectrum belongs to, Ω: for a
    /// harmonic, that of its fundamental.
    pub(super) fn impedance_ohm(&self, row: usize) -> f64 {
        let point = match &self.kind {
            Kind::Eis {
                points, harmonics, ..
            } if row >= 2 * points.len() => {
                let freq_hz = harmonics[row / 2 - points.len()].at.freq_hz;
                let of_point = points.iter().position(|p| p.freq_hz == freq_hz);
                of_point.unwrap_or_default()
            }
            _ => row / 2,
        };
        self.measured[2 * point].hypot(self.measured[2 * point + 1])
    }

    /// Returns the number of rows.
    pub(super) fn rows(&self) -> usize {
        self.measured.len()
    }

    /// Writes the predicted voltage of every sample under a current into the workspace.
    pub(super) fn play(
        &self,
        time: &TimeBlock,
        model: &Model<'_>,
        current_a: &[f64],
        parts: usize,
        workspace: &mut Workspace,
    ) {
        let Some(windows) = &time.windows else {
            let record = Record {
                time_s: &time.time_s,
                current_a,
                ..self.circumstances()
            };
            workspace.player.play(
                model.base,
                model.added,
                &record,
                &time.grid,
                parts,
                &mut workspace.voltage_v,
            );
            return;
        };
        windows.current(current_a, &mut workspace.within_a);
        let record = Record {
            time_s: &windows.time_s,
            current_a: &workspace.within_a,
            ..self.circumstances()
        };
        workspace.player.play(
            model.base,
            model.added,
            &record,
            &time.grid,
            parts,
            &mut workspace.within_v,
        );
        windows.means(&workspace.within_v, &mut workspace.voltage_v);
    }

    /// Returns a record of a block in time, still without samples.
    fn circumstances(&self) -> Record<'_> {
        Record {
            time_s: &[],
            current_a: &[],
            soc: self.at.soc,
            temperature_degc: self.at.temperature_degc,
            order: self.at.order,
            start_s: self.at.start_s,
            is_cell: self.at.is_cell,
            before: &self.before,
        }
    }

    /// Places a planned sweep as far above the ground of the channels as the measured ones of its
    /// kind. A control that was not measured yet lies in the same jig as the cell, at an unknown
    /// position. It is assumed to lie no higher than its own resistance, so that a plan does not
    /// promise too much.
    pub(super) fn lies_as(&mut self, measured: &[Self]) {
        let is_cell = self.at.is_cell;
        // An unknown position differs from zero impedance below it.
        let is_placed = |b: &&Self| {
            matches!(b.kind, Kind::Eis { .. }) && b.at.common_mode != CommonModeImpedance::default()
        };
        let common_mode = |cell: bool| {
            measured
                .iter()
                .filter(is_placed)
                .find(|b| b.at.is_cell == cell)
                .map(|b| b.at.common_mode)
        };
        let Kind::Eis {
            points,
            control_ohm,
            ..
        } = &mut self.kind
        else {
            return;
        };
        let guess = || {
            common_mode(true).map(|common_mode| {
                control_ohm.map_or(common_mode, |own| CommonModeImpedance {
                    r_ohm: common_mode.r_ohm.min(own),
                    l_h: 0.0,
                })
            })
        };
        if let Some(common_mode) = common_mode(is_cell).or_else(guess) {
            points.iter_mut().for_each(|p| p.common_mode = common_mode);
        }
    }

    /// Sets in each block which earlier one has the same derivatives.
    pub(super) fn find_alike(blocks: &mut [Self]) {
        for k in 0..blocks.len() {
            blocks[k].alike = (0..k)
                .find(|first| blocks[*first].alike.is_none() && blocks[*first].is_like(&blocks[k]));
        }
    }

    /// Returns whether a record has the same derivatives as another one: a repeat from the same
    /// state of charge, with the same sampling and current. Spectra are excluded because their
    /// simulation is cheap.
    fn is_like(&self, other: &Self) -> bool {
        let (Kind::Time(a), Kind::Time(b)) = (&self.kind, &other.kind) else {
            return false;
        };
        let same = |a: f64, b: f64, within: f64| (a - b).abs() <= within;
        let greatest_a = a
            .bins
            .iter()
            .fold(0.0f64, |m, bin| m.max(bin.current_a.abs()));
        let bins_alike = |(a, b): (&Bin, &Bin)| {
            same(a.time_s, b.time_s, ALIKE_PART * (a.since_edge_s + ALIKE_S))
                && same(a.current_a, b.current_a, ALIKE_PART * greatest_a)
        };
        let at_alike = same(self.at.soc, other.at.soc, ALIKE_SOC)
            && same(self.at.temperature_degc, other.at.temperature_degc, ALIKE_K);
        let kind = self.group == other.group
            && self.role == other.role
            && a.linear == b.linear
            && a.bins.len() == b.bins.len();
        kind && at_alike && a.bins.iter().zip(&b.bins).all(bins_alike)
    }

    /// Predicted rows, appended to `rows`.
    pub(super) fn predict(
        &self,
        model: &Model<'_>,
        parts: usize,
        workspace: &mut Workspace,
        rows: &mut Vec<f64>,
    ) {
        self.predict_under(model, Current::Logged, parts, workspace, rows);
    }

    /// The same under the current as it was logged or driven.
    pub(super) fn predict_under(
        &self,
        model: &Model<'_>,
        current: Current,
        parts: usize,
        workspace: &mut Workspace,
        rows: &mut Vec<f64>,
    ) {
        match &self.kind {
            Kind::Eis {
                points,
                harmonics: more,
                control_ohm,
                ..
            } => {
                for point in points {
                    let z = impedance(
                        &model.network,
                        model.base,
                        model.added,
                        point,
                        control_ohm.map(|r| Complex64::new(r, 0.0)),
                    );
                    rows.extend([z.re, z.im]);
                }
                let mut last: Option<(Point, [Complex64; 2])> = None;
                for HarmonicPoint { at, order } in more {
                    let both = match last {
                        Some((point, both)) if point == *at => both,
                        _ => harmonics(model.base, model.added, at),
                    };
                    last = Some((*at, both));
                    let z = both[*order as usize - 2];
                    rows.extend([z.re, z.im]);
                }
            }
            Kind::Time(time) => {
                let current_a = if current == Current::Logged {
                    &time.current_a
                } else {
                    &time.driven_a
                };
                self.play(time, model, current_a, parts, workspace);
                time.average_into(&workspace.voltage_v, rows);
            }
        }
    }
}

/// Buffers of a prediction.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    pub(super) player: Player,
    pub(super) voltage_v: Vec<f64>,
    within_a: Vec<f64>,
    within_v: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::TimeRecord;
    use analysis_effects::{augmented::Between, contract::Facts};
    use analysis_model::{
        model::{Erm, RcBranch},
        ocv::OcvCurve,
    };
    use analysis_signal::series::TimeSeries;

    const R_OHM: f64 = 6e-3;
    const BRANCH: (f64, f64) = (5e-3, 5.6);

    /// Returns the mean over a window, on one side of the steps, of the voltage over a branch and a
    /// resistance after a step of 9 A that lasts 20 s.
    fn mean_v((from_s, to_s): (f64, f64)) -> f64 {
        let (r_ohm, tau_s) = BRANCH;
        let decay = |t: f64| (-t / tau_s).exp();
        let mean = |from_s: f64, to_s: f64| {
            if to_s > from_s {
                tau_s * (decay(from_s) - decay(to_s)) / (to_s - from_s)
            } else {
                decay(from_s)
            }
        };
        match from_s {
            f if f < 1.0 => 3.7,
            f if f < 21.0 => 3.7 - 9.0 * (R_OHM + r_ohm * (1.0 - mean(from_s - 1.0, to_s - 1.0))),
            _ => 3.7 - 9.0 * r_ohm * (1.0 - decay(20.0)) * mean(from_s - 21.0, to_s - 21.0),
        }
    }

    fn swept(bias_a: f64, charge_coulomb: Vec<f64>) -> Sweep {
        let point = |freq_hz: f64| SweepPoint {
            freq_hz,
            z_ohm: Complex64::new(0.01 / freq_hz, -0.001),
            sigma_ohm: None,
            amplitude_a: Some(1.0),
        };
        let harmonic = |freq_hz: f64, order: u32| Harmonic {
            freq_hz,
            order,
            z_ohm: Complex64::new(1e-5, 2e-5),
            sigma_ohm: (1e-6, 1e-6),
            amplitude_a: 2.0,
        };
        Sweep {
            bias_a,
            common_mode: CommonModeImpedance::default(),
            elapsed_s: Vec::new(),
            charge_coulomb,
            points: vec![point(1.0), point(10.0)],
            harmonics: vec![harmonic(10.0, 2), harmonic(1.0, 3)],
        }
    }

    fn base() -> Base {
        Base {
            erm: Erm {
                r_ohm: R_OHM,
                branches: Vec::new(),
            },
            ocv: OcvCurve::monotone(1.0, vec![0.0, 1.0], vec![3.0, 4.0]).unwrap(),
            facts: Facts::NONE,
        }
    }

    /// Returns a run that starts at half of the charge.
    fn run_of(data: RunData) -> Run {
        Run {
            name: "s".to_owned(),
            fixture: Fixture::Cell("cell".to_owned()),
            role: Role::Train,
            repeat_group: "s".to_owned(),
            order: 0,
            start_s: 0.0,
            temperature_degc: 25.0,
            start: Start::Soc(0.5),
            data,
        }
    }

    fn block_of(sweep: Sweep) -> Result<Block, DataSetError> {
        Block::new(&run_of(RunData::Eis(sweep)), &base(), 0.0)
    }

    /// A discharge of 2 A takes 36 and 72 C of 3600 C out: 18 and 36 s.
    #[test]
    fn points_under_a_direct_current_have_their_charge_and_its_duration() {
        let block = block_of(swept(2.0, vec![-36.0, -72.0])).unwrap();
        let Kind::Eis {
            points, harmonics, ..
        } = &block.kind
        else {
            unreachable!()
        };
        let found: Vec<(f64, f64)> = points.iter().map(|p| (p.soc, p.held_s)).collect();
        assert_eq!(found, [(0.49, 18.0), (0.48, 36.0)]);
        // Each harmonic belongs to the point of its frequency.
        assert_eq!((harmonics[0].at.soc, harmonics[1].at.soc), (0.48, 0.49));
        assert_eq!(harmonics[0].at.amplitude_a, Some(2.0));
        // Rows: two points, then the harmonics of 10 Hz and of 1 Hz.
        let sizes: Vec<f64> = (0..8).map(|row| block.impedance_ohm(row)).collect();
        let [slow, fast] = [0.01_f64.hypot(0.001), 0.001_f64.hypot(0.001)];
        assert_eq!(sizes, [slow, slow, fast, fast, fast, fast, slow, slow]);
        let mut predicted = Vec::new();
        let base = base();
        let model = Model::new(&base, &[]);
        block.predict(&model, 1, &mut Workspace::default(), &mut predicted);
        assert_eq!(predicted.len(), block.rows());
        // A straight curve and a resistance have no harmonics.
        assert!(
            predicted[4..].iter().all(|v| v.abs() < 1e-9),
            "{predicted:?}"
        );
        let rest = block_of(swept(0.0, Vec::new())).unwrap();
        let Kind::Eis { points, .. } = &rest.kind else {
            unreachable!()
        };
        assert_eq!((points[0].soc, points[0].held_s), (0.5, Point::HELD_S));
    }

    #[test]
    fn sweeps_that_cannot_be_are_refused() {
        let message = |sweep: Sweep| block_of(sweep).unwrap_err().to_string();
        let far = message(swept(2.0, vec![-36.0, -3000.0]));
        assert!(
            far.contains("a state of charge from 0 to 1, met -0.333 at 10 Hz"),
            "{far}"
        );
        let few = message(swept(2.0, vec![-36.0]));
        assert!(
            few.contains("a charge for each point, met 1 for 2 points"),
            "{few}"
        );
        let mut alone = swept(0.0, Vec::new());
        alone.harmonics[0].freq_hz = 3.0;
        let text = message(alone);
        assert!(
            text.contains("a point of the spectrum for each harmonic, met none at 3 Hz"),
            "{text}"
        );
        let mut fourth = swept(0.0, Vec::new());
        fourth.harmonics[0].order = 4;
        assert!(message(fourth).contains("harmonics of order 2 or 3"));
    }

    /// A record of means as the bench logs them is predicted as such, to less than its noise.
    #[test]
    fn means_are_predicted_as_means() {
        let mut rows = vec![(0.0, 0.0, (0.0_f64, 0.0_f64))];
        for (begin_s, end_s, amps) in [(0.0, 1.0, 0.0), (1.0, 21.0, 9.0), (21.0, 60.0, 0.0)] {
            let mut from_s: f64 = begin_s + 0.002;
            rows.push((begin_s + 0.0004, amps, (begin_s + 0.0003, begin_s + 0.0005)));
            while from_s < end_s - 0.02 {
                let to_s = (from_s + (0.2 * (from_s - begin_s)).max(0.002)).min(end_s - 0.01);
                rows.push((0.5 * (from_s + to_s), amps, (from_s, to_s)));
                from_s = to_s;
            }
            if end_s < 60.0 {
                rows.push((end_s - 0.0004, amps, (from_s, end_s - 0.0001)));
            }
        }
        let record: Vec<f64> = rows.iter().map(|(_, _, window)| mean_v(*window)).collect();
        let series = TimeSeries {
            name: "s".to_owned(),
            time_s: rows.iter().map(|row| row.0).collect(),
            current_a: rows.iter().map(|row| row.1).collect(),
            voltage_v: record,
            temperature_degc: None,
        };
        let facts = Facts {
            lowest_hz: None,
            highest_hz: None,
            longest_s: 60.0,
            shortest_s: 1e-3,
            greatest_a: 9.0,
            widest_soc: 0.1,
            soc: 0.5,
            temperature_degc: 25.0,
            orders: 0.0,
            span_s: 0.0,
            held_out: None,
        };
        let erm = Erm {
            r_ohm: R_OHM,
            branches: vec![RcBranch {
                r_ohm: BRANCH.0,
                c_f: BRANCH.1 / BRANCH.0,
            }],
        };
        let base = Base {
            erm,
            ocv: OcvCurve::monotone(1e9, vec![0.0, 1.0], vec![3.7 - 1e-6, 3.7 + 1e-6]).unwrap(),
            facts,
        };
        let worst = |averaged_s: Option<Vec<(f64, f64)>>| {
            let data = RunData::Time(TimeRecord {
                series: series.clone(),
                between: Between::Linear,
                compared_from_s: 0.0,
                level_sigma_v: 0.0,
                sigma_v: None,
                averaged_s,
                current_errors_a: Vec::new(),
            });
            let run = run_of(data);
            let (block, mut workspace) =
                (Block::new(&run, &base, 0.0).unwrap(), Workspace::default());
            let Kind::Time(time) = &block.kind else {
                unreachable!()
            };
            let model = Model::new(&base, &[]);
            block.play(time, &model, &time.current_a, 1, &mut workspace);
            assert_eq!(model.network.branches.len(), 1);
            let off = workspace
                .voltage_v
                .iter()
                .zip(&series.voltage_v)
                .map(|(p, m)| (p - m).abs());
            off.fold(0.0, f64::max)
        };
        let windows: Vec<(f64, f64)> = rows.iter().map(|row| row.2).collect();
        let (as_means, as_instants) = (worst(Some(windows)), worst(None));
        assert!(
            as_instants > 2e-5 && as_means < 2e-6,
            "as means off by {as_means} V, as instants by {as_instants} V"
        );
    }
}
