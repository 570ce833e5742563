//! What the program says: results on standard output, everything else on standard error.

use std::fmt::Display;
use std::io::Write;

/// How much is said.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    quiet: bool,
    verbose: bool,
}

impl Report {
    pub fn new(quiet: bool, verbose: bool) -> Report {
        Report { quiet, verbose }
    }

    /// Whether progress may be drawn.
    pub fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// The one line of an error, with its causes.
    pub fn error(&self, error: &anyhow::Error) {
        let line = format!("{error:#}").replace('\n', " ");
        complain(&format!("error: {line}"));
    }

    /// A line about something that the user should know.
    pub fn warning(&self, message: impl Display) {
        if !self.quiet {
            complain(&format!("warning: {message}"));
        }
    }

    /// A line about what is done.
    pub fn note(&self, message: impl Display) {
        if !self.quiet {
            complain(&message.to_string());
        }
    }

    /// A line for those who want to know more.
    pub fn detail(&self, message: impl Display) {
        if self.verbose {
            complain(&message.to_string());
        }
    }

    /// A line of what was asked for.
    ///
    /// # Errors
    /// If standard output cannot be written; a reader that has closed it is no error.
    pub fn result(&self, message: impl Display) -> anyhow::Result<()> {
        match writeln!(std::io::stdout(), "{message}") {
            Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
                Err(anyhow::Error::new(error).context("standard output"))
            }
            _ => Ok(()),
        }
    }
}

/// Writes a line to standard error; where that is closed there is nobody to tell.
fn complain(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
