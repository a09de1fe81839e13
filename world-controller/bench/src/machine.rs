//! The machine of a measurement, and the costs of processes on it, from Linux's /proc.

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;
use std::fs::read_to_string;
use std::time::Duration;

/// The machine of a measurement.
#[derive(Debug, Serialize)]
pub struct Machine {
    /// The processor's name.
    pub processor: String,
    /// Processors that this program may use.
    pub processors: usize,
    /// Memory in bytes.
    pub memory_bytes: u64,
    /// The kernel's release.
    pub kernel: String,
    /// Mean number of runnable threads over the minute before the measurement; above `processors`, times are
    /// those of a busy machine.
    pub load: f64,
}

impl Machine {
    /// Returns this machine.
    pub fn this() -> Machine {
        let read = |path| read_to_string(path).unwrap_or_default();
        let after = |text: &str, key: &str| -> Option<String> {
            let line = text.lines().find(|l| l.starts_with(key))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        Machine {
            processor: after(&read("/proc/cpuinfo"), "model name").unwrap_or_else(|| "unknown".to_owned()),
            processors: std::thread::available_parallelism().map_or(1, |n| n.get()),
            memory_bytes: after(&read("/proc/meminfo"), "MemTotal").and_then(|t| kilobytes(&t)).unwrap_or(0),
            kernel: read("/proc/sys/kernel/osrelease").trim().to_owned(),
            load: read("/proc/loadavg").split(' ').next().and_then(|l| l.parse().ok()).unwrap_or(0.0),
        }
    }
}

/// Converts `1234 kB` to bytes.
fn kilobytes(text: &str) -> Option<u64> {
    text.split_ascii_whitespace().next()?.parse::<u64>().ok().map(|kb| kb << 10)
}

fn field(path: &str, key: &str) -> Option<u64> {
    let text = read_to_string(path).ok()?;
    let line = text.lines().find(|l| l.starts_with(key))?;
    kilobytes(line.split_once(':')?.1)
}

/// Returns the peak resident memory of this process, in bytes.
pub fn peak_memory() -> u64 {
    field("/proc/self/status", "VmHWM").unwrap_or(0)
}

/// Returns the memory available to new processes without swapping, in bytes.
pub fn available_memory() -> u64 {
    field("/proc/meminfo", "MemAvailable").unwrap_or(0)
}

/// Returns the proportional set size of a process, in bytes.
pub fn proportional_memory(pid: u32) -> u64 {
    field(&format!("/proc/{pid}/smaps_rollup"), "Pss").unwrap_or(0)
}

/// Returns the processor time of all threads of a process.
pub fn ran(pid: u32) -> Duration {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let time = |thread: std::fs::DirEntry| -> Option<u64> {
        read_to_string(thread.path().join("schedstat")).ok()?.split_ascii_whitespace().next()?.parse().ok()
    };
    Duration::from_nanos(threads.filter_map(time).sum())
}

/// Returns the number of files that this process has open.
pub fn open_files() -> u64 {
    std::fs::read_dir("/proc/self/fd").map_or(0, |files| files.count() as u64)
}

/// Returns the child processes of this one that have not been waited for.
pub fn children() -> Vec<u32> {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let text: String =
        tasks.filter_map(|t| read_to_string(t.path().join("children")).ok()).collect::<Vec<_>>().join(" ");
    text.split_ascii_whitespace().filter_map(|pid| pid.parse().ok()).collect()
}

/// Processor time of this thread, independent of other load.
#[derive(Clone, Copy, Debug)]
pub struct CpuWatch(Duration);

impl CpuWatch {
    /// Starts the watch.
    pub fn start() -> CpuWatch {
        let t = clock_gettime(ClockId::ThreadCPUTime);
        // Invariant: this clock starts at zero and never goes back.
        CpuWatch(Duration::new(t.tv_sec as u64, t.tv_nsec as u32))
    }
    /// Returns the time since the start.
    pub fn elapsed(self) -> Duration {
        CpuWatch::start().0.saturating_sub(self.0)
    }
}
