//! The simulated bench: one world of `fixtures`, and behind each configured address a mock that
//! accesses it.

mod ports;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use fixtures::{Scenario, SimulatedBench};
use instruments::{
    clock::Clock,
    transport::{Address, MemoryHub},
};

pub use ports::{Over, Transport};

use bench_plan::{
    config::{Bench, ConfigError, Source},
    mocks::{self, FaultLog, Happened, MockOptions, Quirks, Remote, Schedule, SharedPlant},
};

/// Reason why a simulation cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The scenario file is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A model cannot be simulated.
    #[error("instruments.{role}.model: {reason}")]
    Model {
        /// Its role.
        role: &'static str,
        /// Reason.
        reason: String,
    },
    /// A port cannot be opened.
    #[error("instruments.{role}.address: {address}: {reason}")]
    Port {
        /// Its role.
        role: &'static str,
        /// Its address.
        address: String,
        /// Reason.
        reason: String,
    },
    /// The bench has no simulation.
    #[error("{path}: expected a section [simulation]: this bench is made of real instruments", path = path.display())]
    Real {
        /// The bench file.
        path: PathBuf,
    },
}

/// Voltage limit that is set at the panel of a simulated analog supply, V.
const ANALOG_V: f64 = 5.0;

/// A simulated world; clones share the same world.
#[derive(Clone)]
pub struct Simulation {
    world: Arc<Mutex<SimulatedBench>>,
    faults: Option<Schedule>,
    happened: FaultLog,
    quirks: BTreeMap<&'static str, Quirks>,
    remotes: Option<Remotes>,
}

/// Remote controls of the served instruments, by role.
type Remotes = Arc<Mutex<BTreeMap<&'static str, Remote>>>;

/// Where a mock listens.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Served {
    /// Its role.
    pub role: &'static str,
    /// Its model.
    pub model: String,
    /// The address that a client uses.
    pub address: String,
}

impl Simulation {
    /// Reads the scenario of a bench and creates its world from a seed.
    ///
    /// # Errors
    /// Fails if the scenario file is invalid.
    pub fn new(path: &Path, seed: u64) -> Result<Self, SimError> {
        Self::of(&Source::read(path)?, seed, None)
    }

    /// As [`Simulation::new`], from a parsed scenario, and with a certain cell in the jig if the
    /// scenario has a store of them.
    ///
    /// # Errors
    /// As [`Simulation::new`].
    pub fn of(source: &Source, seed: u64, cell: Option<&str>) -> Result<Self, SimError> {
        let scenario: Scenario = source.parse()?;
        let world = cell
            .map_or_else(
                || SimulatedBench::new(&scenario, seed),
                |cell| SimulatedBench::with_cell(&scenario, seed, cell),
            )
            .map_err(|error| source.complain(&error.field, error.to_string()))?;
        Ok(Self {
            world: Arc::new(Mutex::new(world)),
            faults: None,
            happened: FaultLog::default(),
            quirks: BTreeMap::new(),
            remotes: None,
        })
    }

    /// Adds faults between the instruments and their clients.
    #[must_use]
    pub fn with_faults(self, faults: Option<Schedule>) -> Self {
        Self { faults, ..self }
    }

    /// Adds quirks of the mocks, by role.
    #[must_use]
    pub fn with_quirks(self, quirks: BTreeMap<&'static str, Quirks>) -> Self {
        Self { quirks, ..self }
    }

    /// Adds a remote control for each instrument that it serves ([`Self::remote`]).
    #[must_use]
    pub fn with_remotes(self) -> Self {
        Self {
            remotes: Some(Remotes::default()),
            ..self
        }
    }

    /// Returns the remote control of an instrument that is served; `None` without
    /// [`Self::with_remotes`].
    pub fn remote(&self, role: &str) -> Option<Remote> {
        let remotes = self.remotes.as_ref()?;
        let remotes = remotes.lock().unwrap_or_else(PoisonError::into_inner);
        remotes.get(role).cloned()
    }

    /// Returns the faults that have happened.
    pub fn happened(&self) -> Vec<Happened> {
        self.happened
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Returns the world behind the mocks; only tests access it.
    pub fn world(&self) -> &Arc<Mutex<SimulatedBench>> {
        &self.world
    }

    /// Starts a mock for every instrument of a bench on in-process streams.
    ///
    /// # Errors
    /// Fails if a model cannot be simulated or an address is not in-process.
    pub fn serve_in_process(
        &self,
        bench: &Bench,
        clock: &Clock,
        hub: &MemoryHub,
    ) -> Result<(), SimError> {
        self.connect_analog(bench, clock);
        for (role, instrument) in bench.instruments.addressed() {
            let device = self.device(role, &instrument.model)?;
            let Address::Memory { name } = &instrument.address else {
                return Err(SimError::Port {
                    role,
                    address: instrument.address.to_string(),
                    reason: "expected `memory:` addresses only: the bench runs in this process"
                        .to_owned(),
                });
            };
            let port = |reason: String| SimError::Port {
                role,
                address: instrument.address.to_string(),
                reason,
            };
            mocks::serve_memory(device, hub, name, clock.clone())
                .map_err(|error| port(error.to_string()))?;
        }
        Ok(())
    }

    /// Starts a mock for every instrument of a bench on a real port each: the one in its address,
    /// or, with `over`, a free port of another transport.
    ///
    /// # Errors
    /// Fails if a model cannot be simulated or a port is in use.
    pub async fn serve_on_ports(
        &self,
        bench: &Bench,
        over: &[Over],
        clock: &Clock,
    ) -> Result<Vec<Served>, SimError> {
        self.connect_analog(bench, clock);
        let mut served = Vec::new();
        for (role, instrument) in bench.instruments.addressed() {
            let device = self.device(role, &instrument.model)?;
            let wanted = over
                .iter()
                .rev()
                .find(|over| over.role.as_deref().is_none_or(|found| found == role))
                .map(|over| over.transport);
            let address = match (wanted, &instrument.address) {
                (Some(transport), _) => ports::on_a_free_port(device, transport, clock).await,
                (None, Address::Memory { .. }) => {
                    ports::on_a_free_port(device, Transport::Tcp, clock).await
                }
                (None, address) => ports::at(device, address, clock).await,
            };
            let port = |reason: String| SimError::Port {
                role,
                address: instrument.address.to_string(),
                reason,
            };
            let address = address
                .map_err(|error| port(error.to_string()))?
                .to_string();
            served.push(Served {
                role,
                model: instrument.model.clone(),
                address,
            });
        }
        Ok(served)
    }

    /// Switches an analog supply of the bench on, as a person does before a run.
    fn connect_analog(&self, bench: &Bench, clock: &Clock) {
        if bench.wiring.analog.is_some() {
            let mut world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
            world.connect_analog(clock.now_s(), ANALOG_V);
        }
    }

    fn device(&self, role: &'static str, model: &str) -> Result<Box<dyn mocks::Device>, SimError> {
        let plant: SharedPlant = self.world.clone();
        let options = MockOptions {
            quirks: self.quirks.get(role).cloned().unwrap_or_default(),
            ..MockOptions::default()
        };
        let made = match &self.faults {
            Some(faults) => mocks::make_troubled(model, plant, &options, faults, &self.happened),
            None => mocks::make(model, plant, &options),
        };
        let device = made.map_err(|error| SimError::Model {
            role,
            reason: error.to_string(),
        })?;
        let Some(remotes) = &self.remotes else {
            return Ok(device);
        };
        let (device, remote) = Remote::of(device);
        let mut remotes = remotes.lock().unwrap_or_else(PoisonError::into_inner);
        remotes.insert(role, remote);
        Ok(device)
    }
}
