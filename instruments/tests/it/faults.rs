//! Seeded faults between a link and a simulated instrument: every reply of the link is right, or
//! the link reports an error.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use instruments::{
    chiller,
    clock::{Clock, TimeMode},
    exchange::Exchange,
    generator,
    link::{Link, LinkProfile},
    load, logger,
    mock::{
        self, Fault, FaultLog, MockOptions, Schedule, make_troubled,
        plant::{Action, BipolarState},
    },
    supply, supply4q,
    transcript::Tap,
    transport::MemoryHub,
};

use crate::{
    device::open,
    drivers_common::in_virtual_time,
    mocks_plant::Recorder,
    transports::{Kind, serve},
};

const MODEL: &str = "kepco-bop-mg";

async fn troubled(clock: &Clock, schedule: &Schedule) -> (Link, FaultLog, Arc<Mutex<Recorder>>) {
    let (hub, log) = (MemoryHub::new(), FaultLog::default());
    let plant = Arc::new(Mutex::new(Recorder::default()));
    let device = make_troubled(
        MODEL,
        plant.clone(),
        &MockOptions::default(),
        schedule,
        &log,
    )
    .unwrap();
    mock::serve_memory(device, &hub, "device", clock.clone()).unwrap();
    let link = open(
        "memory:device",
        LinkProfile::scpi(),
        clock,
        &hub,
        Tap::none(),
    )
    .await
    .unwrap();
    (link, log, plant)
}

/// Queries two different numbers in turn and reconnects whenever the link was dropped. Returns the
/// wrong replies and the number of replies.
async fn converse(link: &mut Link, rounds: usize) -> (Vec<String>, usize) {
    let (mut wrong, mut right) = (Vec::new(), 0);
    for round in 0..rounds {
        if link.is_dropped() && link.reconnect().await.is_err() {
            continue;
        }
        let (query, expected) = [("MEAS:VOLT?", "3.75E0"), ("MEAS:CURR?", "-2.5E0")][round % 2];
        match link.query(query).await {
            Ok(answer) if answer == expected => right += 1,
            Ok(answer) => wrong.push(answer),
            Err(_) => {}
        }
    }
    (wrong, right)
}

#[test]
fn no_question_gets_the_answer_to_another_one_whatever_goes_wrong_on_the_wire() {
    for fault in Fault::ALL {
        let (mut happened, mut answered, mut wrong) = (0, 0, Vec::new());
        for seed in 0..40 {
            in_virtual_time(async |clock| {
                let schedule = Schedule {
                    seed,
                    per_message: 0.15,
                    most: 12,
                    faults: vec![fault],
                    ..Schedule::default()
                };
                let (mut link, log, _) = troubled(&clock, &schedule).await;
                let (other, right) = converse(&mut link, 60).await;
                wrong.extend(other);
                answered += right;
                happened += log.lock().unwrap().len();
            });
        }
        assert!(
            happened > 150 && answered > 1000,
            "{fault:?}: {happened} faults, {answered} answers"
        );
        // A garbled byte cannot be distinguished from the right one, and neither can one reply out
        // of two.
        if fault != Fault::Garble {
            assert_eq!(wrong, [""; 0], "{fault:?}");
        }
    }
}

#[test]
fn a_schedule_is_the_same_each_time_and_another_seed_is_another_one() {
    let logs = [7, 7, 8].map(|seed| {
        let mut events = Vec::new();
        in_virtual_time(async |clock| {
            let schedule = Schedule {
                seed,
                per_message: 0.2,
                most: 20,
                faults: Fault::ALL.to_vec(),
                ..Schedule::default()
            };
            let (mut link, log, _) = troubled(&clock, &schedule).await;
            converse(&mut link, 80).await;
            events = log
                .lock()
                .unwrap()
                .iter()
                .map(|happened| (happened.fault, happened.message.clone()))
                .collect();
        });
        events
    });
    assert!(logs[0].len() > 5, "{logs:?}");
    assert_eq!(logs[0], logs[1]);
    assert_ne!(logs[0], logs[2]);
}

#[test]
fn a_power_cut_and_a_hand_at_the_panel_switch_the_output_off() {
    for fault in [Fault::PowerCycle, Fault::OutputOff] {
        in_virtual_time(async |clock| {
            let schedule = Schedule {
                seed: 1,
                per_message: 0.1,
                most: 1,
                faults: vec![fault],
                ..Schedule::default()
            };
            let (mut link, log, plant) = troubled(&clock, &schedule).await;
            link.send("OUTP ON").await.unwrap();
            for _ in 0..100 {
                // The question that the power cut swallows fails.
                let _ = link.query("CURR?").await;
                if !log.lock().unwrap().is_empty() {
                    break;
                }
            }
            let states: Vec<bool> = plant
                .lock()
                .unwrap()
                .actions
                .iter()
                .map(|(_, action)| {
                    matches!(
                        action,
                        Action::Bipolar(BipolarState {
                            output_on: true,
                            ..
                        })
                    )
                })
                .collect();
            assert_eq!(states, [false, true, false], "{fault:?}");
        });
    }
}

/// Fifty seconds of the bench in one: a late answer is late at once.
const PACE: f64 = 50.0;

/// One fault after the other on a real port; gives wrong answers, right answers and the number of
/// faults.
async fn on_a_port(kind: Kind, fault: Fault, clock: &Clock) -> (Vec<String>, usize, usize) {
    let (hub, log) = (MemoryHub::new(), FaultLog::default());
    let schedule = Schedule {
        seed: 3,
        per_message: 0.2,
        most: 2,
        faults: vec![fault],
        ..Schedule::default()
    };
    let plant = Arc::new(Mutex::new(Recorder::default()));
    let device = make_troubled(MODEL, plant, &MockOptions::default(), &schedule, &log).unwrap();
    let address = serve(kind, device, clock, &hub).await;
    let profile = LinkProfile {
        first_timeout: Duration::from_secs(2),
        timeout: Duration::from_millis(70),
        ..LinkProfile::scpi()
    };
    let mut link = open(&address.to_string(), profile, clock, &hub, Tap::none())
        .await
        .unwrap();
    let (wrong, right) = converse(&mut link, 20).await;
    let happened = log.lock().unwrap().len();
    (wrong, right, happened)
}

#[test]
#[ignore = "long drill"]
fn over_every_transport_the_faults_lead_to_no_wrong_answer() {
    for kind in [Kind::Vxi11, Kind::HiSlip, Kind::UsbTmc, Kind::Gpib] {
        let (mut happened, mut answered) = (0, 0);
        for fault in Fault::ALL {
            Clock::runtime(TimeMode::Scaled(PACE))
                .unwrap()
                .block_on(async {
                    let (wrong, right, faults) =
                        on_a_port(kind, fault, &Clock::start(TimeMode::Scaled(PACE))).await;
                    assert!(
                        fault == Fault::Garble || wrong.is_empty(),
                        "{kind:?} {fault:?}: {wrong:?}"
                    );
                    (happened, answered) = (happened + faults, answered + right);
                });
        }
        assert!(
            happened > Fault::ALL.len() && answered > 10 * Fault::ALL.len(),
            "{kind:?}: {happened} faults, {answered} answers"
        );
    }
}

/// The text that an exchange sends first.
fn command(exchange: &Exchange) -> &str {
    match exchange {
        Exchange::Send(message) | Exchange::Set { message, .. } | Exchange::Ask { message, .. } => {
            message
        }
        Exchange::Data { head, .. } => head,
        Exchange::Refuse { message, .. } => panic!("{message} cannot be sent"),
    }
}

/// The faults must recognise every command that a driver sends to switch its output off, and no
/// other.
fn knows_what_switches_off(key: &str, off: &[Exchange], on: &[Exchange]) {
    let messages = &mock::model(key).unwrap().messages;
    let count = |script: &[Exchange]| {
        let texts = script.iter().map(command);
        texts
            .filter(|text| messages.switches_off(text.as_bytes()))
            .count()
    };
    assert_eq!((count(off), count(on)), (1, 0), "{key}: {off:?}");
}

/// The faults must recognise every measurement query of a driver.
fn knows_what_measures(key: &str, questions: &[&str]) {
    let messages = &mock::model(key).unwrap().messages;
    for question in questions {
        assert!(messages.measures(question.as_bytes()), "{key}: {question}");
    }
}

#[test]
fn the_faults_know_what_the_drivers_send() {
    for driver in supply4q::DIALECTS {
        knows_what_switches_off(driver.key(), &driver.output(false), &driver.output(true));
        knows_what_measures(driver.key(), &driver.measure());
    }
    for driver in supply::DIALECTS {
        knows_what_switches_off(driver.key(), &driver.output(false), &driver.output(true));
        knows_what_measures(driver.key(), &driver.measure());
    }
    for driver in load::DIALECTS {
        knows_what_switches_off(driver.key(), &driver.input(false), &driver.input(true));
        knows_what_measures(driver.key(), &driver.measure());
    }
    for driver in generator::DIALECTS {
        for channel in [1, 2] {
            let (off, on) = (driver.output(channel, false), driver.output(channel, true));
            knows_what_switches_off(driver.key(), &off, &on);
        }
    }
    for driver in chiller::DIALECTS {
        knows_what_measures(driver.key(), &driver.queries()[..1]);
    }
    for driver in logger::DIALECTS {
        knows_what_measures(driver.key(), &[driver.scan()]);
    }
}
