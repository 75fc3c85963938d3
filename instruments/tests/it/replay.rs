//! A recorded conversation served again: the driver that had it gets through, another one is
//! stopped at the first difference.

use instruments::{
    clock::Clock,
    instrument::Instrument,
    mock::{self, Divergence, Outcome, Replay},
    scpi::decode::Terminator,
    supply::{self, Charge},
    transcript::{Tap, Transcript},
    transport::MemoryHub,
    units::{Amps, Volts},
};

use crate::{
    device::{SharedText, open},
    drivers_common::{Rig, dialect, in_virtual_time},
};

const MODEL: &str = "keysight-e36312a";
const CHARGE: Charge = Charge {
    voltage: Volts(4.2),
    current: Amps(1.25),
};

/// A charge prepared, begun and ended over a link.
async fn charge(
    tape: &SharedText,
    clock: &Clock,
    hub: &MemoryHub,
    current: f64,
) -> Result<(), String> {
    let dialect = dialect!(supply, MODEL);
    let link = open(
        "memory:device",
        dialect.profile(),
        clock,
        hub,
        Tap::new(tape.clone()),
    )
    .await
    .unwrap();
    let mut supply = Instrument::new(link, dialect);
    let charge = Charge {
        current: Amps(current),
        ..CHARGE
    };
    let played = async {
        supply.prepare(&charge).await?;
        supply.energise().await?;
        supply.measure().await?;
        supply.safe().await
    };
    played.await.map_err(|error| error.to_string())
}

fn serve(text: &str, clock: &Clock) -> (MemoryHub, Outcome, usize) {
    let transcript = Transcript::parse(text).unwrap();
    let (replay, outcome) = Replay::new(&transcript, "dev", Terminator::Lf);
    let (hub, messages) = (MemoryHub::new(), replay.messages().count());
    mock::serve_memory(Box::new(replay), &hub, "device", clock.clone()).unwrap();
    (hub, outcome, messages)
}

#[test]
fn the_same_driver_gets_through_and_another_current_is_the_first_difference() {
    in_virtual_time(async |clock| {
        let (tape, again) = (SharedText::default(), SharedText::default());
        let rig = Rig::lying(clock.clone(), MODEL, &[]);
        charge(&tape, &clock, rig.hub(), 1.25).await.unwrap();

        let (hub, outcome, messages) = serve(&tape.text(), &clock);
        charge(&again, &clock, &hub, 1.25).await.unwrap();
        assert_eq!((outcome.followed(), outcome.divergence()), (messages, None));
        assert!(messages > 15, "{messages}");
        assert_eq!(tape.lines(), again.lines());

        let (hub, outcome, messages) = serve(&tape.text(), &clock);
        let failed = charge(&again, &clock, &hub, 2.0).await.unwrap_err();
        assert!(
            failed.starts_with("dev: expected an answer to "),
            "{failed}"
        );
        let Some(Divergence::Other {
            number,
            expected,
            met,
        }) = outcome.divergence()
        else {
            panic!("{outcome:?}")
        };
        assert_eq!(
            (expected.as_str(), met.as_str()),
            ("CURR 1.250,(@1)", "CURR 2.000,(@1)")
        );
        assert!(number < messages && outcome.followed() == number - 1);
    });
}
