//! What the fuzzers of `tests/fuzz` found once, and their first corpus: an error or a sound result,
//! never a panic.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

#[path = "fuzz/src/lib.rs"]
mod fuzz;
#[path = "fuzz/src/seeds.rs"]
mod seeds;

use std::path::Path;

/// Files of `tests/fuzz_findings/TARGET`, by name, and what eats them.
#[test]
fn findings_stay_solved() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz_findings");
    let mut tried = 0;
    for (name, target) in fuzz::TARGETS {
        let Ok(entries) = std::fs::read_dir(folder.join(name)) else {
            continue;
        };
        let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        for path in paths {
            let bytes = std::fs::read(&path).unwrap();
            let outcome = std::panic::catch_unwind(|| target(&bytes));
            assert!(outcome.is_ok(), "{}", path.display());
            tried += 1;
        }
    }
    assert!(tried > 0, "no findings in {}", folder.display());
}

/// Writes the seeds of all fuzz targets.
#[test]
#[ignore = "writes files: run by tests/fuzz/run.sh"]
fn seeds() {
    seeds::write().unwrap();
}
