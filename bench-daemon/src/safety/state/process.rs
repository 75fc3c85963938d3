//! Processes of this machine, as the system tells of them (proc(5)).

/// The number of this process.
pub fn pid() -> i32 {
    nix::unistd::Pid::this().as_raw()
}

/// When a process began, in ticks since the machine did: a number that was given to another process
/// tells another time. None for one that is gone.
pub fn began(pid: i32) -> Option<u64> {
    field(pid, 19)?.parse().ok()
}

/// A process is there and stopped: it hears nothing.
pub fn is_stopped(pid: i32) -> bool {
    field(pid, 0).is_some_and(|state| matches!(state.as_str(), "T" | "t"))
}

/// A field behind the name of the program, which is in parentheses and may hold anything.
fn field(pid: i32, number: usize) -> Option<String> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    text.rsplit_once(')')?
        .1
        .split_whitespace()
        .nth(number)
        .map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_known_by_its_beginning() {
        let own = began(pid());
        assert!(own.is_some() && own == began(pid()) && !is_stopped(pid()));
        // No process has this number.
        assert_eq!(began(i32::MAX), None);
    }
}
