"""FMUs that fail in the middle of fits: each failure is said, the rest goes on, and nothing is left behind."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rotorsim.diagnosis.conclude.result import untried_of
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.fit import Fit, failed_fit, fit_from_plain, fit_to_plain
from rotorsim.diagnosis.search import work
from rotorsim.diagnosis.search.work import DIED, Work
from rotorsim.errors import Place, RotorsimError
from rotorsim.fmi.functions import close_instances
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.printing import Printed
from rotorsim.identification.identification import identify
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.jobs.jobs import Failure, Jobs
from rotorsim.model.heard import GIVEN_UP, Mishap, hearing, remark, surviving, tell
from rotorsim.recordings.loading import load_recording
from tests.fmi.plant import FAULTS, make_fmu
from tests.fmi.runtime.test_process import clean  # noqa: F401 - a fixture
from tests.fmi.test_fits import BEYOND, driven, folder, found_right  # noqa: F401 - a fixture
from tests.fmi.test_numbers import equations_of

FAILED = FmuError("fmi2GetDerivatives returned fmi2Error", kind="error", name="it", place=Place("a.fmu"), time=0.5)


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("plants")
    make_fmu(made / "plant2.fmu")
    (made / "once").mkdir()
    make_fmu(made / "once" / "plant2.fmu", once=True)
    return made


# -- what is heard -----------------------------------------------------------------------------------------------------


def test_failures_of_a_fit_are_counted_and_said_once() -> None:
    with hearing() as heard:
        for _ in range(3):
            tell(FAILED)
        remark("it", "cannot be reset")
        remark("it", "cannot be reset")
    assert [str(problem) for problem in heard.problems()] == [
        "a.fmu: warning: it: fmi2GetDerivatives returned fmi2Error (t = 0.5 s): 3 trials failed so, and other values "
        "were tried",
        "warning: it: cannot be reset",
    ]
    one = Mishap("it", "error", "fails\n  it said: no", "a.fmu").problem()
    assert one.what == "fails: 1 trial failed so, and other values were tried\n  it said: no"


def test_what_nobody_hears_is_a_warning() -> None:
    with pytest.warns(RuntimeWarning, match="it: cannot be reset"):
        remark("it", "cannot be reset")


def test_starts_at_which_it_fails_are_lost_alone() -> None:
    def followed(start: int) -> int:
        if start < 0:
            raise FAILED if start > -9 else FmuError("no more", kind=GIVEN_UP, name="it", place=Place("a.fmu"))
        return 2 * start

    assert [*surviving(followed, [-1, 2, -3, 4])] == [4, 8]
    assert [*surviving(followed, [])] == []
    with pytest.raises(FmuError, match="fmi2GetDerivatives returned fmi2Error"):
        [*surviving(followed, [-1, -2])]
    with pytest.raises(FmuError, match="no more"):
        [*surviving(followed, [1, -9, 2])]


def test_the_values_at_which_it_failed_are_said(plants: Path) -> None:
    """Those that a fit has moved; where it begins, those that the diagram gives."""
    equations = equations_of(plants, in_process=True, fault=FAULTS.index("fail"), fault_above=110.0, label="values")
    u, p = np.nan_to_num(equations._u.starts), equations._p.starts.copy()
    names = equations._p.names
    p[names.index("fault_above")], p[names.index("fault")] = 110.0, FAULTS.index("fail")
    moved = p.copy()
    moved[names.index("stiffness")], moved[names.index("damping")] = 140.25, 0.75
    with hearing():
        equations.rates(0.0, np.zeros(2), u, p)
        with pytest.raises(FmuError) as caught:
            equations.rates(0.25, np.zeros(2), u, moved)
    said = "fmi2GetDerivatives returned fmi2Error (t = 0.25 s) with stiffness = 140.25, damping = 0.75"
    assert caught.value.problems[0].what == said
    with hearing(), pytest.raises(FmuError) as caught:
        equations.rates(0.25, np.zeros(2), u, moved)
    assert caught.value.problems[0].what == f"{said}, fault = 3, fault_above = 110"
    with pytest.raises(FmuError) as caught:  # in a run
        equations.rates(0.25, np.zeros(2), u, moved)
    assert caught.value.problems[0].what == "fmi2GetDerivatives returned fmi2Error (t = 0.25 s)"
    equations.close()


def test_what_a_flood_is_cut_to(tmp_path: Path) -> None:
    (tmp_path / "printed").write_bytes(b"".join(b"%09d\n" % k for k in range(100_000)))
    printed = Printed((tmp_path / "printed").open("rb")).close().splitlines()
    assert (printed[0], printed[201], printed[-1]) == ("000000000", "(996000 more bytes)", "000099999")
    error = FmuError("fails", kind="crash", name="it", place=Place("a.fmu"), printed=printed)
    lines = error.problems[0].what.splitlines()
    assert lines[:3] == ["fails", "  it printed: 000000000", "  it printed: (397 more)"]
    assert lines[3:] == [f"  it printed: 0000{k}" for k in range(99_996, 100_000)]


# -- identify ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_search_that_would_go_on_where_it_fails_is_no_result(folder: Path) -> None:  # noqa: F811
    """The spring of 130 N/m is beyond what the FMU does: all that is below fits less well, which says nothing."""
    values = {**BEYOND, "fault": FAULTS.index("discard"), "fault_above": 120.0}
    with pytest.raises(RotorsimError) as caught:
        identify(driven(folder, **values), load_recording(folder))
    assert caught.value.exit_code == 1
    said = str(caught.value)
    assert said.startswith(
        f"{folder}/plant2.fmu: error: it: the search ends where it fails, and would go on beyond: "
        "fmi2GetDerivatives returned fmi2Discard (t = "
    )
    assert " with stiffness = 1" in said


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["segv", "leave_well", "flood", "hang"])
def test_an_fmu_in_a_process_of_its_own_ends_no_fit(
    clean: Path,  # noqa: F811 - no process, file or descriptor is left
    folder: Path,  # noqa: F811
    fault: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    diagram = driven(folder, in_process=False, fault=FAULTS.index(fault), timeout=5, **BEYOND)
    found = identify(diagram, load_recording(folder))
    close_instances()
    assert found_right(found)
    said = {
        "segv": "its process was ended by SIGSEGV (it used memory that is not its own), in fmi2GetDerivatives",
        "leave_well": "its process left with exit code 0, in fmi2GetDerivatives",
        "hang": "does not answer within 5 s, in fmi2GetDerivatives",
    }
    told = [one.what for one in found.warnings if one.subject == "it"]
    assert len(told) == (fault in said)
    assert all(one.startswith(said[fault]) for one in told)
    assert capfd.readouterr() == ("", "")


# -- diagnose ----------------------------------------------------------------------------------------------------------


def test_a_fit_that_was_stopped_is_told_from_one_that_does_not_fit() -> None:
    with hearing():
        assert not failed_fit({}, ValueError("diverges")).stopped
        tell(FAILED)
        fit = failed_fit({}, FAILED)
    assert (fit.stopped, fit.failure) == (True, "it: fmi2GetDerivatives returned fmi2Error (t = 0.5 s)")
    assert fit_from_plain({}, fit_to_plain(fit)).stopped
    with pytest.raises(RotorsimError, match="it: the search ends where it fails, and would go on beyond: fmi2Get"):
        Evaluation(np.zeros(1), 1, barred=FAILED).reached()


def test_hypotheses_that_were_stopped_are_said_by_round() -> None:
    def tried(physics: str, place: str, *, stopped: bool) -> Any:
        insertion = SimpleNamespace(physics=physics, spot=_Spot(place))
        return SimpleNamespace(
            insertion=insertion, fit=Fit({}, failure="it: fails" if stopped else "", stopped=stopped)
        )

    first = [tried("crack", "a", stopped=True), tried("crack", "a", stopped=False), tried("rub", "a", stopped=True)]
    second = [tried("rub", "b", stopped=True)]
    chosen = SimpleNamespace(insertion=SimpleNamespace(physics="crack"))
    selection: Any = SimpleNamespace(
        rounds=(SimpleNamespace(tried=first), SimpleNamespace(tried=second)), chosen=(chosen,)
    )
    assert untried_of(selection) == {"rub at a": "it: fails", "rub at b beside crack": "it: fails"}


class _Spot(str):
    """A place, in words."""

    @property
    def words(self) -> str:
        return str(self)


def test_one_candidate_that_kills_its_process_is_the_only_one_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_jobs(function: Any, arguments: list[Any], **_: Any) -> list[Any]:
        failed = Failure(0, DIED, "the process that ran this job died")
        return [
            failed if any(job[0] == "bad" for job in batch) else function((batch, *rest)) for batch, *rest in arguments
        ]

    def fit(document: Any, starts: Any, effort: Any) -> Fit:
        tell(FAILED)
        return Fit(document, misfit=1.0)

    monkeypatch.setattr(work, "run_jobs", run_jobs)
    evidence: Any = SimpleNamespace(fit=fit, promise=lambda document, starts: tell(FAILED) or np.inf)
    jobs: Any = [(name, [[{}]]) for name in ("a", "bad", "b", "c", "d", "e", "f", "g", "h", "i")]
    with hearing() as heard:
        fits = Work(evidence, Jobs(workers=1)).fits(jobs, work.Effort())
    assert [fit.stopped for fit in fits] == [job[0] == "bad" for job in jobs]
    assert [one.count for one in heard.mishaps] == [9]
    with hearing():
        promises = Work(evidence, Jobs(workers=1)).promises(jobs)
    assert np.isnan(promises).all()  # not infinite: nothing is known of them


@pytest.mark.slow
def test_a_diagnosis_goes_on_where_the_fmu_crashes(
    clean: Path,  # noqa: F811 - no process, file or descriptor is left
    folder: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """In processes of their own; its trials beyond 135 N/m are lost, and all else is as without the fault."""
    for name in ("plant2.fmu", "recording.json"):
        shutil.copy(folder / name, tmp_path)
    (tmp_path / "run.csv").write_text("\n".join((folder / "run.csv").read_text().splitlines()[:40]))
    recording, few = load_recording(tmp_path), {"offset"}
    healthy = diagnose(driven(tmp_path, stiffness=60.0, damping=3.0), recording, physics=few, workers=1)
    values = {**BEYOND, "fault": FAULTS.index("segv"), "fault_time": 0.2}
    found = diagnose(driven(tmp_path, in_process=False, **values), recording, physics=few, workers=1)
    close_instances()
    role, said = (one.what for one in found.warnings if one.subject == "it")
    assert role.startswith("its ports do not say what it is")
    assert said.startswith(
        "its process was ended by SIGSEGV (it used memory that is not its own), in fmi2GetDerivatives"
    )
    assert said.endswith(" failed so, and other values were tried")
    assert (found.verdict, len(found.effects)) == (healthy.verdict, 0)
    off = np.abs(found.after.theta - healthy.after.theta) / np.sqrt(np.diag(healthy.after.covariance))
    assert off.max() < 1e-3


# -- instances ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("ok", []),
        ("bad_reset", ["reset, it is not what a new instance is: it is instantiated anew for all values"]),
        ("no_reset", ["cannot be reset: it is instantiated anew for all values"]),
    ],
)
def test_an_fmu_that_cannot_be_reset_is_made_anew_and_that_is_said(plants: Path, fault: str, said: list[str]) -> None:
    equations = equations_of(plants, in_process=False, label=fault)
    equations.instances.texts["fault"] = FAULTS.index(fault)
    equations._most = 1
    u, p = np.nan_to_num(equations._u.starts), equations._p.starts.copy()
    with hearing() as heard:
        for stiffness in (100.0, 110.0, 120.0):
            p[equations._p.names.index("stiffness")] = stiffness
            assert equations.rates(0.0, np.array([1.0, 0.0]), u, p).tolist() == [0.0, -stiffness]
    equations.close()
    assert [one.what for one in heard.mishaps] == said


def test_an_fmu_that_allows_one_instance_is_made_anew_and_that_is_said(plants: Path) -> None:
    equations = equations_of(plants / "once", in_process=True)
    u, p = np.nan_to_num(equations._u.starts), equations._p.starts.copy()
    with hearing() as heard:
        J = equations.jacobian(0.0, np.array([1.0, 0.0]), u, p, (False, False, False, True))
        start = equations.start(u + 1.0, p)
    equations.close()
    column = 1 + equations.n_x + equations.n_u + equations._p.names.index("stiffness")
    assert J[1, column] == pytest.approx(-1.0, rel=1e-6)
    assert start.tolist() == [1.0, 0.0]
    [said] = heard.mishaps
    assert said.what == (
        "allows one instance in a process: it is instantiated anew for all values; in a process of its own, without "
        '"in_process", it need not be'
    )


# -- in the process of the command -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "code", "said"), [("leave_well", 1, "has left by exit()"), ("abort", -6, "has crashed")]
)
def test_the_end_of_this_process_is_said(plants: Path, fault: str, code: int, said: str) -> None:
    script = (
        "import sys\n"
        "from rotorsim.fmi.runtime.slave import open_fmu\n"
        "slave = open_fmu(sys.argv[1], in_process=True).instantiate('me')\n"
        "slave.setup(parameters={'fault': int(sys.argv[2])}, outputs=['y'])\n"
        "slave.derivatives(0.0, None)\n"
    )
    file = plants / "plant2.fmu"
    command = [sys.executable, "-c", script, str(file), str(FAULTS.index(fault))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == code
    assert done.stderr.endswith(
        f"error: this process {said}, in which there are FMUs: {file}\n\n"
        'hint: in a process of its own, without "in_process", only what one was asked for fails\n'
    )
    fine = [sys.executable, "-c", script, str(file), "0"]
    assert subprocess.run(fine, capture_output=True, timeout=120, check=False).returncode == 0
