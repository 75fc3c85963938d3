//! The instruments of one bench by role, and their links.

use std::{collections::BTreeMap, time::Duration};

use instruments::{
    chiller::{self, Chiller},
    clock::Clock,
    generator::{self, Generator},
    instrument::{Instrument, Model, by_key},
    jig::Jig,
    link::{Link, LinkOptions, LinkProfile},
    load::{self, Load},
    logger::{self, Logger},
    scope::{self, Scope},
    supply::{self, Supply},
    supply4q::{self, Supply4q},
    transcript::Tap,
    transport::MemoryHub,
};

use super::error::{BenchError, wrap};
use bench_plan::config;

/// Least timeout of a link, as a multiple of its usual answer time.
const ANSWERS_PER_TIMEOUT: f64 = 3.0;

/// Passes the roles whose models have a dialect to another macro, in the order in which
/// instruments are listed: the role's module in `instruments`, which is also its field and its
/// name, and its variant.
macro_rules! for_roles {
    ($hand:ident) => {
        $hand! {
            supply4q Supply4q,
            generator Generator,
            scope Scope,
            load Load,
            supply Supply,
            chiller Chiller,
            logger Logger,
        }
    };
}
pub(crate) use for_roles;

/// Resources that all links of a bench share.
pub struct Connections {
    /// Bench time.
    pub clock: Clock,
    /// In-process streams.
    pub hub: MemoryHub,
    /// Log of each instrument's communication, by role.
    pub taps: BTreeMap<&'static str, Tap>,
}

/// The instruments of one bench, by role.
pub struct Instruments {
    /// Bipolar supply.
    pub supply4q: Option<Supply4q>,
    /// Signal generator.
    pub generator: Option<Generator>,
    /// Oscilloscope.
    pub scope: Option<Scope>,
    /// DC load.
    pub load: Option<Load>,
    /// DC supply.
    pub supply: Option<Supply>,
    /// Chiller.
    pub chiller: Option<Chiller>,
    /// Logger, whose first channel is the cell's.
    pub logger: Option<Logger>,
    /// The jig, where a device changes the fixture.
    pub jig: Option<Jig>,
}

impl Instruments {
    /// Connects to every instrument without sending anything.
    pub(super) async fn open(
        config: &config::Bench,
        connections: &Connections,
    ) -> Result<Self, BenchError> {
        let instruments = &config.instruments;
        let channel = config.wiring.generator_channel;
        let logger_channels = instruments
            .logger
            .as_ref()
            .map_or_else(Vec::new, |(_, cell, ambient)| {
                std::iter::once(*cell).chain(*ambient).collect()
            });
        let jig = match &instruments.jig {
            Some(config::Jig::Device(instrument)) => Some(Jig::new(
                link(connections, "jig", instrument, Jig::profile()).await?,
            )),
            Some(config::Jig::Person) | None => None,
        };
        let logger = instruments
            .logger
            .as_ref()
            .map(|(instrument, _, _)| instrument);
        Ok(Self {
            supply4q: open(
                connections,
                "supply4q",
                &rated(instruments.supply4q.as_ref()),
                instruments.supply4q.as_ref(),
            )
            .await?,
            generator: open(
                connections,
                "generator",
                generator::DIALECTS,
                instruments.generator.as_ref(),
            )
            .await?
            .map(|generator| generator.on_channels(vec![u16::from(channel)])),
            scope: open(
                connections,
                "scope",
                scope::DIALECTS,
                instruments.scope.as_ref(),
            )
            .await?,
            load: open(
                connections,
                "load",
                load::DIALECTS,
                instruments.load.as_ref(),
            )
            .await?
            .map(|load| load.sensing(senses(instruments))),
            supply: open(
                connections,
                "supply",
                supply::DIALECTS,
                instruments.supply.as_ref(),
            )
            .await?,
            chiller: open(
                connections,
                "chiller",
                chiller::DIALECTS,
                instruments.chiller.as_ref(),
            )
            .await?,
            logger: open(connections, "logger", logger::DIALECTS, logger)
                .await?
                .map(|logger| logger.on_channels(logger_channels)),
            jig,
        })
    }

    /// Returns second handles on all instruments except scope and jig; see
    /// [`super::Bench::share`].
    pub(super) fn share(&self, clock: &Clock) -> Self {
        Self {
            supply4q: self.supply4q.as_ref().map(|one| one.share(clock)),
            generator: self.generator.as_ref().map(|one| one.share(clock)),
            scope: None,
            load: self.load.as_ref().map(|one| one.share(clock)),
            supply: self.supply.as_ref().map(|one| one.share(clock)),
            chiller: self.chiller.as_ref().map(|one| one.share(clock)),
            logger: self.logger.as_ref().map(|one| one.share(clock)),
            jig: None,
        }
    }

    /// Creates the instruments that can move charge, and the bath, without connecting to them.
    pub(super) fn unconnected(
        config: &config::Bench,
        connections: &Connections,
    ) -> Result<Self, BenchError> {
        let instruments = &config.instruments;
        let channel = u16::from(config.wiring.generator_channel);
        Ok(Self {
            supply4q: unconnected(
                connections,
                "supply4q",
                &rated(instruments.supply4q.as_ref()),
                instruments.supply4q.as_ref(),
            )?,
            generator: unconnected(
                connections,
                "generator",
                generator::DIALECTS,
                instruments.generator.as_ref(),
            )?
            .map(|generator| generator.on_channels(vec![channel])),
            scope: None,
            load: unconnected(
                connections,
                "load",
                load::DIALECTS,
                instruments.load.as_ref(),
            )?
            .map(|load| load.sensing(senses(instruments))),
            supply: unconnected(
                connections,
                "supply",
                supply::DIALECTS,
                instruments.supply.as_ref(),
            )?,
            chiller: unconnected(
                connections,
                "chiller",
                chiller::DIALECTS,
                instruments.chiller.as_ref(),
            )?,
            logger: None,
            jig: None,
        })
    }
}

/// Returns where the load measures, if the bench file states it.
fn senses(instruments: &config::Instruments) -> Option<bool> {
    instruments.load.as_ref()?.remote_sense
}

/// Returns the dialect of a bipolar supply with its rating, or none for an unknown model.
fn rated(supply: Option<&config::Instrument>) -> Vec<&'static dyn supply4q::Dialect> {
    supply
        .and_then(|supply| supply4q::dialect(&supply.model, supply.rating).ok())
        .into_iter()
        .collect()
}

/// Connects the instrument of a role, if the bench has one; sends nothing.
async fn open<D: Model + ?Sized>(
    connections: &Connections,
    role: &'static str,
    dialects: &[&'static D],
    instrument: Option<&config::Instrument>,
) -> Result<Option<Instrument<D>>, BenchError> {
    let Some(instrument) = instrument else {
        return Ok(None);
    };
    let dialect = spoken(role, dialects, instrument)?;
    let link = link(connections, role, instrument, dialect.profile()).await?;
    Ok(Some(
        Instrument::new(link, dialect).accepting(instrument.accept.clone()),
    ))
}

/// Returns the dialect of an instrument's model.
fn spoken<D: Model + ?Sized>(
    role: &'static str,
    dialects: &[&'static D],
    instrument: &config::Instrument,
) -> Result<&'static D, BenchError> {
    by_key(dialects, &instrument.model).ok_or_else(|| BenchError::Dialect {
        role,
        model: instrument.model.clone(),
    })
}

/// Creates the instrument of a role without a connection.
fn unconnected<D: Model + ?Sized>(
    connections: &Connections,
    role: &'static str,
    dialects: &[&'static D],
    instrument: Option<&config::Instrument>,
) -> Result<Option<Instrument<D>>, BenchError> {
    let Some(instrument) = instrument else {
        return Ok(None);
    };
    let dialect = spoken(role, dialects, instrument)?;
    let link = Link::unconnected(options(connections, role, instrument, dialect.profile()));
    Ok(Some(
        Instrument::new(link, dialect).accepting(instrument.accept.clone()),
    ))
}

async fn link(
    connections: &Connections,
    role: &'static str,
    instrument: &config::Instrument,
    profile: LinkProfile,
) -> Result<Link, BenchError> {
    let opened = Link::open(options(connections, role, instrument, profile)).await;
    opened.map_err(|source| wrap(role, &instrument.model, source))
}

fn options(
    connections: &Connections,
    role: &'static str,
    instrument: &config::Instrument,
    profile: LinkProfile,
) -> LinkOptions {
    let timeout = profile.timeout.max(Duration::from_secs_f64(
        ANSWERS_PER_TIMEOUT * instrument.answer_s,
    ));
    LinkOptions {
        name: role.to_owned(),
        address: instrument.address.clone(),
        profile: LinkProfile { timeout, ..profile },
        clock: connections.clock.clone(),
        hub: connections.hub.clone(),
        tap: connections
            .taps
            .get(role)
            .cloned()
            .unwrap_or_else(Tap::none),
    }
}

/// Opens a new connection if the old one was dropped. If that fails, the next operation fails,
/// too, and returns the reason.
pub(super) async fn fresh<D: Model + ?Sized>(instrument: &mut Instrument<D>) {
    if instrument.link_mut().is_dropped() {
        let _ = instrument.link_mut().reconnect().await;
    }
}
