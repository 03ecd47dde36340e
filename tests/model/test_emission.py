"""What the C emitter rearranges: collapsed gains and steps, chunks; the values must stay."""

import numpy as np
import pytest

from rotorsim.model.compiled import compile_diagram
from rotorsim.model.emit import emit, writer
from rotorsim.model.emit.affine import state_operations
from rotorsim.model.instance import CompiledInstance, InterpretedInstance
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

NAMES = ("jeffcott", "jeffcott_elementary", "offset_disc", "fe_rigid", "fe_flexible", "jeffcott_runup")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_c_right_hand_side_is_the_traced_one(name):
    model = compile_diagram(load(name))
    rng = np.random.default_rng(3)
    t, x = rng.uniform(0, 1, 4), rng.normal(size=(4, model.n_x)) * 1e-5
    p = np.repeat(model.p0[None], 4, 0)
    expected = np.array([np.array(model.rhs(t[k], x[k], np.zeros(0), p[k])).ravel() for k in range(4)])
    found = model.rhs_batch(t, x, np.zeros(0), p)
    scale = np.abs(expected).max(axis=0) + 1e-300
    assert np.abs((found - expected) / scale).max() < 1e-9  # stiff rows cancel: terms are 1e4 times their sum


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name.startswith("fe") else name for name in NAMES]
)
def test_the_unrolled_step_the_chunked_one_and_the_virtual_machine_agree(name, monkeypatch):
    stop = 2e-3 if name.startswith("fe") else 2e-2
    unrolled = simulate(load(name), stop=stop)
    machine = simulate(load(name), stop=stop, use_compiler=False)
    monkeypatch.setattr(emit, "UNROLL_LIMIT", 0)
    monkeypatch.setattr(writer, "STATEMENTS_PER_FUNCTION", 7)  # every function is cut into many
    chunked = simulate(load(name), stop=stop)
    for signal, values in unrolled.signals.items():
        scale = np.abs(values).max()
        assert np.abs(values - machine[signal]).max() <= 1e-11 * scale
        assert np.abs(values - chunked[signal]).max() <= 1e-11 * scale


def test_gains_in_series_are_one_coefficient_for_each_state():
    kernel = compile_diagram(load("jeffcott")).kernel(("rotor.displacement",))
    # u'' = g(t) + a u + b u' + c int u on two axes: three products and three sums each
    assert state_operations(kernel.program, kernel.xdot) == 12


def test_the_elementary_diagram_costs_what_the_blocks_cost():
    one, two = (
        compile_diagram(load(name)).kernel(("rotor.displacement", "controller.current"))
        for name in ("jeffcott", "jeffcott_elementary")
    )
    assert state_operations(one.program, one.xdot) == state_operations(two.program, two.xdot)
    assert len(one.forcing) == len(two.forcing)


@pytest.mark.slow
def test_a_finite_element_rotor_keeps_its_banded_solution():
    cost = {}
    for n in (10, 20, 40):
        changes = {"rotor.elements": n, "rotor.element_length": 0.5 / n, "rotor.pinned_nodes": [1, n + 1]}
        kernel = compile_diagram(load("fe_rigid", set=changes)).kernel(())
        cost[n] = state_operations(kernel.program, kernel.xdot)
    assert cost[40] - cost[20] == pytest.approx(2 * (cost[20] - cost[10]), rel=0.02)


def test_both_instances_start_alike():
    model = compile_diagram(load("jeffcott"))
    names = model.record_names()
    library = model.library(names)
    if library is None:
        pytest.skip("no C compiler on this machine")
    one, two = CompiledInstance(model, library, model.p0), InterpretedInstance(model, names, model.p0)
    assert np.array_equal(one.x, two.x)
    x = np.linspace(-1e-5, 1e-5, model.n_x)
    assert np.allclose(one.derivative(0.3, x), two.derivative(0.3, x), rtol=1e-12, atol=1e-12)
    assert np.allclose(one.record(0.3, x), two.record(0.3, x), rtol=1e-12)


def test_a_linear_step_is_one_sum() -> None:
    """Three states of each axis: stage by stage 4 x 12 operations and 72 of sums between them; at once half of that."""
    for name in ("jeffcott", "jeffcott_elementary"):
        kernel = compile_diagram(load(name)).kernel(())
        step = emit.step_program(kernel)
        assert state_operations(kernel.program, kernel.xdot) == 12
        assert state_operations(step.program, step.new) <= (4 * 12 + 72) / 2


def test_the_motion_does_not_depend_on_what_is_recorded() -> None:
    """To the last bit, also where what is recorded moves the places of the forcing."""
    plain = simulate(load("jeffcott"), stop=0.1, record=["rotor.displacement"])
    other = simulate(load("jeffcott"), stop=0.1, record=["clock.theta", "crack.force", "rotor.displacement[2]"])
    np.testing.assert_array_equal(other["rotor.displacement[2]"], plain["rotor.displacement"][:, 1])
