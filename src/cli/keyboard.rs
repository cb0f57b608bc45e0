//! The keys of a player: read without waiting, the terminal left as it was.

use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, Termios};
use rustix::termios::{tcgetattr, tcsetattr};
use saint_live::play::Command;
use std::io::{self, IsTerminal};

/// Standard input without echo and line by line reading. Dropped, it is as it was. Ctrl-C stays a
/// signal.
pub struct Keyboard {
    before: Termios,
    /// Frames in a second.
    second: i64,
    /// Bytes read and not yet understood.
    pending: Vec<u8>,
}

impl Keyboard {
    /// `None` where standard input is no terminal: then there are no keys.
    pub fn open(frames_per_second: f64) -> Option<Self> {
        let stdin = io::stdin();
        if !stdin.is_terminal() {
            return None;
        }
        let before = tcgetattr(&stdin).ok()?;
        let mut direct = before.clone();
        direct.local_modes -= LocalModes::ICANON | LocalModes::ECHO;
        // a read gives what is there, also nothing
        direct.special_codes[SpecialCodeIndex::VMIN] = 0;
        direct.special_codes[SpecialCodeIndex::VTIME] = 0;
        tcsetattr(&stdin, OptionalActions::Now, &direct).ok()?;
        Some(Self {
            before,
            second: frames_per_second.round() as i64,
            pending: Vec::new(),
        })
    }

    /// The command of the next key, where one was pressed.
    pub fn command(&mut self) -> Option<Command> {
        let mut bytes = [0; 32];
        let read = rustix::io::read(io::stdin(), &mut bytes).unwrap_or(0);
        self.pending.extend_from_slice(&bytes[..read]);
        while !self.pending.is_empty() {
            let (length, command) = key(&self.pending, self.second);
            self.pending.drain(..length);
            if command.is_some() {
                return command;
            }
        }
        None
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}

/// The first key of `bytes`, which are not empty: its length and what it means.
fn key(bytes: &[u8], second: i64) -> (usize, Option<Command>) {
    if let [0x1b, b'[' | b'O', code, ..] = bytes {
        let command = match code {
            b'A' => Some(Command::Step(second)),
            b'B' => Some(Command::Step(-second)),
            b'C' => Some(Command::Step(1)),
            b'D' => Some(Command::Step(-1)),
            b'H' => Some(Command::To(0)),
            b'F' => Some(Command::To(u64::MAX)),
            _ => None,
        };
        return (3, command);
    }
    let command = match bytes[0] {
        b' ' => Some(Command::Pause),
        b'.' => Some(Command::Step(1)),
        b',' => Some(Command::Step(-1)),
        b'q' => Some(Command::Stop),
        _ => None,
    };
    (1, command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_mean_what_the_help_says() {
        for (bytes, length, command) in [
            (&b" "[..], 1, Some(Command::Pause)),
            (b"q", 1, Some(Command::Stop)),
            (b",x", 1, Some(Command::Step(-1))),
            (b"\x1b[C", 3, Some(Command::Step(1))),
            (b"\x1b[D ", 3, Some(Command::Step(-1))),
            (b"\x1bOA", 3, Some(Command::Step(30))),
            (b"\x1b[H", 3, Some(Command::To(0))),
            (b"\x1b", 1, None),
            (b"x", 1, None),
        ] {
            assert_eq!(key(bytes, 30), (length, command), "{bytes:?}");
        }
    }
}
