//! Notifications to people away from the page, by webhook and e-mail. Neither a run nor the
//! server waits for them.
//!
//! Notifications report trips and latches, benches whose outputs were not read back as off, and
//! ends of runs. During quiet hours, whatever can wait is collected and sent together at their
//! end.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError, atomic::Ordering},
    time::Duration,
};

use analysis::dataset::write_atomically;
use jiff::{Zoned, civil::Time};
use lettre::{
    Message, SmtpTransport, Transport,
    transport::smtp::{
        authentication::Credentials,
        client::{Tls, TlsParameters},
    },
};
use serde::Serialize;

use super::{
    Server,
    jobs::Job,
    live::Live,
    notices::{About, EMAIL, Notice, WEBHOOK},
    targets::{Email, Encryption},
};

/// Waits before the second and later tries, s.
const AGAIN_S: [f64; 4] = [2.0, 10.0, 60.0, 600.0];
/// Time limit of a receiver, s.
const PATIENCE: Duration = Duration::from_secs(20);
/// Interval between two checks for notices that wait for the end of quiet hours, s.
const LOOK_S: f64 = 5.0;
/// Time between two questions whether the benches have been looked at, s.
const FIRST_S: f64 = 0.1;
/// Time for which outputs must not have been read as off before it is reported, s: after a run
/// its guardian reads them first.
const SETTLED_S: f64 = 10.0;

/// The body of a webhook.
#[derive(Debug, Serialize)]
struct Hook<'a> {
    schema: &'static str,
    #[serde(flatten)]
    notice: &'a Notice,
}

/// Sends a test notice and returns its outcome.
pub async fn test(server: &Arc<Server>, by: &str) -> Notice {
    let text = format!("{by} tried whether notices arrive.");
    let notice = server
        .notices
        .add(About::Test, None, "eis-bench: a test".to_owned(), text);
    send(server, std::slice::from_ref(&notice), 0).await;
    let mut all = server.notices.list();
    all.retain(|one| one.number == notice.number);
    all.pop().unwrap_or(notice)
}

/// Watches the benches and sends notifications, forever.
pub async fn work(server: Arc<Server>) {
    let mut wake = server.hub.wake();
    let mut number = server.hub.latest();
    let mut seen = Seen::default();
    // The first poll shows the state that existed before this server.
    while server.counts.looks.load(Ordering::Relaxed) == 0 {
        server.clock.sleep_s(FIRST_S).await;
    }
    seen.benches(&server, true);
    let kept = Kept::read(&server);
    let mut is_reported = false;
    loop {
        wake.mark_unchanged();
        let mut fresh = seen.benches(&server, false);
        loop {
            let news = server.hub.after(number);
            let Some(last) = news.events.last() else {
                break;
            };
            number = last.number;
            let runs = news.events.iter().filter(|event| event.kind == "run");
            fresh.extend(runs.filter_map(|event| ended(&server, &event.data)));
        }
        for notice in fresh {
            server.hub.tell("notice", &notice);
            if notice.about.is_urgent()
                || !is_quiet(server.settings.notify.quiet, Zoned::now().time())
            {
                start(&server, vec![notice]);
            } else {
                server.notices.outcome(
                    notice.number,
                    "quiet hours",
                    "kept until their end".to_owned(),
                );
                kept.push(notice);
            }
        }
        let quiet = is_quiet(server.settings.notify.quiet, Zoned::now().time());
        if quiet {
            is_reported = false;
        } else if !is_reported {
            is_reported = true;
            tell_kept(&server, &kept);
        }
        if server.hub.closed() {
            std::future::pending::<()>().await;
        }
        tokio::select! {
            _ = wake.changed() => {}
            () = server.clock.sleep_s(LOOK_S) => {}
        }
    }
}

/// Notices that wait for the end of quiet hours. They are also stored on disk until they are
/// sent, so that they survive the server.
#[derive(Clone)]
struct Kept {
    path: PathBuf,
    notices: Arc<Mutex<Vec<Notice>>>,
}

impl Kept {
    /// Reads the notices that an earlier server has stored.
    fn read(server: &Server) -> Self {
        let path = server.settings.data.join("notices.json");
        let earlier: Vec<Notice> = std::fs::read_to_string(&path)
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or_default();
        let again = |notice: Notice| {
            let Notice { about, bench, .. } = &notice;
            let (title, text) = (notice.title.clone(), notice.text.clone());
            server.notices.add(*about, bench.as_deref(), title, text)
        };
        let notices = Arc::new(Mutex::new(earlier.into_iter().map(again).collect()));
        Self { path, notices }
    }

    fn change<T>(&self, change: impl FnOnce(&mut Vec<Notice>) -> T) -> T {
        let mut notices = self.notices.lock().unwrap_or_else(PoisonError::into_inner);
        let before = notices.len();
        let outcome = change(&mut notices);
        if notices.len() != before {
            let text = serde_json::to_string(&*notices).unwrap_or_default();
            if let Err(error) = write_atomically(&self.path, text.as_bytes()) {
                tracing::error!("{error}");
            }
        }
        outcome
    }

    /// Stores a notice; a question replaces the previous question of its bench.
    fn push(&self, notice: Notice) {
        self.change(|all| {
            if notice.about == About::Question {
                all.retain(|one| one.about != About::Question || one.bench != notice.bench);
            }
            all.push(notice);
        });
    }

    /// Returns the notices that are still due. The notice of an answered question is dropped.
    fn due(&self, server: &Server) -> Vec<Notice> {
        let live = server.live();
        let waits = |notice: &Notice| {
            let bench = notice.bench.as_ref().and_then(|bench| live.get(bench));
            notice.about != About::Question || bench.is_some_and(|bench| bench.question.is_some())
        };
        self.change(|all| {
            all.retain(|notice| waits(notice));
            all.clone()
        })
    }

    /// Removes notices that were sent.
    fn sent(&self, sent: &[Notice]) {
        let is_sent = |one: &Notice| sent.iter().any(|other| other.number == one.number);
        self.change(|all| all.retain(|one| !is_sent(one)));
    }
}

/// Sends stored notices concurrently with new ones, and removes them once they are sent.
fn tell_kept(server: &Arc<Server>, kept: &Kept) {
    let due = kept.due(server);
    if due.is_empty() {
        return;
    }
    let (server, kept) = (server.clone(), kept.clone());
    tokio::spawn(async move {
        send(&server, &due, AGAIN_S.len()).await;
        kept.sent(&due);
    });
}

/// Sends concurrently with later notices.
fn start(server: &Arc<Server>, notices: Vec<Notice>) {
    let server = server.clone();
    tokio::spawn(async move { send(&server, &notices, AGAIN_S.len()).await });
}

/// Benches as they were seen last.
#[derive(Debug, Default)]
struct Seen {
    /// Causes of the trips that are there, by bench.
    trips: BTreeMap<String, String>,
    /// Outputs that a person must inspect, by bench.
    unread: BTreeMap<String, Unread>,
    /// Questions that were reported: the run, and the number of the question, by bench.
    questions: BTreeMap<String, (Option<String>, u64)>,
}

/// Outputs that a person must inspect.
#[derive(Debug)]
struct Unread {
    /// Since when, s.
    since_s: f64,
    /// The states that were read, without the time.
    states: Vec<String>,
    notified: bool,
}

impl Seen {
    /// Returns notices of new trips, and of benches whose outputs have needed inspection for a
    /// while.
    fn benches(&mut self, server: &Server, first: bool) -> Vec<Notice> {
        let live: Vec<Live> = server.live().values().cloned().collect();
        let mut fresh = Vec::new();
        for bench in live {
            if let Some(trip) = &bench.trip {
                // A trip record that cannot be read has another time at each poll.
                let known = self.trips.insert(bench.bench.clone(), trip.cause.clone());
                if known.as_ref() != Some(&trip.cause) && !first {
                    let step = trip.step.as_ref().map(|step| format!(", in step “{step}”"));
                    let text = format!(
                        "{}{}. Found by the {}. Look at the bench and at the cell.",
                        trip.cause,
                        step.unwrap_or_default(),
                        trip.by
                    );
                    let title = format!("{} is latched", bench.bench);
                    fresh.push(
                        server
                            .notices
                            .add(About::Trip, Some(&bench.bench), title, text),
                    );
                }
            } else {
                self.trips.remove(&bench.bench);
            }
            fresh.extend(self.question(server, &bench));
            if !bench.needs_look {
                self.unread.remove(&bench.bench);
                continue;
            }
            fresh.extend(self.outputs(server, &bench));
        }
        fresh
    }

    /// Returns a notice of outputs that a person must inspect, once that is so for a while, and
    /// again as soon as other states are read.
    fn outputs(&mut self, server: &Server, bench: &Live) -> Option<Notice> {
        let now_s = server.clock.now_s();
        let states: Vec<String> = std::iter::once(format!("{:?}", bench.outputs.state))
            .chain(
                bench
                    .outputs
                    .outputs
                    .iter()
                    .map(|reading| format!("{} {}", reading.role, reading.state.name())),
            )
            .collect();
        let begun = || Unread {
            since_s: now_s,
            states: states.clone(),
            notified: false,
        };
        let unread = self.unread.entry(bench.bench.clone()).or_insert_with(begun);
        if unread.states != states {
            *unread = begun();
        }
        if unread.notified || now_s - unread.since_s < SETTLED_S {
            return None;
        }
        unread.notified = true;
        let title = format!("{}: {}", bench.bench, bench.outputs.words);
        let text = format!(
            "Look at the bench, and switch it off: `{}` on its machine.",
            bench.safe_command
        );
        let notices = &server.notices;
        Some(notices.add(About::Unverified, Some(&bench.bench), title, text))
    }

    /// Returns the notice of a question that was not reported yet. After a restart it is reported
    /// once more, because it is unknown whether it was sent.
    fn question(&mut self, server: &Server, bench: &Live) -> Option<Notice> {
        let Some(question) = &bench.question else {
            self.questions.remove(&bench.bench);
            return None;
        };
        let run = bench.run.as_ref().and_then(|run| run.run.clone());
        let now = (run, question.number);
        if self.questions.insert(bench.bench.clone(), now.clone()) == Some(now) {
            return None;
        }
        let title = format!("{} waits for a person", bench.bench);
        let text = format!(
            "{} Every output that the program switches is off. Answer on the page of the bench, or \
            with `eis-bench answer`.",
            question.text
        );
        let notices = &server.notices;
        Some(notices.add(About::Question, Some(&bench.bench), title, text))
    }
}

/// The notice of a run that has ended.
fn ended(server: &Server, data: &str) -> Option<Notice> {
    let job: Job = serde_json::from_str(data).ok()?;
    let ended = job.ended?;
    let how = match &ended.stopped_by {
        Some(who) => format!("stopped by {who}"),
        None => ended.how,
    };
    let title = format!("{} on {}: {how}", job.item.run, job.item.bench);
    let text = format!("Submitted by {}.", job.item.by);
    Some(
        server
            .notices
            .add(About::End, Some(&job.item.bench), title, text),
    )
}

/// Returns whether a time lies in quiet hours, which may extend over midnight.
fn is_quiet(quiet: Option<(Time, Time)>, now: Time) -> bool {
    quiet.is_some_and(|(from, to)| {
        if from <= to {
            from <= now && now < to
        } else {
            from <= now || now < to
        }
    })
}

/// Sends notices to every target independently; several notices are one message.
async fn send(server: &Arc<Server>, notices: &[Notice], again: usize) {
    let targets = &server.settings.notify;
    let hook = targets.webhook.clone().map(|address| {
        let bodies = notices.iter().map(|notice| {
            let hook = Hook {
                schema: "eis-bench/notice",
                notice,
            };
            serde_json::to_string(&hook).unwrap_or_default()
        });
        (address, bodies.collect::<Vec<_>>())
    });
    let post = async {
        let Some((address, bodies)) = hook else {
            return;
        };
        for (notice, body) in notices.iter().zip(bodies) {
            let address = address.clone();
            let work = move || post_once(&address, &body);
            tried(server, &[notice.number], WEBHOOK, again, work).await;
        }
    };
    let mail = async {
        let Some(email) = targets.email.clone() else {
            return;
        };
        let numbers: Vec<u64> = notices.iter().map(|notice| notice.number).collect();
        let notices = notices.to_vec();
        let work = move || mail_once(&email, &notices);
        tried(server, &numbers, EMAIL, again, work).await;
    };
    tokio::join!(post, mail);
}

/// Sends, and retries after a failure.
async fn tried(
    server: &Arc<Server>,
    numbers: &[u64],
    target: &'static str,
    again: usize,
    work: impl Fn() -> Result<(), String> + Clone + Send + 'static,
) {
    for number in 0..=again {
        let work = work.clone();
        // A receiver that hangs holds few threads.
        let permit = server.notices.sending.acquire().await;
        let outcome = tokio::task::spawn_blocking(work).await;
        drop(permit);
        let outcome = outcome.unwrap_or_else(|error| Err(error.to_string()));
        server.notices.tried(target, outcome.is_ok());
        let words = match &outcome {
            Ok(()) => "sent".to_owned(),
            Err(error) => format!("not sent, try {}: {error}", number + 1),
        };
        for notice in numbers {
            server.notices.outcome(*notice, target, words.clone());
        }
        match outcome {
            Ok(()) => return,
            Err(error) => tracing::warn!("a notice by {target} was not sent: {error}"),
        }
        match AGAIN_S.get(number).filter(|_| number < again) {
            Some(pause_s) => server.clock.sleep_s(*pause_s).await,
            None => return,
        }
    }
}

fn post_once(address: &str, body: &str) -> Result<(), String> {
    let config = ureq::Agent::config_builder()
        .timeout_global(Some(PATIENCE))
        .max_redirects(0)
        .build();
    let agent: ureq::Agent = config.into();
    agent
        .post(address)
        .header("Content-Type", "application/json")
        .send(body)
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn mail_once(email: &Email, notices: &[Notice]) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let tls = || TlsParameters::new(email.host.clone()).map_err(|error| failed(&error));
    let mut transport = SmtpTransport::builder_dangerous(&email.host)
        .port(email.port)
        .timeout(Some(PATIENCE))
        .tls(match email.encryption {
            Encryption::Tls => Tls::Wrapper(tls()?),
            Encryption::Starttls => Tls::Required(tls()?),
            Encryption::None => Tls::None,
        });
    if let Some(user) = &email.user {
        let password = email
            .password_file
            .as_ref()
            .map(std::fs::read_to_string)
            .transpose();
        let password = password
            .map_err(|error| failed(&error))?
            .unwrap_or_default();
        transport = transport.credentials(Credentials::new(
            user.clone(),
            password.trim_end().to_owned(),
        ));
    }
    let (subject, text) = match notices {
        [one] => (one.title.clone(), one.text.clone()),
        several => {
            let lines = several
                .iter()
                .map(|one| format!("{}\n{}\n", one.title, one.text));
            (
                format!("{} notices", several.len()),
                lines.collect::<Vec<_>>().join("\n"),
            )
        }
    };
    let mut message = Message::builder()
        .from(email.from.clone())
        .subject(format!("eis-bench: {subject}"));
    for to in &email.to {
        message = message.to(to.clone());
    }
    let message = message.body(text).map_err(|error| failed(&error))?;
    transport
        .build()
        .send(&message)
        .map(|_| ())
        .map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quiet_hours_may_go_over_midnight() {
        let at = |hour| Time::constant(hour, 30, 0, 0);
        let night = Some((at(21), at(5)));
        let found = [20, 21, 23, 0, 4, 5, 12].map(|hour| is_quiet(night, at(hour)));
        assert_eq!(found, [false, true, true, true, true, false, false]);
        assert!(is_quiet(Some((at(1), at(5))), at(4)) && !is_quiet(Some((at(1), at(5))), at(5)));
        assert!(!is_quiet(None, at(0)));
    }
}
