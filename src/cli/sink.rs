//! Where frames go: a recording, or nowhere (then only the numbers count).

use super::args::{StreamArgs, SyncArg};
use super::failure::Failure;
use saint_live::frame::{Camera, ColorFrame, FrameTime};
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::Packet;
use saint_live::pipeline::stages::Sink;
use saint_live::pipeline::statistics::Drops;
use saint_live::pipeline::statistics::Statistics;
use saint_live::recording::{
    RecordingError, RecordingSummary, RecordingWriter, Sync, Target, WriterOptions,
};
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
    drops: Drops,
    /// Frames that are safe, after a failure.
    kept: Option<u64>,
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
        let options = WriterOptions {
            notes,
            sync: match args.sync {
                SyncArg::End => Sync::End,
                SyncArg::Chunk => Sync::Chunk,
            },
            split: args.split,
        };
        let writer = RecordingWriter::create(target, camera, &options)?;
        Ok(Self {
            writer: Some(writer),
            ..Self::default()
        })
    }

    /// Puts the numbers of the last second into the recording, and the account so far.
    fn record_statistics(&mut self, now_ns: i64) -> Result<(), StageError> {
        let mut told = Ok(());
        if let (Some(writer), Some(statistics)) = (&mut self.writer, &mut self.statistics) {
            statistics.take_over(&self.drops);
            let mut report = serde_json::to_value(statistics.interval(now_ns))?;
            let total = statistics.total(now_ns);
            report["total"] = serde_json::json!({
                "sensor_frames": total.sensor_frames,
                "frames": total.frames,
                "drops": total.drops,
            });
            told = writer.statistics(&report, self.last);
        }
        self.told_ns = now_ns;
        Ok(self.noted(told)?)
    }

    /// Notes what is safe where the recording has failed.
    fn noted<T>(&mut self, result: Result<T, RecordingError>) -> Result<T, RecordingError> {
        if let Err(error) = &result {
            self.kept = self.kept.or(error.kept_frames());
        }
        result
    }
}

impl Sink for Output {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let written = writer.frame(&packet.encoded);
        self.noted(written)?;
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
        let written = self.writer.as_mut().map_or(Ok(()), |w| w.color(color));
        Ok(self.noted(written)?)
    }

    fn idle(&mut self) -> Result<(), StageError> {
        let written = self.writer.as_mut().map_or(Ok(()), RecordingWriter::idle);
        Ok(self.noted(written)?)
    }

    fn finish(&mut self) -> Result<(), StageError> {
        if self.kept.is_some() {
            // it has failed, and said so
            return Ok(());
        }
        let told = self.record_statistics(self.last.device_ns);
        if let Some(writer) = self.writer.take() {
            let summary = writer.finish();
            self.summary = self.noted(summary).map(Some)?;
        }
        told
    }

    fn account(&mut self, drops: &Drops) {
        self.drops = *drops;
    }

    fn kept(&self) -> Option<u64> {
        self.kept
    }
}
