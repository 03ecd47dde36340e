"""``rotorsim check``, ``fmt``, ``diff``, ``swap``, ``blocks``, ``draw`` and ``cache``."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from rotorsim.diagram.resolve.registry import all_types
from rotorsim.diagram.resolve.resolution import shipped_diagrams

DIAGRAMS = sorted(shipped_diagrams())


@pytest.mark.slow
def test_every_shipped_diagram_is_right_and_canonical(run) -> None:
    assert run("check", *DIAGRAMS).exit_code == 0
    result = run("fmt", "--check", *(str(file) for file in shipped_diagrams().values()))
    assert (result.exit_code, result.stdout) == (0, "")


def test_check_finds_all_mistakes_of_all_files(run, oscillator) -> None:
    text = oscillator.read_text()
    Path("bad.json").write_text(text.replace('"gain",', '"gian",').replace('"stop": 1.0', '"stop": "1 m"'))
    result = run("check", str(oscillator), "bad.json")
    assert result.exit_code == 2
    assert result.stdout == f"{oscillator}: 2 blocks, 2 wires, no mistakes\n"
    places = [line.split(": ")[0] for line in result.stderr.splitlines() if line.startswith("bad.json")]
    assert len(places) >= 2
    assert all(place.count(":") == 2 for place in places)
    data = json.loads(run("check", str(oscillator), "bad.json", "--json").stdout)["diagrams"]
    assert [entry["valid"] for entry in data] == [True, False]
    assert all(problem["hint"] for problem in data[1]["problems"])


def test_fmt_is_idempotent_and_changes_no_meaning(run, oscillator) -> None:
    before = json.loads(oscillator.read_text())
    assert run("fmt", "--check", str(oscillator)).exit_code == 1
    first = run("fmt", str(oscillator))
    assert (first.exit_code, first.stdout, first.stderr) == (0, f"{oscillator}\n", "1 of 1 file changed\n")
    assert json.loads(oscillator.read_text()) == before
    assert run("fmt", str(oscillator)).stderr == "0 of 1 file changed\n"
    assert run("fmt", "--check", str(oscillator)).exit_code == 0


def test_fmt_refuses_what_is_not_json_and_leaves_it(run) -> None:
    Path("x.json").write_text('{"blocks": {},}')
    result = run("fmt", "x.json")
    assert result.exit_code == 2
    assert result.stderr == "x.json:1:14: error: not valid JSON: comma before '}'\n\nhint: remove the comma\n"
    assert Path("x.json").read_text() == '{"blocks": {},}'


def test_diff_compares_meaning(run, oscillator) -> None:
    other = json.loads(oscillator.read_text())
    other["wires"].reverse()
    other["description"] = "the same"
    Path("same.json").write_text(json.dumps(other))
    assert run("diff", str(oscillator), "same.json").exit_code == 0
    assert run("diff", str(oscillator), "same.json", "--layout").exit_code == 1
    other["blocks"]["rate"]["parameters"]["gain"] = -2.0
    Path("other.json").write_text(json.dumps(other))
    result = run("diff", str(oscillator), "other.json")
    assert (result.exit_code, result.stdout) == (1, "~ blocks.rate.parameters.gain: -1.0 -> -2.0\n")
    data = json.loads(run("diff", str(oscillator), "other.json", "--json").stdout)
    assert data == {
        "equal": False,
        "changes": [{"kind": "~", "where": "blocks.rate.parameters.gain", "old": -1.0, "new": -2.0}],
    }


@pytest.mark.slow
def test_swap_designs_a_state_feedback_that_levitates(run) -> None:
    result = run("swap", "jeffcott", "controller", "state_feedback", "-o", "new.json")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == (
        "controller: pid -> state_feedback; designed from the linearised plant; written: new.json\n"
    )
    assert run("check", "new.json").exit_code == 0
    assert json.loads(run("modes", "new.json", "--json").stdout)["stable"]
    assert run("run", "new.json", "--stop", "0.5 s").exit_code == 0
    assert run("fmt", "--check", "new.json").exit_code == 0


def test_swap_to_stdout_and_in_place(run) -> None:
    text = run("swap", "jeffcott", "controller", "pd").stdout
    assert json.loads(text)["blocks"]["controller"]["type"] == "pd"
    Path("mine.json").write_text(text)
    assert run("swap", "mine.json", "controller", "pid", "--in-place", "--set", "KI=7").exit_code == 0
    controller = json.loads(Path("mine.json").read_text())["blocks"]["controller"]
    assert controller["type"] == "pid"
    assert controller["parameters"]["KI"] == 7
    assert controller["parameters"]["KP"] == "12200 A/m"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["controler", "pd"], "error: controler: no block 'controler'\n\nhint: did you mean 'controller'?\n"),
        (["controller", "pdd"], "error: controller: unknown block type 'pdd'\n\nhint: did you mean 'pd' or 'pid'?\n"),
        (
            ["controller", "pd", "--in-place"],
            "error: jeffcott comes with rotorsim and stays as it is\n\nhint: use -o FILE\n",
        ),
        (
            ["controller", "state_feedback", "--set", "weight=2"],
            "error: controller: the design has no weight 'weight'\n\n"
            "hint: did you mean 'noise_weight' or 'current_weight'?\n",
        ),
    ],
)
def test_wrong_swaps(run, arguments, text) -> None:
    result = run("swap", "jeffcott", *arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == text


def test_swap_to_a_block_with_other_ports_names_what_fits(run) -> None:
    result = run("swap", "jeffcott", "controller", "gain")
    assert result.exit_code == 2
    assert "error: controller.displacement: type 'gain' has no input 'displacement', which is wired" in result.stderr
    assert "hint: types that fit: " in result.stderr


def test_blocks_lists_every_type(run) -> None:
    listed = {line.split()[0] for line in run("blocks").stdout.splitlines() if line.startswith("  ")}
    assert listed == set(all_types())
    assert set(json.loads(run("blocks", "--json").stdout)["blocks"]) == set(all_types())


def test_one_block(run) -> None:
    lines = run("blocks", "sum").stdout.splitlines()
    assert lines[0] == "sum (elementary)"
    assert "  signs  one sign, + or -, for each input; default ++" in lines
    assert lines[-1] == "source: Simulink: Sum"


def test_unknown_block(run) -> None:
    result = run("blocks", "pidd")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: unknown block type 'pidd'\n\nhint: did you mean 'pid'")


@pytest.mark.parametrize("name", all_types())
def test_every_block_says_what_it_is_and_where_it_is_from(run, name: str) -> None:
    data = json.loads(run("blocks", name, "--json").stdout)["blocks"][name]
    assert data["summary"].endswith(".")
    assert data["source"]
    for kind in ("inputs", "outputs", "parameters", "options"):
        for item, declared in data[kind].items():
            assert declared["doc"], f"{name}.{item} has no doc"


@pytest.mark.parametrize("name", DIAGRAMS)
def test_draw_names_every_block(run, name: str) -> None:
    result = run("draw", name, "-o", "d.svg")
    assert (result.exit_code, result.stdout) == (0, "")
    text = "".join(ET.parse("d.svg").getroot().itertext())
    blocks = json.loads(shipped_diagrams()[name].read_text())["blocks"]
    assert [block for block in blocks if block not in text] == []
    assert run("draw", name).stdout.strip() == Path("d.svg").read_text().strip()


def test_cache_counts_and_clears(run, monkeypatch, tmp_path, oscillator) -> None:
    folder = tmp_path / "cache"
    monkeypatch.setenv("ROTORSIM_CACHE", str(folder))
    assert json.loads(run("cache", "--json").stdout)["files"] == 0
    ran = run("run", str(oscillator))
    expected = 0 if "virtual machine" in ran.stderr else 1  # no compiler here
    data = json.loads(run("cache", "--clear", "--json").stdout)
    assert (data["folder"], data["files"]) == (str(folder), expected)
    assert json.loads(run("cache", "--json").stdout)["files"] == 0


def test_swap_puts_an_fmu_into_the_place_of_a_block(run):
    Path("mine.json").write_text(shipped_diagrams()["jeffcott"].read_text())
    assert run("fmu", "export", "mine.json", "--block", "controller", "-o", "c.fmu").exit_code == 0
    assert run("swap", "mine.json", "controller", "fmu", "--set", "file=c.fmu", "--in-place").exit_code == 0
    gains = {"KP": "12200 A/m", "KI": "2000 A/(m s)", "KD": "3 A s/m"}
    entry = {"type": "fmu", "file": "c.fmu", "parameters": gains}  # those of the block, which the FMU has, too
    assert json.loads(Path("mine.json").read_text())["blocks"]["controller"] == entry
    assert run("check", "mine.json").exit_code == 0


@pytest.mark.parametrize(
    ("diagram", "file", "out", "written"),
    [
        ("jeffcott", "c.fmu", "new.json", "c.fmu"),
        ("jeffcott", "c.fmu", "sub/new.json", "../c.fmu"),
        ("jeffcott", "sub/d.fmu", "sub/new.json", "d.fmu"),
        ("sub/mine.json", "c.fmu", "new.json", "c.fmu"),
        ("sub/mine.json", "c.fmu", None, "../c.fmu"),  # in place
        ("jeffcott", "ABSOLUTE/c.fmu", "new.json", "c.fmu"),
    ],
)
def test_the_fmu_is_named_from_where_the_user_stands(run, diagram, file, out, written) -> None:
    Path("sub").mkdir()
    Path("sub/mine.json").write_text(shipped_diagrams()["jeffcott"].read_text())
    assert run("fmu", "export", "jeffcott", "--block", "controller", "-o", "c.fmu").exit_code == 0
    Path("sub/d.fmu").write_bytes(Path("c.fmu").read_bytes())
    file = file.replace("ABSOLUTE", str(Path.cwd()))
    result = run(
        "swap", diagram, "controller", "fmu", "--set", f"file={file}", *(["-o", out] if out else ["--in-place"])
    )
    assert (result.exit_code, result.stderr) == (0, f"controller: pid -> fmu; written: {out or diagram}\n")
    new = out or diagram
    assert json.loads(Path(new).read_text())["blocks"]["controller"]["file"] == written
    assert run("check", new).exit_code == 0


def test_the_file_of_an_fmu_is_no_parameter(run) -> None:
    """It was accepted, and the FMU stayed the old one."""
    assert run("fmu", "export", "jeffcott", "--block", "controller", "-o", "c.fmu").exit_code == 0
    assert run("swap", "jeffcott", "controller", "fmu", "--set", "file=c.fmu", "-o", "new.json").exit_code == 0
    result = run("cosim", "new.json", "--step", "0.1 ms", "--set", "controller.file=other.fmu")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == (
        "--set: error: controller: the file is a key of the block, no parameter\n\n"
        "hint: it has the block's ports: rotorsim swap DIAGRAM controller fmu --set file=FILE\n"
    )


def test_a_folder_does_not_stand_before_a_shipped_diagram(run) -> None:
    Path("jeffcott").mkdir()
    assert run("swap", "jeffcott", "controller", "pd").stderr == "controller: pid -> pd\n"
    result = run("check", "jeffcott")
    assert (result.exit_code, result.stdout) == (0, "jeffcott: 8 blocks, 14 wires, no mistakes\n")
    result = run("swap", "jeffcott", "controller", "pd", "--in-place")
    assert result.stderr.startswith("error: jeffcott comes with rotorsim and stays as it is")


def test_a_file_before_a_shipped_diagram_is_told(run) -> None:
    Path("jeffcott").write_text(shipped_diagrams()["fe_rigid"].read_text())
    warning = (
        "jeffcott: warning: this is the file of the current folder, not the diagram that comes with rotorsim\n\n"
        "hint: write ./jeffcott to mean the file; rename it to mean the other\n"
    )
    for arguments in (("check", "jeffcott"), ("diff", "jeffcott", "./jeffcott"), ("modes", "jeffcott")):
        assert run(*arguments).stderr.startswith(warning)
    assert run("check", "./jeffcott").stderr == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["controller", "fmu"], "error: controller: an FMU needs its file\n\nhint: add --set file=controller.fmu"),
        (["controler", "fmu", "--set", "file=c.fmu"], "error: controler: no block 'controler'\n\nhint: did you mean"),
        (
            ["controller", "fmu", "--set", "file=c.fmu"],
            "error: --set file=c.fmu: there is no such file\n\nhint: it is t",
        ),
    ],
)
def test_swap_with_an_fmu_that_is_not_there(run, arguments: list[str], said: str) -> None:
    Path("mine.json").write_text(shipped_diagrams()["jeffcott"].read_text())
    result = run("swap", "mine.json", *arguments)
    assert result.exit_code == 2
    assert said in result.stderr


def test_new_copies_a_shipped_diagram_under_its_name(run) -> None:
    done = run("new", "mine")
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "written: mine.json\n")
    assert json.loads(run("new", "models.json", "--from", "fe_flexible", "--json").stdout) == {
        "file": "models.json",
        "from": "fe_flexible",
    }
    copied, shipped = Path("mine.json"), shipped_diagrams()["jeffcott"]
    assert copied.read_text() == shipped.read_text().replace('"name": "jeffcott"', '"name": "mine"')
    assert Path("diagram.schema.json").read_bytes() == shipped.with_name("diagram.schema.json").read_bytes()
    assert run("check", "mine.json", "models.json").exit_code == 0
    done = run("new", "mine.json", "--from", "jeffcot")
    assert done.exit_code == 2
    assert done.stderr == (
        "error: --from jeffcot: no diagram of this name\n\nhint: did you mean 'jeffcott' or 'jeffcott_rub' or "
        "'jeffcott_runup'?\n\n"
        "mine.json: error: is there already\n\nhint: choose another name, or delete the file\n"
    )


def test_docs_shows_the_pages(run) -> None:
    pages = Path(__file__).parents[2] / "docs"
    lines = run("docs").stdout.splitlines()
    assert [line.split()[0] for line in lines] == sorted(page.stem for page in pages.glob("*.md"))
    assert ["engine", "How the engine works"] in [line.split(maxsplit=1) for line in lines]
    assert run("docs", "engine").stdout == (pages / "engine.md").read_text()
    data = json.loads(run("docs", "engine.md", "--json").stdout)
    assert (data["page"], data["title"]) == ("engine", "How the engine works")
    done = run("docs", "engin")
    assert (done.exit_code, done.stderr) == (2, "error: no page 'engin'\n\nhint: did you mean 'engine'?\n")


def test_blocks_of_the_folders_of_a_diagram(run) -> None:
    Path("mine.json").write_text('{"block_folders": ["my_blocks"], "blocks": {}}')
    Path("other.json").write_text("[")
    Path("my_blocks").mkdir()
    Path("my_blocks/my_block.py").write_text(
        "from rotorsim.block import Block\nclass MyBlock(Block):\n    'Do nothing.'\nprint('it ran')\n"
    )
    done = run("blocks", "my_block")
    assert (done.exit_code, done.stdout) == (2, "")  # block files are code: none runs without a word
    assert done.stderr == (
        "error: unknown block type 'my_block'\n\n"
        "hint: add --trust-blocks if it is in my_blocks; did you mean 'clock'?\n"
    )
    assert run("blocks", "my_block", "--trust-blocks").stdout.startswith("it ran\nmy_block (elementary)\nDo nothing.\n")
    assert "  my_block " in run("blocks", "--trust-blocks", "--diagram", "mine.json").stdout
    done = run("blocks", "--trust-blocks", "--diagram", "other.json")
    assert (done.exit_code, done.stderr.partition(" error: ")[0]) == (2, "other.json:1:2:")


def test_swap_sets_an_entry_of_a_parameter(run) -> None:
    done = run("swap", "fe_flexible", "support_left", "support", "--set", "stiffness[2]=7 N/um", "--json")
    written = json.loads(done.stdout)["diagram"]["blocks"]["support_left"]["parameters"]["stiffness"]
    assert written == [495.82e6, "7 N/um"]
