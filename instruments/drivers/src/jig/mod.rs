//! Changes the fixture in the jig without a person: on the simulated bench a separate small device,
//! later a relay.

use instruments_domain::fixture::Fixture;
use instruments_link::link::{Link, LinkError, LinkProfile};

use crate::{
    exchange::{Exchange, Identity, play},
    instrument::ms,
};

/// The name in a bench file.
pub const MOCK_JIG: &str = "mock-jig";

/// A jig that changes its fixture by command.
pub struct Jig {
    link: Link,
}

impl Jig {
    /// Returns the pace and deadlines of its link.
    pub fn profile() -> LinkProfile {
        LinkProfile {
            min_gap: ms(1),
            ..LinkProfile::scpi()
        }
    }

    /// Puts the jig on a link. Sends nothing.
    pub fn new(link: Link) -> Self {
        Self { link }
    }

    /// Queries the identity; changes nothing.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn identify(&mut self) -> Result<Identity, LinkError> {
        Ok(Identity::parse(&self.link.query("*IDN?").await?))
    }

    /// Clamps a fixture; every output must be off.
    ///
    /// # Errors
    /// The link's errors; a jig that holds another fixture afterwards.
    pub async fn mount(&mut self, fixture: Fixture) -> Result<(), LinkError> {
        let script = match fixture {
            Fixture::Cell => Exchange::word("JIG:MOUNT CELL", "JIG:MOUNT?", &["CELL"]),
            Fixture::Shunt => Exchange::word("JIG:MOUNT SHUNT", "JIG:MOUNT?", &["SHUNT", "SHUN"]),
            Fixture::FakeCell => Exchange::word("JIG:MOUNT FAKE", "JIG:MOUNT?", &["FAKE"]),
            Fixture::Short => Exchange::word("JIG:MOUNT BAR", "JIG:MOUNT?", &["BAR"]),
        };
        play(&mut self.link, &[], &[script]).await
    }

    /// Puts another of the cells under test into the jig's place for them, by its number from 1;
    /// every output must be off.
    ///
    /// # Errors
    /// The link's; a jig that holds another one afterwards.
    pub async fn insert(&mut self, number: usize) -> Result<(), LinkError> {
        let value = number as f64;
        let script = Exchange::number(format!("JIG:CELL {number}"), "JIG:CELL?", value, 0.0);
        play(&mut self.link, &[], &[script]).await
    }

    /// Returns the link, for reconnecting.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }
}
