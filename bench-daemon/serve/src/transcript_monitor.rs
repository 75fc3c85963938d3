//! Reads the last replies of an instrument from the transcript that a run writes: when it
//! replied, and whether its output is on. A run reads every switch back, so that the reply is the
//! instrument's own statement.

use std::{path::Path, str::FromStr};

use analysis::run_folder;
use instruments::{
    exchange::Setting,
    transcript::{Direction, Payload, Transcript},
};

use super::follow::Follow;
use bench_core::bench::survey::KnownDialect;

/// One instrument of a run.
#[derive(Debug)]
pub struct TranscriptMonitor {
    follow: Follow,
    /// The setting that reports whether its output is on.
    switch: Option<Setting>,
    asked: Option<String>,
    /// Bench time of its last answer, s.
    pub answered_s: Option<f64>,
    /// Whether its output is on, and the bench time at which it said so, s.
    pub output: Option<(bool, f64)>,
    /// Last remark of its link, such as that it was dropped, with the bench time, s.
    pub remark: Option<(String, f64)>,
}

impl TranscriptMonitor {
    /// The instrument of a role and a model in a run folder.
    pub fn new(run: &Path, role: &str, model: &str) -> Self {
        let follow = Follow::new(run.join(run_folder::transcript(role)));
        Self {
            follow,
            switch: KnownDialect::of(role, model).and_then(|known| known.switch),
            asked: None,
            answered_s: None,
            output: None,
            remark: None,
        }
    }

    /// Reads on.
    pub fn look(&mut self) {
        // An unreadable transcript gives no information; the run continues.
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
                        let asked = self.asked.take();
                        let shown = self
                            .switch
                            .zip(asked)
                            .and_then(|(switch, asked)| switch.shows_on(asked.trim(), &text));
                        if let Some(on) = shown {
                            self.output = Some((on, record.time_s));
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn switches_of_all_dialects_are_read_and_nothing_else_is() {
        for (model, asked, answer, expected) in [
            ("kepco-bop-mg", "OUTP?", "1", Some(true)),
            ("kepco-bop-mg", "OUTP:MODE?", "1", None),
            ("kepco-bop-mg", "MEAS:VOLT?", "1", None),
            ("kepco-bop-mg", "*OPC?", "1", None),
            ("caenels-fast-ps", "MST", "#MST:08000003", Some(true)),
            ("caenels-fast-ps", "MST", "#MST:08000002", Some(false)),
            (
                "siglent-sdg1000x",
                "C1:OUTP?",
                "C1:OUTP OFF,LOAD,HZ,PLRT,NOR",
                Some(false),
            ),
            (
                "siglent-sdg1000x",
                "C1:OUTP?",
                "C1:OUTP ON,LOAD,50,PLRT,NOR",
                Some(true),
            ),
            ("keysight-33500b", "OUTP1?", "0", Some(false)),
            ("keysight-33500b", "OUTP1:LOAD?", "1", None),
            ("keysight-e36312a", "OUTP? (@1)", "1", Some(true)),
            ("rigol-dp832", ":OUTP? CH1", "ON", Some(true)),
            ("rigol-dp832", ":OUTP:OVP? CH1", "ON", None),
            ("siglent-sdl1000x", ":INP?", "0", Some(false)),
            ("rigol-dl3000", ":SOUR:INP:STAT?", "1", Some(true)),
            ("siglent-spd3303x", "SYST:STAT?", "0x14", Some(true)),
            ("siglent-spd3303x", "SYST:STAT?", "0x4", Some(false)),
            ("huber-pb", "{M14****", "{S140001", Some(true)),
            ("julabo", "IN_MODE_05", "0", Some(false)),
        ] {
            let known = KnownDialect::all()
                .into_iter()
                .find(|known| known.key == model);
            let switch = known.unwrap().switch.unwrap();
            assert_eq!(
                switch.shows_on(asked, answer),
                expected,
                "{model} {asked} {answer}"
            );
        }
    }

    /// Roles without an output, and the board whose relays open automatically.
    const WITHOUT_SWITCH: [&str; 3] = ["scope", "logger", "relay-thermostat"];

    #[test]
    fn every_dialect_that_has_an_output_tells_whether_it_is_on() {
        for known in KnownDialect::all() {
            let is_without = WITHOUT_SWITCH
                .iter()
                .any(|name| [known.role, known.key].contains(name));
            assert_eq!(known.switch.is_none(), is_without, "{}", known.key);
        }
    }

    #[test]
    fn the_last_answer_counts() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("transcripts")).unwrap();
        let text = "1.0 load > :INP?\n1.1 load < 1\n2.0 load > :MEAS:VOLT?\n2.5 load < 0\n\
        3.0 load * dropped: no answer\n";
        std::fs::write(folder.path().join("transcripts/load.txt"), text).unwrap();
        let mut monitor = TranscriptMonitor::new(folder.path(), "load", "siglent-sdl1000x");
        monitor.look();
        assert_eq!(
            (monitor.output, monitor.answered_s),
            (Some((true, 1.1)), Some(2.5))
        );
        assert_eq!(monitor.remark, Some(("dropped: no answer".to_owned(), 3.0)));
    }
}
