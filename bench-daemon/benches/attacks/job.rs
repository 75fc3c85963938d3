//! Experiments that reach the windows within seconds, and their files.

use std::{fs, path::Path};

/// A small experiment; each ends with a sweep of the cell, whose points can be right or wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Job {
    Fast,
    Twice,
    Slow,
    SlowBlocks,
    Pause,
    Prompt,
    Hold,
    Reset,
    Leg,
    Multisine,
    Trace,
    LoadTrace,
    Biased,
}

const SWEEP: &str = "[eis]\nstart = \"100 Hz\"\nstop = \"300 Hz\"\npoints = 3\namplitude = \"1 A\"\n\
    periods = 11\nextra_wait = \"1 s\"\nrepeat = REPEAT\n";
const SLOW_SWEEP: &str = "[eis]\nfrequencies = [\"0.2 Hz\", \"150 Hz\", \"300 Hz\"]\n\
    amplitude = \"1 A\"\nperiods = 2\nperiods_on_screen = 2\nextra_wait = \"1 s\"\n";
const BIASED_SWEEP: &str = "[eis]\nfrequencies = [\"0.5 Hz\", \"150 Hz\", \"300 Hz\"]\n\
    amplitude = \"1 A\"\nperiods = 2\nperiods_on_screen = 2\nextra_wait = \"1 s\"\n\
    rest_first = \"10 s\"\nbias = [\"-2 A\"]\nbias_charge = \"2 %\"\nbias_settle = \"5 s\"\n\
    resistance_max = \"40 mΩ\"\n";
const HOLD: &str =
    "[temperature]\nsetpoint = \"24 °C\"\nwithin = \"1.5 K\"\ntimeout = \"60 min\"\n";
const RESET: &str = "[soc_reset]\ndischarge_current = \"5 A\"\ndischarge_until = \"3.67 V\"\n\
    charge_current = \"3 A\"\ncharge_voltage = \"4.2 V\"\ncharge_until = \"3.86 V\"\n\
    rest_min = \"15 s\"\nrest_max = \"20 s\"\nrest_slope = \"10 mV/s\"\nmax_duration = \"2 h\"\n";
const LEG: &str = "[ocv_soc]\ncharge_current = \"1 A\"\ncharge_voltage = \"4.2 V\"\n\
    cut_off = \"100 mA\"\ndischarge_current = \"1 A\"\ndischarge_until = \"2.5 V\"\n\
    rest_min = \"10 min\"\nrest_max = \"2 h\"\nrest_slope = \"0.2 mV/min\"\n";
const MULTISINE: &str = "[multisine]\npeak = \"1 A\"\n[[multisine.bands]]\nbase = \"1 Hz\"\n\
    stop = \"10 Hz\"\nlines = 4\nperiods = 5\nsettle = \"10 s\"\n";
const TRACE: &str = "[[traces]]\nname = \"pulse\"\nrest_first = \"8 s\"\n\
    start_voltage = [\"3.5 V\", \"4.0 V\"]\nresistance_max = \"40 mΩ\"\n";
const STEPS: &str = "segments = [{ current = \"-1 A\", duration = \"10 s\" }, { current = \"0 A\", \
    duration = \"2 s\" }, { current = \"1 A\", duration = \"5 s\" }]\n";
const LOAD_STEPS: &str = "through = \"load_and_supply\"\nsegments = [{ current = \"-5 A\", \
    duration = \"15 s\" }, { current = \"0 A\", duration = \"2 s\" }, { current = \"2 A\", \
    duration = \"5 s\" }]\n";
const CONTROLS: &str = "[fixture_check]\ncorrected_tolerance = \"1 %\"\n[fixture_check.shunt]\n\
    magnitude = \"3 %\"\nphase = \"3 °\"\n";

impl Job {
    /// Returns the text of its experiment.
    fn experiment(self) -> String {
        let sweep = |repeat: usize| SWEEP.replace("REPEAT", &repeat.to_string());
        let parts = match self {
            Self::Fast | Self::SlowBlocks | Self::Pause => sweep(1),
            Self::Twice => sweep(2),
            Self::Slow => SLOW_SWEEP.to_owned(),
            Self::Biased => BIASED_SWEEP.to_owned(),
            Self::Prompt => sweep(1) + CONTROLS,
            Self::Hold => sweep(1) + HOLD,
            Self::Reset => sweep(1) + RESET,
            Self::Leg => LEG.to_owned(),
            Self::Multisine => sweep(1) + MULTISINE,
            Self::Trace => sweep(1) + TRACE + STEPS,
            Self::LoadTrace => sweep(1) + TRACE + LOAD_STEPS,
        };
        format!(
            "name = \"attack\"\nbench = \"../benches/demo.toml\"\ncell = \"../cells/p45b.toml\"\n\
            seed = 1\n\n{parts}\n[fit]\nrc = [1]\nobjective = \"complex\"\n"
        )
    }

    /// Returns the number of stages of its plan.
    pub(crate) const fn stages(self) -> usize {
        match self {
            Self::Fast | Self::Slow | Self::SlowBlocks | Self::Pause | Self::Leg | Self::Biased => {
                1
            }
            _ => 2,
        }
    }

    /// Checks whether a person changes what is in the jig.
    pub(crate) const fn has_person(self) -> bool {
        matches!(self, Self::Prompt)
    }

    /// Returns the greatest and least current that it requests at any time, A.
    pub(crate) const fn extremes_a(self) -> (f64, f64) {
        match self {
            Self::Reset => (-5.0, 3.0),
            Self::LoadTrace => (-5.0, 2.0),
            Self::Biased => (-3.0, 2.0),
            _ => (-1.0, 1.0),
        }
    }

    /// Returns its files in a separate folder.
    pub(crate) fn files(self) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        for name in [
            "benches/demo.toml",
            "cells/p45b.toml",
            "scenarios/p45b.toml",
        ] {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            fs::copy(configs.join(name), path).expect("a copy");
        }
        let experiments = folder.path().join("experiments");
        fs::create_dir_all(&experiments).expect("a folder");
        fs::write(experiments.join("attack.toml"), self.experiment()).expect("the experiment");
        folder
    }
}

/// Adds the usual time of an answer, s, of every drive to the bench file.
pub(crate) fn state_answers(folder: &Path, answer_s: f64) {
    let path = folder.join("benches/demo.toml");
    let mut text = fs::read_to_string(&path).expect("the bench file");
    for role in ["supply4q", "load", "supply"] {
        let head = format!("[instruments.{role}]\n");
        text = text.replace(&head, &format!("{head}answer = \"{answer_s:.2} s\"\n"));
    }
    fs::write(path, text).expect("the bench file");
}

/// Returns the least and the greatest current that a step requests, A, from its text in the
/// journal, or `None` if it continues with the currents of the previous step.
pub(crate) fn asked_a(step: &str, job: Job) -> Option<(f64, f64)> {
    let amps = || {
        step.split_whitespace()
            .nth(2)
            .and_then(|word| word.parse::<f64>().ok())
            .unwrap_or_default()
    };
    if step.starts_with("discharge at") {
        Some((-amps(), 0.0))
    } else if step.starts_with("charge at") {
        Some((0.0, amps()))
    } else if step.starts_with("trace ") {
        Some(job.extremes_a())
    } else if step.starts_with("ramp the direct current") {
        Some((-2.0, 0.0))
    } else if step.starts_with("bring back") {
        Some((0.0, 2.0))
    } else if job == Job::Biased && step.starts_with("point ") {
        Some((-3.0, 0.0))
    } else if step.starts_with("point ")
        || step.starts_with("multisine")
        || step.starts_with("measure again")
    {
        Some((-1.0, 1.0))
    } else if step.starts_with("bipolar supply down") {
        None
    } else {
        Some((0.0, 0.0))
    }
}
