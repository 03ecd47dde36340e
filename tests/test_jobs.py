"""Lists of jobs: order, the store, failures, processes that die, Ctrl-C, and clusters."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.errors import RotorsimError
from rotorsim.jobs import cluster, jobs, processes
from rotorsim.jobs.jobs import Failure, Jobs, local_workers, run_jobs

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Case:
    speed: float
    label: str = ""


def square(number: float) -> float:
    return number * number


def logged_square(argument: dict[str, Any]) -> float:
    """Return the square; say in a file that the job was run. The job given by "fail" in that file fails."""
    log = Path(argument["log"])
    with log.open("a") as stream:
        stream.write(f"{argument['number']}\n")
    if log.with_suffix(".fail").exists() and log.with_suffix(".fail").read_text() == str(argument["number"]):
        raise ArithmeticError(f"no square of {argument['number']}")
    return float(argument["number"] ** 2)


def versatile(argument: dict[str, Any]) -> Any:
    """Do what the argument says; for the processes of one cluster."""
    match argument["do"]:
        case "fail":
            raise ValueError("asked to fail")
        case "die":
            os._exit(3)
        case "nest":
            return run_jobs(square, [1, 2, 3], jobs=Jobs(2))
        case "environment":
            return [os.getpid(), os.environ.get("OMP_NUM_THREADS"), os.environ.get("OPENBLAS_NUM_THREADS")]
    return argument["number"] ** 2


def various(_: Any) -> dict[str, Any]:
    return {
        "array": np.array([[1.5, 2.5]]),
        "number": np.float32(0.5),
        "flag": np.bool_(True),
        "whole": np.int64(7),
        "tuple": (1, None, "x"),
        "nan": np.array([math.nan, math.inf]),
        "tenth": 0.1,
    }


def returned(argument: Any) -> Any:
    return {"complex": 1j, "key": {1: 2}, "object": object()}[argument]


def uses_store(store: str) -> Any:
    return run_jobs(square, [2], store=store)


def waits(number: int) -> int:
    if number > 2:
        time.sleep(1000)
    return number


def sync(function: Any, arguments: Any, progress: Any = None, **options: Any) -> list[Any]:
    return run_jobs(function, arguments, jobs=Jobs(None, "synchronous", progress), **options)


def logged(tmp_path: Path, count: int) -> list[dict[str, Any]]:
    return [{"number": number, "log": str(tmp_path / "run.log")} for number in range(count)]


def done(tmp_path: Path) -> list[int]:
    """Return the jobs that were run since the last call."""
    log = tmp_path / "run.log"
    text = log.read_text() if log.exists() else ""
    log.unlink(missing_ok=True)
    return [int(line) for line in text.split()]


def test_import_is_cheap():
    code = "import sys, rotorsim.jobs.jobs; print(sorted({'dask', 'distributed', 'numpy'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_in_this_process_in_order_with_progress():
    fractions: list[float] = []
    assert sync(square, [3, 1, 2], progress=fractions.append) == [9, 1, 4]
    np.testing.assert_allclose(fractions, [1 / 3, 2 / 3, 1], rtol=1e-15)
    assert run_jobs(square, [5]) == [25]  # one job: in this process
    assert run_jobs(process_of, [1, 2], jobs=Jobs(1)) == [os.getpid()] * 2
    assert run_jobs(square, []) == []


def process_of(_: Any) -> int:
    return os.getpid()


def test_results_are_plain_data_whether_computed_or_read(tmp_path):
    store = tmp_path / "s.jsonl"
    fresh, read = (sync(various, [0], store=store)[0] for _ in range(2))
    assert json.dumps(fresh) == json.dumps(read)
    assert fresh["array"] == [[1.5, 2.5]]
    assert fresh["tuple"] == [1, None, "x"]
    assert [type(fresh[name]) for name in ("number", "flag", "whole", "tenth")] == [float, bool, int, float]
    assert math.isnan(read["nan"][0])
    assert read["nan"][1] == math.inf
    assert read["tenth"] == 0.1


@pytest.mark.parametrize(
    ("what", "text"), [("complex", "returned a complex"), ("key", "the key 1"), ("object", "returned a object")]
)
def test_results_that_json_cannot_hold_are_failures(what, text):
    (failure,) = sync(returned, [what], on_error="return")
    assert failure.type == "TypeError"
    assert text in failure.text


def test_interrupted_run_resumes(tmp_path):
    store, arguments = tmp_path / "s.jsonl", logged(tmp_path, 6)

    def interrupt(fraction: float) -> None:
        if fraction > 0.49:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sync(logged_square, arguments, store=store, progress=interrupt)
    assert done(tmp_path) == [0, 1, 2]
    fractions: list[float] = []
    assert sync(logged_square, arguments, store=store, progress=fractions.append) == [0, 1, 4, 9, 16, 25]
    assert done(tmp_path) == [3, 4, 5]
    assert fractions[0] == 0.5
    assert sync(logged_square, arguments, store=store) == [0, 1, 4, 9, 16, 25]
    assert done(tmp_path) == []
    assert len(sync(logged_square, logged(tmp_path, 8), store=store)) == 8  # two more
    assert done(tmp_path) == [6, 7]


@pytest.mark.parametrize("cut", [1, 5, 20, 70])
def test_torn_last_line_is_ignored(tmp_path, cut):
    store, arguments = tmp_path / "s.jsonl", logged(tmp_path, 3)
    sync(logged_square, arguments, store=store)
    whole = store.read_bytes()
    done(tmp_path)
    store.write_bytes(whole[:-cut])
    assert sync(logged_square, arguments, store=store) == [0, 1, 4]
    assert done(tmp_path) == [2]
    assert store.read_bytes() == whole


def test_store_of_something_else_is_refused(tmp_path):
    store = tmp_path / "s.jsonl"
    sync(square, [1, 2], store=store, key="a")
    before = store.read_bytes()
    for function, arguments, key, text in [
        (square, [1, 2], "b", ":1:1: error: this store belongs to another function or other settings"),
        (process_of, [1, 2], "a", "another function"),
        (square, [1, 3], "a", ":2:1: error: this store belongs to other jobs: job 1 had another argument"),
        (square, [1], "a", "it has a job 1, the last one now is 0"),
    ]:
        with pytest.raises(RotorsimError, match="delete this one") as refused:
            sync(function, arguments, store=store, key=key)
        assert text in str(refused.value)
    assert store.read_bytes() == before


@pytest.mark.parametrize("content", [b"time,x\n0,1\n", b'{"blocks": {}}', b"\x00\xff\n", b'{"index": 0}\n', b"[1]\n"])
def test_file_that_is_no_store_is_refused_and_kept(tmp_path, content):
    file = tmp_path / "precious.json"
    file.write_bytes(content)
    with pytest.raises(RotorsimError, match="not the line of a store") as refused:
        sync(square, [1, 2], store=file)
    assert "delete" not in str(refused.value)
    assert file.read_bytes() == content


def test_store_is_written_by_one_run_at_a_time(tmp_path):
    store = tmp_path / "s.jsonl"
    (failure,) = sync(uses_store, [str(store)], store=store, on_error="return")
    assert "another process is writing this store" in failure.text
    assert uses_store(str(tmp_path / "other.jsonl")) == [4]


def test_store_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(RotorsimError, match="file cannot be written"):
        sync(square, [1], store=tmp_path / "missing" / "s.jsonl")


def test_arguments_are_told_apart_by_value(tmp_path):
    store = tmp_path / "s.jsonl"
    arguments = [Case(1.0), {"b": np.array([1.0, 2.0]), "a": 1j}, Path("x"), (1, "2")]
    sync(process_of, arguments, store=store)
    same = [Case(1.0, ""), {"a": 1j, "b": np.array([1.0, 2.0])}, Path("x"), [1, "2"]]
    sync(process_of, same, store=store)
    for index, other in enumerate([Case(1.5), {"b": np.array([1.0, 2.5]), "a": 1j}, Path("y"), (1, 2)]):
        with pytest.raises(RotorsimError, match=f"job {index} had another argument"):
            sync(process_of, [*arguments[:index], other, *arguments[index + 1 :]], store=store)
    with pytest.raises(RotorsimError, match="job 0: the argument is no plain data: object"):
        sync(process_of, [object()], store=store)
    assert len(sync(process_of, [object()])) == 1  # no store, no need


def test_failures_are_raised_after_all_jobs_and_run_again(tmp_path):
    store, arguments = tmp_path / "s.jsonl", logged(tmp_path, 4)
    (tmp_path / "run.fail").write_text("1")
    with pytest.raises(RotorsimError) as raised:
        sync(logged_square, arguments, store=store)
    assert raised.value.exit_code == 1
    assert "ArithmeticError: no square of 1" in str(raised.value)
    assert "1 of 4 jobs failed" in str(raised.value)
    assert done(tmp_path) == [0, 1, 2, 3]
    assert json.loads(store.read_text().splitlines()[1])["failure"]["type"] == "ArithmeticError"
    expected = Failure(1, "ArithmeticError", "no square of 1")
    assert sync(logged_square, arguments, store=store, on_error="return") == [0, expected, 4, 9]
    assert done(tmp_path) == [1]
    (tmp_path / "run.fail").unlink()
    assert sync(logged_square, arguments, store=store) == [0, 1, 4, 9]
    assert done(tmp_path) == [1]


def test_only_the_first_failures_are_listed():
    with pytest.raises(RotorsimError) as raised:
        sync(returned, ["complex"] * 30)
    assert len(raised.value.problems) == jobs.LISTED_FAILURES + 1
    assert "30 of 30 jobs failed" in str(raised.value)


def test_a_wrong_scheduler_and_number_of_workers_are_refused_before_any_work():
    with pytest.raises(RotorsimError) as raised:
        Jobs(workers=0, scheduler="cluster")
    assert len(raised.value.problems) == 2
    assert "'cluster' is not the address of a scheduler" in str(raised.value)


def test_diagnose_refuses_a_wrong_scheduler_before_it_looks_at_anything():
    with pytest.raises(RotorsimError, match="'home' is not the address of a scheduler"):
        diagnose(None, None, scheduler="home")


@pytest.mark.parametrize(("options", "said"), [({"chunk": 0}, "at least one"), ({"on_error": "ignore"}, "is unknown")])
def test_wrong_options_are_said(options, said):
    with pytest.raises(RotorsimError, match=said):
        sync(square, [1, 2], **options)


def sockets() -> set[Any]:
    """Return what this process and its children listen on: ports and named sockets."""
    import psutil

    found = set()
    for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
        with suppress(psutil.Error):
            kept = process.net_connections("all")
            found |= {c.laddr for c in kept if c.laddr and (c.status == "LISTEN" or c.family == socket.AF_UNIX)}
    return found


@pytest.mark.slow
def test_local_workers_are_kept_for_several_lists():
    with local_workers(Jobs(2)) as kept:
        seen = {run_jobs(process_of, [1, 2, 3], jobs=kept)[0] for _ in range(3)}
        assert len(seen) <= 2
        assert os.getpid() not in seen
        with pytest.raises(KeyboardInterrupt):
            run_jobs(square, [1, 2, 3], jobs=replace(kept, progress=interrupt))
        assert run_jobs(square, [1, 2, 3], jobs=kept) == [1, 4, 9]
    assert multiprocessing.active_children() == []
    with pytest.raises(RotorsimError, match="the worker processes have ended"):
        run_jobs(square, [1, 2], jobs=kept)
    with local_workers(Jobs(1)) as kept:
        assert kept.scheduler == "synchronous"


@pytest.mark.slow
def test_local_workers_import_modules_as_they_start_and_are_kept_within():
    with local_workers(Jobs(2), "colorsys", "no.such.module") as kept:
        assert run_jobs(is_imported, ["colorsys", "colorsys", "no"], jobs=kept) == [True, True, False]
        with local_workers(kept) as again:
            assert again is kept


def is_imported(name: str) -> bool:
    return name in sys.modules


def interrupt(_: float) -> None:
    raise KeyboardInterrupt


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a shell's exit codes")
def test_a_script_that_does_not_guard_its_start_is_told_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import math\nfrom rotorsim.jobs.jobs import Jobs, run_jobs\nrun_jobs(math.sqrt, [1.0, 4.0], jobs=Jobs(2))\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr.endswith(
        "RotorsimError: error: the worker processes do not start: they end at once\n\n"
        'hint: in a script, call it under `if __name__ == "__main__":`; or use the scheduler "synchronous"\n'
    )


@pytest.mark.slow
def test_local_processes(tmp_path, monkeypatch):
    """Order, failures, a job that kills its process, jobs within a job, BLAS threads, and nothing left behind."""
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    environment = {name: os.environ.get(name) for name in processes.ENVIRONMENT}
    arguments: list[dict[str, Any]] = [{"do": "square", "number": number} for number in range(12)]
    arguments[2] = {"do": "fail"}
    arguments[4] = {"do": "die"}
    arguments[7] = {"do": "nest"}
    arguments[9] = {"do": "environment"}
    fractions: list[float] = []
    reachable: set[Any] = set()

    def look(fraction: float) -> None:
        fractions.append(fraction)
        reachable.update(sockets())

    store = tmp_path / "s.jsonl"
    before = sockets()
    options: dict[str, Any] = {"jobs": Jobs(2, progress=look), "chunk": 3, "on_error": "return"}
    found = run_jobs(versatile, arguments, store=store, **options)
    assert reachable <= before  # another user of this machine finds no port and no socket to speak to
    assert [found[k] for k in (0, 1, 3, 5, 6, 8, 10, 11)] == [0, 1, 9, 25, 36, 64, 100, 121]
    assert found[2] == Failure(2, "ValueError", "asked to fail")
    assert isinstance(found[4], Failure)
    assert "the process that ran this job died" in found[4].text
    assert found[7] == [1, 4, 9]
    assert found[9][0] != os.getpid()
    assert found[9][1:] == ["1", "1"]
    assert fractions == [(k + 1) / 12 for k in range(12)]
    assert sorted(json.loads(line)["index"] for line in store.read_text().splitlines()) == list(range(12))
    assert {name: os.environ.get(name) for name in environment} == environment
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of a process group")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_and_a_kill_keep_results_and_leave_no_process(tmp_path, how):
    import psutil

    store = tmp_path / "s.jsonl"
    script = tmp_path / "script.py"
    script.write_text(
        "import signal\nfrom rotorsim.jobs.jobs import Jobs, run_jobs\nfrom tests.test_jobs import waits\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # shells have what runs behind them ignore it
        f"if __name__ == '__main__':\n    run_jobs(waits, range(6), store={str(store)!r}, jobs=Jobs(2))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    main = subprocess.Popen(
        [sys.executable, str(script)], stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
    )
    processes = []
    try:
        while main.poll() is None and not (store.exists() and store.read_bytes().count(b"\n") == 3):
            time.sleep(0.05)
        processes = psutil.Process(main.pid).children(recursive=True)
        assert len(processes) >= 2
        if how == signal.SIGINT:
            os.killpg(main.pid, how)  # as the terminal does
        else:
            main.kill()
        said = main.communicate(timeout=60)[1]
        assert main.returncode == -how
        if how == signal.SIGINT:
            assert said.count("Traceback") == 1  # nothing of the workers
            assert said.strip().endswith("KeyboardInterrupt")
        assert psutil.wait_procs(processes, timeout=30)[1] == []
        assert sorted(json.loads(line)["result"] for line in store.read_text().splitlines()) == [0, 1, 2]
    finally:
        for process in processes:
            if process.is_running():
                process.kill()
        main.kill()
        main.communicate()  # closes its pipe, too


@pytest.mark.slow
def test_scheduler_out_of_reach_is_said(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.2)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # not listening
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(RotorsimError, match="is it running") as raised:
            run_jobs(square, [1, 2], jobs=Jobs(scheduler=address))
    assert f"the scheduler {address} cannot be reached" in str(raised.value)


def test_cluster_elsewhere():
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        memory_limit=0,
        dashboard_address="127.0.0.1:0",
    ) as running:
        address = running.scheduler_address
        with pytest.raises(RotorsimError, match="has no workers"):
            run_jobs(square, [1, 2], jobs=Jobs(scheduler=address))
        running.scale(1)
        running.wait_for_workers(1)
        assert run_jobs(square, [3, 1, 2], jobs=Jobs(scheduler=address), chunk=2) == [9, 1, 4]
        assert run_jobs(returned, ["key"] * 2, jobs=Jobs(scheduler=address), on_error="return")[1].type == "TypeError"
        with pytest.raises(RotorsimError, match="cannot be sent to another process"):
            run_jobs(square, [threading.Lock(), 1], jobs=Jobs(scheduler=address))


def test_other_versions_on_a_cluster_are_said():
    here = {"python": "3.11.7.final.0", "distributed": "2026.8.0", "rotorsim": "0.1.0"}
    there = {**here, "python": "3.11.9.final.0"}
    found = {
        "client": {"packages": here},
        "scheduler": {"packages": here},
        "workers": {"tcp://a:1": {"packages": {**there, "rotorsim": "0.2.0"}}, "tcp://b:1": {"packages": there}},
    }
    (problem,) = cluster._mismatches(found)
    assert str(problem).startswith("error: worker tcp://a:1: has rotorsim 0.2.0, this process has 0.1.0")
