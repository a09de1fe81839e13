//! The meaning of a signal for the end of a process: its name, and whether the process itself caused it. Not
//! here: sending signals (`supervisor`).

use rustix::process::Signal;

/// Signals that a process itself may cause: an abort on panic, a bad address, memory or a file that could not
/// grow, an exhausted limit. All others come from outside.
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

/// Names of the signals that occur in practice.
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

/// Returns the name of a signal.
pub fn name(signal: i32) -> String {
    let named = NAMES.iter().find(|(known, _)| known.as_raw() == signal);
    named.map_or_else(|| format!("signal {signal}"), |(_, name)| (*name).to_owned())
}

/// True if a process that was ended by this signal cannot have caused the signal itself.
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
