//! The person at the bench, asked on the terminal to change the fixture.

pub mod progress;
pub mod run_control;

use std::io::{BufRead, IsTerminal};

use instruments::fixture::Fixture;

use crate::{plan::Specimen, support::terminal::remark};

/// A person who could not be asked, or did not confirm.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// No terminal.
    #[error(
        "a person must change the fixture ([instruments.jig] model = \"person\"), but standard \
        input is no terminal: run on one"
    )]
    NoTerminal,
    /// The input ended before the change was confirmed.
    #[error("expected `done` after the fixture was changed, found the end of the input")]
    NotConfirmed,
}

/// How the person is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operator {
    /// On the terminal.
    Terminal,
    /// There is nobody.
    Nobody,
}

impl Operator {
    /// The terminal, where there is one.
    pub fn detect() -> Self {
        if std::io::stdin().is_terminal() {
            Self::Terminal
        } else {
            Self::Nobody
        }
    }

    /// Asks for a fixture, for a certain cell where there are several, and waits until it is
    /// confirmed. Every output is off.
    ///
    /// # Errors
    /// Nobody there; not confirmed.
    pub async fn mount(
        &self,
        fixture: Fixture,
        specimen: Option<&Specimen>,
    ) -> Result<(), OperatorError> {
        if *self == Self::Nobody {
            return Err(OperatorError::NoTerminal);
        }
        let text = request(fixture, specimen);
        // Waiting for a person blocks a thread of its own; the bench is off meanwhile.
        let ask = move || {
            let mut line = String::new();
            remark!(
                "\n{text}\nAll outputs are off, but an output that is off is no open switch: mind \
                the terminals. Type `done` when it is so:"
            );
            // The end of the input is an answer too: nobody is there any more.
            while std::io::stdin()
                .lock()
                .read_line(&mut line)
                .is_ok_and(|read| read > 0)
            {
                if line.trim() == "done" {
                    return Ok(());
                }
                remark!(
                    "expected `done`, found {:?}; Ctrl-C stops the run",
                    line.trim()
                );
                line.clear();
            }
            Err(OperatorError::NotConfirmed)
        };
        tokio::task::spawn_blocking(ask)
            .await
            .unwrap_or(Err(OperatorError::NotConfirmed))
    }
}

/// Request to the operator. A control begins with taking the cell out: a bar or a copper dummy
/// clamped across a cell is a dead short.
fn request(fixture: Fixture, specimen: Option<&Specimen>) -> String {
    let text = match (fixture, specimen) {
        (Fixture::Cell, None) => {
            "Clamp the cell into the jig, nothing else beside it, voltage probes C3 (−) and C4 (+) \
            on its Kelvin contacts."
        }
        (Fixture::Cell, Some(specimen)) => {
            return format!(
                "Clamp {specimen} into the jig, no other cell and nothing else beside it, voltage \
                probes C3 (−) and C4 (+) on its Kelvin contacts."
            );
        }
        (Fixture::Shunt, _) => {
            "Take the cell out of the jig. Close the current path there with copper (the fake \
            cell, or a short bar) and put the voltage probes \
             C3 and C4 on the shunt, beside C1 and C2."
        }
        (Fixture::FakeCell, _) => {
            "Take the cell out of the jig. Clamp the fake cell in its place, voltage probes C3 (−) \
            and C4 (+) on its Kelvin contacts."
        }
        (Fixture::Short, _) => {
            "Take the cell out of the jig. Clamp the short bar in its place, voltage probes C3 (−) \
            and C4 (+) on its Kelvin contacts."
        }
    };
    text.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_control_is_asked_for_without_the_cell_and_the_shunt_without_a_fake_cell_that_may_not_exist()
     {
        for control in [Fixture::Shunt, Fixture::FakeCell, Fixture::Short] {
            assert!(
                request(control, None).starts_with("Take the cell out of the jig. "),
                "{}",
                request(control, None)
            );
        }
        assert!(request(Fixture::Cell, None).starts_with("Clamp the cell into the jig"));
        assert!(request(Fixture::Shunt, None).contains("or a short bar"));
        let specimen = Specimen {
            number: 2,
            name: "B".to_owned(),
            serial: Some("P45B-17".to_owned()),
        };
        assert!(
            request(Fixture::Cell, Some(&specimen))
                .starts_with("Clamp cell B (serial number P45B-17) into the jig, no other cell")
        );
    }
}
