"""The page of the measured run-up prints what its command prints, where the recording is here."""

from __future__ import annotations

import re
import shutil

import pytest

from benchmarks.identification.rotor_kit import main
from tests.docs.pages import ROOT, page_text

TABLE = ROOT.parent / "shared" / "recordings" / "rk4_runup" / "runup_1x.csv"


@pytest.mark.slow
@pytest.mark.skipif(not TABLE.exists(), reason="the shared recordings are not here")
def test_the_page_shows_what_the_command_prints(tmp_path, capsys) -> None:
    page = page_text("docs/runup.md")
    [document] = re.findall(r"^```json\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    [shown] = re.findall(r"^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "recording.json").write_text(document)
    shutil.copy(TABLE, tmp_path)
    main([str(tmp_path)])
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line.split() for line in shown.splitlines()] == printed
