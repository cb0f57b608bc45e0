//! What the fuzzers call: bytes from outside go in; anything but an error or a sound result is a
//! finding.
//!
//! `tests/fuzz_findings.rs` of the library includes these modules, too.

mod files;
mod mend;
mod payloads;
mod recordings;

pub use files::{CLOUDS, CONTAINERS, IMAGES, camera_file, cloud_file, container, image};
pub use payloads::{cloud_payload, header, sensor_payload};
pub use recordings::{raw_capture, recording};

/// What is done with any bytes.
pub type Fuzzed = fn(&[u8]);

/// All targets by name.
pub const TARGETS: [(&str, Fuzzed); 9] = [
    ("sensor_payload", sensor_payload),
    ("cloud_payload", cloud_payload),
    ("header", header),
    ("recording", recording),
    ("raw_capture", raw_capture),
    ("image", image),
    ("container", container),
    ("cloud_file", cloud_file),
    ("camera_file", camera_file),
];
