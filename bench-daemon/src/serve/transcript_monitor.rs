//! Reads the last answers of an instrument from the transcript that a run writes: when it answered,
//! and whether its output is on. A run reads every switch back, so that the answer to such a
//! question is the instrument's own statement.

use std::{path::Path, str::FromStr};

use analysis::run_folder;
use instruments::transcript::{Direction, Payload, Transcript};

use super::follow::Follow;

/// Bits of a Siglent supply's status word that tell that channel 1 is on.
const SPD_CHANNEL_1: u32 = 0x10;

/// One instrument of a run.
#[derive(Debug)]
pub struct TranscriptMonitor {
    follow: Follow,
    asked: Option<String>,
    /// Bench time of its last answer, s.
    pub answered_s: Option<f64>,
    /// Whether its output is on, and the bench time at which it said so, s.
    pub output: Option<(bool, f64)>,
    /// Last remark of its link, such as that it was dropped, with the bench time, s.
    pub remark: Option<(String, f64)>,
}

impl TranscriptMonitor {
    /// The instrument of a role in a run folder.
    pub fn new(run: &Path, role: &str) -> Self {
        let follow = Follow::new(run.join(run_folder::transcript(role)));
        Self {
            follow,
            asked: None,
            answered_s: None,
            output: None,
            remark: None,
        }
    }

    /// Reads on.
    pub fn look(&mut self) {
        // What cannot be read says nothing; the run goes on all the same.
        for line in self.follow.look().unwrap_or_default().lines {
            // Without its end a line is a torn one.
            let Ok(transcript) = Transcript::from_str(&format!("{line}\n")) else {
                continue;
            };
            for record in transcript.records {
                let Payload::Text(text) = record.payload else {
                    self.answered_s = Some(record.time_s);
                    continue;
                };
                match record.direction {
                    Direction::Sent => self.asked = Some(text),
                    Direction::Remark => self.remark = Some((text, record.time_s)),
                    Direction::Unsolicited => {}
                    Direction::Received => {
                        self.answered_s = Some(record.time_s);
                        if let Some(on) = self.asked.take().and_then(|asked| output(&asked, &text))
                        {
                            self.output = Some((on, record.time_s));
                        }
                    }
                }
            }
        }
    }
}

/// State of the output by an answer; `None` where the question was about something else.
fn output(asked: &str, answer: &str) -> Option<bool> {
    let asked = asked.trim().to_ascii_uppercase();
    let answer = answer.trim().to_ascii_uppercase();
    if asked == "SYST:STAT?" {
        let bits = u32::from_str_radix(answer.trim_start_matches("0X"), 16).ok()?;
        return Some(bits & SPD_CHANNEL_1 != 0);
    }
    let header = asked.split_whitespace().next()?;
    let leaf = header
        .strip_suffix('?')?
        .trim_end_matches(|c: char| c.is_ascii_digit());
    let switch = [
        "OUTP",
        "OUTP:STAT",
        "OUTPUT",
        "OUTPUT:STATE",
        ":OUTP",
        "INP",
        "INP:STAT",
    ];
    let about = switch
        .iter()
        .any(|end| leaf == *end || leaf.ends_with(&format!(":{end}")))
        || header == "IN_MODE_05";
    let first = answer.split([' ', ',']).find(|word| !word.contains(':'))?;
    match first {
        "1" | "ON" if about => Some(true),
        "0" | "OFF" if about => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn switches_of_all_dialects_are_read_and_nothing_else_is() {
        for (asked, answer, expected) in [
            ("OUTP?", "1", Some(true)),
            ("C1:OUTP?", "C1:OUTP OFF,LOAD,HZ,PLRT,NOR", Some(false)),
            ("C1:OUTP?", "C1:OUTP ON,LOAD,HZ,PLRT,NOR", Some(true)),
            ("OUTP1?", "0", Some(false)),
            ("OUTP? (@1)", "1", Some(true)),
            (":OUTP? CH1", "ON", Some(true)),
            (":INP?", "0", Some(false)),
            (":SOUR:INP:STAT?", "1", Some(true)),
            ("SYST:STAT?", "0x14", Some(true)),
            ("SYST:STAT?", "0x4", Some(false)),
            (":OUTP:OVP? CH1", "ON", None),
            ("OUTP:MODE?", "1", None),
            ("MEAS:VOLT?", "1", None),
            ("*OPC?", "1", None),
        ] {
            assert_eq!(output(asked, answer), expected, "{asked} {answer}");
        }
    }

    #[test]
    fn the_last_answer_counts() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("transcripts")).unwrap();
        let text = "1.0 load > :INP?\n1.1 load < 1\n2.0 load > :MEAS:VOLT?\n2.5 load < 0\n\
        3.0 load * dropped: no answer\n";
        std::fs::write(folder.path().join("transcripts/load.txt"), text).unwrap();
        let mut monitor = TranscriptMonitor::new(folder.path(), "load");
        monitor.look();
        assert_eq!(
            (monitor.output, monitor.answered_s),
            (Some((true, 1.1)), Some(2.5))
        );
        assert_eq!(monitor.remark, Some(("dropped: no answer".to_owned(), 3.0)));
    }
}
