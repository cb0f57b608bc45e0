#!/usr/bin/env python3
"""JPEG XL, JPEG-LS and Draco on the frames of `cargo bench --bench peers`, beside this program's own numbers.

Needs `pip install imagecodecs numpy` and the program: `target/release/saint-live` (`cargo build --release`), or the one SAINT_LIVE names.

    benches/peers.py [FOLDER ...]        without folders: the bundled recordings

Each folder goes through the program first (`replay --lossless`, `export --to png16`), so that the
peers code the measurements the program codes, 0 elsewhere. One thread each. A ratio is the peer's
number over that of our lossless stream in the steady state (`bench --lossless --effort usual --threads 1`); times
are medians over frames, each run once, ours like theirs. Draco (`draco_encoder`, Debian: `apt-get
install draco`; left out where it is not) codes the points, 14 bits a coordinate over their extent,
not without loss; its times are those of its commands, with their start and their files.
"""

import json
import os
import pathlib
import shutil
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
DRACO_FRAMES = 5

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
        camera = json.loads(next((scratch / "png").rglob("camera.json")).read_text())
        return [imagecodecs.png_decode(file.read_bytes()) for file in files], camera


def timed(work, argument):
    start = time.perf_counter()
    result = work(argument)
    return result, (time.perf_counter() - start) * 1e3


def points_of(frame, camera):
    """Points of a frame, n x 3 float32, metres."""
    v, u = numpy.nonzero(frame)
    z = frame[v, u] * camera["depth_scale_m_per_unit"]
    x = (u - camera["cx"]) / camera["fx"] * z
    y = (v - camera["cy"]) / camera["fy"] * z
    return numpy.stack([x, y, z], axis=1).astype("<f4")


def draco(frame, camera):
    """Encode ms, decode ms, bytes, largest distance of a point along an axis (mm)."""
    points = points_of(frame, camera)
    header = "ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    with tempfile.TemporaryDirectory() as scratch:
        ply, drc, back = (str(pathlib.Path(scratch) / name) for name in ("in.ply", "x.drc", "out.ply"))
        pathlib.Path(ply).write_bytes((header % len(points)).encode() + points.tobytes())
        run = lambda *command: subprocess.run(command, check=True, capture_output=True)
        _, encode_ms = timed(lambda _: run("draco_encoder", "-point_cloud", "-i", ply, "-o", drc, "-qp", "14"), None)
        _, decode_ms = timed(lambda _: run("draco_decoder", "-i", drc, "-o", back), None)
        count = int(pathlib.Path(back).read_bytes().split(b"element vertex ")[1].split()[0])
        assert count == len(points), f"Draco: {count} of {len(points)} points"
        step_mm = float(numpy.ptp(points, axis=0).max()) / (2**14 - 1) * 1e3
        return encode_ms, decode_ms, pathlib.Path(drc).stat().st_size, step_mm / 2


def compare(folder):
    frames, camera = frames_of(folder)
    points = sum(int(numpy.count_nonzero(frame)) for frame in frames)
    height, width = frames[0].shape
    print(f"\n{folder} ({width}x{height}), {len(frames)} frames, one thread")
    print(f"{'':<32} {'encode ms':>9} {'decode ms':>9} {'bits/valid px':>13}   ratios: size  encode  decode")
    ours = None
    usual = ["--effort", "usual"]
    for name, flags in (
        ("usual effort, lossless", ["--lossless", *usual]),
        ("live, lossless", ["--lossless"]),
        ("live, default tolerance (lossy)", []),
    ):
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
    if shutil.which("draco_encoder") is None:
        return print("Draco: not installed")
    chosen = frames[:: max(1, len(frames) // DRACO_FRAMES)][:DRACO_FRAMES]
    told = [draco(frame, camera) for frame in chosen]
    encode_ms, decode_ms, _, error = (statistics.median(column) for column in zip(*told))
    bits = sum(row[2] for row in told) * 8 / sum(int(numpy.count_nonzero(frame)) for frame in chosen)
    print(
        f"{'Draco -qp 14 (lossy)':<32} {encode_ms:>9.2f} {decode_ms:>9.2f} {bits:>13.3f}"
        f"           {bits / ours[2]:>5.2f}  {encode_ms / ours[0]:>6.2f}  {decode_ms / ours[1]:>6.2f}"
        f"   half a step {error:.2f} mm"
    )


def main():
    bundled = [ROOT / "recordings" / name for name in ("static_room", "moving_camera", "moving_object")]
    for folder in sys.argv[1:] or bundled:
        compare(folder)


if __name__ == "__main__":
    main()
