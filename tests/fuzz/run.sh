#!/bin/bash
# Fuzzes a reader of bytes: run.sh TARGET SECONDS. Without arguments it names the targets. Needs a
# nightly toolchain, cargo-fuzz (`cargo install cargo-fuzz`) and a C++ compiler. The corpus grows in
# grown/TARGET; a finding stops it and lies in artifacts/TARGET. Keep it in ../fuzz_findings/TARGET
# under a name that says what was wrong: `cargo test --test fuzz_findings` then tries it for ever.
set -euo pipefail
cd "$(dirname "$0")"
if [ $# -ne 2 ]; then
    echo "run.sh TARGET SECONDS, where TARGET is one of:" >&2
    ls fuzz_targets | sed -n 's/\.rs$//p' >&2
    exit 2
fi
fuzz() { cargo +nightly fuzz "$1" --fuzz-dir . --sanitizer "${SANITIZER:-none}" "${@:2}"; }
(cd ../.. && cargo test --quiet --test fuzz_findings -- --ignored seeds > /dev/null)
mkdir -p "grown/$1" "../fuzz_findings/$1"
fuzz run "$1" "grown/$1" "corpus/$1" "../fuzz_findings/$1" -- -max_total_time="$2" \
    -rss_limit_mb=1024 -timeout=20 -max_len=65536 -print_final_stats=1
