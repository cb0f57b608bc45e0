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

use serde_json::Value;
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

    /// The last line of statistics: the whole run.
    fn total(&self) -> Value {
        let path = self.folder.join(format!("{}.out", self.name));
        let text = fs::read_to_string(&path).unwrap();
        let last = text
            .lines()
            .last()
            .unwrap_or_else(|| panic!("{}: empty", path.display()));
        let total: Value = serde_json::from_str(last).unwrap();
        assert_eq!(total["final"], true, "{}: {last}", self.name);
        total
    }

    /// Numbers of the frames the camera sent to their end.
    fn sent(&self, suffix: &str) -> Vec<u32> {
        let path = self.folder.join(format!("{}.{suffix}", self.name));
        let text = fs::read_to_string(&path).unwrap();
        text.lines().map(|line| line.parse().unwrap()).collect()
    }

    /// The camera's numbers of the frames recorded, each checked pixel by pixel.
    fn frames(&self, size: (u32, u32)) -> Vec<u32> {
        let folder = self.folder.join(format!("{}.frames", self.name));
        let mut files: Vec<PathBuf> = fs::read_dir(&folder)
            .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "png"))
            .collect();
        files.sort();
        files
            .iter()
            .map(|file| checked_number(file, size))
            .collect()
    }

    /// Every frame the camera made (`made`) is written, or counted under its cause: `lost` by
    /// cause, all others pushed out of the queue by a newer one, or lost by the bus (an emulator
    /// that is short of time loses some), which the driver's numbers tell.
    fn expect_counts(&self, made: u64, written: usize, lost: &[(&str, u64)]) {
        let total = self.total();
        let name = self.name;
        let drops = total["drops"].as_object().unwrap();
        for (cause, count) in drops {
            let want = lost.iter().find(|(c, _)| c == cause).map_or(0, |(_, n)| *n);
            let count = count.as_u64().unwrap();
            assert!(
                cause == "queue" || count == want || cause == "sensor_gap" && count > want,
                "{name}: {want} lost by {cause} expected: {drops:?}"
            );
        }
        let lost: u64 = lost.iter().map(|(_, n)| *n).sum();
        let gaps = drops["sensor_gap"].as_u64().unwrap();
        let by_bus = drops["damaged"].as_u64().unwrap() + gaps - lost;
        let queue = drops["queue"].as_u64().unwrap() + by_bus;
        assert_eq!(total["frames"], written as u64, "{name}");
        assert_eq!(total["sensor_frames"], made, "{name}: {drops:?}");
        assert_eq!(queue, made - lost - written as u64, "{name}: {drops:?}");
        eprintln!(
            "{name}: {made} made, {written} written, {} queue, {lost} lost, {by_bus} by the bus",
            queue - by_bus
        );
    }
}

/// A frame's number, after comparing all its pixels with what the camera sent.
fn checked_number(file: &Path, size: (u32, u32)) -> u32 {
    let image = image::open(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let image = image.into_luma16();
    assert_eq!(image.dimensions(), size, "{}", file.display());
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
    assert!(!numbers.is_empty(), "{name}: no frame");
    assert!(
        numbers.windows(2).all(|pair| pair[0] < pair[1]),
        "{name}: frames out of order or twice: {numbers:?}"
    );
}

const VGA: (u32, u32) = (640, 480);
const SMALL: (u32, u32) = (320, 240);

/// The folder of results; `None` (and a word about it) where the script was not run.
fn results() -> Option<PathBuf> {
    let folder = std::env::var_os("SAINT_V4L2_GUEST").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: tests/v4l2_guest/run.sh makes the recordings this test checks");
    }
    folder
}

#[test]
fn cameras_are_listed_named_and_refused() {
    let Some(folder) = results() else { return };
    let scenario = |name| Scenario::read(&folder, name);
    scenario("missing").expect(3, "/dev/video0: could not open it: there is no such device");
    scenario("metadata").expect(3, "metadata");
    scenario("d16").expect(3, "D16");
    for name in ["named", "auto", "bus"] {
        scenario(name).expect(0, "1 of 1 frames");
    }
    scenario("nobody").expect(3, "serial SIM0001");
    scenario("forbidden").expect(3, "permission denied; join its group `video`");
    scenario("busy").expect(3, "saint-live (pid ");

    let list = |name: &str| -> Value {
        let text = fs::read_to_string(folder.join(format!("{name}.out"))).unwrap();
        serde_json::from_str(&text).unwrap()
    };
    let idle = list("devices");
    let camera = &idle["devices"][0];
    assert_eq!(camera["kind"], "depth", "{idle}");
    assert_eq!(camera["driver"], "uvcvideo", "{idle}");
    assert_eq!(camera["serial"], "SIM0001", "{idle}");
    assert_eq!(camera["busy"], false, "{idle}");
    let sizes = camera["formats"][0]["sizes"].as_array().unwrap();
    assert_eq!(sizes.len(), 3, "{idle}");
    assert_eq!(sizes[0]["fps"].as_array().unwrap().len(), 3, "{idle}");
    assert_eq!(idle["devices"][1]["kind"], "metadata", "{idle}");
    let closed = list("forbidden");
    let camera = &closed["devices"][0];
    assert_eq!(camera["kind"], "unreadable", "{closed}");
    assert_eq!(camera["serial"], "SIM0001", "{closed}");
    let reason = camera["reason"].as_str().unwrap_or_default();
    assert!(reason.contains("group `video`"), "{closed}");
    let streaming = list("listed");
    let camera = &streaming["devices"][0];
    assert_eq!(camera["busy"], true, "{streaming}");
    let holder = camera["held_by"][0].as_str().unwrap_or_default();
    assert!(holder.starts_with("saint-live (pid "), "{streaming}");
    assert_eq!(
        list("d16_list")["without_node"].as_array().unwrap().len(),
        1
    );
}

#[test]
fn each_frame_the_camera_made_is_recorded_or_counted_by_its_cause() {
    let Some(folder) = results() else { return };
    let scenario = |name| Scenario::read(&folder, name);

    // Ended by their number of frames, the last one written: all before it are accounted for.
    for (name, size, lost) in [
        ("stream", VGA, &[][..]),
        ("slow", VGA, &[]),
        ("threads", SMALL, &[]),
        ("interrupted", SMALL, &[]),
        ("stall", SMALL, &[]),
        ("pause", SMALL, &[]),
        ("faults", SMALL, &[("sensor_gap", 2)]),
        ("flagged", SMALL, &[("damaged", 2)]),
    ] {
        let whole = scenario(name);
        whole.expect(0, "");
        let numbers = whole.frames(size);
        assert_increasing(name, &numbers);
        let last = u64::from(numbers[numbers.len() - 1]);
        whole.expect_counts(last + 1, numbers.len(), lost);
        let bad = numbers
            .iter()
            .any(|n| !lost.is_empty() && [5, 9].contains(n));
        assert!(!bad, "{name}: damaged frames were recorded: {numbers:?}");
    }
    let told = |name: &'static str, text: &str| {
        let errors = scenario(name).errors;
        assert!(errors.contains(text), "{name}: no {text:?} in\n{errors}");
    };
    told("stall", "no frame comes");
    told("pause", "starting the stream again");
    told("stream", "(told by the camera)");

    // Ended by the camera: it sent so many frames, and not one more.
    for (name, status, message) in [
        ("unplugged", 3, "was unplugged after 15 frames"),
        ("hang", 3, "no frame for 12."),
    ] {
        let ended = scenario(name);
        ended.expect(status, message);
        let numbers = ended.frames(SMALL);
        assert_increasing(name, &numbers);
        let sent = ended.sent("sent").len() as u64;
        assert_eq!(sent, if name == "hang" { 10 } else { 15 }, "{name}");
        ended.expect_counts(sent, numbers.len(), &[]);
    }
    // Killed in the middle: the frame under way then may be whole on one side only.
    let killed = scenario("killed");
    killed.expect(3, "given up");
    let numbers = killed.frames(SMALL);
    assert_increasing("killed", &numbers);
    let sent = killed.sent("sent").len() as u64;
    let made = killed.total()["sensor_frames"].as_u64().unwrap();
    assert!(
        sent.abs_diff(made) <= 1,
        "{made} frames came, {sent} were sent"
    );
    killed.expect_counts(made, numbers.len(), &[]);
}

#[test]
fn a_camera_that_comes_back_under_another_number_goes_on() {
    let Some(folder) = results() else { return };
    let nodes = fs::read_to_string(folder.join("replugged.nodes")).unwrap();
    assert!(
        !nodes.split_whitespace().any(|n| n == "/dev/video0"),
        "{nodes}"
    );
    let replugged = Scenario::read(&folder, "replugged");
    replugged.expect(0, "streams again");
    // Its frames begin again, once.
    let numbers = replugged.frames(SMALL);
    let again = (1..numbers.len()).find(|i| numbers[*i] <= numbers[*i - 1]);
    let (first, second) = numbers.split_at(again.unwrap());
    assert_increasing("replugged, before", first);
    assert_increasing("replugged, after", second);
    assert_eq!(replugged.sent("sent").len(), 12);
    let made = 12 + u64::from(second[second.len() - 1]) + 1;
    replugged.expect_counts(made, numbers.len(), &[]);
}

#[test]
fn errors_of_the_driver_are_refused_with_a_remedy_or_survived() {
    let Some(folder) = results() else { return };
    let scenario = |name| Scenario::read(&folder, name);
    // before the first frame there is nothing to wait for
    for name in ["reqbufs", "qbuf", "streamon"] {
        scenario(name).expect(3, "could not start the stream");
        scenario(name).expect(3, "EINVAL");
    }
    for (name, message) in [
        ("damaged", ""),
        ("fatal", "starting the stream again"),
        ("refused", "EINVAL"),
        ("disconnected", "was unplugged"),
        ("dropped", ""),
    ] {
        let survived = scenario(name);
        survived.expect(0, message);
        let total = survived.total();
        let count = |value: &Value| value.as_u64().unwrap();
        let drops = total["drops"].as_object().unwrap();
        let all: u64 = drops.values().map(count).sum();
        let delivered = count(&total["frames"]) + count(&drops["queue"]);
        assert_eq!(delivered, 60, "{name}: {total}");
        assert_eq!(
            count(&total["sensor_frames"]),
            count(&total["frames"]) + all
        );
        assert_eq!(
            count(&drops["damaged"]),
            u64::from(name == "damaged"),
            "{name}: {total}"
        );
        if name == "dropped" {
            assert!(count(&drops["sensor_gap"]) > 10, "{name}: {total}");
        }
        eprintln!("{name}: {} written, {drops:?}", total["frames"]);
    }
}

#[test]
fn of_two_cameras_one_goes_on_without_the_other() {
    let Some(folder) = results() else { return };
    let rig = Scenario::read(&folder, "rig");
    rig.expect(0, "was unplugged after");
    let text = fs::read_to_string(folder.join("rig.out")).unwrap();
    let finals: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .filter(|line: &Value| line["final"] == true)
        .collect();
    let of = |name: &str| finals.iter().find(|line| line["camera"] == name).unwrap();
    assert_eq!(of("usb")["sensor_frames"], 15, "{text}");
    assert!(of("test")["sensor_frames"].as_u64() > Some(60), "{text}");
    // the frames exported are the first camera's
    let numbers = rig.frames(SMALL);
    assert_increasing("rig", &numbers);
    assert_eq!(of("usb")["frames"], numbers.len() as u64);
}

#[test]
fn a_colour_camera_that_breaks_does_not_stop_depth() {
    let Some(folder) = results() else { return };
    let color = Scenario::read(&folder, "color");
    color.expect(0, "depth goes on without it");
    let numbers = color.frames(SMALL);
    assert_increasing("color", &numbers);
    let last = u64::from(numbers[numbers.len() - 1]);
    color.expect_counts(last + 1, numbers.len(), &[]);
    let total = color.total();
    assert!(total["color_frames"].as_u64() > Some(0), "{total}");
    eprintln!(
        "color: {} images, {} dropped",
        total["color_frames"], total["color_dropped"]
    );
}
