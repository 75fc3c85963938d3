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
        let logger = instruments.logger.as_ref();
        let channels = logger.map_or_else(Vec::new, |(_, cell, ambient)| {
            std::iter::once(*cell).chain(*ambient).collect()
        });
        let logger = logger.map(|(instrument, _, _)| instrument);
        let mut all = Self {
            scope: role(
                connections,
                "scope",
                scope::DIALECTS,
                instruments.scope.as_ref(),
            )?,
            logger: role(connections, "logger", logger::DIALECTS, logger)?
                .map(|logger| logger.on_channels(channels)),
            jig: match &instruments.jig {
                Some(config::Jig::Device(instrument)) => {
                    let options = options(connections, "jig", instrument, Jig::profile());
                    let opened = Link::open(options).await;
                    let opened = opened.map_err(|source| wrap("jig", &instrument.model, source));
                    Some(Jig::new(opened?))
                }
                Some(config::Jig::Person) | None => None,
            },
            ..Self::unconnected(config, connections)?
        };
        let addressed = instruments.addressed();
        let model = |role: &str| {
            let found = addressed.iter().find(|(name, _)| *name == role);
            found.map_or("", |(_, instrument)| instrument.model.as_str())
        };
        macro_rules! connect_all {
            ($($role:ident $variant:ident,)+) => {
                $(if let Some(one) = &mut all.$role {
                    let role = stringify!($role);
                    let opened = one.link_mut().connect().await;
                    opened.map_err(|source| wrap(role, model(role), source))?;
                })+
            };
        }
        for_roles!(connect_all);
        Ok(all)
    }

    /// Creates the instruments that can move charge, and the bath, without connecting to them.
    pub(super) fn unconnected(
        config: &config::Bench,
        connections: &Connections,
    ) -> Result<Self, BenchError> {
        let all = &config.instruments;
        let senses = all.load.as_ref().and_then(|load| load.remote_sense);
        let channel = u16::from(config.wiring.generator_channel);
        let rated = rated(all.supply4q.as_ref());
        Ok(Self {
            supply4q: role(connections, "supply4q", &rated, all.supply4q.as_ref())?,
            generator: role(
                connections,
                "generator",
                generator::DIALECTS,
                all.generator.as_ref(),
            )?
            .map(|generator| generator.on_channels(vec![channel])),
            scope: None,
            load: role(connections, "load", load::DIALECTS, all.load.as_ref())?
                .map(|load| load.sensing(senses)),
            supply: role(connections, "supply", supply::DIALECTS, all.supply.as_ref())?,
            chiller: role(
                connections,
                "chiller",
                chiller::DIALECTS,
                all.chiller.as_ref(),
            )?,
            logger: None,
            jig: None,
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
}

/// Returns the dialect of a bipolar supply with its rating, or none for an unknown model.
fn rated(supply: Option<&config::Instrument>) -> Vec<&'static dyn supply4q::Dialect> {
    supply
        .and_then(|supply| supply4q::dialect(&supply.model, supply.rating).ok())
        .into_iter()
        .collect()
}

/// Creates the instrument of a role, if the bench has one, without a connection.
fn role<D: Model + ?Sized>(
    connections: &Connections,
    role: &'static str,
    dialects: &[&'static D],
    instrument: Option<&config::Instrument>,
) -> Result<Option<Instrument<D>>, BenchError> {
    let Some(instrument) = instrument else {
        return Ok(None);
    };
    let dialect = by_key(dialects, &instrument.model).ok_or_else(|| BenchError::Dialect {
        role,
        model: instrument.model.clone(),
    })?;
    let link = Link::unconnected(options(connections, role, instrument, dialect.profile()));
    Ok(Some(
        Instrument::new(link, dialect).accepting(instrument.accept.clone()),
    ))
}

fn options(
    connections: &Connections,
    role: &'static str,
    instrument: &config::Instrument,
    profile: LinkProfile,
) -> LinkOptions {
    let timeout = profile.timeout.max(Duration::from_secs_f64(
        ANSWERS_PER_TIMEOUT * instrument.answer_s.value(),
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
