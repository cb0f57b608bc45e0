#!/usr/bin/env python3
"""A second decoder of saint-live's sensor payload, version 1, written from src/codec/FORMAT.md.

    reference_decoder.py CHAIN [PLANES]

CHAIN holds payloads one after the other, each after its length (u32, little endian). PLANES
receives, frame by frame, depth (float32) and labels (uint16), row-major, little endian. One line
per frame goes to standard output: frame, CRC-32 of depth, CRC-32 of labels. Slow and plain on
purpose. Section numbers are those of FORMAT.md. Needs Python 3.8 and NumPy.
"""

import struct
import sys
import zlib

import numpy as np

F32, F64 = np.float32, np.float64
NO_SPHERE, INVALID = 65534, 65535
KEY, LOSSLESS, DEGRADED, MOVED = 1, 2, 4, 8
EMPTY, FULL, MIXED = 0, 1, 2
MOST = 1 << 21  # §1.6, clamp of a sphere's numbers


class Refused(Exception):
    """Bytes that are no payload."""


# --- §1.4 entropy coding -------------------------------------------------------------------------


class Bit:
    __slots__ = ("fast", "slow", "seen")

    def __init__(self):
        self.fast = self.slow = 32768
        self.seen = 0

    def probability(self):
        return min(max((self.fast + self.slow) >> 1, 48), 65488)

    def learn(self, bit):
        f, s = min(5, self.seen + 1), min(7, self.seen + 1)
        self.seen = min(7, self.seen + 1)
        if bit:
            self.fast += (65535 - self.fast) >> f
            self.slow += (65535 - self.slow) >> s
        else:
            self.fast -= self.fast >> f
            self.slow -= self.slow >> s


def bits(count):
    return [Bit() for _ in range(count)]


class Range:
    """The range decoder of one section."""

    def __init__(self, data):
        self.data, self.at = data, 0
        self.code, self.range = 0, 0xFFFFFFFF
        for _ in range(4):
            self.code = self.code << 8 | self.next()

    def next(self):
        byte = self.data[self.at] if self.at < len(self.data) else 0
        self.at += 1
        return byte

    def renormalise(self):
        while self.range < 1 << 24:
            self.range = self.range << 8 & 0xFFFFFFFF
            self.code = (self.code << 8 | self.next()) & 0xFFFFFFFF

    def bit(self, model):
        bound = (self.range >> 16) * model.probability()
        bit = self.code < bound
        if bit:
            self.range = bound
        else:
            self.code -= bound
            self.range -= bound
        model.learn(bit)
        self.renormalise()
        return bit

    def plain(self, count):
        value = 0
        for _ in range(count):
            self.range >>= 1
            one = self.code >= self.range
            if one:
                self.code -= self.range
            value = value << 1 | one
            self.renormalise()
        return value

    def end(self):
        if self.at > len(self.data) + 8:
            raise Refused("a section ends early")


class Integer:
    def __init__(self):
        self.length = bits(25)
        self.leading = [bits(4) for _ in range(25)]

    def read(self, coder):
        n = 0
        while n < 23 and coder.bit(self.length[n]):
            n += 1
        v, node = 1, 0
        for k in range(n):
            if k < 2:
                bit = coder.bit(self.leading[n][node])
                node = 1 + bit
            else:
                bit = coder.plain(1)
            v = 2 * v + bit
        return v - 1

    def signed(self, coder):
        return unfold(self.read(coder))


def unfold(n):
    return (n >> 1) ^ -(n & 1)


class Models:
    """Start values of all models."""

    def __init__(self):
        self.full, self.empty, self.mask_pixel = bits(36), bits(36), bits(1024)
        self.more = [bits(16) for _ in range(3)]
        self.candidate = [[bits(8) for _ in range(2)] for _ in range(8)]
        self.none, self.new = bits(2), bits(2)
        self.label = [bits(243) for _ in range(3)]
        self.keep, self.far, self.plane = bits(3)
        self.step, self.step_change = Integer(), Integer()
        self.fresh = [Integer() for _ in range(4)]
        self.change = [Integer() for _ in range(4)]
        self.block, self.zero, self.sign = bits(9), bits(64), bits(9)
        self.size = [Integer() for _ in range(6)]


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
    """A padded image that can be read two pixels beyond its edge."""

    def __init__(self, stream, value):
        shape = (8 * stream.rows + 4, 8 * stream.columns + 4)
        self.cells = np.full(shape, value, dtype=np.int64)
        self.inner = self.cells[2:-2, 2:-2]

    def at(self, x, y):
        return int(self.cells[y + 2, x + 2])

    def set(self, x, y, value):
        self.cells[y + 2, x + 2] = value


class Picture:
    """What one frame leaves to the next (§1.7)."""

    def __init__(self, stream):
        self.mask = Plane(stream, 0)
        self.labels = Plane(stream, NO_SPHERE)
        self.fills = [EMPTY] * stream.blocks
        self.palettes = [[] for _ in range(stream.blocks)]
        self.active = [False] * stream.blocks
        self.entries = []


class Entry:
    def __init__(self, a, m, far, exponent):
        self.a, self.m, self.far, self.exponent = F32(a), [F32(c) for c in m], far, exponent


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
        if fields.take(2) != b"SL" or fields.take(1) != b"\x01":
            raise Refused("magic or version")
        (flags,) = fields.take(1)
        if flags & ~(KEY | LOSSLESS | DEGRADED | MOVED):
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
        frame = Frame(self.stream, self.models, self.past, motion)
        planes = frame.read(sections)
        self.past, self.last_sequence = frame.now, sequence
        return planes


# --- §1.6 sections -------------------------------------------------------------------------------


class Frame:
    def __init__(self, stream, models, past, motion):
        self.stream, self.models, self.past = stream, models, past
        self.now = Picture(stream)
        before = past.entries if past else []
        self.taken = [entry is not None for entry in before]
        self.before = before if not any(motion) else [move(entry, motion) for entry in before]
        self.next = self.given = 0

    def read(self, sections):
        coders = [Range(section) for section in sections]
        self.read_mask(coders[0])
        coders[0].end()
        self.read_palettes(coders[1])
        self.read_labels(coders[1])
        coders[1].end()
        self.read_spheres(coders[2])
        coders[2].end()
        self.predict()
        self.read_residual(coders[3])
        coders[3].end()
        return self.output()

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

    # mask

    def read_mask(self, coder):
        s, now, past = self.stream, self.now, self.past
        for k in range(s.blocks):
            west, north = self.neighbour(k, -1, 0), self.neighbour(k, 0, -1)
            c = (now.fills[west] if west is not None else EMPTY) * 3
            c = (c + (now.fills[north] if north is not None else EMPTY)) * 4
            c += past.fills[k] if past else 3
            if coder.bit(self.models.full[c]):
                now.fills[k] = FULL
                x, y = 8 * (k % s.columns), 8 * (k // s.columns)
                now.mask.inner[y : min(y + 8, s.height), x : min(x + 8, s.width)] = 1
            else:
                now.fills[k] = EMPTY if coder.bit(self.models.empty[c]) else MIXED
        near = [(-1, 0), (-2, 0), (-1, -1), (0, -1), (1, -1), (0, -2)]
        for x, y, _ in self.raster([fill == MIXED for fill in now.fills]):
            c = 0
            for dx, dy in near:
                c = 2 * c + now.mask.at(x + dx, y + dy)
            if past:
                m = past.mask
                c = 16 * c + 4 * m.at(x, y) + 2 * m.at(x + 1, y) + m.at(x, y + 1)
            else:
                c = 16 * c + 8
            now.mask.set(x, y, coder.bit(self.models.mask_pixel[c]))

    # labels

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
            n = 1
            while n < 4 and coder.bit(models.more[n - 1][c]):
                n += 1
            left = self.candidates(k)
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

    def read_labels(self, coder):
        s, now, past = self.stream, self.now, self.past
        for k, palette in enumerate(now.palettes):
            if len(palette) < 2:
                x, y = 8 * (k % s.columns), 8 * (k // s.columns)
                now.labels.inner[y : y + 8, x : x + 8] = palette[0] if palette else NO_SPHERE
        near = [(-1, 0), (0, -1), (-1, -1), (1, -1)]
        for x, y, k in self.raster([len(p) > 1 for p in now.palettes], padded=True):
            if not now.mask.at(x, y):
                now.labels.set(x, y, now.labels.at(x - 1, y))
                continue
            palette = now.palettes[k]
            around = [now.labels.at(x + dx, y + dy) for dx, dy in near]
            around.append(past.labels.at(x, y) if past else NO_SPHERE)
            entry = 0
            while entry < len(palette) - 1:
                c = 0
                for label in around:
                    later = label in palette[entry + 1 :]
                    c = 3 * c + (0 if label == palette[entry] else 1 if later else 2)
                if coder.bit(self.models.label[entry][c]):
                    break
                entry += 1
            now.labels.set(x, y, palette[entry])

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
            before = self.before[number] if number < len(self.before) else None
            if before and coder.bit(models.keep):
                self.now.entries[number] = before
                continue
            guide = before or last
            if guide:
                exponent = guide.exponent + models.step_change.signed(coder)
            else:
                exponent = models.step.read(coder) - 30
            exponent = min(max(exponent, -30), 10)
            chart = Chart(s, supports[number], F64(2.0) ** exponent)
            far = bool(coder.bit(models.far))
            plane = coder.bit(models.plane)
            n = [0, 0, 0, 0]
            if before:
                guess = chart.quantise(before)
                for k in range(3 if plane else 4):
                    n[k] = clamp(guess[k] + models.change[k].signed(coder))
            else:
                guess = chart.quantise(last)[0] if last else 0
                n[0] = clamp(guess + models.fresh[0].signed(coder))
                for k in range(1, 3 if plane else 4):
                    n[k] = models.fresh[k].signed(coder)
            last = Entry(*chart.restore(n), far, exponent)
            self.now.entries[number] = last

    # prediction

    def predict(self):
        s = self.stream
        labels = self.now.labels.inner
        self.depth = np.zeros(labels.shape, dtype=F32)  # d of §1.6
        u, v = s.u[None, :], s.v[:, None]
        for number, entry in enumerate(self.now.entries):
            if entry is None:
                continue
            m = entry.m
            l = m[0] * u + m[1] * v + m[2]
            root = np.sqrt(l * l + (F32(4) * entry.a) * s.q)
            w = F32(0.5) * (l - root if entry.far else l + root)
            self.depth = np.where(labels == number, s.per_metre / w, self.depth)
        assert self.depth.dtype == F32
        whole = np.nan_to_num(self.depth + F32(0.5), nan=0.0, posinf=65535.0, neginf=0.0)
        self.whole = np.clip(whole, 0, 65535).astype(np.int64)

    # residual

    def read_residual(self, coder):
        s, now, past, models = self.stream, self.now, self.past, self.models
        for k in range(s.blocks):
            if now.fills[k] == EMPTY:
                continue
            west, north = self.neighbour(k, -1, 0), self.neighbour(k, 0, -1)
            c = (west is not None and now.active[west]) + (north is not None and now.active[north])
            c = 3 * c + (past.active[k] if past else 2)
            now.active[k] = bool(coder.bit(models.block[c]))
        walked = [a or NO_SPHERE in p for a, p in zip(now.active, now.palettes)]
        ks = Plane(s, 0)
        step = F32(2) * F32(0.999) * s.reach_floor / np.sqrt(s.q)
        step = np.maximum(1, np.minimum(step.astype(F64), 2**31 - 1).astype(np.int64))
        if s.lossless:
            step[:] = 1
        self.rebuilt = np.zeros(s.q.shape, dtype=bool)
        last = 0
        for x, y, block in self.raster(walked):
            if not now.mask.at(x, y):
                continue
            k = self.read_k(coder, ks, x, y) if now.active[block] else 0
            ks.set(x, y, k)
            no_sphere = now.labels.at(x, y) == NO_SPHERE
            if k == 0 and not no_sphere:
                continue
            base = int(self.whole[y, x])
            if no_sphere:
                base = last
                for dx, dy in [(-1, 0), (0, -1), (1, -1)]:
                    if now.mask.at(x + dx, y + dy):
                        base = int(self.whole[y + dy, x + dx])
                        break
            back = min(max(base + k * int(step[y, x]), 1), 65535)
            self.whole[y, x] = back
            self.rebuilt[y, x] = True
            if no_sphere:
                last = back

    def read_k(self, coder, ks, x, y):
        models = self.models
        w, n = ks.at(x - 1, y), ks.at(x, y - 1)
        nw, ne = ks.at(x - 1, y - 1), ks.at(x + 1, y - 1)
        around = 2 * (abs(w) + abs(n)) + abs(nw) + abs(ne)
        level = min(around.bit_length(), 5)
        if coder.bit(models.zero[8 * level + 4 * (w != 0) + 2 * (n != 0) + (ne != 0)]):
            return 0
        negative = coder.bit(models.sign[3 * (sign(w) + 1) + sign(n) + 1])
        size = min(models.size[level].read(coder), (1 << 17) - 1) + 1
        return -size if negative else size

    # output

    def output(self):
        s, d = self.stream, self.depth
        on = self.now.mask.inner != 0
        labels = self.now.labels.inner
        if s.lossless:
            depth = (self.whole.astype(F64) * s.unit).astype(F32)
            z = self.whole.astype(F32)
            e = z - d
            reach = np.maximum(s.reach_floor, s.reach_growth * z * z) - F32(4e-7) * z
            own = (e * e * s.q <= reach * reach) & (reach > 0)
        else:
            own = ~self.rebuilt & (d > 0) & (d < 65536)
            whole = np.maximum(self.whole, 1).astype(F32) * s.single
            depth = np.where(own, d * s.single, whole)
        depth = np.where(on, depth, F32(0))
        labels = np.where(on, np.where(own, labels, NO_SPHERE), INVALID)
        assert depth.dtype == F32
        cut = np.s_[: s.height, : s.width]
        return depth[cut].astype("<f4"), labels[cut].astype("<u2")


def sign(n):
    return (n > 0) - (n < 0)


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


# --- §1.7 motion ---------------------------------------------------------------------------------


def move(entry, motion):
    if entry is None:
        return None
    x, y, z = (F64(n) / 65536.0 for n in motion[:3])
    t = [F64(n) / 16384.0 for n in motion[3:]]
    n = 1.0 + x * x + y * y + z * z
    r = [
        [1.0 + x * x - y * y - z * z, 2.0 * (x * y - z), 2.0 * (x * z + y)],
        [2.0 * (x * y + z), 1.0 - x * x + y * y - z * z, 2.0 * (y * z - x)],
        [2.0 * (x * z - y), 2.0 * (y * z + x), 1.0 - x * x - y * y + z * z],
    ]
    r = [[value / n for value in row] for row in r]
    a, m = F64(entry.a), [F64(c) for c in entry.m]
    turned = [row[0] * m[0] + row[1] * m[1] + row[2] * m[2] for row in r]
    tt = t[0] * t[0] + t[1] * t[1] + t[2] * t[2]
    d = 1.0 - a * tt + (turned[0] * t[0] + turned[1] * t[1] + turned[2] * t[2])
    if abs(d) < 1e-6:
        return None
    moved = Entry(a / d, [(turned[k] - 2.0 * a * t[k]) / d for k in range(3)], entry.far, 0)
    moved.exponent = entry.exponent
    return moved if np.isfinite([moved.a, *moved.m]).all() else None


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
