//! Ctrl-C and SIGTERM: what runs ends its step, writes what it has and says how to go on. Who does not want to wait for
//! that asks again.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// As shells give it to a process that Ctrl-C has ended.
const INTERRUPTED: u8 = 130;

/// The exit code of what was stopped.
pub fn exit_code() -> ExitCode {
    ExitCode::from(INTERRUPTED)
}

/// A flag that is set when the program is asked to stop; asked again it ends at once, which leaves no half file but
/// temporary ones. To be called once.
///
/// # Errors
/// If the system refuses.
pub fn watch() -> Result<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    let stop = move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(INTERRUPTED.into());
        }
    };
    ctrlc::set_handler(stop).context("cannot watch for Ctrl-C")?;
    Ok(interrupted)
}
