//! Each driver against the mock of its model: what reaches the world and in which order, and what is refused instead of believed.

use std::sync::{Arc, Mutex};

use instruments::{
    chiller,
    clock::{Clock, TimeMode},
    generator::{self, Sine},
    instrument::{Instrument, Model},
    link::{Link, LinkError, LinkOptions},
    load::{self, Discharge},
    logger,
    mock::{
        self, MockOptions,
        plant::{Action, BipolarState, Fixture},
    },
    scope::{self, Intent, Trigger, Vertical},
    supply::{self, Charge},
    supply4q::{self, Limits},
    transcript::Tap,
    transport::MemoryHub,
    units::{Amps, Celsius, Hertz, Seconds, Volts},
};

use crate::mocks_plant::{AMPLITUDE_V, FREQ_HZ, Recorder, base_v};

/// A mock on an in-process stream, its world, and bench time.
struct Served {
    plant: Arc<Mutex<Recorder>>,
    hub: MemoryHub,
    clock: Clock,
}

impl Served {
    fn new(model: &str, options: &MockOptions) -> Self {
        let (clock, hub) = (Clock::start(TimeMode::Virtual), MemoryHub::new());
        let plant = Arc::new(Mutex::new(Recorder::default()));
        let device = mock::make(model, plant.clone(), options).unwrap();
        mock::serve_memory(device, &hub, "device", clock.clone()).unwrap();
        Self { plant, hub, clock }
    }

    async fn open<D: Model + ?Sized>(&self, dialects: &[&'static D], key: &str) -> Instrument<D> {
        let dialect = dialects.iter().copied().find(|dialect| dialect.key() == key).unwrap();
        let options = LinkOptions {
            name: "dev".to_owned(),
            address: "memory:device".parse().unwrap(),
            profile: dialect.profile(),
            clock: self.clock.clone(),
            hub: self.hub.clone(),
            tap: Tap::none(),
        };
        Instrument::new(Link::open(options).await.unwrap(), dialect)
    }

    fn bipolar(&self) -> Vec<BipolarState> {
        let plant = self.plant.lock().unwrap();
        plant.actions.iter().filter_map(|(_, action)| if let Action::Bipolar(state) = action { Some(*state) } else { None }).collect()
    }

    fn last<T>(&self, pick: impl Fn(&Action) -> Option<T>) -> T {
        self.plant.lock().unwrap().actions.iter().rev().find_map(|(_, action)| pick(action)).unwrap()
    }
}

/// Runs a test of one model in virtual time.
fn with(model: &str, options: &MockOptions, test: impl AsyncFn(Served)) {
    Clock::runtime(TimeMode::Virtual).unwrap().block_on(async { test(Served::new(model, options)).await });
}

const LIMITS: Limits = Limits { compliance: Volts(4.3), current: Amps(2.0) };

#[test]
fn the_bipolar_supply_is_limited_and_handed_over_before_it_is_on() {
    with("kepco-bop-mg", &MockOptions::default(), async |served| {
        let mut supply = served.open(supply4q::DIALECTS, "kepco-bop-mg").await;
        supply.prepare(&LIMITS).await.unwrap();
        assert!(served.bipolar().iter().all(|state| !state.output_on));
        supply.energise().await.unwrap();
        let states = served.bipolar();
        let on = states.iter().find(|state| state.output_on).unwrap();
        assert!(on.current_mode && on.analog_input && on.off_is_open, "{on:?}");
        assert!((on.limit - 4.3).abs() < 1e-9, "{on:?}");
        let (volts, amps) = supply.measure().await.unwrap();
        assert_eq!((volts, amps), (Volts(3.75), Amps(-2.5)));
        supply.safe().await.unwrap();
        let off = *served.bipolar().last().unwrap();
        assert!(!off.output_on && off.off_is_open && !off.analog_input, "{off:?}");
    });
}

#[test]
fn a_supply_that_was_left_to_short_the_cell_when_off_is_opened_first() {
    with("kepco-bop-mg", &MockOptions { off_active: true, ..MockOptions::default() }, async |served| {
        let mut supply = served.open(supply4q::DIALECTS, "kepco-bop-mg").await;
        let before = served.bipolar().len();
        supply.safe().await.unwrap();
        supply.prepare(&LIMITS).await.unwrap();
        let after = &served.bipolar()[before..];
        assert!(!after.is_empty() && after.iter().all(|state| state.output_on || state.off_is_open), "{after:?}");
    });
}

#[test]
fn the_linear_supply_is_never_asked_to_select_its_analog_input() {
    with("kepco-bop-linear", &MockOptions::default(), async |served| {
        // Its mock puts an error into its queue for the command, and the link would report it.
        let mut supply = served.open(supply4q::DIALECTS, "kepco-bop-linear").await;
        supply.prepare(&LIMITS).await.unwrap();
        supply.energise().await.unwrap();
        let on = *served.bipolar().last().unwrap();
        assert!(on.output_on && on.current_mode && on.analog_input, "{on:?}");
        supply.safe().await.unwrap();
        assert!(!served.bipolar().last().unwrap().output_on);
        // The same instrument under the other name is refused, not half obeyed. It talks to one client at a time.
        drop(supply);
        let mut wrong = served.open(supply4q::DIALECTS, "kepco-bop-mg").await;
        let error = wrong.prepare(&LIMITS).await.unwrap_err();
        assert!(matches!(error, LinkError::Refused { .. }), "{error}");
    });
}

#[test]
fn every_driver_recognises_its_own_model_only() {
    for model in mock::MODELS.iter().map(|model| model.key).filter(|key| *key != "mock-jig") {
        with(model, &MockOptions::default(), async |served| {
            let mut known = Vec::new();
            macro_rules! ask {
                ($module:ident) => {
                    for dialect in $module::DIALECTS {
                        if $module::DIALECTS.iter().any(|other| other.key() == model) {
                            let identity = served.open($module::DIALECTS, model).await.identify().await.unwrap();
                            known.push((dialect.key(), dialect.recognises(&identity)));
                        } else {
                            let foreign = instruments::exchange::Identity::parse("ACME,X1,7,1.0");
                            assert!(!dialect.recognises(&foreign), "{}", dialect.key());
                        }
                    }
                };
            }
            ask!(supply4q);
            ask!(generator);
            ask!(scope);
            ask!(load);
            ask!(supply);
            ask!(chiller);
            ask!(logger);
            assert!(known.iter().any(|(key, recognised)| *key == model && *recognised), "{model}: {known:?}");
        });
    }
}

#[test]
fn the_generator_drives_true_volts_and_reports_what_it_clamps() {
    with("siglent-sdg1000x", &MockOptions::default(), async |served| {
        let mut generator = served.open(generator::DIALECTS, "siglent-sdg1000x").await;
        // An earlier user left it at 50 Ω, where an open input would see twice the volts.
        generator.link_mut().send("C1:OUTP LOAD,50").await.unwrap();
        generator.safe().await.unwrap();
        let sine = Sine { freq: Hertz(0.149_23), amplitude: Volts(0.5), offset: Volts(-0.28) };
        generator.sine(&sine).await.unwrap();
        generator.output(true).await.unwrap();
        let state = served.last(|action| if let Action::Generator(state) = action { Some(*state) } else { None });
        assert_eq!((state.freq_hz, state.amplitude_v, state.offset_v), (0.149_23, 0.5, -0.28));
        let error = generator.sine(&Sine { amplitude: Volts(25.0), ..sine }).await.unwrap_err();
        assert!(matches!(error, LinkError::ReadBack { .. }) && error.to_string().contains("expected AMP within"), "{error}");
        generator.quiet(Volts(-0.28)).await.unwrap();
        let state = served.last(|action| if let Action::Generator(state) = action { Some(*state) } else { None });
        assert_eq!((state.amplitude_v, state.offset_v), (0.001, -0.28));
        let error = generator.sine(&Sine { amplitude: Volts(f64::NAN), ..sine }).await.unwrap_err();
        assert!(error.to_string().contains("nothing was sent"), "{error}");
        generator.safe().await.unwrap();
        let state = served.last(|action| if let Action::Generator(state) = action { Some(*state) } else { None });
        assert_eq!((state.amplitude_v, state.offset_v), (0.0, 0.0));
    });
}

/// Everything up to the arming of the scope.
async fn arm(scope: &mut scope::Scope, offset: Volts) -> Result<(), LinkError> {
    scope.set(&Intent::Session { memory_points: 10_000 }).await?;
    for channel in 1..=4 {
        let offset = if channel == 4 { offset } else { Volts(-base_v(channel)) };
        scope.set(&Intent::Vertical(Vertical { channel, per_div: Volts(0.05), offset })).await?;
    }
    scope.set(&Intent::Timebase(Seconds(0.05))).await?;
    scope.set(&Intent::Trigger(Trigger { channel: 2, level: Volts(base_v(2)) })).await?;
    scope.set(&Intent::Arm).await
}

#[test]
fn the_scope_gives_the_volts_of_the_world_whatever_an_earlier_client_left() {
    with("siglent-sds800x-hd", &MockOptions { page_points: 700, ..MockOptions::default() }, async |served| {
        {
            let mut earlier = served.open(scope::DIALECTS, "siglent-sds800x-hd").await;
            for message in
                [":WAVeform:STARt 17", ":WAVeform:INTerval 9", ":WAVeform:WIDTh BYTE", ":WAVeform:POINt 5", ":WAVeform:SOURce C1"]
            {
                earlier.link_mut().send(message).await.unwrap();
            }
        }
        let mut scope = served.open(scope::DIALECTS, "siglent-sds800x-hd").await;
        arm(&mut scope, Volts(-3.8)).await.unwrap();
        served.clock.sleep_s(2.0).await;
        scope.stop().await.unwrap();
        for channel in 1..=4 {
            let waveform = scope.download(channel, 2_000).await.unwrap();
            assert_eq!(waveform.codes.len(), 2_000);
            assert!((waveform.interval_s - 0.5 / 2_000.0).abs() < 1e-9, "{}", waveform.interval_s);
            assert_eq!(waveform.clipped_share(), 0.0);
            let (least, greatest) = waveform.extremes_v();
            let lsb = 0.05 / 480.0;
            assert!((least - (base_v(channel) - AMPLITUDE_V)).abs() < lsb, "channel {channel}: {least}");
            assert!((greatest - (base_v(channel) + AMPLITUDE_V)).abs() < lsb, "channel {channel}: {greatest}");
            // One period is as long as the interval says: the sample a period later is the same.
            let period = (1.0 / FREQ_HZ / waveform.interval_s).round() as usize;
            assert!((i32::from(waveform.codes[10]) - i32::from(waveform.codes[10 + period])).abs() <= 32);
        }
    });
}

#[test]
fn what_the_scope_cannot_do_is_an_error_and_never_a_wrong_voltage() {
    with("siglent-sds800x-hd", &MockOptions::default(), async |served| {
        let mut scope = served.open(scope::DIALECTS, "siglent-sds800x-hd").await;
        // Nothing crosses the trigger level: there is no frame since the scope was armed.
        served.plant.lock().unwrap().silent_from_s = 1.0e-9;
        arm(&mut scope, Volts(-3.8)).await.unwrap();
        served.clock.sleep_s(2.0).await;
        scope.stop().await.unwrap();
        let error = scope.download(1, 1_000).await.unwrap_err();
        assert!(error.to_string().contains("no frame was completed"), "{error}");
        served.plant.lock().unwrap().silent_from_s = 0.0;
        // The instrument clamps the offset silently; the read-back shows it.
        scope.set(&Intent::Session { memory_points: 10_000 }).await.unwrap();
        let vertical = Vertical { channel: 4, per_div: Volts(0.002), offset: Volts(-3.8) };
        let error = scope.set(&Intent::Vertical(vertical)).await.unwrap_err();
        assert!(matches!(&error, LinkError::ReadBack { .. }) && error.to_string().contains("CHANnel4:OFFSet"), "{error}");
        // A channel far off its level clips, and says so.
        arm(&mut scope, Volts(-3.65)).await.unwrap();
        served.clock.sleep_s(2.0).await;
        scope.stop().await.unwrap();
        assert!(scope.download(4, 1_000).await.unwrap().clipped_share() > 0.1);
    });
}

#[test]
fn load_and_charger_are_limited_before_they_are_on_and_read_back() {
    with("siglent-sdl1000x", &MockOptions::default(), async |served| {
        let mut load = served.open(load::DIALECTS, "siglent-sdl1000x").await;
        load.prepare(&Discharge { current: Amps(5.0), stop_below: Volts(3.47) }).await.unwrap();
        let state = || served.last(|action| if let Action::Load(state) = action { Some(*state) } else { None });
        assert!(!state().input_on);
        load.energise().await.unwrap();
        assert_eq!((state().input_on, state().current_a, state().min_voltage_v), (true, 5.0, 3.47));
        assert_eq!(load.measure().await.unwrap(), (Volts(3.7), Amps(1.5)));
        let error = load.prepare(&Discharge { current: Amps(90.0), stop_below: Volts(3.0) }).await.unwrap_err();
        assert!(matches!(error, LinkError::ReadBack { .. }), "{error}");
        load.safe().await.unwrap();
        assert!(!state().input_on);
    });
    with("siglent-spd3303x", &MockOptions::default(), async |served| {
        let mut supply = served.open(supply::DIALECTS, "siglent-spd3303x").await;
        supply.prepare(&Charge { voltage: Volts(4.2), current: Amps(3.0) }).await.unwrap();
        let state = || served.last(|action| if let Action::Supply(state) = action { Some(*state) } else { None });
        assert!(!state().output_on);
        supply.energise().await.unwrap();
        assert_eq!((state().output_on, state().voltage_v, state().current_a), (true, 4.2, 3.0));
        supply.safe().await.unwrap();
        assert!(!state().output_on);
    });
}

#[test]
fn a_chiller_in_manual_mode_is_told_apart_from_one_that_obeys() {
    with("julabo", &MockOptions { strict_pacing: true, ..MockOptions::default() }, async |served| {
        let mut chiller = served.open(chiller::DIALECTS, "julabo").await;
        chiller.start(Celsius(25.0)).await.unwrap();
        assert_eq!(chiller.temperature().await.unwrap(), Celsius(24.5));
        let state = served.last(|action| if let Action::Chiller(state) = action { Some(*state) } else { None });
        assert!(state.running && (state.setpoint_c - 25.0).abs() < 1e-9, "{state:?}");
        assert!(chiller.status().await.unwrap().running);
        chiller.stop().await.unwrap();
        assert!(!chiller.status().await.unwrap().running);
    });
    with("julabo", &MockOptions { local: true, ..MockOptions::default() }, async |served| {
        let mut chiller = served.open(chiller::DIALECTS, "julabo").await;
        let error = chiller.start(Celsius(25.0)).await.unwrap_err();
        assert!(error.to_string().contains("expected remote mode"), "{error}");
    });
}

#[test]
fn an_open_thermocouple_is_no_temperature() {
    with("keysight-34970a", &MockOptions::default(), async |served| {
        let mut logger = served.open(logger::DIALECTS, "keysight-34970a").await.on_channels(vec![104, 101]);
        logger.configure().await.unwrap();
        let readings = logger.scan().await.unwrap();
        assert_eq!(readings.len(), 2);
        assert!((readings[1].unwrap().value() - 25.374).abs() < 1e-6 && readings[0].is_none(), "{readings:?}");
        let mut other = logger.on_channels(vec![101]);
        let error = other.scan().await.unwrap_err();
        assert!(error.to_string().contains("expected 1 readings"), "{error}");
    });
}

#[test]
fn the_jig_holds_what_it_was_told_to() {
    with("mock-jig", &MockOptions::default(), async |served| {
        let options = LinkOptions {
            name: "jig".to_owned(),
            address: "memory:device".parse().unwrap(),
            profile: instruments::jig::Jig::profile(),
            clock: served.clock.clone(),
            hub: served.hub.clone(),
            tap: Tap::none(),
        };
        let mut jig = instruments::jig::Jig::new(Link::open(options).await.unwrap());
        for fixture in [Fixture::Shunt, Fixture::FakeCell, Fixture::Cell] {
            jig.mount(fixture).await.unwrap();
            assert_eq!(served.plant.lock().unwrap().fixture, Some(fixture));
        }
    });
}

#[test]
fn a_refused_message_does_not_keep_the_rest_of_a_switching_off_from_being_sent() {
    use instruments::exchange::{Exchange, play_all};
    with("kepco-bop-linear", &MockOptions::default(), async |served| {
        let mut supply = served.open(supply4q::DIALECTS, "kepco-bop-linear").await;
        supply.prepare(&LIMITS).await.unwrap();
        supply.energise().await.unwrap();
        let script = [Exchange::send("OUTP:MODE BATTERY"), Exchange::switch("OUTP", false)];
        let error = play_all(supply.link_mut(), &script).await.unwrap_err();
        assert!(error.to_string().contains("OUTP:MODE BATTERY"), "{error}");
        assert!(!served.bipolar().last().unwrap().output_on);
    });
}
