//! Raw files → a checked experiment. Every complaint names file, line, field and what was expected.

use std::path::Path;

use analysis::{calibration::KnownImpedance, fit::Objective};
use instruments::{
    chiller, clock::TimeMode, generator, jig, load, logger, mock::plant::Fixture, scope, supply, supply4q, transport::Address,
};

use super::{
    Bench, Cell, ConfigError, ControlTolerance, Eis, Experiment, Fit, FixtureCheck, Instrument, Instruments, Jig, Simulation, SocReset,
    Source, Temperature, Wiring, raw,
};
use crate::interlock::Limits;

/// Highest order of the ERM that is fitted.
const MAX_RC: usize = 6;
/// How far below the end of a discharge the load stops by itself, V.
pub(crate) const LOAD_CUT_OFF_V: f64 = 0.05;
/// Samples per period below which a sinusoid is not to be believed.
const MIN_SAMPLES_PER_PERIOD: f64 = 8.0;

/// Reads an experiment with its bench (or another one in its place) and its cell.
///
/// # Errors
/// The first mistake, with file, line and field.
pub fn load_experiment(path: &Path, other_bench: Option<&Path>) -> Result<Experiment, ConfigError> {
    let source = Source::read(path)?;
    let raw: raw::Experiment = source.parse()?;
    if raw.name.is_empty() || !raw.name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_')) {
        return Err(source.complain("name", format!("expected a name of letters, digits, `-` and `_`, found {:?}", raw.name)));
    }
    let bench_path = other_bench.map_or_else(|| source.relative(&raw.bench), Path::to_owned);
    let bench_source =
        Source::read(&bench_path).map_err(|error| if other_bench.is_none() { in_field(&source, "bench", &error) } else { error })?;
    let bench = resolve_bench(&bench_source)?;
    let cell_source = Source::read(&source.relative(&raw.cell)).map_err(|error| in_field(&source, "cell", &error))?;
    let cell = resolve_cell(&cell_source)?;
    let check = Check { source: &source, bench_source: &bench_source, bench: &bench, cell: &cell };
    let temperature = raw.temperature.as_ref().map(|section| check.temperature(section)).transpose()?;
    let fixture_check = raw.fixture_check.as_ref().map(|section| check.fixture_check(section)).transpose()?;
    let soc_reset = raw.soc_reset.as_ref().map(|section| check.soc_reset(section)).transpose()?;
    let eis = check.eis(&raw.eis)?;
    let fit = check.fit(&raw.fit)?;
    Ok(Experiment {
        name: raw.name,
        seed: raw.seed,
        bench,
        cell,
        temperature,
        fixture_check,
        soc_reset,
        eis,
        fit,
        sources: vec![source, bench_source, cell_source],
    })
}

/// Reads a bench.
///
/// # Errors
/// As [`load_experiment`].
pub fn load_bench(path: &Path) -> Result<(Bench, Source), ConfigError> {
    let source = Source::read(path)?;
    Ok((resolve_bench(&source)?, source))
}

fn in_field(source: &Source, field: &str, error: &ConfigError) -> ConfigError {
    source.complain(field, error.to_string())
}

fn resolve_bench(source: &Source) -> Result<Bench, ConfigError> {
    let raw: raw::Bench = source.parse()?;
    let instruments = resolve_instruments(source, &raw.instruments)?;
    let wiring = &raw.wiring;
    if !(0.1..=10.0).contains(&wiring.command_trim) {
        return Err(source.complain("wiring.command_trim", format!("expected a factor from 0.1 to 10, found {}", wiring.command_trim)));
    }
    if !(1..=2).contains(&wiring.generator_channel) {
        return Err(source.complain("wiring.generator_channel", format!("expected 1 or 2, found {}", wiring.generator_channel)));
    }
    if wiring.scale_per_ampere.iter().any(|scale| scale.si <= 0.0) {
        return Err(source.complain("wiring.scale_per_ampere", "expected four voltages above zero"));
    }
    let simulation = raw.simulation.as_ref().map(|section| resolve_simulation(source, section, &instruments)).transpose()?;
    Ok(Bench {
        name: raw.name,
        instruments,
        wiring: Wiring {
            generator_channel: wiring.generator_channel,
            command_trim: wiring.command_trim,
            command_offset_v: wiring.command_offset.si,
            shunt: known(source, "wiring.shunt", &wiring.shunt)?,
            scale_per_ampere_v: wiring.scale_per_ampere.map(|scale| scale.si),
        },
        fake_cell: raw.controls.fake_cell.as_ref().map(|fake| known(source, "controls.fake_cell", fake)).transpose()?,
        simulation,
    })
}

fn resolve_simulation(source: &Source, raw: &raw::Simulation, instruments: &Instruments) -> Result<Simulation, ConfigError> {
    let in_process = instruments.addressed().iter().all(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }));
    let time = match &raw.time {
        Some(text) => text.parse::<TimeMode>().map_err(|error| source.complain("simulation.time", error.to_string()))?,
        None if in_process => TimeMode::Virtual,
        None => TimeMode::Real,
    };
    if time == TimeMode::Virtual && !in_process {
        return Err(
            source.complain("simulation.time", "virtual time jumps ahead of answers on real ports: it needs `memory:` addresses only")
        );
    }
    // On real instruments every wait would be too short by the factor.
    let elsewhere = instruments.addressed().into_iter().find(|(_, instrument)| !is_local(&instrument.address));
    if let (TimeMode::Scaled(_), Some((role, instrument))) = (time, elsewhere) {
        let reason = format!("scaled time is for mocks on this machine, and {role} is at {}", instrument.address);
        return Err(source.complain("simulation.time", reason));
    }
    Ok(Simulation { scenario: source.relative(&raw.scenario), time })
}

/// In this process, on the loopback interface, or on a pseudo-terminal.
fn is_local(address: &Address) -> bool {
    match address {
        Address::Memory { .. } => true,
        Address::Tcp { host, .. } => host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback()),
        Address::Serial(settings) => settings.path.starts_with("/dev/pts/"),
    }
}

fn known(source: &Source, field: &str, raw: &raw::Known) -> Result<KnownImpedance, ConfigError> {
    let (r_ohm, r_sigma_ohm) = (raw.resistance.si, raw.resistance_sigma.si);
    if !(r_ohm > 0.0 && r_ohm < 1.0) {
        return Err(
            source.complain(&format!("{field}.resistance"), format!("expected a resistance above 0 and below 1 Ω, found {r_ohm} Ω"))
        );
    }
    if !(r_sigma_ohm > 0.0 && r_sigma_ohm < r_ohm) {
        let reason = format!("expected a standard uncertainty above 0 and below the resistance, found {r_sigma_ohm} Ω");
        return Err(source.complain(&format!("{field}.resistance_sigma"), reason));
    }
    if raw.inductance_sigma.si < 0.0 || raw.inductance.si < 0.0 {
        return Err(
            source.complain(&format!("{field}.inductance"), "expected an inductance and its standard uncertainty, neither below zero")
        );
    }
    Ok(KnownImpedance { r_ohm, r_sigma_ohm, l_h: raw.inductance.si, l_sigma_h: raw.inductance_sigma.si })
}

fn resolve_instruments(source: &Source, raw: &raw::Instruments) -> Result<Instruments, ConfigError> {
    let resolve = |role: &str, instrument: &Option<raw::Instrument>, keys: &[&str]| {
        instrument.as_ref().map(|raw| resolve_instrument(source, role, (&raw.model, &raw.address), keys)).transpose()
    };
    let logger_keys: Vec<&str> = logger::DIALECTS.iter().map(|dialect| dialect.key()).collect();
    let logger = raw
        .logger
        .as_ref()
        .map(|raw| {
            resolve_instrument(source, "logger", (&raw.model, &raw.address), &logger_keys)
                .map(|instrument| (instrument, raw.cell_channel, raw.ambient_channel))
        })
        .transpose()?;
    let jig = raw.jig.as_ref().map(|raw| resolve_jig(source, raw)).transpose()?;
    Ok(Instruments {
        supply4q: resolve("supply4q", &raw.supply4q, &supply4q::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        generator: resolve("generator", &raw.generator, &generator::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        scope: resolve("scope", &raw.scope, &scope::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        load: resolve("load", &raw.load, &load::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        supply: resolve("supply", &raw.supply, &supply::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        chiller: resolve("chiller", &raw.chiller, &chiller::DIALECTS.iter().map(|d| d.key()).collect::<Vec<_>>())?,
        logger,
        jig,
    })
}

fn resolve_instrument(source: &Source, role: &str, (model, address): (&str, &str), keys: &[&str]) -> Result<Instrument, ConfigError> {
    if !keys.contains(&model) {
        let reason = format!("expected one of {}, found {model:?}", keys.join(", "));
        return Err(source.complain(&format!("instruments.{role}.model"), reason));
    }
    let address = address.parse().map_err(|error| source.complain(&format!("instruments.{role}.address"), format!("{error}")))?;
    Ok(Instrument { model: model.to_owned(), address })
}

fn resolve_jig(source: &Source, raw: &raw::Jig) -> Result<Jig, ConfigError> {
    match (raw.model.as_str(), &raw.address) {
        ("person", None) => Ok(Jig::Person),
        ("person", Some(_)) => Err(source.complain("instruments.jig.address", "a person has no address: leave it out")),
        (_, Some(address)) => resolve_instrument(source, "jig", (&raw.model, address), &[jig::MOCK_JIG]).map(Jig::Device),
        (_, None) => {
            let reason = format!("expected \"person\", or {:?} with an address, found {:?}", jig::MOCK_JIG, raw.model);
            Err(source.complain("instruments.jig.model", reason))
        }
    }
}

fn resolve_cell(source: &Source) -> Result<Cell, ConfigError> {
    let raw: raw::Cell = source.parse()?;
    let above = |field: &str, value: f64, bound: f64, what: &str| {
        (value > bound).then_some(()).ok_or_else(|| source.complain(field, format!("expected more than {what}, found {value}")))
    };
    above("capacity", raw.capacity.si, 0.0, "0")?;
    above("voltage_min", raw.voltage_min.si, 0.0, "0 V")?;
    above("voltage_max", raw.voltage_max.si, raw.voltage_min.si, "voltage_min")?;
    above("charge_current_max", raw.charge_current_max.si, 0.0, "0 A")?;
    above("discharge_current_max", raw.discharge_current_max.si, 0.0, "0 A")?;
    above("temperature_max", raw.temperature_max.si, raw.temperature_min.si, "temperature_min")?;
    if raw.voltage_max.si > 5.0 {
        return Err(source.complain("voltage_max", format!("expected one lithium cell, at most 5 V, found {} V", raw.voltage_max.si)));
    }
    if raw.pack.series == 0 || raw.pack.parallel == 0 {
        return Err(source.complain("pack", "expected at least one cell in series and one in parallel"));
    }
    Ok(Cell {
        name: raw.name,
        capacity_c: raw.capacity.si,
        limits: Limits {
            min_v: raw.voltage_min.si,
            max_v: raw.voltage_max.si,
            charge_a: raw.charge_current_max.si,
            discharge_a: raw.discharge_current_max.si,
            min_c: raw.temperature_min.si,
            max_c: raw.temperature_max.si,
        },
        series: raw.pack.series,
        parallel: raw.pack.parallel,
    })
}

/// Checks of the experiment's sections against bench and cell.
struct Check<'a> {
    source: &'a Source,
    bench_source: &'a Source,
    bench: &'a Bench,
    cell: &'a Cell,
}

impl Check<'_> {
    fn complain(&self, field: &str, reason: impl Into<String>) -> ConfigError {
        self.source.complain(field, reason)
    }

    fn within(&self, field: &str, value: f64, (least, greatest): (f64, f64), unit: &str) -> Result<f64, ConfigError> {
        if (least..=greatest).contains(&value) {
            return Ok(value);
        }
        Err(self.complain(field, format!("expected {least} {unit} to {greatest} {unit}, found {value} {unit}")))
    }

    /// A section of the experiment needs a role that the bench may lack.
    fn needs<'b, T>(&self, instrument: Option<&'b T>, role: &str, section: &str) -> Result<&'b T, ConfigError> {
        instrument.ok_or_else(|| {
            let reason = format!("expected a section [instruments.{role}]: [{section}] of {} needs it", self.source.path().display());
            self.bench_source.complain(&format!("instruments.{role}"), reason)
        })
    }

    fn temperature(&self, raw: &raw::TemperatureSection) -> Result<Temperature, ConfigError> {
        let chiller = self.needs(self.bench.instruments.chiller.as_ref(), "chiller", "temperature")?;
        self.needs(self.bench.instruments.logger.as_ref(), "logger", "temperature")?;
        let limits = &self.cell.limits;
        let range = chiller::DIALECTS.iter().find(|dialect| dialect.key() == chiller.model).map(|dialect| dialect.range());
        let (low, high) =
            range.map_or((limits.min_c, limits.max_c), |(low, high)| (low.value().max(limits.min_c), high.value().min(limits.max_c)));
        Ok(Temperature {
            setpoint_c: self.within("temperature.setpoint", raw.setpoint.si, (low, high), "°C")?,
            within_k: self.within("temperature.within", raw.within.si, (0.01, 5.0), "K")?,
            timeout_s: self.within("temperature.timeout", raw.timeout.si, (1.0, 86_400.0), "s")?,
        })
    }

    fn fixture_check(&self, raw: &raw::FixtureCheck) -> Result<FixtureCheck, ConfigError> {
        self.needs(self.bench.instruments.jig.as_ref(), "jig", "fixture_check")?;
        if raw.fake_cell.is_some() && self.bench.fake_cell.is_none() {
            let reason = "expected its impedance: [fixture_check.fake_cell] measures it as a control";
            return Err(self.bench_source.complain("controls.fake_cell", reason));
        }
        // The shunt first: no cell-like thing is clamped before the current path has been seen to work.
        let mut controls = Vec::new();
        for (fixture, name, tolerance) in
            [(Fixture::Shunt, "shunt", Some(&raw.shunt)), (Fixture::FakeCell, "fake_cell", raw.fake_cell.as_ref())]
        {
            let Some(tolerance) = tolerance else { continue };
            let field = |part: &str| format!("fixture_check.{name}.{part}");
            controls.push((
                fixture,
                ControlTolerance {
                    magnitude: self.within(&field("magnitude"), tolerance.magnitude.si, (1.0e-4, 0.5), "(share)")?,
                    phase_deg: self.within(&field("phase"), tolerance.phase.si, (0.01, 45.0), "°")?,
                },
            ));
        }
        let corrected_tolerance = self.within("fixture_check.corrected_tolerance", raw.corrected_tolerance.si, (1.0e-4, 0.1), "(share)")?;
        Ok(FixtureCheck { controls, corrected_tolerance })
    }

    fn soc_reset(&self, raw: &raw::SocReset) -> Result<SocReset, ConfigError> {
        let load = self.needs(self.bench.instruments.load.as_ref(), "load", "soc_reset")?;
        let supply = self.needs(self.bench.instruments.supply.as_ref(), "supply", "soc_reset")?;
        let limits = &self.cell.limits;
        let load_max = load::DIALECTS.iter().find(|d| d.key() == load.model).map_or(0.0, |d| d.capabilities().max_current.value());
        let supply_max = supply::DIALECTS.iter().find(|d| d.key() == supply.model).map_or(0.0, |d| d.capabilities().max_current.value());
        let window = (limits.min_v, limits.max_v);
        // The load's own cut-off lies between the end of the discharge and the cell's limit.
        let discharge_window = (limits.min_v + LOAD_CUT_OFF_V, limits.max_v);
        let reset = SocReset {
            discharge_a: self.within(
                "soc_reset.discharge_current",
                raw.discharge_current.si,
                (0.01, limits.discharge_a.min(load_max)),
                "A",
            )?,
            discharge_until_v: self.within("soc_reset.discharge_until", raw.discharge_until.si, discharge_window, "V")?,
            charge_a: self.within("soc_reset.charge_current", raw.charge_current.si, (0.01, limits.charge_a.min(supply_max)), "A")?,
            charge_limit_v: self.within("soc_reset.charge_voltage", raw.charge_voltage.si, window, "V")?,
            charge_until_v: self.within("soc_reset.charge_until", raw.charge_until.si, window, "V")?,
            rest_min_s: self.within("soc_reset.rest_min", raw.rest_min.si, (1.0, 86_400.0), "s")?,
            rest_max_s: self.within("soc_reset.rest_max", raw.rest_max.si, (raw.rest_min.si, 86_400.0), "s")?,
            rest_slope_v_per_s: self.within("soc_reset.rest_slope", raw.rest_slope.si, (1.0e-9, 1.0e-2), "V/s")?,
            max_s: self.within("soc_reset.max_duration", raw.max_duration.si, (1.0, 172_800.0), "s")?,
        };
        if reset.discharge_until_v >= reset.charge_until_v {
            let reason = format!("expected less than charge_until ({} V), found {} V", reset.charge_until_v, reset.discharge_until_v);
            return Err(self.complain("soc_reset.discharge_until", reason));
        }
        if reset.charge_until_v > reset.charge_limit_v {
            let reason = format!("expected at most charge_voltage ({} V), found {} V", reset.charge_limit_v, reset.charge_until_v);
            return Err(self.complain("soc_reset.charge_until", reason));
        }
        Ok(reset)
    }

    fn eis(&self, raw: &raw::Eis) -> Result<Eis, ConfigError> {
        let instruments = &self.bench.instruments;
        let supply4q = self.needs(instruments.supply4q.as_ref(), "supply4q", "eis")?;
        let generator = self.needs(instruments.generator.as_ref(), "generator", "eis")?;
        self.needs(instruments.scope.as_ref(), "scope", "eis")?;
        let generator_dialect = generator::DIALECTS.iter().find(|d| d.key() == generator.model);
        let (least_hz, greatest_hz) = generator_dialect.map_or((1.0e-3, 1.0e4), |d| {
            (d.capabilities().freq_range.0.value().max(1.0e-3), d.capabilities().freq_range.1.value().min(1.0e4))
        });
        let start_hz = self.within("eis.start", raw.start.si, (least_hz, greatest_hz), "Hz")?;
        let stop_hz = self.within("eis.stop", raw.stop.si, (start_hz, greatest_hz), "Hz")?;
        self.within("eis.points", raw.points as f64, (2.0, 1000.0), "points")?;
        if stop_hz <= start_hz {
            return Err(self.complain("eis.stop", format!("expected more than eis.start ({start_hz} Hz), found {stop_hz} Hz")));
        }
        let full_scale = supply4q::DIALECTS.iter().find(|d| d.key() == supply4q.model).map_or(0.0, |d| d.capabilities().full_scale.value());
        let greatest_a = full_scale.min(self.cell.limits.charge_a).min(self.cell.limits.discharge_a);
        let amplitude_a = self.within("eis.amplitude", raw.amplitude.si, (0.01, greatest_a), "A")?;
        let eis = Eis {
            freqs_hz: log_grid(start_hz, stop_hz, raw.points, raw.include_stop),
            amplitude_a,
            periods: self.within("eis.periods", raw.periods, (2.0, 10_000.0), "periods")?,
            extra_wait_s: self.within("eis.extra_wait", raw.extra_wait.si, (0.0, 3600.0), "s")?,
            periods_on_screen: self.within("eis.periods_on_screen", raw.periods_on_screen, (2.0, 1000.0), "periods")?,
            record_points: raw.record_points,
            memory_points: raw.memory_points,
        };
        self.within("eis.memory_points", raw.memory_points as f64, (1_000.0, 1.0e7), "points")?;
        // The 1–2–5 series of the time base can put 2.5 times the asked periods on the screen.
        let least_points = (MIN_SAMPLES_PER_PERIOD * 2.5 * eis.periods_on_screen).ceil();
        self.within("eis.record_points", raw.record_points as f64, (least_points, raw.memory_points as f64), "points")?;
        Ok(eis)
    }

    fn fit(&self, raw: &raw::Fit) -> Result<Fit, ConfigError> {
        if raw.rc.is_empty() || raw.rc.iter().any(|&rc| rc == 0 || rc > MAX_RC) {
            return Err(self.complain("fit.rc", format!("expected orders from 1 to {MAX_RC}, found {:?}", raw.rc)));
        }
        let objective: Objective = raw.objective.parse().map_err(|error| self.complain("fit.objective", format!("{error}")))?;
        Ok(Fit { rc: raw.rc.clone(), objective })
    }
}

/// `points` frequencies from `start_hz`, evenly spaced on a logarithmic axis, in whole microhertz so that a generator can set them exactly. With
/// `include_stop` the last is `stop_hz`; without, the grid is start·(stop/start)^(k/points), as in the thesis' own data.
fn log_grid(start_hz: f64, stop_hz: f64, points: usize, include_stop: bool) -> Vec<f64> {
    let intervals = if include_stop { points - 1 } else { points } as f64;
    (0..points).map(|k| (start_hz * (stop_hz / start_hz).powf(k as f64 / intervals) * 1.0e6).round() / 1.0e6).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_logarithmic_with_and_without_its_end() {
        let with = log_grid(0.1, 300.0, 20, true);
        assert_eq!((with.len(), with[0], with[19]), (20, 0.1, 300.0));
        let without = log_grid(0.1, 300.0, 20, false);
        assert!((without[19] - 201.031_999).abs() < 1.0e-6, "{}", without[19]);
        assert!((without[1] - 0.149_230).abs() < 1.0e-9);
    }
}
