"""Harmonics together with how 1X drifts within the runs: predictions, derivatives, and rows without a drift."""

import numpy as np
import pytest
from scipy.linalg import expm

from rotorsim.identification.harmonic.drifting import DriftingLikelihood
from rotorsim.settled.growing import DEGREES, _modes, decay_course
from tests.diagnosis.test_nothing import bow, source
from tests.identification import shipped

T = 0.4995
NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
LEGENDRE = np.polynomial.legendre.legvander(NODES, DEGREES).T


@pytest.mark.parametrize(
    "u", [0.0, 1e-6, 1e-3, 0.1, 7.0, 80.0, -2.0, 3 + 40j, 0.5 - 200j, -1 + 9j, 1e5 + 2e5j, 1e12 + 1j]
)
@pytest.mark.parametrize("n", range(DEGREES + 1))
def test_a_decay_in_legendre_polynomials(n, u):
    if abs(u) > 1e3:  # by its start alone
        exact = (2 * n + 1) * (-1) ** n / u * (1 - n * (n + 1) / u)
    else:
        exact = (2 * n + 1) / 2 * (WEIGHTS * LEGENDRE[n]) @ np.exp(-u * (1 + NODES) / 2)
    assert decay_course(np.array([u + 0j]), n)[0] == pytest.approx(exact, rel=1e-7, abs=1e-6)


@pytest.mark.parametrize("time_constant", [0.02, 0.4, 10.0])
def test_1x_is_what_an_integration_in_time_gives(time_constant):
    """Of the machine's matrices, settled before the bow begins to grow, by exponentials of steps of 0.1 ms."""
    plain, _ = bow(2e-6, time_constant)
    experiment = plain.experiment
    found = DriftingLikelihood(experiment)._course(experiment.theta0).values
    base = source("jeffcott").load(shipped("jeffcott").document)
    loop = source("jeffcott").open(base, inject=["rotor.force"])
    linear = loop.linear.response(loop.theta0)
    b = 7.6e5 * 2e-6 * np.exp(0.7j) / 2 * np.array([1.0, -1j])  # of x and y at 1X
    count = 4995
    t = T * (np.arange(count) + 0.5) / count
    legendre = np.polynomial.legendre.legvander(2 * t / T - 1, DEGREES)
    for r, item in enumerate(experiment.runs):
        A, B, C, D = (getattr(linear, key)[r] for key in "ABCD")
        assert not D.any()
        turning = A - 1j * item.fit.speed * np.eye(len(A))  # of the vector that turns with the shaft
        F = B @ b
        step = T / count
        forward = expm(np.block([[turning * step, np.eye(len(A)) * step], [np.zeros((len(A), 2 * len(A)))]]))
        power, mean = forward[: len(A), : len(A)], forward[: len(A), len(A) :]
        X, course = np.zeros(len(A), complex), np.zeros((count, len(C)), complex)
        for k in range(count):
            half = X + step / 2 * (turning @ X + F * -np.expm1(-(t[k] - step / 4) / time_constant))
            course[k] = C @ half
            X = power @ X + mean @ F * -np.expm1(-t[k] / time_constant)
        course += C @ np.linalg.solve(turning, F) * (-np.expm1(-t / time_constant)).mean()  # less that of the mean
        for n in range(DEGREES + 1):
            size = (2 * n + 1) / count * legendre[:, n] @ course
            np.testing.assert_allclose(found[r, n], size, atol=2e-3 * np.abs(found[r, 1]).max())


def test_derivatives_are_those_of_differences_and_rows_stand_behind_those_of_each_run():
    plain, places = bow(2e-6, 0.4)
    likelihood = DriftingLikelihood(plain.experiment)
    theta = plain.experiment.theta0
    found, harmonics = likelihood.evaluate(theta), plain.evaluate(theta)
    assert [more - size for more, size in zip(likelihood.sizes, plain.sizes, strict=True)] == [
        2 * DEGREES * plain.c
    ] * 2
    assert [drift.told for drift in likelihood.drifts] == [False, True]  # 7.5 turns are too few for degree four
    assert found.rows == harmonics.rows + DEGREES * (2 * plain.c - 1)  # an angle that is loose takes one of each
    first = found.residual[: likelihood.sizes[0]][: plain.sizes[0]]
    assert np.linalg.norm(first - harmonics.residual[: plain.sizes[0]]) < 0.2 * np.linalg.norm(first)  # but for the lag
    for j in places:
        step = 1e-5 * theta[j] * (np.arange(len(theta)) == j)
        slope = likelihood.evaluate(theta + step).residual - likelihood.evaluate(theta - step).residual
        near = found.jacobian[:, j] * 2 * step[j]
        assert np.linalg.norm(slope - near) < 1e-3 * np.linalg.norm(slope)


def test_the_drift_follows_a_parameter_that_the_block_shares_with_the_diagram():
    """FAULT: of a time constant given as "$tau" the derivatives were zero."""
    plain, _ = bow(2e-6, 0.4)
    document = dict(plain.experiment.diagram.document)
    block = document["blocks"]["thermal_bow"]
    shared = {**block, "parameters": {**block["parameters"], "time_constant": "$tau"}}
    free = {("tau" if name == "thermal_bow.time_constant" else name): v for name, v in document["identify"].items()}
    columns = []
    for name, more in (
        ("thermal_bow.time_constant", {}),
        (
            "tau",
            {
                "blocks": {**document["blocks"], "thermal_bow": shared},
                "parameters": {**document["parameters"], "tau": f"{block['parameters']['time_constant']} s"},
                "identify": free,
            },
        ),
    ):
        evidence = source("jeffcott")
        experiment = evidence.open(evidence.load({**document, **more}))
        j = [item.name for item in experiment.free].index(name)
        columns.append(DriftingLikelihood(experiment).evaluate(experiment.theta0).jacobian[:, j])
    np.testing.assert_allclose(columns[1], columns[0], atol=1e-6 * np.abs(columns[0]).max())


def test_a_machine_in_which_nothing_grows_has_no_drift():
    plain, _ = bow(2e-6, 0.4)
    likelihood = DriftingLikelihood(plain.experiment)
    theta = plain.experiment.theta0.copy()
    theta[[item.name.endswith(".growth") for item in plain.experiment.free].index(True)] = 1e-15
    found = likelihood.evaluate(theta)
    drift = found.misfit - plain.evaluate(theta).misfit
    assert (drift < 2 * DEGREES * (2 * plain.c - 1)).all()  # noise alone: chi-squared


def test_modes_that_are_no_base_are_refused():
    """Two equal lags in a chain have one mode: what their modes make of it is nothing like it."""
    with pytest.raises(np.linalg.LinAlgError, match="modes of the machine are no base of its motion"):
        _modes(np.array([[-50.0, 50.0], [0.0, -50.0]]).tobytes(), 2)


def test_the_motion_elsewhere_does_not_begin_from_measured_runs():
    """FAULT: curves over speed of a nonlinear repair ended with shapes that do not fit."""
    plain, _ = bow(2e-6, 0.4)
    motion, count = plain.experiment.motion, 5
    speeds = np.linspace(95.0, 250.0, count)
    there = motion.elsewhere(np.repeat(motion.p[:1], count, 0), speeds, 3, 0, None)
    assert there.predict(plain.experiment.theta0).Y.shape[:2] == (count, 4)
