//! A world for the tests of the mocks: it records the actions on it, shows fixed readings and
//! carries a known sine on every scope channel.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::{
    f64::consts::TAU,
    sync::{Arc, Mutex},
};

use instruments::{
    fixture::Fixture,
    mock::{
        self, Device, MockOptions,
        plant::{Action, DigitiseRequest, Meter, Plant, TriggerSearch},
    },
};

pub(crate) const FREQ_HZ: f64 = 10.0;
pub(crate) const AMPLITUDE_V: f64 = 0.1;

/// Constant part of a channel's voltage.
pub(crate) fn base_v(channel: u8) -> f64 {
    [0.0, 0.5, 1.0, 3.8][usize::from(channel) - 1]
}

/// The voltage of every channel: a sine that starts at zero, rising, at time zero.
pub(crate) fn volts(channel: u8, t_s: f64) -> f64 {
    base_v(channel) + AMPLITUDE_V * (TAU * FREQ_HZ * t_s).sin()
}

#[derive(Default)]
pub(crate) struct Recorder {
    pub(crate) actions: Vec<(f64, Action)>,
    pub(crate) requests: Vec<DigitiseRequest>,
    pub(crate) searches: Vec<TriggerSearch>,
    pub(crate) fixture: Option<Fixture>,
    pub(crate) shape: Option<Arc<[f64]>>,
    /// The sine is there only before this time; 0 for ever.
    pub(crate) silent_from_s: f64,
}

impl Plant for Recorder {
    fn shape(&mut self, _: f64, steps: Option<Arc<[f64]>>) {
        self.shape = steps;
    }

    fn act(&mut self, t_s: f64, action: Action) {
        self.actions.push((t_s, action));
    }

    fn read(&mut self, _: f64, meter: Meter) -> f64 {
        match meter {
            Meter::BipolarVolts => 3.75,
            Meter::BipolarAmps => -2.5,
            Meter::LoadVolts => 3.7,
            Meter::LoadAmps => 1.5,
            Meter::SupplyVolts => 4.0,
            Meter::SupplyAmps => 1.25,
            Meter::BathCelsius => 24.5,
            Meter::CellCelsius => 25.374,
            Meter::AmbientCelsius => 22.0,
        }
    }

    /// Crossings of the middle of the sine only: the tests set no other level.
    fn find_trigger(&mut self, t_s: f64, search: &TriggerSearch) -> Option<f64> {
        assert!(
            search.to_s <= t_s && search.from_s <= search.to_s,
            "a search must lie in the past and not run backwards: {search:?} at {t_s}"
        );
        self.searches.push(*search);
        if (search.level_v - base_v(search.channel)).abs() > 1e-9 {
            return None;
        }
        let phase = if search.rising { 0.0 } else { 0.5 };
        let end_s = if self.silent_from_s > 0.0 {
            search.to_s.min(self.silent_from_s)
        } else {
            search.to_s
        };
        let crossing_s = ((end_s * FREQ_HZ - phase + 1e-9).floor() + phase) / FREQ_HZ;
        (crossing_s >= search.from_s - 1e-9).then_some(crossing_s)
    }

    fn digitise(&mut self, t_s: f64, request: &DigitiseRequest) -> Vec<i16> {
        self.requests.push(*request);
        (0..request.count)
            .map(|i| {
                let index = request.first + i as u64 * request.stride;
                let at_s = request.start_s + index as f64 * request.interval_s;
                assert!(
                    at_s <= t_s + 1e-9,
                    "sample {index} at {at_s} lies in the future of {t_s}"
                );
                let code = ((volts(request.channel, at_s) + request.offset_v)
                    * request.codes_per_volt)
                    .round();
                code.clamp(request.code_min.into(), request.code_max.into()) as i16
            })
            .collect()
    }

    fn mount(&mut self, _: f64, fixture: Fixture) {
        self.fixture = Some(fixture);
    }

    fn mounted(&self) -> Fixture {
        self.fixture.unwrap_or(Fixture::Cell)
    }
}

/// A mock and the world that it observes.
pub(crate) struct Bench {
    pub(crate) device: Box<dyn Device>,
    pub(crate) plant: Arc<Mutex<Recorder>>,
    pub(crate) now_s: f64,
}

impl Bench {
    pub(crate) fn new(model: &str) -> Self {
        Self::with(
            model,
            &MockOptions {
                serial_number: "TEST1".to_owned(),
                ..MockOptions::default()
            },
        )
    }

    pub(crate) fn with(model: &str, options: &MockOptions) -> Self {
        let plant = Arc::new(Mutex::new(Recorder::default()));
        let device = mock::make(model, plant.clone(), options).unwrap();
        Self {
            device,
            plant,
            now_s: 0.0,
        }
    }

    pub(crate) fn bytes(&mut self, message: &str) -> Vec<u8> {
        self.device.handle(self.now_s, message.as_bytes())
    }

    pub(crate) fn ask(&mut self, message: &str) -> String {
        String::from_utf8(self.bytes(message)).unwrap()
    }

    /// Sends commands that have no answer.
    pub(crate) fn send(&mut self, messages: &[&str]) {
        for message in messages {
            assert_eq!(self.ask(message), "", "answer to {message}");
        }
    }

    /// Each message and the whole reply to it.
    pub(crate) fn table(&mut self, rows: &[(&str, &str)]) {
        for (message, reply) in rows {
            assert_eq!(self.ask(message), *reply, "reply to {message}");
        }
    }

    pub(crate) fn last_action(&self) -> Action {
        self.plant.lock().unwrap().actions.last().unwrap().1
    }
}
