//! A bench file → a checked bench. Every error names file, line, field and what was expected.

use std::path::{Path, PathBuf};

use analysis_signal::calibration::{KnownImpedance, StrayAdmittance};
use instruments::{
    chiller,
    clock::TimeMode,
    generator,
    instrument::{Model, by_key},
    jig, load, logger, scope, supply,
    transport::Address,
    units::{Seconds, Volts},
};

use super::{
    Bench, ConfigError, Doctor, Guardian, Instrument, Instruments, Jig, Simulation, Source, Wiring,
    bench::{ANSWER_S, is_local},
    raw_bench,
    schema::Kind,
    simulation,
    source::in_field,
    supply4q,
};
use crate::support::{addresses::meet, hash};

/// Reads a bench.
///
/// # Errors
/// As [`super::load_experiment`].
pub fn load_bench(path: &Path) -> Result<(Bench, Source), ConfigError> {
    let source = Source::read(path)?;
    Ok((resolve_bench(&source)?, source))
}

/// Reads a bench, or the one that an experiment names.
///
/// # Errors
/// As [`super::load_experiment`].
pub fn load_any_bench(path: &Path) -> Result<Bench, ConfigError> {
    #[derive(serde::Deserialize)]
    struct Either {
        bench: Option<String>,
    }
    let source = Source::read(path)?;
    match source.parse::<Either>()?.bench {
        Some(bench) => Ok(load_bench(&source.relative(&bench))
            .map_err(|error| in_field(&source, "bench", &error))?
            .0),
        None => resolve_bench(&source),
    }
}

/// A bench, checked.
pub fn resolve_bench(source: &Source) -> Result<Bench, ConfigError> {
    let raw: raw_bench::Bench = source.parse_as(Kind::Bench)?;
    let bipolar = supply4q::resolve(source, raw.instruments.supply4q.as_ref())?;
    let volts_per_amp = bipolar.volts_per_amp();
    let instruments = resolve_instruments(source, &raw.instruments, bipolar.linked)?;
    check_addresses(source, &instruments)?;
    let wiring = &raw.wiring;
    if !(0.1..=10.0).contains(&wiring.command_trim) {
        return Err(source.complain(
            "wiring.command_trim",
            format!(
                "expected a factor from 0.1 to 10, found {}",
                wiring.command_trim
            ),
        ));
    }
    // The offset drives a current into the cell as soon as the output is on, before any reading.
    let most_v = most_offset_v(volts_per_amp);
    if !(-most_v..=most_v).contains(&Volts(wiring.command_offset.si)) {
        let reason = format!(
            "expected {} V to {most_v}, the zero error of a supply, found {} V",
            (-most_v).0,
            wiring.command_offset.si
        );
        return Err(source.complain("wiring.command_offset", reason));
    }
    if !(1..=2).contains(&wiring.generator_channel) {
        return Err(source.complain(
            "wiring.generator_channel",
            format!("expected 1 or 2, found {}", wiring.generator_channel),
        ));
    }
    if wiring.scale_per_ampere.iter().any(|scale| scale.si <= 0.0) {
        return Err(source.complain(
            "wiring.scale_per_ampere",
            "expected four voltages above zero",
        ));
    }
    let simulation = raw
        .simulation
        .as_ref()
        .map(|section| resolve_simulation(source, section, &instruments))
        .transpose()?;
    let state_folder = state_folder(source, &raw);
    Ok(Bench {
        name: raw.name,
        sha256: hash::sha256(source.text()),
        instruments,
        wiring: Wiring {
            generator_channel: wiring.generator_channel,
            analog: bipolar.analog,
            volts_per_amp,
            command_trim: wiring.command_trim,
            command_offset_v: Volts(wiring.command_offset.si),
            bursts: wiring.bursts.unwrap_or(true),
            shunt: known(source, "wiring.shunt", &wiring.shunt)?,
            scale_per_ampere_v: wiring.scale_per_ampere.map(|scale| scale.si),
        },
        fake_cell: raw
            .controls
            .fake_cell
            .as_ref()
            .map(|fake| known(source, "controls.fake_cell", fake))
            .transpose()?,
        short: raw
            .controls
            .short
            .as_ref()
            .map(|short| known(source, "controls.short", short))
            .transpose()?,
        open: raw
            .controls
            .open
            .as_ref()
            .map(|open| stray(source, open))
            .transpose()?,
        simulation,
        history: raw.history,
        path: source.path().to_owned(),
        state_folder,
        guardian: resolve_guardian(source, &raw.guardian)?,
        thermostat: simulation::thermostat(source, &raw.thermostat)?,
        doctor: resolve_doctor(source, &raw.doctor)?,
    })
}

/// Returns the state folder as typed, or a folder beside the bench file with the bench's name.
fn state_folder(source: &Source, raw: &raw_bench::Bench) -> PathBuf {
    raw.state_folder.as_ref().map_or_else(
        || {
            let plain = |c: char| {
                if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') {
                    c
                } else {
                    '_'
                }
            };
            source
                .relative(".eis-bench")
                .join(raw.name.chars().map(plain).collect::<String>())
        },
        |folder| source.relative(folder),
    )
}

/// Lease and stall unless they are typed, s.
const GUARDIAN: (f64, f64) = (5.0, 20.0);

fn resolve_guardian(source: &Source, raw: &raw_bench::Guardian) -> Result<Guardian, ConfigError> {
    let within = |field: &str, value: f64, (least, greatest): (f64, f64)| {
        let reason = || format!("expected {least} s to {greatest} s, found {value} s");
        (least..=greatest)
            .contains(&value)
            .then_some(value)
            .ok_or_else(|| source.complain(&format!("guardian.{field}"), reason()))
    };
    Ok(Guardian {
        lease_s: Seconds(within(
            "lease",
            raw.lease.map_or(GUARDIAN.0, |lease| lease.si),
            (1.0, 600.0),
        )?),
        stall_s: Seconds(within(
            "stall",
            raw.stall.map_or(GUARDIAN.1, |stall| stall.si),
            (1.0, 600.0),
        )?),
    })
}

/// Default validity of a report of the doctor, s.
const DOCTOR_VALID_S: Seconds = Seconds(90.0 * 86_400.0);

fn resolve_doctor(source: &Source, raw: &raw_bench::Doctor) -> Result<Doctor, ConfigError> {
    let valid_for_s = raw
        .valid_for
        .map_or(DOCTOR_VALID_S, |span| Seconds(span.si));
    if valid_for_s <= Seconds::ZERO {
        return Err(source.complain(
            "doctor.valid_for",
            format!("expected a duration above 0 s, found {valid_for_s}"),
        ));
    }
    Ok(Doctor {
        required: raw.required,
        valid_for_s,
    })
}

/// Largest stray admittance of the open jig; the true one is anything from zero to that.
fn stray(source: &Source, raw: &raw_bench::Open) -> Result<StrayAdmittance, ConfigError> {
    let (least_ohm, greatest_f) = (raw.resistance_min.si, raw.capacitance_max.si);
    if least_ohm <= 0.0 {
        return Err(source.complain(
            "controls.open.resistance_min",
            format!("expected a resistance above 0 Ω, found {least_ohm} Ω"),
        ));
    }
    if greatest_f < 0.0 {
        return Err(source.complain(
            "controls.open.capacitance_max",
            format!("expected a capacitance of 0 F or more, found {greatest_f} F"),
        ));
    }
    Ok(StrayAdmittance::within(least_ohm, greatest_f))
}

/// One client at a time, one instrument at an address, one connection to a GPIB adapter.
fn check_addresses(source: &Source, instruments: &Instruments) -> Result<(), ConfigError> {
    let addressed = instruments.addressed();
    let mut seen: Vec<(&str, &Address)> = Vec::new();
    for (role, instrument) in &addressed {
        let field = format!("instruments.{role}.address");
        if let Some((other, _)) = seen
            .iter()
            .find(|(_, address)| *address == &instrument.address)
        {
            return Err(source.complain(
                &field,
                format!(
                    "expected an address of its own, found that of {other}: {}",
                    instrument.address
                ),
            ));
        }
        if let Some(other) = seen.iter().find_map(|(other, address)| {
            shares_adapter(address, &instrument.address).then_some(other)
        }) {
            let reason = format!(
                "expected a GPIB adapter of its own, found that of {other}: an adapter takes one \
                connection"
            );
            return Err(source.complain(&field, reason));
        }
        seen.push((role, &instrument.address));
    }
    Ok(())
}

fn shares_adapter(one: &Address, other: &Address) -> bool {
    matches!((one, other), (Address::Gpib { .. }, Address::Gpib { .. })) && meet(one, other)
}

/// Greatest offset of the command, V, and the current that it may drive, A.
const MOST_OFFSET: (f64, f64) = (0.5, 1.0);

/// Greatest offset of the command, V, for a supply with this command per ampere.
fn most_offset_v(volts_per_amp: f64) -> Volts {
    let (most_v, most_a) = MOST_OFFSET;
    Volts(most_v.min(most_a * volts_per_amp.abs()))
}

fn resolve_simulation(
    source: &Source,
    raw: &raw_bench::Simulation,
    instruments: &Instruments,
) -> Result<Simulation, ConfigError> {
    let in_process = instruments
        .addressed()
        .iter()
        .all(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }));
    let time = match &raw.time {
        Some(text) => text
            .parse::<TimeMode>()
            .map_err(|error| source.complain("simulation.time", error.to_string()))?,
        None if in_process => TimeMode::Virtual,
        None => TimeMode::Real,
    };
    if time == TimeMode::Virtual && !in_process {
        return Err(source.complain(
            "simulation.time",
            "virtual time jumps ahead of answers on real ports: it needs `memory:` addresses only",
        ));
    }
    // On real instruments every wait would be too short by the factor.
    let elsewhere = instruments
        .addressed()
        .into_iter()
        .find(|(_, instrument)| !is_local(&instrument.address));
    if let (TimeMode::Scaled(_), Some((role, instrument))) = (time, elsewhere) {
        let reason = format!(
            "scaled time is for mocks on this machine, and {role} is at {}",
            instrument.address
        );
        return Err(source.complain("simulation.time", reason));
    }
    let faults = raw
        .faults
        .as_ref()
        .map(|faults| simulation::faults(source, faults))
        .transpose()?;
    let quirks = simulation::quirks(source, &raw.quirks, instruments)?;
    Ok(Simulation {
        scenario: source.relative(&raw.scenario),
        time,
        faults,
        quirks,
    })
}

fn known(
    source: &Source,
    field: &str,
    raw: &raw_bench::Known,
) -> Result<KnownImpedance, ConfigError> {
    let (r_ohm, r_sigma_ohm) = (raw.resistance.si, raw.resistance_sigma.si);
    if !(r_ohm > 0.0 && r_ohm < 1.0) {
        return Err(source.complain(
            &format!("{field}.resistance"),
            format!("expected a resistance above 0 and below 1 Ω, found {r_ohm} Ω"),
        ));
    }
    if !(r_sigma_ohm > 0.0 && r_sigma_ohm < r_ohm) {
        let reason = format!(
            "expected a standard uncertainty above 0 and below the resistance, found {r_sigma_ohm} \
            Ω"
        );
        return Err(source.complain(&format!("{field}.resistance_sigma"), reason));
    }
    if raw.inductance_sigma.si < 0.0 || raw.inductance.si < 0.0 {
        return Err(source.complain(
            &format!("{field}.inductance"),
            "expected an inductance and its standard uncertainty, neither below zero",
        ));
    }
    Ok(KnownImpedance {
        r_ohm,
        r_sigma_ohm,
        l_h: raw.inductance.si,
        l_sigma_h: raw.inductance_sigma.si,
    })
}

fn resolve_instruments(
    source: &Source,
    raw: &raw_bench::Instruments,
    supply4q: Option<Instrument>,
) -> Result<Instruments, ConfigError> {
    let resolve = |role: &str, instrument: &Option<raw_bench::Instrument>, keys: &[&str]| {
        let resolve = |raw: &raw_bench::Instrument| {
            let resolved = resolve_instrument(
                source,
                role,
                Typed {
                    model: &raw.model,
                    address: &raw.address,
                },
                keys,
            )?;
            Ok(Instrument {
                accept: raw.accept.clone(),
                answer_s: supply4q::resolve_answer(source, role, raw.answer)?,
                ..resolved
            })
        };
        instrument.as_ref().map(resolve).transpose()
    };
    let logger = raw
        .logger
        .as_ref()
        .map(|raw| {
            let instrument = resolve_instrument(
                source,
                "logger",
                Typed {
                    model: &raw.model,
                    address: &raw.address,
                },
                &keys(logger::DIALECTS),
            )?;
            let dialect = by_key(logger::DIALECTS, &raw.model);
            for (field, channel) in [
                ("cell_channel", Some(raw.cell_channel)),
                ("ambient_channel", raw.ambient_channel),
            ] {
                if let Some(channel) = channel
                    .filter(|channel| dialect.is_some_and(|dialect| !dialect.has_channel(*channel)))
                {
                    let reason = format!(
                        "expected a channel that a {} has (one input is channel \
                    1), found {channel}",
                        raw.model
                    );
                    return Err(source.complain(&format!("instruments.logger.{field}"), reason));
                }
            }
            if raw.ambient_channel == Some(raw.cell_channel) {
                return Err(source.complain(
                    "instruments.logger.ambient_channel",
                    "expected another \
                channel than the cell's, or none",
                ));
            }
            Ok((
                Instrument {
                    accept: raw.accept.clone(),
                    ..instrument
                },
                raw.cell_channel,
                raw.ambient_channel,
            ))
        })
        .transpose()?;
    let jig = raw
        .jig
        .as_ref()
        .map(|raw| resolve_jig(source, raw))
        .transpose()?;
    Ok(Instruments {
        supply4q,
        generator: resolve("generator", &raw.generator, &keys(generator::DIALECTS))?,
        scope: resolve("scope", &raw.scope, &keys(scope::DIALECTS))?,
        load: raw
            .load
            .as_ref()
            .map(|raw| resolve_load(source, raw))
            .transpose()?,
        supply: resolve("supply", &raw.supply, &keys(supply::DIALECTS))?,
        chiller: resolve("chiller", &raw.chiller, &keys(chiller::DIALECTS))?,
        logger,
        jig,
    })
}

fn resolve_load(source: &Source, raw: &raw_bench::Load) -> Result<Instrument, ConfigError> {
    let typed = Typed {
        model: &raw.model,
        address: &raw.address,
    };
    Ok(Instrument {
        accept: raw.accept.clone(),
        answer_s: supply4q::resolve_answer(source, "load", raw.answer)?,
        remote_sense: raw.remote_sense,
        ..resolve_instrument(source, "load", typed, &keys(load::DIALECTS))?
    })
}

/// The names of a role's models.
fn keys<D: Model + ?Sized>(dialects: &[&'static D]) -> Vec<&'static str> {
    dialects.iter().map(|dialect| dialect.key()).collect()
}

/// An instrument as typed.
#[derive(Clone, Copy)]
struct Typed<'a> {
    model: &'a str,
    address: &'a str,
}

fn resolve_instrument(
    source: &Source,
    role: &str,
    typed: Typed<'_>,
    keys: &[&str],
) -> Result<Instrument, ConfigError> {
    let Typed { model, address } = typed;
    if !keys.contains(&model) {
        let reason = format!("expected one of {}, found {model:?}", keys.join(", "));
        return Err(source.complain(&format!("instruments.{role}.model"), reason));
    }
    let address = address.parse().map_err(|error| {
        source.complain(&format!("instruments.{role}.address"), format!("{error}"))
    })?;
    Ok(Instrument {
        model: model.to_owned(),
        address,
        accept: None,
        answer_s: ANSWER_S,
        rating: None,
        remote_sense: None,
    })
}

fn resolve_jig(source: &Source, raw: &raw_bench::Jig) -> Result<Jig, ConfigError> {
    match (raw.model.as_str(), &raw.address) {
        ("person", None) => Ok(Jig::Person),
        ("person", Some(_)) => Err(source.complain(
            "instruments.jig.address",
            "a person has no address: leave it out",
        )),
        (_, Some(address)) => resolve_instrument(
            source,
            "jig",
            Typed {
                model: &raw.model,
                address,
            },
            &[jig::MOCK_JIG],
        )
        .map(Jig::Device),
        (_, None) => {
            let reason = format!(
                "expected \"person\", or {:?} with an address, found {:?}",
                jig::MOCK_JIG,
                raw.model
            );
            Err(source.complain("instruments.jig.model", reason))
        }
    }
}
