//! Raw files → a checked experiment. Every error names file, line, field and what was expected.
//! The bench is in `resolve_bench`.

use std::{path::Path, sync::Arc};

use analysis_model::ocv::OcvCurve;
use fixtures::Scenario;
use instruments::{
    transport::Address,
    units::{Amps, Celsius, Coulombs, Seconds, Volts},
};

use super::{
    AutoResume, Cell, ConfigError, Experiment, Instruments, Source, check::Check, limits, map, raw,
    resolve_bench::resolve_bench, schema::Kind, source::in_field,
};
use crate::interlock::Limits;

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
pub fn resolve_experiment(
    source: Source,
    other_bench: Option<&Path>,
) -> Result<Experiment, ConfigError> {
    let raw: raw::Experiment = source.parse_as(Kind::Experiment)?;
    if raw.name.is_empty()
        || !raw
            .name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
    {
        return Err(source.complain(
            "name",
            format!(
                "expected a name of letters, digits, `-` and `_`, found {:?}",
                raw.name
            ),
        ));
    }
    let bench_path = other_bench.map_or_else(|| source.relative(&raw.bench), Path::to_owned);
    let bench_source = source.open(&bench_path).map_err(|error| {
        if other_bench.is_none() {
            in_field(&source, "bench", &error)
        } else {
            error
        }
    })?;
    let bench = resolve_bench(&bench_source)?;
    check_one_world(&bench_source, &bench.instruments)?;
    let scenario = bench
        .simulation
        .as_ref()
        .map(|section| read_scenario(&bench_source, &section.scenario))
        .transpose()?;
    let cell_source = source
        .open(&source.relative(&raw.cell))
        .map_err(|error| in_field(&source, "cell", &error))?;
    let cell = resolve_cell(&cell_source)?;
    let check = Check {
        source: &source,
        bench_source: &bench_source,
        bench: &bench,
        cell: &cell,
    };
    let temperature = raw
        .temperature
        .as_ref()
        .map(|section| check.temperature(section))
        .transpose()?;
    let fixture_check = raw
        .fixture_check
        .as_ref()
        .map(|section| check.fixture_check(section))
        .transpose()?;
    let soc_reset = raw
        .soc_reset
        .as_ref()
        .map(|section| check.soc_reset(section))
        .transpose()?;
    let ocv_soc = raw
        .ocv_soc
        .as_ref()
        .map(|section| check.ocv_soc(section))
        .transpose()?;
    let eis = raw
        .eis
        .as_ref()
        .map(|section| check.eis(section))
        .transpose()?;
    if let Some((eis, bias)) = eis
        .as_ref()
        .and_then(|eis| eis.bias.as_ref().map(|b| (eis, b)))
    {
        let setpoint_degc = temperature.as_ref().map(|held| held.setpoint_degc);
        check.check_bias("eis.bias", bias, eis.amplitude_a, setpoint_degc)?;
    }
    let multisine = raw
        .multisine
        .as_ref()
        .map(|section| check.multisine(section))
        .transpose()?;
    if let Some((multisine, bias)) = multisine.as_ref().and_then(|m| Some((m, m.bias.as_ref()?))) {
        let setpoint_degc = temperature.as_ref().map(|held| held.setpoint_degc);
        check.check_bias("multisine.bias", bias, multisine.peak_a, setpoint_degc)?;
    }
    if fixture_check.is_some() && eis.is_none() {
        let reason = "expected a section [eis], whose frequencies the controls are measured at; \
        with repeat = 0 the cell is left out";
        return Err(source.complain("fixture_check", reason));
    }
    if let (Some(check), Some(eis)) = (&fixture_check, &eis)
        && let (Some(first), Some(last)) = (check.beyond_hz.first(), eis.freqs_hz.last())
        && first <= last
    {
        let reason =
            format!("expected frequencies beyond the sweep's last ({last}), found {first}");
        return Err(source.complain("fixture_check.beyond", reason));
    }
    let (traces, trace_sources) = check.traces(&raw.traces)?;
    let campaign = raw
        .campaign
        .as_ref()
        .map(|section| check.campaign(section, eis.as_ref(), &traces))
        .transpose()?;
    if campaign.is_some() && (ocv_soc.is_some() || multisine.is_some()) {
        return Err(source.complain(
            "campaign",
            "expected [campaign] without [ocv_soc] and [multisine]: its runs are sweeps and traces",
        ));
    }
    let specimen = raw
        .specimen
        .as_ref()
        .map(|one| one.resolve(&source, &cell.identity))
        .transpose()?;
    if campaign.is_some() && specimen.is_some() {
        let reason = "expected [specimen] without [campaign], which names its cells itself";
        return Err(source.complain("specimen", reason));
    }
    let (specimen, identity) = specimen.unzip();
    let beside = map::Beside {
        eis: eis.as_ref(),
        multisine: multisine.as_ref(),
        temperature: temperature.as_ref(),
        specimen: specimen.as_ref(),
        refused: [
            (campaign.is_some(), "campaign"),
            (soc_reset.is_some(), "soc_reset"),
            (ocv_soc.is_some(), "ocv_soc"),
            (!traces.is_empty(), "[traces]"),
            (raw.diagnosis.is_some(), "diagnosis"),
        ]
        .into_iter()
        .find_map(|(there, section)| there.then_some(section)),
    };
    let map = raw
        .map
        .as_ref()
        .map(|section| check.map(section, &beside))
        .transpose()?;
    if let (Some(campaign), Some((file, scenario))) = (&campaign, &scenario) {
        check.specimens(campaign, file, scenario)?;
    }
    if eis.as_ref().is_none_or(|eis| eis.repeat == 0)
        && traces.is_empty()
        && ocv_soc.is_none()
        && multisine.is_none()
        && map.is_none()
    {
        let reason = "expected a section [eis] with a repeat above 0, or a section [[traces]], \
        [ocv_soc], [multisine] or [map]";
        return Err(source.complain("(whole file)", reason));
    }
    // The spectra of a map are not fitted.
    let swept = eis.as_ref().filter(|_| map.is_none());
    let fit = check.fit(&raw.fit, swept.map_or(usize::MAX, |eis| eis.freqs_hz.len()))?;
    let diagnosed_rc = raw
        .diagnosis
        .as_ref()
        .map(|section| check.diagnosis(section, &fit, eis.as_ref()))
        .transpose()?;
    let auto_resume = auto_resume(&source, raw.resume.as_ref())?;
    Ok(Experiment {
        name: raw.name,
        auto_resume,
        seed: raw.seed,
        bench,
        cell: Cell {
            identity: identity.unwrap_or_else(|| cell.identity.clone()),
            ..cell
        },
        specimen: specimen.map(Arc::new),
        temperature,
        fixture_check,
        soc_reset,
        ocv_soc,
        eis,
        multisine,
        map,
        campaign,
        traces,
        fit,
        diagnosed_rc,
        sources: [source, bench_source, cell_source]
            .into_iter()
            .chain(scenario.map(|(file, _)| file))
            .chain(trace_sources)
            .collect(),
    })
}

/// Default number of continuations after a transient fault, and the wait before each, s, in which
/// an instrument notices that its client has gone.
const PASSING: (usize, f64) = (5, 5.0);

fn auto_resume(source: &Source, raw: Option<&raw::Resume>) -> Result<AutoResume, ConfigError> {
    let within = |field: &str, value: f64, (least, greatest): (f64, f64), unit: &str| {
        let reason = || format!("expected {least}{unit} to {greatest}{unit}, found {value}{unit}");
        (least..=greatest)
            .contains(&value)
            .then_some(())
            .ok_or_else(|| source.complain(&format!("resume.{field}"), reason()))
    };
    let none = AutoResume {
        passing: PASSING.0,
        pause_s: Seconds(PASSING.1),
        most: 0,
        after_s: Seconds::ZERO,
    };
    let Some(raw) = raw else { return Ok(none) };
    within("after", raw.after.si, (5.0, 86_400.0), " s")?;
    within("most", raw.most as f64, (0.0, 20.0), "")?;
    let passing = raw.passing.unwrap_or(none.passing);
    within("passing", passing as f64, (0.0, 100.0), "")?;
    Ok(AutoResume {
        passing,
        most: raw.most,
        after_s: Seconds(raw.after.si),
        ..none
    })
}

/// The scenario of a simulated bench, checked, and the file that it is in.
fn read_scenario(bench: &Source, path: &Path) -> Result<(Source, Scenario), ConfigError> {
    let source = bench
        .open(path)
        .map_err(|error| in_field(bench, "simulation.scenario", &error))?;
    let scenario: Scenario = source.parse_as(Kind::Scenario)?;
    scenario
        .validate()
        .map_err(|error| source.complain(&error.field, error.to_string()))?;
    Ok((source, scenario))
}

/// The built-in mocks are a whole bench or none: they share one simulated world.
fn check_one_world(source: &Source, instruments: &Instruments) -> Result<(), ConfigError> {
    let in_process = |address: &Address| matches!(address, Address::Memory { .. });
    let addressed = instruments.addressed();
    let first = addressed
        .first()
        .is_some_and(|(_, instrument)| in_process(&instrument.address));
    match addressed
        .iter()
        .find(|(_, instrument)| in_process(&instrument.address) != first)
    {
        None => Ok(()),
        Some((role, _)) => {
            let reason = "expected all instruments in this process (`memory:`) or none of them: \
            they share one simulated bench";
            Err(source.complain(&format!("instruments.{role}.address"), reason))
        }
    }
}

/// A cell, checked.
///
/// # Errors
/// The first mistake, with file, line and field.
pub fn resolve_cell(source: &Source) -> Result<Cell, ConfigError> {
    let raw: raw::Cell = source.parse_as(Kind::Cell)?;
    let above = |field: &str, value: f64, bound: f64, what: &str| {
        (value > bound).then_some(()).ok_or_else(|| {
            source.complain(field, format!("expected more than {what}, found {value}"))
        })
    };
    above("capacity", raw.capacity.si, 0.0, "0")?;
    above("voltage_min", raw.voltage_min.si, 0.0, "0 V")?;
    above(
        "voltage_max",
        raw.voltage_max.si,
        raw.voltage_min.si,
        "voltage_min",
    )?;
    above("charge_current_max", raw.charge_current_max.si, 0.0, "0 A")?;
    above(
        "discharge_current_max",
        raw.discharge_current_max.si,
        0.0,
        "0 A",
    )?;
    above(
        "temperature_max",
        raw.temperature_max.si,
        raw.temperature_min.si,
        "temperature_min",
    )?;
    if raw.voltage_max.si > 5.0 {
        return Err(source.complain(
            "voltage_max",
            format!(
                "expected one lithium cell, at most 5 V, found {} V",
                raw.voltage_max.si
            ),
        ));
    }
    if raw.pack.series == 0 || raw.pack.parallel == 0 {
        return Err(source.complain(
            "pack",
            "expected at least one cell in series and one in parallel",
        ));
    }
    raw.identity.check(source, "identity")?;
    let curve = |ocv: raw::Ocv| {
        OcvCurve::monotone(raw.capacity.si / 3600.0, ocv.soc, ocv.voltage_v)
            .map_err(|error| source.complain("ocv", error.to_string()))
    };
    let ocv = raw.ocv.map(curve).transpose()?;
    let cell = Cell {
        name: raw.name,
        identity: raw.identity,
        capacity_coulomb: Coulombs(raw.capacity.si),
        limits: Limits {
            min_v: Volts(raw.voltage_min.si),
            max_v: Volts(raw.voltage_max.si),
            charge_a: Amps(raw.charge_current_max.si),
            discharge_a: Amps(raw.discharge_current_max.si),
            min_degc: Celsius(raw.temperature_min.si),
            max_degc: Celsius(raw.temperature_max.si),
        },
        interlock: raw.interlock.resolve(source, Coulombs(raw.capacity.si))?,
        series: raw.pack.series,
        parallel: raw.pack.parallel,
        ocv,
        wide: Vec::new(),
    };
    raw.absolute.check(source, &cell)?;
    Ok(Cell {
        wide: limits::wide(&cell),
        ..cell
    })
}
