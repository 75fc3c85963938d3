//! Opens the instruments of one bench, checks their identities, and brings them into a safe state.
//! Opening does not change the state of any instrument.

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
    units::Volts,
};

use error::wrap;

use bench_plan::config;

/// A bench: its instruments and their configuration.
pub struct Bench {
    name: String,
    /// Its instruments, by role.
    pub instruments: Instruments,
    models: BTreeMap<&'static str, config::Instrument>,
    clock: Clock,
    command: Command,
    /// Roles whose output was reported as off while a current flowed, and the method that brought
    /// the current to zero.
    lied: BTreeMap<String, String>,
    /// Report of the last shutdown of all outputs.
    last_safe: Option<SafeReport>,
}

/// The generator's command to the bipolar supply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Command {
    /// Its offset for no current.
    zero: Volts,
    /// Whether the supply is analog: no message switches it, so that the command must stay at zero.
    unswitched: bool,
}

/// Identity of an instrument, for the manifest.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Identified {
    /// Its role.
    pub role: &'static str,
    /// Its model in the configuration.
    pub model: String,
    /// Its address.
    pub address: String,
    /// Identity as the instrument reports it.
    pub identity: Identity,
    /// Whether the identity matches the configured model.
    pub recognised: bool,
}

impl Identified {
    /// Returns an error if the instrument is not the configured model.
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
    /// Connects to every instrument without sending anything.
    ///
    /// # Errors
    /// Fails at the first instrument that cannot be reached.
    pub async fn open(
        config: &config::Bench,
        connections: &Connections,
    ) -> Result<Self, BenchError> {
        let instruments = Instruments::open(config, connections).await?;
        Ok(Self::of(instruments, config, connections))
    }

    /// Creates the instruments that can move charge, and the bath, without connecting to them.
    /// Shutdown and queries connect to each of them separately, so that an unreachable instrument
    /// does not prevent the others from being switched off. Sends nothing.
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
            command: Command {
                zero: config.wiring.command_offset_v,
                unswitched: config.wiring.analog.is_some(),
            },
            lied: BTreeMap::new(),
            last_safe: None,
        }
    }

    /// Returns a second set of handles on the same connections, whose waits count on `clock`. The
    /// watch uses them to read meters and to switch off while a procedure drives the instruments.
    /// Scope and jig are not included.
    #[must_use]
    pub fn share(&self, clock: &Clock) -> Self {
        Self {
            name: self.name.clone(),
            instruments: self.instruments.share(clock),
            models: self.models.clone(),
            clock: clock.clone(),
            command: self.command,
            lied: self.lied.clone(),
            last_safe: None,
        }
    }

    /// Blocks every other set of handles, so that the shutdown comes first; see
    /// [`instruments::link::Link::take_over`].
    pub fn take_over(&mut self) {
        self.each_link(|link| link.take_over());
    }

    /// Unblocks the other sets of handles, and passes on to `other` which outputs were found to
    /// report a wrong state.
    pub fn release_to(&mut self, other: &mut Self) {
        self.each_link(|link| link.release());
        other.lied.extend(self.lied.clone());
    }

    /// Queries whether all settings of the instrument in a role are still as they were made,
    /// without changing anything. Returns a description of the difference, if any.
    ///
    /// # Errors
    /// Errors of the link.
    pub async fn differs(&mut self, role: &str) -> Result<Option<String>, LinkError> {
        self.compare(role, None).await
    }

    /// As [`Self::differs`], for a single setting: number `turn`, modulo the number of settings.
    ///
    /// # Errors
    /// Errors of the link.
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

    /// Opens a new connection to each instrument that can move charge and has none. The bath is
    /// excluded: see [`Self::reach_bath`].
    ///
    /// # Errors
    /// Fails at the first instrument that cannot be reached.
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

    /// Returns what the units of this bench do not know or do otherwise, each with its consequence.
    pub fn peculiarities(&mut self) -> Vec<String> {
        let found = std::cell::RefCell::new(Vec::new());
        self.each_link(|link| {
            let of_link = link.notes().into_iter();
            let named = of_link.map(|text| format!("{}: {text}", link.name()));
            found.borrow_mut().extend(named);
        });
        found.into_inner()
    }

    /// Queries the identity of every instrument without changing anything. An instrument that is
    /// not the configured model is marked but not rejected.
    ///
    /// # Errors
    /// Fails at the first instrument that does not answer.
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

    /// As [`Self::identify`], but rejects an instrument that is not the configured model.
    ///
    /// # Errors
    /// As [`Self::identify`], and [`BenchError::Identity`].
    pub async fn identify_strictly(&mut self) -> Result<Vec<Identified>, BenchError> {
        let found = self.identify().await?;
        found.iter().try_for_each(Identified::expected)?;
        Ok(found)
    }

    /// Closes every connection. Returns the report of the last shutdown.
    pub fn close(self) -> Option<SafeReport> {
        self.last_safe
    }

    /// Returns the configured model of a role.
    pub fn model(&self, role: &str) -> &str {
        let model = self.models.get(role);
        match model {
            Some(instrument) => &instrument.model,
            None if role == "supply4q" && self.is_unswitched() => config::ANALOG,
            None => "",
        }
    }

    /// Queries whether the generator of an analog supply is at its zero command; changes nothing. A
    /// generator that does not answer is not.
    pub(crate) async fn commands_zero(&mut self) -> bool {
        let zero = self.command.zero;
        match self.instruments.generator.as_mut() {
            Some(generator) if self.command.unswitched => {
                let answers = generator.look_at_zero(zero).await;
                answers.is_ok_and(|answers| answers.iter().all(|answer| answer.as_scripted))
            }
            _ => false,
        }
    }

    /// Checks whether its bipolar supply is analog, so that the program cannot switch it.
    pub fn is_unswitched(&self) -> bool {
        self.command.unswitched
    }

    /// Returns a function that wraps a link error with the role.
    pub fn error(&self, role: &'static str) -> impl Fn(LinkError) -> BenchError + use<> {
        let model = self.model(role).to_owned();
        move |source| wrap(role, &model, source)
    }
}
