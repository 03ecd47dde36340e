"""Parameters at their bounds, or of which the data say nothing: they move again, and no interval is empty."""

from copy import copy

import numpy as np
import pytest

from rotorsim.block import Param
from rotorsim.diagram.diagram import Free
from rotorsim.identification.files import identification_data
from rotorsim.identification.harmonic.coordinates import Coordinates, stretched
from rotorsim.identification.harmonic.estimate import Estimate, Search
from rotorsim.identification.harmonic.likelihood import Evaluation
from rotorsim.identification.harmonic.profile import linear_intervals, profile_intervals
from rotorsim.identification.identification import identify
from rotorsim.identification.verdict import judge
from tests.identification import OTHER_GAINS, TRUTH, changed, errors, made, recorded
from tests.reference.recordings import LOWER, THESIS_GAINS

RISE = 2.705543  # of chi-squared of one parameter, 90 %
COLLAPSED = {"viscous_damping": 1e-40, "force_displacement_factor": 1e-13}


def collapsed():
    return changed("jeffcott", lambda document: document["parameters"].update(COLLAPSED))


def test_values_that_an_earlier_fit_brought_to_nothing_are_found_again():
    """Scaled by themselves they moved nothing, and were left where they were."""
    gains = (THESIS_GAINS, OTHER_GAINS)
    runs = [run for some in gains for run in made("jeffcott", LOWER["jeffcott"][::4], TRUTH, gains=some)]
    assert max(errors(identify(collapsed(), recorded(runs), profile=False)).values()) < 1e-3


def test_the_size_of_a_value_that_says_nothing_is_what_its_block_declares():
    scales = {item.name: item.scale for item in collapsed().free}
    assert scales["force_displacement_factor"] == 105210.0
    assert scales["viscous_damping"] == 76.0
    assert scales["eccentricity"] == 24e-6  # as given

    def bent(document, amplitude):
        document["blocks"]["bow"] = {"type": "residual_bow", "parameters": {"amplitude": amplitude}}
        document["wires"] += [["clock.theta", "bow.theta"], ["bow.force", "rotor.force"]]
        document["identify"] = {"bow.amplitude": {}}

    for amplitude, scale in ((0.0, 1e-6), (1e-20, 1e-6), (2e-8, 2e-8), (3e-5, 3e-5)):
        [item] = changed("jeffcott", lambda document, a=amplitude: bent(document, a)).free
        assert item.scale == scale


class Straight:
    """A search whose residual is J q - y, q of theta in its coordinates, which may be others than it was made with."""

    def __init__(self, J, y, scale, low, high, pairs=(), series=()) -> None:
        self.J, self.y = np.asarray(J, float), np.asarray(y, float)
        scale, low, high = (np.asarray(part, float) for part in (scale, low, high))
        self.coordinates = self.own = Coordinates(scale, pairs, low, high, series)

    def in_coordinates(self, coordinates):
        other = copy(self)
        other.coordinates = coordinates
        return other

    def residual(self, q):
        return self.J @ self.own.inside(self.coordinates.outside(q)) - self.y

    def jacobian(self, q):
        theta = self.coordinates.outside(q)
        return self.J @ np.linalg.inv(self.own.jacobian(theta)) @ self.coordinates.jacobian(theta)

    def found(self, q) -> Estimate:
        c = self.coordinates
        free = tuple(
            Free(f"p{k}", f"p{k}", 0, 1.0, "m", low, high, scale=scale, series=k in c.series)
            for k, (low, high, scale) in enumerate(zip(c.low, c.high, c.scale, strict=True))
        )
        r = self.residual(q)
        evaluation = Evaluation(r, self.J, np.array([r @ r]), np.zeros(0), len(r))
        at_bound = c.at_bound(q, 1e-6)
        return Estimate(free, c.outside(q), c, evaluation, self.J.T @ self.J, at_bound, r @ r, 1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_interval_at_a_bound_has_one_side(side):
    """Of x with the free estimate -0.5 std beyond the bound 0: up to where (x + 0.5)^2 - 0.5^2 is 2.71, in std."""
    J = np.array([[2.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    y = J @ [-side * 0.25, 3.0]  # std of the first: 1/2
    ends = (0.0, np.inf) if side > 0 else (-np.inf, 0.0)
    search = Straight(J, y, (1e-6, 1.0), (ends[0], -9.0), (ends[1], 9.0))
    found = search.found(np.array([0.0, 3.0]))
    assert found.at_bound.tolist() == [True, False]
    assert found.std[0] == 0.0
    intervals = linear_intervals(search, found)
    far = side * 0.5e-6 * (np.sqrt(RISE + 0.25) - 0.5)
    assert sorted(intervals[0]) == pytest.approx(sorted((0.0, far)), rel=1e-6, abs=1e-20)
    assert intervals[1] == pytest.approx((3 - 1.644854 / np.sqrt(2), 3 + 1.644854 / np.sqrt(2)), rel=1e-6)


def test_an_interval_at_a_bound_lets_the_others_follow():
    """With a partner of correlation -0.8 the profile rises as 0.36 of the square."""
    J = np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]])).T
    search = Straight(J, np.zeros(2), (1.0, 1.0), (0.0, -9.0), (np.inf, 9.0))
    intervals = linear_intervals(search, search.found(np.zeros(2)))
    assert intervals[0] == pytest.approx((0.0, np.sqrt(RISE / 0.36)), rel=1e-6)


def test_what_the_data_say_nothing_about_has_no_finite_interval():
    """Two parameters that are one number, one that nothing depends on, and one that is known to a half."""
    J = np.array([[3.0, 6e4, 0.0, 0.0], [1.0, 2e4, 0.0, 2.0], [1.0, 2e4, 0.0, -1.0]])
    search = Straight(J, np.zeros(3), (1.0, 1.0, 1.0, 1.0), (0.0, *3 * [-np.inf]), 4 * [np.inf])
    found = search.found(np.array([0.5, 0.0, 0.0, 0.0]))
    assert found.undetermined.tolist() == [True, True, True, False]
    assert np.isinf(found.std[:3]).all()
    # (1, 2) projected off (1, 1, 3) / sqrt 11, with -1: |(2, -1)|^2 - 1 / 11
    assert found.std[3] == pytest.approx(1 / np.sqrt(5 - 1 / 11), rel=1e-9)
    intervals = linear_intervals(search, found)
    assert intervals[0].tolist() == [0.0, np.inf]
    assert intervals[1].tolist() == [-np.inf, np.inf]


def test_a_small_slope_is_no_ignorance():
    """A parameter known to 1 % is known, beside one that is known to 1e-11."""
    search = Straight(np.diag([1e11, 100.0]), np.zeros(2), (1.0, 1.0), (-9, -9), (9, 9))
    found = search.found(np.array([0.1, 0.2]))
    assert found.std == pytest.approx([1e-11, 0.01], rel=1e-9)


def test_an_amplitude_has_a_largest_value_in_every_direction():
    pair = Coordinates(np.array([2.0, 2.0]), ((0, 1),), np.array([0.0, -np.inf]), np.array([10.0, np.inf]))
    low, high = pair.bounds
    assert low.tolist() == [-5.0, -5.0]
    assert high.tolist() == [5.0, 5.0]
    assert pair.outside(np.array([3.0, 3.9])) == pytest.approx([2 * np.hypot(3.0, 3.9), np.arctan2(3.9, 3.0)])
    assert pair.outside(np.array([-4.0, 4.0])) == pytest.approx([10.0, 0.75 * np.pi])
    assert pair.at_bound(np.array([-4.0, 4.0]), 1e-6).tolist() == [True, False]
    assert pair.at_bound(np.array([0.0, 4.9]), 1e-6).tolist() == [False, False]


def test_an_identification_says_what_is_at_its_bound():
    """Without damping in the truth the estimate is at zero or above: the interval has a width, the flag says where."""
    truth = TRUTH.changed({"viscous_damping": 0.0})
    recording = recorded(made("jeffcott", LOWER["jeffcott"][::4], truth, level=0.02, seed=4))
    found = identify(collapsed(), recording, profile=False)
    item = found.parameters["viscous_damping"]
    data = identification_data(found)["parameters"]
    assert [name for name, said in data.items() if said["at_bound"]] == ["viscous_damping"]
    assert item.value < 1e-4
    low, high = item.interval90
    assert low == 0.0
    assert high > 0.01
    assert item.std == pytest.approx(high / 1.644854, rel=1e-3)
    assert data["viscous_damping"]["interval90"] == [low, high]


def test_the_search_moves_off_a_bound():
    """From the bound itself, where the data want it elsewhere."""
    search = object.__new__(Search)
    straight = Straight(
        np.array([[1e6, 1.0], [0.0, 1e-2]]), [1e6 * 0.3 + 2.0, 2e-2], (1.0, 1.0), (0.0, 0.0), (9.0, 9.0)
    )
    search.coordinates, search.residual, search.jacobian = straight.coordinates, straight.residual, straight.jacobian
    assert search.minimise(np.array([0.1, 0.0])) == pytest.approx([0.3, 2.0], rel=1e-6)


def test_what_is_in_series_is_sought_by_its_reciprocal():
    """q = k / (k + k_0): a step in q is one in the compliance where k is large; above 1e6 k_0 it is rigid."""
    support = Coordinates(np.array([5e8]), (), np.array([0.0]), np.array([np.inf]), (0,))
    k = np.array([1e8, 5e8, 4e12])
    q = np.array([support.inside(np.array([value]))[0] for value in k])
    assert q == pytest.approx([1 / 6, 1 / 2, 4e12 / (4e12 + 5e8)], rel=1e-12)
    assert [support.outside(np.array([at]))[0] for at in q] == pytest.approx(k.tolist(), rel=1e-9)
    assert support.bounds[0].tolist() == [0.0]
    assert 1 - support.bounds[1] == pytest.approx(1e-6, rel=1e-4)
    step = 1e-7
    slope = (support.outside(q[:1] + step) - support.outside(q[:1] - step)) / (2 * step)
    assert support.jacobian(k[:1])[0] == pytest.approx(slope, rel=1e-6)
    assert support.moved(5e8, 0, -0.25) == pytest.approx(5e8 / 3)
    assert support.moved(5e14, 0, 1e-3) == np.inf


@pytest.mark.slow
def test_a_support_that_an_earlier_fit_made_rigid_is_soft_again():
    """FAULT: in the stiffness itself nothing led back from there; k moved by nothing, and all others adapted."""
    rigid = ["1e14 N/m", "5e13 N/m"]

    def change(document):
        document["blocks"]["support_left"]["parameters"]["stiffness"] = rigid

    runs = made("fe_flexible", LOWER["fe_flexible"][::2], TRUTH, gains=THESIS_GAINS)
    found = identify(changed("fe_flexible", change), recorded(runs), profile=False)
    k = [found.parameters[f"support_left.stiffness[{axis}]"].value for axis in (1, 2)]
    assert k == pytest.approx([455e6, 1010e6], rel=0.03)


@pytest.mark.parametrize("widen", [1.0, 3.0])
@pytest.mark.parametrize(("q", "std"), [(2 / 3, 0.02), (0.95, 0.1), (1 - 1e-6, 0.1), (1 - 1e-6, 0.01)])
def test_intervals_of_what_is_in_series_are_those_of_its_compliance(q, std, widen):
    """k is between those of q -+ 1.64 std, and may be infinite; FAULT: profiles stepped in k, and left out 1e12 N/m."""
    search = Straight([[1 / std]], [q / std], [5e8], [0.0], [np.inf], series=(0,))
    estimate = search.found(np.array([q]))
    low, high = q - 1.644854 * std * widen, q + 1.644854 * std * widen
    expected = 5e8 * low / (1 - low), 5e8 * high / (1 - high) if high < 1 else np.inf
    assert profile_intervals(search, estimate, widen)[0] == pytest.approx(expected, rel=1e-4)
    linear = linear_intervals(search, estimate)[0]
    k = estimate.theta[0]
    assert [stretched(estimate.free[0], k, end, widen) for end in linear] == pytest.approx(expected, rel=1e-4)


def test_what_is_rigid_is_said_to_be():
    search = Straight([[10.0]], [10.0], [5e8], [0.0], [np.inf], series=(0,))
    estimate = search.found(np.array([1 - 1e-6]))
    [verdict] = judge(estimate, linear_intervals(search, estimate))
    assert verdict.reason == "it is as good as rigid: the data say only that it is above 2.53978 Gm"
    assert not verdict.identifiable


def test_what_is_in_series_cannot_be_negative():
    with pytest.raises(ValueError, match="what is in series cannot be negative: low or above must say so"):
        Param(5e8, unit="N/m", series=True)


@pytest.mark.parametrize("angle", np.radians([0, 100, 180, 250]))
def test_the_interval_of_an_amplitude_at_its_bound_does_not_depend_on_its_angle(angle):
    """5 um, std 0.1, data at 5.05. FAULT: of a cosine below zero the interval began at zero."""
    both = np.array([np.cos(angle), np.sin(angle)])
    bounds = (0.0, -np.inf), (5e-6, np.inf)
    search = Straight(10 * np.eye(2), 10 * 5.05 * both, (1e-6, 1e-6), *bounds, pairs=((0, 1),))
    low, high = linear_intervals(search, search.found(5 * both))[0]
    assert high == pytest.approx(5e-6)
    assert low == pytest.approx(5e-6 - 0.1e-6 * (np.sqrt(RISE + 0.25) - 0.5), rel=1e-9)
