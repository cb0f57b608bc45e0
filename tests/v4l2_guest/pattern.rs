//! The depth the simulated camera sends: a function of frame number and pixel, so that a recording
//! can be checked pixel by pixel.

/// Depth of a pixel, millimetres. Pixel (0, 0) is the frame's number instead.
pub fn depth(frame: u32, x: u32, y: u32) -> u16 {
    if (x, y) == (0, 0) {
        return (frame & 0xffff) as u16;
    }
    let slope = 3 * x + 5 * y + 11 * frame;
    let ripple = (x * y) >> 6;
    (400 + (slope + ripple) % 5000) as u16
}
