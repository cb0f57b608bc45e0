//! A timeline of the run in the Chrome trace event format, which Perfetto and chrome://tracing open.
//!
//! The file is a JSON array. It is written in blocks, each of which overwrites the closing bracket
//! of the one before, so the file is valid JSON after every block, however the run ends.

use super::error::Stage;
use super::packet::{FrameRecord, Span};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

/// A block is written when this many bytes wait.
const BLOCK_BYTES: usize = 32 * 1024;
/// What closes the array.
const CLOSE: &str = "\n]\n";

/// An open trace file: one row per stage, one span per stage and frame.
pub struct Trace<W: Write + Seek = File> {
    out: W,
    block: String,
    origin_ns: i64,
}

impl Trace {
    /// Creates the file (replacing an older one); times count from `origin_ns`.
    ///
    /// # Errors
    /// The system's, where the file cannot be created or written.
    pub fn create(path: &Path, origin_ns: i64) -> io::Result<Self> {
        Self::new(File::create(path)?, origin_ns)
    }
}

impl<W: Write + Seek> Trace<W> {
    /// Starts a trace in `out`; times count from `origin_ns`.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, origin_ns: i64) -> io::Result<Self> {
        let mut block = String::with_capacity(BLOCK_BYTES + 1024);
        block.push_str(
            "[\n{\"name\":\"process_name\",\"ph\":\"M\",\"pid\":1,\"tid\":0,\"args\":{\"name\":\"saint-live\"}}",
        );
        for stage in [Stage::Capture, Stage::Model, Stage::Encode, Stage::Sink] {
            let _ = write!(
                block,
                ",\n{{\"name\":\"thread_name\",\"ph\":\"M\",\"pid\":1,\"tid\":{},\"args\":{{\"name\":\"{}\"}}}}",
                row(stage),
                stage.name(),
            );
        }
        block.push_str(CLOSE);
        out.write_all(block.as_bytes())?;
        out.flush()?;
        block.clear();
        Ok(Self {
            out,
            block,
            origin_ns,
        })
    }

    /// Adds the spans of a written frame.
    ///
    /// # Errors
    /// Those of the output, when a block is due.
    pub fn frame(&mut self, record: &FrameRecord) -> io::Result<()> {
        let spans = [
            (Stage::Capture, record.capture),
            (Stage::Model, record.model),
            (Stage::Encode, record.encode),
            (Stage::Sink, record.sink),
        ];
        for (stage, span) in spans {
            self.span(stage, span, record);
        }
        self.write_if_due()
    }

    /// Marks a frame that was given up, and why, at `now_ns`.
    ///
    /// # Errors
    /// Those of the output, when a block is due.
    pub fn dropped(&mut self, sequence: u64, cause: &str, now_ns: i64) -> io::Result<()> {
        let (whole, part) = self.micros(now_ns);
        // writing to a String cannot fail
        let _ = write!(
            self.block,
            ",\n{{\"name\":\"drop: {cause}\",\"ph\":\"i\",\"s\":\"p\",\"pid\":1,\"tid\":1,\"ts\":{whole}.{part:03},\"args\":{{\"frame\":{sequence}}}}}",
        );
        self.write_if_due()
    }

    fn span(&mut self, stage: Stage, span: Span, record: &FrameRecord) {
        let (whole, part) = self.micros(span.start_ns);
        let length = span.length_ns().max(0);
        let _ = write!(
            self.block,
            ",\n{{\"name\":\"{} {}\",\"cat\":\"{}\",\"ph\":\"X\",\"pid\":1,\"tid\":{},\"ts\":{whole}.{part:03},\"dur\":{}.{:03},\"args\":{{\"frame\":{},\"spheres\":{},\"bytes\":{},\"degraded\":{}}}}}",
            stage.name(),
            record.sequence,
            stage.name(),
            row(stage),
            length / 1000,
            length % 1000,
            record.sequence,
            record.modelled.spheres,
            record.bytes,
            record.modelled.degraded,
        );
    }

    /// Whole microseconds since the origin, and thousandths.
    fn micros(&self, ns: i64) -> (i64, i64) {
        let since = (ns - self.origin_ns).max(0);
        (since / 1000, since % 1000)
    }

    fn write_if_due(&mut self) -> io::Result<()> {
        if self.block.len() >= BLOCK_BYTES {
            self.flush()?;
        }
        Ok(())
    }

    /// Writes what waits; the file is complete afterwards.
    ///
    /// # Errors
    /// Those of the output.
    pub fn flush(&mut self) -> io::Result<()> {
        if self.block.is_empty() {
            return Ok(());
        }
        self.block.push_str(CLOSE);
        self.out.seek(SeekFrom::End(-(CLOSE.len() as i64)))?;
        self.out.write_all(self.block.as_bytes())?;
        self.out.flush()?;
        self.block.clear();
        Ok(())
    }
}

/// The row of a stage in the viewer.
const fn row(stage: Stage) -> u32 {
    match stage {
        Stage::Capture => 1,
        Stage::Model => 2,
        Stage::Encode => 3,
        Stage::Sink => 4,
        Stage::Color => 5,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn the_file_is_valid_after_every_block() {
        let mut trace = Trace::new(io::Cursor::new(Vec::new()), 1_000).unwrap();
        let parse = |trace: &Trace<io::Cursor<Vec<u8>>>| -> Vec<Value> {
            let text = std::str::from_utf8(trace.out.get_ref()).unwrap();
            serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
        };
        assert_eq!(parse(&trace).len(), 5);
        let record = FrameRecord {
            sequence: 7,
            model: Span {
                start_ns: 2_500,
                end_ns: 6_000,
            },
            ..FrameRecord::default()
        };
        let mut seen = 5;
        for n in 0..400 {
            trace.frame(&record).unwrap();
            trace.dropped(n, "queue", 9_000).unwrap();
            let now = parse(&trace).len();
            assert!(now >= seen);
            seen = now;
        }
        assert!(seen > 5, "no block was written by itself");
        trace.flush().unwrap();
        let events = parse(&trace);
        assert_eq!(events.len(), 5 + 400 * 5);
        let model = &events[6];
        assert_eq!(model["name"], "model 7");
        assert_eq!(
            (model["ts"].as_f64(), model["dur"].as_f64()),
            (Some(1.5), Some(3.5))
        );
    }
}
