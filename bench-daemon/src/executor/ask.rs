//! Asks a person to change the fixture, and writes down who has.

use instruments::fixture::Fixture;

use super::{ExecuteError, Executor};
use crate::{
    journal::Entry,
    operator::{Operator, question::Question},
    record::Event,
};

impl Executor<'_> {
    /// Waits until a person has confirmed the change. Every output is off, and read back.
    pub(super) async fn ask(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        let operator = self.person.operator;
        let question = Question::new(
            fixture,
            self.position.specimen.as_deref(),
            *operator == Operator::Terminal,
        );
        self.rig.recorder.journal(Entry::Safe)?;
        let number = self.rig.recorder.numbered(Entry::Asked(question.clone()))?;
        let text = format!("asked: {}", question.text);
        self.rig.recorder.event(Event::Request, &text)?;
        if *operator == Operator::Folder {
            self.person.progress.say(&text);
        }
        let answer = {
            let _person = self.rig.clock.wait(None);
            tokio::select! {
                answer = operator.ask(&question, number, self.rig.recorder.folder()) => answer?,
                ended = self.rig.asked_to_end() => return Err(ended),
            }
        };
        let serial = answer
            .serial
            .as_ref()
            .map_or_else(String::new, |serial| format!(", serial number {serial}"));
        let text = format!("answered: {}{serial}", answer.by);
        self.rig.recorder.journal(Entry::Answered(answer))?;
        Ok(self.rig.recorder.event(Event::Request, &text)?)
    }
}
