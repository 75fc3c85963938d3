//! Asks a person to change the fixture, and records who changed it.

use std::path::PathBuf;

use instruments::{clock::TimeMode, fixture::Fixture, units::Seconds};
use tokio::task::JoinHandle;

use super::{ExecuteError, Executor, Rig, analog::BY_HAND, handle_request::PAUSE_POLL_S, require};
use crate::{
    clock::TypedClock,
    journal::Entry,
    operator::{
        Operator, OperatorError,
        question::{Answer, Question},
    },
    record::Event,
};
use bench_plan::interlock::Reading;

/// Seconds between two checks for the answer and for a stop request.
const PERSON_POLL_S: Seconds = Seconds(1.0);
/// Phase name of readings that are taken while waiting for a person.
const ASKING: &str = "asking";

impl Executor<'_> {
    /// Waits until a person has confirmed the change. Every output is off, and is read back before
    /// and after.
    pub(super) async fn ask(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let operator = *self.person.operator;
        let certain = self.position.specimen.as_deref();
        let specimen = certain.or(self.rig.setup.specimen.as_deref());
        let mut question = Question::new(fixture, specimen, &self.rig.setup.cell);
        if self.rig.setup.wiring.analog.is_some() {
            question.text.push_str(BY_HAND);
        }
        question.on_terminal = operator == Operator::Terminal;
        self.rig.recorder.journal(Entry::Safe)?;
        let number = self.rig.recorder.numbered(Entry::Asked(question.clone()))?;
        let text = format!("asked: {}", question.text);
        self.rig.recorder.event(Event::Request, &text)?;
        if operator == Operator::Folder {
            self.person.progress.say(&text);
        }
        let folder: PathBuf = self.rig.recorder.folder().to_owned();
        let asked = tokio::spawn(async move { operator.ask(&question, number, &folder).await });
        let answer = self.rig.answer(asked).await?;
        // First switch off any output that was switched on by hand in the meantime.
        self.rig.bench.off_again().await?;
        let serial = answer
            .serial
            .as_ref()
            .map_or_else(String::new, |serial| format!(", serial number {serial}"));
        let text = format!("answered: {}{serial}", answer.by);
        self.rig.recorder.journal(Entry::Answered(answer))?;
        Ok(self.rig.recorder.event(Event::Request, &text)?)
    }
}

/// A question that is aborted when its waiter is dropped.
struct Waits(JoinHandle<Result<Answer, OperatorError>>);

impl Drop for Waits {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Rig<'_> {
    /// Waits for an answer without a time limit, because a person may need any amount of time.
    /// Meanwhile the instruments are watched and stop requests are accepted. In virtual time,
    /// where sleeps take no time, only the answer is waited for.
    async fn answer(
        &mut self,
        asked: JoinHandle<Result<Answer, OperatorError>>,
    ) -> Result<Answer, ExecuteError> {
        let mut asked = Waits(asked);
        if self.clock.mode() != TimeMode::Virtual {
            let mut watched_s = Seconds::NEG_INFINITY;
            while !asked.0.is_finished() {
                self.handle_abort()?;
                if self.clock.now() - watched_s >= PAUSE_POLL_S {
                    self.watch_open().await?;
                    watched_s = self.clock.now();
                }
                self.clock.sleep_for(PERSON_POLL_S).await;
            }
        }
        let _person = self.clock.wait(None);
        let answer = (&mut asked.0).await;
        Ok(answer.unwrap_or(Err(OperatorError::NotConfirmed))?)
    }

    /// Checks everything that could drive a current while hands are in the jig, and the bath. The
    /// voltage across the open jig, and a thermocouple that lies beside it, carry no information.
    async fn watch_open(&mut self) -> Result<(), ExecuteError> {
        if self.bench.instruments.supply4q.is_some() {
            let error = self.bench.error("supply4q");
            let (_, amps) = require(&mut self.bench.instruments.supply4q, "supply4q")?
                .measure()
                .await
                .map_err(error)?;
            let reading = Reading {
                time_s: self.clock.now(),
                current_a: Some(amps),
                ..Reading::default()
            };
            self.recorder.reading(ASKING, &reading)?;
            self.no_current("current of the bipolar supply", amps)?;
        }
        self.others_off(&["supply4q"]).await?;
        self.regulate().await?;
        self.watch_chiller().await?;
        self.cross_check_bath().await?;
        Ok(())
    }
}
