"""The verb ``serve``: its address, its end, wrong arguments."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from click.testing import CliRunner

from rotorsim.cli.app import rotorsim

ADDRESS = re.compile(r"http://127\.0\.0\.1:(\d+)/#([A-Za-z0-9_-]{43})\n")


@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_the_address_is_printed_and_ctrl_c_ends_everything(mine: Path) -> None:
    command = [sys.executable, "-m", "rotorsim", "serve", mine.name, "--no-browser", "--port", "0"]
    process = subprocess.Popen(
        command, cwd=mine.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    found = ADDRESS.fullmatch(process.stdout.readline())
    assert found is not None
    port, token = found.groups()
    request = Request(f"http://127.0.0.1:{port}/api/gallery", headers={"X-Rotorsim-Token": token})
    with urlopen(request, timeout=20) as answer:
        assert b'"open": "mine.json"' in answer.read()
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert time.monotonic() - begun < 2.0
    assert process.returncode == 0
    assert "Traceback" not in said
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)  # nothing is left of its session


def test_wrong_arguments_are_refused_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.json").mkdir()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for arguments, said in (
            (["nothing.json"], "error: there is no such file\n\nhint: 'rotorsim new mine' makes a diagram"),
            (["jeffcott"], "it comes with rotorsim and stays as it is: rotorsim new mine --from jeffcott"),
            (["folder.json"], "there is no such file"),
            (["--port", "70000"], "70000 is not in the range 0<=x<=65535"),
            (["--no-browser", "--port", port], f"error: --port: port {port} cannot be had: "),
        ):
            result = CliRunner().invoke(rotorsim, ["serve", *arguments])
            assert result.exit_code == 2, (arguments, result.output)
            assert said in result.output, (arguments, result.output)
