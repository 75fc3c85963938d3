//! The daemon's end of the pipe to the guardian: starts the guardian, renews the lease as long as
//! the executor makes progress, and detects the end of the guardian.

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::process::CommandExt,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    time::Duration,
};

use instruments::{clock::Clock, units::Seconds};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use super::{ALIVE, Charge, DOING, GOODBYE, NO_BATH, READY, REFUSED, TAKE_OVER};
use crate::{
    bench::BenchError,
    clock::TypedClock,
    operator::progress::{Doing, Now},
    safety::state::{State, StateError},
};
use bench_plan::{plan::fixture_name, support::terminal::remark};

/// Time between two heartbeats to the guardian.
const RENEWAL: Duration = Duration::from_millis(200);
/// Number of unanswered heartbeats after which the guardian counts as stopped.
const UNANSWERED: u64 = 100;
/// Longest wait for a guardian that reaches and identifies its instruments.
const START: Duration = Duration::from_secs(90);
/// Longest wait for the guardian of an earlier run to finish, and the polling period, s.
const EARLIER_S: (Seconds, Seconds) = (Seconds(120.0), Seconds(0.2));
/// Longest wait for the end of a guardian that was dismissed.
const END: Duration = Duration::from_secs(15);

/// Error of a guardian.
#[derive(Debug, thiserror::Error)]
pub enum GuardianError {
    /// The state of the bench cannot be read or written.
    #[error(transparent)]
    State(#[from] StateError),
    /// An instrument failed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The bench is simulated in this process.
    #[error("expected a bench with addresses outside this process: there is nothing to guard")]
    NothingToGuard,
    /// Two guardians at a time would interfere with each other.
    #[error("expected no guardian at work on this bench, found one")]
    Another,
    /// The guardian of an earlier run does not finish.
    #[error("the guardian of an earlier run still tries to switch the bench off; its log is {0}")]
    Busy(String),
    /// The guardian reported why it cannot watch.
    #[error("{0}")]
    Refused(String),
    /// The guardian cannot watch because of a fault on the wire to an instrument.
    #[error("{0}")]
    Unreached(String),
    /// The guardian cannot be started.
    #[error("expected to start the guardian, the system says: {0}")]
    Start(#[source] std::io::Error),
    /// The guardian did not report that it is ready.
    #[error("expected the guardian to be ready within {START:?}, it was not")]
    Silent,
    /// The guardian process has ended.
    #[error("the guardian ended or stopped while it was needed: {0}")]
    Lost(&'static str),
    /// A person removed its folder.
    #[error("gave up before safe state was verified")]
    GaveUp,
}

impl GuardianError {
    /// Checks whether the guardian failed to reach an instrument because of the wire or of a
    /// single answer. In that case no process was given access to an output, and the next attempt
    /// may succeed.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Unreached(_) => true,
            Self::Bench(BenchError::Link { source, .. }) => source.may_pass(),
            _ => false,
        }
    }
}

enum GuardianMessage {
    Ready,
    Refused(GuardianError),
    Silent,
    Gone,
}

/// A guardian that watches this process.
pub struct Keeper {
    messages: UnboundedReceiver<GuardianMessage>,
    goodbye: mpsc::Sender<&'static str>,
    pid: u32,
}

impl Keeper {
    /// Suffix of a guardian's refusal that is due to a fault of the wire, which may pass.
    pub const MAY_PASS: &str = "may pass";

    /// Starts a guardian and waits until it has verified that it can reach its instruments.
    /// `clocks` are those of the procedure and of the watch, whose progress renews the lease.
    ///
    /// # Errors
    /// Any reason why the guardian cannot watch.
    pub async fn start(
        charge: &Charge<'_>,
        clocks: [&Clock; 2],
        doing: &Doing,
    ) -> Result<Self, GuardianError> {
        let [clock, _] = clocks;
        let mut child = spawn(charge).map_err(GuardianError::Start)?;
        let pid = child.id();
        let (Some(stdin), Some(stdout)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(GuardianError::Start(std::io::Error::other("no pipes")));
        };
        let (tell, messages) = unbounded_channel();
        let (goodbye, goodbyes) = mpsc::channel();
        let answers = Arc::new(AtomicU64::new(0));
        std::thread::spawn({
            let (tell, answers) = (tell.clone(), answers.clone());
            move || listen(child, stdout, &tell, &answers)
        });
        let stall_s = charge.bench.guardian.stall_s;
        let renewal = Renewal {
            clocks: clocks.map(Clock::clone),
            doing: doing.clone(),
            stall_s,
            answers,
            tell,
        };
        std::thread::spawn(move || renewal.keep(stdin, &goodbyes));
        let mut keeper = Self {
            messages,
            goodbye,
            pid,
        };
        match clock.deadline(START, keeper.messages.recv()).await {
            Ok(Some(GuardianMessage::Ready)) => Ok(keeper),
            Ok(Some(GuardianMessage::Refused(error))) => Err(error),
            Ok(_) => Err(GuardianError::Lost("at its start")),
            Err(_) => Err(GuardianError::Silent),
        }
    }

    /// Returns the process ID of the guardian.
    pub fn pid(&self) -> u32 {
        self.pid
    }

    /// Waits until the guardian process has ended.
    pub async fn lost(&mut self) -> GuardianError {
        GuardianError::Lost(match self.messages.recv().await {
            Some(GuardianMessage::Silent) => "it no longer answers",
            _ => "its process has ended",
        })
    }

    /// Dismisses the guardian, because the bench is off, and waits for its end.
    pub async fn dismiss(mut self, clock: &Clock) {
        let _ = self.goodbye.send(GOODBYE);
        let gone = async {
            while !matches!(
                self.messages.recv().await,
                Some(GuardianMessage::Gone) | None
            ) {}
        };
        if clock.deadline(END, gone).await.is_err() {
            tracing::warn!(
                "the guardian, process {}, did not end when it was dismissed",
                self.pid
            );
        }
    }

    /// Leaves a bench that may be on to the guardian, which keeps trying after this process has
    /// ended.
    pub fn hand_over(self) {
        let _ = self.goodbye.send(TAKE_OVER);
        // The message must be sent before this process ends: the sending thread ends after that.
        drop(self.messages);
    }
}

/// Waits until the guardian of an earlier run has finished, or until no process works on the
/// bench.
///
/// # Errors
/// [`GuardianError::Busy`] if the guardian does not finish.
pub async fn wait_for_earlier(state: &State, clock: &Clock) -> Result<(), GuardianError> {
    let start_s = clock.machine();
    let mut reported = false;
    while state.lock_guardian()?.is_none() {
        if clock.machine() - start_s > EARLIER_S.0 {
            return Err(GuardianError::Busy(
                state.path("guardian.log").display().to_string(),
            ));
        }
        if !reported {
            remark!(
                "the guardian of an earlier run is still switching the bench off: waiting for it"
            );
            reported = true;
        }
        clock.sleep_for(EARLIER_S.1).await;
    }
    Ok(())
}

fn spawn(charge: &Charge<'_>) -> std::io::Result<Child> {
    let (least_v, greatest_v) = charge.window_v;
    let temperatures = charge.cell_degc.map(|(least_degc, greatest_degc)| {
        [
            format!("--least-c={}", least_degc.value()),
            format!("--greatest-c={}", greatest_degc.value()),
        ]
    });
    // Starts the running program, even if its file has been replaced since. The guardian gets its
    // own process group, so that Ctrl-C at the terminal does not reach it.
    Command::new("/proc/self/exe")
        .arg("guardian")
        .arg(&charge.bench.path)
        .arg("--run")
        .arg(charge.run)
        .arg(format!("--least-v={}", least_v.value()))
        .arg(format!("--greatest-v={}", greatest_v.value()))
        .args(temperatures.iter().flatten())
        .arg("--sha256")
        .arg(&charge.sha256)
        .process_group(0)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
}

/// Reads the guardian's messages until it has ended.
fn listen(
    mut child: Child,
    stdout: ChildStdout,
    tell: &UnboundedSender<GuardianMessage>,
    answers: &AtomicU64,
) {
    let mut refused: Option<GuardianError> = None;
    for line in BufReader::new(stdout).lines() {
        let Ok(line) = line else { break };
        if let Some(reason) = line.strip_prefix(REFUSED) {
            // A later message states whether the fault may pass.
            refused = Some(GuardianError::Refused(reason.to_owned()));
        } else if line == Keeper::MAY_PASS {
            refused = refused.map(|error| GuardianError::Unreached(error.to_string()));
        } else if line == READY {
            let _ = tell.send(GuardianMessage::Ready);
        } else {
            answers.fetch_add(1, Ordering::Relaxed);
        }
    }
    let _ = child.wait();
    if let Some(error) = refused {
        let _ = tell.send(GuardianMessage::Refused(error));
    }
    let _ = tell.send(GuardianMessage::Gone);
}

struct Renewal {
    clocks: [Clock; 2],
    doing: Doing,
    stall_s: Seconds,
    answers: Arc<AtomicU64>,
    tell: UnboundedSender<GuardianMessage>,
}

impl Renewal {
    /// Returns the next message to the guardian, or `None` while the procedure or the watch hangs.
    fn message(&self, known: &mut Option<Now>) -> Option<String> {
        if self
            .clocks
            .iter()
            .any(|clock| Seconds(clock.overdue_s()) > self.stall_s)
        {
            return None;
        }
        let now = self.doing.now();
        if known.as_ref() == Some(&now) {
            return Some(ALIVE.to_owned());
        }
        let bath = now.bath_degc.map_or_else(
            || NO_BATH.to_owned(),
            |setpoint_degc| setpoint_degc.to_string(),
        );
        let message = format!(
            "{DOING}{} {bath} {}",
            now.fixture.map_or("unknown", fixture_name),
            now.step.replace('\n', " ")
        );
        *known = Some(now);
        Some(message)
    }

    /// Sends heartbeats while the executor makes progress: a daemon whose executor hangs must
    /// count as dead.
    fn keep(self, mut stdin: ChildStdin, goodbye: &mpsc::Receiver<&'static str>) {
        let (mut sent, mut known) = (0, None);
        loop {
            match goodbye.recv_timeout(RENEWAL) {
                Ok(message) => {
                    let _ = writeln!(stdin, "{message}");
                    return;
                }
                // The sender was dropped without a goodbye: the guardian switches off.
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {}
            }
            let Some(message) = self.message(&mut known) else {
                continue;
            };
            if writeln!(stdin, "{message}").is_err() {
                return;
            }
            sent += 1;
            if sent > self.answers.load(Ordering::Relaxed) + UNANSWERED {
                let _ = self.tell.send(GuardianMessage::Silent);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use instruments::{clock::TimeMode, fixture::Fixture};

    use super::*;
    use crate::operator::progress::Progress;
    use bench_plan::plan::{Plan, Step};

    #[test]
    fn the_lease_is_renewed_while_the_executor_waits_and_not_while_it_hangs() {
        Clock::runtime(TimeMode::Virtual).unwrap().block_on(async {
            let (clock, other) = (
                Clock::start(TimeMode::Virtual),
                Clock::start(TimeMode::Virtual),
            );
            let watch = clock.apart();
            let _idle = watch.wait(None);
            let progress = Progress::new(&Plan { stages: Vec::new() });
            let (tell, _heard) = unbounded_channel();
            let doing = progress.doing().clone();
            let renewal = Renewal {
                clocks: [clock.clone(), watch.clone()],
                doing,
                stall_s: Seconds(20.0),
                answers: Arc::default(),
                tell,
            };
            let mut known = None;
            assert_eq!(
                renewal.message(&mut known).as_deref(),
                Some("doing unknown - ")
            );
            assert_eq!(renewal.message(&mut known).as_deref(), Some("."));
            let mount = Step::Mount(Fixture::Cell);
            progress.begin("sweep", &mount);
            progress.end(&mount);
            progress.begin("sweep", &Step::PowerDown);
            assert_eq!(
                renewal.message(&mut known).as_deref(),
                Some("doing cell - bipolar supply down")
            );
            progress.bath(25.5);
            assert_eq!(
                renewal.message(&mut known).as_deref(),
                Some("doing cell 25.5 bipolar supply down")
            );
            // A wait within its bound counts as progress, however long it is.
            let wait = clock.wait(Some(Duration::from_secs(3600)));
            other.sleep_s(3000.0).await;
            assert_eq!(renewal.message(&mut known).as_deref(), Some("."));
            // Computing without a wait: first for a short time, then for too long.
            drop(wait);
            other.sleep_s(19.0).await;
            assert_eq!(renewal.message(&mut known).as_deref(), Some("."));
            other.sleep_s(2.0).await;
            assert_eq!(renewal.message(&mut known), None);
            clock.sleep_for(Seconds(0.1)).await;
            assert_eq!(renewal.message(&mut known).as_deref(), Some("."));
        });
    }
}
