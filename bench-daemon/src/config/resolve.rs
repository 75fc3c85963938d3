//! Raw files → a checked experiment. Every complaint names file, line, field and what was expected.

use std::path::{Path, PathBuf};

use analysis::{
    calibration::{KnownImpedance, StrayAdmittance},
    ocv::OcvCurve,
};
use fixtures::Scenario;
use instruments::{
    chiller,
    clock::TimeMode,
    generator,
    instrument::{Model, by_key},
    jig, load, logger, scope, supply, supply4q,
    transport::Address,
};

use super::{
    Bench, Cell, ConfigError, Doctor, Experiment, Guardian, Instrument, Instruments, Jig, Simulation, Source, Wiring, check::Check, limits,
    raw, simulation,
};
use crate::{interlock::Limits, state::meet};

/// Reads an experiment with its bench (or another one in its place) and its cell.
///
/// # Errors
/// The first mistake, with file, line and field.
pub fn load_experiment(path: &Path, other_bench: Option<&Path>) -> Result<Experiment, ConfigError> {
    resolve_experiment(Source::read(path)?, other_bench)
}

/// As [`load_experiment`], from a file that was read, and with it from wherever that was read.
///
/// # Errors
/// As [`load_experiment`].
pub fn resolve_experiment(source: Source, other_bench: Option<&Path>) -> Result<Experiment, ConfigError> {
    let raw: raw::Experiment = source.parse()?;
    if raw.name.is_empty() || !raw.name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_')) {
        return Err(source.complain("name", format!("expected a name of letters, digits, `-` and `_`, found {:?}", raw.name)));
    }
    let bench_path = other_bench.map_or_else(|| source.relative(&raw.bench), Path::to_owned);
    let bench_source =
        source.open(&bench_path).map_err(|error| if other_bench.is_none() { in_field(&source, "bench", &error) } else { error })?;
    let bench = resolve_bench(&bench_source)?;
    check_one_world(&bench_source, &bench.instruments)?;
    let scenario_source = bench.simulation.as_ref().map(|section| read_scenario(&bench_source, &section.scenario)).transpose()?;
    let cell_source = source.open(&source.relative(&raw.cell)).map_err(|error| in_field(&source, "cell", &error))?;
    let cell = resolve_cell(&cell_source)?;
    let check = Check { source: &source, bench_source: &bench_source, bench: &bench, cell: &cell };
    let temperature = raw.temperature.as_ref().map(|section| check.temperature(section)).transpose()?;
    let fixture_check = raw.fixture_check.as_ref().map(|section| check.fixture_check(section)).transpose()?;
    let soc_reset = raw.soc_reset.as_ref().map(|section| check.soc_reset(section)).transpose()?;
    let ocv_soc = raw.ocv_soc.as_ref().map(|section| check.ocv_soc(section)).transpose()?;
    let eis = raw.eis.as_ref().map(|section| check.eis(section)).transpose()?;
    let multisine = raw.multisine.as_ref().map(|section| check.multisine(section)).transpose()?;
    if fixture_check.is_some() && eis.is_none() {
        let reason = "expected a section [eis], whose frequencies the controls are measured at; with repeat = 0 the cell is left out";
        return Err(source.complain("fixture_check", reason));
    }
    if let (Some(check), Some(eis)) = (&fixture_check, &eis)
        && let (Some(first), Some(last)) = (check.beyond_hz.first(), eis.freqs_hz.last())
        && first <= last
    {
        let reason = format!("expected frequencies beyond the sweep's last ({last} Hz), found {first} Hz");
        return Err(source.complain("fixture_check.beyond", reason));
    }
    let (traces, trace_sources) = check.traces(&raw.traces)?;
    let campaign = raw.campaign.as_ref().map(|section| check.campaign(section, (eis.as_ref(), &traces))).transpose()?;
    if campaign.is_some() && (ocv_soc.is_some() || multisine.is_some()) {
        return Err(source.complain("campaign", "expected [campaign] without [ocv_soc] and [multisine]: its runs are sweeps and traces"));
    }
    if eis.as_ref().is_none_or(|eis| eis.repeat == 0) && traces.is_empty() && ocv_soc.is_none() && multisine.is_none() {
        let reason = "expected a section [eis] with a repeat above 0, or a section [[traces]], [ocv_soc] or [multisine]";
        return Err(source.complain("(whole file)", reason));
    }
    let fit = check.fit(&raw.fit, eis.as_ref().map_or(usize::MAX, |eis| eis.freqs_hz.len()))?;
    let diagnosed_rc = raw.diagnosis.as_ref().map(|section| check.diagnosis(section, &fit, eis.as_ref())).transpose()?;
    Ok(Experiment {
        name: raw.name,
        seed: raw.seed,
        bench,
        cell,
        temperature,
        fixture_check,
        soc_reset,
        ocv_soc,
        eis,
        multisine,
        campaign,
        traces,
        fit,
        diagnosed_rc,
        sources: [source, bench_source, cell_source].into_iter().chain(scenario_source).chain(trace_sources).collect(),
    })
}

/// The scenario of a simulated bench, checked.
fn read_scenario(bench: &Source, path: &Path) -> Result<Source, ConfigError> {
    let source = bench.open(path).map_err(|error| in_field(bench, "simulation.scenario", &error))?;
    let scenario: Scenario = source.parse()?;
    scenario.validate().map_err(|error| source.complain(&error.field, error.to_string()))?;
    Ok(source)
}

/// Reads a bench.
///
/// # Errors
/// As [`load_experiment`].
pub fn load_bench(path: &Path) -> Result<(Bench, Source), ConfigError> {
    let source = Source::read(path)?;
    Ok((resolve_bench(&source)?, source))
}

/// Reads a bench, or the one that an experiment names.
///
/// # Errors
/// As [`load_experiment`].
pub fn load_any_bench(path: &Path) -> Result<Bench, ConfigError> {
    #[derive(serde::Deserialize)]
    struct Either {
        bench: Option<String>,
    }
    let source = Source::read(path)?;
    match source.parse::<Either>()?.bench {
        Some(bench) => Ok(load_bench(&source.relative(&bench)).map_err(|error| in_field(&source, "bench", &error))?.0),
        None => resolve_bench(&source),
    }
}

fn in_field(source: &Source, field: &str, error: &ConfigError) -> ConfigError {
    source.complain(field, error.to_string())
}

fn resolve_bench(source: &Source) -> Result<Bench, ConfigError> {
    let raw: raw::Bench = source.parse()?;
    let instruments = resolve_instruments(source, &raw.instruments)?;
    check_addresses(source, &instruments)?;
    let wiring = &raw.wiring;
    if !(0.1..=10.0).contains(&wiring.command_trim) {
        return Err(source.complain("wiring.command_trim", format!("expected a factor from 0.1 to 10, found {}", wiring.command_trim)));
    }
    // What it makes flow into the cell when the output goes on, before anything is read.
    if !(-MOST_OFFSET_V..=MOST_OFFSET_V).contains(&wiring.command_offset.si) {
        let reason =
            format!("expected {} V to {MOST_OFFSET_V} V, the zero error of a supply, found {} V", -MOST_OFFSET_V, wiring.command_offset.si);
        return Err(source.complain("wiring.command_offset", reason));
    }
    if !(1..=2).contains(&wiring.generator_channel) {
        return Err(source.complain("wiring.generator_channel", format!("expected 1 or 2, found {}", wiring.generator_channel)));
    }
    if wiring.scale_per_ampere.iter().any(|scale| scale.si <= 0.0) {
        return Err(source.complain("wiring.scale_per_ampere", "expected four voltages above zero"));
    }
    let simulation = raw.simulation.as_ref().map(|section| resolve_simulation(source, section, &instruments)).transpose()?;
    let state_folder = state_folder(source, &raw);
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
        short: raw.controls.short.as_ref().map(|short| known(source, "controls.short", short)).transpose()?,
        open: raw.controls.open.as_ref().map(|open| stray(source, open)).transpose()?,
        simulation,
        history: raw.history,
        path: source.path().to_owned(),
        state_folder,
        guardian: resolve_guardian(source, &raw.guardian)?,
        thermostat: simulation::thermostat(source, &raw.thermostat)?,
        doctor: resolve_doctor(source, &raw.doctor)?,
    })
}

/// As it is typed, or beside the bench file and called after the bench.
fn state_folder(source: &Source, raw: &raw::Bench) -> PathBuf {
    raw.state_folder.as_ref().map_or_else(
        || {
            let plain = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' };
            source.relative(".eis-bench").join(raw.name.chars().map(plain).collect::<String>())
        },
        |folder| source.relative(folder),
    )
}

/// Lease and stall unless they are typed, s.
const GUARDIAN: (f64, f64) = (5.0, 20.0);

fn resolve_guardian(source: &Source, raw: &raw::Guardian) -> Result<Guardian, ConfigError> {
    let within = |field: &str, value: f64, (least, greatest): (f64, f64)| {
        let reason = || format!("expected {least} s to {greatest} s, found {value} s");
        (least..=greatest).contains(&value).then_some(value).ok_or_else(|| source.complain(&format!("guardian.{field}"), reason()))
    };
    Ok(Guardian {
        lease_s: within("lease", raw.lease.map_or(GUARDIAN.0, |lease| lease.si), (1.0, 600.0))?,
        stall_s: within("stall", raw.stall.map_or(GUARDIAN.1, |stall| stall.si), (1.0, 600.0))?,
    })
}

/// A report of the doctor is valid for so long unless that is typed, s.
const DOCTOR_VALID_S: f64 = 90.0 * 86_400.0;

fn resolve_doctor(source: &Source, raw: &raw::Doctor) -> Result<Doctor, ConfigError> {
    let valid_for_s = raw.valid_for.map_or(DOCTOR_VALID_S, |span| span.si);
    if valid_for_s <= 0.0 {
        return Err(source.complain("doctor.valid_for", format!("expected a duration above 0 s, found {valid_for_s} s")));
    }
    Ok(Doctor { required: raw.required, valid_for_s })
}

/// What the open jig may leak at most; the leak itself is anything from nothing to that.
fn stray(source: &Source, raw: &raw::Open) -> Result<StrayAdmittance, ConfigError> {
    let (least_ohm, greatest_f) = (raw.resistance_min.si, raw.capacitance_max.si);
    if least_ohm <= 0.0 {
        return Err(source.complain("controls.open.resistance_min", format!("expected a resistance above 0 Ω, found {least_ohm} Ω")));
    }
    if greatest_f < 0.0 {
        return Err(
            source.complain("controls.open.capacitance_max", format!("expected a capacitance of 0 F or more, found {greatest_f} F"))
        );
    }
    Ok(StrayAdmittance::within(least_ohm, greatest_f))
}

/// One client at a time, one instrument at an address, one connection to a GPIB adapter.
fn check_addresses(source: &Source, instruments: &Instruments) -> Result<(), ConfigError> {
    let addressed = instruments.addressed();
    let mut seen: Vec<(&str, &Address)> = Vec::new();
    for (role, instrument) in &addressed {
        let field = format!("instruments.{role}.address");
        if let Some((other, _)) = seen.iter().find(|(_, address)| *address == &instrument.address) {
            return Err(source.complain(&field, format!("expected an address of its own, found that of {other}: {}", instrument.address)));
        }
        if let Some(other) = seen.iter().find_map(|(other, address)| shares_adapter(address, &instrument.address).then_some(other)) {
            let reason = format!("expected a GPIB adapter of its own, found that of {other}: an adapter takes one connection");
            return Err(source.complain(&field, reason));
        }
        seen.push((role, &instrument.address));
    }
    Ok(())
}

fn shares_adapter(one: &Address, other: &Address) -> bool {
    matches!((one, other), (Address::Gpib { .. }, Address::Gpib { .. })) && meet(one, other)
}

/// The built-in mocks are a whole bench or none: they share one simulated world.
fn check_one_world(source: &Source, instruments: &Instruments) -> Result<(), ConfigError> {
    let in_process = |address: &Address| matches!(address, Address::Memory { .. });
    let addressed = instruments.addressed();
    let first = addressed.first().is_some_and(|(_, instrument)| in_process(&instrument.address));
    match addressed.iter().find(|(_, instrument)| in_process(&instrument.address) != first) {
        None => Ok(()),
        Some((role, _)) => {
            let reason = "expected all instruments in this process (`memory:`) or none of them: they share one simulated bench";
            Err(source.complain(&format!("instruments.{role}.address"), reason))
        }
    }
}

/// Greatest offset of the command, V: with the usual 2 A per volt it is an ampere.
const MOST_OFFSET_V: f64 = 0.5;

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
    let faults = raw.faults.as_ref().map(|faults| simulation::faults(source, faults)).transpose()?;
    let quirks = simulation::quirks(source, &raw.quirks, instruments)?;
    Ok(Simulation { scenario: source.relative(&raw.scenario), time, faults, quirks })
}

/// In this process, on the loopback interface, on a pseudo-terminal, or a socket in the place of a device's file.
pub(super) fn is_local(address: &Address) -> bool {
    match (address, address.host(), address.path()) {
        (_, Some(host), _) => {
            host == "localhost" || host.trim_matches(['[', ']']).parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
        }
        (Address::UsbTmc { .. }, _, Some(path)) => !path.starts_with("/dev/"),
        (_, _, Some(path)) => path.starts_with("/dev/pts/"),
        (_, None, None) => true,
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
        let resolve = |raw: &raw::Instrument| {
            let resolved = resolve_instrument(source, role, (&raw.model, &raw.address), keys)?;
            Ok(Instrument { accept: raw.accept.clone(), ..resolved })
        };
        instrument.as_ref().map(resolve).transpose()
    };
    let logger = raw
        .logger
        .as_ref()
        .map(|raw| {
            let instrument = resolve_instrument(source, "logger", (&raw.model, &raw.address), &keys(logger::DIALECTS))?;
            let dialect = by_key(logger::DIALECTS, &raw.model);
            for (field, channel) in [("cell_channel", Some(raw.cell_channel)), ("ambient_channel", raw.ambient_channel)] {
                if let Some(channel) = channel.filter(|channel| dialect.is_some_and(|dialect| !dialect.has_channel(*channel))) {
                    let reason = format!("expected a channel that a {} has (one input is channel 1), found {channel}", raw.model);
                    return Err(source.complain(&format!("instruments.logger.{field}"), reason));
                }
            }
            if raw.ambient_channel == Some(raw.cell_channel) {
                return Err(source.complain("instruments.logger.ambient_channel", "expected another channel than the cell's, or none"));
            }
            Ok((Instrument { accept: raw.accept.clone(), ..instrument }, raw.cell_channel, raw.ambient_channel))
        })
        .transpose()?;
    let jig = raw.jig.as_ref().map(|raw| resolve_jig(source, raw)).transpose()?;
    Ok(Instruments {
        supply4q: resolve("supply4q", &raw.supply4q, &keys(supply4q::DIALECTS))?,
        generator: resolve("generator", &raw.generator, &keys(generator::DIALECTS))?,
        scope: resolve("scope", &raw.scope, &keys(scope::DIALECTS))?,
        load: resolve("load", &raw.load, &keys(load::DIALECTS))?,
        supply: resolve("supply", &raw.supply, &keys(supply::DIALECTS))?,
        chiller: resolve("chiller", &raw.chiller, &keys(chiller::DIALECTS))?,
        logger,
        jig,
    })
}

/// The names of a role's models.
fn keys<D: Model + ?Sized>(dialects: &[&'static D]) -> Vec<&'static str> {
    dialects.iter().map(|dialect| dialect.key()).collect()
}

fn resolve_instrument(source: &Source, role: &str, (model, address): (&str, &str), keys: &[&str]) -> Result<Instrument, ConfigError> {
    if !keys.contains(&model) {
        let reason = format!("expected one of {}, found {model:?}", keys.join(", "));
        return Err(source.complain(&format!("instruments.{role}.model"), reason));
    }
    let address = address.parse().map_err(|error| source.complain(&format!("instruments.{role}.address"), format!("{error}")))?;
    Ok(Instrument { model: model.to_owned(), address, accept: None })
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
    let curve = |ocv: raw::Ocv| {
        OcvCurve::monotone(raw.capacity.si / 3600.0, ocv.soc, ocv.voltage_v).map_err(|error| source.complain("ocv", error.to_string()))
    };
    let ocv = raw.ocv.map(curve).transpose()?;
    let cell = Cell {
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
        interlock: raw.interlock.resolve(source, raw.capacity.si)?,
        series: raw.pack.series,
        parallel: raw.pack.parallel,
        ocv,
        wide: Vec::new(),
    };
    raw.absolute.check(source, &cell)?;
    Ok(Cell { wide: limits::wide(&cell), ..cell })
}
