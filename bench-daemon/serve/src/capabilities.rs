//! Properties of a bench by its file, from which a client can see whether an experiment fits it.

use instruments::{chiller, fixture::Fixture, instrument::by_key, load, supply};
use serde::Serialize;
use utoipa::ToSchema;

use bench_plan::config::{Bench, Instrument, Jig};

/// Properties of a bench. An experiment that needs less is nevertheless checked against the limits
/// of its cell.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Capabilities {
    /// Greatest current that its instruments can drive through a cell, A.
    current_a: f64,
    /// Least and greatest temperature that its bath can hold, °C; null without a bath.
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<[f64; 2]>,
    /// Fixtures that its jig can take: `cell`, `shunt`, `fake_cell`, `short`.
    fixtures: Vec<String>,
    /// Every instrument is simulated.
    simulated: bool,
}

impl Capabilities {
    /// Returns the properties of a bench.
    pub fn of(bench: &Bench) -> Self {
        Self {
            current_a: current_a(bench),
            temperature_degc: temperature_degc(bench),
            fixtures: fixtures(bench).into_iter().map(name).collect(),
            simulated: bench.is_simulated(),
        }
    }
}

/// Greatest current of the instruments that drive one through the cell, by their models.
fn current_a(bench: &Bench) -> f64 {
    let model = |instrument: &Option<Instrument>| {
        let instrument = instrument.as_ref()?;
        Some(instrument.model.clone())
    };
    let instruments = &bench.instruments;
    let bipolar = bench.bipolar().map(|can| can.full_scale.value());
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
fn temperature_degc(bench: &Bench) -> Option<[f64; 2]> {
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
