#!/usr/bin/env python3
"""JPEG XL and JPEG-LS on the frames of `cargo bench --bench peers`, beside this program's own numbers.

Needs `pip install imagecodecs numpy` and the program: `target/release/saint-live` (`cargo build --release`), or the one SAINT_LIVE names.

    benches/peers.py [FOLDER ...]        without folders: the bundled recordings

Each folder goes through the program first (`replay --lossless`, `export --to png16`), so that the
peers code the measurements the program codes, 0 elsewhere. One thread each. A ratio is the peer's
number over that of our lossless stream in the steady state (`bench --lossless --threads 1`); times
are medians over frames, each run once, ours like theirs.
"""

import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import imagecodecs
import numpy

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = pathlib.Path(os.environ.get("SAINT_LIVE", ROOT / "target/release/saint-live"))
FRAMES = 40

PEERS = {
    f"JPEG XL effort {effort}": (
        lambda frame, effort=effort: imagecodecs.jpegxl_encode(frame, lossless=True, effort=effort, numthreads=1),
        lambda data: imagecodecs.jpegxl_decode(data, numthreads=1),
    )
    for effort in (1, 2, 7)
} | {"JPEG-LS": (imagecodecs.jpegls_encode, imagecodecs.jpegls_decode)}


def program(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


def frames_of(folder):
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        program("replay", folder, "--lossless", "--to", FRAMES, "-o", scratch / "x.mcap", "-q")
        program("export", scratch / "x.mcap", "--to", "png16", "-o", scratch / "png", "-q")
        files = sorted((scratch / "png").rglob("*.png"))
        return [imagecodecs.png_decode(file.read_bytes()) for file in files]


def timed(work, argument):
    start = time.perf_counter()
    result = work(argument)
    return result, (time.perf_counter() - start) * 1e3


def compare(folder):
    frames = frames_of(folder)
    points = sum(int(numpy.count_nonzero(frame)) for frame in frames)
    height, width = frames[0].shape
    print(f"\n{folder} ({width}x{height}), {len(frames)} frames, one thread")
    print(f"{'':<32} {'encode ms':>9} {'decode ms':>9} {'bits/valid px':>13}   ratios: size  encode  decode")
    ours = None
    for name, flags in (("live, lossless", ["--lossless"]), ("live, default tolerance (lossy)", [])):
        told = json.loads(program("bench", folder, "--frames", FRAMES, "--threads", 1, "--json", "-q", *flags))
        row = (told["warm_ms"]["p50"], told["decode_ms"]["p50"], told["bits_per_valid_px"])
        ours = ours or row
        error = told["residual_mm"]
        print(f"{name:<32} {row[0]:>9.2f} {row[1]:>9.2f} {row[2]:>13.3f}   error mm: mean {error['mean']:.2f} max {error['max']:.1f}")
    for name, (encode, decode) in PEERS.items():
        sizes, encode_ms, decode_ms = 0, [], []
        for frame in frames:
            data, elapsed = timed(encode, frame)
            encode_ms.append(elapsed)
            back, elapsed = timed(decode, data)
            decode_ms.append(elapsed)
            assert numpy.array_equal(back, frame), f"{name}: not lossless"
            sizes += len(data)
        row = (statistics.median(encode_ms), statistics.median(decode_ms), sizes * 8 / points)
        ratios = [mine / theirs for mine, theirs in zip(row, ours)]
        print(
            f"{name:<32} {row[0]:>9.2f} {row[1]:>9.2f} {row[2]:>13.3f}"
            f"           {ratios[2]:>5.2f}  {ratios[0]:>6.2f}  {ratios[1]:>6.2f}"
        )


def main():
    bundled = [ROOT / "recordings" / name for name in ("static_room", "moving_camera", "moving_object")]
    for folder in sys.argv[1:] or bundled:
        compare(folder)


if __name__ == "__main__":
    main()
