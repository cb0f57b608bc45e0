//! SIGINT and SIGTERM: the first ends the run and finalises the output, the second kills with 130.

use super::failure::{Failure, Kind};
use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a run that was killed by a second Ctrl-C.
const KILLED: i32 = 130;

/// A flag that the first signal raises. A file size limit is met as a write error, not as a death.
pub fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // in this order: the second signal finds the flag raised by the first
        signal_hook::flag::register_conditional_shutdown(signal, KILLED, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .map_err(|source| refused(&source))?;
    }
    // what counts is that it does not kill: the write then fails with "file too large"
    signal_hook::flag::register(SIGXFSZ, Arc::default()).map_err(|source| refused(&source))?;
    Ok(stop)
}

fn refused(source: &std::io::Error) -> Failure {
    Failure::new(
        Kind::Failure,
        format_args!("cannot handle signals: {source}"),
    )
}
