//! A trace as data: when the current changes, when the scope records, and the greatest load on the
//! cell.

use analysis_signal::series::Role;

use instruments::units::{Amps, Coulombs, Ohms, Seconds, Unit, Volts, Watts};

use crate::interlock::Limits;

/// Instruments that execute a trace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Through {
    /// The bipolar supply, step by step.
    Bipolar,
    /// The bipolar supply, which follows a wave in the generator's memory.
    Wave {
        /// Length of a step, s.
        step_s: Seconds,
        /// Steps of a period: the trace, and the time without a current before and after it.
        steps: usize,
    },
    /// The DC load discharges, the DC supply charges; their own meters record.
    LoadAndSupply,
}

/// Averaging of rows that are shorter than a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Averaged {
    /// Length of a step, s.
    pub step_s: Seconds,
    /// Number of rows before averaging.
    pub rows: usize,
    /// Whether the values are powers, W, instead of currents, A.
    pub power: bool,
    /// Root mean square of what averaging removes, over time, W or A.
    pub rms: f64,
    /// Ratio of this value to the root mean square of the rows.
    pub share: f64,
    /// Greatest difference, W or A.
    pub greatest: f64,
}

impl std::fmt::Display for Averaged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (what, kept, unit) = if self.power {
            ("powers", "energy", "W")
        } else {
            ("currents", "charge", "A")
        };
        write!(
            f,
            "{} {what} averaged over steps of {} s: the {kept} of each step is kept, {:.3} {unit} \
            rms ({:.1} % of the rows' rms) and at most {:.3} {unit} \
             are left out",
            self.rows,
            self.step_s.0,
            self.rms,
            100.0 * self.share,
            self.greatest
        )
    }
}

/// A stepwise current, with the frames that record it. Times count from the start of the first
/// frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TracePlan {
    /// Its name.
    pub name: String,
    /// Number of the repeat, from 1.
    pub repeat: usize,
    /// Purpose of the trace.
    pub role: Role,
    /// Traces of one group repeat each other.
    pub repeat_group: String,
    /// Instruments that execute it.
    pub through: Through,
    /// Averaging of rows that are shorter than a step.
    pub averaged: Option<Averaged>,
    /// Resistance between the cell and the load's voltmeter where load and supply drive, Ω.
    pub lead_ohm: Ohms,
    /// Rest before it, nothing connected, s.
    pub rest_s: Seconds,
    /// Steps of the current, by time; the last is to zero.
    pub levels: Vec<Level>,
    /// End of the rest after the last step, s.
    pub end_s: Seconds,
    /// Frames, by time and without overlap; every step lies within one.
    pub frames: Vec<Frame>,
    /// Open-circuit voltages at which it may begin, V.
    pub start_v: (Volts, Volts),
    /// Greatest resistance between current and voltmeter, Ω.
    pub resistance_max_ohm: Ohms,
    /// Capacity of the cell, C.
    pub capacity_coulomb: Coulombs,
    /// Averaging of the frames: first mean after a step, s; growth; longest, s.
    pub thinning: (Seconds, f64, Seconds),
}

/// A current from a certain time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Start time, s.
    pub at_s: Seconds,
    /// Current, A, charge positive; for a power, in the worst case.
    pub current_a: Amps,
    /// Power into the cell, W, if given instead of a current.
    pub power_w: Option<Watts>,
}

impl Level {
    /// Returns the current at a voltage of the cell, A, which never exceeds the worst case.
    pub fn at_a(&self, volts: Volts) -> Amps {
        let most_a = self.current_a.abs();
        self.power_w.map_or(self.current_a, |power_w| {
            (power_w / volts).clamp(-most_a, most_a)
        })
    }
}

/// A frame that the scope records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Start, s.
    pub start_s: Seconds,
    /// Duration, s.
    pub span_s: Seconds,
    /// Points in the scope's memory per channel.
    pub memory_points: u64,
    /// Points downloaded per channel.
    pub record_points: u64,
}

/// Greatest share of the capacity that a trace may move in either direction.
const GREATEST_SWING: f64 = 0.5;
/// Longest frame, s: a simulated bench stores twice as much.
pub const LONGEST_FRAME_S: Seconds = Seconds(200.0);

impl TracePlan {
    /// Returns the time between the first frame and the end of the last, or of the rest, s.
    pub fn length_s(&self) -> Seconds {
        self.frames
            .iter()
            .map(|frame| frame.start_s + frame.span_s)
            .fold(self.end_s, Seconds::max)
    }

    /// Checks whether the trace needs the bipolar supply.
    pub fn bipolar(&self) -> bool {
        self.through != Through::LoadAndSupply
    }

    /// Returns the least and greatest current, A, both including zero.
    pub fn extremes_a(&self) -> (Amps, Amps) {
        self.levels
            .iter()
            .fold((Amps::ZERO, Amps::ZERO), |(least, greatest), level| {
                (level.current_a.min(least), level.current_a.max(greatest))
            })
    }

    /// Describes the first step that is not zero, and its direction, so that the sign of a file is
    /// visible before a current flows.
    pub(super) fn first_step(&self) -> Option<String> {
        let level = self
            .levels
            .iter()
            .find(|level| level.current_a != Amps::ZERO)?;
        let current = (level.current_a.value(), Amps::SYMBOL);
        let (value, unit) = level
            .power_w
            .map_or(current, |power_w| (power_w.value(), Watts::SYMBOL));
        let way = if level.current_a < Amps::ZERO {
            "out of the cell"
        } else {
            "into the cell"
        };
        // A scaled or averaged value has more digits than a person needs.
        Some(format!(
            "{} {unit} {way}",
            (1.0e3 * value.abs()).round() / 1.0e3
        ))
    }

    /// Returns the greatest charge below and above the start, C.
    pub fn swing_coulomb(&self) -> (Coulombs, Coulombs) {
        let (mut charge_coulomb, mut least_coulomb, mut greatest_coulomb) =
            (Coulombs::ZERO, Coulombs::ZERO, Coulombs::ZERO);
        for pair in self.levels.windows(2) {
            charge_coulomb += pair[0].current_a * (pair[1].at_s - pair[0].at_s);
            (least_coulomb, greatest_coulomb) = (
                least_coulomb.min(charge_coulomb),
                greatest_coulomb.max(charge_coulomb),
            );
        }
        (least_coulomb, greatest_coulomb)
    }

    /// Returns how far the open-circuit voltage may fall and rise, V: the charge as a share of the
    /// cell's capacity, times the cell's voltage window, doubled because the curve is steeper in
    /// places.
    pub fn drift_v(&self, limits: &Limits) -> (Volts, Volts) {
        let (least_coulomb, greatest_coulomb) = self.swing_coulomb();
        let per_coulomb =
            2.0 * (limits.max_v - limits.min_v).value() / self.capacity_coulomb.value();
        (
            Volts(least_coulomb.value() * per_coulomb),
            Volts(greatest_coulomb.value() * per_coulomb),
        )
    }

    /// Returns an error if the trace could exceed the limits of the cell in the worst case, or
    /// could not be recorded.
    pub(super) fn check(&self, limits: &Limits) -> Result<(), String> {
        let (least_a, greatest_a) = self.extremes_a();
        for (amps, limit, what) in [
            (-least_a, limits.discharge_a, "discharge"),
            (greatest_a, limits.charge_a, "charge"),
        ] {
            if amps > limit {
                return Err(format!(
                    "expected {what} currents of at most {limit}, found {amps}"
                ));
            }
        }
        let (least_coulomb, greatest_coulomb) = self.swing_coulomb();
        let most_coulomb = GREATEST_SWING * self.capacity_coulomb;
        if !(-least_coulomb <= most_coulomb && greatest_coulomb <= most_coulomb) {
            let (least_ah, greatest_ah, most_ah) = (
                least_coulomb.value() / 3600.0,
                greatest_coulomb.value() / 3600.0,
                most_coulomb.value() / 3600.0,
            );
            return Err(format!(
                "expected charge within ±{most_ah:.3} Ah of the start, found {least_ah:.3} Ah to \
                {greatest_ah:.3} Ah"
            ));
        }
        self.check_voltage(limits)?;
        self.check_frames()
    }

    /// Returns an error if the voltage could exceed the limits of the cell in the worst case.
    pub(crate) fn check_voltage(&self, limits: &Limits) -> Result<(), String> {
        let (lowest_v, highest_v) = self.worst_v(limits);
        if !(lowest_v >= limits.min_v && highest_v <= limits.max_v) {
            return Err(format!(
                "expected a cell voltage within {} V to {} V at worst, found {lowest_v:.3} to \
                {highest_v:.3}, from {} V to {} V at the start",
                limits.min_v.0, limits.max_v.0, self.start_v.0.0, self.start_v.1.0
            ));
        }
        Ok(())
    }

    /// Returns the lowest and highest voltage in the worst case, V.
    pub(crate) fn worst_v(&self, limits: &Limits) -> (Volts, Volts) {
        let (least_a, greatest_a) = self.extremes_a();
        let (down_v, up_v) = self.drift_v(limits);
        let lowest_v = self.start_v.0 + down_v + self.resistance_max_ohm * least_a;
        let highest_v = self.start_v.1 + up_v + self.resistance_max_ohm * greatest_a;
        (lowest_v, highest_v)
    }

    fn check_frames(&self) -> Result<(), String> {
        if !self.bipolar() {
            let ends = self
                .levels
                .last()
                .is_some_and(|level| level.current_a == Amps::ZERO);
            return ends
                .then_some(())
                .ok_or_else(|| "expected an end without current".to_owned());
        }
        if let Some(frame) = self
            .frames
            .iter()
            .find(|frame| frame.span_s > LONGEST_FRAME_S)
        {
            return Err(format!(
                "expected steps that frames of at most {LONGEST_FRAME_S} can hold, found one of \
                {} s at {:.1} s: set pauses between the steps",
                frame.span_s.0, frame.start_s.0
            ));
        }
        let held = |level: &Level| {
            self.frames
                .iter()
                .any(|frame| (frame.start_s..frame.start_s + frame.span_s).contains(&level.at_s))
        };
        let apart = self
            .frames
            .windows(2)
            .all(|pair| pair[0].start_s + pair[0].span_s < pair[1].start_s);
        let ends = self
            .levels
            .last()
            .is_some_and(|level| level.current_a == Amps::ZERO);
        if apart && ends && self.levels.iter().all(held) {
            return Ok(());
        }
        Err(
            "expected each step within one frame, frames apart and an end without current"
                .to_owned(),
        )
    }
}
