"""A diagram whose rotor or controller is its own FMU for Model Exchange is the diagram that it was."""

from __future__ import annotations

import copy
import json
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.functions import functions_of
from rotorsim.fmi.runtime.slave import Fmu, Slave
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.periodic import periodic
from rotorsim.simulation.run import simulate
from tests.fmi.conftest import Make, lacking
from tests.fmi.events import alone, events_fmu
from tests.fmi.plant import FAULTS, floats_only, make_fmu

BOTH = pytest.mark.parametrize("version", ["2.0", "3.0"])
REPLACED = pytest.mark.parametrize("block", ["rotor", "controller"])


def with_fmu(
    fmu: Make, block: str, version: str = "2.0", *, trust: bool = True, lacks: Sequence[str] = (), **values: Any
) -> Diagram:
    """Return jeffcott with a block replaced by its FMU, in this process unless the values say otherwise.

    lacks: derivatives that the FMU does not offer.
    """
    made = fmu("jeffcott", version, blocks=[block])
    made = lacking(made, lacks) if lacks else made
    document = copy.deepcopy(dict(load("jeffcott").document))
    document["blocks"][block] = {"type": "fmu", "file": str(made), "parameters": {"in_process": True, **values}}
    document["identify"].pop("viscous_damping" if block == "rotor" else "", None)
    return load(document, trust_blocks=trust)


@pytest.mark.slow
@BOTH
@REPLACED
def test_a_run_is_that_of_the_plain_diagram(fmu: Make, block: str, version: str) -> None:
    plain, made = (simulate(one, stop=0.02) for one in (load("jeffcott"), with_fmu(fmu, block, version)))
    for name, values in plain.signals.items():
        np.testing.assert_allclose(made.signals[name], values, atol=1e-9 * np.abs(values).max(), rtol=0)


@pytest.mark.parametrize("method", ["dop853", "radau"])
def test_methods_that_choose_their_steps(fmu: Make, method: str) -> None:
    diagrams = load("jeffcott"), with_fmu(fmu, "controller", "3.0")
    plain, made = (simulate(one, stop=0.01, method=method) for one in diagrams)
    for name, values in plain.signals.items():
        np.testing.assert_allclose(made.signals[name], values, atol=1e-5 * np.abs(values).max(), rtol=0)


def test_a_run_without_a_compiler(fmu: Make) -> None:
    diagram = with_fmu(fmu, "controller")
    compiled, interpreted = (simulate(diagram, stop=2e-3, use_compiler=use) for use in (True, False))
    for name, values in compiled.signals.items():
        np.testing.assert_allclose(interpreted.signals[name], values, atol=1e-9 * np.abs(values).max(), rtol=0)


@BOTH
@REPLACED
def test_modes_are_those_of_the_plain_diagram(fmu: Make, block: str, version: str) -> None:
    plain, made = (modes(one) for one in (load("jeffcott"), with_fmu(fmu, block, version)))
    np.testing.assert_allclose(made.real_poles, plain.real_poles, rtol=1e-6)
    np.testing.assert_allclose([m.eigenvalue for m in made.modes], [m.eigenvalue for m in plain.modes], rtol=1e-6)


@BOTH
def test_settled_motion_is_that_of_the_plain_diagram(fmu: Make, version: str) -> None:
    diagrams = load("jeffcott"), with_fmu(fmu, "rotor", version)
    plain, made = (periodic(one, speeds=[150.0], harmonics=9) for one in diagrams)
    for name, values in plain.harmonics.items():
        np.testing.assert_allclose(made.harmonics[name], values, atol=1e-6 * np.abs(values).max(), rtol=0)


def test_where_states_begin_follows_from_parameters(fmu: Make) -> None:
    model = compile_diagram(with_fmu(fmu, "rotor", initial_displacement=[1e-5, -2e-5]))
    part = model.states["rotor.states"].part
    assert model.x0()[part].tolist() == [1e-5, -2e-5, 0.0, 0.0]


@pytest.mark.parametrize("lacks", [(), ("adjoint",), ("directional",), ("directional", "adjoint")])
@pytest.mark.parametrize("way", ["forward", "reverse"])
@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("in_process", [pytest.param(False, marks=pytest.mark.slow), True])
def test_derivatives_are_those_of_the_plain_equations(
    fmu: Make, lacks: tuple[str, ...], way: str, linear: bool, in_process: bool
) -> None:
    """By states, time and parameters: derivatives of the FMU, or central differences, against the trace."""
    diagram = with_fmu(fmu, "rotor", "3.0", lacks=lacks, in_process=in_process, linear=linear)
    offered = tuple(kind for kind in ("directional", "adjoint") if kind not in lacks)
    assert functions_of(diagram.nodes["rotor"].block).equations.offered == offered
    ad = {f"ad_weight{end}": float(way == "reverse") for end in ("", "_sp")}
    found = []
    for model in (compile_diagram(load("jeffcott")), compile_diagram(diagram)):
        t, x, z, p = model.trace.t, model.trace.x, model.trace.z, model.trace.p
        by = ca.vertcat(x, t, p[model.parameters["rotor.mass"]])
        function = MatrixFunction([t, x, z, p], ca.jacobian(model.trace.xdot, by, {"helper_options": ad}))
        for _ in range(2):  # the second time without Python, by instances that the first has made
            J = function(0.01, 1e-5 * np.arange(1, model.n_x + 1), model.z0(), model.p0)
        found.append(J)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6, atol=1e-6 * np.abs(found[0]).max(axis=0).min())


def test_foreign_code_runs_by_consent_alone(fmu: Make) -> None:
    with pytest.raises(RotorsimError) as caught:
        simulate(with_fmu(fmu, "rotor", trust=False))
    assert str(caught.value) == (
        "error: rotor: FMUs are programs; they are not run unless you say so\n\n"
        "hint: if you trust where they come from, add --trust-blocks (trust_blocks=True)"
    )


def test_an_fmu_that_hides_its_states_is_refused(fmu: Make) -> None:
    with pytest.raises(RotorsimError) as caught:
        modes(with_fmu(fmu, "rotor", interface="cs"))
    assert str(caught.value) == (
        "error: rotor: is an FMU for Co-Simulation, which hides its states and equations\n\n"
        'hint: it offers Model Exchange, too: "interface": "me"; `rotorsim run` co-simulates it as it is'
    )


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the plant of tests/fmi/c, which has events, as plant2.fmu and plant3.fmu."""
    folder = tmp_path_factory.mktemp("plants")
    for version in ("2.0", "3.0"):
        make_fmu(folder / f"plant{version[0]}.fmu", version)
    return folder


def of_plant(folder: Path, version: str = "2.0", blocks: Any = None, wires: Any = (), **values: Any) -> Diagram:
    """Return a diagram of the plant alone, or of more blocks."""
    values = {"interface": "me", "in_process": True, **values}
    document = {
        "name": "of_plant",
        "blocks": {"it": {"type": "fmu", "file": f"plant{version[0]}.fmu", "parameters": values}, **(blocks or {})},
        "wires": list(wires),
        "solver": {"step": 1e-3, "stop": 0.5},
        "record": ["it.y"],
    }
    return load(document, folder=folder, trust_blocks=True)


def decay(t: np.ndarray) -> np.ndarray:
    """Return x of x'' = -100 x - 0.5 x', x(0) = 1, x'(0) = 0."""
    a, w = 0.25, np.sqrt(100 - 0.25**2)
    return np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t))


@BOTH
def test_between_events_there_are_equations(plants: Path, version: str) -> None:
    found = simulate(of_plant(plants, version))
    y = found.signals["it.y"].reshape(len(found.time), -1)[:, 0]
    np.testing.assert_allclose(y, decay(found.time), atol=1e-7)


@BOTH
def test_one_file_in_two_blocks_with_parameters_of_their_own(plants: Path, version: str) -> None:
    """x_a'' = -100 x_a - x_a' / 2 drives x_b'' = x_a - 49 x_b - x_b' / 2."""
    parameters = {"interface": "me", "in_process": True, "stiffness": 49.0}
    blocks = {
        "other": {"type": "fmu", "file": f"plant{version[0]}.fmu", "parameters": parameters},
        "gain": {"type": "gain", "parameters": {"gain": "1 N/m"}},
    }
    diagram = of_plant(plants, version, blocks, [["it.y", "gain.input"], ["gain.output", "other.u"]])
    found = simulate(diagram, record=["it.y", "other.y"])

    def slope(_: float, x: np.ndarray) -> list[float]:
        return [x[1], -100 * x[0] - 0.5 * x[1], x[3], x[0] - 49 * x[2] - 0.5 * x[3]]

    x = solve_ivp(slope, (0, 0.5), [1.0, 0.0, 1.0, 0.0], t_eval=found.time, rtol=1e-11, atol=1e-12).y
    for name, right in (("it.y", x[0]), ("other.y", x[2])):
        y = found.signals[name].reshape(len(found.time), -1)[:, 0]
        np.testing.assert_allclose(y, right, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("in_process", [True, False])
def test_an_input_that_is_wired_does_not_begin_with_its_start_value(tmp_path: Path, in_process: bool) -> None:
    """u = 2 of a wire, 3 at the start: x'' = 2 - 100 x - x' / 2. y, said not to follow u, is asked for with u = 3."""
    text = floats_only().replace('start="0" unit="m"', 'start="3" unit="m"')
    make_fmu(tmp_path / "plant2.fmu", description=text)
    blocks = {"in": {"type": "constant", "parameters": {"value": 2.0}}}
    wires = [["in.output", "it.u"]]
    found = simulate(of_plant(tmp_path, "2.0", blocks, wires, in_process=in_process, gain=1.0))
    np.testing.assert_allclose(found.signals["it.y"], 0.02 + 0.98 * decay(found.time) + 3, atol=1e-7)


def test_in_this_process_instances_are_used_again(plants: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A foreign library may keep something of every instance that it makes until there is no more of it."""
    made: list[Slave] = []
    new = Fmu.instantiate
    monkeypatch.setattr(Fmu, "instantiate", lambda self, *how: made.append(new(self, *how)) or made[-1])
    model = compile_diagram(of_plant(plants))
    most = functions_of(model.diagram.nodes["it"].block).equations._most
    for k in range(2 * most):
        p = model.parameter_vector({"it.stiffness": 101.0 + k})
        assert model.rhs(0.0, np.array([1.0, 0.0]), model.z0(p), p)[1] == -101.0 - k
    assert len(made) <= most + 1  # one more tells whether a reset is as good


@pytest.mark.slow
def test_an_input_that_is_taken_at_events_only_hides_the_equations(plants: Path) -> None:
    blocks = {"in": {"type": "constant", "parameters": {"value": 1.0}}}
    diagram = of_plant(plants, "2.0", blocks, [["in.output", "it.level"]])
    with pytest.raises(RotorsimError, match=r"it: is an FMU that takes its input level at events only"):
        modes(diagram)
    assert np.abs(simulate(diagram)["it.y"] - decay(simulate(diagram).time)).max() < 1e-7  # co-simulated


FAULTY = {
    "fail": "fmi2GetDerivatives returned fmi2Error (t = 0.1 s)",
    "nan": "gives der(v) = nan (t = 0.1 s)",
    "segv": "its process was ended by SIGSEGV (it used memory that is not its own), in fmi2GetDerivatives (t = 0.1 s)",
    "discard": "fmi2GetDerivatives returned fmi2Discard (t = 0.1 s)",
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTY)
def test_a_failure_inside_ends_the_run_with_what_there_is(plants: Path, fault: str) -> None:
    diagram = of_plant(plants, in_process=fault in ("fail", "nan"), fault=FAULTS.index(fault), fault_time=0.1)
    found = simulate(diagram)
    said = f"it: {FAULTY[fault]}; what was computed until t = 0.1 s is kept"
    assert (found.status, found.message.partition("\n")[0]) == ("stopped", said)
    assert found.time[-1] == pytest.approx(0.099)
    again = simulate(of_plant(plants, in_process=False))  # nothing is left behind
    np.testing.assert_allclose(again.signals["it.y"], decay(again.time), atol=1e-7)


def test_an_fmu_that_nothing_is_wired_to_needs_consent_too(plants: Path) -> None:
    untrusted = load(dict(of_plant(plants).document), folder=plants)
    for work in (simulate, modes):
        with pytest.raises(RotorsimError, match="FMUs are programs; they are not run unless you say so"):
            work(untrusted)


@BOTH
@pytest.mark.parametrize("in_process", [True, False])
@pytest.mark.parametrize(
    ("signal", "right"), [("x", [1.0, 0.0]), ("der_v_", [-100.0, -0.5]), ("y", [1.0, 0.0]), ("v", [0.0, 1.0])]
)
def test_variables_inside_have_derivatives(
    plants: Path, version: str, in_process: bool, signal: str, right: Any
) -> None:
    """FMI offers no derivatives of those that are no outputs: states, derivatives."""
    document = {**of_plant(plants, version, in_process=in_process).document, "record": [f"it.{signal}"]}
    model = compile_diagram(load(document, folder=plants, trust_blocks=True))
    y = model.expression(f"it.{signal}")[0]
    own = model.trace.x[[0, model.n_x // 2]]  # of FMI 3.0 there are two directions
    arguments = [model.trace.t, model.trace.x, model.trace.z, model.trace.p]
    J = ca.Function("J", arguments, [ca.jacobian(y, own)])
    found = np.array(J(0.1, np.linspace(0.1, 0.4, model.n_x), model.z0(), model.p0)).ravel()
    np.testing.assert_allclose(found, right, atol=1e-6)


@pytest.mark.parametrize("wrong", [("directional",), ("adjoint",), ("directional", "adjoint")])
def test_derivatives_that_are_not_those_of_the_equations_are_not_used(
    fmu: Make, monkeypatch: Any, wrong: tuple[str, ...]
) -> None:
    own = Slave.jacobian
    monkeypatch.setattr(
        Slave, "jacobian", lambda self, of, by, kind: own(self, of, by, kind) * (0.99 if kind in wrong else 1)
    )
    equations = copy.copy(functions_of(with_fmu(fmu, "rotor", "3.0").nodes["rotor"].block).equations)
    equations._slaves, equations._modes, equations._begun = OrderedDict(), {}, {}
    equations.offered, equations._checked, equations.native = ("directional", "adjoint"), False, None
    instead = {"directional": "the adjoint ones", "adjoint": "the directional ones"}
    taken = "central differences" if len(wrong) == 2 else instead[wrong[0]]
    with pytest.warns(RuntimeWarning) as caught:
        equations.rates(0.0, np.zeros(4), np.zeros(2), equations._p.starts)
    said = [str(one.message).removeprefix("rotor: ") for one in caught]
    assert said == [f"its {kind} derivatives are not those of its equations: {taken} are taken" for kind in wrong]
    assert equations.offered == tuple(kind for kind in ("directional", "adjoint") if kind not in wrong)


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_a_failure_at_the_end_is_one(plants: Path, method: str) -> None:
    """The last row is recorded behind the last step."""
    found = simulate(of_plant(plants, fault=FAULTS.index("fail"), fault_time=0.0995), stop=0.1, method=method)
    assert (found.status, np.isfinite(found.signals["it.y"]).all()) == ("stopped", True)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "radau", "lsoda"])
def test_what_was_computed_until_a_failure_is_kept(plants: Path, method: str) -> None:
    """Without events an adaptive method goes through the whole run at one stretch."""
    found, whole = (
        simulate(of_plant(plants, fault=FAULTS.index(fault), fault_time=0.0995), stop=0.5, method=method)
        for fault in ("fail", "ok")
    )
    assert (found.status, len(found.time) > 95, found.time[-1] < 0.0995) == ("stopped", True, True)
    np.testing.assert_array_equal(found.signals["it.y"], whole.signals["it.y"][: len(found.time)])
    assert "; what was computed until t = 0.09" in found.message


def test_the_command_says_what_failed_and_where_the_rest_is(plants: Path, run: Any) -> None:
    diagram = of_plant(plants, fault=FAULTS.index("fail"), fault_time=0.1)
    make_fmu(Path("plant2.fmu"))
    Path("it.json").write_text(json.dumps(dict(diagram.document)))
    done = run("run", "it.json", "--trust-blocks", "--out", "it.csv")
    assert done.exit_code == 1
    assert done.stderr.endswith(
        "error: of_plant: it: fmi2GetDerivatives returned fmi2Error (t = 0.1 s); what was computed until t = 0.1 s "
        "is kept\n\nhint: what was computed until then is in it.csv\n"
    )
    assert len(np.loadtxt("it.csv", delimiter=",", skiprows=1)) == 100


@pytest.mark.slow
@pytest.mark.parametrize("here", [True, False])
def test_the_equations_of_fmi_1(tmp_path: Path, here: bool) -> None:
    """x'' = -x: cos t, and a mode of 1 / (2 pi) Hz by central differences; ticks of a clock add up to a broken line."""
    file = events_fmu(tmp_path, "1.0")
    diagram = alone(file, "two", step=0.05, stop=1.0, low=-9.0, in_process=here)
    found = simulate(diagram)
    assert found["it.x"] == pytest.approx(np.cos(found.time), abs=0.05**4 / 120)
    assert cosimulate_diagram(diagram, step=0.05)["it.x"] == pytest.approx(found["it.x"], abs=1e-14)
    assert modes(diagram).modes[0].frequency_hz == pytest.approx(1 / (2 * np.pi), rel=1e-8)
    found = simulate(alone(file, "clock", step=0.05, stop=1.0, tick=0.13, in_process=here))
    n = np.floor(found.time / 0.13 + 1e-9)
    assert found["it.x"] == pytest.approx(1 + n * found.time - 0.13 * n * (n + 1) / 2, rel=1e-12)


def test_many_points_are_evaluated_in_c(fmu: Make) -> None:
    """The virtual machine of CasADi, for 10 000 calls of parts, and then the compiled function: the same numbers."""
    model = compile_diagram(with_fmu(fmu, "rotor"))
    trace, n = model.trace, 7
    x = 1e-5 * np.random.default_rng(0).standard_normal((model.n_x, n))
    given = np.linspace(0.0, 0.1, n)[None], x, model.z0(), model.p0
    found = []
    for more in (0, 1):
        function = MatrixFunction([trace.t, trace.x, trace.z, trace.p], ca.jacobian(trace.xdot, trace.x))
        function._calls = 10_000 - (n + 1) * function._called + more
        found.append((function(*given), function(0.1, x[:, 0], model.z0(), model.p0)))
        assert ("_compiled" in vars(function)) == bool(more)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())
