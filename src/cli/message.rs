//! Messages for people, on standard error: log lines, and one line that is rewritten in place.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use tracing_subscriber::fmt::MakeWriter;

/// True while a status line stands at the cursor.
static STATUS: AtomicBool = AtomicBool::new(false);

/// Sends what the library notes to standard error: warnings, with `-v` more, with `-q` errors only.
pub fn start(quiet: bool, verbose: u8) {
    let level = match (quiet, verbose) {
        (true, _) => tracing::Level::ERROR,
        (false, 0) => tracing::Level::WARN,
        (false, 1) => tracing::Level::INFO,
        (false, 2) => tracing::Level::DEBUG,
        (false, _) => tracing::Level::TRACE,
    };
    // a second start (there is none) would be refused: nothing is lost
    let _ = tracing_subscriber::fmt()
        .with_max_level(level)
        .with_target(verbose > 1)
        .without_time()
        .with_ansi(io::stderr().is_terminal())
        .with_writer(AboveStatus)
        .try_init();
}

/// Says one line. Standard error that is closed is no reason to fail.
pub fn say(line: &str) {
    let _ = writeln!(Above, "{line}");
}

/// Says what an output has become.
pub fn wrote(target: &str, parts: u32, frames: u64, bytes: u64) {
    let parts = match parts {
        1 => String::new(),
        n => format!("{n} parts up to "),
    };
    say(&format!(
        "wrote {parts}{target}: {frames} frames, {bytes} bytes"
    ));
}

/// Rewrites the status line (terminals only).
pub fn status(line: &str) {
    STATUS.store(true, Ordering::Relaxed);
    let mut out = io::stderr().lock();
    let _ = write!(out, "\r{line}\x1b[K");
    let _ = out.flush();
}

/// Ends the status line, leaving its last state.
pub fn end_status() {
    if STATUS.swap(false, Ordering::Relaxed) {
        let _ = writeln!(io::stderr());
    }
}

/// Standard error, after the status line was wiped.
struct Above;

impl Write for Above {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut out = io::stderr().lock();
        if STATUS.swap(false, Ordering::Relaxed) {
            out.write_all(b"\r\x1b[K")?;
        }
        out.write_all(bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// Makes [`Above`] for each log line.
struct AboveStatus;

impl<'a> MakeWriter<'a> for AboveStatus {
    type Writer = Box<dyn Write + 'a>;

    fn make_writer(&'a self) -> Self::Writer {
        Box::new(Above)
    }
}
