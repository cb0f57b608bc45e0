//! Is every byte and every frame of a recording as it was written?
//!
//! What covers which byte of a whole file:
//!
//! | bytes | guarded by |
//! |---|---|
//! | magic to the last record of the data section | the data section's CRC-32, in its end mark |
//! | the end mark (13 bytes) | its value is compared with the bytes it must hold |
//! | summary and footer | the summary's CRC-32 |
//! | closing magic | its value |
//!
//! Nothing is left over, so any flipped byte is found. Beside that each chunk has its CRC, which
//! says *which* frames are hit, and each payload its own. A file that was cut has lost the CRC of
//! its data section: there chunks and payloads speak for themselves, and the records between
//! chunks (MCAP's message indexes, which this program does not use) are not guarded.

use super::container::{PREFIX, Source};
use super::index::End;
use super::message::{self, FrameHeader};
use super::{RecordingError, RecordingReader, raw};
use crate::codec::{EncodedFrame, PayloadDecoder};
use mcap::records::op;
use serde::Serialize;
use std::path::Path;

/// Faults and gaps listed one by one; more are only counted.
const MOST_LISTED: usize = 1000;
/// A step in time this many times longer than the frames' numbers say is a pause.
const PAUSE: f64 = 2.0;
/// Bytes read at once.
const PIECE: u64 = 1 << 20;

/// Something that is not as it was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The camera's name, where one is concerned.
    pub camera: Option<String>,
    /// First frame that is damaged or cannot be decoded, where frames are.
    pub from: Option<u64>,
    /// The last of them.
    pub to: Option<u64>,
    /// Where in the file, bytes, where that is known.
    pub offset: Option<u64>,
    /// What is wrong.
    pub what: String,
}

/// Frames that never were in the recording, or a pause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// The camera's name.
    pub camera: String,
    /// The frame before it.
    pub after: u64,
    /// Numbers the source skipped; 0 for a pause.
    pub missing: u64,
    /// Time between the frames around it, milliseconds.
    pub step_ms: f64,
}

/// What a check has found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CheckReport {
    /// The file.
    pub path: String,
    /// Its size, bytes.
    pub bytes: u64,
    /// Frames of all cameras that can be read.
    pub frames: u64,
    /// Key frames among them.
    pub key_frames: u64,
    /// True where every frame was decoded, too.
    pub decoded: bool,
    /// The file ends before its end mark.
    pub cut: bool,
    /// Faults in all.
    pub fault_count: u64,
    /// The first thousand of them.
    pub faults: Vec<Finding>,
    /// Gaps in all. A gap is no fault: the frames were lost before they were recorded.
    pub gap_count: u64,
    /// The first thousand of them.
    pub gaps: Vec<Gap>,
}

impl CheckReport {
    /// True where everything is as it was written.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.fault_count == 0
    }

    fn fault(&mut self, finding: Finding) {
        self.fault_count += 1;
        if self.faults.len() < MOST_LISTED {
            self.faults.push(finding);
        }
    }

    fn gap(&mut self, gap: Gap) {
        self.gap_count += 1;
        if self.gaps.len() < MOST_LISTED {
            self.gaps.push(gap);
        }
    }
}

/// Checks a recording: every byte, every frame's place and, with `decode`, its payload. `keep_on`
/// is asked with the number of frames done; `false` ends the check early.
///
/// # Errors
/// As [`RecordingReader::open`]: a file of which nothing can be read. Damage is no error here.
pub fn check(
    path: &Path,
    decode: bool,
    keep_on: &mut dyn FnMut(u64) -> bool,
) -> Result<CheckReport, RecordingError> {
    let reader = RecordingReader::open(path)?;
    let mut report = CheckReport {
        path: path.display().to_string(),
        bytes: reader.source.length,
        cut: reader.index.cut.is_some(),
        decoded: decode,
        ..CheckReport::default()
    };
    for camera in reader.cameras() {
        let reader = RecordingReader::open_camera(path, camera)?;
        Walk::new(reader, camera.clone(), decode).run(&mut report, keep_on);
    }
    if reader.index.rebuilt && !report.cut {
        report.fault(file_fault(
            None,
            "the index at the end of the file is damaged; no frame is lost by that",
        ));
    } else if report.fault_count == 0
        && let Err(what) = data_section(&reader.source)
    {
        report.fault(file_fault(None, &what));
    }
    Ok(report)
}

fn file_fault(offset: Option<u64>, what: &str) -> Finding {
    Finding {
        camera: None,
        from: None,
        to: None,
        offset,
        what: what.to_owned(),
    }
}

/// Compares the data section with the checksum in its end mark.
fn data_section(source: &Source) -> Result<(), String> {
    let end = End::read(source).ok_or("the index at the end of the file is damaged")?;
    let mark_at = end
        .summary_start
        .checked_sub(PREFIX + 4)
        .ok_or("the data section has no end mark")?;
    let mut crc = crc32fast::Hasher::new();
    let mut piece = Vec::new();
    let mut at = 0;
    while at < mark_at {
        let take = PIECE.min(mark_at - at);
        source.fill(at, take, &mut piece)?;
        crc.update(&piece);
        at += take;
    }
    let computed = crc.finalize();
    source.fill(mark_at, PREFIX + 4, &mut piece)?;
    let mut expected = vec![op::DATA_END];
    expected.extend(4u64.to_le_bytes());
    if piece[..expected.len()] != expected {
        return Err(format!(
            "the end mark of the data section at byte {mark_at} is damaged; no frame is lost by that"
        ));
    }
    let written = u32::from_le_bytes([piece[9], piece[10], piece[11], piece[12]]);
    if written == computed {
        return Ok(());
    }
    Err(format!(
        "the data section's checksum is {computed:08x}, {written:08x} was written; every chunk is \
         whole, so the damage lies between them and no frame is lost by it"
    ))
}

/// One camera's frames, from the first to the last.
struct Walk {
    reader: RecordingReader,
    camera: String,
    decoder: Option<PayloadDecoder>,
    frame: EncodedFrame,
    /// The image last unpacked, of a raw capture.
    depth: Vec<u16>,
    /// Header of the frame before.
    before: Option<FrameHeader>,
    /// Mean time from one frame number to the next, ns.
    step_ns: f64,
    /// Frames that cannot be decoded in a row, and why the first cannot.
    undecodable: Option<(u64, String)>,
}

impl Walk {
    fn new(reader: RecordingReader, camera: String, decode: bool) -> Self {
        let info = reader.info();
        let numbers = info.frames.saturating_sub(1) + info.lost_frames;
        Self {
            step_ns: if numbers > 0 {
                info.duration_s * 1e9 / numbers as f64
            } else {
                f64::INFINITY
            },
            reader,
            camera,
            decoder: decode.then(PayloadDecoder::new),
            frame: EncodedFrame::default(),
            depth: Vec::new(),
            before: None,
            undecodable: None,
        }
    }

    fn run(&mut self, report: &mut CheckReport, keep_on: &mut dyn FnMut(u64) -> bool) {
        loop {
            let at = self.reader.position();
            match self.reader.next_frame(&mut self.frame) {
                Ok(true) => {
                    report.frames += 1;
                    report.key_frames += u64::from(self.frame.key);
                    self.look(at, report);
                }
                Ok(false) => break,
                Err(RecordingError::Damaged { offset, what, .. }) => {
                    self.told(at, report);
                    let next = self.reader.position();
                    self.fault(report, (at, next.checked_sub(1)), Some(offset), what);
                    self.before = None;
                }
                Err(RecordingError::Cut { offset, what, .. }) => {
                    self.told(at, report);
                    let what = format!("the file was cut after {at} whole frames: {what}");
                    report.fault(file_fault(Some(offset), &what));
                }
                Err(other) => {
                    report.fault(file_fault(None, &other.to_string()));
                    break;
                }
            }
            if !keep_on(report.frames) {
                return;
            }
        }
        self.told(self.reader.position(), report);
        if let Some(account) = self.reader.info().account {
            let sum = account.frames + account.drops.values().sum::<u64>();
            if sum != account.sensor_frames {
                let what = format!(
                    "the statistics do not balance: {} frames of the sensor, {sum} written and dropped",
                    account.sensor_frames
                );
                report.fault(file_fault(None, &what));
            }
        }
    }

    /// The frame just read: order, header, payload.
    fn look(&mut self, at: u64, report: &mut CheckReport) {
        let now = FrameHeader {
            key: self.frame.key,
            sequence: self.frame.sequence,
            time: self.frame.time,
        };
        if let Some(before) = self.before.replace(now) {
            self.order(at, before, now, report);
        }
        let refused = self.refused(&now);
        match (&mut self.undecodable, refused) {
            (Some(_), Some(_)) => {}
            (none, Some(why)) => *none = Some((at, why)),
            (_, None) => self.told(at, report),
        }
    }

    /// Why the frame cannot be used, where it cannot.
    fn refused(&mut self, now: &FrameHeader) -> Option<String> {
        let payload = &self.frame.payload;
        if self.reader.is_raw() {
            self.decoder.as_ref()?;
            return raw::unpack(self.reader.camera(), payload, &mut self.depth).err();
        }
        if !message::has_whole_payload(payload) {
            return Some("its payload fails its own checksum".to_owned());
        }
        if message::agrees(&(*now, payload.as_slice())) == Some(false) {
            return Some("its header and its payload disagree".to_owned());
        }
        let decoder = self.decoder.as_mut()?;
        decoder.decode(payload).err().map(|error| error.to_string())
    }

    /// Numbers and times of neighbours.
    fn order(&self, at: u64, before: FrameHeader, now: FrameHeader, report: &mut CheckReport) {
        let place = (at, Some(at));
        if now.sequence <= before.sequence {
            let what = format!(
                "its number {} does not follow {}",
                now.sequence, before.sequence
            );
            self.fault(report, place, None, what);
            return;
        }
        let step_ns = now.time.device_ns.saturating_sub(before.time.device_ns);
        if step_ns <= 0 {
            let what = format!(
                "its time {} ns does not lie after {} ns",
                now.time.device_ns, before.time.device_ns
            );
            self.fault(report, place, None, what);
            return;
        }
        let missing = now.sequence - before.sequence - 1;
        let expected_ns = self.step_ns * (missing + 1) as f64;
        if missing > 0 || step_ns as f64 > PAUSE * expected_ns {
            report.gap(Gap {
                camera: self.camera.clone(),
                after: at - 1,
                missing,
                step_ms: step_ns as f64 * 1e-6,
            });
        }
    }

    /// Reports the frames that could not be decoded up to `end`.
    fn told(&mut self, end: u64, report: &mut CheckReport) {
        if let Some((from, why)) = self.undecodable.take() {
            let what = format!("cannot be decoded: {why}");
            self.fault(report, (from, end.checked_sub(1)), None, what);
        }
    }

    fn fault(
        &self,
        report: &mut CheckReport,
        (from, to): (u64, Option<u64>),
        offset: Option<u64>,
        what: String,
    ) {
        // after a scan the numbers of lost frames are lost as well: nothing stands between
        let to = to.filter(|to| *to >= from);
        report.fault(Finding {
            camera: Some(self.camera.clone()),
            from: Some(from),
            to,
            offset,
            what,
        });
    }
}
