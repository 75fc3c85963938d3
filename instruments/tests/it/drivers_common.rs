//! The drivers against the simulated instruments: common parts. Each role has its own file.

use std::sync::{Arc, Mutex};

use instruments::{
    chiller,
    clock::{Clock, TimeMode},
    exchange::{Exchange, Identity, play, play_all},
    fixture::Fixture,
    generator,
    instrument::Instrument,
    jig::Jig,
    link::{Grammar, Link, LinkProfile},
    load, logger,
    mock::{
        self, Device, MODELS, MockOptions,
        plant::{Action, BipolarState, GeneratorState, LoadState, SupplyState},
    },
    scope,
    scpi::decode::Terminator,
    supply, supply4q,
    transcript::Tap,
    transport::MemoryHub,
};
use proptest::prelude::*;

use crate::{
    device::{SharedText, open},
    mocks_plant::Recorder,
};

/// The dialect with this key in a role's table.
macro_rules! dialect {
    ($role:ident, $key:expr) => {
        *$role::DIALECTS
            .iter()
            .find(|dialect| dialect.key() == $key)
            .unwrap()
    };
}
pub(crate) use dialect;

/// One simulated instrument in process, its world, and all messages sent to it.
pub(crate) struct Rig {
    pub(crate) clock: Clock,
    pub(crate) plant: Arc<Mutex<Recorder>>,
    hub: MemoryHub,
    tape: SharedText,
}

/// Answers some messages itself, as an instrument with a fault or another firmware does, and hands
/// on the rest.
struct Liar {
    device: Box<dyn Device>,
    lies: Vec<(&'static str, &'static [u8])>,
}

impl Device for Liar {
    fn terminator(&self) -> Terminator {
        self.device.terminator()
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        let lie = self
            .lies
            .iter()
            .find(|(asked, _)| asked.as_bytes() == message);
        lie.map_or_else(
            || self.device.handle(now_s, message),
            |(_, answer)| answer.to_vec(),
        )
    }

    fn connected(&mut self, now_s: f64) {
        self.device.connected(now_s);
    }

    fn late_s(&self, now_s: f64) -> f64 {
        self.device.late_s(now_s)
    }

    fn end_late_s(&self) -> f64 {
        self.device.end_late_s()
    }
}

/// Defines functions of a rig that return the states of its instrument, in their order.
macro_rules! states {
    ($($name:ident: $action:ident($state:ident),)+) => {
        impl Rig {
            $(pub(crate) fn $name(&self) -> Vec<$state> {
                let state = |action| match action {
                    Action::$action(state) => state,
                    other => panic!("expected a state of another instrument, found {other:?}"),
                };
                self.actions().into_iter().map(state).collect()
            })+
        }
    };
}
states! {
    loads: Load(LoadState),
    supplies: Supply(SupplyState),
    waves: Generator(GeneratorState),
    drives: Bipolar(BipolarState),
}

impl Rig {
    pub(crate) fn new(clock: Clock, model: &str) -> Self {
        Self::lying(clock, model, &[])
    }

    /// An instrument that answers some messages with these lies.
    pub(crate) fn lying(clock: Clock, model: &str, lies: &[(&'static str, &'static [u8])]) -> Self {
        Self::with(clock, model, &MockOptions::default(), lies)
    }

    pub(crate) fn with(
        clock: Clock,
        model: &str,
        options: &MockOptions,
        lies: &[(&'static str, &'static [u8])],
    ) -> Self {
        let (hub, plant) = (MemoryHub::new(), Arc::new(Mutex::new(Recorder::default())));
        let device = mock::make(model, plant.clone(), options).unwrap();
        let liar = Liar {
            device,
            lies: lies.to_vec(),
        };
        mock::serve_memory(Box::new(liar), &hub, "device", clock.clone()).unwrap();
        Self {
            clock,
            plant,
            hub,
            tape: SharedText::default(),
        }
    }

    pub(crate) async fn link(&self, profile: LinkProfile) -> Link {
        open(
            "memory:device",
            profile,
            &self.clock,
            &self.hub,
            Tap::new(self.tape.clone()),
        )
        .await
        .unwrap()
    }

    /// Returns the hub on which the instrument listens, as `device`.
    pub(crate) fn hub(&self) -> &MemoryHub {
        &self.hub
    }

    /// Another client uses the instrument, and disconnects.
    pub(crate) async fn earlier_user(&self, terminator: Terminator, messages: &[&str]) {
        let profile = LinkProfile {
            grammar: Grammar::Plain,
            terminator,
            error_query: None,
            ..LinkProfile::scpi()
        };
        let mut link = open(
            "memory:device",
            profile,
            &self.clock,
            &self.hub,
            Tap::none(),
        )
        .await
        .unwrap();
        for message in messages {
            link.send_unchecked(message).await.unwrap();
        }
        // The messages are read before the connection closes.
        self.clock.sleep_s(1.0).await;
    }

    /// Answer of an instrument afterwards to another client.
    pub(crate) async fn ask(&self, query: &str) -> String {
        let profile = LinkProfile {
            error_query: None,
            ..LinkProfile::scpi()
        };
        open(
            "memory:device",
            profile,
            &self.clock,
            &self.hub,
            Tap::none(),
        )
        .await
        .unwrap()
        .query(query)
        .await
        .unwrap()
    }

    /// The shape that the generator's signal has instead of a sine.
    pub(crate) fn shape(&self) -> Option<Arc<[f64]>> {
        self.plant.lock().unwrap().shape.clone()
    }

    /// All that was sent by the links of [`Self::link`], without the questions after the error
    /// queue.
    pub(crate) fn sent(&self) -> Vec<String> {
        let lines = self.tape.lines();
        lines
            .iter()
            .filter_map(|line| line.strip_prefix("dev > "))
            .filter(|line| !["SYST:ERR?", ":SYSTem:ERRor?"].contains(line))
            .map(str::to_owned)
            .collect()
    }

    /// Actions of the instrument on its world, from the start.
    pub(crate) fn actions(&self) -> Vec<Action> {
        self.plant
            .lock()
            .unwrap()
            .actions
            .iter()
            .map(|(_, action)| *action)
            .collect()
    }

    pub(crate) fn last_action(&self) -> Action {
        *self.actions().last().unwrap()
    }
}

pub(crate) fn in_virtual_time(test: impl AsyncFnOnce(Clock)) {
    in_time(TimeMode::Virtual, test);
}

pub(crate) fn in_time(mode: TimeMode, test: impl AsyncFnOnce(Clock)) {
    Clock::runtime(mode)
        .unwrap()
        .block_on(async { test(Clock::start(mode)).await });
}

/// Keys of the dialects, of every role, that take this identity for their own.
fn recognised_by(identity: &Identity) -> Vec<&'static str> {
    let mut keys = Vec::new();
    macro_rules! collect {
        ($($role:ident),+) => {
            $(keys.extend(
                $role::DIALECTS
                    .iter()
                    .filter(|dialect| dialect.recognises(identity))
                    .map(|dialect| dialect.key()),
            );)+
        };
    }
    collect!(supply4q, generator, scope, load, supply, chiller, logger);
    keys
}

#[test]
fn every_dialect_recognises_its_own_model_and_no_other() {
    in_virtual_time(async |clock| {
        for model in MODELS {
            let rig = Rig::new(clock.clone(), model.key);
            macro_rules! identify {
                ($role:ident) => {{
                    let dialect = dialect!($role, model.key);
                    Instrument::new(rig.link(dialect.profile()).await, dialect)
                        .identify()
                        .await
                        .unwrap()
                }};
            }
            let identity = match model.role {
                "supply4q" => identify!(supply4q),
                "generator" => identify!(generator),
                "scope" => identify!(scope),
                "load" => identify!(load),
                "supply" => identify!(supply),
                "chiller" => identify!(chiller),
                "logger" => identify!(logger),
                _ => Jig::new(rig.link(Jig::profile()).await)
                    .identify()
                    .await
                    .unwrap(),
            };
            let expected: &[&str] = if model.role == "jig" {
                &[]
            } else {
                &[model.key]
            };
            assert_eq!(recognised_by(&identity), expected, "{}", identity.raw);
            for raw in [
                identity.raw.to_uppercase(),
                identity.raw.to_lowercase(),
                identity.raw.replace(' ', "   ").replace(',', " , "),
            ] {
                let spelled = Identity::parse(&raw);
                assert_eq!(recognised_by(&spelled), expected, "{raw}");
                assert!(spelled.is_same_instrument(&identity), "{raw}");
            }
            assert_eq!(
                rig.sent().len(),
                1,
                "identifying sends one question: {:?}",
                rig.sent()
            );
        }
    });
}

#[test]
fn models_of_the_same_makers_that_differ_are_not_recognised() {
    for answer in [
        "Siglent Technologies,SPD1305X,SPD1XXXX,2.01.01.06,V2.2",
        "Siglent Technologies,SDS1104X-E,SDSMMFCX5R3333,8.2.6.1.37R2",
        "Siglent Technologies,SDG1025,SDG1XXXX,1.0",
        "Siglent Technologies,SDM3045X,SDM34HBC900580,1.02.01.28",
        "HEWLETT-PACKARD,34401A,0,10-5-2",
        "KEPCO,BOP1KW 36-28 ,E156884, 2.01",
        "",
    ] {
        assert_eq!(recognised_by(&Identity::parse(answer)), [""; 0], "{answer}");
    }
}

fn bad_then_on() -> [Exchange; 3] {
    [
        Exchange::send("NONSENSE 1"),
        Exchange::send("CURR 99"),
        Exchange::switch("OUTP", true),
    ]
}

#[test]
fn a_script_stops_at_a_refused_message_and_switching_off_does_not() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "kepco-bop-mg");
        let mut link = rig.link(LinkProfile::scpi()).await;
        let on = |rig: &Rig| {
            matches!(
                rig.last_action(),
                Action::Bipolar(BipolarState {
                    output_on: true,
                    ..
                })
            )
        };
        let refused = "dev: `NONSENSE 1` was refused: -113, Undefined header";
        assert_eq!(
            play(&mut link, &[], &bad_then_on())
                .await
                .unwrap_err()
                .to_string(),
            refused
        );
        assert!(
            !on(&rig),
            "nothing is sent after a message that was refused"
        );
        assert_eq!(
            play_all(&mut link, &[], &bad_then_on())
                .await
                .unwrap_err()
                .to_string(),
            refused
        );
        assert!(on(&rig), "everything is sent");
        assert_eq!(
            rig.sent(),
            ["NONSENSE 1", "NONSENSE 1", "CURR 99", "OUTP ON", "OUTP?"]
        );
    });
}

#[test]
fn the_jig_changes_hands_and_says_when_it_does_not() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock.clone(), "mock-jig");
        let mut jig = Jig::new(rig.link(Jig::profile()).await);
        for fixture in [Fixture::Shunt, Fixture::FakeCell, Fixture::Cell] {
            jig.mount(fixture).await.unwrap();
            assert_eq!(rig.plant.lock().unwrap().fixture, Some(fixture));
        }
        let rig = Rig::lying(clock, "mock-jig", &[("JIG:MOUNT?", b"CELL\n")]);
        let stuck = Jig::new(rig.link(Jig::profile()).await)
            .mount(Fixture::Shunt)
            .await
            .unwrap_err();
        assert_eq!(
            stuck.to_string(),
            "dev: after `JIG:MOUNT SHUNT`, `JIG:MOUNT?` answered `CELL`: expected one of SHUNT, \
            SHUN"
        );
    });
}

proptest! {
    #[test]
    fn any_text_is_judged_without_a_panic(answer in "\\PC{0,30}", digits in "[-+0-9.eE]{0,12}") {
        for text in [&answer, &digits] {
            let _ = instruments::exchange::leading_number(text);
            let _ = instruments::exchange::field(text, "AMP");
            let _ = instruments::exchange::hex_word(text);
            prop_assert_eq!(&Identity::parse(text).raw, text.trim());
        }
    }
}
