//! Opens the instruments of one bench, checks their identities, and brings them into safe state.
//! Opening changes nothing on any of them.

mod bath;
mod output;
mod safe;
pub mod state_readback;
pub mod survey;

pub use bath::BathLeft;
pub use output::{Output, SafeReport, Unsafe};

use std::collections::BTreeMap;

use instruments::{
    chiller::{self, Chiller},
    clock::Clock,
    exchange::Identity,
    generator::{self, Generator},
    instrument::{Instrument, Model, by_key},
    jig::Jig,
    link::{Link, LinkError, LinkOptions, LinkProfile},
    load::{self, Load},
    logger::{self, Logger},
    scope::{self, Scope},
    supply::{self, Supply},
    supply4q::{self, Supply4q},
    transcript::Tap,
    transport::MemoryHub,
};

use crate::config;

/// Hands the roles whose models speak a dialect to another macro, in the order in which instruments
/// are listed: the role's module in `instruments`, which is its field and its name, too, and its
/// variant.
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

/// Reason why a bench cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// An instrument does not answer as it must.
    #[error("{role} ({model}): {source}")]
    Link {
        /// Its role.
        role: &'static str,
        /// Its model in the configuration.
        model: String,
        /// Error of the link.
        source: Box<LinkError>,
    },
    /// Another model answers than the configuration says.
    #[error(
        "{role}: expected a {model}, found {found:?} at {address}; check model and address in the \
        bench file"
    )]
    Identity {
        /// Its role.
        role: &'static str,
        /// Its model in the configuration.
        model: String,
        /// Its address.
        address: String,
        /// Its answer.
        found: String,
    },
    /// Outputs that are not known to be off.
    #[error(transparent)]
    Unsafe(#[from] Unsafe),
    /// A step needs a role that the bench lacks.
    #[error("the bench has no {role}, which this step needs")]
    Missing {
        /// The role.
        role: &'static str,
    },
    /// A key without a dialect: the configuration should have refused it.
    #[error("{role}: no dialect {model:?}")]
    Dialect {
        /// The role.
        role: &'static str,
        /// The key.
        model: String,
    },
}

/// Resources that all links of a bench share.
pub struct Connections {
    /// Bench time.
    pub clock: Clock,
    /// In-process streams.
    pub hub: MemoryHub,
    /// Where each instrument's conversation is written, by role.
    pub taps: BTreeMap<&'static str, Tap>,
}

/// The instruments of one bench.
pub struct Bench {
    /// Its name.
    name: String,
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
    models: BTreeMap<&'static str, config::Instrument>,
    clock: Clock,
    command_offset_v: f64,
    /// Roles whose output said that it is off while a current flowed, and by what it was brought to
    /// zero.
    lied: BTreeMap<String, String>,
}

/// An instrument's identity, for the manifest.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Identified {
    /// Its role.
    pub role: &'static str,
    /// Its model in the configuration.
    pub model: String,
    /// Its address.
    pub address: String,
    /// Identity by its own answer.
    pub identity: Identity,
    /// Whether that is what the configuration says.
    pub recognised: bool,
}

impl Identified {
    /// Refuses an instrument that is not the configured model.
    ///
    /// # Errors
    /// [`BenchError::Identity`].
    pub fn expected(&self) -> Result<(), BenchError> {
        if self.recognised {
            return Ok(());
        }
        let (model, address, found) = (
            self.model.clone(),
            self.address.clone(),
            self.identity.raw.clone(),
        );
        Err(BenchError::Identity {
            role: self.role,
            model,
            address,
            found,
        })
    }
}

impl Bench {
    /// Connects to every instrument; sends nothing.
    ///
    /// # Errors
    /// The first instrument that cannot be reached.
    pub async fn open(
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
            name: config.name.clone(),
            supply4q: open(
                connections,
                "supply4q",
                supply4q::DIALECTS,
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
            .await?,
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
            clock: connections.clock.clone(),
            command_offset_v: config.wiring.command_offset_v,
            lied: BTreeMap::new(),
            models: instruments
                .addressed()
                .into_iter()
                .map(|(role, instrument)| (role, instrument.clone()))
                .collect(),
        })
    }

    /// The instruments that can move charge, and the bath, not yet connected to: switching off and
    /// asking connect each of them by itself, so that one that cannot be reached does not keep the
    /// others from being switched off. Sends nothing.
    ///
    /// # Errors
    /// [`BenchError::Dialect`].
    pub fn unconnected(
        config: &config::Bench,
        connections: &Connections,
    ) -> Result<Self, BenchError> {
        let instruments = &config.instruments;
        let channel = u16::from(config.wiring.generator_channel);
        Ok(Self {
            name: config.name.clone(),
            supply4q: unconnected(
                connections,
                "supply4q",
                supply4q::DIALECTS,
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
            )?,
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
            clock: connections.clock.clone(),
            command_offset_v: config.wiring.command_offset_v,
            lied: BTreeMap::new(),
            models: instruments
                .addressed()
                .into_iter()
                .map(|(role, instrument)| (role, instrument.clone()))
                .collect(),
        })
    }

    /// A new connection to each instrument that can move charge and has none. The bath is not among
    /// them: [`Self::reach_bath`].
    ///
    /// # Errors
    /// The first that cannot be reached.
    pub async fn connect(&mut self) -> Result<(), BenchError> {
        macro_rules! connect {
            ($role:literal, $field:ident) => {
                if let Some(instrument) = self.$field.as_mut()
                    && instrument.link_mut().is_dropped()
                {
                    let reconnected = instrument.link_mut().reconnect().await;
                    reconnected.map_err(|source| {
                        wrap(
                            $role,
                            self.models
                                .get($role)
                                .map_or("", |known| known.model.as_str()),
                            source,
                        )
                    })?;
                }
            };
        }
        connect!("supply4q", supply4q);
        connect!("generator", generator);
        connect!("load", load);
        connect!("supply", supply);
        Ok(())
    }

    /// Asks every instrument who it is; changes nothing. What is not the configured model is
    /// marked, not refused.
    ///
    /// # Errors
    /// The first instrument that does not answer.
    pub async fn identify(&mut self) -> Result<Vec<Identified>, BenchError> {
        let mut found = Vec::new();
        macro_rules! ask {
            ($role:expr, $field:ident, $recognises:expr) => {
                if let (Some(instrument), Some(config)) =
                    (self.$field.as_mut(), self.models.get($role))
                {
                    let identity = instrument
                        .identify()
                        .await
                        .map_err(|source| wrap($role, &config.model, source))?;
                    let recognised = $recognises(&*instrument, &identity);
                    let (model, address) = (config.model.clone(), config.address.to_string());
                    found.push(Identified {
                        role: $role,
                        model,
                        address,
                        identity,
                        recognised,
                    });
                }
            };
        }
        macro_rules! ask_all {
            ($($field:ident $variant:ident,)+) => { $(ask!(stringify!($field), $field, Instrument::recognises);)+ };
        }
        for_roles!(ask_all);
        ask!("jig", jig, |_: &Jig, _: &Identity| true);
        Ok(found)
    }

    /// As [`Self::identify`], and refuses an instrument that is not the configured model.
    ///
    /// # Errors
    /// Also [`BenchError::Identity`].
    pub async fn identify_strictly(&mut self) -> Result<Vec<Identified>, BenchError> {
        let found = self.identify().await?;
        found.iter().try_for_each(Identified::expected)?;
        Ok(found)
    }

    /// The model that the configuration gives a role.
    pub fn model(&self, role: &str) -> &str {
        self.models
            .get(role)
            .map_or("", |instrument| instrument.model.as_str())
    }

    /// Wraps a link's error with its role.
    pub fn error(&self, role: &'static str) -> impl Fn(LinkError) -> BenchError + use<> {
        let model = self.model(role).to_owned();
        move |source| wrap(role, &model, source)
    }
}

/// Connects the instrument of a role, where the bench has one; sends nothing.
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

/// The dialect of an instrument's model.
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

/// The same without a connection.
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

fn wrap(role: &'static str, model: &str, source: LinkError) -> BenchError {
    BenchError::Link {
        role,
        model: model.to_owned(),
        source: Box::new(source),
    }
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
    LinkOptions {
        name: role.to_owned(),
        address: instrument.address.clone(),
        profile,
        clock: connections.clock.clone(),
        hub: connections.hub.clone(),
        tap: connections
            .taps
            .get(role)
            .cloned()
            .unwrap_or_else(Tap::none),
    }
}
