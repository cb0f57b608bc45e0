#!/bin/bash
# Kills a live recording with SIGKILL at random moments: each file must open, must have lost no more
# than the last second, must say that it was cut, and must be made whole by `repair`.
#   tests/kill_at_random.sh [-n TIMES] [PROGRAM]
# Slow (a few seconds each): tests/recordings.rs does the same for a few moments.
set -euo pipefail
times=100
while getopts n: option; do
    case $option in
    n) times=$OPTARG ;;
    *) exit 2 ;;
    esac
done
shift $((OPTIND - 1))
program=${1:-target/release/saint-live}
command -v jq > /dev/null || { echo "jq is missing: apt-get install jq" >&2; exit 1; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
worst=0 none=0 fewest=-1 most=0
for n in $(seq "$times"); do
    file=$folder/$n.mcap whole=$folder/$n-whole.mcap
    "$program" --device synthetic:room,size=80x60,fps=60 -q -o "$file" &
    recorder=$!
    sleep "$(awk -v seed="$RANDOM$n" 'BEGIN { srand(seed); printf "%.3f", 0.02 + 3.5 * rand() }')"
    kill -KILL "$recorder"
    killed_ns=$(date +%s%N)
    wait "$recorder" 2> /dev/null || true
    if [ ! -e "$file" ]; then
        none=$((none + 1)) # killed before it had made a file
        continue
    fi
    facts=$("$program" info "$file" --json 2> /dev/null) || { echo "$n: does not open" >&2; exit 1; }
    [ "$(jq .cut <<< "$facts")" = true ] || { echo "$n: does not say it was cut" >&2; exit 1; }
    frames=$(jq .frames <<< "$facts")
    if [ "$frames" -gt 0 ]; then
        last_ns=$(jq .last.wall_ns <<< "$facts")
        lost_ms=$(((killed_ns - last_ns) / 1000000))
        [ "$lost_ms" -gt "$worst" ] && worst=$lost_ms
    fi
    [ "$frames" -gt "$most" ] && most=$frames
    { [ "$fewest" -lt 0 ] || [ "$frames" -lt "$fewest" ]; } && fewest=$frames
    "$program" repair "$file" -o "$whole" -q 2> /dev/null ||
        [ "$frames" = 0 ] || { echo "$n: cannot be repaired" >&2; exit 1; }
    "$program" check "$whole" -q > /dev/null || { echo "$n: is not whole after repair" >&2; exit 1; }
    [ "$("$program" info "$whole" --json | jq .frames)" = "$frames" ] ||
        { echo "$n: repair lost frames" >&2; exit 1; }
    rm -f "$file" "$whole"
done
echo "$times kills: $none before there was a file, the others open and are whole after repair;" \
    "$fewest to $most frames, at most $worst ms lost"
[ "$worst" -le 1000 ] || { echo "more than a second was lost" >&2; exit 1; }
