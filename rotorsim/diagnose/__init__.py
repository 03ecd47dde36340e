"""Diagnosis: locate where a model and recordings differ, name the missing physics, model it, show the fit improve."""

from __future__ import annotations

from rotorsim._lazy import callable_as, lazy

_HOME = {"Diagnosis": "conclusions", "diagnose": "diagnosis", "diagnosis_data": "files", "save_diagnosis": "files"}
__all__ = sorted(_HOME)
__getattr__, __dir__ = lazy(__name__, _HOME)
callable_as(__name__)
