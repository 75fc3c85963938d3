//! Checks the thermometers against each other, against the bath and against the heat in the cell.
//! Detects a thermometer that does not change although it must, two thermometers that are swapped,
//! and an air temperature that no room has. The functions are pure.
//!
//! A thermometer with coarse digits and without noise may correctly stay constant. The criterion
//! is the least warming of the cell, from generous values of its heat capacity and its cooling.

use instruments::units::{Amps, Celsius, Coulombs, Joules, Kelvins, Ohms, Seconds, Volts, Watts};

use std::collections::VecDeque;

/// Possible temperatures of the air of a room, °C.
const ROOM_C: (Celsius, Celsius) = (Celsius(-30.0), Celsius(55.0));
/// Least change of the cell's temperature after which an unchanged reading is a fault, K: ten
/// steps of a thermometer with one decimal.
const MUST_MOVE_K: Kelvins = Kelvins(1.0);
/// Greatest heat capacity of a cell with its holder, J/K per Ah: four times that of a cylindrical
/// lithium-ion cell.
const HEAT_CAPACITY_J_PER_K_AH: f64 = 60.0;
/// Shortest time constants with which a cell loses its heat, s: to blocks with water, and to still
/// air.
const COOLS_S: (Seconds, Seconds) = (Seconds(60.0), Seconds(600.0));
/// Longest time constant with which a cell follows its bath, s.
const FOLLOWS_S: Seconds = Seconds(3600.0);
/// Two readings farther apart than this do not define the time between them, s.
const GAP_S: Seconds = Seconds(300.0);
/// How long the change of the air temperature is followed, s.
const AIR_WINDOW_S: Seconds = Seconds(1800.0);
/// Rise of the air temperature within that time that must be visible at the cell, K, and the least
/// share of it there.
const AIR_RISES_K: Kelvins = Kelvins(8.0);
const AIR_SHARE: f64 = 0.5;
/// Least difference between two temperatures that count as different, and greatest between two
/// that count as equal, K.
const DIFFERENT_K: Kelvins = Kelvins(10.0);
const ALIKE_K: Kelvins = Kelvins(5.0);
/// How long the air temperature must match that of a cell in its bath, s.
const ALIKE_S: Seconds = Seconds(300.0);
/// Number of successive readings with which a fine thermometer repeats itself beside another one
/// that does not.
const REPEATS: u32 = 20;
/// Greatest change of the air temperature between readings that counts as noise, K.
const NOISE_K: Kelvins = Kelvins(0.1);
/// Least current from which a resistance can be determined, A, and range of resistances of a cell,
/// Ω.
const TELLS_A: Amps = Amps(0.5);
const OHM: (Ohms, Ohms) = (Ohms(1.0e-4), Ohms(1.0));

/// One reading of all thermometers; a thermometer that is missing or returns no number is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ThermometerReadings {
    /// The cell, °C.
    pub cell_degc: Option<Celsius>,
    /// The air of the room, the second channel of the logger, °C.
    pub air_degc: Option<Celsius>,
    /// The bath by its own sensor, °C.
    pub bath_degc: Option<Celsius>,
}

/// Fault of the thermometers.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ThermometerFault {
    /// The air has a temperature that no room has.
    #[error(
        "that of the air reads {air_degc:.1}, expected {} to {}: is it swapped with that of \
        the cell?",
        ROOM_C.0,
        ROOM_C.1
    )]
    NoRoom {
        /// Reading, °C.
        air_degc: Celsius,
    },
    /// The air warms, and the cell does not.
    #[error(
        "that of the air has risen by {rise_k:.1} to {air_degc:.1}, and that of the cell by \
        {cell_rise_k:.1}: are the two swapped?"
    )]
    AirWarms {
        /// Reading of the air, °C.
        air_degc: Celsius,
        /// Rise of the air temperature, K.
        rise_k: Kelvins,
        /// Rise of the cell temperature in the same time, K.
        cell_rise_k: Kelvins,
    },
    /// The air is as warm as the bath, and the cell is not.
    #[error(
        "that of the cell reads {cell_degc:.1}, that of the air {air_degc:.1}, and the bath \
        {bath_degc:.1}: are the two swapped?"
    )]
    AirInBath {
        /// Reading of the cell, °C.
        cell_degc: Celsius,
        /// Reading of the air, °C.
        air_degc: Celsius,
        /// Reading of the bath, °C.
        bath_degc: Celsius,
    },
    /// The bath temperature has changed, but the cell's thermometer has not.
    #[error(
        "that of the cell reads {cell_degc} all the while, although the bath went from \
        {bath_from_degc:.1} to {bath_degc:.1}, which must have moved it by {must_k:.1}: it is \
        frozen"
    )]
    StillBesideBath {
        /// Reading of the cell, °C.
        cell_degc: Celsius,
        /// Temperature of the bath at the last change of the reading, °C.
        bath_from_degc: Celsius,
        /// The bath now, °C.
        bath_degc: Celsius,
        /// Least change of the cell's temperature that must have occurred, K.
        must_k: Kelvins,
    },
    /// The cell was heated, but its thermometer has not changed.
    #[error(
        "that of the cell reads {cell_degc} all the while, although {heat_j:.0} of heat in the \
        cell must have warmed it by {must_k:.1}: it is frozen"
    )]
    StillWhileHeated {
        /// Reading of the cell, °C.
        cell_degc: Celsius,
        /// Heat since the reading changed last, J.
        heat_j: Joules,
        /// Least warming of the cell that must have occurred, K.
        must_k: Kelvins,
    },
    /// The other thermometer of the same logger shows noise, and that of the cell does not.
    #[error(
        "that of the cell has read {cell_degc} {times} times in a row, while that of the air \
        changed each time by its noise: it is frozen"
    )]
    StillBesideAir {
        /// Reading of the cell, °C.
        cell_degc: Celsius,
        /// Number of equal readings.
        times: u32,
    },
}

/// Heat in the cell by its own resistance, as far as a step of the current shows it.
#[derive(Debug, Clone, Copy, Default)]
struct Heat {
    rest_v: Option<Volts>,
    ohm: Option<Ohms>,
    /// Last current, A, with its time, s.
    last: Option<(Amps, Seconds)>,
    /// Heat that no reading has consumed yet, J.
    joules: Joules,
}

impl Heat {
    fn take(&mut self, volts: Volts, amps: Amps, time_s: Seconds) {
        if let (Some((before_a, before_s)), Some(ohm)) = (self.last, self.ohm) {
            let passed_s = (time_s - before_s).clamp(Seconds::ZERO, GAP_S);
            // Use the smaller of two currents, so that a single sampled peak does not count.
            let least_a = before_a.abs().min(amps.abs()).value();
            self.joules += Watts(ohm.value() * least_a.powi(2)) * passed_s;
        }
        let rested = self
            .last
            .is_none_or(|(before_a, _)| before_a.abs() < TELLS_A);
        self.last = Some((amps, time_s));
        if !volts.is_finite() {
            return;
        }
        if amps.abs() < TELLS_A {
            self.rest_v = Some(volts);
        } else if let Some(rest_v) = self.rest_v.filter(|_| rested) {
            let ohm = (volts - rest_v) / amps;
            self.ohm = Some(ohm)
                .filter(|ohm| (OHM.0..=OHM.1).contains(ohm))
                .or(self.ohm);
        }
    }
}

/// What must have happened to the cell since its reading last changed.
#[derive(Debug, Clone, Copy)]
struct Still {
    cell_degc: Celsius,
    /// Temperature of the bath at that time, °C.
    bath_from_degc: Option<Celsius>,
    /// Least movement by the bath, and least warming by heat, K.
    by_bath_k: Kelvins,
    by_heat_k: Kelvins,
    heat_j: Joules,
    /// Number of readings in which the cell repeated itself while the air temperature changed by
    /// its noise.
    repeats: u32,
}

impl Still {
    fn begin(cell_degc: Celsius, bath_degc: Option<Celsius>) -> Self {
        Self {
            cell_degc,
            bath_from_degc: bath_degc,
            by_bath_k: Kelvins::ZERO,
            by_heat_k: Kelvins::ZERO,
            heat_j: Joules::ZERO,
            repeats: 0,
        }
    }

    /// Advances by `passed_s` with heat in the cell, J.
    fn pass(
        &mut self,
        passed_s: Seconds,
        heat_j: Joules,
        bath_degc: Option<Celsius>,
        capacity_j_per_k: f64,
    ) {
        let cools_s = if bath_degc.is_some() {
            COOLS_S.0
        } else {
            COOLS_S.1
        };
        self.heat_j += heat_j;
        self.by_heat_k = self.by_heat_k * (-passed_s / cools_s).exp()
            + Kelvins(heat_j.value() / capacity_j_per_k);
        if let Some((from_degc, now_degc)) = self.bath_from_degc.zip(bath_degc) {
            let left = (-passed_s / FOLLOWS_S).exp();
            let goal_k = now_degc - from_degc;
            self.by_bath_k = goal_k + (self.by_bath_k - goal_k) * left;
        }
        if self.bath_from_degc.is_none() {
            self.bath_from_degc = bath_degc;
        }
    }

    fn fault(&self, bath_degc: Option<Celsius>) -> Option<ThermometerFault> {
        let cell_degc = self.cell_degc;
        if let Some((bath_from_degc, bath_degc)) = self.bath_from_degc.zip(bath_degc)
            && self.by_bath_k.abs() > MUST_MOVE_K
        {
            return Some(ThermometerFault::StillBesideBath {
                cell_degc,
                bath_from_degc,
                bath_degc,
                must_k: self.by_bath_k,
            });
        }
        if self.by_heat_k > MUST_MOVE_K {
            return Some(ThermometerFault::StillWhileHeated {
                cell_degc,
                heat_j: self.heat_j,
                must_k: self.by_heat_k,
            });
        }
        (self.repeats >= REPEATS && is_fine(cell_degc)).then_some(
            ThermometerFault::StillBesideAir {
                cell_degc,
                times: self.repeats + 1,
            },
        )
    }
}

/// Checks whether a reading shows that its thermometer has fine digits: it is not a multiple of a
/// hundredth or of a sixteenth of a degree.
fn is_fine(celsius: Celsius) -> bool {
    [100.0, 16.0].iter().all(|steps| {
        let scaled = celsius.value() * steps;
        (scaled - scaled.round()).abs() > 1.0e-6 * scaled.abs().max(1.0)
    })
}

/// Judges successive readings of the thermometers.
#[derive(Debug)]
pub struct ThermometerJudge {
    /// Greatest heat capacity of the cell, J/K.
    capacity_j_per_k: f64,
    heat: Heat,
    last: Option<(Seconds, ThermometerReadings)>,
    still: Option<Still>,
    /// Times, s, and readings of air and cell, °C, within the window.
    air: VecDeque<(Seconds, Celsius, Celsius)>,
    /// Time since which the air temperature matches that of a cell in its bath, s.
    alike_s: Option<Seconds>,
}

impl ThermometerJudge {
    /// Creates a judge for a cell of this capacity, C.
    pub fn new(capacity_coulomb: Coulombs) -> Self {
        Self {
            capacity_j_per_k: HEAT_CAPACITY_J_PER_K_AH * capacity_coulomb.value() / 3600.0,
            heat: Heat::default(),
            last: None,
            still: None,
            air: VecDeque::new(),
            alike_s: None,
        }
    }

    /// Drops the history after a change of the object in the jig: earlier readings do not apply to
    /// it.
    pub fn forget(&mut self) {
        (self.heat, self.last, self.still) = (Heat::default(), None, None);
        self.air.clear();
        self.alike_s = None;
    }

    /// Accepts the voltage, V, and the current, A, of a reading at `time_s`, from which the heat
    /// in the cell follows.
    pub fn take_power(&mut self, volts: Volts, amps: Amps, time_s: Seconds) {
        self.heat.take(volts, amps, time_s);
    }

    /// Judges a reading at `now_s`. `cell` is false while the cell lies beside the jig; then only
    /// the air temperature is judged.
    pub fn judge(
        &mut self,
        readings: ThermometerReadings,
        cell: bool,
        now_s: Seconds,
    ) -> Option<ThermometerFault> {
        let finite = |value: Option<Celsius>| value.filter(|celsius| celsius.is_finite());
        let readings = ThermometerReadings {
            cell_degc: finite(readings.cell_degc),
            air_degc: finite(readings.air_degc),
            bath_degc: finite(readings.bath_degc),
        };
        let no_room = readings
            .air_degc
            .filter(|air_degc| !(ROOM_C.0..=ROOM_C.1).contains(air_degc));
        if let Some(air_degc) = no_room {
            return Some(ThermometerFault::NoRoom { air_degc });
        }
        let heat_j = std::mem::take(&mut self.heat.joules);
        if !cell {
            self.forget();
            return None;
        }
        let before = self
            .last
            .replace((now_s, readings))
            .filter(|(before_s, _)| now_s - *before_s <= GAP_S);
        self.judge_still(readings, before, heat_j, now_s)
            .or_else(|| self.judge_air(readings, now_s))
    }

    fn judge_still(
        &mut self,
        readings: ThermometerReadings,
        before: Option<(Seconds, ThermometerReadings)>,
        heat_j: Joules,
        now_s: Seconds,
    ) -> Option<ThermometerFault> {
        let cell_degc = readings.cell_degc?;
        let Some((still, (before_s, before))) = self
            .still
            .as_mut()
            .zip(before)
            .filter(|(still, _)| still.cell_degc == cell_degc)
        else {
            self.still = Some(Still::begin(cell_degc, readings.bath_degc));
            return None;
        };
        still.pass(
            now_s - before_s,
            heat_j,
            readings.bath_degc,
            self.capacity_j_per_k,
        );
        let noise =
            readings
                .air_degc
                .zip(before.air_degc)
                .is_some_and(|(now_degc, before_degc)| {
                    now_degc != before_degc && (now_degc - before_degc).abs() < NOISE_K
                });
        still.repeats = if noise { still.repeats + 1 } else { 0 };
        still.fault(readings.bath_degc)
    }

    fn judge_air(
        &mut self,
        readings: ThermometerReadings,
        now_s: Seconds,
    ) -> Option<ThermometerFault> {
        let (cell_degc, air_degc) = readings.cell_degc.zip(readings.air_degc)?;
        self.air.push_back((now_s, air_degc, cell_degc));
        while self
            .air
            .front()
            .is_some_and(|(time_s, ..)| now_s - *time_s > AIR_WINDOW_S)
        {
            self.air.pop_front();
        }
        let coldest = self.air.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let (rise_k, cell_rise_k) = (air_degc - coldest.1, cell_degc - coldest.2);
        if rise_k > AIR_RISES_K && cell_rise_k < AIR_SHARE * rise_k {
            return Some(ThermometerFault::AirWarms {
                air_degc,
                rise_k,
                cell_rise_k,
            });
        }
        let bath_degc = readings.bath_degc.filter(|bath_degc| {
            air_degc - cell_degc > DIFFERENT_K && (air_degc - *bath_degc).abs() < ALIKE_K
        });
        let Some(bath_degc) = bath_degc else {
            self.alike_s = None;
            return None;
        };
        let since_s = *self.alike_s.get_or_insert(now_s);
        (now_s - since_s >= ALIKE_S).then_some(ThermometerFault::AirInBath {
            cell_degc,
            air_degc,
            bath_degc,
        })
    }
}

#[cfg(test)]
mod tests;
