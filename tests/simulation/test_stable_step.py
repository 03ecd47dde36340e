"""Steps that hold for a diagram to which something fast has been added."""

import json

import numpy as np
import pytest

from rotorsim.linear.stability import step_factor
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from rotorsim.simulation.stable_step import stable_steps, with_stable_step


def chain(rate, **solver):
    """Return x' = -rate x, of which no step above 2.785 / rate holds."""
    blocks = {
        "lag": {"type": "integrator", "parameters": {"initial": 1.0}},
        "back": {"type": "gain", "parameters": {"gain": -rate}},
    }
    wires = [["lag.output", "back.input"], ["back.output", "lag.input"]]
    given = {"step": "1 ms", "stop": "0.1 s", **solver}
    return load({"schema_version": 1, "name": "chain", "blocks": blocks, "wires": wires, "solver": given})


@pytest.mark.parametrize(("rate", "parts"), [(2700.0, 1), (2800.0, 2), (1e4, 4)])
def test_a_step_is_divided_into_the_fewest_that_hold(rate, parts):
    found = stable_steps(chain(rate, record_every=3))
    assert found == ({} if parts == 1 else {"step": pytest.approx(1e-3 / parts), "record_every": 3 * parts})
    factors = step_factor(-rate * 1e-3 / np.array([parts, max(parts - 1, 0.5)]))
    assert factors[0] <= 1 < factors[1]
    assert simulate(chain(rate, **found)).status == "finished"


def test_of_more_than_a_hundred_parts_radau_takes_less_time():
    assert stable_steps(chain(2785.29 * 100.0)) == {"step": pytest.approx(1e-3 / 100), "record_every": 100}
    assert stable_steps(chain(2785.30 * 100.0)) == {"method": "radau"}


def test_no_step_is_changed_where_that_would_not_help():
    assert stable_steps(chain(-10.0)) == {}  # it grows
    assert stable_steps(chain(1e4, method="radau")) == {}
    assert stable_steps(load("jeffcott")) == {}


def test_a_document_gets_a_step_that_its_finer_mesh_wants():
    """FAULT: repaired beams, whose meshes had been refined, diverged at the step of the diagram as given."""
    document = json.loads(json.dumps(load("fe_rigid").document))
    assert with_stable_step(document, load(document)) == document
    for parts, method in ((2, "rk4"), (4, "rk4"), (8, "radau")):
        document["blocks"]["rotor"]["parameters"]["subdivisions"] = parts
        assert simulate(load(document), stop=0.01).status == "diverged"
        found = with_stable_step(document, load(document))
        assert found["solver"]["method"] == method
        assert simulate(load(found), stop=0.01).status == "finished"
    assert found["solver"] == {**document["solver"], "method": "radau"}
