//! Queries an instrument at an address for its identity, capabilities, present settings and error
//! queue.
//!
//! It sends only queries, including those of the read-backs. The only state that a query changes
//! is the error queue, which drops the entries that it returns.

use instruments::{
    chiller::{self, Chiller},
    exchange::{Answer, Exchange, Identity, NOT_KNOWN, Setting, fold, survey},
    generator::{self, Generator},
    instrument::{Instrument, Model},
    jig::{self, Jig},
    link::{Link, LinkError, LinkProfile},
    load::{self, Load},
    logger::{self, Logger},
    scope::{self, Intent, Scope, Vertical},
    supply::{self, Supply},
    supply4q::{self, Supply4q},
    units::{Amps, Seconds, Volts},
};
use serde::Serialize;
use serde_json::Value;

use crate::bench::{Bench, for_roles};

/// What an instrument reports about itself.
#[derive(Debug, Clone, Serialize)]
pub struct InstrumentReport {
    /// Its identity.
    pub identity: Identity,
    /// Whether the dialect supports this model.
    pub recognised: bool,
    /// Capabilities of the model by its dialect: ranges, channels, smallest steps.
    pub capabilities: Value,
    /// Present settings: queries and replies.
    pub programmed: Vec<Answer>,
    /// Entries of its error queue, or faults that it reports.
    pub health: Vec<String>,
}

impl InstrumentReport {
    /// Creates a report with the identity only: the replies to queries of another model would be
    /// meaningless.
    pub fn unknown(identity: Identity) -> Self {
        Self {
            identity,
            recognised: false,
            capabilities: Value::Null,
            programmed: Vec::new(),
            health: Vec::new(),
        }
    }
}

/// An instrument of any role.
#[expect(missing_docs, reason = "the roles")]
pub enum AnyInstrument {
    Supply4q(Supply4q),
    Generator(Generator),
    Scope(Scope),
    Load(Load),
    Supply(Supply),
    Chiller(Chiller),
    Logger(Logger),
    Jig(Jig),
}

/// A dialect of any role.
#[derive(Clone, Copy)]
pub struct KnownDialect {
    /// The role.
    pub role: &'static str,
    /// The name in a bench file.
    pub key: &'static str,
    /// Pace and deadlines.
    pub profile: LinkProfile,
    /// Query for the identity.
    pub question: &'static str,
    /// The setting that shows whether its output or input is on, or its control of a bath.
    pub switch: Option<Setting>,
    dialect: RoleDialect,
}

#[derive(Clone, Copy)]
enum RoleDialect {
    Supply4q(&'static dyn supply4q::Dialect),
    Generator(&'static dyn generator::Dialect),
    Scope(&'static dyn scope::Dialect),
    Load(&'static dyn load::Dialect),
    Supply(&'static dyn supply::Dialect),
    Chiller(&'static dyn chiller::Dialect),
    Logger(&'static dyn logger::Dialect),
}

impl KnownDialect {
    /// Returns every dialect, role by role.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        macro_rules! add {
            ($($module:ident $variant:ident,)+) => {
                $(all.extend($module::DIALECTS.iter().map(|dialect| {
                    known(stringify!($module), *dialect, RoleDialect::$variant(*dialect))
                }));)+
            };
        }
        for_roles!(add);
        all
    }

    /// Returns the dialect for a role and a model in a bench file.
    pub fn of(role: &str, model: &str) -> Option<Self> {
        let mut all = Self::all().into_iter();
        all.find(|known| known.role == role && known.key == model)
    }

    /// Checks whether an identity belongs to this model.
    pub fn recognises(&self, identity: &Identity) -> bool {
        macro_rules! ask {
            ($($module:ident $variant:ident,)+) => {
                match self.dialect {
                    $(RoleDialect::$variant(dialect) => dialect.recognises(identity),)+
                }
            };
        }
        for_roles!(ask)
    }

    /// Applies the dialect to a link. Sends nothing.
    pub fn on(&self, link: Link) -> AnyInstrument {
        macro_rules! put {
            ($($module:ident $variant:ident,)+) => {
                match self.dialect {
                    $(RoleDialect::$variant(dialect) => AnyInstrument::$variant(Instrument::new(link, dialect)),)+
                }
            };
        }
        for_roles!(put)
    }
}

fn known<D: Model + ?Sized>(
    role: &'static str,
    dialect: &'static D,
    dialect_of_role: RoleDialect,
) -> KnownDialect {
    KnownDialect {
        role,
        key: dialect.key(),
        profile: dialect.profile(),
        question: dialect.identity_query(),
        switch: dialect.switch(),
        dialect: dialect_of_role,
    }
}

impl AnyInstrument {
    /// Returns the instruments of a bench with their roles, in a fixed order.
    pub fn of(bench: Bench) -> Vec<(&'static str, Self)> {
        let mut all = Vec::new();
        macro_rules! add {
            ($($module:ident $variant:ident,)+) => {
                $(all.extend(
                    bench.instruments.$module.map(|known| (stringify!($module), AnyInstrument::$variant(known))),
                );)+
            };
        }
        for_roles!(add);
        all.extend(
            bench
                .instruments
                .jig
                .map(|jig| ("jig", AnyInstrument::Jig(jig))),
        );
        all
    }

    /// Runs all queries without changing anything.
    ///
    /// # Errors
    /// Errors of the link.
    pub async fn describe(&mut self) -> Result<InstrumentReport, LinkError> {
        let (identity, recognised) = self.identify().await?;
        if !recognised {
            return Ok(InstrumentReport::unknown(identity));
        }
        let capabilities = self.capabilities();
        let questions = self.questions();
        let mut health = self.errors().await?;
        let programmed = survey(self.link(), &questions).await?;
        let missing = programmed
            .iter()
            .filter(|answer| answer.answer == NOT_KNOWN);
        health.extend(missing.map(|answer| self.depends(&answer.question)));
        if let Self::Chiller(chiller) = self {
            match chiller.status().await {
                Ok(status) => {
                    health.extend(status.alarm);
                    let local = format!("not in remote mode: {}", status.raw);
                    health.extend((!status.remote).then_some(local));
                }
                Err(LinkError::Timeout { message, .. }) => health.push(self.depends(&message)),
                Err(error) => return Err(error),
            }
        }
        Ok(InstrumentReport {
            identity,
            recognised,
            capabilities,
            programmed,
            health,
        })
    }

    /// Returns the entries of the error queue; a note in their place for a unit without one.
    async fn errors(&mut self) -> Result<Vec<String>, LinkError> {
        let link = self.link();
        match link.drain_errors().await {
            Ok(entries) => Ok(entries.iter().map(ToString::to_string).collect()),
            Err(LinkError::Timeout { message, .. }) => {
                link.reconnect().await?;
                Ok(vec![self.depends(&message)])
            }
            Err(error) => Err(error),
        }
    }

    /// Describes what depends on a query that the unit does not know.
    fn depends(&self, question: &str) -> String {
        let settings = self.settings();
        match Setting::missing(settings, question) {
            Some(without) => format!("`{question}` is {NOT_KNOWN}: {without} is not known"),
            None => format!("`{question}` is {NOT_KNOWN}: a run needs it, and ends without it"),
        }
    }

    fn settings(&self) -> &'static [Setting] {
        macro_rules! of {
            ($($module:ident $variant:ident,)+) => {
                match self {
                    $(Self::$variant(instrument) => instrument.dialect().settings(),)+
                    Self::Jig(_) => &[],
                }
            };
        }
        for_roles!(of)
    }

    async fn identify(&mut self) -> Result<(Identity, bool), LinkError> {
        macro_rules! ask {
            ($($module:ident $variant:ident,)+) => {
                match self {
                    $(Self::$variant(instrument) => {
                        let identity = instrument.identify().await?;
                        let recognised = instrument.recognises(&identity);
                        Ok((identity, recognised))
                    })+
                    Self::Jig(jig) => {
                        let identity = jig.identify().await?;
                        let recognised = fold(&identity.raw).contains(&fold(jig::MOCK_JIG));
                        Ok((identity, recognised))
                    }
                }
            };
        }
        for_roles!(ask)
    }

    fn link(&mut self) -> &mut Link {
        macro_rules! of {
            ($($module:ident $variant:ident,)+) => {
                match self {
                    $(Self::$variant(instrument) => instrument.link_mut(),)+
                    Self::Jig(jig) => jig.link_mut(),
                }
            };
        }
        for_roles!(of)
    }

    fn capabilities(&self) -> Value {
        let known = match self {
            Self::Supply4q(instrument) => serde_json::to_value(instrument.capabilities()),
            Self::Generator(instrument) => serde_json::to_value(instrument.capabilities()),
            Self::Scope(instrument) => serde_json::to_value(instrument.capabilities()),
            Self::Load(instrument) => serde_json::to_value(instrument.capabilities()),
            Self::Supply(instrument) => serde_json::to_value(instrument.capabilities()),
            Self::Chiller(instrument) => Ok(serde_json::json!({ "range": instrument.range() })),
            Self::Logger(_) | Self::Jig(_) => Ok(Value::Null),
        };
        known.unwrap_or(Value::Null)
    }

    /// Returns the scripts whose read-backs show the present settings; none of their commands is
    /// sent.
    fn questions(&self) -> Vec<Exchange> {
        match self {
            Self::Supply4q(instrument) => {
                let limits = supply4q::Limits {
                    compliance: Volts(1.0),
                    current: Amps(1.0),
                };
                [
                    instrument.dialect().output(false),
                    instrument.dialect().prepare(&limits),
                    instrument.dialect().analog(false),
                ]
                .concat()
            }
            Self::Generator(instrument) => [
                instrument.dialect().output(1, false),
                instrument.dialect().quiet(1, Volts::ZERO),
            ]
            .concat(),
            Self::Scope(instrument) => {
                let vertical = |channel| {
                    Intent::Vertical(Vertical {
                        channel,
                        per_div: Volts(1.0),
                        offset: Volts::ZERO,
                    })
                };
                let intents = (1..=4).map(vertical).chain([
                    Intent::Timebase(Seconds(0.01)),
                    Intent::Session {
                        memory_points: 1_000_000,
                    },
                ]);
                intents
                    .flat_map(|intent| instrument.dialect().script(&intent))
                    .collect()
            }
            Self::Load(instrument) => {
                let discharge = load::Discharge {
                    draw: load::Draw::Current(Amps(0.1)),
                    stop_below: Volts(1.0),
                };
                [
                    instrument.dialect().input(false),
                    instrument.dialect().prepare(&discharge),
                ]
                .concat()
            }
            Self::Supply(instrument) => {
                let charge = supply::Charge {
                    voltage: Volts(1.0),
                    current: Amps(0.1),
                };
                [
                    instrument.dialect().output(false),
                    instrument.dialect().prepare(&charge),
                ]
                .concat()
            }
            Self::Chiller(instrument) => instrument.dialect().run(Some(instrument.range().0)),
            Self::Logger(_) | Self::Jig(_) => Vec::new(),
        }
    }
}
