//! Exit status of the program, errors of commands, and reasons why a measurement stops early.

use std::process::ExitCode;

use relight::files;
use relight::graph::{Diagnostic, Ending, RunReport};

use super::messages;

/// The exit status of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    Done,
    /// A stage failed, or `--verify` or `cache verify` found a difference or damage.
    Failed,
    /// Arguments or files that cannot be used.
    Bad,
    Interrupted,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}

impl Exit {
    /// Returns the status code that the shell receives: 0, 1, 2 or 130.
    pub fn code(self) -> u8 {
        match self {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::Bad => 2,
            Exit::Interrupted => 130,
        }
    }

    /// The status of a run. It is [`Exit::Bad`] where bad files explain every failure.
    pub fn of(run: &RunReport) -> Exit {
        match run.ending() {
            Ending::Complete => Exit::Done,
            Ending::Failed => Exit::Failed,
            Ending::BadInput => Exit::Bad,
            Ending::Cancelled => Exit::Interrupted,
        }
    }

    /// The same status, or [`Exit::Failed`] in the place of [`Exit::Done`] unless `sound`.
    pub fn and(self, sound: bool) -> Exit {
        if self == Exit::Done && !sound { Exit::Failed } else { self }
    }
}

/// Arguments or files that a command cannot use: its status is [`Exit::Bad`].
pub struct CliError(Vec<Diagnostic>);

impl CliError {
    /// The faults as text, for a report.
    pub fn text(&self) -> String {
        files::draw(&self.0, false)
    }

    /// Shows the faults on standard error.
    pub fn report(&self) -> Exit {
        messages::raw(&files::draw(&self.0, messages::terminal()));
        Exit::Bad
    }
}

impl From<Vec<Diagnostic>> for CliError {
    fn from(faults: Vec<Diagnostic>) -> CliError {
        CliError(faults)
    }
}

impl From<Diagnostic> for CliError {
    fn from(fault: Diagnostic) -> CliError {
        CliError(vec![fault])
    }
}

/// The reason for which a command that needs whole runs ends early.
pub enum Stop {
    Error(CliError),
    /// A stage failed, or the user interrupted the run; the messages are shown already.
    Ended(Exit),
}

impl<T: Into<CliError>> From<T> for Stop {
    fn from(error: T) -> Stop {
        Stop::Error(error.into())
    }
}

/// Converts the outcome of a command that needs whole runs.
///
/// # Errors
/// Those that are not shown yet.
pub fn ended(outcome: Result<(), Stop>) -> Result<Exit, CliError> {
    match outcome {
        Ok(()) => Ok(Exit::Done),
        Err(Stop::Ended(exit)) => Ok(exit),
        Err(Stop::Error(error)) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight::graph::{NodeReport, Status};

    fn node(status: Status, bad_file: bool) -> NodeReport {
        NodeReport {
            name: "node".into(),
            kind: "Kind",
            status,
            seconds: 0.0,
            rays: 0,
            samples: None,
            stderr: None,
            bytes: 0,
            key: None,
            why: None,
            warnings: vec![],
            notes: vec![],
            error: None,
            bad_file,
        }
    }

    #[test]
    fn the_status_of_a_run_is_that_of_its_worst_node() {
        use Status::{Blocked, Cancelled, Failed, Hit, Ran};
        for (nodes, wanted) in [
            (vec![(Hit, false), (Ran, false)], Exit::Done),
            (vec![(Failed, true), (Blocked, false)], Exit::Bad),
            (vec![(Failed, true), (Failed, false)], Exit::Failed),
            (vec![(Failed, false), (Cancelled, false)], Exit::Interrupted),
        ] {
            let nodes =
                nodes.into_iter().map(|(status, bad_file)| node(status, bad_file)).collect();
            assert_eq!(Exit::of(&RunReport { nodes, ..RunReport::default() }), wanted);
        }
        assert_eq!(
            [Exit::Done.and(false), Exit::Bad.and(false), Exit::Done.and(true)],
            [Exit::Failed, Exit::Bad, Exit::Done]
        );
    }
}
