//! Switches the bipolar supply on at zero current, within limits that were read back, and off
//! again.

use analysis_files::run_folder::OUTPUT_ON;
use instruments::{
    fixture::Fixture,
    supply4q,
    units::{Amps, Volts},
};

use super::{ExecuteError, Executor, Rig, require};
use crate::{clock::TypedClock, record::Event};
use bench_plan::plan::{Depth, Step, fixture_name};

/// Number of readings whose mean is the zero of an ammeter: their noise counts as charge
/// throughout the sweep.
const ZERO_READINGS: u32 = 4;
/// Voltage below which a control stays with every output off, V: thermal voltages, and the zero
/// error of a meter. Any cell shows more.
const CONTROL_IDLE_V: Volts = Volts(0.2);

impl Rig<'_> {
    /// Records the set-point limits of a supply that accepts no voltage limit.
    async fn tell_own_limits(&mut self, limits: &supply4q::Limits) -> Result<(), ExecuteError> {
        let error = self.bench.error("supply4q");
        let supply = require(&mut self.bench.instruments.supply4q, "supply4q")?;
        if supply.capabilities().holds != supply4q::Holds::Nothing {
            return Ok(());
        }
        let Some(own) = supply.own_limits().await.map_err(error)? else {
            return Ok(());
        };
        let text = format!(
            "bipolar supply: takes no compliance and no current limit; its own set-point limits \
            are {} V to {} V, {} A to {} A",
            own.volts.0, own.volts.1, own.amps.0, own.amps.1
        );
        self.recorder.event(Event::Bench, &text)?;
        let wider = own.volts.1.max(-own.volts.0) > limits.compliance.value()
            || own.amps.1.max(-own.amps.0) > limits.current.value();
        if wider && !self.driving.unlimited_reported {
            self.driving.unlimited_reported = true;
            self.recorder.warning(&format!(
                "{text}: beyond the limits of this run only the \
            daemon's readings and a fuse hold it"
            ));
        }
        Ok(())
    }

    /// Returns the mean of some readings of the bipolar supply's ammeter, A, the first of which is
    /// `first_a`.
    pub(super) async fn mean_of_supply(&mut self, first_a: Amps) -> Result<Amps, ExecuteError> {
        let mut sum_a = first_a;
        for _ in 1..ZERO_READINGS {
            let error = self.bench.error("supply4q");
            sum_a += Amps(
                require(&mut self.bench.instruments.supply4q, "supply4q")?
                    .measure()
                    .await
                    .map_err(error)?
                    .1
                    .value(),
            );
        }
        Ok(sum_a / f64::from(ZERO_READINGS))
    }

    /// Reads the voltage at the jig with every output off, and returns an error if it is too large
    /// for a control or is not a number.
    pub(super) async fn refuse_a_cell(&mut self, what: &str) -> Result<(), ExecuteError> {
        let reading = self.read_supply4q().await?;
        self.recorder.reading("idle", &reading)?;
        let volts = reading.voltage_v.unwrap_or(Volts::NAN);
        if volts.abs() <= CONTROL_IDLE_V {
            Ok(())
        } else {
            Err(ExecuteError::CellLeftIn {
                what: what.to_owned(),
                volts,
            })
        }
    }

    pub(super) async fn power_down(&mut self) -> Result<(), ExecuteError> {
        self.driving.powered_a = None;
        self.driving.bias.cut(self.clock.now());
        Ok(self.bench.drive_off().await?)
    }
}

impl Executor<'_> {
    pub(super) async fn power(
        &mut self,
        fixture: Fixture,
        step: &Step,
    ) -> Result<(), ExecuteError> {
        let Step::PowerUp {
            compliance_v,
            limit_a,
            idle_a,
            depth,
            ..
        } = *step
        else {
            return Ok(());
        };
        self.rig.driving.powered_a = Some(limit_a);
        self.rig.driving.bias.cut(self.rig.clock.now());
        (self.rig.driving.first_mean, self.rig.driving.mean_change_a) = (None, Amps::ZERO);
        self.power_up(
            fixture,
            &supply4q::Limits {
                compliance: compliance_v,
                current: limit_a,
            },
            idle_a,
            depth,
        )
        .await
    }

    async fn power_up(
        &mut self,
        fixture: Fixture,
        limits: &supply4q::Limits,
        allowed_a: Amps,
        depth: Option<Depth>,
    ) -> Result<(), ExecuteError> {
        if self.rig.setup.wiring.analog.is_some() {
            self.rig.hold_zero().await?;
            self.read_idle(fixture).await?;
            self.deepen(depth).await?;
            self.rig.recorder.event(Event::OutputOn, OUTPUT_ON)?;
            let limit_a = limits.current.value();
            return self
                .test_analog(fixture, Amps(limit_a), allowed_a, depth)
                .await;
        }
        let error = self.rig.bench.error("generator");
        let offset = self.rig.setup.wiring.command_offset_v;
        let generator = require(&mut self.rig.bench.instruments.generator, "generator")?;
        generator.output(false).await.map_err(&error)?;
        generator.quiet(offset).await.map_err(&error)?;
        self.rig.no_burst();
        let error = self.rig.bench.error("supply4q");
        let supply = require(&mut self.rig.bench.instruments.supply4q, "supply4q")?;
        supply.prepare(limits).await.map_err(&error)?;
        self.rig.tell_own_limits(limits).await?;
        self.read_idle(fixture).await?;
        self.deepen(depth).await?;
        // The generator provides the offset that compensates the supply's zero error to zero
        // current before the output is switched on.
        let generator_error = self.rig.bench.error("generator");
        require(&mut self.rig.bench.instruments.generator, "generator")?
            .output(true)
            .await
            .map_err(generator_error)?;
        self.rig.recorder.event(Event::OutputOn, OUTPUT_ON)?;
        require(&mut self.rig.bench.instruments.supply4q, "supply4q")?
            .energise()
            .await
            .map_err(&error)?;
        let idle_a = self
            .rig
            .watch("idle", fixture)
            .await?
            .current_a
            .unwrap_or(Amps::ZERO);
        if idle_a.abs() > allowed_a {
            return Err(ExecuteError::Disobeyed {
                what: "bipolar supply with its command at zero".to_owned(),
                expected: format!("less than {allowed_a}"),
                met: format!("{idle_a:.3}: adjust wiring.command_offset"),
            });
        }
        Ok(())
    }

    /// Reads what is in the jig before the bipolar supply drives it: a cell must be within its
    /// limits, and a control must not be one.
    async fn read_idle(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        if fixture == Fixture::Cell {
            // A cell that is missing, reversed, damaged or too hot must not be driven: read it
            // while the output is still off.
            let mut reading = self.rig.read_supply4q().await?;
            reading.temperature_degc = self.rig.cell_temperature().await?;
            self.known.idle = reading;
            self.rig.judge("idle", reading)?;
            if let Some(amps) = reading.current_a {
                let zero_a = self.rig.mean_of_supply(amps).await?;
                self.rig.interlock.zero(zero_a);
                self.direct.ammeter_zero_a = zero_a;
            }
        } else {
            self.rig
                .refuse_a_cell(&format!("driving the {}", fixture_name(fixture)))
                .await?;
        }
        Ok(())
    }

    /// Sets the memory depth of the scope.
    async fn deepen(&mut self, depth: Option<Depth>) -> Result<(), ExecuteError> {
        let scope_error = self.rig.bench.error("scope");
        if let Some(depth) = depth {
            let scope = require(&mut self.rig.bench.instruments.scope, "scope")?;
            // If the scope cannot thin out its data before sending, limit the number of samples
            // that it takes.
            let memory_points = if scope.capabilities().thins_out {
                depth.memory_points
            } else {
                depth.record_points
            };
            scope
                .set(&instruments::scope::Intent::Session { memory_points })
                .await
                .map_err(scope_error)?;
            self.scope.memory_points = Some(memory_points);
        }
        Ok(())
    }
}
