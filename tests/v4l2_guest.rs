//! Checks what `tests/v4l2_guest/run.sh` recorded from a real kernel V4L2 node. Run by that
//! script; without its results (`SAINT_V4L2_GUEST`) there is nothing to check.
#![allow(
    clippy::print_stderr,
    clippy::panic,
    clippy::unwrap_used,
    reason = "a test: it says that it was skipped, and fails by panicking"
)]

#[path = "v4l2_guest/pattern.rs"]
mod pattern;

use std::fs;
use std::path::{Path, PathBuf};

/// What one scenario of the guest left.
struct Scenario {
    name: &'static str,
    status: i32,
    errors: String,
    folder: PathBuf,
}

impl Scenario {
    fn read(folder: &Path, name: &'static str) -> Self {
        let text = |suffix: &str| {
            let path = folder.join(format!("{name}.{suffix}"));
            fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
        };
        Self {
            name,
            status: text("status").trim().parse().unwrap(),
            errors: text("err"),
            folder: folder.into(),
        }
    }

    fn expect(&self, status: i32, message: &str) {
        let told = self.errors.contains(message);
        assert!(
            self.status == status && told,
            "{}: exit {} instead of {status}, or stderr without {message:?}:\n{}",
            self.name,
            self.status,
            self.errors
        );
    }

    /// The camera's numbers of the frames recorded, each checked pixel by pixel.
    fn frames(&self) -> Vec<u32> {
        let folder = self.folder.join(format!("{}.frames", self.name));
        let mut files: Vec<PathBuf> = fs::read_dir(&folder)
            .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "png"))
            .collect();
        files.sort();
        files.iter().map(|file| checked_number(file)).collect()
    }
}

/// A frame's number, after comparing all its pixels with what the camera sent.
fn checked_number(file: &Path) -> u32 {
    let image = image::open(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let image = image.into_luma16();
    assert_eq!(image.dimensions(), (640, 480), "{}", file.display());
    let number = u32::from(image.get_pixel(0, 0).0[0]);
    let wrong = image
        .enumerate_pixels()
        .filter(|(x, y, pixel)| pixel.0[0] != pattern::depth(number, *x, *y))
        .count();
    assert_eq!(
        wrong,
        0,
        "{}: wrong pixels in frame {number}",
        file.display()
    );
    number
}

fn assert_increasing(name: &str, numbers: &[u32]) {
    assert!(
        numbers.windows(2).all(|pair| pair[0] < pair[1]),
        "{name}: frames out of order or twice: {numbers:?}"
    );
}

#[test]
fn recordings_are_what_the_camera_sent() {
    let Some(folder) = std::env::var_os("SAINT_V4L2_GUEST").map(PathBuf::from) else {
        eprintln!("skipped: tests/v4l2_guest/run.sh makes the recordings this test checks");
        return;
    };
    let scenario = |name| Scenario::read(&folder, name);

    scenario("missing").expect(3, "/dev/video0");
    scenario("metadata").expect(3, "metadata");
    scenario("d16").expect(3, "D16");

    let list = fs::read_to_string(folder.join("devices.out")).unwrap();
    let list: serde_json::Value = serde_json::from_str(&list).unwrap();
    assert_eq!(list["devices"][0]["kind"], "depth", "{list}");
    assert_eq!(list["devices"][1]["kind"], "metadata", "{list}");

    // Whole recordings: as many frames as asked, none twice. Under emulation the driver may skip
    // some in between, so numbers need not follow each other.
    for (name, count) in [("stream", 60), ("stall", 25), ("faults", 20)] {
        let whole = scenario(name);
        whole.expect(0, "");
        let numbers = whole.frames();
        assert_eq!(numbers.len(), count, "{name}: {numbers:?}");
        assert_increasing(name, &numbers);
        if name == "faults" {
            let bad = numbers.iter().any(|n| [5, 9].contains(n));
            assert!(!bad, "damaged frames were recorded: {numbers:?}");
        }
    }

    // Ended early: what was recorded is whole.
    let interrupted = scenario("interrupted");
    interrupted.expect(0, "");
    assert_increasing("interrupted", &interrupted.frames());
    assert!(!interrupted.frames().is_empty());
    let unplugged = scenario("unplugged");
    unplugged.expect(3, "unplugged");
    let numbers = unplugged.frames();
    assert_increasing("unplugged", &numbers);
    assert!((1..=15).contains(&numbers.len()), "{numbers:?}");

    // The camera came back as a new one, under another number: its frames begin again, once.
    let nodes = fs::read_to_string(folder.join("replugged.nodes")).unwrap();
    assert!(
        !nodes.split_whitespace().any(|n| n == "/dev/video0"),
        "{nodes}"
    );
    let replugged = scenario("replugged");
    replugged.expect(0, "");
    let numbers = replugged.frames();
    assert_eq!(numbers.len(), 30, "{numbers:?}");
    let restarts: Vec<usize> = (1..numbers.len())
        .filter(|i| numbers[*i] <= numbers[*i - 1])
        .collect();
    assert_eq!(restarts.len(), 1, "{numbers:?}");
    assert!(
        numbers[..restarts[0]].iter().all(|n| *n < 12),
        "{numbers:?}"
    );
}
