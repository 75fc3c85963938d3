//! The direct current under the sinusoids of a sweep: what is commanded, what flows, and the charge
//! that it has moved.

use instruments::units::{Amps, Celsius, Coulombs, Seconds, Volts};

use analysis_files::dataset::PointConditions;

use bench_plan::{interlock::Trip, measure::zero::Zeros};

/// Factor on the planned charge at which the run ends.
const MOST_MOVED: f64 = 1.25;
/// Possible error of the charge by the supply's meter, as a share of what flowed in both directions.
const METER_SHARE: f64 = 0.1;
/// Time for which the direct current may flow beyond that, s: its ramps and records.
const MORE_S: Seconds = Seconds(60.0);

/// The direct current under the sinusoids of a sweep.
#[derive(Debug, Default)]
pub(crate) struct BiasState {
    /// Commanded direct current, A, charge positive.
    pub(crate) commanded_a: Amps,
    /// The current that flows.
    pub(crate) met: MetCurrent,
    /// Direct current by the meter of the bipolar supply, A.
    pub(crate) meter_a: Amps,
    /// Zero error of the drive that the command cancels, A.
    pub(crate) zero_a: Amps,
    /// Means of the channels with every output off, V; `None` outside a sweep with a direct current.
    pub(crate) off_v: Option<[Volts; 4]>,
    /// Means of the channels at the direct current, without a sinusoid.
    pub(crate) zeros: Zeros,
    /// Current for which the ranges of its records are made, A.
    pub(crate) range_a: Amps,
    /// Charge so far.
    pub(crate) charge: MovedCharge,
}

/// A measured direct current.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct MetCurrent {
    /// Before the first sinusoid, A.
    pub(crate) base_a: Amps,
    /// By the last record, A.
    pub(crate) current_a: Amps,
    /// Standard deviation, A.
    pub(crate) sigma_a: Amps,
}

/// The charge that a direct current has moved.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct MovedCharge {
    coulomb: Coulombs,
    /// In both directions together, C.
    passed_coulomb: Coulombs,
    /// Bench time up to which it is counted, s.
    since_s: Seconds,
    /// Charge that the plan allows, C.
    most_coulomb: Coulombs,
}

impl BiasState {
    /// Returns the state at the beginning of a sweep that may move `most_coulomb` with currents up to
    /// `range_a`.
    pub(crate) fn begin(most_coulomb: Coulombs, range_a: Amps, now_s: Seconds) -> Self {
        Self {
            range_a,
            charge: MovedCharge {
                coulomb: Coulombs::ZERO,
                passed_coulomb: Coulombs::ZERO,
                since_s: now_s,
                most_coulomb,
            },
            ..Self::default()
        }
    }

    /// Checks whether a direct current flows.
    pub(crate) fn is_on(&self) -> bool {
        self.commanded_a != Amps::ZERO
    }

    /// Counts the charge up to now, during which `current_a` has flowed.
    pub(crate) fn count(&mut self, now_s: Seconds, current_a: Amps) {
        let coulomb = current_a * (now_s - self.charge.since_s);
        self.charge.coulomb += coulomb;
        self.charge.passed_coulomb += coulomb.abs();
        self.charge.since_s = now_s;
    }

    /// Takes the current that a record shows.
    pub(crate) fn meet(&mut self, now_s: Seconds, current_a: Amps) {
        self.met.current_a = current_a;
        self.count(now_s, current_a);
    }

    /// Counts the charge, because no current flows from now on.
    pub(crate) fn cut(&mut self, now_s: Seconds) {
        self.count(now_s, self.met.current_a);
        (self.commanded_a, self.meter_a, self.zero_a) = (Amps::ZERO, Amps::ZERO, Amps::ZERO);
        self.met = MetCurrent::default();
    }

    /// Returns how far the supply's meter may be from the charge that the shunt counts, C: its mean at the
    /// direct current is of few readings, and is kept for hours.
    pub(crate) fn unsure_coulomb(&self) -> Coulombs {
        METER_SHARE * self.charge.passed_coulomb
    }

    /// Returns the charge at a bench time, C.
    pub(crate) fn moved_coulomb(&self, at_s: Seconds) -> Coulombs {
        self.charge.coulomb + self.met.current_a * (at_s - self.charge.since_s)
    }

    /// Returns the conditions of a point whose record has its middle at `at_s`; `None` without a
    /// direct current.
    pub(crate) fn conditions(
        &self,
        at_s: Seconds,
        temperature_degc: Option<Celsius>,
    ) -> Option<PointConditions> {
        self.is_on().then(|| PointConditions {
            bias_a: self.commanded_a.value(),
            bias_measured_a: self.met.current_a.value(),
            sigma_bias_a: self.met.sigma_a.value(),
            charge_coulomb: self.moved_coulomb(at_s).value(),
            temperature_degc: temperature_degc
                .map(Celsius::value)
                .filter(|degc| degc.is_finite()),
        })
    }

    /// Judges the charge so far.
    pub(crate) fn judge(&self, now_s: Seconds) -> Option<Trip> {
        let value = self.moved_coulomb(now_s);
        let greatest = MOST_MOVED * self.charge.most_coulomb + MORE_S * self.commanded_a.abs();
        let what = "charge moved by the direct current";
        (self.off_v.is_some() && value.abs() > greatest)
            .then(|| Trip::limit(what, value, &(-greatest..=greatest), now_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_charge_counts_each_current_up_to_its_end() {
        let mut bias = BiasState::begin(Coulombs(100.0), Amps(3.0), Seconds(10.0));
        bias.off_v = Some([Volts(0.0); 4]);
        bias.count(Seconds(11.0), Amps(1.0));
        bias.commanded_a = Amps(2.0);
        bias.met.current_a = Amps(2.1);
        assert!((bias.moved_coulomb(Seconds(12.0)) - Coulombs(3.1)).abs() < Coulombs(1.0e-12));
        // A record shows what has flowed since the last count.
        bias.meet(Seconds(21.0), Amps(2.0));
        assert!((bias.moved_coulomb(Seconds(21.0)) - Coulombs(21.0)).abs() < Coulombs(1.0e-12));
        let at = bias.conditions(Seconds(20.0), Some(Celsius::NAN)).unwrap();
        assert_eq!(
            (at.bias_a, at.bias_measured_a, at.temperature_degc),
            (2.0, 2.0, None)
        );
        assert!((at.charge_coulomb - 19.0).abs() < 1.0e-12);
        // 1.25 · 100 C and a minute of 2 A.
        assert_eq!(bias.judge(Seconds(132.9)), None);
        let trip = bias.judge(Seconds(133.1)).map(|trip| trip.to_string());
        assert!(
            trip.as_deref()
                .is_some_and(|text| text.starts_with("charge moved by the direct current 245.2")),
            "{trip:?}"
        );
        // 21 C by records; a tenth may be the meter's.
        assert!((bias.unsure_coulomb() - Coulombs(2.1)).abs() < Coulombs(1.0e-12));
        bias.cut(Seconds(31.0));
        assert!(
            (bias.moved_coulomb(Seconds(1000.0)) - Coulombs(41.0)).abs() < Coulombs(1.0e-12)
                && !bias.is_on()
        );
        assert_eq!(bias.conditions(Seconds(0.0), None), None);
        // Outside such a sweep nothing is judged.
        assert_eq!(BiasState::default().judge(Seconds(1.0e9)), None);
    }
}
