//! Recordings over hours: how fast a frame is found, and what a long run with faults costs.
//!
//! ```text
//! cargo bench --bench recording -- seek [-t 1h]      a synthetic hour at 30 fps; random frames in it
//! cargo bench --bench recording -- soak -t 10min     looped input, faults everywhere, real time
//! ```
//! Without a word (as `cargo bench` runs it) `seek` measures one minute.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a bench prints, and fails by panicking"
)]

mod seek;
mod soak;
mod stages;

use std::time::Duration;

fn main() {
    let words: Vec<_> = std::env::args()
        .skip(1)
        .filter(|w| w != "--bench")
        .collect();
    let time = words.iter().position(|word| word == "-t").map(|at| {
        let text = words.get(at + 1).map_or("", String::as_str);
        time(text).unwrap_or_else(|| panic!("-t takes a time: 30s, 10min, 1h; not `{text}`"))
    });
    match words.first().map(String::as_str) {
        Some("soak") => soak::run(time.unwrap_or(Duration::from_secs(60))),
        Some("seek") => seek::run(time.unwrap_or(Duration::from_secs(3600))),
        _ => seek::run(Duration::from_secs(60)),
    }
}

fn time(text: &str) -> Option<Duration> {
    let number = text.trim_end_matches(char::is_alphabetic);
    let factor = match &text[number.len()..] {
        "s" => 1,
        "min" => 60,
        "h" => 3600,
        _ => return None,
    };
    Some(Duration::from_secs(number.parse::<u64>().ok()? * factor))
}
