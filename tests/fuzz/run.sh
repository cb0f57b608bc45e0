#!/bin/bash
# Fuzzes the readers of bytes: run.sh TARGET SECONDS, where TARGET is sensor, cloud_payload,
# recording, cloud_file or sequence. Needs a C++ compiler for libFuzzer; without one, or with
# SAINT_FUZZ=plain, mutations of the corpus are tried in a plain loop. A finding stops it.
set -euo pipefail
cd "$(dirname "$0")"
target=${1:?"TARGET SECONDS"} seconds=${2:?"TARGET SECONDS"}
plain=(cargo run --quiet --no-default-features --target-dir target/plain --bin)
"${plain[@]}" seeds
if [ "${SAINT_FUZZ:-}" = plain ] || ! command -v c++ > /dev/null; then
    exec "${plain[@]}" mutate "$target" "$seconds" "$RANDOM"
fi
# what cargo-fuzz passes, less the sanitizers: these need a nightly compiler
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1"
# a target of its own name keeps the flags from build scripts
host=$(rustc -vV | sed -n 's/^host: //p')
mkdir -p artifacts
exec cargo run --quiet --target "$host" --bin "$target" -- "corpus/$target" \
    -max_total_time="$seconds" -artifact_prefix="artifacts/$target-" -rss_limit_mb=2048 \
    -timeout=20 -print_final_stats=1
