//! SIGINT and SIGTERM: the first ends the run and finalises the output, the second kills with 130.

use super::failure::{Failure, Kind};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a run that was killed by a second Ctrl-C.
const KILLED: i32 = 130;

/// A flag that the first signal raises.
pub fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // in this order: the second signal finds the flag raised by the first
        signal_hook::flag::register_conditional_shutdown(signal, KILLED, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .map_err(|source| {
                Failure::new(
                    Kind::Failure,
                    format_args!("cannot handle signals: {source}"),
                )
            })?;
    }
    Ok(stop)
}
