//! The end of the pipeline: a recording with its own account of the frames, or nothing (then only
//! the numbers count).

use super::StageError;
use super::packet::Packet;
use super::stages::Sink;
use super::statistics::{Drops, Statistics};
use crate::frame::{ColorFrame, FrameTime};
use crate::recording::{RecordingError, RecordingSummary, RecordingWriter};

/// Statistics are recorded this often in stream time, ns.
const STATISTICS_NS: i64 = 1_000_000_000;

/// A recording being written, or nothing.
#[derive(Default)]
pub struct Recorder {
    writer: Option<RecordingWriter>,
    /// What became of the recording.
    pub summary: Option<RecordingSummary>,
    statistics: Option<Statistics>,
    told_ns: i64,
    last: FrameTime,
    drops: Drops,
    /// Frames that are safe, after a failure.
    kept: Option<u64>,
    /// What went wrong after a frame had been taken: told when the next one comes.
    late: Option<StageError>,
}

impl Recorder {
    /// Hands frames to `writer`.
    #[must_use]
    pub fn new(writer: RecordingWriter) -> Self {
        Self {
            writer: Some(writer),
            ..Self::default()
        }
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

    fn tell_late(&mut self) -> Result<(), StageError> {
        self.late.take().map_or(Ok(()), Err)
    }

    /// Notes what is safe where the recording has failed.
    fn noted<T>(&mut self, result: Result<T, RecordingError>) -> Result<T, RecordingError> {
        if let Err(error) = &result {
            self.kept = self.kept.or(error.kept_frames());
        }
        result
    }
}

impl Sink for Recorder {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        self.tell_late()?;
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
        if now_ns.saturating_sub(self.told_ns) >= STATISTICS_NS {
            self.late = self.record_statistics(now_ns).err();
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
        self.tell_late()?;
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
