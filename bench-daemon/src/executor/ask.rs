//! Asks a person to change the fixture, and writes down who has.

use std::path::PathBuf;

use instruments::{clock::TimeMode, fixture::Fixture};
use tokio::task::JoinHandle;

use super::{ExecuteError, Executor, Rig, handle_request::PAUSE_POLL_S, require};
use crate::{
    interlock::Reading,
    journal::Entry,
    operator::{
        Operator, OperatorError,
        question::{Answer, Question},
    },
    record::Event,
};

/// Seconds between two looks for the answer, and for a request to end.
const PERSON_POLL_S: f64 = 1.0;
/// How readings are named while a person is waited for.
const ASKING: &str = "asking";

impl Executor<'_> {
    /// Waits until a person has confirmed the change. Every output is off, and read back before and
    /// after.
    pub(super) async fn ask(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let operator = *self.person.operator;
        let certain = self.position.specimen.as_deref();
        let specimen = certain.or(self.rig.setup.specimen.as_deref());
        let mut question = Question::new(fixture, specimen, &self.rig.setup.cell);
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
        // An output that was switched on by hand meanwhile is off again before anything else.
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

/// A question that ends with whoever waits for its answer.
struct Waits(JoinHandle<Result<Answer, OperatorError>>);

impl Drop for Waits {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Rig<'_> {
    /// Waits for an answer: without end where none comes, for a person may take as long as that
    /// takes. Meanwhile the instruments are watched, and a request to end is heard. In virtual time,
    /// whose sleeps take none, only the answer is waited for.
    async fn answer(
        &mut self,
        asked: JoinHandle<Result<Answer, OperatorError>>,
    ) -> Result<Answer, ExecuteError> {
        let mut asked = Waits(asked);
        if self.clock.mode() != TimeMode::Virtual {
            let mut watched_s = f64::NEG_INFINITY;
            while !asked.0.is_finished() {
                self.handle_abort()?;
                if self.clock.now_s() - watched_s >= PAUSE_POLL_S {
                    self.watch_open().await?;
                    watched_s = self.clock.now_s();
                }
                self.clock.sleep_s(PERSON_POLL_S).await;
            }
        }
        let _person = self.clock.wait(None);
        let answer = (&mut asked.0).await;
        Ok(answer.unwrap_or(Err(OperatorError::NotConfirmed))?)
    }

    /// Looks at everything that could drive a current while hands are in the jig, and at the bath.
    /// The voltage across the open jig, and a thermocouple that lies beside it, say nothing.
    async fn watch_open(&mut self) -> Result<(), ExecuteError> {
        if self.bench.instruments.supply4q.is_some() {
            let error = self.bench.error("supply4q");
            let (_, amps) = require(&mut self.bench.instruments.supply4q, "supply4q")?
                .measure()
                .await
                .map_err(error)?;
            let reading = Reading {
                time_s: self.clock.now_s(),
                current_a: Some(amps.value()),
                ..Reading::default()
            };
            self.recorder.reading(ASKING, &reading)?;
            self.no_current("current of the bipolar supply", amps.value())?;
        }
        self.others_off(&["supply4q"]).await?;
        self.regulate().await?;
        self.watch_chiller().await?;
        self.cross_check_bath().await?;
        Ok(())
    }
}
