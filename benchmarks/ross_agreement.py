"""Rotors of ROSS imported as diagrams: how far their eigenvalues are from those of ROSS itself.

python -m benchmarks.ross_agreement [--python PYTHON] [--out docs/ross.md]
python -m benchmarks.ross_agreement [--python PYTHON] --load FILE.toml --speeds 0,400

PYTHON: one that has ROSS (``pip install ross-rotordynamics``); it needs nothing of rotorsim, nor rotorsim of ROSS.
--load prints the eigenvalues that ROSS finds for a file, for tests.

Eigenvalues of ROSS: those of its own matrices M, C, K, G at the speed, without the axial and torsional degrees of
freedom, which nothing couples to the others where no torque acts; all of them are also found by ``rotor.run_modal``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

COUNT = 12  # modes that are compared, in ascending damped frequency
SAME = 1e-6  # of run_modal and the matrices of ROSS
SLOWEST = 1e-3  # rad/s; below it an eigenvalue does not oscillate
AXES = (2, 5)  # z and the turn about it among the six degrees of freedom of a node
SPEEDS = {"example": (0.0, 300.0, 1000.0), "compressor": (500.0, 1000.0), "compressor, not smoothed": (500.0, 1000.0)}
SPEEDS |= {"tables": (0.0, 100.0, 400.0, 800.0), "hutchinson": (400.0,)}
OTHERS = (0.0, 400.0, 800.0)
MARKER = "ross agreement"


# -- in the Python that has ROSS ---------------------------------------------------------------------------------------


def eigenvalues(rotor: Any, speed: float, count: int = COUNT) -> list[complex]:
    """Return the lateral eigenvalues [1/s] that ROSS has at a speed [rad/s], imaginary parts positive, ascending."""
    nodes, points = len(rotor.nodes), len(rotor.point_mass_elements)
    lost = {6 * k + axis for k in range(nodes) for axis in AXES} | {6 * nodes + 3 * k + AXES[0] for k in range(points)}
    keep = np.ix_(*[[k for k in range(rotor.ndof) if k not in lost]] * 2)
    M, C, K, G = (np.asarray(full)[keep] for full in (rotor.M(speed), rotor.C(speed), rotor.K(speed), rotor.G()))
    zero, one = np.zeros_like(M), np.eye(len(M))
    A = np.block([[zero, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, C + speed * G)]])
    values = np.linalg.eigvals(A)
    values = values[values.imag > SLOWEST]
    found = values[np.argsort(values.imag)][:count]
    modal = rotor.run_modal(speed, num_modes=2 * rotor.ndof, sparse=False)
    for value in found:
        decrement = -2 * np.pi * value.real / value.imag
        near = np.argmin(np.abs(modal.wn - abs(value)) + np.abs(modal.wd - value.imag))
        assert np.isclose(modal.wn[near], abs(value), rtol=SAME)
        assert np.isclose(modal.wd[near], value.imag, rtol=SAME)
        assert np.isclose(modal.log_dec[near], decrement, rtol=SAME, atol=SAME)
    return [complex(value) for value in found]


def through_points(rotor: Any) -> Any:
    """Return a rotor of ROSS whose tables are interpolated, not smoothed."""
    from scipy.interpolate import CubicSpline

    for one in rotor.bearing_elements:
        if one.frequency is not None and len(one.frequency) > 3:
            for key in (f"{kind}{a}{b}" for kind in "kc" for a in "xy" for b in "xy"):
                setattr(one, f"{key}_interpolated", CubicSpline(one.frequency, getattr(one, key)))
    return rotor


def reference(folder: Path, files: dict[str, list[float]]) -> None:
    """Save the examples of ROSS into a folder, and the eigenvalues of these and of further files beside them."""
    import ross

    made: dict[str, Callable[[], Any]] = {
        "example": ross.rotor_example,
        "compressor": ross.compressor_example,
        "compressor, not smoothed": lambda: through_points(ross.compressor_example()),
    }
    found: dict[str, Any] = {}
    for name, make in {} if files else made.items():
        rotor = make()
        rotor.save(folder / f"{name}.toml")
        found[name] = [[speed, _pairs(eigenvalues(rotor, speed))] for speed in SPEEDS[name]]
    for file, speeds in files.items():
        rotor = ross.Rotor.load(file)
        found[file] = [[speed, _pairs(eigenvalues(rotor, speed))] for speed in speeds]
    (folder / "reference.json").write_text(json.dumps({"version": ross.__version__, "rotors": found}))


def _pairs(values: list[complex]) -> list[list[float]]:
    return [[value.real, value.imag] for value in values]


# -- here --------------------------------------------------------------------------------------------------------------


def asked(python: str, folder: Path, files: dict[str, list[float]]) -> dict[str, Any]:
    """Return what the Python that has ROSS finds; files: with speeds, none for the examples of ROSS."""
    (folder / "files.json").write_text(json.dumps(files))
    command = [python, "-W", "ignore", str(Path(__file__).resolve()), "--reference", str(folder)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{python} found nothing: {done.stderr.strip().splitlines()[-1:]}")
    found: dict[str, Any] = json.loads((folder / "reference.json").read_text())
    return found


def deviation(file: Path, speed: float, expected: list[complex]) -> float:
    """Return the largest relative deviation of the eigenvalues of a file, imported, from those expected."""
    from rotorsim import load, modes
    from rotorsim.ross.to_diagram import import_ross

    document = import_ross(file).document
    mine = np.array([mode.eigenvalue for mode in modes(load(document, set={"speed": speed})).modes])
    return max(float(np.abs(mine - value).min() / abs(value)) for value in expected)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--out", type=Path, help="page whose table is replaced")
    parser.add_argument("--load", type=Path, help="a file saved by ROSS")
    parser.add_argument("--speeds", default="0", help="speeds [rad/s] for --load")
    parser.add_argument("--reference", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.reference:
        reference(given.reference, json.loads((given.reference / "files.json").read_text()))
        return
    from benchmarks.markers import expect, fill

    expect(given.out, MARKER)
    with tempfile.TemporaryDirectory(prefix="ross-") as scratch:
        folder = Path(scratch)
        if given.load:
            speeds = [float(part) for part in given.speeds.split(",")]
            found = asked(given.python, folder, {str(given.load.resolve()): speeds})
            print(json.dumps({"version": found["version"], "eigenvalues": next(iter(found["rotors"].values()))}))
            return
        text = _table(given.python, folder)
    print(text)
    if given.out:
        fill(given.out, MARKER, text)


def _table(python: str, folder: Path) -> str:
    from benchmarks.markers import table_text
    from tests.ross.rotors import DISC, PLAIN, ROTORS, stepped, tables, toml

    hutchinson = tables(stepped(shear_method_calc="hutchinson"), DISC, PLAIN)
    files = {}
    for name, elements in {**ROTORS, "hutchinson": hutchinson}.items():
        file = folder / f"{name}.toml"
        file.write_text(toml(elements))
        files[str(file)] = list(SPEEDS.get(name, OTHERS))
    examples = asked(python, folder, {})
    mine = asked(python, folder, files)
    rows = []
    for found in (examples, mine):
        for name, results in found["rotors"].items():
            file = folder / f"{name}.toml" if found is examples else Path(name)
            for speed, pairs in results:
                values = [complex(*pair) for pair in pairs]
                off = deviation(file, speed, values)
                first = abs(values[0]) / (2 * np.pi)
                rows.append([file.stem, f"{speed:.0f}", str(len(values)), f"{first:.6g}", f"{off:.0e}"])
    header = ["rotor", "speed [rad/s]", "modes", "first natural frequency of ROSS [Hz]", "largest deviation"]
    return f"Beside ROSS {examples['version']}:\n\n{table_text(header, rows)}"


if __name__ == "__main__":
    main()
