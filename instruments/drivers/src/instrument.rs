//! Common parts of every role: a link, the dialect of the model on it, and the identity query.

use std::{
    sync::{Arc, PoisonError},
    time::Duration,
};

use instruments_domain::units::{Amps, Celsius, Volts};
use instruments_link::{
    clock::Clock,
    link::{Link, LinkError, LinkProfile},
    transport::Address,
};

use crate::exchange::{
    Bound, Exchange, ExpectedAnswers, Identity, Setting, Standing, Way, fold, leading_number,
    plain, play, play_all,
};

/// A model of instrument, whatever its role.
pub trait Model: Send + Sync {
    /// Returns the name in a bench file.
    fn key(&self) -> &'static str;

    /// Returns the pace and deadlines of its link.
    fn profile(&self) -> LinkProfile;

    /// Returns whether an identity is this model's. Case and runs of spaces do not matter.
    fn recognises(&self, identity: &Identity) -> bool {
        self.recognises_folded(&identity.folded())
    }

    /// Checks an identity in capitals and with single spaces ([`Identity::folded`]) in the same
    /// manner.
    fn recognises_folded(&self, identity: &Identity) -> bool;

    /// Returns the identity query.
    fn identity_query(&self) -> &'static str {
        "*IDN?"
    }

    /// Returns descriptions of the settings, for messages about a setting that has changed.
    fn settings(&self) -> &'static [Setting] {
        &[]
    }

    /// Returns the setting that reports whether the output or input is on, or whether a bath is
    /// controlled. Returns `None` for a model without such a switch.
    fn switch(&self) -> Option<Setting> {
        self.settings()
            .iter()
            .copied()
            .find(|setting| setting.is_switch)
    }
}

/// End of a direct current of a load or a charger when no further message arrives, as far as its
/// maker states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unattended {
    /// It stops below the voltage that it was given.
    StopsBelow,
    /// It holds the voltage that it was given, and the current falls.
    HoldsVoltage,
    /// Nothing that is known.
    NothingKnown,
}

/// Finds the model of this name in a role's table.
pub fn by_key<D: Model + ?Sized>(dialects: &[&'static D], key: &str) -> Option<&'static D> {
    dialects
        .iter()
        .copied()
        .find(|dialect| dialect.key() == key)
}

/// How one instrument is used on its bench.
#[derive(Debug, Clone, Default)]
pub(crate) struct Setup {
    /// The channels in use, if a model has several.
    pub(crate) channels: Vec<u16>,
    /// Part of the identity of another model that is accepted as this one.
    accepted: Option<String>,
    /// Whether a load measures at its sense terminals; `None` to leave it as it is.
    pub(crate) remote_sense: Option<bool>,
}

/// Instrument on its link, driven by a role's dialect `D`.
pub struct Instrument<D: Model + ?Sized + 'static> {
    pub(crate) link: Link,
    pub(crate) dialect: &'static D,
    pub(crate) setup: Setup,
    /// Settings that were made last and must stay so while current flows. It is locked while a
    /// script changes them, so that a second handle never compares a setting that is being made.
    pub(crate) expected: Arc<tokio::sync::Mutex<ExpectedAnswers>>,
    /// The last reading of its meters, by whichever handle.
    measured: Arc<std::sync::Mutex<Option<Measured>>>,
    /// Its identity at the first query, by any handle.
    identified: Arc<std::sync::Mutex<Option<Identity>>>,
    /// The last scan of its thermometers, by whichever handle.
    pub(crate) scanned: Arc<std::sync::Mutex<Option<Scan>>>,
    /// Settings of a scope that need not be sent again.
    pub(crate) standing: Standing,
}

/// A scan of the thermometers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan {
    /// Temperature of the cell; `None` for an open thermocouple.
    pub cell: Option<Celsius>,
    /// When it was answered, s on the machine's clock.
    pub answered_s: f64,
}

/// A reading of an instrument's own meters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Voltage at its terminals or its sense leads, V; `None` if only the current was queried.
    pub volts: Option<Volts>,
    /// Current, in the direction that the role counts as positive, A.
    pub amps: Amps,
    /// When the current was queried, s on the machine's clock.
    pub asked_s: f64,
    /// When it was answered, s on the machine's clock.
    pub answered_s: f64,
}

impl<D: Model + ?Sized> Instrument<D> {
    /// Puts a dialect on a link. Sends nothing.
    pub fn new(link: Link, dialect: &'static D) -> Self {
        Self {
            link,
            dialect,
            setup: Setup::default(),
            expected: Arc::default(),
            measured: Arc::default(),
            identified: Arc::default(),
            scanned: Arc::default(),
            standing: Standing::default(),
        }
    }

    /// Returns a second handle on the same instrument. Its waits count on `clock`. Both handles
    /// share the connection, the settings that must stay, and the last reading.
    #[must_use]
    pub fn share(&self, clock: &Clock) -> Self {
        Self {
            link: self.link.share(clock),
            dialect: self.dialect,
            setup: self.setup.clone(),
            expected: self.expected.clone(),
            measured: self.measured.clone(),
            identified: self.identified.clone(),
            scanned: self.scanned.clone(),
            standing: Standing::default(),
        }
    }

    /// Returns the last reading of its meters, by any handle.
    pub fn last_measured(&self) -> Option<Measured> {
        *self.measured.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the channels in use, if a model has several: the generator's output, the logger's scan
    /// list.
    #[must_use]
    pub fn on_channels(self, channels: Vec<u16>) -> Self {
        let setup = Setup {
            channels,
            ..self.setup
        };
        Self { setup, ..self }
    }

    /// Accepts an instrument as this model if its identity contains this text.
    #[must_use]
    pub fn accepting(self, accepted: Option<String>) -> Self {
        let setup = Setup {
            accepted,
            ..self.setup
        };
        Self { setup, ..self }
    }

    /// Returns whether an identity is that of the expected instrument.
    pub fn recognises(&self, identity: &Identity) -> bool {
        let accepted =
            self.setup.accepted.as_deref().is_some_and(|text| {
                !text.is_empty() && identity.folded().raw.contains(&fold(text))
            });
        accepted || self.dialect.recognises(identity)
    }

    /// Queries the identity; changes no setting. If the transport cannot detect that an earlier
    /// client left a reply unread, an unexpected identity may be that reply. In that case the link
    /// is resynchronised and the query is repeated.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn identify(&mut self) -> Result<Identity, LinkError> {
        let identity = self.ask_identity().await?;
        self.identified
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert_with(|| identity.clone());
        Ok(identity)
    }

    async fn ask_identity(&mut self) -> Result<Identity, LinkError> {
        let identity = Identity::parse(&self.link.query(self.dialect.identity_query()).await?);
        if self.recognises(&identity) || !matches!(self.link.address(), Address::UsbTmc { .. }) {
            return Ok(identity);
        }
        // A model that answers only this query is still the one that it identified itself as.
        if self.link.reconnect().await.is_err() {
            return Ok(identity);
        }
        let again = self.link.query(self.dialect.identity_query()).await;
        Ok(again.map_or(identity, |text| Identity::parse(&text)))
    }

    /// Reconnects and queries the identity. An instrument whose replies belong to other queries
    /// does not reply with its identity.
    ///
    /// # Errors
    /// The link's errors, and [`LinkError::Unexpected`] if the reply is not the identity of this
    /// model.
    pub async fn reconnect_and_identify(&mut self) -> Result<(), LinkError> {
        self.link.reconnect().await?;
        self.identify_model().await.map(|_| ())
    }

    /// Queries the identity and refuses another model.
    async fn identify_model(&mut self) -> Result<Identity, LinkError> {
        let identity = self.ask_identity().await?;
        if self.recognises(&identity) {
            return Ok(identity);
        }
        let expected = format!("the identity of a {}", self.dialect.key());
        Err(self.refusal(&identity, &expected))
    }

    /// Queries the identity and refuses any instrument other than the one that was identified
    /// first.
    ///
    /// # Errors
    /// The link's errors, and [`LinkError::Unexpected`].
    pub async fn identify_same(&mut self) -> Result<(), LinkError> {
        let identity = self.identify_model().await?;
        let first = self
            .identified
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert_with(|| identity.clone())
            .clone();
        if first.is_same_instrument(&identity) {
            return Ok(());
        }
        // Its answers must not be taken for those of the other one.
        self.link.disconnect("another instrument answers").await;
        Err(self.refusal(&identity, &format!("`{}`", first.raw)))
    }

    fn refusal(&self, identity: &Identity, expected: &str) -> LinkError {
        LinkError::unexpected(
            self.link.name(),
            self.dialect.identity_query(),
            &identity.raw,
            expected,
        )
    }

    /// Queries one number.
    pub(crate) async fn number(&mut self, query: &str) -> Result<f64, LinkError> {
        let answer = self.link.query(query).await?;
        // An overload (9.9E37) and a missing number (9.91E37) are not readings.
        leading_number(&answer)
            .filter(|number| number.is_finite())
            .ok_or_else(|| LinkError::unexpected(self.link.name(), query, &answer, "a number"))
    }

    /// Queries a voltage, then a current, and stores them as the last reading.
    pub(crate) async fn volts_and_amps(
        &mut self,
        [volts, amps]: [&str; 2],
    ) -> Result<(Volts, Amps), LinkError> {
        let volts = Volts(self.number(volts).await?);
        Ok((volts, self.keep_amps(Some(volts), amps).await?))
    }

    /// Queries a current and stores it as the last reading.
    pub(crate) async fn keep_amps(
        &mut self,
        volts: Option<Volts>,
        query: &str,
    ) -> Result<Amps, LinkError> {
        let asked_s = self.link.clock().machine_s();
        let amps = Amps(self.number(query).await?);
        let measured = Measured {
            volts,
            amps,
            asked_s,
            answered_s: self.link.clock().machine_s(),
        };
        *self.measured.lock().unwrap_or_else(PoisonError::into_inner) = Some(measured);
        Ok(amps)
    }

    /// Runs a script. Stops at the first message that the instrument refuses or whose read-back
    /// does not match.
    pub(crate) async fn play(&mut self, script: &[Exchange]) -> Result<(), LinkError> {
        play(&mut self.link, self.dialect.settings(), script).await
    }

    /// Plays a whole script whatever happens in between, for switching off.
    pub(crate) async fn play_all(&mut self, script: &[Exchange]) -> Result<(), LinkError> {
        play_all(&mut self.link, self.dialect.settings(), script).await
    }

    /// Runs a script that changes what drives a current, and stores the resulting settings.
    pub(crate) async fn tell(&mut self, script: &[Exchange]) -> Result<(), LinkError> {
        let mut expected = self.expected.clone().lock_owned().await;
        self.play(script).await?;
        expected.add(script);
        Ok(())
    }

    /// Clears the list of settings that must stay.
    pub(crate) async fn expect_nothing(&self) {
        *self.expected.lock().await = ExpectedAnswers::default();
    }

    /// Returns whether a setting was made that must stay, or is being made.
    pub fn has_settings(&self) -> bool {
        self.expected
            .try_lock()
            .map_or(true, |expected| !expected.is_empty())
    }

    /// Checks, while something is on, whether all settings are unchanged, and changes nothing.
    /// Returns a description of the differences.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn differs(&mut self) -> Result<Option<String>, LinkError> {
        let settings = self.dialect.settings();
        let expected = self.expected.clone().lock_owned().await;
        expected.differs(&mut self.link, settings).await
    }

    /// As [`Self::differs`], for one setting: number `turn`, counted round. A script that changes
    /// settings waits for one question at most.
    ///
    /// # Errors
    /// The link's.
    pub async fn differs_one(&mut self, turn: usize) -> Result<Option<String>, LinkError> {
        let settings = self.dialect.settings();
        let expected = self.expected.clone().lock_owned().await;
        expected.differs_one(turn, &mut self.link, settings).await
    }

    /// Applies a method to reach zero current, regardless of refused messages.
    ///
    /// # Errors
    /// The link's error for the first message that failed.
    pub async fn go(&mut self, way: &Way) -> Result<(), LinkError> {
        self.play_all(&way.script).await
    }

    /// Queries the limits that bound the instrument and returns them as text. Limits without a
    /// reply are left out.
    pub async fn bounded_by(&mut self, bounds: &[Bound]) -> Vec<String> {
        let mut bounds_in_words = Vec::new();
        for Bound { query, words, unit } in bounds {
            // An instrument that fails to answer once is not queried again, because each further
            // timeout only takes time.
            let Ok(number) = self.number(query).await else {
                break;
            };
            // Each text appears once.
            let value = format!("{} {unit}", plain(number));
            match bounds_in_words
                .last_mut()
                .filter(|last: &&mut String| last.starts_with(words))
            {
                Some(last) => last.push_str(&format!(" and {value}")),
                None => bounds_in_words.push(format!("{words} {value}")),
            }
        }
        bounds_in_words
    }

    /// Returns the dialect in use.
    pub fn dialect(&self) -> &'static D {
        self.dialect
    }

    /// Returns the link, for reconnecting.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }
}

/// Converts milliseconds, for profiles.
pub(crate) const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}
