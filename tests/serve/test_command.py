"""The verb ``serve``: its address, its end, wrong arguments."""

from __future__ import annotations

import asyncio
import json
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
from tornado.websocket import websocket_connect

from rotorsim.cli.app import rotorsim
from rotorsim.diagram.resolve.resolution import shipped_diagrams

ADDRESS = re.compile(r"http://127\.0\.0\.1:(\d+)/#([A-Za-z0-9_-]{43})\n")


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_ctrl_c_does_not_wait_for_what_is_computed(tmp_path: Path) -> None:
    (tmp_path / "rotor.json").write_bytes(shipped_diagrams()["drawn_rotor"].read_bytes())
    command = [sys.executable, "-m", "rotorsim", "serve", "rotor.json", "--no-browser", "--port", "0", "--json"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    lines = "".join(iter(lambda: process.stdout.readline() if process.stdout else "", "}\n"))
    address = re.search(r"http://([0-9.:]+)/#([A-Za-z0-9_-]+)", lines)
    assert address is not None

    async def talking() -> None:
        connection = await websocket_connect(f"ws://{address[1]}/api/live", max_message_size=50_000_000)
        await connection.write_message(json.dumps({"token": address[2]}))
        await connection.read_message()
        await connection.write_message(json.dumps({"id": 1, "kind": "analyse", "what": "campbell"}))
        await asyncio.sleep(1.0)  # it takes some seconds
        process.send_signal(signal.SIGINT)
        begun = time.monotonic()
        while process.poll() is None and time.monotonic() - begun < 20:
            await asyncio.sleep(0.02)
        assert time.monotonic() - begun < 2.0
        while await connection.read_message() is not None:
            pass
        connection.close()
        await asyncio.sleep(0.05)

    asyncio.run(talking())
    process.stdout.close()
    assert process.returncode == 0


def test_the_browser_is_not_given_the_token_as_an_argument(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which all users of a machine can read."""
    opened: list[str] = []

    def browse(url: str) -> bool:
        opened.append(url)
        file = Path(url.removeprefix("file://"))
        assert file.stat().st_mode & 0o077 == 0
        assert re.search(r'url=http://127\.0\.0\.1:\d+/#[A-Za-z0-9_-]{43}">', file.read_text())
        os.kill(os.getpid(), signal.SIGINT)
        return True

    monkeypatch.chdir(mine.parent)
    monkeypatch.setattr("webbrowser.open", browse)
    result = CliRunner().invoke(rotorsim, ["serve", "mine.json", "--port", "0"])
    assert result.exit_code == 0, result.output
    [url] = opened
    assert url.startswith("file://")
    assert "#" not in url
    assert not Path(url.removeprefix("file://")).exists()


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
