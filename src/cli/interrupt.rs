//! Ctrl-C and a request to terminate: the run ends within two seconds and leaves nothing unfinished.
//!
//! First the run is asked to stop, which most stages do within a fraction of a second. One that has
//! not after a grace period (a long pass over a large volume, a hanging network drive) is left where
//! it is: what it has under way is removed, and the process exits. A second Ctrl-C does so at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::execution::Cancelled;
use crate::export::abandon_unfinished;

/// Exit code of an interrupted run: 128 and the number of SIGINT, as shells have it.
pub(super) const EXIT_CODE: u8 = 130;

/// How long a run may take to stop by itself.
const GRACE: Duration = Duration::from_millis(1200);

/// Makes Ctrl-C set `cancel`, and see to it that the run ends.
pub(super) fn install(cancel: Arc<AtomicBool>) {
    // Without a handler Ctrl-C still stops the run, only less politely.
    let _ = ctrlc::set_handler(move || {
        if cancel.swap(true, Ordering::Relaxed) {
            leave();
        }
        // In a thread of its own, so that a second Ctrl-C is heard meanwhile.
        std::thread::spawn(|| {
            std::thread::sleep(GRACE);
            leave();
        });
    });
}

#[allow(clippy::print_stderr)] // the run itself can no longer tell
fn leave() {
    let _nothing_more_is_written = abandon_unfinished();
    eprintln!("error: {Cancelled}");
    std::process::exit(EXIT_CODE.into());
}
