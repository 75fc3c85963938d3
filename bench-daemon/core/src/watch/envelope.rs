//! The limits that apply at the moment, against which the watch checks every reading.

use instruments::units::{Amps, Celsius, Seconds, Unit, Volts};

use bench_plan::interlock::{Allowance, CURRENT_MARGIN, Drive, Drives, NO_CURRENT_A};

/// Limits of currents, voltage and temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    /// Least and greatest current of each drive, A, in the direction that its meter counts.
    amps: [(Amps, Amps); 3],
    used: Drives,
    /// Least and greatest voltage of the cell, V, while it is in the jig and a current may flow.
    volts: Option<(Volts, Volts)>,
    /// Least and greatest temperature of the cell, °C.
    degc: (Celsius, Celsius),
}

impl Envelope {
    /// Returns an envelope that allows no current and sets no limits for a cell.
    pub fn nothing() -> Self {
        Self {
            amps: [(-NO_CURRENT_A, NO_CURRENT_A); 3],
            used: Drives::default(),
            volts: None,
            degc: (Celsius::NEG_INFINITY, Celsius::INFINITY),
        }
    }

    /// Returns the envelope of a step.
    pub fn of(allowance: &Allowance) -> Self {
        let limits = &allowance.limits;
        let (charge_a, discharge_a) = (
            CURRENT_MARGIN * limits.charge_a,
            CURRENT_MARGIN * limits.discharge_a,
        );
        let used = |drive| allowance.live && allowance.drives.uses(drive);
        let amps = Drive::ALL.map(|drive| match drive {
            _ if !used(drive) => (-NO_CURRENT_A, NO_CURRENT_A),
            Drive::Supply4q => (-discharge_a, charge_a),
            Drive::Load => (-NO_CURRENT_A, discharge_a),
            Drive::Supply => (-NO_CURRENT_A, charge_a),
        });
        Self {
            amps,
            used: if allowance.live {
                allowance.drives
            } else {
                Drives::default()
            },
            volts: (allowance.live && allowance.cell).then_some((limits.min_v, limits.max_v)),
            degc: (limits.min_degc, limits.max_degc),
        }
    }

    /// Combines two envelopes into one that allows what either of them allows, for the transition
    /// between two steps.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            amps: [0, 1, 2].map(|at| wider([self.amps[at], other.amps[at]])),
            used: Drives {
                supply4q: self.used.supply4q || other.used.supply4q,
                load: self.used.load || other.used.load,
                supply: self.used.supply || other.used.supply,
            },
            volts: self
                .volts
                .zip(other.volts)
                .map(|(one, other)| wider([one, other])),
            degc: wider([self.degc, other.degc]),
        }
    }

    /// Limits the current to at most `most_a`, A, in either direction.
    #[must_use]
    pub fn at_most(self, most_a: Amps) -> Self {
        Self {
            amps: self
                .amps
                .map(|(least, greatest)| (least.max(-most_a), greatest.min(most_a))),
            ..self
        }
    }

    /// Returns the least and greatest current of a drive, A.
    pub fn amps(&self, drive: Drive) -> (Amps, Amps) {
        self.amps[drive as usize]
    }

    /// Checks whether the step uses a drive.
    pub fn uses(&self, drive: Drive) -> bool {
        self.used.uses(drive)
    }

    /// Checks whether a current may flow.
    pub fn is_live(&self) -> bool {
        self.used != Drives::default()
    }

    /// Returns the least and greatest voltage of the cell, V, if it is judged.
    pub fn volts(&self) -> Option<(Volts, Volts)> {
        self.volts
    }

    /// Returns the least and greatest temperature of the cell, °C.
    pub fn degc(&self) -> (Celsius, Celsius) {
        self.degc
    }
}

/// Returns a range that holds two others.
fn wider<Q: Unit>([one, other]: [(Q, Q); 2]) -> (Q, Q) {
    (
        Q::of(one.0.number().min(other.0.number())),
        Q::of(one.1.number().max(other.1.number())),
    )
}

/// The envelope in force. After a change both envelopes apply until the procedure has verified
/// that the new one is kept, but only for a bounded time.
#[derive(Debug)]
pub(super) struct InForce {
    present: Envelope,
    before: Option<(Envelope, Seconds)>,
}

impl InForce {
    pub(super) fn new() -> Self {
        Self {
            present: Envelope::nothing(),
            before: None,
        }
    }

    /// Applies `next` from now on, and keeps the previous envelope until `until_s`.
    pub(super) fn change(&mut self, next: Envelope, until_s: Seconds) {
        if next != self.present {
            self.before = Some((self.present, until_s));
            self.present = next;
        }
    }

    /// Ends the previous envelope: the procedure has read a current that the present one allows.
    pub(super) fn settle(&mut self) {
        self.before = None;
    }

    /// Returns the envelopes that apply to a reading that was requested at `asked_s`.
    pub(super) fn at(&mut self, asked_s: Seconds) -> Envelopes {
        let allowed = match self.before {
            Some((before, until_s)) if asked_s <= until_s => self.present.or(before),
            Some(_) => {
                self.before = None;
                self.present
            }
            None => self.present,
        };
        Envelopes {
            allowed,
            present: self.present,
        }
    }
}

/// The envelope that decides on a reading, and the one that a message names.
#[derive(Debug, Clone, Copy)]
pub(super) struct Envelopes {
    /// What the present or the previous step allows.
    pub(super) allowed: Envelope,
    /// What the present step allows.
    pub(super) present: Envelope,
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::interlock::Limits;

    const CELL: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(13.5),
        discharge_a: Amps(45.0),
        min_degc: Celsius(0.0),
        max_degc: Celsius(60.0),
    };

    fn allowing(drives: Drives, charge_a: Amps, discharge_a: Amps) -> Envelope {
        Envelope::of(&Allowance {
            live: true,
            drives,
            ..Allowance::idle(CELL.bounded(charge_a, discharge_a))
        })
    }

    #[test]
    fn a_step_allows_current_in_the_drives_that_it_uses_and_in_no_other() {
        let nothing = (-NO_CURRENT_A, NO_CURRENT_A);
        for (drives, expected) in [
            (
                Drives::SUPPLY4Q,
                [(Amps(-2.04), Amps(1.02)), nothing, nothing],
            ),
            (
                Drives::LOAD,
                [nothing, (-NO_CURRENT_A, Amps(2.04)), nothing],
            ),
            (
                Drives::SUPPLY,
                [nothing, nothing, (-NO_CURRENT_A, Amps(1.02))],
            ),
            (Drives::default(), [nothing; 3]),
        ] {
            let envelope = allowing(drives, Amps(1.0), Amps(2.0));
            assert_eq!(Drive::ALL.map(|drive| envelope.amps(drive)), expected);
            assert_eq!(envelope.is_live(), drives != Drives::default());
        }
        let idle = Envelope::of(&Allowance {
            drives: Drives::LOAD,
            ..Allowance::idle(CELL)
        });
        assert_eq!(idle.amps(Drive::Load), nothing);
        assert_eq!(idle.volts(), None);
    }

    #[test]
    fn two_envelopes_hold_until_the_new_one_is_seen_or_time_is_up() {
        let (wide, narrow) = (
            allowing(Drives::SUPPLY4Q, Amps(5.0), Amps(5.0)),
            allowing(Drives::SUPPLY4Q, Amps(1.0), Amps(1.0)),
        );
        let mut force = InForce::new();
        force.change(wide, Seconds(1.0));
        force.change(narrow, Seconds(10.0));
        assert_eq!(
            force.at(Seconds(9.0)).allowed.amps(Drive::Supply4q),
            (Amps(-5.1), Amps(5.1))
        );
        force.settle();
        assert_eq!(
            force.at(Seconds(9.0)).allowed.amps(Drive::Supply4q),
            (Amps(-1.02), Amps(1.02))
        );
        force.change(wide, Seconds(20.0));
        force.change(narrow, Seconds(30.0));
        assert_eq!(
            force.at(Seconds(31.0)).allowed.amps(Drive::Supply4q),
            (Amps(-1.02), Amps(1.02))
        );
        // Setting the same envelope again does not restore the previous one.
        force.change(narrow, Seconds(90.0));
        assert_eq!(
            force.at(Seconds(40.0)).allowed.amps(Drive::Supply4q),
            (Amps(-1.02), Amps(1.02))
        );
    }
}
