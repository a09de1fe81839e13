//! What a signal says about the end of a process: its name, and whether the process brought it about
//! itself. Absent: sending signals (`supervisor`).

use rustix::process::Signal;

/// Signals that a process of its own accord may end by: a panic that aborts, a bad address, memory or a
/// file that could not grow, a limit that it has used up. Any other one comes from outside.
const OWN: [Signal; 10] = [
    Signal::ABORT,
    Signal::BUS,
    Signal::SEGV,
    Signal::ILL,
    Signal::FPE,
    Signal::SYS,
    Signal::TRAP,
    Signal::PIPE,
    Signal::XCPU,
    Signal::XFSZ,
];

/// Names of the signals that are seen in practice.
const NAMES: [(Signal, &str); 21] = [
    (Signal::ABORT, "SIGABRT"),
    (Signal::BUS, "SIGBUS"),
    (Signal::SEGV, "SIGSEGV"),
    (Signal::ILL, "SIGILL"),
    (Signal::FPE, "SIGFPE"),
    (Signal::SYS, "SIGSYS"),
    (Signal::TRAP, "SIGTRAP"),
    (Signal::PIPE, "SIGPIPE"),
    (Signal::XCPU, "SIGXCPU"),
    (Signal::XFSZ, "SIGXFSZ"),
    (Signal::KILL, "SIGKILL"),
    (Signal::TERM, "SIGTERM"),
    (Signal::INT, "SIGINT"),
    (Signal::HUP, "SIGHUP"),
    (Signal::QUIT, "SIGQUIT"),
    (Signal::USR1, "SIGUSR1"),
    (Signal::USR2, "SIGUSR2"),
    (Signal::STOP, "SIGSTOP"),
    (Signal::TSTP, "SIGTSTP"),
    (Signal::TTIN, "SIGTTIN"),
    (Signal::TTOU, "SIGTTOU"),
];

/// The name of a signal.
pub fn name(signal: i32) -> String {
    let named = NAMES.iter().find(|(known, _)| known.as_raw() == signal);
    named.map_or_else(|| format!("signal {signal}"), |(_, name)| (*name).to_owned())
}

/// Whether a process that ended by this signal was ended by something else.
pub fn is_from_outside(signal: i32) -> bool {
    OWN.iter().all(|own| own.as_raw() != signal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crash_is_told_from_a_kill() {
        let told = |signal: Signal| (name(signal.as_raw()), is_from_outside(signal.as_raw()));
        assert_eq!(told(Signal::KILL), ("SIGKILL".into(), true));
        assert_eq!(told(Signal::TERM), ("SIGTERM".into(), true));
        assert_eq!(told(Signal::BUS), ("SIGBUS".into(), false));
        assert_eq!(told(Signal::ABORT), ("SIGABRT".into(), false));
        assert_eq!((name(40), is_from_outside(40)), ("signal 40".into(), true));
    }
}
