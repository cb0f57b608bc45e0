#!/usr/bin/env python3
"""Bits against error: this program beside the best image coders of depth, on the same frames.

Needs `pip install imagecodecs numpy scipy opencv-python-headless OpenEXR` and the program: `target/release/saint-live`, or the
one SAINT_LIVE names.

    benches/rate_distortion.py FOLDER [FOLDER ...] [--frames N] [--every K] [--depth-max METRES]

A folder holds `depth/*.png` and `camera.json` (as `export --to png16` writes them). Ours is a stream of
the first N frames with key frames every 30, in several qualities; peers code every frame alone:
JPEG XL (effort 7) of depth rounded in depth ("z") or in inverse depth ("d"), all pixels or every 2nd or 4th
in both directions with interpolation inside surfaces. Every K-th frame is compared: symmetric Chamfer
distance and the 99th percentile of the nearest-neighbour distances (worse direction), mm; pixels lost and
invented. At the end: bits at equal error, by interpolation between the settings, and the ratio to the best
peer.
"""

import argparse
import collections
import json
import os
import pathlib
import subprocess
import tempfile

import cv2
import imagecodecs
import numpy
from scipy.spatial import cKDTree

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = os.environ.get("SAINT_LIVE", ROOT / "target/release/saint-live")
OURS = {
    "default": [],
    "quality 30": ["--quality", 30],
    "quality 40": ["--quality", 40],
    "quality 60": ["--quality", 60],
    "quality 70": ["--quality", 70],
    "quality 30, smooth mask": ["--quality", 30, "--smooth-mask"],
    "max error 5 mm": ["--max-error", "5mm"],
    "max error 10 mm": ["--max-error", "10mm"],
}
LEVELS = (("Chamfer", 0, (1, 2, 3.5, 5)), ("p99", 1, (5, 10, 20)))

Point = collections.namedtuple("Point", "name bits chamfer p99 lost invented")


class Frames:
    """Depth of the compared frames, metres, 0 where nothing was measured."""

    def __init__(self, folder, options):
        self.camera = json.loads((folder / "camera.json").read_text())
        self.files = sorted((folder / "depth").glob("*.png"))[: options.frames]
        self.every = options.every
        self.options = options
        unit = self.camera.get("depth_scale_m_per_unit") or self.camera["depth_unit_m"]
        self.depth = [self.read(file, unit) for file in self.files[:: options.every]]
        self.valid = sum(int((self.read(f, unit) > 0).sum()) for f in self.files)
        height, width = self.depth[0].shape
        u, v = numpy.meshgrid(numpy.arange(width), numpy.arange(height))
        c = self.camera.get("intrinsics", self.camera)
        self.rays = numpy.stack([(u - c["cx"]) / c["fx"], (v - c["cy"]) / c["fy"], numpy.ones(u.shape)], -1)

    def read(self, file, unit):
        raw = cv2.imread(str(file), -1)
        raw[numpy.isin(raw, self.camera.get("invalid_values", [0]))] = 0
        depth = raw * unit
        depth[depth > self.options.depth_max] = 0
        return depth

    def compare(self, name, bits_per_pixel, decoded):
        errors, lost, invented, valid = [], 0, 0, 0
        for true, got in zip(self.depth, decoded):
            a, b = true > 0, got > 0
            first, second = (self.rays * true[..., None])[a], (self.rays * got[..., None])[b]
            forth, back = cKDTree(second).query(first)[0] * 1e3, cKDTree(first).query(second)[0] * 1e3
            worse = max(numpy.percentile(forth, 99), numpy.percentile(back, 99))
            errors.append(((forth.mean() + back.mean()) / 2, worse))
            lost, invented, valid = lost + (a & ~b).sum(), invented + (b & ~a).sum(), valid + a.sum()
        chamfer, p99 = numpy.mean(errors, 0)
        point = Point(name, bits_per_pixel, chamfer, p99, lost / valid, invented / valid)
        print(
            f"{name:<34} {point.bits:7.4f} {chamfer:8.2f} {p99:8.2f} {point.lost:7.2%} {point.invented:7.2%}",
            flush=True,
        )
        return point


def ours(folder, frames):
    """Each setting of the program, bits of the whole stream."""
    for name, flags in OURS.items():
        with tempfile.TemporaryDirectory() as scratch:
            scratch = pathlib.Path(scratch)
            flags = [*flags, "--depth-max", f"{frames.options.depth_max}m", "--to", len(frames.files)]
            run = lambda *a: subprocess.run([PROGRAM, *map(str, a)], check=True, capture_output=True, text=True).stdout
            flags += ["--smooth-mask"] * (frames.options.smooth_mask and "--smooth-mask" not in flags)
            run("replay", folder, "-o", scratch / "x.mcap", "-q", "--effort", "usual", *flags)
            info = json.loads(run("info", scratch / "x.mcap", "--json"))
            run("export", scratch / "x.mcap", "--to", "exr", "-o", scratch / "exr", "-q")
            files = sorted((scratch / "exr").glob("*.exr"))[:: frames.every]
            decoded = [read_exr(file) for file in files]
            yield frames.compare(name, info["bits_per_frame"] * info["frames"] / frames.valid, decoded)


def read_exr(file):
    import OpenEXR

    depth = numpy.array(OpenEXR.File(str(file)).channels()["Z"].pixels, numpy.float64)
    return numpy.where(numpy.isfinite(depth) & (depth > 0), depth, 0)


def rounded(depth, inverse, step):
    """Numbers of the distinct rounded depths, 0 where nothing was measured, and what they stand for."""
    on = depth > 0
    steps = numpy.zeros(depth.shape, numpy.int64)
    steps[on] = numpy.maximum(1, numpy.round(1 / (depth[on] * step) if inverse else depth[on] / step))
    back = numpy.zeros(depth.shape)
    back[on] = 1 / (steps[on] * step) if inverse else steps[on] * step
    distinct, numbers = numpy.unique(steps, return_inverse=True)
    return numbers.reshape(depth.shape) + (distinct[0] != 0), back


def enlarged(small, factor, shape, edge=0.05):
    """Interpolated in inverse depth inside surfaces, the nearest pixel across edges and holes."""
    y, x = (numpy.arange(n) / factor for n in shape)
    y0, x0 = (numpy.minimum(a.astype(int), n - 1) for a, n in zip((y, x), small.shape))
    y1, x1 = (numpy.minimum(a + 1, n - 1) for a, n in zip((y0, x0), small.shape))
    fy, fx = (y - y0)[:, None], (x - x0)[None]
    corners = numpy.stack([small[numpy.ix_(a, b)] for a in (y0, y1) for b in (x0, x1)])
    weights = numpy.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])
    low, high = corners.min(0), corners.max(0)
    inside = (low > 0) & (high - low < edge * numpy.maximum(low, 0.3))
    inverse = (weights / numpy.where(corners > 0, corners, 1)).sum(0)
    near = small[numpy.ix_(*(numpy.minimum(numpy.round(a).astype(int), n - 1) for a, n in zip((y, x), small.shape)))]
    return numpy.where(inside, 1 / inverse, near)


def peers(frames):
    settings = [(1, False, s) for s in (0.004, 0.01, 0.02)]
    settings += [(1, True, s) for s in (0.0015, 0.003, 0.006, 0.012, 0.024)]
    settings += [(2, True, s) for s in (0.0015, 0.003, 0.006, 0.012)]
    settings += [(4, True, s) for s in (0.003, 0.006, 0.012)]
    for factor, inverse, step in settings:
        bits, decoded = 0, []
        for depth in frames.depth:
            numbers, back = rounded(depth[::factor, ::factor], inverse, step)
            image = numbers.astype(numpy.uint16)
            bits += 8 * len(imagecodecs.jpegxl_encode(image, lossless=True, effort=7, numthreads=1))
            decoded.append(back if factor == 1 else enlarged(back, factor, depth.shape))
        name = f"JPEG XL 1/{factor} {'d' if inverse else 'z'} {step}"
        yield frames.compare(name, bits / sum(int((d > 0).sum()) for d in frames.depth), decoded)


def at(points, measure, level):
    """Fewest bits at this error, interpolated (log bits) between settings of the same family."""
    families = collections.defaultdict(list)
    for p in points:
        families[p.name.rsplit(" ", 1)[0] if p.name.startswith("JPEG") else p.name.startswith("max")].append(p)
    found = []
    for family in families.values():
        pairs = sorted((p[2 + measure], numpy.log(p.bits)) for p in family)
        errors, bits = zip(*pairs)
        if errors[0] <= level <= errors[-1]:
            found.append(float(numpy.exp(numpy.interp(level, errors, bits))))
        found += [p.bits for p in family if p[2 + measure] <= level]
    return min(found, default=None)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=pathlib.Path)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--smooth-mask", action="store_true", help="in all rows of ours")
    parser.add_argument("--depth-max", type=float, default=65.0)
    options = parser.parse_args()
    for folder in options.folders:
        frames = Frames(folder, options)
        print(f"\n{folder.name}: {len(frames.files)} frames, {len(frames.depth)} compared")
        print(f"{'':<34} {'bits/px':>7} {'Chamfer':>8} {'p99':>8} {'lost':>7} {'invented':>7}")
        mine, theirs = list(ours(folder, frames)), list(peers(frames))
        for name, measure, levels in LEVELS:
            for level in levels:
                a, b = at(mine, measure, level), at(theirs, measure, level)
                ratio = f"{a / b:.2f}" if a and b else "-"
                told = " ".join(f"{x:.3f}" if x else "-" for x in (a, b))
                print(f"{name} {level} mm: ours, best peer {told}, ratio {ratio}")


if __name__ == "__main__":
    main()
