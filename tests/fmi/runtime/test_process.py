"""FMUs that crash, hang, eat memory or talk nonsense: a message with all that is known, and a clean parent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.functions import close_instances
from rotorsim.fmi.runtime.binding import format_message
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import Slave, open_fmu
from tests.fmi.plant import FAULTS, description2, description3, make_fmu


@pytest.fixture(scope="session")
def plants(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("plants")
    return {version: make_fmu(folder / f"plant{version[0]}.fmu", version) for version in ("2.0", "3.0")}


@pytest.fixture
def clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give an empty folder for temporary files; afterwards it is empty, and no file or child more is open."""
    close_instances()  # those that equations of other tests keep
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    files, processes = set(os.listdir("/proc/self/fd")), children()
    yield folder
    assert list(folder.iterdir()) == []
    assert set(os.listdir("/proc/self/fd")) - files == set()
    assert children() - processes == set()


def children() -> set[str]:
    """Return the processes that this one has begun and not waited for; other tests leave some, as for semaphores."""
    found: set[str] = set()
    for task in Path("/proc/self/task").iterdir():
        with suppress(FileNotFoundError):  # a thread that has ended
            found.update((task / "children").read_text().split())
    return found


def run_faulty(path: Path, fault: str, *, timeout: float = 20.0, memory: int = 1 << 30, kind: str = "cs") -> Slave:
    """Step a plant whose fault comes at t = 0.05 s."""
    with open_fmu(path, timeout=timeout, memory=memory) as fmu:
        slave = fmu.instantiate(kind)
        slave.setup(parameters={"fault": FAULTS.index(fault), "fault_time": 0.05}, outputs=["y"])
        for k in range(10):
            if kind == "cs":
                slave.exchange(None, 0.01 * k, 0.01)
            else:
                slave.derivatives(0.01 * k, None)
        slave.terminate()
    return slave


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("fault", "kind", "what"),
    [
        ("segv", "crash", "its process was ended by SIGSEGV (it used memory that is not its own), in fmi{}DoStep"),
        ("abort", "crash", "its process was ended by SIGABRT (it gave up), in fmi{}DoStep"),
        ("leave", "crash", "its process left with exit code 3, in fmi{}DoStep"),
        ("fail", "error", "fmi{0}DoStep returned fmi{0}Error"),
        ("fatal", "fatal", "fmi{0}DoStep returned fmi{0}Fatal"),
        ("discard", "discard", "fmi{}DoStep refused the step, it came to t = 0.05 s"),
        ("nan", "value", "gives y"),
    ],
)
def test_faults_of_a_step(clean: Path, plants: dict[str, Path], version: str, fault: str, kind: str, what: str) -> None:
    with pytest.raises(FmuError) as caught:
        run_faulty(plants[version], fault)
    error = caught.value
    assert (error.kind, error.time, error.exit_code) == (kind, 0.05, 1)
    problem = error.problems[0]
    assert problem.what.startswith(what.format(version[0]))
    assert "(t = 0.05 s)" in problem.what
    assert problem.subject == "plant"
    assert problem.place.file == str(plants[version])
    if fault == "abort":
        assert "it printed: assertion failed: the plant is tired" in problem.what
    if fault == "discard":
        assert error.last == pytest.approx(0.05)
    if fault in ("fail", "fatal", "discard"):
        assert len(error.log) == 1


@pytest.mark.slow
def test_the_log_of_fmi2_is_formatted_as_printf_does(clean: Path, plants: dict[str, Path]) -> None:
    with pytest.raises(FmuError) as caught:
        run_faulty(plants["2.0"], "fail")
    assert caught.value.log == (("Error", "logStatusError", "step of 0.01 s refused, code 3 in none"),)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cs", "me"])
def test_a_hang_ends_at_the_time_limit(clean: Path, plants: dict[str, Path], kind: str) -> None:
    begun = time.monotonic()
    with pytest.raises(FmuError) as caught:
        run_faulty(plants["2.0"], "hang", timeout=0.5, kind=kind)
    assert 0.5 < time.monotonic() - begun < 10.0
    function = "fmi2DoStep" if kind == "cs" else "fmi2GetDerivatives"
    assert caught.value.kind == "hang"
    assert caught.value.problems[0].what == f"does not answer within 0.5 s, in {function} (t = 0.05 s)"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits address space")
def test_memory_is_limited(clean: Path, plants: dict[str, Path]) -> None:
    with pytest.raises(FmuError) as caught:
        run_faulty(plants["2.0"], "hungry", memory=400 << 20)
    assert caught.value.kind == "crash"
    assert "of the 400 MiB that it may have" in caught.value.problems[0].hint


@pytest.mark.parametrize("fault", ["ok", "print", "bad_free", "child"])
def test_what_does_no_harm(clean: Path, plants: dict[str, Path], fault: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Printing a lot, crashing when freed, and leaving a child behind."""
    run_faulty(plants["2.0"], fault)
    assert capfd.readouterr() == ("", "")


def test_the_end_that_an_fmu_asks_for_is_noted(clean: Path, plants: dict[str, Path]) -> None:
    assert run_faulty(plants["3.0"], "terminate").ended
    assert not run_faulty(plants["3.0"], "ok").ended


def test_after_a_crash_every_call_says_so_and_others_go_on(clean: Path, plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"]) as fmu:
        bad, good = fmu.instantiate("cs"), fmu.instantiate("cs")
        for slave, fault in ((bad, "segv"), (good, "ok")):
            slave.setup(parameters={"fault": FAULTS.index(fault)}, outputs=["y"])
        for _ in range(2):
            with pytest.raises(FmuError, match="SIGSEGV"):
                bad.exchange(None, 0.0, 0.01)
        with pytest.raises(FmuError, match="SIGSEGV"):
            bad.get(["x"])
        assert good.exchange(None, 0.0, 0.01)[0] < 1.0
        bad.free()


def test_killed_from_outside(clean: Path, plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["y"])
        os.kill(slave.worker.process.pid, signal.SIGKILL)  # type: ignore[attr-defined]
        time.sleep(0.2)
        with pytest.raises(FmuError, match=r"its process was ended by SIGKILL \(killed from outside\)"):
            slave.exchange(None, 0.0, 0.01)


def test_a_child_outlives_neither_a_forgotten_fmu_nor_its_parent(plants: dict[str, Path], tmp_path: Path) -> None:
    """A parent that is killed, while its FMU hangs, leaves neither a process nor files."""
    code = (
        "import sys, tempfile, threading\n"
        "tempfile.tempdir = sys.argv[2]\n"
        "from rotorsim.fmi.runtime.slave import open_fmu\n"
        "slave = open_fmu(sys.argv[1], timeout=100.0).instantiate('cs')\n"
        "slave.setup(parameters={'fault': 2}, outputs=['y'])\n"
        "threading.Timer(0.2, lambda: print(slave.worker.process.pid, flush=True)).start()\n"
        "slave.exchange(None, 0.0, 0.01)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(plants["2.0"]), str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    with parent.stdout:
        child = int(parent.stdout.readline())
    assert list(tmp_path.iterdir())
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline and (list(tmp_path.iterdir()) or _runs(child)):
        time.sleep(0.01)
    assert list(tmp_path.iterdir()) == []
    assert not _runs(child)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_answers_that_are_no_answers(clean: Path, plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["y"])
        slave.worker.pipe.kept.append(b"\xff nonsense")  # type: ignore[attr-defined]
        with pytest.raises(FmuError, match="its process answers nonsense: its memory is damaged"):
            slave.get(["x"])


def test_one_instance_only(clean: Path, tmp_path: Path) -> None:
    path = make_fmu(tmp_path / "once.fmu", once=True)
    with open_fmu(path, in_process=True) as fmu:
        first = fmu.instantiate("cs")
        with pytest.raises(RotorsimError) as caught:
            fmu.instantiate("cs")
        assert caught.value.problems[0].what == "allows one instance in a process, and there is one already"
        first.free()
        fmu.instantiate("cs").free()  # forgotten, it would be there for ever
    with open_fmu(path) as fmu:
        for slave in [fmu.instantiate("cs"), fmu.instantiate("cs")]:
            slave.setup(outputs=["y"])
            assert slave.exchange(None, 0.0, 0.01)[0] < 1.0


def test_platforms_inside_are_named(clean: Path, tmp_path: Path) -> None:
    path = make_fmu(tmp_path / "a.fmu", platform="win16")
    with pytest.raises(RotorsimError) as caught, open_fmu(path) as fmu:
        fmu.instantiate("cs")
    assert "holds no library for this platform (" in caught.value.problems[0].what
    assert caught.value.problems[0].hint == "platforms inside: win16"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("here", [True, False])
def test_a_library_that_is_none(clean: Path, tmp_path: Path, here: bool) -> None:
    path = make_fmu(tmp_path / "a.fmu", library_bytes=b"\x7fELF nothing")
    with pytest.raises(FmuError) as caught, open_fmu(path, in_process=here) as fmu:
        fmu.instantiate("cs")
    assert caught.value.problems[0].what.startswith("its library cannot be loaded: ")
    assert caught.value.kind == "load"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_wrong_token(clean: Path, tmp_path: Path, version: str) -> None:
    text = (description2() if version == "2.0" else description3()).replace("{plant", "{other")
    with pytest.raises(FmuError) as caught, open_fmu(make_fmu(tmp_path / "a.fmu", version, description=text)) as fmu:
        fmu.instantiate("me")
    said = "wrong guid (2.5, -7, {other2})" if version == "2.0" else "wrong token"
    what = f"fmi{version[0]}Instantiate returned no instance\n  it said: Error: {said}"
    assert caught.value.problems[0].what == what


def test_clocks_are_refused_by_name(clean: Path, tmp_path: Path) -> None:
    clock = '<Clock name="tock" valueReference="90" causality="input" intervalVariability="triggered"/>'
    clocked = '<Float64 name="w" valueReference="91" causality="output" variability="discrete" clocks="92"/>'
    for extra, what in (
        (clock, "has clocks as inputs, which are not supported: tock"),
        (clocked, "w: belongs to a clock: clocks are not supported"),
    ):
        text = description3().replace("</ModelVariables>", extra + "</ModelVariables>")
        path = make_fmu(tmp_path / "a.fmu", "3.0", description=text)
        with pytest.raises(RotorsimError, match=what), open_fmu(path) as fmu:
            fmu.instantiate("cs").setup(outputs=["w"])


def test_a_kind_that_is_not_offered(clean: Path, tmp_path: Path) -> None:
    text = description2().replace("<ModelExchange", "<Annotations").replace("</ModelExchange", "</Annotations")
    path = make_fmu(tmp_path / "a.fmu", description=text)
    with pytest.raises(RotorsimError, match="does not offer Model Exchange; it offers Co-Simulation"):
        open_fmu(path).instantiate("me")


def test_all_messages_go_to_the_log_that_is_given(clean: Path, plants: dict[str, Path]) -> None:
    lines: list[tuple[str, str, str]] = []
    with open_fmu(plants["2.0"], log=lambda *line: lines.append(line)) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("discard")}, outputs=["y"])
        with pytest.raises(FmuError):
            slave.exchange(None, 0.0, 0.01)
    assert lines == [("Discard", "logStatusError", "step of 0.01 s refused, code 2 in none")]


@pytest.mark.parametrize(
    ("message", "whole", "real", "text"),
    [
        (b"plain", (), (), b"plain"),
        (b"100 %%", (), (), b"100 %"),
        (b"%d %5d|%-5d|%05d", (2**32 - 1, 42, 42, 42), (), b"-1    42|42   |00042"),
        (b"%u %lu %x %lld", (2**32 - 1, 2**63, 255, 2**64 - 2), (), b"4294967295 9223372036854775808 ff -2"),
        (b"%g %.3f %10.2e", (), (0.1, 1.0, 12345.678), b"0.1 1.000   1.23e+04"),
        (b"%*d %.*f", (4, 7, 2), (1.0,), b"   7 1.00"),
        (b"%s", (0,), (), b"(null)"),
        (b"%c%n", (65, 1), (), b"A"),
        (b"%999999999d", (1,), (), b"1".rjust(200)),
    ],
)
def test_printf(message: bytes, whole: tuple[int, ...], real: tuple[float, ...], text: bytes) -> None:
    assert format_message(message, whole, real) == text


def test_steps_without_spinning(plants: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine with one processor, or one that does not keep the order of stores."""
    monkeypatch.setattr("rotorsim.fmi.runtime.process.ordered", lambda: False)
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["y"])
        found = [slave.exchange(None, 0.01 * k, 0.01)[0] for k in range(100)]
    with open_fmu(plants["2.0"], in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["y"])
        assert found == [slave.exchange(None, 0.01 * k, 0.01)[0] for k in range(100)]


def test_long_waits_on_both_sides(plants: dict[str, Path]) -> None:
    """Both sides fall asleep between steps and are woken up."""
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["y"])
        for k in range(20):
            time.sleep(0.005)
            slave.exchange(None, 0.01 * k, 0.01)


def test_numbers_cross_exactly(plants: dict[str, Path]) -> None:
    values = np.array([1e-308, -0.0, 1.0 + 2**-52, 1e308, 5e-324])
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(inputs=["u"], outputs=["u"])
        for value in values:
            assert json.dumps(slave.exchange(np.array([value]), 0.0)[0]) == json.dumps(value)
            slave.set(["u"], [float(value)])
            assert json.dumps(slave.get(["u"])[0]) == json.dumps(value)
