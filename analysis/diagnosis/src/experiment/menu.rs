//! Menu of planned runs that can separate effects, generated for the cell, the currents and the
//! frequencies of a campaign.

use super::planned::{BenchLimits, Planned, PlannedRun, point_s};
use crate::thresholds::{
    BIAS_CHARGE, BIAS_PART, BIAS_RAMP_S, BURST_S, HALVES_S, MENU_REPEATS, MIRRORED_PARTS,
    SETTLE_ELSEWHERE_S, SETTLE_JIG_S, SETTLE_S, SLOW_POINTS, SLOW_REPEATS, SLOWEST_HZ, SOC_WITHIN,
    SWEEP_BAND_HZ, SWEEP_POINTS, TOP_POINTS, WALK_REST_S, WALK_SOC,
};
use crate::{
    block::{Block, Kind},
    data::{Fixture, Role},
    problem::Problem,
    time_block::TimeBlock,
};
use std::ops::RangeInclusive;

/// One entry of the menu.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MenuItem {
    pub(super) name: &'static str,
    pub(super) description: String,
    pub(super) runs: Vec<PlannedRun>,
}

impl MenuItem {
    /// Returns the time on the bench with all repeats and settling, min.
    pub(super) fn duration_min(&self) -> f64 {
        self.runs.iter().map(PlannedRun::duration_s).sum::<f64>() / 60.0
    }

    /// Same item, with `times` as many repeats.
    pub(super) fn times(&self, times: usize) -> Self {
        let mut more = self.clone();
        more.runs.iter_mut().for_each(|run| run.repeat *= times);
        more
    }

    /// Returns whether another item can be run in the same experiment: one sweep at most, and the
    /// cell under the same conditions.
    pub(super) fn joins(&self, other: &Self) -> bool {
        let all = || self.runs.iter().chain(&other.runs);
        let cells: Vec<&PlannedRun> = all()
            .filter(|run| matches!(run.fixture, Fixture::Cell(_)))
            .collect();
        let alike = cells
            .windows(2)
            .all(|w| w[0].soc == w[1].soc && w[0].temperature_degc == w[1].temperature_degc);
        self.name != other.name
            && alike
            && all()
                .filter(|run| matches!(run.what, Planned::Eis { .. }))
                .count()
                < 2
    }

    /// This item and then another one.
    pub(super) fn and(&self, other: &Self) -> Self {
        let mut both = self.clone();
        let (orders, later_s) = (
            self.runs.iter().map(|run| run.repeat as u32).sum::<u32>(),
            60.0 * self.duration_min(),
        );
        both.runs.extend(other.runs.iter().map(|run| PlannedRun {
            order: run.order + orders,
            start_s: run.start_s + later_s,
            ..run.clone()
        }));
        both.description = format!("{}; then {}", self.description, other.description);
        both
    }

    /// Returns the charge moved in either direction, Ah.
    pub(super) fn charge_ah(&self) -> f64 {
        self.runs.iter().map(PlannedRun::charge_ah).sum()
    }
}

/// Facts of the campaign that the menu needs.
#[derive(Debug)]
pub(super) struct Campaign<'a> {
    problem: &'a Problem,
    limits: BenchLimits,
    soc: f64,
    temperature_degc: f64,
    order: u32,
    start_s: f64,
    sweep: Planned,
}

impl<'a> Campaign<'a> {
    /// Creates a campaign. By default its currents extend as far as those of the data.
    pub(super) fn new(problem: &'a Problem, limits: Option<BenchLimits>) -> Self {
        let facts = &problem.base.facts;
        let greatest = |sign: f64| {
            let currents = problem
                .blocks
                .iter()
                .filter_map(time)
                .flat_map(|t| &t.bins)
                .map(|b| sign * b.current_a);
            currents.fold(0.0, f64::max)
        };
        let limits = limits.unwrap_or_else(|| BenchLimits {
            discharge_a: greatest(1.0),
            charge_a: greatest(-1.0),
            highest_hz: facts.highest_hz.unwrap_or(SWEEP_BAND_HZ.1),
            shunt_ohm: None,
        });
        let swept = problem
            .blocks
            .iter()
            .filter(|b| b.at.is_cell)
            .find_map(|b| match &b.kind {
                Kind::Eis { points, .. } => Some(Planned::Eis {
                    freq_hz: points.iter().map(|p| p.freq_hz).collect(),
                    amplitude_a: points[0].amplitude_a.unwrap_or(1.0),
                    bias_a: 0.0,
                }),
                Kind::Time(_) => None,
            });
        let last = |pick: fn(&Block) -> f64| problem.blocks.iter().map(pick).fold(0.0, f64::max);
        Self {
            problem,
            limits,
            soc: facts.soc,
            temperature_degc: facts.temperature_degc,
            order: last(|b| b.at.order) as u32 + 1,
            start_s: last(|b| b.at.start_s) + facts.longest_s,
            sweep: swept.unwrap_or_else(|| Planned::Eis {
                freq_hz: frequencies(SWEEP_BAND_HZ.0, SWEEP_BAND_HZ.1, SWEEP_POINTS),
                amplitude_a: 1.0,
                bias_a: 0.0,
            }),
        }
    }

    /// Returns a run at the campaign's own circumstances.
    fn run(&self, name: &str, what: Planned) -> PlannedRun {
        PlannedRun {
            name: name.to_owned(),
            fixture: Fixture::Cell("cell".to_owned()),
            soc: self.soc,
            temperature_degc: self.temperature_degc,
            repeat: MENU_REPEATS,
            repeat_group: name.to_owned(),
            order: self.order,
            settle_s: SETTLE_S,
            start_s: self.start_s + SETTLE_S,
            what,
        }
    }

    /// Returns an item of one run of currents, or `None` if the limits leave nothing of it or it
    /// would leave the range of states of charge.
    fn trace(
        &self,
        name: &'static str,
        description: String,
        segments: Vec<(f64, f64)>,
    ) -> Option<MenuItem> {
        let capacity_coulomb = 3600.0 * self.problem.base.ocv.capacity_ah;
        let mut soc = self.soc;
        for (span_s, amps) in &segments {
            soc -= span_s * amps / capacity_coulomb;
            let allowed = span_s.is_finite()
                && *amps <= self.limits.discharge_a + 1e-9
                && -amps <= self.limits.charge_a + 1e-9;
            if !allowed || soc < SOC_WITHIN.0 || soc > SOC_WITHIN.1 {
                return None;
            }
        }
        Some(MenuItem {
            name,
            description,
            runs: vec![self.run(name, Planned::Trace(segments))],
        })
    }

    /// Returns an item of one sweep under other circumstances.
    fn swept(
        &self,
        name: &'static str,
        description: String,
        change: impl FnOnce(&mut PlannedRun),
    ) -> MenuItem {
        let mut run = self.run(name, self.sweep.clone());
        change(&mut run);
        run.start_s = self.start_s + run.settle_s;
        MenuItem {
            name,
            description,
            runs: vec![run],
        }
    }

    fn amplitude_a(&self) -> f64 {
        if let Planned::Eis { amplitude_a, .. } = &self.sweep {
            *amplitude_a
        } else {
            1.0
        }
    }

    /// Returns the size of a direct current under the sweep, A, or `None` if it would not exceed the
    /// amplitude: half of what the limits leave beside the amplitude, as much as its slowest point and
    /// the ramp may move of the charge, and one capacity per hour, so that it heats the cell little.
    fn direct_a(&self, sign: f64) -> Option<f64> {
        let Planned::Eis {
            freq_hz,
            amplitude_a,
            ..
        } = &self.sweep
        else {
            return None;
        };
        let slowest_s = freq_hz.iter().copied().map(point_s).fold(0.0, f64::max);
        let capacity_ah = self.problem.base.ocv.capacity_ah;
        let limit_a = if sign > 0.0 {
            self.limits.discharge_a
        } else {
            self.limits.charge_a
        };
        let current_a = (BIAS_PART * (limit_a - amplitude_a))
            .min(BIAS_CHARGE * 3600.0 * capacity_ah / (slowest_s + BIAS_RAMP_S))
            .min(capacity_ah);
        (current_a > *amplitude_a).then_some(current_a)
    }

    /// Returns the lesser of both limits.
    fn both_ways_a(&self) -> f64 {
        self.limits.discharge_a.min(self.limits.charge_a)
    }
}

fn time(block: &Block) -> Option<&TimeBlock> {
    if let Kind::Time(t) = &block.kind {
        Some(t)
    } else {
        None
    }
}

/// Returns all items that the limits allow. Of items with the same name, the first that can be run
/// is the best.
pub(super) fn menu(campaign: &Campaign<'_>) -> Vec<MenuItem> {
    let mut items = sweeps(campaign);
    let zero = "no current for 10 min: what moves by itself".to_owned();
    items.extend(campaign.trace("zero_current_log", zero, vec![(600.0, 0.0)]));
    items.extend(
        MIRRORED_PARTS
            .iter()
            .map(|part| mirrored(campaign, *part))
            .chain([
                bursts(campaign),
                long_pulse(campaign),
                slow_pulse(campaign),
                square_waves(campaign),
            ])
            .flatten(),
    );
    items.extend(
        [minor_loops(campaign), equal_charge(campaign)]
            .into_iter()
            .flatten(),
    );
    items.extend(
        WALK_SOC
            .into_iter()
            .filter_map(|(low, high)| range_walk(campaign, low..=high)),
    );
    items.extend(sentinel_repeat(campaign));
    items
}

fn sweeps(campaign: &Campaign<'_>) -> Vec<MenuItem> {
    let mut items = Vec::new();
    let highest_hz = campaign
        .problem
        .base
        .facts
        .highest_hz
        .unwrap_or(SWEEP_BAND_HZ.1)
        .min(campaign.limits.highest_hz);
    let top = |low_hz: f64, high_hz: f64| Planned::Eis {
        freq_hz: frequencies(low_hz, high_hz, TOP_POINTS),
        amplitude_a: campaign.amplitude_a(),
        bias_a: 0.0,
    };
    if campaign.limits.highest_hz > 1.5 * highest_hz {
        let words = format!(
            "a sweep from {:.0} Hz to {:.0} Hz",
            0.3 * highest_hz,
            campaign.limits.highest_hz
        );
        items.push(campaign.swept("eis_high_frequency", words, |run| {
            run.what = top(0.3 * highest_hz, campaign.limits.highest_hz);
        }));
    }
    let top_hz = campaign.limits.highest_hz.max(highest_hz);
    let shunts = campaign.limits.shunt_ohm.map_or(
        vec![("shunt_sweep", 10e-3), ("shunt_sweep_small", 1e-3)],
        |ohm| vec![("shunt_sweep", ohm)],
    );
    for (name, ohm) in shunts {
        let what = format!(
            "a sweep of a {:.0} mΩ shunt instead of the cell, {:.0} Hz to {top_hz:.0} Hz",
            1e3 * ohm,
            0.1 * highest_hz
        );
        items.push(campaign.swept(name, what, |run| {
            run.fixture = Fixture::Shunt(ohm);
            run.what = top(0.1 * highest_hz, top_hz);
            run.settle_s = SETTLE_JIG_S;
        }));
    }
    for (name, soc) in [
        ("eis_lower_soc", campaign.soc - 0.2),
        ("eis_higher_soc", campaign.soc + 0.2),
    ] {
        if soc > SOC_WITHIN.0 && soc < SOC_WITHIN.1 {
            items.push(campaign.swept(
                name,
                format!("the same sweep at {:.0} % state of charge", 100.0 * soc),
                |run| {
                    run.soc = soc;
                    run.settle_s = SETTLE_ELSEWHERE_S;
                },
            ));
        }
    }
    let warm_degc = if campaign.temperature_degc < 30.0 {
        35.0
    } else {
        campaign.temperature_degc - 10.0
    };
    items.push(campaign.swept(
        "eis_other_temperature",
        format!("the same sweep at {warm_degc:.0} °C"),
        |run| {
            run.temperature_degc = warm_degc;
            run.settle_s = SETTLE_ELSEWHERE_S;
        },
    ));
    let larger_a = (5.0 * campaign.amplitude_a()).min(campaign.both_ways_a());
    if larger_a > 1.5 * campaign.amplitude_a() {
        items.push(campaign.swept(
            "eis_larger_amplitude",
            format!("the same sweep with an amplitude of {larger_a:.1} A"),
            |run| {
                if let Planned::Eis { amplitude_a, .. } = &mut run.what {
                    *amplitude_a = larger_a;
                }
            },
        ));
    }
    for (name, sign, way) in [
        ("eis_under_discharge", 1.0, "discharge"),
        ("eis_under_charge", -1.0, "charge"),
    ] {
        if let Some(current_a) = campaign.direct_a(sign) {
            let words = format!(
                "the same sweep under a {way} of {current_a:.1} A; its charge is brought back"
            );
            items.push(campaign.swept(name, words, |run| {
                if let Planned::Eis { bias_a, .. } = &mut run.what {
                    *bias_a = sign * current_a;
                }
            }));
        }
    }
    let lowest_hz = campaign
        .problem
        .base
        .facts
        .lowest_hz
        .unwrap_or(SWEEP_BAND_HZ.0);
    for slowest_hz in SLOWEST_HZ.into_iter().filter(|f| lowest_hz > 2.0 * f) {
        items.push(campaign.swept(
            "eis_low_frequency",
            format!(
                "a sweep from {:.0} mHz to {lowest_hz:.3} Hz",
                1e3 * slowest_hz
            ),
            |run| {
                run.what = Planned::Eis {
                    freq_hz: frequencies(slowest_hz, lowest_hz, SLOW_POINTS),
                    amplitude_a: campaign.amplitude_a(),
                    bias_a: 0.0,
                };
                run.repeat = SLOW_REPEATS;
            },
        ));
    }
    items
}

/// Record with the longest constant current, with the sign reversed and a part of its current.
fn mirrored(campaign: &Campaign<'_>, part: f64) -> Option<MenuItem> {
    let training = campaign
        .problem
        .of_role(Role::Train)
        .filter_map(|k| time(&campaign.problem.blocks[k]));
    let longest = |segments: &[(f64, f64)]| {
        segments
            .iter()
            .filter(|s| s.1 != 0.0)
            .map(|s| s.0)
            .fold(0.0, f64::max)
    };
    let segments = training
        .map(segments)
        .max_by(|a, b| longest(a).total_cmp(&longest(b)))?;
    let BenchLimits {
        discharge_a,
        charge_a,
        ..
    } = campaign.limits;
    let mirrored = segments
        .iter()
        .map(|(span_s, amps)| (*span_s, (-part * amps).clamp(-charge_a, discharge_a)))
        .collect();
    let words = format!(
        "the record with the longest constant current, {:.0} % of its current reversed",
        100.0 * part
    );
    campaign.trace("mirrored_charge", words, mirrored)
}

/// Discharge and charge in turn, each with its greatest current, as much out as in.
fn bursts(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let BenchLimits {
        discharge_a,
        charge_a,
        ..
    } = campaign.limits;
    let charge_coulomb = BURST_S * discharge_a.max(charge_a);
    let (out_s, in_s) = (charge_coulomb / discharge_a, charge_coulomb / charge_a);
    let pairs = (60.0 / (out_s + in_s)).round().max(1.0);
    if !pairs.is_finite() || pairs > 60.0 || in_s > 30.0 || out_s > 30.0 {
        return None;
    }
    let pair = [(out_s, discharge_a), (in_s, -charge_a)];
    let burst = std::iter::repeat_n(pair, pairs as usize).flatten();
    let segments = std::iter::once((2.0, 0.0))
        .chain(burst)
        .chain([(300.0, 0.0)])
        .collect();
    let words = format!(
        "{discharge_a:.1} A out for {out_s:.2} s and {charge_a:.1} A in for {in_s:.2} s in turn \
        for a minute, then 5 min of rest: heat without charge"
    );
    campaign.trace("zero_net_charge_bursts", words, segments)
}

fn long_pulse(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let amps = 0.6 * campaign.limits.discharge_a;
    let words = format!("{amps:.1} A for 60 s, then 30 min of rest");
    (amps > 0.0)
        .then(|| {
            campaign.trace(
                "long_pulse",
                words,
                vec![(2.0, 0.0), (60.0, amps), (1800.0, 0.0)],
            )
        })
        .flatten()
}

/// Long enough for what takes an hour to settle.
fn slow_pulse(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let amps = campaign
        .both_ways_a()
        .min(campaign.problem.base.ocv.capacity_ah);
    let words = format!("{amps:.1} A out for 5 min, 40 min of rest, and the same back");
    let segments = vec![
        (2.0, 0.0),
        (300.0, amps),
        (2400.0, 0.0),
        (300.0, -amps),
        (2400.0, 0.0),
    ];
    (amps > 0.0)
        .then(|| campaign.trace("slow_pulse", words, segments))
        .flatten()
}

/// Square waves that become ever slower: relaxations within seconds to minutes, without net charge
/// and with little rest.
fn square_waves(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let amps = campaign
        .both_ways_a()
        .min(10.0 * campaign.problem.base.ocv.capacity_ah);
    let halves = HALVES_S
        .into_iter()
        .flat_map(|half_s| [(half_s, amps), (2.0 * half_s, -amps), (half_s, amps)]);
    let segments = std::iter::once((2.0, 0.0))
        .chain(halves)
        .chain([(600.0, 0.0)])
        .collect();
    let words =
        format!("{amps:.1} A out and in with half periods of 4 s up to 80 s, then 10 min of rest");
    (amps > 0.0)
        .then(|| campaign.trace("square_waves", words, segments))
        .flatten()
}

/// Loops of charge around the start, ever smaller and then ever larger.
fn minor_loops(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let amps = campaign
        .both_ways_a()
        .min(2.0 * campaign.problem.base.ocv.capacity_ah);
    let spans_s = [120.0, 60.0, 30.0, 15.0, 30.0, 60.0, 120.0];
    let loops = spans_s
        .into_iter()
        .flat_map(|s| [(s, amps), (30.0, 0.0), (s, -amps), (30.0, 0.0)]);
    let segments = std::iter::once((2.0, 0.0)).chain(loops).collect();
    let words = format!(
        "loops of {amps:.1} A out and back around the start, 120 s down to 15 s and up again"
    );
    (amps > 0.0)
        .then(|| campaign.trace("minor_loops", words, segments))
        .flatten()
}

/// Goes down, up and back at the current of one hour: a wrong charge count shows where the curve
/// bends, a wrong voltage reading shows far from the start.
fn range_walk(campaign: &Campaign<'_>, soc: RangeInclusive<f64>) -> Option<MenuItem> {
    let capacity_ah = campaign.problem.base.ocv.capacity_ah;
    let amps = campaign.both_ways_a().min(capacity_ah);
    let (down, up) = (
        (campaign.soc - soc.start()).max(0.0),
        (soc.end() - campaign.soc).max(0.0),
    );
    let span_s = |part: f64| 3600.0 * capacity_ah * part / amps;
    let legs = [
        (span_s(down), amps),
        (span_s(down + up), -amps),
        (span_s(up), amps),
    ];
    let legs = legs
        .into_iter()
        .filter(|leg| leg.0 > 0.0)
        .flat_map(|leg| [leg, (WALK_REST_S, 0.0)]);
    let segments = std::iter::once((2.0, 0.0)).chain(legs).collect();
    let (lowest, highest) = (100.0 * (campaign.soc - down), 100.0 * (campaign.soc + up));
    let words = format!(
        "{amps:.1} A down to {lowest:.0} %, up to {highest:.0} % state of charge and back to the \
        start, with rests between"
    );
    (amps > 0.0)
        .then(|| campaign.trace("range_walk", words, segments))
        .flatten()
}

/// Returns pulses of several amplitudes with the same charge, in both directions if charging is
/// allowed.
fn equal_charge(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let ways = [campaign.limits.discharge_a, -campaign.limits.charge_a];
    let charge_coulomb = 2.0 * campaign.limits.discharge_a;
    let pulses = ways.into_iter().filter(|a| *a != 0.0).flat_map(|greatest| {
        [0.25, 0.5, 1.0].into_iter().flat_map(move |part| {
            [
                (charge_coulomb / (part * greatest).abs(), part * greatest),
                (40.0, 0.0),
            ]
        })
    });
    let segments = std::iter::once((2.0, 0.0)).chain(pulses).collect();
    let words = format!(
        "pulses of a quarter, half and all of the greatest current with {charge_coulomb:.0} C each, both \
        ways"
    );
    (charge_coulomb > 0.0)
        .then(|| campaign.trace("equal_charge_pulses", words, segments))
        .flatten()
}

/// The first run once more at the end.
pub(super) fn sentinel_repeat(campaign: &Campaign<'_>) -> Option<MenuItem> {
    let training = campaign
        .problem
        .of_role(Role::Train)
        .map(|k| &campaign.problem.blocks[k]);
    let first = training
        .filter(|b| b.at.is_cell)
        .min_by(|a, b| a.at.order.total_cmp(&b.at.order))?;
    let what = match &first.kind {
        Kind::Time(t) => Planned::Trace(segments(t)),
        Kind::Eis { .. } => campaign.sweep.clone(),
    };
    let mut run = campaign.run("sentinel_repeat", what);
    (run.soc, run.temperature_degc, run.repeat_group) =
        (first.at.soc, first.at.temperature_degc, first.group.clone());
    let description = format!(
        "run {} once more at the end: what has changed since",
        first.name
    );
    Some(MenuItem {
        name: "sentinel_repeat",
        description,
        runs: vec![run],
    })
}

/// Returns the currents of a record between its edges. A current of at most a hundredth of the
/// greatest counts as rest.
fn segments(time: &TimeBlock) -> Vec<(f64, f64)> {
    let greatest = time.current_a.iter().fold(0.0f64, |m, i| m.max(i.abs()));
    let last = time.time_s.len() - 1;
    let ends = time.edges.iter().skip(1).copied().chain([last]);
    time.edges
        .iter()
        .zip(ends)
        .filter(|(from, to)| to > from)
        .map(|(from, to)| {
            let mean = time.current_a[*from..to].iter().sum::<f64>() / (to - from) as f64;
            (
                time.time_s[to] - time.time_s[*from],
                if mean.abs() < 0.01 * greatest {
                    0.0
                } else {
                    mean
                },
            )
        })
        .collect()
}

/// Frequencies evenly in the logarithm, Hz, rising.
fn frequencies(low_hz: f64, high_hz: f64, count: usize) -> Vec<f64> {
    let step = (high_hz / low_hz).ln() / (count - 1) as f64;
    (0..count)
        .map(|k| low_hz * (step * k as f64).exp())
        .collect()
}
