"""Hand-written C baselines: compiled in the run that uses them, with the compiler that the product uses."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from tests.reference.jeffcott import Jeffcott
from tests.reference.rotor import Rotor

HERE = Path(__file__).resolve().parent
PLAIN = ("-std=gnu99", "-O3")
SAME = (*PLAIN, "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")  # the flags of the product

Runner = Callable[[], np.ndarray]


def compiler() -> str:
    """Return the command of the C compiler, the first that the product would take."""
    for name in ("cc", "gcc", "clang"):
        found = shutil.which(name)
        if found:
            return found
    raise SystemExit("benchmarks need a C compiler: cc, gcc or clang")


@cache
def library(name: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Compile a baseline and load it."""
    folder = Path(tempfile.mkdtemp(prefix="baseline-"))
    target = folder / f"{name}.so"
    command = [compiler(), *flags, "-fPIC", "-shared", "-o", str(target), str(HERE / f"{name}.c"), "-lm"]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(target))
    shutil.rmtree(folder, ignore_errors=True)
    return loaded


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def jeffcott(steps: int, step: float, by_hand: bool = False, flags: tuple[str, ...] = PLAIN) -> Runner:
    """Return a function that runs the Jeffcott rotor in C and returns rows (steps + 1, 4)."""
    d = Jeffcott()
    values = (ctypes.c_double * 13)(
        d.mass,
        d.stiffness,
        d.damping,
        d.crack_stiffness,
        d.sag,
        d.eccentricity,
        d.phase,
        d.force_displacement,
        d.force_current,
        d.kp,
        d.ki,
        d.kd,
        d.speed,
    )
    run = library("jeffcott_by_hand" if by_hand else "jeffcott", flags).run
    run.restype = None

    def action() -> np.ndarray:
        rows = np.empty((steps + 1, 4))
        run(values, ctypes.c_int64(steps), ctypes.c_double(step), _pointer(rows))
        return rows

    return action


class _Beam(ctypes.Structure):
    _fields_ = [
        *[(name, ctypes.c_void_p) for name in ("MK", "MC", "g", "factor")],
        *[(name, ctypes.c_int64) for name in ("amb", "crack", "tilt")],
        *[(n, ctypes.c_double) for n in ("crack_stiffness", "sag", "unbalance", "phase", "ks", "ki", "KP", "KI", "KD")],
        ("speed", ctypes.c_double),
        ("where", ctypes.c_void_p),
    ]


def fe_rigid(
    rotor: Rotor, steps: int, step: float, every: int = 1, banded: bool = False, flags: tuple[str, ...] = PLAIN
) -> Runner:
    """Return a function that runs a pinned FE rotor in C: rows (steps // every + 1, 2 nodes + 2)."""
    n = rotor.size
    nodes = n // 2 + 1
    tilt = int(np.argmax(np.diag(rotor.gyroscopic)))
    inverse = np.linalg.inv(rotor.mass)
    if banded:
        k, c = _bands(rotor.stiffness), _bands(rotor.damping)
        lower = np.linalg.cholesky(rotor.mass)
        factor = np.zeros((n, 4))
        for i in range(n):
            for j in range(max(0, i - 3), i):
                factor[i, j - i + 3] = lower[i, j]
            factor[i, 3] = 1 / lower[i, i]
        g = np.array([rotor.gyroscopic[tilt, tilt]])
    else:
        k = np.asfortranarray(inverse @ rotor.stiffness).T.copy()
        c = np.asfortranarray(inverse @ rotor.damping).T.copy()
        g = inverse[:, tilt] * rotor.gyroscopic[tilt, tilt]
        factor = inverse.T.copy()
    where = np.full(nodes, -1, dtype=np.int64)
    where[1:-1] = rotor.translations
    _, mass, eccentricity, phase = rotor.discs[0]
    data = _Beam(
        *[a.ctypes.data for a in (k, c, g, factor)],
        rotor.amb,
        rotor.crack,
        tilt,
        rotor.crack_stiffness,
        rotor.sag,
        mass * eccentricity * rotor.speed**2,
        phase,
        rotor.force_displacement,
        rotor.force_current,
        rotor.kp,
        rotor.ki,
        rotor.kd,
        rotor.speed,
        where.ctypes.data,
    )
    run = library("fe_rigid", (*flags, f"-DN={n}", *(["-DBANDED"] if banded else []))).run
    run.restype = None
    keep = (k, c, g, factor, where)

    def action() -> np.ndarray:
        rows = np.empty((steps // every + 1, 2 * nodes + 2))
        assert keep
        run(ctypes.byref(data), *map(ctypes.c_int64, (steps, every)), ctypes.c_double(step), _pointer(rows))
        return rows

    return action


def _bands(matrix: np.ndarray) -> np.ndarray:
    n = len(matrix)
    bands = np.zeros((n, 7))
    for i in range(n):
        for j in range(max(0, i - 3), min(n, i + 4)):
            bands[i, j - i + 3] = matrix[i, j]
    return bands
