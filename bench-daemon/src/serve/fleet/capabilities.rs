//! Properties of a bench by its file, for the requirements of jobs.

use bench_fleet::Capabilities;
use instruments::{chiller, fixture::Fixture, instrument::by_key, load, supply, supply4q};

use crate::config::{Bench, Instrument, Jig};

/// Returns the properties of a bench. A job that needs more is not taken; one that needs less is
/// nevertheless checked against the limits of its cell.
pub(super) fn capabilities(bench: &Bench) -> Capabilities {
    Capabilities {
        current_a: current_a(bench),
        temperature_c: temperature_c(bench),
        fixtures: fixtures(bench).into_iter().map(name).collect(),
        simulated: bench.in_process() || bench.is_mocked(),
    }
}

/// Greatest current of the instruments that drive one through the cell, by their models.
fn current_a(bench: &Bench) -> f64 {
    let model = |instrument: &Option<Instrument>| {
        let instrument = instrument.as_ref()?;
        Some(instrument.model.clone())
    };
    let instruments = &bench.instruments;
    let bipolar = model(&instruments.supply4q)
        .and_then(|key| by_key(supply4q::DIALECTS, &key))
        .map(|dialect| dialect.capabilities().full_scale.value());
    let load = model(&instruments.load)
        .and_then(|key| by_key(load::DIALECTS, &key))
        .map(|dialect| dialect.capabilities().max_current.value());
    let supply = model(&instruments.supply)
        .and_then(|key| by_key(supply::DIALECTS, &key))
        .map(|dialect| dialect.capabilities().max_current.value());
    // A spectrum needs the bipolar supply; without one the weaker of the two directions counts.
    let direct = match (load, supply) {
        (Some(load), Some(supply)) => load.min(supply),
        (load, supply) => load.or(supply).unwrap_or_default(),
    };
    bipolar.unwrap_or(direct)
}

/// Range of the bath, by its model.
fn temperature_c(bench: &Bench) -> Option<[f64; 2]> {
    let chiller = bench.instruments.chiller.as_ref()?;
    let dialect = by_key(chiller::DIALECTS, &chiller.model)?;
    let (least, greatest) = dialect.range();
    Some([least.value(), greatest.value()])
}

/// Fixtures that can be put into the jig, by hand or by a device. Without a jig the cell is in it.
fn fixtures(bench: &Bench) -> Vec<Fixture> {
    let mut found = vec![Fixture::Cell];
    match bench.instruments.jig {
        Some(Jig::Person | Jig::Device(_)) => {
            found.push(Fixture::Shunt);
            found.extend(bench.fake_cell.as_ref().map(|_| Fixture::FakeCell));
            found.extend(bench.short.as_ref().map(|_| Fixture::Short));
        }
        None => {}
    }
    found
}

fn name(fixture: Fixture) -> String {
    let name = match fixture {
        Fixture::Cell => "cell",
        Fixture::Shunt => "shunt",
        Fixture::FakeCell => "fake_cell",
        Fixture::Short => "short",
    };
    name.to_owned()
}
