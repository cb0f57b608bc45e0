//! `play`: a recording in the terminal, each sphere in its colour.

use super::args::PlayArgs;
use super::failure::{Failure, Kind};
use super::keyboard::Keyboard;
use super::tape::Tape;
use super::{report, signals};
use saint_live::export::png::{Picture, draw};
use saint_live::play::{Command, PlayOptions, SystemClock, play};
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::Ordering;

/// Rows kept free under the picture: the line about the frame.
const FREE_ROWS: u32 = 1;

/// Plays to a terminal; without one (or with `--stats`) it only keeps the pace and counts.
pub fn run(args: &PlayArgs) -> Result<(), Failure> {
    let stop = signals::stop_flag()?;
    let mut tape = Tape::open(&args.file)?;
    tape.decode_at(args.level);
    if tape.frames() == 0 {
        return Err(Failure::new(
            Kind::Input,
            format_args!("{}: holds no frame", args.file.display()),
        ));
    }
    let visible = io::stdout().is_terminal() && !args.stats;
    let mut options = PlayOptions {
        speed: args.speed,
        looped: args.repeat,
        reverse: args.reverse,
        from: args.range.from,
        to: args.range.to.unwrap_or(u64::MAX),
        hold_at: None,
    };
    if let Some(frame) = args.frame {
        // a frame that is not there is told before the screen is taken
        tape.seek(frame)?;
        if visible {
            options.hold_at = Some(frame);
        } else {
            (options.from, options.to) = (frame, frame.saturating_add(1));
        }
    }
    let mut screen = visible.then(Screen::open).transpose()?;
    let mut keys = visible
        .then(|| Keyboard::open(tape.frames_per_second()))
        .flatten();
    let played = play(
        &mut tape,
        &options,
        &mut SystemClock::default(),
        || {
            if stop.load(Ordering::Relaxed) {
                return Some(Command::Stop);
            }
            keys.as_mut().and_then(Keyboard::command)
        },
        |tape, number| match &mut screen {
            Some(screen) => screen.show(tape, number),
            None => Ok(()),
        },
    );
    drop(keys);
    drop(screen);
    let played = played?;
    if args.stats || !visible {
        let mut text =
            serde_json::to_string(&played).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        super::write_data(text.as_bytes())?;
    }
    tape.finish()
}

/// The terminal, with the cursor hidden. Dropped, it is as it was.
#[derive(Default)]
struct Screen {
    picture: Picture,
    text: String,
}

impl Screen {
    fn open() -> Result<Self, Failure> {
        // another screen, no cursor
        super::write_data(b"\x1b[?1049h\x1b[?25l")?;
        Ok(Self::default())
    }

    /// Draws the frame as half blocks: two pixels in each cell.
    fn show(&mut self, tape: &Tape, number: u64) -> Result<(), Failure> {
        let frame = tape.frame();
        let size = picture_size(terminal_size(), (frame.camera.width, frame.camera.height));
        draw(&frame, size, &mut self.picture);
        half_blocks(&self.picture, &mut self.text);
        let points = frame.depth_m.iter().filter(|z| **z > 0.0).count();
        let spheres = frame.spheres.iter().flatten().count();
        // writing to a String cannot fail
        let _ = write!(
            self.text,
            "\x1b[0mframe {number}/{}  {} pts  {spheres} spheres\x1b[K",
            tape.frames(),
            report::short(points as f64),
        );
        super::write_data(self.text.as_bytes())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let mut out = io::stdout().lock();
        let _ = out.write_all(b"\x1b[0m\x1b[?25h\x1b[?1049l");
        let _ = out.flush();
    }
}

/// Columns and rows of the terminal.
fn terminal_size() -> (u32, u32) {
    match rustix::termios::tcgetwinsize(io::stdout()) {
        Ok(size) if size.ws_col > 0 && size.ws_row > 0 => (size.ws_col.into(), size.ws_row.into()),
        _ => (80, 24),
    }
}

/// The largest picture of the image's shape; a cell is one pixel wide and two high.
fn picture_size((columns, rows): (u32, u32), (width, height): (u32, u32)) -> (u32, u32) {
    let most = (columns.max(1), 2 * rows.saturating_sub(FREE_ROWS).max(1));
    let by_width = u64::from(most.0) * u64::from(height) / u64::from(width.max(1));
    if by_width <= u64::from(most.1) {
        (most.0, (by_width as u32).max(1))
    } else {
        let across = u64::from(most.1) * u64::from(width) / u64::from(height.max(1));
        ((across as u32).max(1), most.1)
    }
}

/// The picture from the upper left corner on; colours are sent only where they change.
fn half_blocks(picture: &Picture, text: &mut String) {
    text.clear();
    text.push_str("\x1b[H\x1b[0m");
    let row_bytes = picture.width as usize * 3;
    let black = vec![0; row_bytes];
    let mut rows = picture.rgb.chunks_exact(row_bytes.max(1));
    while let Some(upper) = rows.next() {
        let lower = rows.next().unwrap_or(&black);
        let (mut ink, mut paper) = (None, None);
        for (up, low) in upper.chunks_exact(3).zip(lower.chunks_exact(3)) {
            if ink != Some(up) {
                let _ = write!(text, "\x1b[38;2;{};{};{}m", up[0], up[1], up[2]);
                ink = Some(up);
            }
            if paper != Some(low) {
                let _ = write!(text, "\x1b[48;2;{};{};{}m", low[0], low[1], low[2]);
                paper = Some(low);
            }
            text.push('▀');
        }
        text.push_str("\x1b[0m\x1b[K\r\n");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_fit_and_keep_their_shape() {
        assert_eq!(picture_size((80, 61), (640, 480)), (80, 60));
        assert_eq!(picture_size((200, 31), (640, 480)), (80, 60));
        assert_eq!(picture_size((1, 1), (640, 480)), (1, 1));
        assert_eq!(picture_size((0, 0), (1, 10_000)), (1, 2));
    }

    #[test]
    fn a_cell_shows_two_pixels() {
        let picture = Picture {
            width: 2,
            height: 3,
            rgb: vec![1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 4],
        };
        let mut text = String::new();
        half_blocks(&picture, &mut text);
        assert_eq!(text.matches('▀').count(), 4);
        assert_eq!(text.matches("\r\n").count(), 2);
        // the upper ink is sent once for two cells, the lower paper twice
        assert_eq!(text.matches("\x1b[38;2;1;1;1m").count(), 1);
        assert_eq!(text.matches("\x1b[48;2;").count(), 3);
    }
}
