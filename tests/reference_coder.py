"""Entropy coding of saint-live's sensor payload (src/codec/FORMAT.md §1.4), for
reference_decoder.py: range decoder, models, integers and mixed bits, plain and slow on purpose."""


class Refused(Exception):
    """Bytes that are no payload."""


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
        bit = self.chance(model.probability())
        model.learn(bit)
        return bit

    def chance(self, probability):
        bound = (self.range >> 16) * probability
        bit = self.code < bound
        if bit:
            self.range = bound
        else:
            self.code -= bound
            self.range -= bound
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

    def uniform(self, total):
        self.range //= total
        value = min(self.code // self.range, total - 1)
        self.code -= self.range * value
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


# --- mixed bits ----------------------------------------------------------------------------------

LOGISTIC = [22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743]
LOGISTIC += [32768, 40793, 47911, 53581, 57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269]
LOGISTIC += [65374, 65438, 65476, 65500, 65514]


def squash(x):
    i, f = (x >> 7) + 16, x & 127
    return (LOGISTIC[i] * (128 - f) + LOGISTIC[i + 1] * f + 64) >> 7


def inverse_of_squash():
    table, x = [], -2047
    for p in range(4096):
        while x < 2047 and squash(x) >> 4 < p:
            x += 1
        table.append(x)
    return table


STRETCH = inverse_of_squash()


class Contexts:
    """Estimates of one context of mixed bits: a probability and a count each."""

    def __init__(self):
        self.cells = {}

    def at(self, *cell):
        return self.cells.setdefault(cell, [32768, 0])


class Weights:
    def __init__(self):
        self.sets = {}

    def at(self, *cell):
        return self.sets.setdefault(cell, [9830, 9830, 9830, 0])


def mixed_bit(coder, estimates, weights):
    lanes = [STRETCH[e[0] >> 4] for e in estimates] + [64]
    x = sum(s * w for s, w in zip(lanes, weights)) >> 14
    p = min(max(squash(min(max(x, -2047), 2047)), 48), 65488)
    bit = coder.chance(p)
    error = (65536 * bit - p) >> 4
    for k, s in enumerate(lanes):
        weights[k] = min(max(weights[k] + ((s * error + 4096) >> 13), -131072), 131072)
    for e in estimates:
        learn(e, bit)
    return bit


def single_bit(coder, estimate):
    bit = coder.chance(min(max(estimate[0], 48), 65488))
    learn(estimate, bit)
    return bit


def learn(estimate, bit):
    estimate[0] += ((65535 * bit - estimate[0]) * (327680 // (10 * estimate[1] + 16))) >> 15
    estimate[1] = min(estimate[1] + 1, 250)
