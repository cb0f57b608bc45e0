"""The SAINT loss in PyTorch, and its check.

    cargo rustc --release --lib --features capi --crate-type cdylib
    python3 examples/torch_loss.py target/release/libsaint_live.so

`saint_loss(points, spheres, owners)` is differentiable in points and spheres. Run as a program,
this file compares its gradients with finite differences: by torch.autograd.gradcheck where
PyTorch is installed, else by NumPy alone. Exit code 0 means that they agree.
"""

import ctypes
import sys

import numpy as np

PENALTIES = {"absolute": 0, "squared": 1, "huber": 2}
REASONS = ["ok", "null pointer", "too many", "bad value", "bad owner", "bad penalty", "fault"]


class Input(ctypes.Structure):
    """saint_live_loss_input of include/saint_live.h."""

    _fields_ = [
        ("points", ctypes.c_void_p),
        ("point_count", ctypes.c_size_t),
        ("spheres", ctypes.c_void_p),
        ("sphere_count", ctypes.c_size_t),
        ("owners", ctypes.c_void_p),
        ("weights", ctypes.c_void_p),
        ("penalty", ctypes.c_uint32),
        ("huber_m", ctypes.c_double),
    ]


class Library:
    """The loss as arrays: (value, gradient to points, gradient to spheres)."""

    def __init__(self, path):
        self.lib = ctypes.CDLL(path)
        self.lib.saint_live_abi_version.restype = ctypes.c_uint32
        if self.lib.saint_live_abi_version() != 1:
            raise RuntimeError(f"{path} has another interface version; build it again")
        self.lib.saint_live_loss.argtypes = [ctypes.POINTER(Input)] + [ctypes.c_void_p] * 3
        self.lib.saint_live_loss.restype = ctypes.c_int32

    def loss(self, points, spheres, owners=None, weights=None, penalty="absolute", huber_m=0.0):
        points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        spheres = np.ascontiguousarray(spheres, np.float64).reshape(-1, 4)
        if owners is not None:
            owners = np.ascontiguousarray(owners, np.uint32)  # -1 becomes "no owner"
        if weights is not None:
            weights = np.ascontiguousarray(weights, np.float64)
        for name, given in (("owners", owners), ("weights", weights)):
            if given is not None and given.shape != (len(points),):
                raise ValueError(f"{len(points)} points and {given.shape} {name}")
        pointer = lambda array: None if array is None else array.ctypes.data
        value = np.zeros(1)
        to_points, to_spheres = np.zeros_like(points), np.zeros_like(spheres)
        code = self.lib.saint_live_loss(
            Input(
                pointer(points), len(points), pointer(spheres), len(spheres),
                pointer(owners), pointer(weights), PENALTIES[penalty], huber_m,
            ),
            pointer(value), pointer(to_points), pointer(to_spheres),
        )
        if code:
            raise ValueError(f"saint_live_loss: {REASONS[code]}")
        return value[0], to_points, to_spheres


def torch_loss(library):
    """The loss as a differentiable function of torch tensors (CPU, any float type)."""
    import torch

    class SaintLoss(torch.autograd.Function):
        @staticmethod
        def forward(ctx, points, spheres, owners, penalty, huber_m):
            value, to_points, to_spheres = library.loss(
                points.detach().numpy(), spheres.detach().numpy(),
                None if owners is None else owners.numpy(), None, penalty, huber_m,
            )
            ctx.save_for_backward(
                torch.from_numpy(to_points).to(points), torch.from_numpy(to_spheres).to(spheres)
            )
            return points.new_tensor(value)

        @staticmethod
        def backward(ctx, slope):
            to_points, to_spheres = ctx.saved_tensors
            return slope * to_points, slope * to_spheres, None, None, None

    def loss(points, spheres, owners=None, penalty="absolute", huber_m=0.0):
        return SaintLoss.apply(points, spheres, owners, penalty, huber_m)

    return loss


def problem(seed):
    """Points around three spheres, none of them where the loss has a corner."""
    chance = np.random.default_rng(seed)
    spheres = np.hstack([4.0 * np.arange(3)[:, None] * [1, 0, 0], chance.uniform(0.5, 1.0, (3, 1))])
    owners = chance.integers(0, 3, 40)
    direction = chance.normal(size=(40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    off = chance.uniform(0.02, 0.3, (40, 1)) * chance.choice([-1, 1], (40, 1))
    points = spheres[owners, :3] + (spheres[owners, 3:] + off) * direction
    return points, spheres, owners


def check_numpy(library):
    worst = 0.0
    for seed in range(5):
        points, spheres, owners = problem(seed)
        for penalty in PENALTIES:
            for given in (owners, None):
                at = lambda p, s: library.loss(p, s, given, None, penalty, 0.1)
                _, to_points, to_spheres = at(points, spheres)
                for array, found in ((points, to_points), (spheres, to_spheres)):
                    for place in np.ndindex(array.shape):
                        step = np.zeros_like(array)
                        step[place] = 1e-6
                        both = [
                            at(*(q + sign * step if q is array else q for q in (points, spheres)))[0]
                            for sign in (1, -1)
                        ]
                        worst = max(worst, abs((both[0] - both[1]) / 2e-6 - found[place]))
                total = to_points.sum(0) + to_spheres[:, :3].sum(0)
                worst = max(worst, np.abs(total).max())
    print(f"NumPy: largest difference from finite differences, and of the sum of slopes from 0: {worst:.1e}")
    return worst < 1e-7


def check_torch(library):
    import torch

    loss = torch_loss(library)
    good = True
    for seed in range(5):
        points, spheres, owners = (torch.from_numpy(a) for a in problem(seed))
        points.requires_grad_()
        spheres.requires_grad_()
        for penalty in PENALTIES:
            for given in (owners, None):
                call = lambda p, s: loss(p, s, given, penalty, 0.1)
                good &= torch.autograd.gradcheck(call, (points, spheres), atol=1e-7, rtol=1e-5)
    print(f"torch {torch.__version__}: gradcheck passed for 5 seeds, 3 penalties, owners given and nearest")
    return good


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    library = Library(sys.argv[1])
    good = check_numpy(library)
    try:
        import torch  # noqa: F401
    except ImportError:
        print("PyTorch is not installed: torch.autograd.gradcheck was not run")
    else:
        good &= check_torch(library)
    sys.exit(0 if good else 1)
