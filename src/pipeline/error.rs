//! What can end a pipeline early.

use crate::capture::CaptureError;

/// An error of a stage, as the stage itself reports it.
pub type StageError = Box<dyn std::error::Error + Send + Sync>;

/// The stages, in the order a frame passes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Reads the source.
    Capture,
    /// Finds spheres and the contact map.
    Model,
    /// Writes the frame as bytes.
    Encode,
    /// Hands the bytes on: file, pipe.
    Sink,
    /// Reads the colour camera beside the depth camera.
    Color,
}

impl Stage {
    /// The stage's name, which is also its thread's.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Capture => "capture",
            Self::Model => "model",
            Self::Encode => "encode",
            Self::Sink => "sink",
            Self::Color => "color",
        }
    }
}

/// Why a pipeline ended before its source did. What was written before is kept.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The source cannot go on.
    #[error(transparent)]
    Source(#[from] CaptureError),
    /// The model or encode stage refused a frame.
    #[error("frame {sequence}: {} failed: {source}", .stage.name())]
    Stage {
        /// Which stage.
        stage: Stage,
        /// The source's number of the frame.
        sequence: u64,
        /// What the stage said.
        source: StageError,
    },
    /// The output cannot be written; what was written so far is kept.
    #[error("output failed: {0}")]
    Sink(#[source] StageError),
    /// The trace file cannot be written.
    #[error("trace failed: {0}")]
    Trace(#[source] std::io::Error),
    /// A stage broke its own rules: a defect of the program, not of the input.
    #[error("the {} stage panicked: {message}; please report this", .stage.name())]
    Panic {
        /// Which stage.
        stage: Stage,
        /// The panic's message.
        message: String,
    },
    /// The system refused a thread.
    #[error("cannot start the {} thread: {source}; free memory or use --threads 1", .stage.name())]
    Spawn {
        /// Which stage.
        stage: Stage,
        /// What the system said.
        source: std::io::Error,
    },
}

impl PipelineError {
    /// True where the reader of our output went away (a closed pipe): no fault of ours.
    #[must_use]
    pub fn is_broken_pipe(&self) -> bool {
        let mut next: Option<&(dyn std::error::Error + 'static)> = match self {
            Self::Sink(source) => Some(source.as_ref()),
            _ => None,
        };
        while let Some(error) = next {
            if let Some(io) = error.downcast_ref::<std::io::Error>()
                && io.kind() == std::io::ErrorKind::BrokenPipe
            {
                return true;
            }
            next = error.source();
        }
        false
    }
}

/// The text of a caught panic.
pub(crate) fn panic_message(payload: &(dyn std::any::Any + Send)) -> String {
    if let Some(text) = payload.downcast_ref::<&str>() {
        (*text).to_owned()
    } else if let Some(text) = payload.downcast_ref::<String>() {
        text.clone()
    } else {
        "no message".to_owned()
    }
}
