//! The end of the pipeline: a recording with its own account of the frames, or nothing (then only
//! the numbers count).

use super::StageError;
use super::packet::Packet;
use super::stages::Sink;
use super::statistics::{Drops, Statistics};
use crate::frame::{ColorFrame, FrameTime};
use crate::recording::{RecordingError, RecordingSummary, RecordingWriter};
use std::sync::{Arc, Mutex, PoisonError};

/// Statistics are recorded this often in stream time, ns.
const STATISTICS_NS: i64 = 1_000_000_000;

/// One camera's side of a recording being written, or nothing.
#[derive(Default)]
pub struct Recorder {
    /// Shared by all cameras; the last to finish closes it.
    writer: Option<Arc<Mutex<RecordingWriter>>>,
    /// The camera's number in the recording.
    camera: usize,
    /// What became of the recording.
    pub summary: Option<RecordingSummary>,
    statistics: Option<Statistics>,
    told_ns: i64,
    last: FrameTime,
    drops: Drops,
    /// Frames of the camera that are safe, after a failure.
    kept: Option<u64>,
    /// What went wrong after a frame had been taken: told when the next one comes.
    late: Option<StageError>,
}

impl Recorder {
    /// Hands frames to `writer`.
    #[must_use]
    pub fn new(writer: RecordingWriter) -> Self {
        Self::side(&Arc::new(Mutex::new(writer)), 0)
    }

    /// Hands frames of `cameras` cameras to `writer`, each from a pipeline of its own.
    #[must_use]
    pub fn rig(writer: RecordingWriter, cameras: usize) -> Vec<Self> {
        let writer = Arc::new(Mutex::new(writer));
        (0..cameras)
            .map(|camera| Self::side(&writer, camera))
            .collect()
    }

    fn side(writer: &Arc<Mutex<RecordingWriter>>, camera: usize) -> Self {
        Self {
            writer: Some(Arc::clone(writer)),
            camera,
            ..Self::default()
        }
    }

    /// Writes, where there is anything to write to. Notes what is safe where that fails.
    fn write(
        &mut self,
        write: impl FnOnce(&mut RecordingWriter, usize) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        let Some(writer) = &self.writer else {
            return Ok(());
        };
        // a camera whose thread panicked has left whole messages behind
        let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
        let result = write(&mut writer, self.camera);
        self.kept = self.kept.or(kept(&writer, self.camera, &result));
        result
    }

    /// Puts the numbers of the last second into the recording, and the account so far.
    fn record_statistics(&mut self, now_ns: i64) -> Result<(), StageError> {
        self.told_ns = now_ns;
        if let (Some(_), Some(statistics)) = (&self.writer, &mut self.statistics) {
            statistics.take_over(&self.drops);
            let mut report = serde_json::to_value(statistics.interval(now_ns))?;
            let total = statistics.total(now_ns);
            report["total"] = serde_json::json!({
                "sensor_frames": total.sensor_frames,
                "frames": total.frames,
                "drops": total.drops,
                "spent_bits": total.spent_bits,
            });
            let last = self.last;
            self.write(|writer, camera| writer.statistics_of(camera, &report, last))?;
        }
        Ok(())
    }

    fn tell_late(&mut self) -> Result<(), StageError> {
        self.late.take().map_or(Ok(()), Err)
    }
}

/// Frames of a camera that are safe where the recording has failed.
fn kept<T>(
    writer: &RecordingWriter,
    camera: usize,
    result: &Result<T, RecordingError>,
) -> Option<u64> {
    let failed = result
        .as_ref()
        .is_err_and(|error| error.kept_frames().is_some());
    failed.then(|| writer.kept_frames_of(camera))
}

impl Sink for Recorder {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        self.tell_late()?;
        if self.writer.is_none() {
            return Ok(());
        }
        self.write(|writer, camera| writer.frame_of(camera, &packet.encoded))?;
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
        Ok(self.write(|writer, camera| writer.color_of(camera, color))?)
    }

    fn idle(&mut self) -> Result<(), StageError> {
        Ok(self.write(|writer, _| writer.idle())?)
    }

    fn finish(&mut self) -> Result<(), StageError> {
        let told = self.tell_late().and_then(|()| match self.kept {
            None => self.record_statistics(self.last.device_ns),
            // it has failed, and said so
            Some(_) => Ok(()),
        });
        let Some(writer) = self.writer.take().and_then(Arc::into_inner) else {
            return told;
        };
        if self.kept.is_none() {
            let mut writer = writer.into_inner().unwrap_or_else(PoisonError::into_inner);
            let summary = writer.finish();
            self.kept = kept(&writer, self.camera, &summary);
            self.summary = Some(summary?);
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
