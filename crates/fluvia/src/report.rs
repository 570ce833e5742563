//! What the program says: results on standard output, everything else on standard error.

use std::fmt::Display;
use std::io::Write;

use indicatif::{ProgressBar, ProgressStyle};

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

    /// A bar on a terminal, unless nothing is to be said; drawn nowhere else.
    pub fn bar(&self, length: u64) -> ProgressBar {
        if self.quiet { ProgressBar::hidden() } else { ProgressBar::new(length) }
    }

    /// A [`bar`](Report::bar) that looks like the template.
    pub fn bar_like(&self, length: u64, template: &str) -> ProgressBar {
        let style = ProgressStyle::with_template(template);
        self.bar(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    }

    /// Whether progress may be drawn.
    pub fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// The one line of an error, with its causes.
    pub fn error(&self, error: &anyhow::Error) {
        complain(&format!("error: {}", one_line(error)));
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

/// An error and its causes in one line; errors of the libraries end with their cause already.
pub fn one_line(error: &anyhow::Error) -> String {
    let mut line = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !line.ends_with(&cause) {
            line.push_str(": ");
            line.push_str(&cause);
        }
    }
    line.replace(['\n', '\r'], " ")
}

/// Writes a line to standard error; where that is closed there is nobody to tell.
fn complain(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// "1 particle", "2 particles".
pub fn counted(count: usize, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// A row of a Markdown table.
pub fn row(name: &str, cells: impl Iterator<Item = String>) -> String {
    format!("| {name} |{}", cells.map(|cell| format!(" {cell} |")).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_said_once() {
        let missing = || std::io::Error::from(std::io::ErrorKind::NotFound);
        let library = fluvia_sim::Error::io("a.json")(missing());
        let line = one_line(&anyhow::Error::new(library).context("no scene"));
        assert_eq!(line, "no scene: a.json: entity not found");
        let line = one_line(&anyhow::Error::new(missing()).context("two\nlines"));
        assert_eq!(line, "two lines: entity not found");
    }
}
