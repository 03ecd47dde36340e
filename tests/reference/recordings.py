"""Recordings of the four thesis models with known parameters, for tests and benchmarks; nothing of rotorsim.

Exact: settled harmonics from the frequency domain plus the transient from rest in the modes of the closed loop.

    runs = [jeffcott_run(Truth(), speed) for speed in LOWER["jeffcott"]]
    runs = [add_noise(run, 0.01, seed) for seed, run in enumerate(runs)]
    path = write_recording(tmp_path, runs, "nine_speeds")

theta = W t + theta0; the crack stands at theta + crack_phase, an unbalance at theta + unbalance_phase. Time is
counted from the start at rest, so the integral action (time constant 14 s) has not settled in a window at 4 s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.reference import rotor as models
from tests.reference.excitation import RPM, participation
from tests.reference.rotor import Rotor

Gains = tuple[float, float, float]  # KP [A/m], KI [A/(m s)], KD [A s/m]
Model = tuple[Rotor, dict[str, int | None]]  # the nodes: suffix of a column -> degree of freedom, None where pinned
System = tuple[np.ndarray, dict[int, np.ndarray], np.ndarray]  # matrix, forcing, readout of _response
THESIS_GAINS: Gains = (12200.0, 2000.0, 3.0)


def _speeds(first: int, last: int) -> tuple[float, ...]:
    return tuple(rpm * RPM for rpm in range(first, last + 1, 60))


# model: nine speeds [rad/s] of Tables 2-4 and 3-2, section 4.7 (lower range only) and Table 5-2
LOWER = {
    "jeffcott": _speeds(1140, 1620),
    "offset_disc": _speeds(900, 1380),
    "fe_rigid": _speeds(900, 1380),
    "fe_flexible": _speeds(1560, 2040),
}
UPPER = {"jeffcott": _speeds(5520, 6000), "offset_disc": _speeds(5580, 6060), "fe_flexible": _speeds(6240, 6720)}

_CRACK_AND_AMB = ("crack_stiffness", "crack_phase", "force_displacement_factor", "force_current_factor")
_ONE_DISC = ("eccentricity", "unbalance_phase")
_TWO_DISCS = ("eccentricity1", "unbalance_phase1", "eccentricity2", "unbalance_phase2")
_DAMPING = ("rotor.mass_damping", "rotor.stiffness_damping")
_SUPPORTS = tuple(f"support_{s}.{q}[{k}]" for s in ("left", "right") for q in ("stiffness", "damping") for k in (1, 2))
PARAMETERS = {
    "jeffcott": ("viscous_damping", *_CRACK_AND_AMB, *_ONE_DISC),
    "offset_disc": ("viscous_damping", *_CRACK_AND_AMB, *_ONE_DISC),
    "fe_rigid": (*_CRACK_AND_AMB, *_ONE_DISC, *_DAMPING),
    "fe_flexible": (*_CRACK_AND_AMB, *_TWO_DISCS, *_DAMPING, *_SUPPORTS),
}


@dataclass(frozen=True)
class Truth:
    """The true parameters, SI and rad, with the values of the shipped diagrams; each model uses its `PARAMETERS`.

    `truth["support_left.stiffness[1]"]` gives a value by the product's name, `truth.changed({name: value})` another
    truth. Pairs are [x, y]. parts: beams that make up each element of the model with rigid supports.
    """

    viscous_damping: float = 76.0
    crack_stiffness: float = 3e5
    crack_phase: float = 0.0
    force_displacement_factor: float = 105210.0
    force_current_factor: float = 42.1
    eccentricity: float = 24e-6
    unbalance_phase: float = float(np.radians(30.0))
    eccentricity1: float = 24e-6
    unbalance_phase1: float = float(np.radians(15.0))
    eccentricity2: float = 58e-6
    unbalance_phase2: float = float(np.radians(45.0))
    mass_damping: float = 0.154
    stiffness_damping: float = 1e-5
    disc_damping: float = 0.0
    parts: int = 1
    support_left_stiffness: tuple[float, float] = (495.82e6, 950.13e6)
    support_left_damping: tuple[float, float] = (500.0, 500.0)
    support_right_stiffness: tuple[float, float] = (355.82e6, 805.82e6)
    support_right_damping: tuple[float, float] = (500.0, 500.0)

    def __getitem__(self, name: str) -> float:
        """Return a value by the product's name."""
        field, index = _field(name)
        value = getattr(self, field)
        return float(value if index is None else value[index])

    def changed(self, values: Mapping[str, float]) -> Truth:
        """Return this truth with other values, by the product's names."""
        found = self
        for name, value in values.items():
            field, index = _field(name)
            old: Any = getattr(found, field)
            new = value if index is None else (value, old[1]) if index == 0 else (old[0], value)
            found = replace(found, **{field: new})  # type: ignore[arg-type]
        return found

    def of(self, model: str) -> dict[str, float]:
        """Return product's name -> value of every parameter of a model."""
        return {name: self[name] for name in PARAMETERS[model]}


def _field(name: str) -> tuple[str, int | None]:
    """Return the field of Truth, and the index in its pair, of a name such as support_left.stiffness[1]."""
    if not any(name in names for names in PARAMETERS.values()):
        raise KeyError(name)
    field, _, index = name.removeprefix("rotor.").replace(".", "_").partition("[")
    return field, int(index[0]) - 1 if index else None


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One run: time (n,) [s] since the start at rest, columns name -> (n,) [m, A], theta (n,) [rad], speed [rad/s]."""

    model: str
    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    theta: np.ndarray
    speed: float
    rate: float
    settings: Mapping[str, float]

    def select(self, names: Sequence[str]) -> RecordedRun:
        """Return the run with these columns only."""
        return replace(self, columns={name: self.columns[name] for name in names})


def _jeffcott(truth: Truth) -> Model:
    """Return chapter 2 as a rotor of one degree of freedom a plane: columns x, y."""
    rotor = Rotor(
        mass=np.array([[2.0]]),
        damping=np.array([[truth.viscous_damping]]),
        gyroscopic=np.zeros((1, 1)),
        stiffness=np.array([[7.6e5]]),
        amb=0,
        crack=0,
        crack_stiffness=truth.crack_stiffness,
        sag=2.6e-5,
        discs=((0, 2.0, truth.eccentricity, truth.unbalance_phase),),
    )
    return rotor, {"": 0}


def _offset_disc(truth: Truth) -> Model:
    """Return chapter 3, I_d = 0.0024 kg m^2: columns x, y."""
    rotor = replace(
        models.offset_disc(),
        damping=np.array([[truth.viscous_damping, 11.0], [11.0, 6.0]]),
        discs=((0, 2.0, truth.eccentricity, truth.unbalance_phase),),
    )
    return rotor, {"": 0}


def _fe_rigid(truth: Truth) -> Model:
    """Return chapter 4: columns x1, y1, ..., x6, y6; the pinned nodes 1 and 6 do not move."""
    rotor = models.fe_rigid(5 * truth.parts, a0=truth.mass_damping, a1=truth.stiffness_damping)
    damping = rotor.damping.copy()
    damping[rotor.amb, rotor.amb] += truth.disc_damping
    discs = ((rotor.amb, 2.0, truth.eccentricity, truth.unbalance_phase),)
    rotor = replace(rotor, damping=damping, discs=discs)
    nodes = rotor.translations[truth.parts - 1 :: truth.parts]
    return rotor, {"1": None, **dict(zip("2345", nodes, strict=True)), "6": None}


def _fe_flexible(truth: Truth) -> Model:
    """Return chapter 5, sag 31 um, inertias and supports of the shipped diagram: columns x1, y1, ..., x6, y6."""
    inertias: Any = {"polar": (0.0045, 0.0034), "diametral": (0.0024, 0.0018)}
    rotor = models.fe_flexible(**inertias, a0=truth.mass_damping, a1=truth.stiffness_damping)
    first, second = (disc[0] for disc in rotor.discs)
    left, right = (support[0] for support in rotor.supports)
    rotor = replace(
        rotor,
        discs=(
            (first, 2.0, truth.eccentricity1, truth.unbalance_phase1),
            (second, 1.5, truth.eccentricity2, truth.unbalance_phase2),
        ),
        supports=(
            (left, *truth.support_left_stiffness, *truth.support_left_damping),
            (right, *truth.support_right_stiffness, *truth.support_right_damping),
        ),
    )
    return rotor, dict(zip("123456", rotor.translations, strict=True))


def rotor_of(model: str, truth: Truth, speed: float, gains: Gains = THESIS_GAINS) -> Model:
    """Return the rotor in its closed loop (without the crack phase) and suffix of a column -> degree of freedom."""
    makers = {"jeffcott": _jeffcott, "offset_disc": _offset_disc, "fe_rigid": _fe_rigid, "fe_flexible": _fe_flexible}
    rotor, nodes = makers[model](truth)
    k_s, k_i = truth.force_displacement_factor, truth.force_current_factor
    rotor = replace(rotor, crack_stiffness=truth.crack_stiffness, force_displacement=k_s, force_current=k_i)
    return replace(rotor, kp=float(gains[0]), ki=float(gains[1]), kd=float(gains[2]), speed=speed), nodes


def _run(
    model: str,
    truth: Truth,
    speed: float,
    gains: Gains = THESIS_GAINS,
    start: float = 4.0,
    duration: float = 1.0,
    rate: float = 10_000.0,
    settled: bool = False,
    theta0: float = 0.0,
) -> RecordedRun:
    """Return one run in the window [start, start + duration) [s] after the start at rest; speed [rad/s], rate [Hz].

    settled: the motion without its transient, integral action included. theta0: the angle [rad] at the start.
    """
    rotor, nodes = rotor_of(model, truth, speed, gains)
    time = start + np.arange(round(duration * rate)) / rate
    dofs = [dof for dof in nodes.values() if dof is not None]
    planes, system = (2, _two_planes) if rotor.supports else (1, _one_complex_plane)
    matrix, forcing, readout = system(rotor, _forces(rotor, truth.crack_phase), dofs)
    if rotor.ki == 0.0:  # nothing depends on the integral, the first state of each plane, and it never settles
        matrix, readout = matrix[planes:, planes:], readout[:, planes:]
        forcing = {k: b[planes:] for k, b in forcing.items()}
    found = _response((matrix, forcing, readout), speed, time, theta0, settled)
    if planes == 2:
        found = found[0::2].real + 1j * found[1::2].real
    signals = dict(zip(dofs, found[:-1], strict=True))
    pinned = np.zeros(len(time), dtype=complex)
    named = [(f"x{s}", f"y{s}", pinned if dof is None else signals[dof]) for s, dof in nodes.items()]
    columns: dict[str, np.ndarray] = {}
    for x, y, signal in (*named, ("ix", "iy", found[-1])):
        columns[x], columns[y] = signal.real.copy(), signal.imag.copy()
    settings = {"controller.KP": rotor.kp, "controller.KI": rotor.ki, "controller.KD": rotor.kd}
    return RecordedRun(model, time, columns, speed * time + theta0, speed, rate, settings)


jeffcott_run = partial(_run, "jeffcott")
offset_disc_run = partial(_run, "offset_disc")
fe_rigid_run = partial(_run, "fe_rigid")
fe_flexible_run = partial(_run, "fe_flexible")


def _forces(rotor: Rotor, crack_phase: float) -> dict[int, np.ndarray]:
    """Return order k -> complex force (n,) of f_x + i f_y = sum F_k exp(i k theta), crack and unbalances."""
    orders = participation(rotor.terms)
    forces = {k: np.zeros(rotor.size, dtype=complex) for k in sorted({1, *orders})}
    for k, p in orders.items():
        forces[k][rotor.crack] += p * rotor.crack_stiffness * rotor.sag * np.exp(1j * k * crack_phase)
    for dof, mass, eccentricity, phase in rotor.discs:
        forces[1][dof] += mass * eccentricity * rotor.speed**2 * np.exp(1j * phase)
    return forces


def _one_complex_plane(rotor: Rotor, forces: dict[int, np.ndarray], dofs: Sequence[int]) -> System:
    """Return the isotropic rotor in q = q_x + i q_y, state [int u_amb, q, q'] (1 + 2n), readout [u ..., i]."""
    n, amb = rotor.size, rotor.amb
    inverse = np.linalg.inv(rotor.mass)
    stiffness, damping = rotor.stiffness.copy(), rotor.damping - 1j * rotor.speed * rotor.gyroscopic
    stiffness[amb, amb] += rotor.force_current * rotor.kp - rotor.force_displacement
    damping[amb, amb] += rotor.force_current * rotor.kd
    matrix = np.zeros((1 + 2 * n, 1 + 2 * n), dtype=complex)
    matrix[0, 1 + amb] = 1.0
    matrix[1 : 1 + n, 1 + n :] = np.eye(n)
    matrix[1 + n :, 0] = -inverse[:, amb] * rotor.force_current * rotor.ki
    matrix[1 + n :, 1 : 1 + n] = -inverse @ stiffness
    matrix[1 + n :, 1 + n :] = -inverse @ damping
    forcing = {k: np.concatenate([np.zeros(1 + n), inverse @ f]) for k, f in forces.items()}
    readout = np.zeros((len(dofs) + 1, 1 + 2 * n))
    for row, dof in enumerate(dofs):
        readout[row, 1 + dof] = 1.0
    readout[-1, [0, 1 + amb, 1 + n + amb]] = rotor.ki, rotor.kp, rotor.kd
    return matrix, forcing, readout


def _two_planes(rotor: Rotor, forces: dict[int, np.ndarray], dofs: Sequence[int]) -> System:
    """Return the rotor in two real planes, state [int u_amb, q_x, q_y, q_x', q_y'], readout [u_x, u_y, ..., i_x, i_y].

    The force of real f_x, f_y at exp(i k theta) is (F_k + conj F_-k) / 2 and (F_k - conj F_-k) / 2i.
    """
    n, amb = rotor.size, rotor.amb
    inverse = np.linalg.inv(rotor.mass)
    forcing = {}
    for k in sorted({*forces, *(-k for k in forces)}):
        plus = forces.get(k, np.zeros(n, dtype=complex))
        minus = forces.get(-k, np.zeros(n, dtype=complex)).conj()
        forcing[k] = np.concatenate([np.zeros(2 + 2 * n), inverse @ (plus + minus) / 2, inverse @ (plus - minus) / 2j])
    readout = np.zeros((2 * len(dofs) + 2, 2 + 4 * n))
    for plane in range(2):
        for row, dof in enumerate(dofs):
            readout[2 * row + plane, 2 + plane * n + dof] = 1.0
        current = [plane, 2 + plane * n + amb, 2 + (2 + plane) * n + amb]
        readout[2 * len(dofs) + plane, current] = rotor.ki, rotor.kp, rotor.kd
    return rotor.system(), forcing, readout


def _response(system: System, speed: float, time: np.ndarray, theta0: float, settled: bool) -> np.ndarray:
    """Return readout y (rows, n), complex, of y' = A y + sum b_k exp(i k theta) from y(0) = 0, or settled.

    y = sum Y_k exp(i k theta) + V exp(lambda t) c,  (i k W - A) Y_k = b_k,  V c = - sum Y_k exp(i k theta0)
    """
    matrix, forcing, readout = system
    orders, eye = np.array(list(forcing)), np.eye(len(matrix))
    roots, modes = np.linalg.eig(matrix)
    if roots.real.max() >= 0.0:
        raise ValueError(f"unstable: the closed loop has a root {roots[roots.real.argmax()]:.6g}")
    states = np.stack([np.linalg.solve(1j * k * speed * eye - matrix, b) for k, b in forcing.items()], axis=1)
    found = (readout @ states) @ np.exp(1j * np.outer(orders, speed * time + theta0))
    if not settled:
        share = np.linalg.solve(modes, -states @ np.exp(1j * orders * theta0))
        found += ((readout @ modes) * share) @ np.exp(np.outer(roots, time))
    return np.asarray(found)


def add_noise(run: RecordedRun, level: float, seed: int | Sequence[int], kind: str = "white") -> RecordedRun:
    """Return the run with noise on every column; level is a fraction: 0.05 is 5 %.

    "white":  r + level rms(r) R                                   R ~ N(0, 1), its own for each sample and column
    "thesis": r (1 + (R - 0.5) N_p / 100), N_p = 100 level         thesis eq. (2.67)
    The draw depends on the seed and the name of the column alone: give each run its own seed.
    """
    if kind not in ("white", "thesis"):
        raise ValueError(kind)
    noisy = {}
    for name, r in run.columns.items():
        draw = np.random.default_rng((*np.atleast_1d(seed), *name.encode())).standard_normal(len(r))
        noisy[name] = r + level * (np.sqrt(np.mean(r**2)) * draw if kind == "white" else r * (draw - 0.5))
    return replace(run, columns=noisy)


def tacho_times(run: RecordedRun, jitter: float = 0.0, seed: int | Sequence[int] = 0) -> np.ndarray:
    """Return the times [s] within the window where theta = 2 pi k, on the clock of `run.time`; jitter: std [s]."""
    turn = 2 * np.pi
    first, last = np.ceil(run.theta[0] / turn - 1e-9), np.floor(run.theta[-1] / turn + 1e-9)
    pulses = np.arange(first, last + 1) * turn
    times = run.time[0] + (pulses - run.theta[0]) / run.speed
    return np.asarray(times + jitter * np.random.default_rng(seed).standard_normal(len(times)))


def write_recording(
    folder: Path,
    runs: Sequence[RecordedRun],
    name: str,
    use: str | Sequence[str] = "identify",
    *,
    file_format: str = "npz",
    angle: str = "tacho",
    clock: str = "rate",
    jitter: float = 0.0,
    seed: int = 0,
) -> Path:
    """Write recording.json and a data file a run into the folder, and return the path of recording.json.

    use: of all runs, or one for each. file_format: "npz" | "csv". angle: "tacho" (pulses with jitter [s]) |
    "theta" (a channel) | "none". clock: "rate" (time starts at 0) | "column" (a column time, since the start at rest).
    """
    assert file_format in ("npz", "csv")
    assert angle in ("tacho", "theta", "none")
    assert clock in ("rate", "column")
    folder.mkdir(parents=True, exist_ok=True)
    uses = [use] * len(runs) if isinstance(use, str) else list(use)
    entries = []
    for number, (run, purpose) in enumerate(zip(runs, uses, strict=True)):
        time = {"time": run.time} if clock == "column" else {}
        data = {**time, **run.columns, **({"theta": run.theta} if angle == "theta" else {})}
        identity = f"run{number:02d}"
        entry: dict[str, Any] = {"id": identity, "file": f"{identity}.{file_format}"}
        if clock == "rate":
            entry["sample_rate"] = f"{run.rate:.17g} Hz"
        entry["speed"] = f"{run.speed / RPM:.15g} rpm"
        if angle == "tacho":
            offset = run.time[0] if clock == "rate" else 0.0
            entry["tacho"] = [float(t) for t in tacho_times(run, jitter, (seed, number)) - offset]
        entries.append({**entry, "set": dict(run.settings), "use": purpose})
        _write_data(folder / entry["file"], data)
    content: dict[str, Any] = {
        "name": name,
        "source": f"computed exactly by an independent program (tests/reference), model {runs[0].model}",
        "channels": {column: _channel(column) for column in runs[0].columns},
    }
    if angle == "theta":
        content["channels"]["theta"] = {"signal": "clock.theta", "unit": "rad"}
    if clock == "column":
        content["time"] = "time"
    path = folder / "recording.json"
    path.write_text(json.dumps({**content, "runs": entries}, indent=1) + "\n", encoding="utf-8")
    return path


def _channel(column: str) -> dict[str, Any]:
    """Return the entry of recording.json of a column: x, y3, ix."""
    if column.startswith("i"):
        return {"signal": "controller.current", "axis": column[1], "unit": "A"}
    node = {"node": int(column[1:])} if column[1:] else {}
    return {"signal": "rotor.displacement", **node, "axis": column[0], "unit": "m"}


def _write_data(path: Path, data: Mapping[str, np.ndarray]) -> None:
    """Write columns to .npz or to .csv with a header, every bit kept."""
    if path.suffix == ".npz":
        np.savez(path, **data)  # type: ignore[arg-type]
        return
    rows = np.column_stack(list(data.values()))
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=",".join(data), comments="")
