"""Bins, charts and motion of saint-live's sensor payload (src/codec/FORMAT.md §1.6, §1.7), for
reference_decoder.py: everything that is arithmetic, plain and slow on purpose."""

import bisect

import numpy as np

F32, F64 = np.float32, np.float64
MOST = 1 << 21  # §1.6, clamp of a sphere's numbers


class Entry:
    def __init__(self, a, m, far, exponent):
        self.a, self.m, self.far, self.exponent = F32(a), [F32(c) for c in m], far, exponent


class Bins:
    """The bins of a stream, class by class."""

    def __init__(self, stream, integers):
        self.stream, self.tables = stream, {}
        self.integers = range(1, 65536) if integers is None else sorted(integers)
        u = np.abs(stream.u[: stream.width]).max().astype(F64)
        v = np.abs(stream.v[: stream.height]).max().astype(F64)
        most = u * u + v * v + 1.0
        self.edges = [1.0 + (most - 1.0) * n / 8.0 for n in range(9)]

    def at(self, x, y):
        q = F64(self.stream.q[y, x])
        c = sum(q >= self.edges[n] for n in range(1, 8))
        if c not in self.tables:
            self.tables[c] = self.fill(c)
        return self.tables[c]

    def fill(self, c):
        s, table = self.stream, Table()
        first = None
        for i in self.integers:
            if first is None or i > first + widest:
                first, widest = i, 0
                if not s.lossless:
                    f = F32(i)
                    reach = F64(max(s.reach_floor, s.reach_growth * f * f))
                    widest = 2 * int(reach * 0.999 / np.sqrt(self.edges[c + 1]))
                table.begins.append(i)
                table.centres.append(i)
            table.centres[-1] = (first + i) >> 1
        if first is None:
            table.begins, table.centres = [0], [1]
        return table


class Table:
    def __init__(self):
        self.begins, self.centres = [], []

    def bin(self, integer):
        return max(bisect.bisect_right(self.begins, integer) - 1, 0)

    def part(self, own, d):
        quarter = F32(4)
        if own + 1 < len(self.centres):
            quarter = F32(4) / F32(self.centres[own + 1] - self.centres[own])
        way = (d - F32(self.centres[own])) * quarter
        return int(min(max(way, F32(-3)), F32(3)) + F32(8.5)) - 8


def nine(t):
    small = {0: 4, 1: 5, -1: 3, 2: 6, -2: 2}
    if t in small:
        return small[t]
    if t > 0:
        return 7 if t <= 5 else 8
    return 1 if t >= -5 else 0


def five(t):
    return min(max(t, -2), 2) + 2


def clamp(n):
    return min(max(n, -MOST), MOST)


class Chart:
    """Where and in which steps a sphere is stated. All numbers are float64."""

    def __init__(self, stream, support, step):
        x0, y0, x1, y1 = support
        u, v = stream.u.astype(F64), stream.v.astype(F64)
        du, dv = u[1] - u[0], v[1] - v[0]
        x, y = F64(4 * (x0 + x1 + 1) - 0.5), F64(4 * (y0 + y1 + 1) - 0.5)
        self.u, self.v = u[0] + x * du, v[0] + y * dv
        self.q = self.u * self.u + self.v * self.v + 1.0
        self.hu, self.hv = 4.0 * (x1 - x0 + 1) * du, 4.0 * (y1 - y0 + 1) * dv
        self.bulge = 0.5 * (self.hu * self.hu + self.hv * self.hv)
        self.step = step

    def scale(self, n):
        w = max(n[0] * self.step, self.step * 0.5)
        p, r = n[1] * self.step / w, n[2] * self.step / w
        return w, self.bulge + 0.5 * (p * p + r * r)

    def round(self, x):
        n = np.floor(x / self.step + 0.5)
        return 0 if np.isnan(n) else int(min(max(n, -MOST), MOST))

    def quantise(self, entry):
        a, (mx, my, mz) = F64(entry.a), map(F64, entry.m)
        l = mx * self.u + my * self.v + mz
        square = l * l + 4.0 * a * self.q
        root = np.sqrt(square if square > 0 else F64(0))
        w = 0.5 * (l - root if entry.far else l + root)
        slope = 1.0 + a * self.q / (w * w)
        if abs(slope) < 1e-3:
            slope = F64(1e-3)
        wu = (2.0 * a * self.u / w + mx) / slope
        wv = (2.0 * a * self.v / w + my) / slope
        n = [self.round(w), self.round(wu * self.hu), self.round(wv * self.hv)]
        w, bulge = self.scale(n)
        return n + [self.round(a / slope * bulge / w)]

    def restore(self, n):
        w, bulge = self.scale(n)
        bend = n[3] * self.step * w / bulge
        turn = 1.0 - bend * self.q / (w * w)
        a = bend / (F64(1e-3) if abs(turn) < 1e-3 else turn)
        wu, wv = n[1] * self.step / self.hu, n[2] * self.step / self.hv
        slope = 1.0 + a * self.q / (w * w)
        mx = wu * slope - 2.0 * a * self.u / w
        my = wv * slope - 2.0 * a * self.v / w
        mz = w - a * self.q / w - mx * self.u - my * self.v
        return a, [mx, my, mz]


def inverse_depth(entry, u, v, q):
    """0.5·(l ± root) of §1.6, "Prediction", f32."""
    l = entry.m[0] * u + entry.m[1] * v + entry.m[2]
    root = np.sqrt(l * l + (F32(4) * entry.a) * q)
    return F32(0.5) * (l - root if entry.far else l + root)


def turn_and_shift(motion):
    """R and t of §1.7."""
    x, y, z = (F64(n) / 65536.0 for n in motion[:3])
    t = [F64(n) / 16384.0 for n in motion[3:]]
    n = 1.0 + x * x + y * y + z * z
    r = [
        [1.0 + x * x - y * y - z * z, 2.0 * (x * y - z), 2.0 * (x * z + y)],
        [2.0 * (x * y + z), 1.0 - x * x + y * y - z * z, 2.0 * (y * z - x)],
        [2.0 * (x * z - y), 2.0 * (y * z + x), 1.0 - x * x - y * y + z * z],
    ]
    return [[value / n for value in row] for row in r], t


def shift_of(motion, u, v, w, du, dv):
    """How many pixels right and down the point of inverse depth w on the ray (u, v) was."""
    r, t = turn_and_shift(motion)
    z = 1.0 / w
    e = [u * z - t[0], v * z - t[1], z - t[2]]
    p = [r[0][k] * e[0] + r[1][k] * e[1] + r[2][k] * e[2] for k in range(3)]
    return whole64((p[0] / p[2] - u) / du + 0.5), whole64((p[1] / p[2] - v) / dv + 0.5)


def whole64(x):
    """int(floor(x)), 64 bits."""
    x = np.floor(x)
    return 0 if np.isnan(x) else int(min(max(x, -(2.0**63)), 2.0**63 - 1024))


def move(entry, motion):
    if entry is None:
        return None
    r, t = turn_and_shift(motion)
    a, m = F64(entry.a), [F64(c) for c in entry.m]
    turned = [row[0] * m[0] + row[1] * m[1] + row[2] * m[2] for row in r]
    tt = t[0] * t[0] + t[1] * t[1] + t[2] * t[2]
    d = 1.0 - a * tt + (turned[0] * t[0] + turned[1] * t[1] + turned[2] * t[2])
    if abs(d) < 1e-6:
        return None
    moved = Entry(a / d, [(turned[k] - 2.0 * a * t[k]) / d for k in range(3)], entry.far, 0)
    moved.exponent = entry.exponent
    return moved if np.isfinite([moved.a, *moved.m]).all() else None
