"""The casings: two masses on springs, a rigid body on its feet, and one of modes in the place of its matrices."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from rotorsim.diagram.edit import swap
from rotorsim.errors import RotorsimError
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.load import load
from tests.blocks.evaluation import prepare
from tests.reference.rotor import beam

M, K, D, MASS, FOOT, DAMPING = 12.0, 3e6, 900.0, 60.0, [8e6, 5e6], [400.0, 700.0]


def between() -> dict[str, Any]:
    """Return a rotor on a bearing in a casing, wired as docs/machines.md says."""
    return {
        "blocks": {
            "rotor": {"type": "rotor_2dof", "parameters": {"mass": M, "stiffness": 0.0, "viscous_damping": 0.0}},
            "bearing": {"type": "support", "parameters": {"stiffness": [K, K], "damping": [D, D]}},
            "casing": {"type": "casing", "parameters": {"mass": MASS, "stiffness": [FOOT], "damping": [DAMPING]}},
            "gap": {"type": "sum", "parameters": {"signs": "+-"}},
            "gap_rate": {"type": "sum", "parameters": {"signs": "+-"}},
            "reaction": {"type": "gain", "parameters": {"gain": -1.0}},
        },
        "wires": [
            ["rotor.displacement", "gap.input1"],
            ["casing.displacement[1]", "gap.input2"],
            ["rotor.velocity", "gap_rate.input1"],
            ["casing.velocity[1]", "gap_rate.input2"],
            ["gap.output", "bearing.displacement"],
            ["gap_rate.output", "bearing.velocity"],
            ["bearing.force", "rotor.force"],
            ["bearing.force", "reaction.input"],
            ["reaction.output", "casing.force[1]"],
        ],
        "record": ["rotor.displacement"],
    }


def test_a_rotor_in_a_casing_has_the_poles_of_two_masses_on_springs() -> None:
    """m u'' + d (u - c)' + k (u - c) = 0,  M c'' + d (c - u)' + k (c - u) + D c' + K c = 0, in x and in y."""
    expected = []
    for stiffness, damping in zip(FOOT, DAMPING, strict=True):
        mass = np.diag([M, MASS])
        k = np.array([[K, -K], [-K, K + stiffness]])
        d = np.array([[D, -D], [-D, D + damping]])
        lower = np.hstack([-np.linalg.solve(mass, k), -np.linalg.solve(mass, d)])
        expected += np.linalg.eigvals(np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower])).tolist()
    wanted = sorted((pole for pole in expected if pole.imag > 0), key=lambda pole: pole.imag)
    found = sorted((mode.eigenvalue for mode in modes(load(between())).modes), key=lambda pole: pole.imag)
    assert len(found) == 4
    assert np.array(found) == pytest.approx(np.array(wanted), rel=1e-9)


def test_a_casing_that_tilts_is_a_rigid_body_on_springs() -> None:
    stations, feet, centre = np.array([0.1, 0.5, 0.9]), np.array([0.0, 0.8]), 0.45
    stiffness, damping = np.array([[2e6, 3e6], [4e6, 1e6]]), np.array([[100.0, 200.0], [300.0, 50.0]])
    block = prepare(
        "casing",
        {"force": (3, 2)},
        {
            "stations": stations,
            "feet": feet,
            "mass": 40.0,
            "tilt_inertia": 7.0,
            "centre_of_gravity": centre,
            "stiffness": stiffness,
            "damping": damping,
        },
        {"tilts": True},
    )
    rng = np.random.default_rng(5)
    force, (c, b, dc, db) = rng.normal(size=(3, 2)) * 1e3, rng.normal(size=(4, 2)) * 1e-3
    found = block.evaluate({"force": force}, {"position": c, "slope": b, "velocity": dc, "slope_rate": db})
    for axis in (0, 1):
        arm, seen = feet - centre, stations - centre
        pushed = -stiffness[:, axis] * (c[axis] + arm * b[axis]) - damping[:, axis] * (dc[axis] + arm * db[axis])
        assert found.outputs["displacement"][:, axis] == pytest.approx(c[axis] + seen * b[axis], rel=1e-12)
        assert found.outputs["velocity"][:, axis] == pytest.approx(dc[axis] + seen * db[axis], rel=1e-12)
        rate = (force[:, axis].sum() + pushed.sum()) / 40.0
        assert found.derivatives["velocity"][axis] == pytest.approx(rate, rel=1e-12)
        turned = (seen @ force[:, axis] + arm @ pushed) / 7.0
        assert found.derivatives["slope_rate"][axis] == pytest.approx(turned, rel=1e-12)


def test_one_that_tilts_on_one_foot_is_refused() -> None:
    document = between()
    document["blocks"]["casing"]["parameters"]["tilts"] = True
    with pytest.raises(RotorsimError) as caught:
        load(document)
    [problem] = caught.value.problems
    assert (problem.subject, problem.what, problem.hint) == (
        "casing.tilts",
        "a casing that tilts needs feet at two positions",
        "give two positions or more in feet, or leave tilts out",
    )


# --- modes ------------------------------------------------------------------------------------------------------------

BEARING, SPEED = ([K, 0.7 * K], [D, 0.5 * D]), 400.0
ROTOR = {"elements": 3, "element_length": 0.2, "outer_diameter": 0.03, "disc_nodes": [2], "disc_mass": 4.0,
         "disc_polar_inertia": 0.03, "disc_diametral_inertia": 0.02}  # fmt: skip


def on_two_bearings(casing: dict[str, Any], feet: tuple[tuple[list[float], list[float]], ...] = ()) -> dict[str, Any]:
    """Return a turning rotor whose ends are on two bearings in a casing; feet: at its stations from the third on."""
    blocks = {
        "turning": {"type": "constant", "parameters": {"value": SPEED}},
        "rotor": {"type": "rotor_fe", "parameters": ROTOR},
        "casing": casing,
    }
    wires = [["turning.output", "rotor.speed"]]
    for k, node in ((1, 1), (2, 4)):
        values = dict(zip(("stiffness", "damping"), BEARING, strict=True))
        blocks[f"bearing{k}"] = {"type": "support", "parameters": values}
        blocks[f"reaction{k}"] = {"type": "gain", "parameters": {"gain": -1.0}}
        for end in ("displacement", "velocity"):
            blocks[f"{end}{k}"] = {"type": "sum", "parameters": {"signs": "+-"}}
            wires += [[f"rotor.{end}[{node}]", f"{end}{k}.input1"], [f"casing.{end}[{k}]", f"{end}{k}.input2"]]
            wires.append([f"{end}{k}.output", f"bearing{k}.{end}"])
        wires += [[f"bearing{k}.force", f"rotor.force[{node}]"], [f"bearing{k}.force", f"reaction{k}.input"]]
        wires.append([f"reaction{k}.output", f"casing.force[{k}]"])
    for k, (stiffness, damping) in enumerate(feet, 3):
        blocks[f"foot{k}"] = {"type": "support", "parameters": {"stiffness": stiffness, "damping": damping}}
        wires += [[f"casing.{end}[{k}]", f"foot{k}.{end}"] for end in ("displacement", "velocity")]
        wires.append([f"foot{k}.force", f"casing.force[{k}]"])
    return {"blocks": blocks, "wires": wires, "record": ["rotor.displacement"]}


def poles(document: dict[str, Any]) -> np.ndarray:
    return np.array([mode.eigenvalue for mode in modes(load(document)).modes])


def oscillating(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of M q'' + C q' + K q = 0 above the real axis, in the order of their frequency."""
    n = len(mass)
    lower = np.hstack([-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)])
    values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))
    return np.array(sorted(values[values.imag > 1.0], key=lambda pole: pole.imag))


def test_a_rotor_in_a_casing_of_modes_has_the_poles_of_all_their_matrices() -> None:
    """The casing as masses and springs, nothing of it diagonal, x and y coupled; its modes are those of scipy.eigh."""
    rng = np.random.default_rng(11)
    root, other = rng.normal(size=(2, 6, 6))
    mass, stiffness = 20 * (root @ root.T + 6 * np.eye(6)), 1e7 * (other @ other.T + np.eye(6))
    a0, a1 = 3.0, 4e-6
    squares, shapes = eigh(stiffness, mass)
    w, scale = np.sqrt(squares), rng.uniform(0.2, 3.0, 6)
    seen = (shapes * scale).T[:, :4]  # x, y of the first station, then of the second; the rest is inside
    given = {
        "natural_frequency": w.tolist(),
        "damping_ratio": ((a0 / w + a1 * w) / 2).tolist(),
        "modal_mass": (scale**2).tolist(),
        "mode_shape_x": seen[:, ::2].tolist(),
        "mode_shape_y": seen[:, 1::2].tolist(),
    }
    m, k = beam(3, 0.6, 0.03)
    g = np.zeros_like(m)
    m[2, 2], m[3, 3], g[3, 3] = m[2, 2] + 4.0, m[3, 3] + 0.02, 0.03
    n, zero = len(m), np.zeros_like(m)
    joint = np.zeros((2 * n + 6,) * 2)
    M, C, S = (joint.copy() for _ in range(3))
    M[: 2 * n, : 2 * n] = np.block([[m, zero], [zero, m]])
    C[: 2 * n, : 2 * n] = SPEED * np.block([[zero, g], [-g, zero]])
    S[: 2 * n, : 2 * n] = np.block([[k, zero], [zero, k]])
    M[2 * n :, 2 * n :], S[2 * n :, 2 * n :] = mass, stiffness
    C[2 * n :, 2 * n :] = a0 * mass + a1 * stiffness
    for end, station in ((0, 0), (n - 2, 1)):
        for axis in (0, 1):
            between = np.zeros(2 * n + 6)
            between[axis * n + end], between[2 * n + 2 * station + axis] = 1.0, -1.0
            S += BEARING[0][axis] * np.outer(between, between)
            C += BEARING[1][axis] * np.outer(between, between)
    expected = oscillating(M, C, S)
    found = poles(on_two_bearings({"type": "flexible_casing", "parameters": given}))
    assert len(found) == len(expected) == 22
    assert found == pytest.approx(expected, rel=1e-9)


def test_a_casing_of_stiff_modes_is_the_rigid_one() -> None:
    """Rigid modes and feet: the casing that tilts, to rounding; a bending mode at f moves its poles as 1 / f^2."""
    feet, stations, centre, mass, inertia = [0.0, 0.7], [0.05, 0.6], 0.4, 60.0, 9.0
    stiffness, damping = [[2e7, 3e7], [4e7, 1.5e7]], [[100.0, 200.0], [300.0, 50.0]]
    body = {"stations": stations, "feet": feet, "mass": mass, "tilt_inertia": inertia, "centre_of_gravity": centre}
    rigid = {"type": "casing", "parameters": {"tilts": True, **body, "stiffness": stiffness, "damping": damping}}
    expected = poles(on_two_bearings(rigid))
    arms = [z - centre for z in (*stations, *feet)]
    one, none = [1.0] * 4, [0.0] * 4
    grounded = tuple(zip(stiffness, damping, strict=True))

    def flexible(frequencies: list[float]) -> dict[str, Any]:
        bent = [[0.8, 0.6, -0.9, -1.1], none]
        more = len(frequencies)
        values = {
            "natural_frequency": [0.0] * 4 + frequencies,
            "damping_ratio": 0.0,
            "modal_mass": [mass, mass, inertia, inertia] + [mass / 3] * more,
            "mode_shape_x": [one, none, arms, none, *bent[:more]],
            "mode_shape_y": [none, one, none, arms, *bent[::-1][:more]],
        }
        return on_two_bearings({"type": "flexible_casing", "parameters": values}, grounded)

    assert poles(flexible([])) == pytest.approx(expected, rel=1e-9)
    off = []
    for f in (4e4, 8e4):
        found = poles(flexible([f, f]))
        assert len(found) == len(expected) + 2
        off.append(np.abs(found[:8] / expected[:8] - 1).max())
    assert off[0] < 1e-2
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.02)


def modal() -> dict[str, Any]:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 4, 3))
    return {
        "natural_frequency": np.array([0.0, 150.0, 400.0, 900.0]),
        "damping_ratio": np.array([0.0, 0.02, 0.01, 0.3]),
        "modal_mass": np.array([30.0, 12.0, 1.0, 5.0]),
        "mode_shape_x": x,
        "mode_shape_y": y,
    }


def test_what_bearings_do_to_a_casing_of_modes_is_energy_or_heat() -> None:
    """f . u' = d/dt sum m (q'^2 + w^2 q^2) / 2 + sum 2 zeta w m q'^2: what forces do, motion sees."""
    values = modal()
    block = prepare("flexible_casing", {"force": (3, 2)}, values)
    w, zeta, m = (values[key] for key in ("natural_frequency", "damping_ratio", "modal_mass"))
    rng = np.random.default_rng(3)
    force, q, v = rng.normal(size=(3, 2)) * 1e3, rng.normal(size=4) * 1e-4, rng.normal(size=4) * 1e-2
    found = block.evaluate({"force": force}, {"position": q, "velocity": v})
    rate = np.sum(m * (v * found.derivatives["velocity"] + w**2 * q * v))
    heat = np.sum(2 * zeta * w * m * v**2)
    assert np.sum(force * found.outputs["velocity"]) == pytest.approx(rate + heat, rel=1e-10)
    for station in range(3):
        shapes = np.array([values["mode_shape_x"][:, station], values["mode_shape_y"][:, station]])
        assert found.outputs["displacement"][station] == pytest.approx(shapes @ q, rel=1e-12)


def swapped(**parameters: Any) -> dict[str, Any]:
    """Return the rotor in a casing, the rigid one swapped for modes."""
    return swap(between(), "casing", "flexible_casing", parameters)


def test_a_rigid_casing_is_swapped_for_modes_and_its_wires_stay() -> None:
    """A casing of one mass on springs is one of two modes, w^2 = K / M and zeta = D / (2 sqrt(K M))."""
    stiffness, damping = np.array(FOOT), np.array(DAMPING)
    made = swapped(
        natural_frequency=np.sqrt(stiffness / MASS).tolist(),
        damping_ratio=(damping / (2 * np.sqrt(stiffness * MASS))).tolist(),
        modal_mass=MASS,
        mode_shape_x=[[1], [0]],
        mode_shape_y=[[0], [1]],
    )
    assert made["wires"] == between()["wires"]
    assert poles(made) == pytest.approx(poles(between()), rel=1e-9)


def test_modes_that_do_not_fit_are_refused() -> None:
    """Shapes as [station, mode], a mode without a mass, a damping ratio in per cent, a station that no shape has."""
    rows = "hint: write a list of rows [[...], ...]: [mode, station]"
    format_ = "hint: docs/diagrams.md describes the format; `rotorsim blocks TYPE` lists ports and parameters"
    two = {"natural_frequency": ["30 Hz", "35 Hz"]}
    assert refused(**two, mode_shape_x=[[1, 0]], mode_shape_y=0) == [
        f"error: casing.mode_shape_x: shape is (1, 2), expected (2, ?)\n\n{rows}"
    ]
    assert refused(**two, mode_shape_x=[[1], [0]], mode_shape_y=0, damping_ratio=[2, 1], modal_mass=[60, 0]) == [
        f"error: casing.damping_ratio: 2 must be at most 1\n\n{format_}",
        f"error: casing.modal_mass: 0 kg must be greater than 0 kg\n\n{format_}",
    ]
    assert refused(**two, mode_shape_x=[[1, 1], [0, 1]], mode_shape_y=[[1], [1]], modal_mass=[1, 2, 3]) == [
        f"error: casing.mode_shape_y: shape is (2, 1), expected (2, 2)\n\n{rows}",
        "error: casing.modal_mass: shape is (3,), expected (2,)\n\nhint: write a list [...]",
    ]
    wider = [[wire.replace("casing.force[1]", "casing.force[2]") for wire in ends] for ends in between()["wires"]]
    assert refused(wider, natural_frequency=["30 Hz"], mode_shape_x=[[1]], mode_shape_y=0) == [
        "error: casing.force[2]: index 2 is out of range\n\nhint: shape is (1, 2), counted from 1"
    ]


def refused(wires: list[list[str]] | None = None, **parameters: Any) -> list[str]:
    made = swapped(**parameters)
    with pytest.raises(RotorsimError) as caught:
        load(made if wires is None else {**made, "wires": wires})
    return [str(problem) for problem in caught.value.problems]


def chain() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies, mass-normalised shapes (n, modes) and flexibility of ten masses on springs, one end held."""
    n, m, k = 10, 8.0, 4e8
    S = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    S[-1, -1] = k
    w2, shapes = eigh(S, m * np.eye(n))
    return np.sqrt(w2), shapes, np.linalg.inv(S)


STATIONS = [2, 5, 9]


def of_chain(count: int, residual: bool, damping: float = 0.0, **more: Any) -> dict[str, Any]:
    """Return parameters of a casing of ``count`` of the modes in x, the residual of the others if wanted."""
    w, shapes, flexibility = chain()
    seen = shapes[STATIONS, :count]
    values: dict[str, Any] = {
        "natural_frequency": w[:count],
        "damping_ratio": np.full(count, damping),
        "modal_mass": np.ones(count),
        "mode_shape_x": seen.T,
        "mode_shape_y": np.zeros((count, 3)),
    }
    if residual:
        R = flexibility[np.ix_(STATIONS, STATIONS)] - seen / w[:count] ** 2 @ seen.T
        left_out = float(w[min(count, len(w) - 1)])
        values |= {"residual_flexibility_x": R, "residual_frequency": left_out, "residual_damping_ratio": damping}
    return {**values, **more}


def receptance(values: dict[str, Any], residual: bool, at: float) -> np.ndarray:
    """Return u / f in x (3, 3) at a frequency [rad/s], from the equations of the block: states by their slopes."""
    block = prepare("flexible_casing", {"force": (3, 2)}, values, options={"residual": True} if residual else {})
    count = len(values["natural_frequency"])
    shapes = {"position": (count,), "velocity": (count,)}
    shapes |= {"sway": (3, 2), "sway_rate": (3, 2)} if residual else {}
    zero = {name: np.zeros(shape) for name, shape in shapes.items()}

    def flat(found: Any) -> np.ndarray:
        return np.concatenate([np.ravel(found.derivatives[name]) for name in shapes])

    def out(found: Any) -> np.ndarray:
        return np.asarray(found.outputs["displacement"])[:, 0]

    columns, seen = [], []
    for name, shape in shapes.items():
        for entry in np.ndindex(*shape):
            state = {**zero, name: zero[name].copy()}
            state[name][entry] = 1.0
            found = block.evaluate({"force": np.zeros((3, 2))}, state)
            columns.append(flat(found))
            seen.append(out(found))
    driven = []
    for station in range(3):
        force = np.zeros((3, 2))
        force[station, 0] = 1.0
        found = block.evaluate({"force": force}, zero)
        assert not out(found).any()  # no algebraic loop
        driven.append(flat(found))
    A, B, C = np.array(columns).T, np.array(driven).T, np.array(seen).T
    return np.asarray(C @ np.linalg.solve(1j * at * np.eye(len(A)) - A, B))


def test_a_residual_makes_a_casing_of_few_modes_as_flexible_as_a_whole_one() -> None:
    """Exactly at rest; beyond, in error by (w / w_res)^2 of the residual where w_res is that of the first left out."""
    w, shapes, flexibility = chain()
    first = w[3]
    static = flexibility[np.ix_(STATIONS, STATIONS)]
    few = receptance(of_chain(3, residual=True), True, 1e-3)
    np.testing.assert_allclose(few.real, static, rtol=1e-9)
    errors = []
    for at in (first / 10, first / 5):
        truth = shapes[STATIONS] / (w**2 - at**2) @ shapes[STATIONS].T
        with_it, without = (
            np.abs(receptance(of_chain(3, residual), residual, at) - truth).max() / np.abs(truth).max()
            for residual in (True, False)
        )
        errors.append(with_it)
        assert with_it < without / 20
    assert errors[1] < 2e-3
    assert errors[1] / errors[0] > 3.0


def test_a_residual_of_one_mode_is_that_mode() -> None:
    at = 0.8 * chain()[0][9]
    whole, few = (of_chain(count, residual, 0.02) for count, residual in ((10, False), (9, True)))
    np.testing.assert_allclose(receptance(few, True, at), receptance(whole, False, at), rtol=1e-8)


def test_a_residual_that_no_casing_has_is_refused() -> None:
    given = {"residual": True, "natural_frequency": [100.0], "modal_mass": 5.0}
    given |= {"mode_shape_x": [[1.0]], "mode_shape_y": [[1.0]]}
    for more, said in (
        ({}, "option residual needs residual_frequency above 0"),
        ({"residual_frequency": 900.0, "residual_flexibility_x": [[-1e-9]]}, "must have no negative eigenvalue"),
    ):
        with pytest.raises(RotorsimError, match=said):
            load(swapped(**given, **more))
    assert load(swapped(**given, residual_frequency=900.0, residual_flexibility_x=[[1e-9]]))
