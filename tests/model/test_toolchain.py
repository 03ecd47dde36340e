"""Compilers: found, missing, broken; the cache."""

import os
import subprocess
import sys

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.model.emit import toolchain
from rotorsim.model.emit.toolchain import cache_folder, find_compiler
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.model.documents import oscillator


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


VIRTUAL = "the model runs on CasADi's virtual machine: the same numbers, several times slower"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell script as compiler")
@pytest.mark.parametrize(
    ("script", "said"),
    [
        (b"echo 'fatal: no space left' >&2\nexit 1", "failed: fatal: no space left"),
        (b"for k in 1 2 3 4 5 6 7; do echo line $k; done\nexit 1", "failed: line 3\nline 4\nline 5\nline 6\nline 7"),
        (b"printf 'erreur: \\351chec\\n' >&2\nexit 1", "failed: erreur: \ufffdchec"),
        (b"echo 'in rs_run' >&2\nkill -9 $$", "was killed (SIGKILL): in rs_run"),
        (b'while [ "$1" != -o ]; do shift; done; echo garbage > "$2"', "wrote what is no library: file too short"),
        (b"exit 0", "wrote no library"),
        (
            b'while [ "$1" != -o ]; do shift; done; echo "int a;" | cc -shared -x c -o "$2" -',
            "wrote a library without rs_size",
        ),
    ],
    ids=["fails", "says much", "not UTF-8", "killed", "garbage", "nothing", "another library"],
)
def test_a_compiler_that_fails_is_reported_and_the_virtual_machine_runs(
    fresh_cache, tmp_path, monkeypatch, script, said
):
    broken = tmp_path / "broken-cc"
    broken.write_bytes(b"#!/bin/sh\n" + script + b"\n")
    broken.chmod(0o755)
    monkeypatch.setenv("ROTORSIM_CC", str(broken))
    with pytest.warns(RuntimeWarning) as caught:
        result = simulate(load(oscillator()), stop=0.01)
    assert [str(item.message) for item in caught] == [f"{broken}: the C compiler {said}\n{VIRTUAL}"]
    assert result.provenance["path"] == "CasADi virtual machine (the C compiler failed)"
    assert len([*fresh_cache.iterdir()]) == (1 if "without" in said else 0)


def test_a_full_disk_for_temporary_files_is_said_and_the_virtual_machine_runs(fresh_cache, monkeypatch):
    def full(**options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rotorsim.model.emit.toolchain.tempfile.TemporaryDirectory", full)
    with pytest.warns(RuntimeWarning, match="the C compiler has no folder to work in: no space left on device"):
        result = simulate(load(oscillator()), stop=0.01)
    assert result.status == "finished"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a file that can be run")
def test_a_compiler_that_cannot_be_started_or_is_not_there_is_said(fresh_cache, tmp_path, monkeypatch):
    broken = tmp_path / "broken-cc"
    broken.write_text("no program")
    broken.chmod(0o755)
    monkeypatch.setenv("ROTORSIM_CC", str(broken))
    with pytest.warns(RuntimeWarning, match="broken-cc: the C compiler cannot be started: exec format error"):
        simulate(load(oscillator()), stop=0.01)
    monkeypatch.setenv("ROTORSIM_CC", str(tmp_path / "missing-cc"))
    with pytest.warns(RuntimeWarning, match="^ROTORSIM_CC: there is no compiler .*missing-cc: none is used$"):
        assert find_compiler() is None


def last(**options):
    result = simulate(load(oscillator()), stop=0.01, **options)
    return result["position.output"][-1], result.provenance["path"].rpartition(", ")[2]


@pytest.mark.slow
def test_a_damaged_library_is_compiled_again(fresh_cache):
    """Cut short (a disk that was full), one bit flipped (a failing disk), and empty (a power cut)."""
    value, path = last()
    assert path == "compiled now)"
    [library] = fresh_cache.iterdir()
    whole = library.read_bytes()
    middle = len(whole) // 2
    for damaged in (whole[:9000], whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :], b""):
        library.unlink()  # a new file: the old one is mapped into this process
        library.write_bytes(damaged)
        assert last() == (value, "compiled now)")
        assert [file.name for file in fresh_cache.iterdir()] == [library.name]
        assert library.read_bytes() == whole
        assert last() == (value, "from the cache)")


def test_a_cache_that_is_full_loses_what_was_not_used_for_longest(fresh_cache, monkeypatch):
    monkeypatch.setattr(toolchain, "MOST_KEPT", 4)
    for k in range(4):
        file = toolchain.keep(str(k).encode(), f"key{k}", ".so")
        os.utime(file, (k, k))
    assert toolchain.cached("key0", ".so") is not None  # used now
    toolchain.keep(b"4", "key4", ".so")
    assert sorted(file.name[:4] for file in fresh_cache.iterdir()) == ["key0", "key3", "key4"]


def test_a_library_for_another_processor_is_not_loaded(fresh_cache, monkeypatch):
    """A cache in a home folder that machines share: what one of them compiled may stop another."""
    value, _ = last()
    monkeypatch.setattr(toolchain, "_instructions", lambda compiler: "#define __ANOTHER__ 1")
    assert last() == (value, "compiled now)")
    assert len([*fresh_cache.iterdir()]) == 2


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell script as compiler")
@pytest.mark.parametrize("refused", ["-march=*", "-O*"], ids=["no such flag", "an assembler that is too old"])
def test_a_compiler_that_cannot_use_all_instructions_is_used_without(fresh_cache, tmp_path, monkeypatch, refused):
    value, _ = last()
    compiler = tmp_path / "old-cc"
    told = f'for a in "$@"; do case "$a" in -march=*) native=1;; esac; case "$a" in {refused}) seen=1;; esac; done'
    compiler.write_text(f'#!/bin/sh\n{told}\n[ "$native$seen" = 11 ] && exit 1\nexec cc "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("ROTORSIM_CC", str(compiler))
    assert last() == (value, "compiled now)")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners and modes of POSIX")
def test_a_library_that_others_could_have_written_is_not_loaded(fresh_cache, monkeypatch):
    last()
    [library] = fresh_cache.iterdir()
    assert library.stat().st_mode & 0o777 == 0o600
    library.chmod(0o622)
    assert last()[1] == "compiled now)"
    elsewhere = library.rename(fresh_cache.parent / "planted.so")
    library.symlink_to(elsewhere)
    assert last()[1] == "compiled now)"
    assert not library.is_symlink()
    monkeypatch.setattr(os, "geteuid", lambda: library.stat().st_uid + 1)
    with pytest.warns(RuntimeWarning, match="^the cache .* belongs to another user: it is not used, and every model"):
        assert last()[1] == "compiled now)"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="modes of POSIX")
def test_a_cache_that_others_can_write_to_is_not_used(fresh_cache, monkeypatch, tmp_path):
    fresh_cache.mkdir()
    fresh_cache.chmod(0o775)
    with pytest.warns(RuntimeWarning, match=r"can be written by others: .* \(chmod go-w .*cache\)$"):
        assert last()[1] == "compiled now)"
    assert [*fresh_cache.iterdir()] == []
    monkeypatch.delenv("ROTORSIM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    own = tmp_path / "rotorsim"
    own.mkdir()
    own.chmod(0o775)  # as an older version made it, under a generous umask
    last()
    assert last()[1] == "from the cache)"
    assert own.stat().st_mode & 0o777 == 0o755


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="the folder of XDG")
@pytest.mark.parametrize("given", ["", "cache", "./x"])
def test_a_relative_cache_is_not_used(given, monkeypatch, tmp_path):
    monkeypatch.delenv("ROTORSIM_CACHE", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", given)
    assert cache_folder() == tmp_path / ".cache" / "rotorsim"
    if given:
        monkeypatch.setenv("ROTORSIM_CACHE", given)
        monkeypatch.chdir(tmp_path)
        with pytest.raises(RotorsimError) as caught:
            cache_folder()
        assert str(caught.value) == (
            f"error: ROTORSIM_CACHE={given}: is not an absolute path\n\nhint: ROTORSIM_CACHE={tmp_path / given}"
        )


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("ROTORSIM_CACHE", str(blocked / "inside"))
    assert np.isfinite(simulate(load(oscillator()), stop=0.01)["position.output"]).all()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX processes")
def test_runs_in_parallel_share_one_cache(fresh_cache):
    program = (
        "from rotorsim import load, simulate;"
        "from tests.model.documents import oscillator;"
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
