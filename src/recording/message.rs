//! One message of the `saint` channel: a small header, then the frame's payload.
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | u8 | kind: `0x4B` (`K`) decodes alone, `0x50` (`P`) needs the frame before it |
//! | 1 | u64 | the source's frame number; a gap is a frame lost before the encoder |
//! | 9 | i64 | device clock, ns |
//! | 17 | i64 | wall clock (Unix epoch), ns; 0 where it is not known |
//! | 25 | … | payload (`codec/FORMAT.md`), at least one byte |
//!
//! Little endian. A reader MUST reject another kind: a new kind comes with a new message encoding
//! (`saint-live/2`). The kind stands first so that key frames are found without the codec.

use crate::codec::EncodedFrame;
use crate::codec::header::{Header, MAGIC};
use crate::frame::FrameTime;

/// Bytes before the payload.
pub const HEADER: usize = 25;
const KEY: u8 = b'K';
const PREDICTED: u8 = b'P';

/// What stands before the payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// True where the payload decodes alone.
    pub key: bool,
    /// The source's frame number.
    pub sequence: u64,
    /// When the frame was taken.
    pub time: FrameTime,
}

/// Replaces `message` by the frame's header and payload.
pub fn write(frame: &EncodedFrame, message: &mut Vec<u8>) {
    message.clear();
    message.reserve(HEADER + frame.payload.len());
    message.push(if frame.key { KEY } else { PREDICTED });
    message.extend_from_slice(&frame.sequence.to_le_bytes());
    message.extend_from_slice(&frame.time.device_ns.to_le_bytes());
    message.extend_from_slice(&frame.time.wall_ns.to_le_bytes());
    message.extend_from_slice(&frame.payload);
}

/// Splits a message into header and payload. `None` where the bytes are no such message.
#[must_use]
pub fn read(message: &[u8]) -> Option<(FrameHeader, &[u8])> {
    let (header, payload) = message.split_at_checked(HEADER)?;
    let key = match header[0] {
        KEY => true,
        PREDICTED => false,
        _ => return None,
    };
    let eight = |at: usize| header[at..at + 8].try_into().ok();
    let frame = FrameHeader {
        key,
        sequence: u64::from_le_bytes(eight(1)?),
        time: FrameTime {
            device_ns: i64::from_le_bytes(eight(9)?),
            wall_ns: i64::from_le_bytes(eight(17)?),
        },
    };
    (!payload.is_empty()).then_some((frame, payload))
}

/// True where the payload's own checksum holds: its last four bytes, in both domains.
#[must_use]
pub fn has_whole_payload(payload: &[u8]) -> bool {
    payload
        .split_last_chunk::<4>()
        .is_some_and(|(body, check)| u32::from_le_bytes(*check) == crc32fast::hash(body))
}

/// Whether a frame's header repeats what its payload says of kind, number and time; `None` for a
/// payload that does not say it (a polar map). The payload must be whole.
#[must_use]
pub fn agrees((frame, payload): &(FrameHeader, &[u8])) -> Option<bool> {
    let body = payload.strip_suffix(payload.last_chunk::<4>()?)?;
    if !body.starts_with(&MAGIC) {
        return None;
    }
    let (header, ..) = Header::read(body, 0).ok()?;
    let said = (header.stream.is_some(), header.sequence, header.time);
    Some(said == (frame.key, frame.sequence, frame.time))
}

/// Number of the frame that a sensor payload refers to; `None` for one that decodes alone and for
/// other payloads.
#[must_use]
pub fn reference(payload: &[u8]) -> Option<u64> {
    let body = payload.strip_suffix(payload.last_chunk::<4>()?)?;
    let (header, ..) = Header::read(body, 0).ok()?;
    header.stream.is_none().then_some(header.reference)
}
