//! Where frames go: a recording, or nowhere (then only the numbers count).

use super::args::StreamArgs;
use super::failure::Failure;
use saint_live::frame::{Camera, ColorFrame, FrameTime};
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::Packet;
use saint_live::pipeline::stages::Sink;
use saint_live::pipeline::statistics::Statistics;
use saint_live::recording::{RecordingSummary, RecordingWriter, Target, WriterOptions};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// Statistics are recorded this often in stream time, ns.
const STATISTICS_NS: i64 = 1_000_000_000;

/// A recording being written, or nothing.
#[derive(Default)]
pub struct Output {
    writer: Option<RecordingWriter>,
    /// What became of the recording.
    pub summary: Option<RecordingSummary>,
    statistics: Option<Statistics>,
    told_ns: i64,
    last: FrameTime,
}

/// True where `-o -` was given.
pub fn is_stdout(args: &StreamArgs) -> bool {
    args.output.as_deref() == Some(Path::new("-"))
}

impl Output {
    /// Opens what `-o` names.
    pub fn open(
        args: &StreamArgs,
        camera: &Camera,
        notes: BTreeMap<String, String>,
    ) -> Result<Self, Failure> {
        let Some(path) = &args.output else {
            return Ok(Self::default());
        };
        let target = if is_stdout(args) {
            if std::io::stdout().is_terminal() {
                return Err(Failure::usage(
                    "-o - writes a binary recording, and standard output is a terminal; redirect it or name a file",
                ));
            }
            Target::stdout()?
        } else {
            Target::File {
                path: path.clone(),
                overwrite: args.overwrite,
            }
        };
        let writer = RecordingWriter::create(target, camera, &WriterOptions { notes })?;
        Ok(Self {
            writer: Some(writer),
            ..Self::default()
        })
    }

    /// Puts the numbers of the last second into the recording.
    fn record_statistics(&mut self, now_ns: i64) -> Result<(), StageError> {
        if let (Some(writer), Some(statistics)) = (&mut self.writer, &mut self.statistics) {
            let report = serde_json::to_value(statistics.interval(now_ns))?;
            writer.statistics(&report, self.last)?;
        }
        self.told_ns = now_ns;
        Ok(())
    }
}

impl Sink for Output {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        writer.frame(&packet.encoded)?;
        // counted by stream time, so that a replay records the same numbers live would
        let now_ns = packet.depth.time.device_ns;
        self.last = packet.depth.time;
        let statistics = self.statistics.get_or_insert_with(|| {
            self.told_ns = now_ns;
            Statistics::new(now_ns, i64::MAX)
        });
        statistics.delivered();
        statistics.written(&packet.record);
        if now_ns - self.told_ns >= STATISTICS_NS {
            self.record_statistics(now_ns)?;
        }
        Ok(())
    }

    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        if let Some(writer) = &mut self.writer {
            writer.color(color)?;
        }
        Ok(())
    }

    fn idle(&mut self) -> Result<(), StageError> {
        if let Some(writer) = &mut self.writer {
            writer.idle()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), StageError> {
        if let Some(writer) = self.writer.take() {
            self.summary = Some(writer.finish()?);
        }
        Ok(())
    }
}
