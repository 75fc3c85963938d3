//! Reads and judges the meters during each step: voltage, current, temperature and chiller,
//! against the allowance of the step.

use std::time::Duration;

use instruments::{
    fixture::Fixture,
    link::LinkError,
    units::{Amps, Celsius, Coulombs, Hertz, Seconds, Volts},
};

use super::{ExecuteError, POLL_S, Rig, require};
use crate::{clock::TypedClock, executor::thermostat::Action, watch::Envelope};
use bench_plan::{
    interlock::{Allowance, Drive, Limits, Mean, NO_CURRENT_A, Reading, ThermometerReadings, Trip},
    plan::{Flow, IDLE_CURRENT_A, Step},
};

/// Standard deviations that random noise does not exceed in a night of readings.
const CERTAIN: f64 = 5.0;
/// Share of the time between two readings of a multisine by which it differs at most, and the factor
/// whose multiples have well spread fractions.
const SPREAD: f64 = 0.4;
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Number of instruments that drive a current, and the bath.
const DRIVES: usize = 5;
/// Longest search for a cause before everything is switched off: five instruments answer within
/// half of this time.
const CAUSE: Duration = Duration::from_millis(500);
/// Number of pairs that must agree before a mean trips.
const PAIRS: usize = 2;
/// Longest usual duration of a reading, s.
const READ_S: Seconds = Seconds(0.2);
/// If a reading takes longer than this share of a period, its phase is unknown. With this
/// uncertainty, the mean for an amplitude of 1 A may be off by a third of its limit.
const UNSURE: f64 = 0.05;
/// Factor for the gain error of a meter in a step's envelope.
const METER_GAIN: f64 = 1.1;
/// The temperature is read with every n-th reading.
const TEMPERATURE_EVERY: u32 = 10;
/// Number of readings in a period above which each reading must differ from the previous one.
const FOLLOWED: f64 = 5.0;
/// Names of the currents of instruments that must carry none.
pub(super) const LOAD_CURRENT: &str = Drive::Load.current();
pub(super) const CHARGER_CURRENT: &str = Drive::Supply.current();
/// Amplitude below which the swing of the cell's voltage may be lost between two digits of a
/// voltmeter, A.
const SEEN_A: Amps = Amps(0.5);
/// Charge that a counted discharge may draw, as a multiple of the planned one.
const LONGER: f64 = 1.1;
/// Distance below the voltage limit of a supply within which its current falls and the voltage
/// stands still, V.
const HELD_V: Volts = Volts(0.1);
/// Distance of the supply's set voltage below the cell's greatest voltage, V.
pub(super) const BELOW_GREATEST_V: Volts = Volts(0.005);

impl Rig<'_> {
    /// Returns the limits of a step. Both the current and the charge that a step allows are far
    /// below what the cell could tolerate.
    pub(super) fn allowance(&self, fixture: Fixture, step: &Step) -> Allowance {
        let cell = self.setup.limits;
        let settings = &self.setup.interlock;
        let cell = if fixture == Fixture::Cell {
            cell
        } else {
            cell.of_control()
        };
        let drift_coulomb = settings.drift_coulomb;
        // The limit of the power-up applies until the power-down; each step in between may be
        // stricter.
        let powered = self
            .driving
            .powered_a
            .map_or(cell, |limit_a| cell.bounded(limit_a, limit_a));
        let idle = Allowance {
            cell: fixture == Fixture::Cell,
            ..Allowance::idle(cell.bounded(NO_CURRENT_A, NO_CURRENT_A))
        };
        let live = |limits, charge_coulomb| Allowance {
            limits,
            live: true,
            charge_coulomb,
            ..idle
        };
        // The charge in a piece of copper is not judged.
        let sweep_coulomb = |swing_coulomb: Coulombs| {
            if idle.cell {
                let most = drift_coulomb + swing_coulomb + self.driving.bias.unsure_coulomb();
                (-most, most)
            } else {
                idle.charge_coulomb
            }
        };
        let allowance = match *step {
            Step::Discharge { current_a, .. } => live(
                cell.bounded(NO_CURRENT_A, drawn(current_a)),
                (-settings.charge_coulomb, drift_coulomb),
            ),
            Step::Charge {
                current_a, limit_v, ..
            } => {
                let limits = cell.bounded(drawn(current_a), NO_CURRENT_A);
                Allowance {
                    held_v: limit_v - HELD_V,
                    ..live(limits, (-drift_coulomb, settings.charge_coulomb))
                }
            }
            Step::Leg(leg) => {
                let (charge_a, discharge_a) = leg.most_a();
                match leg.flow {
                    Flow::Discharge { .. } => live(
                        cell.bounded(NO_CURRENT_A, drawn(discharge_a)),
                        (-settings.charge_coulomb, drift_coulomb),
                    ),
                    // From a full cell at most; more has lost count.
                    Flow::DischargeTo {
                        below_full_coulomb, ..
                    } => live(
                        cell.bounded(NO_CURRENT_A, drawn(discharge_a)),
                        (
                            -settings
                                .charge_coulomb
                                .min(LONGER * below_full_coulomb + drift_coulomb),
                            drift_coulomb,
                        ),
                    ),
                    Flow::Charge { limit_v, .. } => Allowance {
                        held_v: limit_v - HELD_V,
                        ..live(
                            cell.bounded(drawn(charge_a), NO_CURRENT_A),
                            (-drift_coulomb, settings.charge_coulomb),
                        )
                    },
                    Flow::Rest => idle,
                }
            }
            Step::PowerUp { limit_a, .. } => live(
                cell.bounded(limit_a, limit_a),
                sweep_coulomb(Coulombs::ZERO),
            ),
            // Between power-up and power-down the charge accumulates. Half a period moves A/(πf).
            Step::Sine {
                freq_hz,
                amplitude_a,
                ..
            } => {
                let swing_coulomb =
                    Coulombs(amplitude_a.value() / (std::f64::consts::PI * freq_hz.value()));
                let bias = &self.driving.bias;
                let mean = mean(1.0 / freq_hz, amplitude_a).map(|mean| Mean {
                    around_a: bias.meter_a,
                    ..mean
                });
                let limits = drawn_within(
                    &powered,
                    bias.commanded_a - amplitude_a,
                    bias.commanded_a + amplitude_a,
                );
                Allowance {
                    continues: true,
                    swing_s: swing_s(freq_hz, amplitude_a),
                    mean,
                    ..live(limits, sweep_coulomb(swing_coulomb))
                }
            }
            Step::Multisine(ref band) => {
                let swing_coulomb =
                    Coulombs(band.peak_a.value() / (std::f64::consts::PI * band.base_hz.value()));
                let slowest_hz = band.base_hz
                    * band
                        .design
                        .harmonics
                        .first()
                        .map_or(1.0, |line| *line as f64);
                let swing_s = swing_s(slowest_hz, band.design.amplitude * band.peak_a);
                let bias = &self.driving.bias;
                let mean = multisine_mean(1.0 / band.base_hz, band.peak_a).map(|mean| Mean {
                    around_a: bias.meter_a,
                    ..mean
                });
                let limits = drawn_within(
                    &powered,
                    bias.commanded_a - band.peak_a,
                    bias.commanded_a + band.peak_a,
                );
                Allowance {
                    continues: true,
                    swing_s,
                    mean,
                    ..live(limits, sweep_coulomb(swing_coulomb))
                }
            }
            // A ramp begins and ends at the zero error of the drive.
            Step::Bias(ref bias) => Allowance {
                continues: true,
                ..live(
                    drawn_within(
                        &powered,
                        bias.from_a.min(bias.to_a).min(-IDLE_CURRENT_A),
                        bias.from_a.max(bias.to_a).max(IDLE_CURRENT_A),
                    ),
                    sweep_coulomb(Coulombs::ZERO),
                )
            },
            Step::Recharge(ref recharge) => Allowance {
                continues: true,
                ..live(
                    drawn_within(
                        &powered,
                        recharge.current_a.min(-IDLE_CURRENT_A),
                        recharge.current_a.max(IDLE_CURRENT_A),
                    ),
                    sweep_coulomb(Coulombs::ZERO),
                )
            },
            Step::PowerDown | Step::Recheck(_) => Allowance {
                continues: true,
                ..live(powered, idle.charge_coulomb)
            },
            Step::Trace(ref trace) => {
                let (least_a, greatest_a) = trace.extremes_a();
                let (least_coulomb, greatest_coulomb) = trace.swing_coulomb();
                let within = if trace.bipolar() { powered } else { cell };
                let limits = within.bounded(drawn(greatest_a), drawn(-least_a));
                let traced = live(
                    limits,
                    (
                        METER_GAIN * least_coulomb - drift_coulomb,
                        METER_GAIN * greatest_coulomb + drift_coulomb,
                    ),
                );
                let held_v = if trace.bipolar() {
                    traced.held_v
                } else {
                    cell.max_v - BELOW_GREATEST_V - HELD_V
                };
                Allowance { held_v, ..traced }
            }
            Step::HoldTemperature { .. } => Allowance {
                tempering: true,
                ..idle
            },
            Step::Specimen(_)
            | Step::Mount(_)
            | Step::Accept { .. }
            | Step::Pause { .. }
            | Step::BiasZero(_)
            | Step::Zero(_)
            | Step::Rest { .. } => idle,
        };
        Allowance {
            drives: step.drives(),
            ..allowance
        }
    }

    /// Applies the allowance of a step from now on.
    pub(super) fn begin(&mut self, fixture: Fixture, step: &Step) {
        let allowance = self.allowance(fixture, step);
        self.allow(allowance, step);
    }

    /// Applies an allowance from now on and records its limits in the run folder.
    pub(super) fn allow(&mut self, allowance: Allowance, step: &Step) {
        self.recorder.envelope(&allowance.limits);
        if let Some(watch) = &self.setup.watch {
            let envelope = Envelope::of(&allowance);
            watch.allow(match *step {
                // The command is zero: allow twice the zero error that the step accepts.
                Step::PowerUp { idle_a, .. } => envelope.at_most(drawn(2.0 * idle_a)),
                _ => envelope,
            });
        }
        self.interlock.begin(allowance, self.clock.machine());
    }

    /// Waits while reading and judging the bipolar supply; `phase` is recorded with the readings.
    pub(super) async fn wait_watching(
        &mut self,
        seconds: Seconds,
        phase: &str,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        let end_s = self.clock.now() + seconds;
        loop {
            let left_s = end_s - self.clock.now();
            if left_s <= Seconds::ZERO {
                return Ok(());
            }
            let poll_s = self.spread_share() * self.poll_s();
            self.clock.sleep_for(left_s.min(poll_s)).await;
            let reading = self.watch(phase, fixture).await?;
            self.watch_mean(reading, end_s - self.clock.now()).await?;
        }
    }

    /// Returns the share of the time between two readings that passes until the next. Readings of a
    /// multisine that are evenly apart can meet the same phase of it again and again, and then count a
    /// charge that does not flow; a share that differs from reading to reading spreads the phases.
    fn spread_share(&self) -> f64 {
        let meets_phases = self
            .interlock
            .allowed_mean()
            .is_some_and(|mean| mean.is_aliased());
        if meets_phases {
            // The fraction of an irrational multiple of the time in ms is as good as random.
            1.0 - SPREAD * (GOLDEN * 1.0e3 * self.clock.now().value()).fract()
        } else {
            1.0
        }
    }

    /// Returns the time until the next reading, s: a share of the period if a slow current is
    /// followed.
    pub(super) fn poll_s(&self) -> Seconds {
        self.interlock
            .allowed_mean()
            .map_or(POLL_S, |mean| mean.poll_s().min(POLL_S))
    }

    /// Takes and judges one reading of the bipolar supply.
    pub(super) async fn watch(
        &mut self,
        phase: &str,
        fixture: Fixture,
    ) -> Result<Reading, ExecuteError> {
        let mut reading = self.read_supply4q().await?;
        self.watching.watched_s = self.clock.now();
        self.recorder.reading(phase, &reading)?;
        if fixture != Fixture::Cell {
            // The cell lies beside the jig, possibly without its thermocouple.
            reading.temperature_degc = reading
                .temperature_degc
                .filter(|celsius| celsius.is_finite());
        }
        self.interlock
            .silent(self.clock.now() >= self.driving.burst.ends_s);
        self.driving
            .burst
            .over(&reading, self.driving.bias.meter_a)?;
        // A late answer belongs to another moment of the period.
        if self
            .interlock
            .allowed_mean()
            .is_some_and(|mean| self.watching.read_s > UNSURE * mean.period_s)
        {
            self.interlock.lose_period();
        }
        match self.interlock.judge(&reading, self.clock.machine()) {
            Some(trip) => {
                let trip = trip.because(self.cause().await);
                Err(if fixture == Fixture::Cell {
                    trip
                } else {
                    trip.of_control()
                }
                .into())
            }
            None => {
                if let Some(trip) = self.driving.bias.judge(reading.time_s) {
                    return Err(trip.into());
                }
                self.settle();
                self.look_back().await?;
                // The load was read as a voltmeter.
                self.others_off(&["supply4q", "load"]).await?;
                Ok(reading)
            }
        }
    }

    /// Checks, while current flows, whether the settings of the instruments that drive it are
    /// still those that this run made: one instrument with each reading, in turn.
    ///
    /// If there is a watch, it makes these checks instead.
    pub(super) async fn look_back(&mut self) -> Result<(), ExecuteError> {
        if self.setup.watch.is_some() {
            return Ok(());
        }
        for _ in 0..DRIVES {
            self.watching.looked = (self.watching.looked + 1) % DRIVES;
            if let Some(met) = self.differs(self.watching.looked).await? {
                return met;
            }
        }
        Ok(())
    }

    /// Returns the instrument whose settings are not those that this run made, if any. Queries it
    /// immediately, whatever else has happened, but only for a short time, because the excess
    /// current still flows.
    pub(super) async fn cause(&mut self) -> Option<String> {
        let clock = self.clock.clone();
        let asked = async {
            for number in 0..DRIVES {
                // The trip takes precedence over an instrument that does not answer now.
                if let Ok(Some(Err(meddled))) = self.differs(number).await {
                    return Some(meddled.to_string());
                }
            }
            None
        };
        clock.deadline(CAUSE, asked).await.ok().flatten()
    }

    /// Returns an error for a current that does not appear, with the cause if the instruments
    /// report one.
    pub(super) async fn explained(
        &mut self,
        followed: Result<(), ExecuteError>,
    ) -> Result<(), ExecuteError> {
        let Err(ExecuteError::Disobeyed {
            what,
            expected,
            met,
        }) = followed
        else {
            return followed;
        };
        let met = match self.cause().await {
            Some(cause) => format!("{met}: {cause}"),
            None => met,
        };
        Err(ExecuteError::Disobeyed {
            what,
            expected,
            met,
        })
    }

    /// Queries one of the instruments that drive a current; returns nothing if that instrument has
    /// received no settings.
    async fn differs(
        &mut self,
        number: usize,
    ) -> Result<Option<Result<(), ExecuteError>>, ExecuteError> {
        macro_rules! ask {
            ($role:literal, $field:ident) => {{
                let error = self.bench.error($role);
                let Some(instrument) = self
                    .bench
                    .instruments
                    .$field
                    .as_mut()
                    .filter(|instrument| instrument.has_settings())
                else {
                    return Ok(None);
                };
                let met = instrument.differs().await.map_err(error)?;
                Ok(Some(met.map_or(Ok(()), |met| {
                    Err(ExecuteError::Meddled { role: $role, met })
                })))
            }};
        }
        match number {
            0 => ask!("generator", generator),
            1 => ask!("supply4q", supply4q),
            2 => ask!("load", load),
            3 => ask!("supply", supply),
            _ => ask!("chiller", chiller),
        }
    }

    /// Judges the mean of a current of some hertz: takes a second reading, half a period after the
    /// first, if there is time for it.
    pub(super) async fn watch_mean(
        &mut self,
        first: Reading,
        left_s: Seconds,
    ) -> Result<(), ExecuteError> {
        let is_metered = self.bench.instruments.supply4q.is_some();
        let Some((mean, half_s)) = self
            .interlock
            .allowed_mean()
            .filter(|_| is_metered)
            .and_then(|mean| Some((mean, mean.pair_s()?)))
        else {
            return Ok(());
        };
        let end_s = self.clock.now() + left_s;
        let (mut one_a, mut one_s, mut one_took_s) = (
            first.current_a.unwrap_or(Amps::NAN),
            first.time_s,
            self.watching.read_s,
        );
        let mut trip = None;
        for _ in 0..PAIRS {
            let next_s = self.clock.now() + one_took_s - one_s;
            // A delay by whole periods is equivalent.
            let due_s = one_s
                + half_s
                + 2.0 * half_s * ((next_s - half_s) / (2.0 * half_s)).ceil().max(0.0);
            if due_s + 2.0 * READ_S > end_s {
                return Ok(());
            }
            self.clock
                .sleep_for((due_s - one_took_s - self.clock.now()).max(Seconds::ZERO))
                .await;
            let error = self.bench.error("supply4q");
            let asked_s = self.clock.now();
            let (_, other) = require(&mut self.bench.instruments.supply4q, "supply4q")?
                .measure()
                .await
                .map_err(error)?;
            let (other_s, took_s) = (self.clock.now(), self.clock.now() - asked_s);
            let unsure_s = (other_s - due_s).abs().max((took_s - one_took_s).abs());
            trip = mean.judge_pair(0.5 * (one_a + other), unsure_s, other_s);
            if trip.is_none() {
                return Ok(());
            }
            (one_a, one_s, one_took_s) = (other, other_s, took_s);
        }
        match trip {
            Some(trip) => Err(trip.because(self.cause().await).into()),
            None => Ok(()),
        }
    }

    /// Reads voltage and current of the cell. Without a link the bipolar supply shows no current:
    /// the load's voltmeter is the only meter, and the scope's records show the current.
    pub(super) async fn read_supply4q(&mut self) -> Result<Reading, ExecuteError> {
        let start_s = self.clock.now();
        let (mut volts, amps) = if self.setup.wiring.analog.is_some() {
            (Volts::NAN, None)
        } else {
            let (volts, amps) = self.read_drive(Drive::Supply4q).await?;
            (volts, Some(amps))
        };
        // The current was queried last.
        let time_s = self.clock.now();
        self.watching.read_s = time_s - start_s;
        // The supply's meter includes the voltage drop of its leads; the load, with its input off,
        // is a voltmeter at the jig.
        if self.bench.instruments.load.is_some() {
            let (seen, drawn_a) = self.read_drive(Drive::Load).await?;
            volts = seen;
            self.watching.shown_v = Some(seen);
            // As a voltmeter it draws no current.
            self.no_current(LOAD_CURRENT, drawn_a)?;
        }
        let temperature_degc = self.temperature_now_and_then().await?;
        Ok(Reading {
            time_s,
            voltage_v: Some(volts),
            current_a: amps,
            temperature_degc,
        })
    }

    /// Trips if a current flows through an instrument that is off.
    pub(super) fn no_current(&self, what: &'static str, amps: Amps) -> Result<(), ExecuteError> {
        if amps.abs() <= NO_CURRENT_A {
            return Ok(());
        }
        let allowed = -NO_CURRENT_A..=NO_CURRENT_A;
        Err(Trip::limit(what, amps, &allowed, self.clock.now()).into())
    }

    /// Checks everything that could drive a current through the cell while none may flow. Each
    /// instrument is judged separately, because two currents that cancel are two faults.
    pub(super) async fn watch_idle(
        &mut self,
        phase: &str,
        fixture: Fixture,
    ) -> Result<(), ExecuteError> {
        self.handle_request_within_step()?;
        if self.bench.instruments.supply4q.is_some() {
            self.watch(phase, fixture).await?;
        } else if self.bench.instruments.load.is_some() {
            let (volts, drawn_a) = self.load_volts().await?;
            self.no_current(LOAD_CURRENT, drawn_a)?;
            let temperature_degc = self.temperature_now_and_then().await?;
            self.judge(
                phase,
                Reading {
                    time_s: self.clock.now(),
                    voltage_v: Some(volts),
                    temperature_degc,
                    ..Reading::default()
                },
            )?;
        }
        self.others_off(&["supply4q", "load"]).await
    }

    /// Trips if a current flows through an instrument that the step does not use, whatever state
    /// its output reports. `used` lists the instruments that the step reads itself. Instruments
    /// that were checked less than a second ago are not queried again.
    ///
    /// If there is a watch, it makes these checks instead.
    pub(super) async fn others_off(&mut self, used: &[&str]) -> Result<(), ExecuteError> {
        if self.setup.watch.is_some() || self.clock.now() - self.watching.others_s < POLL_S {
            return Ok(());
        }
        self.watching.others_s = self.clock.now();
        for drive in Drive::ALL {
            if self.has_drive(drive) && !used.contains(&drive.role()) {
                let (_, amps) = self.read_drive(drive).await?;
                self.no_current(drive.current(), amps)?;
            }
        }
        Ok(())
    }

    fn has_drive(&self, drive: Drive) -> bool {
        let instruments = &self.bench.instruments;
        match drive {
            Drive::Supply4q => instruments.supply4q.is_some(),
            Drive::Load => instruments.load.is_some(),
            Drive::Supply => instruments.supply.is_some(),
        }
    }

    /// Reads voltage, V, and current, A, by a drive's own meter. A reading that the present step
    /// does not allow is repeated once, so that a single glitch of a meter does not decide.
    pub(super) async fn read_drive(&mut self, drive: Drive) -> Result<(Volts, Amps), ExecuteError> {
        let envelope = Envelope::of(self.interlock.allowance());
        let limits = *self.interlock.limits();
        let reads_cell = drive.reads_cell(self.bench.instruments.load.is_some());
        let (least_a, greatest_a) = envelope.amps(drive);
        let allowed = |(volts, amps): &(Volts, Amps)| {
            (least_a..=greatest_a).contains(amps)
                && (!reads_cell || (limits.min_v..=limits.max_v).contains(volts))
        };
        let error = self.bench.error(drive.role());
        let first = self.bench.read(drive).await?.map_err(&error)?;
        if allowed(&first) {
            return Ok(first);
        }
        let again = self.bench.read(drive).await?.map_err(error)?;
        let numbers = |(volts, amps): (Volts, Amps)| (volts.value(), amps.value());
        let (first, then) = (numbers(first), numbers(again));
        tracing::info!("{}: read {first:?}, then {then:?} V and A", drive.role());
        Ok(again)
    }

    /// Reads the cell's temperature with every tenth reading, or earlier if the last one grows
    /// old.
    pub(super) async fn temperature_now_and_then(
        &mut self,
    ) -> Result<Option<Celsius>, ExecuteError> {
        self.regulate().await?;
        self.check_stuck_meter().await?;
        self.watching.polls = self.watching.polls.wrapping_add(1);
        let due = self.watching.polls.is_multiple_of(TEMPERATURE_EVERY)
            || self.interlock.wants_temperature(self.clock.machine());
        if due {
            self.cell_temperature().await
        } else {
            Ok(None)
        }
    }

    /// Reads the cell's temperature; returns nothing on a bench without a logger. An open
    /// thermocouple gives a reading that is not a number, and trips. A chiller that was started is
    /// queried at the same time whether it still runs, and its own sensor is judged.
    pub(super) async fn cell_temperature(&mut self) -> Result<Option<Celsius>, ExecuteError> {
        self.regulate().await?;
        self.check_stuck_meter().await?;
        self.watch_chiller().await?;
        let error = self.bench.error("logger");
        let Some(logger) = self.bench.instruments.logger.as_mut() else {
            self.cross_check_bath().await?;
            return Ok(None);
        };
        if !self.temperatures.logger_ready {
            logger.configure().await.map_err(&error)?;
            self.temperatures.logger_ready = true;
        }
        let readings = logger.scan().await.map_err(error)?;
        let [cell_degc, air_degc] = [0, 1].map(|channel| readings.get(channel).copied().flatten());
        self.temperatures.last_degc = Some(cell_degc.unwrap_or(Celsius::NAN));
        let bath_degc = self.cross_check_bath().await?;
        self.judge_thermometers(ThermometerReadings {
            cell_degc,
            air_degc,
            bath_degc,
        })?;
        Ok(self.temperatures.last_degc)
    }

    pub(super) async fn watch_chiller(&mut self) -> Result<(), ExecuteError> {
        let error = self.bench.error("chiller");
        let Some(chiller) = self
            .bench
            .instruments
            .chiller
            .as_mut()
            .filter(|_| self.temperatures.chiller_runs)
        else {
            return Ok(());
        };
        let status = chiller.status().await.map_err(error)?;
        match self.interlock.chiller(&status, self.clock.now()) {
            Some(trip) => Err(trip.into()),
            None => Ok(()),
        }
    }

    /// Controls a bath that has no loop of its own: reads it once per window and sends a pulse. An
    /// implausible reading counts as none. A board that does not answer, or whose relays do not
    /// follow, is an error.
    pub(super) async fn regulate(&mut self) -> Result<(), ExecuteError> {
        let (error, now_s) = (self.bench.error("chiller"), self.clock.now());
        let Some(thermostat) = self
            .temperatures
            .thermostat
            .as_mut()
            .filter(|thermostat| thermostat.is_due(now_s))
        else {
            return Ok(());
        };
        let chiller = require(&mut self.bench.instruments.chiller, "chiller")?;
        let reading_degc = match chiller.temperature().await {
            Ok(celsius) => Some(celsius),
            Err(LinkError::Unexpected { .. }) => None,
            Err(failed) => return Err(error(failed).into()),
        };
        self.recorder
            .bath(reading_degc, self.temperatures.setpoint_degc);
        match thermostat.step(reading_degc, self.clock.now()) {
            Action::Pulse(seconds) => chiller.pulse(seconds.value()).await.map_err(error)?,
            Action::Fault(fault) => {
                chiller.pulse(0.0).await.map_err(error)?;
                return Err(Trip::Chiller {
                    message: fault.to_string(),
                    time_s: now_s,
                }
                .into());
            }
        }
        // The control loop itself judges the age of its last reading.
        match reading_degc {
            Some(celsius) => self.judge_bath(Some(celsius - self.setup.thermostat.sensor_offset_k)),
            None => Ok(()),
        }
    }

    /// Records a reading and judges it.
    pub(super) fn judge(&mut self, phase: &str, reading: Reading) -> Result<(), ExecuteError> {
        self.handle_request_within_step()?;
        self.recorder.reading(phase, &reading)?;
        match self.interlock.judge(&reading, self.clock.machine()) {
            Some(trip) => Err(trip.into()),
            None => {
                self.settle();
                Ok(())
            }
        }
    }

    /// Ends the allowance of the previous step, because a reading of the present step was within
    /// its limits.
    fn settle(&self) {
        if let Some(watch) = &self.setup.watch {
            watch.settle();
        }
    }
}

/// Returns the largest meter reading for a requested current, A, including gain and zero error.
pub(super) fn drawn(amps: Amps) -> Amps {
    METER_GAIN * amps + NO_CURRENT_A
}

/// Returns the limits of readings while the requested current lies between two values, A.
fn drawn_within(limits: &Limits, least_a: Amps, greatest_a: Amps) -> Limits {
    limits.bounded(
        drawn(greatest_a.max(Amps::ZERO)),
        drawn((-least_a).max(Amps::ZERO)),
    )
}

/// Returns the allowed mean of a sinusoid: the zero errors of supply and meter, and a share of its
/// amplitude.
fn mean(period_s: Seconds, amplitude_a: Amps) -> Option<Mean> {
    Some(Mean {
        period_s,
        around_a: Amps::ZERO,
        greatest_a: (METER_GAIN - 1.0) * amplitude_a + NO_CURRENT_A,
        amplitude_a: Some(amplitude_a),
    })
}

/// Returns the allowed mean of a multisine. Readings a second apart miss its faster lines, whose
/// effective value is at most about half of the peak.
fn multisine_mean(period_s: Seconds, peak_a: Amps) -> Option<Mean> {
    let missed_a = CERTAIN * 0.5 * peak_a * (POLL_S / period_s).sqrt();
    mean(period_s, peak_a).map(|mean| Mean {
        greatest_a: mean.greatest_a + missed_a,
        amplitude_a: None,
        ..mean
    })
}

/// Returns the period of a sinusoid whose readings must change, s, or `None` for a sinusoid that
/// is too fast or too small.
fn swing_s(freq_hz: Hertz, amplitude_a: Amps) -> Option<Seconds> {
    (freq_hz * FOLLOWED * POLL_S <= 1.0 && amplitude_a >= SEEN_A).then_some(1.0 / freq_hz)
}
