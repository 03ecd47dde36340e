"""Compilers: found, missing, broken; the cache."""

import os
import subprocess
import sys

import numpy as np
import pytest

from rotorsim.compile.toolchain import cache_folder, find_compiler
from rotorsim.diagram import load
from rotorsim.errors import RotorsimError
from rotorsim.simulate.run import simulate
from tests.compile.documents import oscillator


@pytest.fixture
def fresh_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ROTORSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_library_is_compiled_once_and_changed_values_do_not_compile_again(fresh_cache):
    first = simulate(load(oscillator()), stop=0.01)
    again = simulate(load(oscillator(stiffness=123.0)), stop=0.01)
    assert first.provenance["path"].endswith("compiled now)")
    assert again.provenance["path"].endswith("from the cache)")
    assert len(list(fresh_cache.iterdir())) == 1  # no temporary folder is left
    assert cache_folder() == fresh_cache


def test_without_a_compiler_the_virtual_machine_runs_and_says_so(monkeypatch):
    monkeypatch.setenv("ROTORSIM_CC", "none")
    assert find_compiler() is None
    result = simulate(load(oscillator()), stop=0.01)
    assert result.provenance["path"] == "CasADi virtual machine (no C compiler)"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell script as compiler")
def test_a_compiler_that_fails_is_reported_with_its_words(fresh_cache, tmp_path, monkeypatch):
    broken = tmp_path / "broken-cc"
    broken.write_text("#!/bin/sh\necho 'fatal: no space left' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("ROTORSIM_CC", str(broken))
    with pytest.raises(RotorsimError) as caught:
        simulate(load(oscillator()), stop=0.01)
    problem = caught.value.problems[0]
    assert problem.what == "the C compiler failed: fatal: no space left"
    assert problem.hint == "run with --no-compiler (slower, needs no compiler), or name another one in ROTORSIM_CC"
    assert list(fresh_cache.iterdir()) == []


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("ROTORSIM_CACHE", str(blocked / "inside"))
    assert np.isfinite(simulate(load(oscillator()), stop=0.01)["position.output"]).all()


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX processes")
def test_runs_in_parallel_share_one_cache(fresh_cache):
    program = (
        "from rotorsim.diagram import load; from rotorsim.simulate.run import simulate;"
        "from tests.compile.documents import oscillator;"
        "print(simulate(load(oscillator()), stop=0.01)['position.output'][-1])"
    )
    runs = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=os.environ.copy())
        for _ in range(3)
    ]
    values = {run.communicate(timeout=120)[0] for run in runs}
    assert len(values) == 1
    assert all(run.returncode == 0 for run in runs)
    assert len([f for f in fresh_cache.iterdir() if f.is_file()]) == 1
