//! Opens the instruments of one bench, checks their identities, and brings them into safe state.
//! Opening changes nothing on any of them.

mod bath;
mod error;
mod output;
pub mod outputs;
mod roles;
mod safe;
pub mod state_readback;
pub mod survey;

pub use bath::BathOrder;
pub use error::BenchError;
pub use output::{BathLeft, Output, SafeReport, Unsafe};
pub(crate) use roles::for_roles;
pub use roles::{Connections, Instruments};
pub(crate) use safe::Driven;

use std::collections::BTreeMap;

use instruments::{
    clock::Clock,
    exchange::Identity,
    instrument::Instrument,
    jig::Jig,
    link::{Link, LinkError},
};

use error::wrap;

use crate::config;

/// A bench: its instruments, and what the configuration says of them.
pub struct Bench {
    name: String,
    /// Its instruments, by role.
    pub instruments: Instruments,
    models: BTreeMap<&'static str, config::Instrument>,
    clock: Clock,
    command_offset_v: f64,
    /// Roles whose output said that it is off while a current flowed, and by what it was brought to
    /// zero.
    lied: BTreeMap<String, String>,
    /// Report of the last time that everything was switched off.
    last_safe: Option<SafeReport>,
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
        let instruments = Instruments::open(config, connections).await?;
        Ok(Self::of(instruments, config, connections))
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
        let instruments = Instruments::unconnected(config, connections)?;
        Ok(Self::of(instruments, config, connections))
    }

    fn of(instruments: Instruments, config: &config::Bench, connections: &Connections) -> Self {
        let addressed = config.instruments.addressed().into_iter();
        Self {
            name: config.name.clone(),
            instruments,
            models: addressed
                .map(|(role, instrument)| (role, instrument.clone()))
                .collect(),
            clock: connections.clock.clone(),
            command_offset_v: config.wiring.command_offset_v,
            lied: BTreeMap::new(),
            last_safe: None,
        }
    }

    /// A second set of handles on the same connections, whose waits count on `clock`: for the watch,
    /// which reads meters and switches off while a procedure drives the instruments. Scope and jig
    /// are left out.
    #[must_use]
    pub fn share(&self, clock: &Clock) -> Self {
        Self {
            name: self.name.clone(),
            instruments: self.instruments.share(clock),
            models: self.models.clone(),
            clock: clock.clone(),
            command_offset_v: self.command_offset_v,
            lied: self.lied.clone(),
            last_safe: None,
        }
    }

    /// Keeps every other set of handles out, so that switching off comes first; see
    /// [`instruments::link::Link::take_over`].
    pub fn take_over(&mut self) {
        self.each_link(|link| link.take_over());
    }

    /// Lets the other sets of handles speak again, and gives them what this one has learnt about
    /// outputs that report a wrong state.
    pub fn release_to(&mut self, other: &mut Self) {
        self.each_link(|link| link.release());
        other.lied.extend(self.lied.clone());
    }

    /// Asks the instrument of a role whether all its settings are still as they were made, and
    /// changes nothing; what is not, in words.
    ///
    /// # Errors
    /// The link's.
    pub async fn differs(&mut self, role: &str) -> Result<Option<String>, LinkError> {
        self.compare(role, None).await
    }

    /// As [`Self::differs`], for one setting: number `turn`, counted round.
    ///
    /// # Errors
    /// The link's.
    pub async fn differs_one(
        &mut self,
        role: &str,
        turn: usize,
    ) -> Result<Option<String>, LinkError> {
        self.compare(role, Some(turn)).await
    }

    async fn compare(
        &mut self,
        role: &str,
        turn: Option<usize>,
    ) -> Result<Option<String>, LinkError> {
        macro_rules! compare_all {
            ($($field:ident $variant:ident,)+) => { $(
                if role == stringify!($field)
                    && let Some(instrument) = self.instruments.$field.as_mut()
                {
                    return match turn {
                        Some(turn) => instrument.differs_one(turn).await,
                        None => instrument.differs().await,
                    };
                }
            )+ };
        }
        for_roles!(compare_all);
        Ok(None)
    }

    fn each_link(&mut self, visit: impl Fn(&Link)) {
        macro_rules! visit_all {
            ($($field:ident $variant:ident,)+) => { $(
                if let Some(instrument) = self.instruments.$field.as_mut() {
                    visit(instrument.link_mut());
                }
            )+ };
        }
        for_roles!(visit_all);
    }

    /// A new connection to each instrument that can move charge and has none. The bath is not among
    /// them: [`Self::reach_bath`].
    ///
    /// # Errors
    /// The first that cannot be reached.
    pub async fn connect(&mut self) -> Result<(), BenchError> {
        macro_rules! connect {
            ($role:literal, $field:ident) => {
                if let Some(instrument) = self.instruments.$field.as_mut()
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
                    (self.instruments.$field.as_mut(), self.models.get($role))
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

    /// Closes every connection; gives what was read back when everything was switched off last.
    pub fn close(self) -> Option<SafeReport> {
        self.last_safe
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
