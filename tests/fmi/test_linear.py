"""FMUs whose model description says that their equations are linear (dependenciesKind)."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.functions import functions_of
from rotorsim.fmi.runtime.slave import describe_fmu
from rotorsim.fmi.slopes import PROBED, Slopes
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.compiled import compile_diagram, model_for_runs
from rotorsim.model.load import load
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.periodic import periodic
from tests.fmi.conftest import Make
from tests.fmi.plant import description2, make_fmu
from tests.fmi.test_equations import BOTH, with_fmu

# x' = v, v' = u - 100 (x + 100 x^3) - 2 v
SPRUNG: dict[str, Any] = {
    "name": "sprung",
    "blocks": {
        "in": {"type": "constant"},
        "spring": {"type": "polynomial", "parameters": {"cubic": 100.0}},
        "stiffness": {"type": "gain", "parameters": {"gain": 100.0}},
        "damping": {"type": "gain", "parameters": {"gain": 2.0}},
        "sum": {"type": "sum", "parameters": {"signs": "+--"}},
        "v": {"type": "integrator", "parameters": {"initial": 0.1}},
        "x": {"type": "integrator", "parameters": {"initial": 0.01}},
    },
    "wires": [
        ["in.output", "sum.input1"],
        ["spring.output", "stiffness.input"],
        ["stiffness.output", "sum.input2"],
        ["damping.output", "sum.input3"],
        ["sum.output", "v.input"],
        ["v.output", "x.input"],
        ["v.output", "damping.input"],
        ["x.output", "spring.input"],
    ],
    "solver": {"step": 1e-3, "stop": 0.1},
    "record": ["x.output"],
}
INSIDE = [name for name in SPRUNG["blocks"] if name != "in"]


def kinds_in(file: Path) -> dict[str, dict[str, str]]:
    """Return unknown -> known -> kind, as FMPy reads it."""
    description = fmpy.read_model_description(str(file))
    rows = description.outputs + description.derivatives
    return {
        row.variable.name: dict(
            zip((d.name for d in row.dependencies), row.dependenciesKind or ["dependent"] * 99, strict=False)
        )
        for row in rows
    }


@BOTH
def test_an_exported_rotor_says_that_it_is_linear(fmu: Make, version: str) -> None:
    file = fmu("jeffcott", version, blocks=["rotor"])
    rate = {"rotor.force[1]": "tunable", "rotor.position[1]": "tunable", "rotor.velocity_state[1]": "tunable"}
    found = kinds_in(file)["der(rotor.velocity_state[1])"]
    assert {name: kind for name, kind in found.items() if name in rate} == rate
    assert {kind for name, kind in found.items() if name not in rate} <= {"dependent"}  # FMI 3.0 lists parameters
    assert kinds_in(file)["rotor.displacement[1]"] == {"rotor.position[1]": "constant"}
    description = describe_fmu(file)
    assert description.is_affine(["rotor.displacement[1]", "rotor.velocity[2]"])


def test_what_is_not_linear_is_not_said_to_be(fmu: Make) -> None:
    found = kinds_in(fmu(SPRUNG, blocks=INSIDE))  # type: ignore[attr-defined]
    assert found["der(x.value)"] == {"v.value": "constant"}
    assert found["der(v.value)"] == {"sum.input1": "dependent", "x.value": "dependent", "v.value": "dependent"}


@BOTH
def test_analyses_take_it_at_its_word_and_runs_do_not(fmu: Make, version: str) -> None:
    diagram = with_fmu(fmu, "rotor", version)
    assert compile_diagram(diagram).linear
    assert not model_for_runs(diagram).linear
    assert not compile_diagram(with_fmu(fmu, "rotor", version, linear=False)).linear


def test_the_settled_motion_is_the_same_either_way(fmu: Make) -> None:
    made = [periodic(with_fmu(fmu, "rotor", linear=word), speeds=[150.0], harmonics=9) for word in (True, False)]
    for name, values in made[0].harmonics.items():
        np.testing.assert_allclose(made[1].harmonics[name], values, atol=1e-6 * np.abs(values).max(), rtol=0)


@pytest.mark.parametrize("lacks", [(), ("directional",), ("directional", "adjoint")])
def test_the_factors(fmu: Make, lacks: tuple[str, ...]) -> None:
    """By directional or adjoint derivatives, or by differences over any step: m v' = u - d v - k x."""
    diagram = with_fmu(fmu, "rotor", "3.0", lacks=lacks)
    equations = functions_of(diagram.nodes["rotor"].block).equations
    values = {name: compile_diagram(diagram).parameter_vector()[part] for name, part in parts_of(diagram).items()}
    p = np.concatenate([values[f"rotor.{name}"] for name in diagram.nodes["rotor"].block.fmu_parameters])  # type: ignore[attr-defined]
    m, d, k = (float(values[f"rotor.{name}"][0]) for name in ("mass", "viscous_damping", "stiffness"))
    assert Slopes(equations).at(p)[2].tolist() == pytest.approx(
        [-k / m, 0, -d / m, 0, 1 / m, 0], rel=1e-9 if len(lacks) < 2 else 1e-8
    )


def parts_of(diagram: Diagram) -> dict[str, slice]:
    return dict(compile_diagram(diagram).parameters)


def test_one_value_of_the_parameters_is_asked_for_once(fmu: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = with_fmu(fmu, "rotor")
    model = compile_diagram(diagram)
    asked: list[bytes] = []
    own = Slopes._found

    def counted(self: Slopes, p: np.ndarray) -> np.ndarray:
        asked.append(p.tobytes())
        return own(self, p)

    monkeypatch.setattr(Slopes, "_found", counted)
    trace = model.trace
    matrix = MatrixFunction([trace.t, trace.x, trace.p], model.closed(trace.xdot))
    p = np.repeat([1.01 * model.p0, 1.02 * model.p0], 50, axis=0)
    found = matrix(np.linspace(0, 0.1, 100)[None], 1e-5 * np.ones((model.n_x, 100)), p.T)
    assert len(asked) == 2
    for k in (0, 60):
        expected = model.rhs(k * 0.1 / 99, 1e-5 * np.ones(model.n_x), model.z0(), p[k])
        np.testing.assert_allclose(found[k, :, 0], np.array(expected).ravel(), rtol=1e-12)


def rewritten(file: Path, target: Path, change: Callable[[str], str]) -> Path:
    """Write an FMU with another model description."""
    with zipfile.ZipFile(file) as given, zipfile.ZipFile(target, "w") as made:
        for name in given.namelist():
            data = given.read(name)
            made.writestr(name, change(data.decode()).encode() if name == "modelDescription.xml" else data)
    return target


def boasting(text: str) -> str:
    """Say that all is linear."""
    listed = re.compile(r'dependencies="([\d ]+)" />')
    return listed.sub(lambda m: f'{m[0][:-3]} dependenciesKind="{" ".join("fixed" for _ in m[1].split())}" />', text)


def test_inputs_begin_where_the_fmu_says(fmu: Make, tmp_path: Path) -> None:
    """What does not follow an input is asked for with the value with which it begins, which need not be zero."""
    file = fmu("jeffcott", blocks=["rotor"])

    def change(text: str) -> str:
        force = re.search(r'name="rotor\.force\[1\]".*?start="0\.0"', text, re.S)
        assert force is not None
        return text.replace(force[0], force[0].replace('start="0.0"', 'start="3.0"'))

    moved = rewritten(file, tmp_path / "moved.fmu", change)
    document = {**load("jeffcott").document, "blocks": dict(load("jeffcott").document["blocks"]), "identify": {}}
    document["blocks"]["rotor"] = {"type": "fmu", "file": str(moved), "parameters": {"in_process": True}}
    diagram = load(document, trust_blocks=True)
    linear, called = compile_diagram(diagram), model_for_runs(diagram)
    assert functions_of(diagram.nodes["rotor"].block).equations.idle.tolist() == [3.0, 0.0]
    x = 1e-5 * np.arange(1, linear.n_x + 1)
    found, expected = (np.array(one.rhs(0.01, x, one.z0(), one.p0)).ravel() for one in (linear, called))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_one_that_is_not_what_it_says_ends_an_analysis(fmu: Make, tmp_path: Path) -> None:
    """The cube is seen at its largest probe, a thousand times its nominal value of 1e-5."""
    file = rewritten(fmu(SPRUNG, blocks=INSIDE), tmp_path / "sprung.fmu", boasting)

    def diagram(**values: Any) -> Diagram:
        block = {"type": "fmu", "file": str(file), "parameters": {"in_process": True, **values}}
        return load({"name": "it", "blocks": {"it": block}}, trust_blocks=True)

    with pytest.raises(RotorsimError) as caught:
        modes(diagram())
    assert (
        str(caught.value)
        .splitlines()[0]
        .endswith("it: says that der(v.value) is linear in states and inputs, and it is not (t = 0 s)")
    )
    assert str(caught.value).endswith('hint: tell its maker; "linear": false takes its equations as they are')
    found = modes(diagram(linear=False))
    assert found.modes[0].eigenvalue == pytest.approx(-1 + 1j * np.sqrt(99), rel=1e-6)


def test_where_linear_equations_are_probed() -> None:
    """A dead zone, and a limit, of a thousandth of a nominal value is met, and a slight bend at a thousandfold."""
    assert PROBED == (1e-3, 1.0, 1e3)


@pytest.mark.parametrize(("kinds", "said"), [("fixed loose", "'loose' is not one"), ("fixed", "1 for 2 dependencies")])
def test_mistakes_in_what_it_says(tmp_path: Path, kinds: str, said: str) -> None:
    text = description2().replace('dependencies="2 6"', f'dependencies="2 6" dependenciesKind="{kinds}"')
    with pytest.raises(RotorsimError) as caught:
        describe_fmu(make_fmu(tmp_path / "a.fmu", description=text))
    assert f"y: dependenciesKind: {said}" in str(caught.value)
