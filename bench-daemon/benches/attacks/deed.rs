//! The attacks on a bench, and the product of windows and attacks.

use instruments::mock::Fault;
use nix::sys::signal::Signal;

use super::window::Window;

/// Messages of another client to one instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hand {
    pub(crate) name: &'static str,
    pub(crate) role: &'static str,
    pub(crate) messages: &'static [&'static str],
    needs: Needs,
}

/// State of an instrument that is required for the client to have an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Needs {
    Nothing,
    /// The output of this instrument is on.
    Output,
    /// The scope is being read.
    Scope,
    /// A bath holds the cell's temperature.
    Bath,
}

/// Attack.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Deed {
    /// No attack, for comparison.
    Nothing,
    /// Another client.
    Hand(Hand),
    /// One message is disturbed, and the bipolar supply is set to 1.9 A at that moment.
    Hang(&'static str, Fault, &'static str),
    /// An instrument has a permanent fault.
    Fault(&'static str, Fault),
    /// Every answer is late, s, and another client connects three seconds later.
    Slow(f64, Hand),
    /// One instrument, or all, is unavailable for a time, s: silent, or with closed connections.
    Gone(Option<&'static str>, f64, bool),
    /// A signal to the daemon (0) or its guardian (1), or both (2).
    Signal(u8, Signal),
    /// The run folder is deleted.
    FolderGone,
    /// The bipolar supply suddenly gets an offset, A.
    Offset(f64),
}

/// One combination.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Attack {
    pub(crate) window: Window,
    pub(crate) deed: Deed,
}

const fn hand(
    name: &'static str,
    role: &'static str,
    messages: &'static [&'static str],
    needs: Needs,
) -> Hand {
    Hand {
        name,
        role,
        messages,
        needs,
    }
}

const LOAD_20: Hand = hand(
    "load on at 20 A",
    "load",
    &[
        ":INP OFF",
        ":VOLT:LEV:ON 0",
        ":CURR:IRANG 30",
        ":CURR:LEV:IMM 20",
        ":INP ON",
    ],
    Needs::Nothing,
);
pub(crate) const BIPOLAR_FIXED: Hand = hand(
    "bipolar supply on at its own 1.9 A",
    "supply4q",
    &[
        "FUNC:MODE CURR",
        "CURR:MODE FIX",
        "CURR 1.9",
        "VOLT 6",
        "OUTP ON",
    ],
    Needs::Nothing,
);

/// Actions of another client.
const HANDS: [Hand; 18] = [
    LOAD_20,
    hand(
        "load on at 2 A",
        "load",
        &[":CURR:LEV:IMM 2", ":INP ON"],
        Needs::Nothing,
    ),
    hand(
        "charger on at 3 A",
        "supply",
        &["CH1:VOLT 5", "CH1:CURR 3", "OUTP CH1,ON"],
        Needs::Nothing,
    ),
    BIPOLAR_FIXED,
    hand(
        "generator at twice the amplitude",
        "generator",
        &["C1:BSWV AMP,2"],
        Needs::Output,
    ),
    hand(
        "generator with an offset",
        "generator",
        &["C1:BSWV OFST,0.43"],
        Needs::Output,
    ),
    hand(
        "generator at 7 Hz",
        "generator",
        &["C1:BSWV FRQ,7"],
        Needs::Output,
    ),
    hand(
        "generator without burst",
        "generator",
        &["C1:BTWV STATE,OFF"],
        Needs::Output,
    ),
    hand(
        "generator off",
        "generator",
        &["C1:OUTP OFF"],
        Needs::Output,
    ),
    hand(
        "bipolar supply limited to 20 A",
        "supply4q",
        &["CURR:LIM 20"],
        Needs::Output,
    ),
    hand(
        "bipolar supply off",
        "supply4q",
        &["OUTP OFF"],
        Needs::Output,
    ),
    hand("load off", "load", &[":INP OFF"], Needs::Output),
    hand("charger off", "supply", &["OUTP CH1,OFF"], Needs::Output),
    hand(
        "charger at 0.5 A",
        "supply",
        &["CH1:CURR 0.5"],
        Needs::Output,
    ),
    hand(
        "scope at another scale",
        "scope",
        &[":CHANnel2:SCALe 2"],
        Needs::Scope,
    ),
    hand(
        "scope at another time base",
        "scope",
        &[":TIMebase:SCALe 1E-3"],
        Needs::Scope,
    ),
    hand("scope triggered", "scope", &[":TRIGger:RUN"], Needs::Scope),
    hand(
        "bath to 70 °C",
        "chiller",
        &["OUT_SP_00 70.00"],
        Needs::Bath,
    ),
];

/// Delays of answers, s.
const LATENCIES_S: [f64; 4] = [0.1, 0.3, 1.0, 2.0];
/// Instruments that become unavailable individually.
const ROLES: [&str; 7] = [
    "supply4q",
    "generator",
    "scope",
    "load",
    "supply",
    "chiller",
    "logger",
];
/// Instruments with meters.
const METERS: [&str; 4] = ["supply4q", "load", "supply", "logger"];
/// Messages that hang while the bipolar supply is set.
const HANGS: [(&str, Fault, &str); 4] = [
    ("scope", Fault::Truncate, "DATA?"),
    ("generator", Fault::TooLate, "?"),
    ("logger", Fault::LoseReply, "?"),
    ("supply4q", Fault::TooLate, "?"),
];
/// Faults of one instrument that reports wrong values or loses power.
const LIES: [Fault; 5] = [
    Fault::StuckOutput,
    Fault::Lagging,
    Fault::PowerCycle,
    Fault::ShortBlock,
    Fault::OffsetDrift,
];
/// Faults of one message.
const WIRE: [Fault; 10] = [
    Fault::LoseMessage,
    Fault::LoseReply,
    Fault::Delay,
    Fault::TooLate,
    Fault::Duplicate,
    Fault::Garble,
    Fault::Truncate,
    Fault::HalfClose,
    Fault::Reset,
    Fault::Stall,
];

/// Returns every attack, whether or not it is possible in a window.
fn deeds(window: Window) -> Vec<Deed> {
    let mut deeds = vec![Deed::Nothing];
    deeds.extend(HANDS.map(Deed::Hand));
    deeds.extend(HANGS.map(|(role, fault, within)| Deed::Hang(role, fault, within)));
    deeds.extend(METERS.map(|role| Deed::Fault(role, Fault::FrozenMeter)));
    let second = if window.is_on("supply4q") {
        BIPOLAR_FIXED
    } else {
        LOAD_20
    };
    deeds.extend(LATENCIES_S.map(|late_s| Deed::Slow(late_s, second)));
    deeds.extend([7.0, 10.0].map(|span_s| Deed::Gone(None, span_s, false)));
    deeds.extend(ROLES.map(|role| Deed::Gone(Some(role), 10.0, false)));
    deeds.extend([None, Some("supply4q"), Some("supply")].map(|role| Deed::Gone(role, 10.0, true)));
    use Signal::{SIGKILL, SIGSTOP};
    deeds.extend(
        [
            (0, SIGKILL),
            (0, SIGSTOP),
            (1, SIGKILL),
            (1, SIGSTOP),
            (2, SIGKILL),
            (2, SIGSTOP),
        ]
        .map(|(whom, signal)| Deed::Signal(whom, signal)),
    );
    deeds.extend([Deed::FolderGone, Deed::Offset(0.34)]);
    for fault in LIES.into_iter().chain(WIRE).chain([Fault::Overflow]) {
        deeds.extend(ROLES.map(|role| Deed::Fault(role, fault)));
    }
    deeds
}

impl Deed {
    pub(crate) fn name(self) -> String {
        match self {
            Self::Nothing => "nothing".to_owned(),
            Self::Hand(hand) => hand.name.to_owned(),
            Self::Hang(role, fault, _) => {
                format!("{fault:?} of the {role}, bipolar supply at 1.9 A meanwhile")
            }
            Self::Fault(role, fault) => format!("{role} {fault:?}"),
            Self::Slow(late_s, hand) => format!("answers {late_s} s late, then {}", hand.name),
            Self::Gone(role, span_s, closed) => {
                let how = if closed { ", connections closed" } else { "" };
                format!("{} gone for {span_s} s{how}", role.unwrap_or("network"))
            }
            Self::Signal(whom, signal) => {
                let whom = ["daemon", "guardian", "daemon and guardian"]
                    .get(usize::from(whom))
                    .unwrap_or(&"?");
                format!("{signal} to {whom}")
            }
            Self::FolderGone => "run folder deleted".to_owned(),
            Self::Offset(amps) => format!("offset of {amps} A"),
        }
    }

    /// Checks whether the attack is transient: after it has passed, everything must be correct.
    pub(crate) const fn is_transient(self) -> bool {
        matches!(self, Self::Gone(..))
    }

    /// Checks whether the daemon loses control of the bench, so that its guardian's lease must
    /// expire.
    pub(crate) const fn takes_lease(self) -> bool {
        matches!(self, Self::Signal(0 | 2, _))
    }

    /// Returns the delay of answers, s.
    pub(crate) const fn late_s(self) -> f64 {
        match self {
            Self::Slow(late_s, _) => late_s,
            _ => 0.0,
        }
    }
}

impl Attack {
    pub(crate) fn name(&self) -> String {
        format!("{}: {}", self.window.name(), self.deed.name())
    }

    /// Returns why window and attack cannot be combined, or `None` if they can.
    fn impossible(&self) -> Option<&'static str> {
        let window = self.window;
        match self.deed {
            Deed::Nothing => None,
            Deed::Hand(hand) => match hand.needs {
                Needs::Output if !window.is_on(hand.role) => {
                    Some("the setting acts only while that output is on")
                }
                Needs::Scope if !window.reads_scope() => Some("the scope is not read"),
                Needs::Bath
                    if !matches!(window, Window::Hold | Window::SlowSine | Window::Rest) =>
                {
                    Some("the bath moves too slowly for a short window")
                }
                _ => None,
            },
            _ if window == Window::End => Some("no process of the run asks anything any more"),
            Deed::Hang("scope", ..) if !window.reads_scope() => Some("the scope is not read"),
            Deed::Hang(role, ..) if role != "scope" && !window.is_on("supply4q") => {
                Some("the exchange is not made while the bipolar supply is off")
            }
            Deed::Offset(_) if !window.is_on("supply4q") => {
                Some("an offset does not flow while the bipolar supply is off")
            }
            Deed::Fault("supply4q", Fault::FrozenMeter) if !window.is_on("supply4q") => {
                Some("the meter is not asked while its output is off")
            }
            Deed::Fault(_, Fault::FrozenMeter) => None,
            Deed::Fault(role, fault) => self.no_exchange(role, fault),
            Deed::Signal(1, Signal::SIGSTOP) | Deed::Signal(2, _)
                if !matches!(window, Window::SlowSine | Window::FastSine) =>
            {
                Some("nothing is left that could act")
            }
            _ => None,
        }
    }

    /// Returns why a fault of one instrument is skipped.
    fn no_exchange(&self, role: &str, fault: Fault) -> Option<&'static str> {
        if !self.window.has_exchanges() {
            return Some("faults of one exchange are injected in four windows");
        }
        let asked = match role {
            "scope" => self.window.reads_scope(),
            "chiller" => false,
            "logger" | "load" => true,
            role => self.window.is_on(role),
        };
        let can = match fault {
            Fault::ShortBlock => role == "scope",
            Fault::OffsetDrift => role == "supply4q",
            Fault::StuckOutput => self.window.is_on(role),
            _ => true,
        };
        match (asked, can) {
            (false, _) => Some("the instrument is not asked"),
            (_, false) => Some("the instrument has no such fault"),
            _ => None,
        }
    }
}

/// Returns the product, and the number of impossible combinations by reason.
pub(crate) fn product() -> (Vec<Attack>, Vec<(&'static str, usize)>) {
    let (mut attacks, mut skipped) = (Vec::new(), Vec::<(&'static str, usize)>::new());
    for window in Window::ALL {
        for deed in deeds(window) {
            let attack = Attack { window, deed };
            match attack.impossible() {
                None => attacks.push(attack),
                Some(why) => match skipped.iter_mut().find(|(known, _)| *known == why) {
                    Some((_, count)) => *count += 1,
                    None => skipped.push((why, 1)),
                },
            }
        }
    }
    (attacks, skipped)
}
