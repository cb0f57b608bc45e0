#!/usr/bin/env python3
"""A second decoder of saint-live's sensor payload, version 3, written from src/codec/FORMAT.md.

    reference_decoder.py CHAIN [PLANES]

CHAIN holds payloads one after the other, each after its length (u32, little endian). PLANES
receives, frame by frame, depth (float32) and labels (uint16), row-major, little endian. One line
per frame goes to standard output: frame, CRC-32 of depth, CRC-32 of labels. Slow and plain on
purpose. Section numbers are those of FORMAT.md; entropy coding is in reference_coder.py, arithmetic
in reference_geometry.py. Needs Python 3.8 and NumPy.
"""

import struct
import sys
import zlib

import numpy as np

from reference_coder import Contexts, Integer, Range, Refused, Weights, bits, mixed_bit, single_bit
from reference_coder import unfold
from reference_geometry import F32, F64, Bins, Chart, Entry, clamp, five, inverse_depth, move, nine
from reference_geometry import shift_of

NO_SPHERE, INVALID = 65534, 65535
KEY, LOSSLESS, DEGRADED, MOVED, PLAIN, FAST = 1, 2, 4, 8, 16, 64
EMPTY, FULL, MIXED = 0, 1, 2
SMOOTH, SPARSE, DENSE = 0, 1, 2
ENDS = [1, 2, 3, 5, 7, 11, 15, 23, 31, 47, 63, 95, 127, 191]


class Models:
    """Start values of all models."""

    def __init__(self):
        self.full, self.empty = bits(36), bits(36)
        self.alone = [bits(8) for _ in range(16)]
        self.more = [bits(16) for _ in range(3)]
        self.candidate = [[bits(8) for _ in range(2)] for _ in range(8)]
        self.none, self.new = bits(2), bits(2)
        self.keep, self.far, self.plane, self.runs_on = bits(4)
        self.step, self.step_change = Integer(), Integer()
        self.fresh = [Integer() for _ in range(4)]
        self.change = [Integer() for _ in range(4)]
        self.guided = [Integer() for _ in range(4)]
        self.quad_full, self.quad_empty = bits(324), bits(324)
        self.mask, self.mask_weights = [Contexts() for _ in range(3)], Weights()
        self.split, self.whole = bits(270), bits(729)
        self.label, self.label_weights = [Contexts() for _ in range(3)], Weights()
        (self.listed,) = bits(1)
        self.active, self.dense, self.miss = bits(9), bits(27), bits(81)
        self.count, self.gap, self.misses = Integer(), Integer(), Integer()
        self.fine, self.bin_far = bits(14), Integer()
        self.bins, self.bin_weights = [Contexts() for _ in range(3)], Weights()


# --- §1.2 layout, §1.3 refusals ------------------------------------------------------------------


class Fields:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        if count > len(self.data) - self.at:
            raise Refused("the payload ends early")
        self.at += count
        return self.data[self.at - count : self.at]

    def unpack(self, form):
        return struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))

    def varint(self):
        value = 0
        for group in range(10):
            (byte,) = self.take(1)
            value |= (byte & 0x7F) << 7 * group
            if byte < 0x80:
                return value & (1 << 64) - 1
        raise Refused("a number of more than ten bytes")


class Stream:
    """What a key frame says of the stream, and §1.5 rays."""

    def __init__(self, fields, lossless):
        self.lossless = lossless
        self.width, self.height = fields.varint(), fields.varint()
        self.fx, self.fy, self.cx, self.cy, unit, floor, growth = map(F64, fields.unpack("7d"))
        w, h = self.width, self.height
        if not (2 <= w <= 8192 and 2 <= h <= 8192 and w * h <= 1 << 23):
            raise Refused(f"image size {w}x{h}")
        if not (1 <= self.fx <= 1e6 and 1 <= self.fy <= 1e6):
            raise Refused("focal length")
        if not (abs(self.cx) <= 1e6 and abs(self.cy) <= 1e6):
            raise Refused("principal point")
        if not 1e-7 <= unit <= 1:
            raise Refused("unit")
        if not (1e-7 <= floor <= 1e3 and 0 <= growth <= 1):
            raise Refused("contact distance")
        self.columns, self.rows = -(-w // 8), -(-h // 8)
        self.blocks = self.columns * self.rows
        self.u = ((np.arange(8 * self.columns, dtype=F64) - self.cx) / self.fx).astype(F32)
        self.v = ((np.arange(8 * self.rows, dtype=F64) - self.cy) / self.fy).astype(F32)
        u, v = self.u[None, :], self.v[:, None]
        self.q = u * u + v * v + F32(1)
        self.unit = unit
        self.per_metre, self.single = F32(F64(1) / unit), F32(unit)
        self.reach_floor, self.reach_growth = F32(floor / unit), F32(growth * unit)


class Plane:
    """A padded image that can be read three pixels beyond its edge."""

    def __init__(self, stream, value):
        shape = (8 * stream.rows + 6, 8 * stream.columns + 6)
        self.cells = np.full(shape, value, dtype=np.int64)
        self.inner = self.cells[3:-3, 3:-3]

    def at(self, x, y):
        return int(self.cells[y + 3, x + 3])

    def set(self, x, y, value):
        self.cells[y + 3, x + 3] = value


class Picture:
    """What one frame leaves to the next (§1.7)."""

    def __init__(self, stream):
        self.mask = Plane(stream, 0)
        self.labels = Plane(stream, NO_SPHERE)
        self.fills = [EMPTY] * stream.blocks
        self.palettes = [[] for _ in range(stream.blocks)]
        self.kinds = [SMOOTH] * stream.blocks
        self.entries = []


class Decoder:
    def __init__(self):
        self.stream = self.models = self.past = self.last_sequence = None

    def decode(self, payload):
        """Depth and labels of one payload."""
        reference, self.last_sequence = self.last_sequence, None
        if len(payload) < 4:
            raise Refused("the payload ends early")
        body = payload[:-4]
        if struct.unpack("<I", payload[-4:])[0] != zlib.crc32(body):
            raise Refused("checksum")
        fields = Fields(body)
        if fields.take(2) != b"SL" or fields.take(1) != b"\x03":
            raise Refused("magic or version")
        (flags,) = fields.take(1)
        if flags & ~(KEY | LOSSLESS | DEGRADED | MOVED | PLAIN | FAST):
            raise Refused("unknown flags")
        sequence = fields.varint()
        fields.unpack("2q")
        motion = [0] * 6
        if flags & KEY:
            stream = Stream(fields, bool(flags & LOSSLESS))
        else:
            wanted = (sequence - fields.varint()) % (1 << 64)
            if flags & MOVED:
                folded = [fields.varint() for _ in range(6)]
                if max(folded) > 65535:
                    raise Refused("motion")
                motion = [unfold(n) for n in folded]
        lengths = [fields.varint() for _ in range(4)]
        sections = [fields.take(n) for n in lengths]
        if fields.at != len(body):
            raise Refused("bytes after the last section")
        if flags & KEY:
            self.stream, self.models, self.past = stream, Models(), None
        elif reference is None or reference != wanted:
            raise Refused(f"missing reference: frame {sequence} needs frame {wanted}")
        how = bool(flags & PLAIN), bool(flags & FAST)
        frame = Frame(self.stream, self.models, self.past, motion, *how)
        planes = frame.read(sections)
        self.past, self.last_sequence = frame.now, sequence
        return planes


# --- §1.6 sections -------------------------------------------------------------------------------


class Frame:
    def __init__(self, stream, models, past, motion, plain, fast):
        self.stream, self.models, self.past = stream, models, past
        self.plain, self.fast = plain, fast
        self.now = Picture(stream)
        self.motion = motion
        before = past.entries if past else []
        self.taken = [entry is not None for entry in before]
        self.before = before if not any(motion) else [move(entry, motion) for entry in before]
        self.next = self.given = 0

    def read(self, sections):
        blocks, spheres = map(Range, sections[:2])
        self.read_fills(blocks)
        self.read_palettes(blocks)
        blocks.end()
        self.read_spheres(spheres)
        spheres.end()
        self.shifts = [self.shift(k) for k in range(self.stream.blocks)]
        of_mask, of_labels = self.pixels(sections[2])
        self.read_quads(of_mask)
        self.read_mask(of_mask)
        of_mask.end()
        self.read_labels(of_labels)
        of_labels.end()
        self.predict()
        if self.plain:
            self.read_plain_residual(sections[3])
        else:
            residual = Range(sections[3])
            self.read_residual(residual)
            residual.end()
        return self.output()

    def pixels(self, section):
        """What mask and labels are read from: one run, or, fast, one each."""
        if not self.fast:
            return (Range(section),) * 2
        length = struct.unpack("<I", section[:4])[0] if len(section) >= 4 else len(section)
        if len(section) - 4 < length:
            raise Refused("fast")
        return Range(section[4 : 4 + length]), Range(section[4 + length :])

    def mixed_bit(self, coder, estimates, weights):
        return single_bit(coder, estimates[0]) if self.fast else mixed_bit(coder, estimates, weights)

    def neighbour(self, k, dx, dy):
        """The block beside block k, or None outside the image."""
        x, y = k % self.stream.columns + dx, k // self.stream.columns + dy
        inside = 0 <= x < self.stream.columns and 0 <= y < self.stream.rows
        return y * self.stream.columns + x if inside else None

    def raster(self, blocks, padded=False):
        """Pixels (x, y, block) of these blocks in raster order, those in the image or all."""
        s = self.stream
        for y in range(8 * s.rows if padded else s.height):
            for bx in range(s.columns):
                k = y // 8 * s.columns + bx
                if blocks[k]:
                    for x in range(8 * bx, 8 * bx + 8 if padded else min(8 * bx + 8, s.width)):
                        yield x, y, k

    # blocks

    def read_fills(self, coder):
        now, past = self.now, self.past
        for k in range(self.stream.blocks):
            west, north = self.neighbour(k, -1, 0), self.neighbour(k, 0, -1)
            c = (now.fills[west] if west is not None else EMPTY) * 3
            c = (c + (now.fills[north] if north is not None else EMPTY)) * 4
            c += past.fills[k] if past else 3
            if coder.bit(self.models.full[c]):
                now.fills[k] = FULL
            else:
                now.fills[k] = EMPTY if coder.bit(self.models.empty[c]) else MIXED

    def peek(self):
        while self.next < len(self.taken) and self.taken[self.next]:
            self.next += 1

    def take(self):
        self.peek()
        number = self.next
        self.next += 1
        self.given = max(self.given, number + 1)
        if number >= 65534:
            raise Refused("too many spheres")
        return number

    def bound(self):
        return max(len(self.taken), self.given)

    def candidates(self, k):
        now, past = self.now.palettes, self.past.palettes if self.past else None
        places = [(past, 0, 0, 1), (now, -1, 0, 2), (now, 0, -1, 4), (now, 1, -1, 0)]
        places += [(now, -1, -1, 0), (past, 1, 0, 0), (past, 0, 1, 0), (past, -1, 0, 0)]
        places += [(past, 0, -1, 0)]
        votes = {}  # in order of first appearance
        for palettes, dx, dy, vote in places:
            there = self.neighbour(k, dx, dy)
            if palettes is None or there is None:
                continue
            for label in palettes[there]:
                if label in votes:
                    votes[label] |= vote
                elif len(votes) < 16:
                    votes[label] = vote
        return list(votes.items())

    def read_palettes(self, coder):
        now, past, models = self.now, self.past, self.models
        for k in range(self.stream.blocks):
            if now.fills[k] == EMPTY:
                continue
            west, north = self.neighbour(k, -1, 0), self.neighbour(k, 0, -1)
            c = west is not None and len(now.palettes[west]) > 1
            c |= (north is not None and len(now.palettes[north]) > 1) << 1
            c |= (past is not None and len(past.palettes[k]) > 1) << 2
            c |= (now.fills[k] == MIXED) << 3
            left = self.candidates(k)
            first = left[0] if self.fast and left else None
            if first and coder.bit(models.alone[c][first[1]]):
                now.palettes[k] = [first[0]]
                continue
            n = 1
            while n < 4 and coder.bit(models.more[n - 1][c]):
                n += 1
            if first and n == 1:
                del left[0]
            palette = []
            for entry in range(n):
                palette.append(self.read_entry(coder, min(entry, 1), left))
            now.palettes[k] = palette

    def read_entry(self, coder, e, left):
        models = self.models
        for r, (label, votes) in enumerate(left):
            if coder.bit(models.candidate[min(r, 7)][e][votes]):
                del left[r]
                return label
        if coder.bit(models.none[e]):
            return NO_SPHERE
        bound = self.bound()
        if bound == 0 or coder.bit(models.new[e]):
            return self.take()
        number = coder.plain((bound - 1).bit_length())
        if number >= bound:
            raise Refused("a sphere that does not exist")
        return number

    # spheres

    def read_spheres(self, coder):
        s, models = self.stream, self.models
        supports = {}
        for k, palette in enumerate(self.now.palettes):
            x, y = k % s.columns, k // s.columns
            for label in palette:
                if label != NO_SPHERE:
                    x0, y0, x1, y1 = supports.get(label, (x, y, x, y))
                    supports[label] = min(x0, x), min(y0, y), max(x1, x), max(y1, y)
        self.now.entries = [None] * self.bound()
        last = None
        for number in sorted(supports):
            before = self.entry_before(number)
            if before and coder.bit(models.keep):
                self.now.entries[number] = before
                continue
            beside = self.beside(number)
            guide = before or beside or last
            if guide:
                exponent = guide.exponent + models.step_change.signed(coder)
            else:
                exponent = models.step.read(coder) - 30
            exponent = min(max(exponent, -30), 10)
            chart = Chart(s, supports[number], F64(2.0) ** exponent)
            far = bool(coder.bit(models.far))
            plane = coder.bit(models.plane)
            n = [0, 0, 0, 0]
            if before or beside and coder.bit(models.runs_on):
                guess = chart.quantise(guide)
                model = models.change if before else models.guided
                for k in range(3 if plane else 4):
                    n[k] = clamp(guess[k] + model[k].signed(coder))
            else:
                guess = chart.quantise(guide)[0] if guide else 0
                n[0] = clamp(guess + models.fresh[0].signed(coder))
                for k in range(1, 3 if plane else 4):
                    n[k] = models.fresh[k].signed(coder)
            last = Entry(*chart.restore(n), far, exponent)
            self.now.entries[number] = last

    def entry_before(self, number):
        return self.before[number] if number < len(self.before) else None

    def beside(self, number):
        """The entry of the first neighbour of this number."""
        palettes = self.now.palettes
        for k, palette in enumerate(palettes):
            if number not in palette:
                continue
            labels = []
            for dx, dy in [(-1, 0), (0, -1)]:
                there = self.neighbour(k, dx, dy)
                labels += palettes[there][:1] if there is not None else []
            for label in labels + palette:
                if label not in (number, NO_SPHERE):
                    here = self.now.entries[label] if label < number else None
                    return here or self.entry_before(label)
        return None

    # pixels

    def shift(self, k):
        """How far the pixels of block k look into the past planes."""
        s, palette = self.stream, self.now.palettes[k]
        if not any(self.motion) or not palette or palette[0] == NO_SPHERE:
            return 0, 0
        entry = self.now.entries[palette[0]]
        x, y = 8 * (k % s.columns), 8 * (k // s.columns)
        u, v = s.u[x + 4], s.v[y + 4]
        w = inverse_depth(entry, u, v, s.q[y + 4, x + 4])
        du, dv = F64(s.u[1]) - F64(s.u[0]), F64(s.v[1]) - F64(s.v[0])
        sx, sy = shift_of(self.motion, F64(u), F64(v), F64(w), du, dv)
        sx = min(max(sx, -x), 8 * s.columns - 8 - x)
        sy = min(max(sy, -y), 8 * s.rows - 8 - y)
        return sx, sy

    def quad(self, k, n):
        """The top left pixel of quad n of block k."""
        s = self.stream
        return 8 * (k % s.columns) + 4 * (n % 2), 8 * (k // s.columns) + 4 * (n // 2)

    def in_past(self, plane, k, x, y, width, height):
        """The cells of a past plane that these pixels of block k look at, row by row."""
        x, y = x + self.shifts[k][0], y + self.shifts[k][1]
        return [plane.at(x + i, y + j) for j in range(height) for i in range(width)]

    def read_quads(self, coder):
        s, now = self.stream, self.now
        self.quads = [[fill] * 4 for fill in now.fills]
        for k in range(s.blocks):
            for n in range(4):
                x, y = self.quad(k, n)
                if now.fills[k] == MIXED:
                    inside = x < s.width and y < s.height
                    self.quads[k][n] = self.read_quad(coder, k, n) if inside else EMPTY
                if self.quads[k][n] == FULL:
                    now.mask.inner[y : min(y + 4, s.height), x : min(x + 4, s.width)] = 1

    def read_quad(self, coder, k, n):
        c = 0
        for dx, dy in [(-1, 0), (0, -1), (1, 0), (0, 1)]:
            x, y = n % 2 + dx, n // 2 + dy
            later = dx + dy > 0
            if 0 <= x < 2 and 0 <= y < 2:
                fill = MIXED if later else self.quads[k][2 * y + x]
            else:
                there = self.neighbour(k, dx, dy)
                if there is None:
                    fill = EMPTY
                elif later:
                    fill = self.now.fills[there]
                else:
                    fill = self.quads[there][2 * (y % 2) + x % 2]
            c = 3 * c + fill
        past = 3
        if self.past:
            measured = sum(self.in_past(self.past.mask, k, *self.quad(k, n), 4, 4))
            past = {0: 0, 16: 1}.get(measured, 2)
        c = 4 * c + past
        if coder.bit(self.models.quad_full[c]):
            return FULL
        return EMPTY if coder.bit(self.models.quad_empty[c]) else MIXED

    def read_mask(self, coder):
        now, past = self.now, self.past
        near = [(-1, 0), (-2, 0), (-1, -1), (0, -1), (1, -1), (0, -2)]
        wide = [(-3, 0), (-2, -1), (2, -1), (-1, -2), (1, -2)]
        around = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        for x, y, k in self.raster([fill == MIXED for fill in now.fills]):
            if self.quads[k][y // 4 % 2 * 2 + x // 4 % 2] != MIXED:
                continue
            if self.plain:
                now.mask.set(x, y, coder.plain(1))
                continue
            sx, sy = self.shifts[k]

            def read(mask, places, x, y):
                c = 0
                for dx, dy in places:
                    c = 2 * c + mask.at(x + dx, y + dy)
                return c

            n6 = read(now.mask, near, x, y)
            few, nine = 8, 512
            if past:
                few = read(past.mask, [(0, 0), (1, 0), (0, 1)], x + sx, y + sy)
                nine = read(past.mask, around, x + sx, y + sy)
            cells = (64 * n6 + 4 * few + read(now.mask, [(1, 0), (0, 1)], x, y),)
            cells += (32 * n6 + read(now.mask, wide, x, y),)
            cells += (4 * nine + read(now.mask, [(-1, 0), (0, -1)], x, y),)
            estimates = [m.at(c) for m, c in zip(self.models.mask, cells)]
            now.mask.set(x, y, self.mixed_bit(coder, estimates, self.models.mask_weights.at(n6)))

    def read_labels(self, coder):
        labels = self.now.labels
        for k, palette in enumerate(self.now.palettes):
            x, y = self.quad(k, 0)
            if len(palette) < 2:
                labels.inner[y : y + 8, x : x + 8] = palette[0] if palette else NO_SPHERE
                continue
            sides = self.sides(k, palette)
            for n in range(4):
                x, y = self.quad(k, n)
                if not self.asked(x, y, 4):
                    labels.inner[y : y + 4, x : x + 4] = labels.at(x - 1, y)
                elif coder.bit(self.models.split[self.split_context(k, n, palette, sides)]):
                    self.read_quad_labels(coder, k, n, palette, sides)
                else:
                    labels.inner[y : y + 4, x : x + 4] = self.read_whole(coder, k, n, palette)

    def asked(self, x, y, size):
        """Does any pixel of this square have a label of its own: is it measured, or, fast, in the image?"""
        if self.fast:
            return x < self.stream.width and y < self.stream.height
        return self.now.mask.inner[y : y + size, x : x + size].any()

    def sides(self, k, palette):
        """For each entry but the last: front and close of the block's pixels, [y, x]."""
        s, sides = self.stream, []
        x, y = self.quad(k, 0)
        here = np.s_[y : y + 8, x : x + 8]
        u, v = s.u[None, x : x + 8], s.v[y : y + 8, None]
        for pair in zip(palette, palette[1:]):
            if NO_SPHERE in pair:
                sides.append((np.zeros((8, 8), dtype=bool),) * 2)
                continue
            entries = [self.now.entries[label] for label in pair]
            a, b = (s.per_metre / inverse_depth(entry, u, v, s.q[here]) for entry in entries)
            close = np.abs(a - b) <= np.maximum(s.reach_floor, s.reach_growth * a * a)
            sides.append((a < b, close))
        return sides

    @staticmethod
    def kind(palette, entry, label):
        """The class of a label."""
        return 0 if label == palette[entry] else 1 if label in palette[entry + 1 :] else 2

    def split_context(self, k, n, palette, sides):
        at = self.now.labels.at
        x, y = self.quad(k, n)
        w, nn = at(x - 1, y), at(x, y - 1)
        west = all(at(x - 1, y + i) == w for i in range(4))
        north = all(at(x + i, y - 1) == nn for i in range(4))
        if west and north:
            agree = 1 if w != nn else 0 if w in palette else 4
        else:
            agree = 2 if west or north else 3
        past = 2
        if self.past:
            past = int(len(set(self.in_past(self.past.labels, k, x, y, 4, 4))) > 1)
        here = np.s_[y % 8 : y % 8 + 4, x % 8 : x % 8 + 4]
        front, close = (0, 0) if self.fast else (int(plane[here].sum()) for plane in sides[0])
        near = {0: 0, 16: 2}.get(close, 1)
        return (((agree * 3 + past) * 2 + (0 < front < 16)) * 3 + near) * 3 + len(palette) - 2

    def read_whole(self, coder, k, n, palette):
        at = self.now.labels.at
        x, y = self.quad(k, n)
        east = x + 3 if n == 3 else x + 4
        around = [at(x - 1, y + 1), at(x + 1, y - 1), at(x - 1, y - 1), at(east, y - 1)]
        past = self.past and self.in_past(self.past.labels, k, x + 1, y + 1, 1, 1)
        around += past or [NO_SPHERE]
        entry = 0
        while entry < len(palette) - 1:
            c = 0
            for label in around:
                c = 3 * c + self.kind(palette, entry, label)
            if coder.bit(self.models.whole[entry * 243 + c]):
                break
            entry += 1
        return palette[entry]

    def read_quad_labels(self, coder, k, n, palette, sides):
        x, y = self.quad(k, n)
        for y in range(y, y + 4):
            for i in range(4):
                if not self.asked(x + i, y, 1):
                    self.now.labels.set(x + i, y, self.now.labels.at(x + i - 1, y))
                else:
                    self.read_label(coder, k, n, palette, sides, x + i, y)

    def read_label(self, coder, k, n, palette, sides, x, y):
        labels, models = self.now.labels, self.models
        up = labels.at(x, y - 1)
        no_east = x % 4 == 3 and (y % 4 != 0 or n == 3)
        near = [labels.at(x - 1, y), up, labels.at(x - 1, y - 1)]
        near.append(up if no_east else labels.at(x + 1, y - 1))
        past = None
        if self.past:
            (here, east), (south, _) = np.reshape(
                self.in_past(self.past.labels, k, x, y, 2, 2), (2, 2)
            ).tolist()
            past = here, east, south
        entry = 0
        while entry < len(palette) - 1:
            w, north, nw, ne = (self.kind(palette, entry, label) for label in near)
            p = (2, 2, 2)
            if past:
                p = tuple(self.kind(palette, entry, label) for label in past)
            front, close = sides[entry]
            side = front[y % 8, x % 8]
            cross_w = 2 if x % 8 == 0 else int(side != front[y % 8, x % 8 - 1])
            cross_n = 2 if y % 8 == 0 else int(side != front[y % 8 - 1, x % 8])
            cells = (
                (entry, w, north, nw, ne, p[0]),
                (entry, cross_w, cross_n, bool(side), bool(close[y % 8, x % 8]), w, north),
                (entry, *p, w, north),
            )
            estimates = [m.at(c) for m, c in zip(models.label, cells)]
            if self.mixed_bit(coder, estimates, models.label_weights.at(entry, w, north)):
                break
            entry += 1
        labels.set(x, y, palette[entry])

    # prediction

    def predict(self):
        s = self.stream
        labels = self.now.labels.inner
        self.depth = np.zeros(labels.shape, dtype=F32)  # d of §1.6
        u, v = s.u[None, :], s.v[:, None]
        for number, entry in enumerate(self.now.entries):
            if entry is None:
                continue
            depth = s.per_metre / inverse_depth(entry, u, v, s.q)
            self.depth = np.where(labels == number, depth, self.depth)
        assert self.depth.dtype == F32
        whole = np.nan_to_num(self.depth + F32(0.5), nan=0.0, posinf=65535.0, neginf=0.0)
        self.whole = np.clip(whole, 0, 65535).astype(np.int64)

    # residual

    def read_residual(self, coder):
        self.read_integers(coder)
        self.read_kinds(coder)
        s, now = self.stream, self.now
        bins = Bins(s, self.now.integers)
        self.rebuilt = np.zeros(s.q.shape, dtype=bool)
        self.integers = Plane(s, 0)
        self.integers.inner[:] = np.where(now.mask.inner != 0, self.whole, 0)
        self.traces = {}
        last = 0
        for x, y, block in self.read_places(coder) if self.fast else self.raster_places(coder):
            sphere = now.labels.at(x, y) != NO_SPHERE
            dense = now.kinds[block] == DENSE
            last = self.read_bin(coder, bins.at(x, y), x, y, last, sphere, dense)
            self.integers.set(x, y, last)
            self.rebuilt[y, x] = True
        self.whole = self.integers.inner

    def raster_places(self, coder):
        """Pixels that come back from bins, (x, y, block), in raster order."""
        now = self.now
        for x, y, block in self.raster([kind != SMOOTH for kind in now.kinds]):
            if not now.mask.at(x, y):
                continue
            sphere = now.labels.at(x, y) != NO_SPHERE
            if not sphere or now.kinds[block] == DENSE or self.misses(coder, x, y):
                yield x, y, block

    def read_places(self, coder):
        """The same of a fast frame, block by block."""
        s, now = self.stream, self.now
        for block, kind in enumerate(now.kinds):
            if kind == SMOOTH:
                continue
            x0, y0 = self.quad(block, 0)
            square = ((x0 + i, y0 + j) for j in range(8) for i in range(8))
            left = [(x, y) for x, y in square if x < s.width and y < s.height and now.mask.at(x, y)]
            if kind == SPARSE:
                known = [place for place in left if now.labels.at(*place) != NO_SPHERE]
                left = set(left) - set(known)
                for still in range(min(self.models.misses.read(coder), len(known)), 0, -1):
                    skipped = coder.uniform(len(known) - still + 1)
                    left.add(known[skipped])
                    known = known[skipped + 1 :]
                left = sorted(left, key=lambda place: place[::-1])
            for x, y in left:
                yield x, y, block

    def read_plain_residual(self, section):
        s, now = self.stream, self.now
        if len(section) < 4:
            raise Refused("plain")
        (length,) = struct.unpack("<I", section[:4])
        if len(section) - 4 < length:
            raise Refused("plain")
        kinds, depths = Range(section[4 : 4 + length]), section[4 + length :]
        now.integers = self.past.integers if self.past else None
        self.read_kinds(kinds)
        kinds.end()
        wanted = [(x, y) for x, y, _ in self.raster([kind != SMOOTH for kind in now.kinds]) if now.mask.at(x, y)]
        if len(depths) != 2 * len(wanted):
            raise Refused("plain")
        self.rebuilt = np.zeros(s.q.shape, dtype=bool)
        integers = np.where(now.mask.inner != 0, self.whole, 0)
        for (x, y), integer in zip(wanted, np.frombuffer(depths, "<u2")):
            integers[y, x] = integer
            self.rebuilt[y, x] = True
        self.whole = integers

    def read_integers(self, coder):
        models, now = self.models, self.now
        if self.past is None:
            now.integers = set() if coder.bit(models.listed) else None
        else:
            now.integers = self.past.integers
        if now.integers is None:
            return
        now.integers = set(now.integers)
        last = 0
        for _ in range(models.count.read(coder)):
            last += models.gap.read(coder) + 1
            if last > 65535:
                raise Refused("an integer beyond 65535")
            now.integers.add(last)

    def read_kinds(self, coder):
        now, past, models = self.now, self.past, self.models
        for k in range(self.stream.blocks):
            if now.fills[k] == EMPTY:
                continue
            west, north = self.neighbour(k, -1, 0), self.neighbour(k, 0, -1)
            west = now.kinds[west] if west is not None else SMOOTH
            north = now.kinds[north] if north is not None else SMOOTH
            if NO_SPHERE not in now.palettes[k]:
                c = 3 * ((west != SMOOTH) + (north != SMOOTH))
                if not coder.bit(models.active[c + (past.kinds[k] != SMOOTH if past else 2)]):
                    continue
            c = (west * 3 + north) * 3 + (past.kinds[k] if past else 0)
            now.kinds[k] = DENSE if coder.bit(models.dense[c]) else SPARSE

    def trace(self, x, y):
        return self.traces.get((x, y), (0, 0, False))

    def north_east(self, x, y):
        """The place of NE; fast, none, which reads as unmeasured, where it lies in a later block."""
        later = self.fast and x % 8 == 7 and y % 8 > 0
        return (-3, -3) if later else (x + 1, y - 1)

    def misses(self, coder, x, y):
        c = 0
        for dx, dy in [(-1, 0), (0, -1), (1, -1), (-1, -1)]:
            off, _, coded = self.trace(x + dx, y + dy)
            c = 3 * c + (0 if not coded else 1 if abs(off) <= 1 else 2)
        return coder.bit(self.models.miss[c])

    def read_bin(self, coder, table, x, y, last, sphere, dense):
        """Steps 2 to 7: the rebuilt integer."""
        models = self.models
        r = self.integers.at
        w = r(x - 1, y) or r(x, y - 1) or last
        n = r(x, y - 1) or w
        places = w, n, r(x - 1, y - 1) or n, r(*self.north_east(x, y)) or n, r(x - 2, y) or w, r(x, y - 2) or n
        w, n, nw, ne, ww, nn = map(table.bin, places)
        low, high = min(w, n), max(w, n)
        median = low if nw >= high else high if nw <= low else w + n - nw
        around = [self.trace(x + dx, y + dy) for dx, dy in [(-1, 0), (0, -1), (-1, -1)]]
        around.append(self.trace(*self.north_east(x, y)))
        d = self.depth[y, x]
        sphere = sphere and 0 < d < 65536
        part, shifted, guess = 0, median, median
        own = None
        if sphere:
            own = table.bin(int(self.whole[y, x]))
            part = table.part(own, d)
            off = [t[0] for t in around]
            shifted = own + ((3 * (off[0] + off[1]) + off[2] + off[3] + 4) >> 3)
            guess = (median + shifted + (median > shifted)) >> 1
        error = [t[1] for t in around]
        e = 2 * (error[0] + error[1]) + error[2] + error[3]
        activity = sum(e > limit for limit in (0, 1, 2, 4, 7, 12, 20, 36, 64, 120))
        anchor = guess if own is None else own
        cells = (
            (nine(n - guess), nine(nn - n), nine(ne - n), five(w - guess)),
            (nine(w - guess), nine(ww - w), nine(nw - n), five(n - guess)),
            (part, nine(anchor - guess), nine(shifted - guess), activity, dense),
        )
        which = 0 if own is None else 2 if dense else 1

        def read(node):
            estimates = [c.at(cell, node) for c, cell in zip(models.bins, cells)]
            return self.mixed_bit(coder, estimates, models.bin_weights.at(activity, which, node))

        found = guess
        if not read(0):
            side = read(1)
            t = 0
            while t < 14 and read(2 + t):
                t += 1
            if t == 14:
                m = 192 + min(models.bin_far.read(coder), 1 << 17)
            else:
                m = ENDS[t - 1] + 1 if t else 1
                n = (ENDS[t] - m + 1).bit_length() - 1
                if n:
                    m += coder.bit(models.fine[t]) << (n - 1)
                    m += coder.plain(n - 1)
            found = guess - m if side else guess + m
        found = min(max(found, 0), len(table.centres) - 1)
        off = 0 if own is None else min(max(found - own, -8), 8)
        self.traces[x, y] = off, min(abs(found - guess), 255), True
        if own is None:
            self.depth[y, x] = 0
        return table.centres[found]

    # output

    def output(self):
        s, d = self.stream, self.depth
        on = self.now.mask.inner != 0
        labels = self.now.labels.inner
        whole = np.maximum(self.whole, 1)
        d = np.where(labels == NO_SPHERE, F32(0), d)
        z, size = whole.astype(F32), np.abs(d)
        e = z - size
        reach = np.maximum(s.reach_floor, s.reach_growth * z * z) - F32(4e-7) * z
        own = (e * e * s.q <= reach * reach) & (reach > 0)
        if s.lossless:
            depth = (whole.astype(F64) * s.unit).astype(F32)
        else:
            stands = ~self.rebuilt & (d > 0) & (d < 65536)
            depth = np.where(stands, d * s.single, z * s.single)
            own |= stands
        depth = np.where(on, depth, F32(0))
        labels = np.where(on, np.where(own, labels, NO_SPHERE), INVALID)
        assert depth.dtype == F32
        cut = np.s_[: s.height, : s.width]
        return depth[cut].astype("<f4"), labels[cut].astype("<u2")


def main(arguments):
    if len(arguments) not in (1, 2):
        sys.exit(__doc__)
    with open(arguments[0], "rb") as file:
        data = file.read()
    planes = open(arguments[1], "wb") if len(arguments) == 2 else None
    decoder, at, number = Decoder(), 0, 0
    with np.errstate(all="ignore"):
        while at < len(data):
            (length,) = struct.unpack_from("<I", data, at)
            depth, labels = decoder.decode(data[at + 4 : at + 4 + length])
            at += 4 + length
            print(number, *(f"{zlib.crc32(p.tobytes()):08x}" for p in (depth, labels)))
            if planes:
                planes.write(depth.tobytes() + labels.tobytes())
            number += 1
    if planes:
        planes.close()


if __name__ == "__main__":
    main(sys.argv[1:])
