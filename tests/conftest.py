"""What keeps tests cheap: one thread of linear algebra, no search for garbage at collection, and quick compilations."""

import gc
import os
import shutil
import sys
from pathlib import Path

import pytest

# For their many small matrices two threads cost several times the CPU of one. Read where numpy is first imported, and
# inherited by the commands that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
gc.disable()  # what pytest holds while it collects is no garbage
QUICK_CC = Path(__file__).with_name("quick_cc")


def pytest_configure(config: pytest.Config) -> None:
    """Set what the workers of a session and the commands that they start inherit."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else every worker and command compiles the package anew
    quick = config.option.markexpr == "not slow" and sys.platform != "win32" and shutil.which("cc")
    if quick and "ROTORSIM_CC" not in os.environ:  # optimising takes most of a compilation; with -m slow it is done
        os.environ["ROTORSIM_CC"] = str(QUICK_CC)


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()
