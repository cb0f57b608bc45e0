//! The machine a figure was measured on.

use serde::Serialize;
use std::fs;

/// Processor and cores.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Processor name, as the kernel gives it.
    pub cpu: String,
    /// Cores this process may use.
    pub cores: usize,
    /// Kernel architecture.
    pub arch: &'static str,
}

impl Machine {
    /// This machine.
    pub fn this() -> Self {
        Self {
            cpu: proc_line("/proc/cpuinfo", "model name").unwrap_or_else(|| "unknown".to_owned()),
            cores: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            arch: std::env::consts::ARCH,
        }
    }
}

/// Memory the process holds now, MB (10⁶ bytes); 0 where the system does not say.
pub fn resident_mb() -> f64 {
    status_mb("VmRSS")
}

/// The most memory the process has held, MB (10⁶ bytes); 0 where the system does not say.
pub fn peak_mb() -> f64 {
    status_mb("VmHWM")
}

fn status_mb(key: &str) -> f64 {
    let kib = proc_line("/proc/self/status", key).and_then(|text| {
        let number = text.split_whitespace().next()?;
        number.parse::<f64>().ok()
    });
    kib.map_or(0.0, |kib| kib * 1024.0 * 1e-6)
}

/// The value of the first `key : value` line.
fn proc_line(path: &str, key: &str) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    text.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        (name.trim() == key).then(|| value.trim().to_owned())
    })
}
