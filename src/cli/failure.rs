//! How a command ends when it does not end well, and the exit code that says so.

use saint_live::capture::CaptureError;
use saint_live::cloud::CloudError;
use saint_live::model::file::ModelFileError;
use saint_live::pipeline::PipelineError;
use saint_live::recording::RecordingError;
use saint_live::rig::RigError;
use std::fmt;
use std::io;

/// What went wrong, in the classes a script tells apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Standard output was closed by its reader: no failure.
    Closed,
    /// A fault of the program or the system.
    Failure,
    /// The request is wrong.
    Usage,
    /// The device cannot be used.
    Device,
    /// The input is missing or damaged.
    Input,
    /// The output cannot be written; what was written is valid.
    Output,
    /// The latency budget was missed under `--strict`.
    Budget,
}

/// A failed command: kind and message.
#[derive(Debug)]
pub struct Failure {
    kind: Kind,
    message: String,
}

impl Failure {
    /// A failure of this kind.
    pub fn new(kind: Kind, message: impl fmt::Display) -> Self {
        Self {
            kind,
            message: message.to_string(),
        }
    }

    /// The same failure, with its place in front.
    pub fn at(self, place: &str) -> Self {
        Self {
            message: format!("{place}: {}", self.message),
            ..self
        }
    }

    /// A wrong request.
    pub fn usage(message: impl fmt::Display) -> Self {
        Self::new(Kind::Usage, message)
    }

    /// Standard output could not be written.
    pub fn stdout(source: &io::Error) -> Self {
        if source.kind() == io::ErrorKind::BrokenPipe {
            Self::new(Kind::Closed, "")
        } else {
            Self::new(Kind::Output, format_args!("standard output: {source}"))
        }
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        match self.kind {
            Kind::Closed => 0,
            Kind::Failure => 1,
            Kind::Usage => 2,
            Kind::Device => 3,
            Kind::Input => 4,
            Kind::Output => 5,
            Kind::Budget => 6,
        }
    }

    /// True where the output failed.
    pub fn is_output(&self) -> bool {
        self.kind == Kind::Output
    }

    /// True where there is nothing to say.
    pub fn is_silent(&self) -> bool {
        self.kind == Kind::Closed
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<CaptureError> for Failure {
    fn from(error: CaptureError) -> Self {
        let kind = match &error {
            CaptureError::Usage(_) => Kind::Usage,
            CaptureError::Device { .. } => Kind::Device,
            CaptureError::Input { .. } => Kind::Input,
        };
        Self::new(kind, error)
    }
}

impl From<RigError> for Failure {
    fn from(error: RigError) -> Self {
        Self::new(Kind::Input, error)
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        let kind = match &error {
            RecordingError::Exists { .. }
            | RecordingError::NoSuchFrame { .. }
            | RecordingError::NoSuchCamera { .. }
            | RecordingError::NoParts { .. } => Kind::Usage,
            RecordingError::Closed { .. } => Kind::Closed,
            RecordingError::Unwritable { .. }
            | RecordingError::DiskFull { .. }
            | RecordingError::FileLimit { .. }
            | RecordingError::Vanished { .. }
            | RecordingError::Write { .. }
            | RecordingError::TooLarge { .. } => Kind::Output,
            RecordingError::Finished { .. } | RecordingError::Container { .. } => Kind::Failure,
            _ => Kind::Input,
        };
        Self::new(kind, error)
    }
}

impl From<CloudError> for Failure {
    fn from(error: CloudError) -> Self {
        Self::new(Kind::Input, error)
    }
}

impl From<ModelFileError> for Failure {
    fn from(error: ModelFileError) -> Self {
        let kind = match error {
            ModelFileError::File(error) => return error.into(),
            ModelFileError::NoSuch { .. } => Kind::Usage,
            _ => Kind::Input,
        };
        Self::new(kind, error)
    }
}

impl From<PipelineError> for Failure {
    fn from(error: PipelineError) -> Self {
        if error.is_broken_pipe() {
            return Self::new(Kind::Closed, error);
        }
        match error {
            PipelineError::Source(error) => error.into(),
            PipelineError::Sink(_) | PipelineError::Trace(_) => Self::new(Kind::Output, error),
            _ => Self::new(Kind::Failure, error),
        }
    }
}
