#!/usr/bin/env python3
"""A second decoder of saint-live's polar payload, version 2, written from src/codec/FORMAT.md,
chapter 2.

    reference_polar.py PAYLOAD [OUT]

OUT receives, little endian, the origin (3 f64), the step (f32), and for each sphere its seven f32,
the number of its claims (u32), and row and column of each (i32). The CRC-32 of that goes to
standard output. Slow and plain on purpose. Needs Python 3.8; entropy coding is in
reference_coder.py.
"""

import math
import struct
import sys
import zlib

from reference_coder import Bit, Contexts, Integer, Range, Refused, Weights, bits, mixed_bit

FARTHEST = 1 << 24


class Float:
    def __init__(self):
        self.top = bits(512)
        self.used = [bits(32) for _ in range(32)]

    def read(self, coder):
        node = 1
        for _ in range(9):
            node = 2 * node + coder.bit(self.top[node])
        top, node = node - 512, 1
        for _ in range(5):
            node = 2 * node + coder.bit(self.used[top % 32][node])
        count = min(node - 32, 23)
        fraction = coder.plain(count - 1) << 1 | 1 if count > 0 else 0
        return top << 23 | fraction << (23 - count)


def as_float(pattern):
    return struct.unpack("<f", struct.pack("<I", pattern))[0]


def as_pattern(value):
    return struct.unpack("<I", struct.pack("<f", value))[0]


class Spheres:
    """The spheres of a payload, each as seven bit patterns."""

    def __init__(self):
        self.again = bits(2)
        self.last = [[0] * 7, [0] * 7]
        self.anchor = [Float() for _ in range(3)]
        self.side = [Float(), Float()]
        self.curvature = Float()
        self.pole, self.sign = bits(2), bits(3)
        self.near, self.off = Bit(), Integer()

    def read(self, coder, any_claim):
        if not coder.bit(self.again[any_claim]):
            sphere = [model.read(coder) for model in self.anchor]
            sphere += self.normal(coder)
            sphere.append(self.curvature.read(coder))
            self.last[any_claim] = sphere
        return self.last[any_claim]

    def normal(self, coder):
        pole = 2 if coder.bit(self.pole[0]) else int(coder.bit(self.pole[1]))
        normal = [0, 0, 0]
        for k, model in enumerate(self.side):
            normal[(pole + 1 + k) % 3] = model.read(coder)
        a, b = (as_float(normal[(pole + k) % 3]) for k in (1, 2))
        negative = coder.bit(self.sign[pole])
        rest = 1.0 - a * a - b * b
        unit = as_pattern(math.sqrt(rest) if rest > 0.0 else 0.0)
        if coder.bit(self.near):
            size = min(max(unit + self.off.signed(coder), 0), (1 << 31) - 1)
        else:
            size = coder.plain(31)
        normal[pole] = negative << 31 | size
        return normal


def gaps(cells):
    """Cells without a claim before the first one and before the next one, nearest first."""
    found, at = [], 0
    for _ in range(2):
        gap = 0
        while gap < 8 and at + gap < len(cells) and not cells[at + gap]:
            gap += 1
        # beyond what is known there are none
        found.append(gap if at + gap < len(cells) else 8)
        at += gap + 1
        if found[0] == 8:
            return [8, 8]
    return found


class Claims:
    """The claims of a payload's spheres."""

    def __init__(self):
        self.first_row, self.first_column = Integer(), Integer()
        self.rows_on, self.columns_on = Integer(), Integer()
        self.beside, self.more, self.below = bits(64), bits(2), bits(2)
        self.contexts = [Contexts(), Contexts(), Contexts()]
        self.weights = Weights()

    def read(self, coder, most):
        """Cells of one sphere, by row, then column."""
        claimed, above, first = [], {}, 0
        row = self.first_row.signed(coder)
        while True:
            own = {}
            first += self.first_column.signed(coder)
            column = first
            while True:
                tile = self.tile(coder, above, own, row, column)
                own[column] = tile
                claimed += tile
                if len(claimed) > most:
                    raise Refused("more claims than announced")
                east = above.get(column + 1, set())
                e = min(sum(x == 8 * column + 7 for _, x in tile), 3)
                f = min(sum(y == 8 * row - 1 for y, _ in east), 3)
                g, h = bool(east), column + 2 in above
                if coder.bit(self.beside[e + 4 * f + 16 * g + 32 * h]):
                    column += 1
                    continue
                beyond = any(x > column for x in above)
                if not coder.bit(self.more[beyond]):
                    break
                column += 2 + self.columns_on.read(coder)
            last = any(y == 8 * row + 7 for tile in own.values() for y, _ in tile)
            if not coder.bit(self.below[last]):
                return sorted(claimed)
            on = self.rows_on.read(coder)
            row, above = row + 1 + on, {} if on else own

    def tile(self, coder, above, own, row, column):
        known = [above.get(column + k, set()) for k in (-1, 0, 1)]
        known = set().union(own.get(column - 1, set()), *known)
        tile = set()
        for y in range(8 * row, 8 * row + 8):
            for x in range(8 * column, 8 * column + 8):
                if (y, x) == (8 * row + 7, 8 * column + 7) and not tile:
                    claim = True
                else:
                    claim = self.cell(coder, known, row, column, y, x)
                if claim:
                    if max(abs(y), abs(x)) > FARTHEST:
                        raise Refused("a claim beyond 2^24")
                    tile.add((y, x))
                    known.add((y, x))
        return tile

    def cell(self, coder, known, row, column, y, x):
        def line(places):
            return [int((y + j, x + i) in known) for i, j in places]

        def bits_of(cells):
            return sum(cell << k for k, cell in enumerate(cells))

        across, top = x - (8 * column - 8), y - (8 * row - 8)
        left = gaps(line((-k, 0) for k in range(1, across + 1)))
        up = gaps(line((0, -k) for k in range(1, top + 1)))
        right = gaps(line((1, -k) for k in range(1, top + 1)))[0]
        pattern = bits_of(
            line([(-3, 0), (-2, 0), (-1, 0)])
            + line((k, -1) for k in range(-2, 3))
            + line((k, -2) for k in range(-2, 3))
            + line([(0, -3)])
        )
        number = sum(
            line((k, 0) for k in range(-4, 0))
            + line((k, -1) for k in range(-4, 5))
            + line((k, -2) for k in range(-4, 5))
            + line((k, -3) for k in range(-3, 4))
        )
        cells = (
            pattern,
            ((left[0] * 9 + left[1]) * 9 + up[0]) * 8 + min(right, 7),
            (number * 9 + up[0]) * 9 + up[1],
        )
        estimates = [context.at(cell) for context, cell in zip(self.contexts, cells)]
        return mixed_bit(coder, estimates, self.weights.at(number // 4))


def varint(data, at):
    value = 0
    for k in range(5):
        if at + k >= len(data):
            raise Refused("it ends early")
        value |= (data[at + k] & 127) << 7 * k
        if data[at + k] < 128:
            if value >= 1 << 32 or (k > 0 and data[at + k] == 0):
                break
            return value, at + k + 1
    raise Refused("a number is not as it must be")


def decode(payload):
    """Origin, step, and each sphere with its claims."""
    if payload[:4] != b"SPOL":
        raise Refused("no polar payload")
    if payload[4:6] != b"\2\0":
        raise Refused("version or flags are not known")
    data = payload[:-4]
    if len(data) < 34 or struct.pack("<I", zlib.crc32(data)) != payload[-4:]:
        raise Refused("the check does not match")
    *origin, step = struct.unpack_from("<dddf", data, 6)
    if not all(map(math.isfinite, origin + [step])) or step <= 0.0:
        raise Refused("origin or step")
    count, at = varint(data, 34)
    total, at = varint(data, at)
    run = data[at:]
    if count + total > 64 * len(run):
        raise Refused("more spheres and claims than bytes can hold")
    coder, any_claim, spheres, claims = Range(run), Bit(), Spheres(), Claims()
    found, left = [], total
    for _ in range(count):
        some = coder.bit(any_claim)
        sphere = spheres.read(coder, some)
        values = [as_float(pattern) for pattern in sphere]
        if not all(map(math.isfinite, values)) or abs(math.hypot(*values[3:6]) - 1.0) >= 1e-3:
            raise Refused("a sphere")
        cells = claims.read(coder, left) if some else []
        left -= len(cells)
        found.append((sphere, cells))
        coder.end()
    if left or any(run[coder.at :]):
        raise Refused("claims or bytes are left")
    return origin, step, found


def main(arguments):
    if len(arguments) not in (1, 2):
        sys.exit(__doc__)
    with open(arguments[0], "rb") as file:
        origin, step, spheres = decode(file.read())
    out = [struct.pack("<dddf", *origin, step)]
    for sphere, cells in spheres:
        out.append(struct.pack("<7II", *sphere, len(cells)))
        out += [struct.pack("<ii", *cell) for cell in cells]
    out = b"".join(out)
    print(f"{zlib.crc32(out):08x}")
    if len(arguments) == 2:
        with open(arguments[1], "wb") as file:
            file.write(out)


if __name__ == "__main__":
    main(sys.argv[1:])
