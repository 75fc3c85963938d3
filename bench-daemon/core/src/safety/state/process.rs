//! Processes of this machine, as reported by the system (proc(5)).

/// Returns the process ID of this process.
pub fn pid() -> i32 {
    nix::unistd::Pid::this().as_raw()
}

/// Returns when a process began, in ticks since the machine started, or `None` if the process is
/// gone. A reused process ID has a different start time.
pub fn began(pid: i32) -> Option<u64> {
    field(pid, 19)?.parse().ok()
}

/// Checks whether a process exists and is stopped, so that it cannot react.
pub fn is_stopped(pid: i32) -> bool {
    field(pid, 0).is_some_and(|state| matches!(state.as_str(), "T" | "t"))
}

/// Returns a field that follows the program name. The name is in parentheses and may contain any
/// character.
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
        // This process ID does not exist.
        assert_eq!(began(i32::MAX), None);
    }
}
