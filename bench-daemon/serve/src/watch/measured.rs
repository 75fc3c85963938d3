//! The last reading of a run, and the state of charge by its readings.

use analysis::run_folder::{EnvelopeRow, ReadingRow};
use instruments::fixture::Fixture;

use crate::live::{ReadingNow, Soc};
use bench_plan::{config::Cell, interlock::NO_CURRENT_A, plan::fixture_name};

/// Values that the instruments of a run read last.
#[derive(Debug, Default)]
pub(super) struct Measured {
    reading: Option<ReadingNow>,
    soc: Option<Soc>,
    /// Bounds of the readings in the present step.
    pub(super) bounds: Option<EnvelopeRow>,
}

impl Measured {
    /// Takes the next reading, with its fixture if known. The cell's data are those of the
    /// experiment if it can be read.
    pub(super) fn take(
        &mut self,
        row: &ReadingRow<'_>,
        fixture: Option<Fixture>,
        cell: Option<&Cell>,
    ) {
        let before = self.reading.take();
        let now = ReadingNow {
            time_s: row.time_s,
            phase: row.phase.to_owned(),
            fixture: fixture.map_or("cell", fixture_name).to_owned(),
            voltage_v: row.voltage_v,
            current_a: row.current_a,
            temperature_degc: row.temperature_degc,
            fresh: true,
        };
        let is_cell = fixture.is_none_or(|fixture| fixture == Fixture::Cell);
        if let Some(cell) = cell.filter(|_| is_cell) {
            self.count(&now, before.as_ref(), cell);
        }
        let kept_degc = before.as_ref().and_then(|before| before.temperature_degc);
        let (voltage_v, current_a) = match (now.voltage_v, now.current_a, &before) {
            // Some readings contain the temperature only. Values of another fixture do not apply
            // to this one.
            (None, None, Some(before)) if before.fixture == now.fixture => {
                (before.voltage_v, before.current_a)
            }
            (voltage_v, current_a, _) => (voltage_v, current_a),
        };
        self.reading = Some(ReadingNow {
            voltage_v,
            current_a,
            temperature_degc: now.temperature_degc.or(kept_degc),
            ..now
        });
    }

    /// The state of charge: from the voltage at rest, and from there on by the charge that was
    /// read. In a sweep no net charge flows, and its readings are means over a part of a period.
    fn count(&mut self, now: &ReadingNow, before: Option<&ReadingNow>, cell: &Cell) {
        let (Some(volts), Some(amps)) = (now.voltage_v, now.current_a) else {
            return;
        };
        let phase = now.phase.as_str();
        let rests = matches!(phase, "rest" | "idle" | "paused") && amps.abs() < NO_CURRENT_A.0;
        let curve = cell.ocv.as_ref().filter(|_| rests);
        if let Some(share) = curve.and_then(|curve| curve.soc_at(volts)) {
            self.soc = Some(Soc {
                share,
                counted_coulomb: 0.0,
            });
        } else if let (Some(soc), Some(before)) = (&mut self.soc, before)
            && phase != "sine"
            && before.phase == phase
        {
            let mean_a = 0.5 * (amps + before.current_a.unwrap_or(amps));
            let moved_coulomb = mean_a * (now.time_s - before.time_s);
            soc.share += moved_coulomb / cell.capacity_coulomb.value();
            soc.counted_coulomb += moved_coulomb;
        }
    }

    /// The last reading; `fresh_from_s` is the bench time, s, from which on one is fresh, where
    /// anything is.
    pub(super) fn reading(&self, fresh_from_s: Option<f64>) -> Option<ReadingNow> {
        let reading = self.reading.clone()?;
        Some(ReadingNow {
            fresh: fresh_from_s.is_some_and(|from_s| reading.time_s >= from_s),
            ..reading
        })
    }

    /// The state of charge, while the cell is in the jig.
    pub(super) fn soc(&self) -> Option<Soc> {
        self.soc
    }
}
