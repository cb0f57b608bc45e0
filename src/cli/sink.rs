//! Where frames go: a recording, or nowhere (then only the numbers count).

use super::args::StreamArgs;
use super::failure::Failure;
use saint_live::frame::{Camera, ColorFrame, FrameTime};
use saint_live::pipeline::StageError;
use saint_live::pipeline::packet::Packet;
use saint_live::pipeline::stages::Sink;
use saint_live::pipeline::statistics::Statistics;
use saint_live::recording::{
    CameraStream, RecordingError, RecordingSummary, RecordingWriter, Target,
};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Statistics are recorded this often in stream time, ns.
const STATISTICS_NS: i64 = 1_000_000_000;

/// One camera's side of a recording being written, or nothing.
#[derive(Default)]
pub struct Output {
    /// Shared by all cameras; the last to finish closes it.
    writer: Option<Arc<Mutex<RecordingWriter>>>,
    /// The camera's number in the recording.
    camera: usize,
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
    /// Opens what `-o` names, for one camera.
    pub fn open(
        args: &StreamArgs,
        camera: &Camera,
        notes: BTreeMap<String, String>,
    ) -> Result<Self, Failure> {
        let only = CameraStream {
            name: String::new(),
            camera: camera.clone(),
            notes,
        };
        let mut outputs = Self::open_all(args, &[only])?;
        Ok(outputs.pop().unwrap_or_default())
    }

    /// Opens what `-o` names; each camera gets its side of it.
    pub fn open_all(args: &StreamArgs, cameras: &[CameraStream]) -> Result<Vec<Self>, Failure> {
        let Some(path) = &args.output else {
            return Ok(cameras.iter().map(|_| Self::default()).collect());
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
        let writer = RecordingWriter::create_rig(target, cameras)?;
        let writer = Arc::new(Mutex::new(writer));
        let side = |camera| Self {
            writer: Some(Arc::clone(&writer)),
            camera,
            ..Self::default()
        };
        Ok((0..cameras.len()).map(side).collect())
    }

    /// Writes, where there is anything to write to.
    fn write(
        &self,
        write: impl FnOnce(&mut RecordingWriter, usize) -> Result<(), RecordingError>,
    ) -> Result<(), StageError> {
        if let Some(writer) = &self.writer {
            // a camera whose thread panicked has left whole messages behind
            let mut writer = writer.lock().unwrap_or_else(PoisonError::into_inner);
            write(&mut writer, self.camera)?;
        }
        Ok(())
    }

    /// Puts the numbers of the last second into the recording.
    fn record_statistics(&mut self, now_ns: i64) -> Result<(), StageError> {
        if let Some(statistics) = &mut self.statistics {
            let report = serde_json::to_value(statistics.interval(now_ns))?;
            let last = self.last;
            self.write(|writer, camera| writer.statistics_of(camera, &report, last))?;
        }
        self.told_ns = now_ns;
        Ok(())
    }
}

impl Sink for Output {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
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
        if now_ns - self.told_ns >= STATISTICS_NS {
            self.record_statistics(now_ns)?;
        }
        Ok(())
    }

    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        self.write(|writer, camera| writer.color_of(camera, color))
    }

    fn idle(&mut self) -> Result<(), StageError> {
        self.write(|writer, _| writer.idle())
    }

    fn finish(&mut self) -> Result<(), StageError> {
        if let Some(writer) = self.writer.take().and_then(Arc::into_inner) {
            let writer = writer.into_inner().unwrap_or_else(PoisonError::into_inner);
            self.summary = Some(writer.finish()?);
        }
        Ok(())
    }
}
