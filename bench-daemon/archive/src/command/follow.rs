//! `eis-archive follow`: keeps the store up to date, for as long as the process lives. It can be
//! killed at any time: every operation is repeatable.

use instruments_link::clock::{Clock, TimeMode, unix_time_s};

use super::{
    arguments::{FollowArgs, PushArgs},
    push::{push_due, with_jitter},
    thin::move_captures,
};
use crate::{
    failure::Failure,
    open::Archive,
    print::print_remark,
    settings::Settings,
    status::{read_status, write_status},
};

/// First and longest pause before a push is repeated, s. The pause doubles each time.
const PAUSES_S: [f64; 2] = [2.0, 300.0];
/// Interval between two checks for captures that are due to be moved, s.
const THIN_EVERY_S: f64 = 6.0 * 3600.0;
/// Interval between two updates of the status while runs are sent, s.
const STATUS_EVERY_S: f64 = 30.0;

/// Sends runs as they end.
///
/// # Errors
/// The file of the archive is invalid at the start. If the store does not answer, the operation is
/// retried instead.
pub(super) async fn follow(args: &FollowArgs) -> Result<(), Failure> {
    let settings = Settings::load(&args.config)?;
    let push = PushArgs {
        tries: 1,
        ..PushArgs::default()
    };
    let mut pause_s = PAUSES_S[0];
    let clock = Clock::start(TimeMode::Real);
    let mut next_thin_s = 0.0;
    loop {
        if let Err(trouble) = push_once(&settings, &push, &clock).await {
            let wait_s = with_jitter(pause_s);
            let words = format!("{trouble}; next attempt in {:.0} s", wait_s);
            print_remark(format_args!("{words}"));
            let again_unix_s = unix_time_s() + wait_s;
            publish(&settings, false, Some((trouble.to_string(), again_unix_s)));
            clock.sleep_s(wait_s).await;
            pause_s = (2.0 * pause_s).min(PAUSES_S[1]);
            continue;
        }
        pause_s = PAUSES_S[0];
        if let Some(after_s) = settings.captures_after_s
            && clock.now_s() >= next_thin_s
        {
            next_thin_s = clock.now_s() + THIN_EVERY_S;
            if let Err(trouble) = move_due_captures(&settings, after_s).await {
                print_remark(format_args!("captures stay where they are: {trouble}"));
            }
        }
        publish(&settings, false, None);
        clock.sleep_s(args.every_s).await;
    }
}

/// Performs the due work once.
async fn push_once(settings: &Settings, push: &PushArgs, clock: &Clock) -> Result<(), Failure> {
    let archive = Archive::open(settings.clone())?;
    let mut published_s: Option<f64> = None;
    let between = || {
        if published_s.is_none_or(|at_s| clock.now_s() - at_s >= STATUS_EVERY_S) {
            published_s = Some(clock.now_s());
            publish(settings, true, None);
        }
        Ok(())
    };
    let report = push_due(&archive, push, clock, between).await?;
    match report.failed {
        0 => Ok(()),
        failed => Err(Failure::Store(format!(
            "{failed} runs could not be archived"
        ))),
    }
}

async fn move_due_captures(settings: &Settings, after_s: f64) -> Result<(), Failure> {
    let archive = Archive::open(settings.clone())?;
    let sources = archive.sources(&[])?;
    move_captures(&archive, &sources, after_s, false).await?;
    Ok(())
}

/// Writes the status for the server. A failure is only a remark, because the runs are more
/// important.
fn publish(settings: &Settings, in_work: bool, trouble: Option<(String, f64)>) {
    let written = read_status(settings).and_then(|mut status| {
        status.in_work = in_work;
        status.written_unix_s = unix_time_s();
        (status.trouble, status.again_unix_s) = trouble.unzip();
        write_status(&settings.data, &status)
    });
    if let Err(error) = written {
        print_remark(format_args!("the status is out of date: {error}"));
    }
}
