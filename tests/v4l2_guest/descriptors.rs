//! What the simulated camera tells the USB host of itself: USB 2.0 and UVC 1.1 descriptors.

/// Sizes it offers.
pub const SIZES: [(u16, u16); 3] = [(640, 480), (848, 480), (320, 240)];
/// Frame intervals it offers, 100 ns: 30, 15 and 6 frames/s.
pub const INTERVALS: [u32; 3] = [333_333, 666_666, 1_666_666];
/// Number of its extension unit.
pub const UNIT: u8 = 2;
/// Bytes in one message of the extension unit.
pub const UNIT_BYTES: usize = 1024;
/// Bytes before each frame.
pub const HEADER_BYTES: usize = 2;

const PACKET: u16 = 512;
const UNIT_GUID: [u8; 16] = [
    0xcb, 0x6c, 0x60, 0xc9, 0x4c, 0x59, 0x25, 0x4d, 0xaf, 0x47, 0xcc, 0xc4, 0x96, 0x43, 0x59, 0x95,
];
const GUID_TAIL: [u8; 12] = [0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71];

/// Bytes of a frame at a size.
pub fn frame_bytes((width, height): (u16, u16)) -> u32 {
    u32::from(width) * u32::from(height) * 2
}

pub fn device() -> Vec<u8> {
    let mut d = vec![18, 1];
    d.extend([0x00, 0x02]); // USB 2.0
    d.extend([0xef, 2, 1, 64]); // several functions; 64 bytes at endpoint 0
    d.extend([0x6b, 0x1d, 0x04, 0x01]); // vendor, product
    d.extend([0x00, 0x01, 1, 2, 3, 1]); // release, names, one configuration
    d
}

pub fn qualifier() -> Vec<u8> {
    vec![10, 6, 0x00, 0x02, 0xef, 2, 1, 64, 1, 0]
}

pub fn configuration(d16: bool) -> Vec<u8> {
    let mut c = vec![9, 2, 0, 0, 2, 1, 0, 0x80, 250];
    c.extend([8, 11, 0, 2, 0x0e, 3, 0, 0]); // one video function of two interfaces
    c.extend([9, 4, 0, 0, 0, 0x0e, 1, 0, 0]);
    c.extend(control());
    c.extend([9, 4, 1, 0, 1, 0x0e, 2, 0, 0]);
    c.extend(streaming(d16));
    c.extend([7, 5, 0x81, 2]); // bulk in
    c.extend(PACKET.to_le_bytes());
    c.push(0);
    with_total(c, 2)
}

/// Terminals and units: camera -> extension unit -> USB.
fn control() -> Vec<u8> {
    let mut c = vec![13, 0x24, 1, 0x10, 0x01, 0, 0];
    c.extend(48_000_000u32.to_le_bytes());
    c.extend([1, 1]); // one streaming interface, number 1
    c.extend([
        18, 0x24, 2, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0,
    ]);
    c.extend([26, 0x24, 6, UNIT]);
    c.extend(UNIT_GUID);
    c.extend([1, 1, 1, 1, 0x01, 0]); // one control, one source (1), one byte of controls
    c.extend([9, 0x24, 3, 3, 0x01, 0x01, 0, UNIT, 0]);
    with_total(c, 5)
}

/// One format with all sizes and rates.
fn streaming(d16: bool) -> Vec<u8> {
    let mut s = vec![14, 0x24, 1, 1, 0, 0, 0x81, 0, 3, 0, 0, 0, 1, 0];
    s.extend([27, 0x24, 4, 1, SIZES.len() as u8]);
    s.extend(if d16 { [0x50, 0, 0, 0] } else { *b"Z16 " });
    s.extend(GUID_TAIL);
    s.extend([16, 1, 0, 0, 0, 0]);
    for (i, size) in SIZES.into_iter().enumerate() {
        let bytes = frame_bytes(size);
        s.extend([26 + 4 * INTERVALS.len() as u8, 0x24, 5, i as u8 + 1, 0]);
        s.extend(size.0.to_le_bytes());
        s.extend(size.1.to_le_bytes());
        for word in [bytes * 8 * 6, bytes * 8 * 30, bytes, INTERVALS[0]] {
            s.extend(word.to_le_bytes());
        }
        s.push(INTERVALS.len() as u8);
        s.extend(INTERVALS.iter().flat_map(|i| i.to_le_bytes()));
    }
    with_total(s, 4)
}

/// Writes the length of `d` into its 16-bit total at `at`.
fn with_total(mut d: Vec<u8>, at: usize) -> Vec<u8> {
    let total = (d.len() as u16).to_le_bytes();
    d[at..at + 2].copy_from_slice(&total);
    d
}

pub fn string(index: u8) -> Vec<u8> {
    let text = match index {
        0 => return vec![4, 3, 9, 4],
        1 => "saint-live",
        2 => "Simulated depth camera",
        _ => "SIM0001",
    };
    let mut s = vec![0, 3];
    s.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
    s[0] = s.len() as u8;
    s
}

/// The 34 bytes of a probe or commit: format 1, a size by its number (from 1), an interval.
pub fn probe(size: u8, interval: u32) -> Vec<u8> {
    let bytes = frame_bytes(SIZES[usize::from(size) - 1]);
    let mut p = vec![1, 0, 1, size];
    p.extend(interval.to_le_bytes());
    p.extend([0; 10]);
    p.extend(bytes.to_le_bytes());
    p.extend((bytes + HEADER_BYTES as u32).to_le_bytes());
    p.extend(48_000_000u32.to_le_bytes());
    p.extend([0, 1, 1, 1]);
    p
}

/// Answers a calibration command of the extension unit (see `src/capture/v4l2/realsense.rs`).
pub fn calibration(command: &[u8]) -> Vec<u8> {
    let word = |at: usize| {
        command
            .get(at..at + 4)
            .map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    };
    let data = match (word(4), word(8)) {
        (0x2c, 9) => 1000u32.to_le_bytes().to_vec(), // depth unit, micrometres
        (0x15, 25) => coefficients(),
        _ => Vec::new(),
    };
    let mut reply = vec![0; UNIT_BYTES];
    reply[..4].copy_from_slice(&word(4).to_le_bytes());
    reply[4..4 + data.len()].copy_from_slice(&data);
    reply[UNIT_BYTES - 4..].copy_from_slice(&(data.len() as u32).to_le_bytes());
    reply
}

/// fx, fy, cx, cy at the place of each size in the table.
fn coefficients() -> Vec<u8> {
    let mut rows = [[0f32; 4]; 16];
    rows[2] = [615.5, 615.25, 320.5, 240.25]; // 640x480
    rows[3] = [425.5, 425.25, 424.5, 240.25]; // 848x480
    rows[6] = [307.75, 307.5, 160.25, 120.0]; // 320x240
    let mut table = vec![0; 256];
    table.extend(rows.iter().flatten().flat_map(|v| v.to_le_bytes()));
    table
}
