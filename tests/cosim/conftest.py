"""Exported FMUs that several tests share."""

from tests.fmi.conftest import fmu, run  # noqa: F401 - fixtures, here too
