//! Events and telemetry as an external program receives them. Needs `nats-server` in the PATH,
//! and reports if it is missing.
use std::{collections::BTreeSet, time::Duration};

use async_nats::jetstream::{self, consumer::push::OrderedConfig};
use bench_fleet::{JobState, standing::OrderKind};
use futures_util::StreamExt;
use serde_json::Value;

use crate::{
    protocol::Lab,
    support::{clock, pause, until, work},
};

/// Messages of a stream from its beginning up to one that is the last, each with its subject.
async fn heard(lab: &Lab, stream: &str, is_last: impl Fn(&Value) -> bool) -> Vec<Heard> {
    let client = async_nats::connect(lab.broker.address()).await.unwrap();
    let config = OrderedConfig {
        deliver_subject: client.new_inbox(),
        ..Default::default()
    };
    let stream = jetstream::new(client).get_stream(stream).await.unwrap();
    let consumer = stream.create_consumer(config).await.unwrap();
    let mut messages = consumer.messages().await.unwrap();
    let (clock, mut all) = (clock(), Vec::new());
    loop {
        let next = clock
            .deadline(Duration::from_secs(30), messages.next())
            .await;
        let message = next.unwrap().unwrap().unwrap();
        let heard = Heard {
            subject: message.subject.to_string(),
            value: serde_json::from_slice(&message.payload).unwrap(),
        };
        let ends = is_last(&heard.value);
        all.push(heard);
        if ends {
            return all;
        }
    }
}

/// A message.
struct Heard {
    subject: String,
    value: Value,
}

impl Heard {
    fn word(&self, key: &str) -> &str {
        self.value[key].as_str().unwrap_or_default()
    }

    fn fields(&self) -> BTreeSet<&str> {
        let fields = self.value.as_object().unwrap().keys();
        fields.map(String::as_str).collect()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn states_jobs_and_readings_of_a_bench_are_published_with_the_documented_fields() {
    let Some(lab) = Lab::open().await else { return };
    // Longer than telemetry takes to come for the first time.
    let machine = lab.machine("b1", 12.0);
    let _daemon = lab.daemon(&machine);
    lab.knows("b1").await;
    let refused = bench_fleet::Submission {
        text: "not b1".to_owned(),
        ..work("refused", 1)
    };
    let refused = lab.submit(&refused).await;
    until("a refusal", 20.0, async || {
        !lab.job(&refused).await.job.refused.is_empty()
    })
    .await;
    let job = lab.submit(&work("work", 1)).await;
    lab.is(&job, JobState::Done).await;
    pause(2.0).await;
    lab.say("b1", OrderKind::Hold).await;
    let events = heard(&lab, "eis-lab-event", |event| event["state"] == "held").await;
    let fields = ["bench", "job", "site", "state", "unix_s", "what", "words"];
    for event in &events {
        assert_eq!(event.subject, "eis.lab.event.north.b1");
        assert_eq!(event.fields(), BTreeSet::from(fields));
        assert!(event.value["unix_s"].as_f64().unwrap() > 1.7e9);
        assert_eq!((event.word("site"), event.word("bench")), ("north", "b1"));
    }
    let of = |is_state: bool| {
        let wanted = events.iter();
        wanted.filter(move |event| (event.word("what") == "state") == is_state)
    };
    let states: Vec<_> = of(true).map(|event| event.word("state")).collect();
    assert_eq!(states, ["idle", "running", "idle", "held"]);
    let last = events.last().unwrap();
    assert_eq!(last.word("words"), "to look at it (fleet: ann)");
    let jobs: Vec<_> = of(false)
        .map(|event| ["what", "job", "words"].map(|key| event.word(key)))
        .collect();
    let run = format!("work-{job}");
    let why = "the plan would leave the limits of this bench";
    let expected = [
        ["refused", &refused, why],
        ["started", &job, &run],
        ["done", &job, "finished"],
    ];
    assert_eq!(jobs, expected);
    let samples = heard(&lab, "eis-lab-telemetry", |_| true).await;
    let sample = &samples[0];
    assert_eq!(sample.subject, "eis.lab.telemetry.north.b1");
    let fields = [
        "bench",
        "current_a",
        "run",
        "site",
        "temperature_c",
        "unix_s",
        "voltage_v",
    ];
    assert_eq!(sample.fields(), BTreeSet::from(fields));
    assert_eq!(sample.word("run"), run);
    assert_eq!(sample.value["voltage_v"], 3.7);
}
