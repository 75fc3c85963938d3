//! Checks the sections of an experiment against its bench and its cell, and rejects whatever the
//! bench cannot do or the cell must not bear.

use std::ops::RangeInclusive;

use analysis_fit::fit::{MAX_RC, Objective};
use analysis_signal::calibration::ControlTolerance;
use instruments::{
    chiller,
    fixture::Fixture,
    generator,
    instrument::by_key,
    load, scope, supply,
    units::{Amps, Celsius, Coulombs, Hertz, Kelvins, Seconds, Unit, Volts},
};

use super::{
    Acceptance, Bench, Cell, ConfigError, Eis, Fit, FixtureCheck, SocReset, Source, Temperature,
    Tolerance, raw,
};
use crate::mocks::HISTORY_S;

/// How far the end of a charge lies below the limit of the supply at least, V.
const CHARGE_MARGIN_V: Volts = Volts(0.02);
/// Greatest part of the capacity that half a period of a sine may move.
const MOST_SWING: f64 = 0.02;
/// Distance below the end of a discharge at which the load stops automatically, V.
pub const LOAD_CUT_OFF_V: Volts = Volts(0.05);
/// A frame on the simulated bench ends within this many periods before it is fetched.
const SIMULATED_SLACK_PERIODS: f64 = 3.0;
/// Number of samples per period below which a fitted sinusoid is unreliable.
const MIN_SAMPLES_PER_PERIOD: f64 = 8.0;
/// Rest before each sweep beside a direct current, if it is not stated, s: the charge of the sweep
/// before it has been brought back, but the voltage still relaxes.
const BIAS_REST_S: Seconds = Seconds(300.0);

/// Frequencies that the instruments of a sweep reach.
#[derive(Clone, Copy)]
struct Reach {
    /// Least that the generator sets.
    least_hz: Hertz,
    /// Greatest that the generator sets.
    greatest_hz: Hertz,
    /// Greatest that the supply follows, too.
    driven_hz: Hertz,
}

/// Refuses a sweep whose slowest frame a simulated bench would have discarded before it is
/// fetched.
pub fn check_frames(bench: &Bench, eis: &Eis) -> Result<(), String> {
    let scope = bench
        .instruments
        .scope
        .as_ref()
        .and_then(|scope| by_key(scope::DIALECTS, &scope.model));
    let (Some(scope), Some(slowest_hz), Some(_)) =
        (scope, eis.freqs_hz.first().copied(), &bench.simulation)
    else {
        return Ok(());
    };
    let capabilities = scope.capabilities();
    let screen_s =
        capabilities.time_per_div(eis.periods_on_screen / slowest_hz) * capabilities.horizontal_div;
    if screen_s + SIMULATED_SLACK_PERIODS / slowest_hz > Seconds(HISTORY_S) {
        return Err(format!(
            "expected a frame of at most {HISTORY_S} s, which is what the simulated bench \
            remembers, found {screen_s}"
        ));
    }
    Ok(())
}

/// Checks of the experiment's sections against bench and cell.
pub(super) struct Check<'a> {
    pub(super) source: &'a Source,
    pub(super) bench_source: &'a Source,
    pub(super) bench: &'a Bench,
    pub(super) cell: &'a Cell,
}

impl Check<'_> {
    pub(super) fn complain(&self, field: &str, reason: impl Into<String>) -> ConfigError {
        self.source.complain(field, reason)
    }

    pub(super) fn within<Q: Unit>(
        &self,
        field: &str,
        value: Q,
        range: RangeInclusive<Q>,
        unit: &str,
    ) -> Result<Q, ConfigError> {
        if range.contains(&value) {
            return Ok(value);
        }
        let (least, greatest) = (range.start().number(), range.end().number());
        let value = value.number();
        Err(self.complain(
            field,
            format!("expected {least} {unit} to {greatest} {unit}, found {value} {unit}"),
        ))
    }

    /// A section of the experiment needs a role that the bench may lack.
    pub(super) fn needs<'b, T>(
        &self,
        instrument: Option<&'b T>,
        role: &str,
        section: &str,
    ) -> Result<&'b T, ConfigError> {
        instrument.ok_or_else(|| {
            let reason = format!(
                "expected a section [instruments.{role}]: [{section}] of {} needs it",
                self.source.path().display()
            );
            self.bench_source
                .complain(&format!("instruments.{role}"), reason)
        })
    }

    /// Refuses a section that needs the ammeter of the bipolar supply.
    pub(super) fn refuse_analog(&self, field: &str) -> Result<(), ConfigError> {
        if self.bench.wiring.analog.is_none() {
            return Ok(());
        }
        let reason = "expected none: it needs a bipolar supply that measures its current, and \
        the bench has an analog one without a link";
        Err(self.complain(field, reason))
    }

    pub(super) fn temperature(
        &self,
        raw: &raw::TemperatureSection,
    ) -> Result<Temperature, ConfigError> {
        self.needs(
            self.bench.instruments.chiller.as_ref(),
            "chiller",
            "temperature",
        )?;
        self.needs(
            self.bench.instruments.logger.as_ref(),
            "logger",
            "temperature",
        )?;
        Ok(Temperature {
            setpoint_degc: self.within(
                "temperature.setpoint",
                Celsius(raw.setpoint.si),
                self.temperatures_of_bench(),
                "°C",
            )?,
            within_k: Kelvins(self.within("temperature.within", raw.within.si, 0.01..=5.0, "K")?),
            timeout_s: Seconds(self.within(
                "temperature.timeout",
                raw.timeout.si,
                1.0..=86_400.0,
                "s",
            )?),
        })
    }

    /// Returns the temperatures within the range of the chiller and the limits of the cell, °C.
    pub(super) fn temperatures_of_bench(&self) -> RangeInclusive<Celsius> {
        let (limits, chiller) = (&self.cell.limits, &self.bench.instruments.chiller);
        let range = chiller
            .as_ref()
            .and_then(|chiller| by_key(chiller::DIALECTS, &chiller.model))
            .map(|dialect| dialect.range());
        range.map_or(limits.min_degc..=limits.max_degc, |(low, high)| {
            low.max(limits.min_degc)..=high.min(limits.max_degc)
        })
    }

    pub(super) fn fixture_check(
        &self,
        raw: &raw::FixtureCheck,
    ) -> Result<FixtureCheck, ConfigError> {
        self.needs(self.bench.instruments.jig.as_ref(), "jig", "fixture_check")?;
        if raw.fake_cell.is_some() && self.bench.fake_cell.is_none() {
            let reason =
                "expected its impedance: [fixture_check.fake_cell] measures it as a control";
            return Err(self.bench_source.complain("controls.fake_cell", reason));
        }
        if raw.short.is_some() && self.bench.short.is_none() {
            let reason = "expected its impedance: [fixture_check.short] measures it as a control";
            return Err(self.bench_source.complain("controls.short", reason));
        }
        // The shunt first: no cell-like thing is clamped before the current path has been seen to
        // work.
        let mut controls = Vec::new();
        for (fixture, name, tolerance) in [
            (Fixture::Shunt, "shunt", Some(&raw.shunt)),
            (Fixture::FakeCell, "fake_cell", raw.fake_cell.as_ref()),
        ] {
            let Some(tolerance) = tolerance else { continue };
            let field = |part: &str| format!("fixture_check.{name}.{part}");
            controls.push((
                fixture,
                Tolerance::Relative(ControlTolerance {
                    magnitude_rel: self.within(
                        &field("magnitude"),
                        tolerance.magnitude.si,
                        1.0e-4..=0.5,
                        "(share)",
                    )?,
                    phase_deg: self.within(
                        &field("phase"),
                        tolerance.phase.si,
                        0.01..=45.0,
                        "°",
                    )?,
                }),
            ));
        }
        if let Some(short) = &raw.short {
            let error_ohm = self.within(
                "fixture_check.short.error",
                short.error.si,
                1.0e-7..=0.1,
                "Ω",
            )?;
            controls.push((Fixture::Short, Tolerance::Absolute(error_ohm)));
        }
        let corrected_tolerance = self.within(
            "fixture_check.corrected_tolerance",
            raw.corrected_tolerance.si,
            1.0e-4..=0.1,
            "(share)",
        )?;
        let driven_hz = self
            .bench
            .bipolar()
            .map_or(Hertz(1.0e5), |can| can.max_freq);
        let mut beyond_hz = Vec::new();
        for frequency in &raw.beyond {
            let asked_hz = microhertz(Hertz(frequency.si));
            if asked_hz > driven_hz {
                let model = self.bench.bipolar_model().unwrap_or_default();
                let reason = format!(
                    "expected at most {driven_hz}, up to which the bipolar supply {model} \
                    follows its command, found {asked_hz}"
                );
                return Err(self.complain("fixture_check.beyond", reason));
            }
            beyond_hz.push(self.within(
                "fixture_check.beyond",
                asked_hz,
                Hertz(1.0e-3)..=Hertz(1.0e5),
                "Hz",
            )?);
        }
        beyond_hz.sort_by(Hertz::total_cmp);
        beyond_hz.dedup();
        Ok(FixtureCheck {
            controls,
            corrected_tolerance,
            beyond_hz,
        })
    }

    pub(super) fn soc_reset(&self, raw: &raw::SocReset) -> Result<SocReset, ConfigError> {
        let load = self.needs(self.bench.instruments.load.as_ref(), "load", "soc_reset")?;
        let supply = self.needs(
            self.bench.instruments.supply.as_ref(),
            "supply",
            "soc_reset",
        )?;
        let limits = &self.cell.limits;
        let load_max = by_key(load::DIALECTS, &load.model)
            .map_or(Amps::ZERO, |d| d.capabilities().max_current);
        let supply_max = by_key(supply::DIALECTS, &supply.model)
            .map_or(Amps::ZERO, |d| d.capabilities().max_current);
        let window = limits.min_v..=limits.max_v;
        // The load's own cut-off lies between the end of the discharge and the cell's limit.
        let discharge_window = limits.min_v + LOAD_CUT_OFF_V..=limits.max_v;
        let reset = SocReset {
            discharge_a: self.within(
                "soc_reset.discharge_current",
                Amps(raw.discharge_current.si),
                Amps(0.01)..=limits.discharge_a.min(load_max),
                "A",
            )?,
            discharge_until_v: self.within(
                "soc_reset.discharge_until",
                Volts(raw.discharge_until.si),
                discharge_window,
                "V",
            )?,
            charge_a: self.within(
                "soc_reset.charge_current",
                Amps(raw.charge_current.si),
                Amps(0.01)..=limits.charge_a.min(supply_max),
                "A",
            )?,
            charge_limit_v: self.within(
                "soc_reset.charge_voltage",
                Volts(raw.charge_voltage.si),
                window.clone(),
                "V",
            )?,
            charge_until_v: self.within(
                "soc_reset.charge_until",
                Volts(raw.charge_until.si),
                window,
                "V",
            )?,
            rest_min_s: Seconds(self.within(
                "soc_reset.rest_min",
                raw.rest_min.si,
                1.0..=86_400.0,
                "s",
            )?),
            rest_max_s: Seconds(self.within(
                "soc_reset.rest_max",
                raw.rest_max.si,
                raw.rest_min.si..=86_400.0,
                "s",
            )?),
            rest_slope_v_per_s: self.within(
                "soc_reset.rest_slope",
                raw.rest_slope.si,
                1.0e-9..=1.0e-2,
                "V/s",
            )?,
            max_s: Seconds(self.within(
                "soc_reset.max_duration",
                raw.max_duration.si,
                1.0..=172_800.0,
                "s",
            )?),
            acceptance: self.acceptance(raw)?,
        };
        if reset.discharge_until_v >= reset.charge_until_v {
            let reason = format!(
                "expected less than charge_until ({} V), found {} V",
                reset.charge_until_v.0, reset.discharge_until_v.0
            );
            return Err(self.complain("soc_reset.discharge_until", reason));
        }
        if reset.charge_until_v > reset.charge_limit_v - CHARGE_MARGIN_V {
            let greatest = reset.charge_limit_v - CHARGE_MARGIN_V;
            let reason = format!(
                "expected at most {greatest:.3}, below charge_voltage where the current dies \
                away, found {} V",
                reset.charge_until_v.0
            );
            return Err(self.complain("soc_reset.charge_until", reason));
        }
        Ok(reset)
    }

    /// The band in which the voltage must come to rest, above the end of the discharge.
    fn acceptance(&self, raw: &raw::SocReset) -> Result<Option<Acceptance>, ConfigError> {
        let Some(band) = raw.rest_band else {
            return Ok(None);
        };
        let (low_v, high_v) = (band[0].si, band[1].si);
        let (least_v, greatest_v) = (raw.discharge_until.si, raw.charge_until.si);
        if !(least_v <= low_v && low_v < high_v && high_v <= greatest_v) {
            let reason = format!(
                "expected two rising voltages within {least_v} V to {greatest_v} V \
                (discharge_until to charge_until), found {low_v} V and {high_v} V"
            );
            return Err(self.complain("soc_reset.rest_band", reason));
        }
        let attempts = self
            .within(
                "soc_reset.attempts",
                raw.attempts as f64,
                1.0..=20.0,
                "times",
            )
            .map(|_| raw.attempts)?;
        Ok(Some(Acceptance {
            band_v: (Volts(low_v), Volts(high_v)),
            attempts,
            missed: raw.missed,
        }))
    }

    pub(super) fn eis(&self, raw: &raw::Eis) -> Result<Eis, ConfigError> {
        let instruments = &self.bench.instruments;
        let bipolar = self.bench.bipolar();
        self.needs(bipolar.as_ref(), "supply4q", "eis")?;
        let generator = self.needs(instruments.generator.as_ref(), "generator", "eis")?;
        self.needs(instruments.scope.as_ref(), "scope", "eis")?;
        if self.bench.wiring.analog.is_some() && instruments.load.is_none() {
            let reason = "expected a section [instruments.load]: an analog supply has no meter, and \
            the load's voltmeter watches the cell between the scope's records";
            return Err(self.bench_source.complain("instruments.load", reason));
        }
        let generator_dialect = by_key(generator::DIALECTS, &generator.model);
        let (least_hz, greatest_hz) = generator_dialect.map_or((1.0e-3, 1.0e4), |d| {
            (
                d.capabilities().freq_range.0.value().max(1.0e-3),
                d.capabilities().freq_range.1.value().min(1.0e4),
            )
        });
        let driven_hz = bipolar.map_or(greatest_hz, |capabilities| {
            capabilities.max_freq.value().min(greatest_hz)
        });
        let freqs_hz = self.frequencies(
            raw,
            Reach {
                least_hz: Hertz(least_hz),
                greatest_hz: Hertz(greatest_hz),
                driven_hz: Hertz(driven_hz),
            },
        )?;
        if raw.fixture == raw::SweptFixture::Shunt {
            self.needs(instruments.jig.as_ref(), "jig", "eis")?;
        }
        self.within("eis.repeat", raw.repeat as f64, 0.0..=1000.0, "sweeps")?;
        let full_scale = bipolar.map_or(Amps::ZERO, |capabilities| capabilities.full_scale);
        let greatest_a = full_scale
            .min(self.cell.limits.charge_a)
            .min(self.cell.limits.discharge_a);
        let amplitude_a = self.within(
            "eis.amplitude",
            Amps(raw.amplitude.si),
            Amps(0.01)..=greatest_a,
            "A",
        )?;
        if raw.fixture != raw::SweptFixture::Shunt {
            self.half_period("eis.start", &freqs_hz, amplitude_a)?;
        }
        let bias = self.eis_bias(raw)?;
        if bias.is_some() {
            self.refuse_analog("eis.bias")?;
        }
        let rest_s = if bias.is_some() {
            BIAS_REST_S
        } else {
            Seconds::ZERO
        };
        let eis = Eis {
            fixture: if raw.fixture == raw::SweptFixture::Shunt {
                Fixture::Shunt
            } else {
                Fixture::Cell
            },
            repeat: raw.repeat,
            rest_s: raw.rest_first.map_or(Ok(rest_s), |rest| {
                self.within(
                    "eis.rest_first",
                    Seconds(rest.si),
                    Seconds::ZERO..=Seconds(86_400.0),
                    "s",
                )
            })?,
            freqs_hz,
            amplitude_a,
            periods: self.within("eis.periods", raw.periods, 2.0..=10_000.0, "periods")?,
            extra_wait_s: Seconds(self.within(
                "eis.extra_wait",
                raw.extra_wait.si,
                0.0..=3600.0,
                "s",
            )?),
            periods_on_screen: self.within(
                "eis.periods_on_screen",
                raw.periods_on_screen,
                2.0..=1000.0,
                "periods",
            )?,
            record_points: raw.record_points,
            memory_points: raw.memory_points,
            mains_hz: raw
                .mains
                .as_ref()
                .map(|mains| {
                    self.within(
                        "eis.mains",
                        Hertz(mains.si),
                        Hertz(10.0)..=Hertz(1000.0),
                        "Hz",
                    )
                })
                .transpose()?,
            order: raw.order,
            steps_a: self.steps(raw, amplitude_a)?,
            compensate_drift: raw.compensate_drift,
            overlap: raw.overlap,
            quality: raw
                .quality
                .as_ref()
                .map(|quality| self.quality(quality, "eis"))
                .transpose()?,
            bias,
        };
        self.within(
            "eis.memory_points",
            raw.memory_points as f64,
            1_000.0..=1.0e7,
            "points",
        )?;
        // The 1–2–5 series of the time base can put 2.5 times the requested periods on the
        // screen.
        let least_points = (MIN_SAMPLES_PER_PERIOD * 2.5 * eis.periods_on_screen).ceil();
        self.within(
            "eis.record_points",
            raw.record_points as f64,
            least_points..=self.most_record_points().min(raw.memory_points as f64),
            "points",
        )?;
        self.check_grid(&eis)?;
        Ok(eis)
    }

    /// Greatest record of the scope: one that cannot thin out its memory before sending takes no
    /// more samples than it sends.
    fn most_record_points(&self) -> f64 {
        let scope = self.bench.instruments.scope.as_ref();
        let can = scope
            .and_then(|scope| by_key(scope::DIALECTS, &scope.model))
            .map(|dialect| dialect.capabilities());
        can.filter(|can| !can.thins_out)
            .map_or(f64::INFINITY, |can| can.most_points as f64)
    }

    /// Half a period of the slowest sine must not move the state of charge by much: amplitude/(π·f)
    /// against the capacity.
    fn half_period(
        &self,
        field: &str,
        freqs_hz: &[Hertz],
        amplitude_a: Amps,
    ) -> Result<(), ConfigError> {
        let freq_hz = freqs_hz.first().copied().unwrap_or(Hertz(1.0));
        let (moved_coulomb, most_coulomb) = (
            Coulombs(amplitude_a.value() / (std::f64::consts::PI * freq_hz.value())),
            MOST_SWING * self.cell.capacity_coulomb,
        );
        if moved_coulomb <= most_coulomb {
            return Ok(());
        }
        let reason = format!(
            "expected half a period to move at most {most_coulomb:.0} ({} % of the capacity), found \
            {moved_coulomb:.0}",
            100.0 * MOST_SWING
        );
        Err(self.complain(field, reason))
    }

    /// The amplitudes of a round, A; the channels' ranges hold the largest.
    fn steps(&self, raw: &raw::Eis, amplitude_a: Amps) -> Result<Vec<Amps>, ConfigError> {
        let Some(list) = &raw.amplitude_steps else {
            return Ok(vec![amplitude_a]);
        };
        let mut steps_a = Vec::new();
        for step in list {
            let (step_a, range_a) = (Amps(step.si), Amps(0.01)..=amplitude_a);
            steps_a.push(self.within("eis.amplitude_steps", step_a, range_a, "A")?);
        }
        let differ = steps_a
            .iter()
            .enumerate()
            .all(|(k, step)| !steps_a[..k].contains(step));
        if steps_a.is_empty() || !differ {
            let found: Vec<f64> = steps_a.iter().map(|step| step.value()).collect();
            return Err(self.complain(
                "eis.amplitude_steps",
                format!("expected amplitudes that differ, found {found:?} A"),
            ));
        }
        Ok(steps_a)
    }

    /// Returns the list as given, or the logarithmic grid, in rising order, between what the
    /// generator can set and what the supply can follow.
    fn frequencies(&self, raw: &raw::Eis, reach: Reach) -> Result<Vec<Hertz>, ConfigError> {
        let Reach {
            least_hz,
            greatest_hz,
            driven_hz,
        } = reach;
        match (&raw.frequencies, raw.start, raw.stop, raw.points) {
            (Some(list), None, None, None) => {
                let mut freqs_hz = Vec::new();
                for frequency in list {
                    freqs_hz.push(self.within(
                        "eis.frequencies",
                        microhertz(Hertz(frequency.si)),
                        least_hz..=driven_hz,
                        "Hz",
                    )?);
                }
                freqs_hz.sort_by(Hertz::total_cmp);
                self.within(
                    "eis.frequencies",
                    freqs_hz.len() as f64,
                    2.0..=1000.0,
                    "points",
                )?;
                Ok(freqs_hz)
            }
            (None, Some(start), Some(stop), Some(points)) => {
                let start_hz =
                    self.within("eis.start", Hertz(start.si), least_hz..=greatest_hz, "Hz")?;
                let stop_hz =
                    self.within("eis.stop", Hertz(stop.si), start_hz..=driven_hz, "Hz")?;
                self.within("eis.points", points as f64, 2.0..=1000.0, "points")?;
                if stop_hz <= start_hz {
                    return Err(self.complain(
                        "eis.stop",
                        format!("expected more than eis.start ({start_hz}), found {stop_hz}"),
                    ));
                }
                Ok(log_grid(start_hz, stop_hz, points, raw.include_stop))
            }
            _ => Err(self.complain(
                "eis",
                "expected start, stop and points, or frequencies, and not both",
            )),
        }
    }

    /// Checks that the frequencies differ when rounded to the generator's resolution, and that a
    /// simulated bench keeps the slowest frame long enough.
    fn check_grid(&self, eis: &Eis) -> Result<(), ConfigError> {
        if eis.freqs_hz.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(self.complain(
                "eis.points",
                "expected fewer points or a wider range: neighbouring \
                frequencies are the same microhertz",
            ));
        }
        check_frames(self.bench, eis).map_err(|reason| self.complain("eis.start", reason))
    }

    pub(super) fn fit(&self, raw: &raw::Fit, points: usize) -> Result<Fit, ConfigError> {
        if raw.rc.is_empty() || raw.rc.iter().any(|&rc| rc == 0 || rc > MAX_RC) {
            return Err(self.complain(
                "fit.rc",
                format!("expected orders from 1 to {MAX_RC}, found {:?}", raw.rc),
            ));
        }
        let distinct: std::collections::BTreeSet<usize> = raw.rc.iter().copied().collect();
        if distinct.len() != raw.rc.len() {
            return Err(self.complain(
                "fit.rc",
                format!("expected different orders, found {:?}", raw.rc),
            ));
        }
        let affordable = points.saturating_sub(1);
        if let Some(rc) = distinct.into_iter().find(|rc| *rc > affordable) {
            let reason = format!(
                "expected orders of at most {affordable} for {points} points, found {rc}: each has \
                2·rc + 1 parameters"
            );
            return Err(self.complain("fit.rc", reason));
        }
        let objective: Objective = raw
            .objective
            .parse()
            .map_err(|error| self.complain("fit.objective", format!("{error}")))?;
        Ok(Fit {
            rc: raw.rc.clone(),
            objective,
            refused_points: raw.refused_points,
        })
    }

    /// Returns the order of the model to diagnose; by default, the highest one that is fitted.
    pub(super) fn diagnosis(
        &self,
        raw: &raw::Diagnosis,
        fit: &Fit,
        eis: Option<&Eis>,
    ) -> Result<usize, ConfigError> {
        if !eis.is_some_and(|eis| eis.repeat > 0 && eis.fixture == Fixture::Cell) {
            return Err(self.complain(
                "diagnosis",
                "expected a sweep of the cell ([eis] with a \
            repeat above 0): the model comes from it",
            ));
        }
        if self.cell.ocv.is_none() {
            return Err(self.complain(
                "diagnosis",
                "expected a section [ocv] in the cell's file: a model \
                in time needs the voltage at rest",
            ));
        }
        let highest = fit.rc.iter().copied().max().unwrap_or(1);
        match raw.rc {
            None => Ok(highest),
            Some(rc) if fit.rc.contains(&rc) => Ok(rc),
            Some(rc) => Err(self.complain(
                "diagnosis.rc",
                format!(
                    "expected one of the orders of fit.rc, {:?}, found {rc}",
                    fit.rc
                ),
            )),
        }
    }
}

/// `points` frequencies from `start_hz`, evenly spaced on a logarithmic axis, in whole microhertz
/// so that a generator can set them exactly. With `include_stop` the last is `stop_hz`; without,
/// the grid is start·(stop/start)^(k/points), as in the thesis' own data.
fn log_grid(start_hz: Hertz, stop_hz: Hertz, points: usize, include_stop: bool) -> Vec<Hertz> {
    let intervals = if include_stop { points - 1 } else { points } as f64;
    (0..points)
        .map(|k| microhertz(start_hz * (stop_hz / start_hz).powf(k as f64 / intervals)))
        .collect()
}

/// Rounds to the generator's resolution.
fn microhertz(freq_hz: Hertz) -> Hertz {
    Hertz((freq_hz.value() * 1.0e6).round() / 1.0e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_logarithmic_with_and_without_its_end() {
        let with = log_grid(Hertz(0.1), Hertz(300.0), 20, true);
        assert_eq!(
            (with.len(), with[0], with[19]),
            (20, Hertz(0.1), Hertz(300.0))
        );
        let without = log_grid(Hertz(0.1), Hertz(300.0), 20, false);
        assert!(
            (without[19] - Hertz(201.031_999)).abs() < Hertz(1.0e-6),
            "{}",
            without[19].0
        );
        assert!((without[1] - Hertz(0.149_230)).abs() < Hertz(1.0e-9));
    }
}
