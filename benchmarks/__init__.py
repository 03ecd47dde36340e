"""Measurements: ratios against hand-written C, figures of evidence, peers, controllers.

Run from the repository: ``python -m benchmarks.speed``, ``.evidence``, ``.peers``, ``.controllers``.
"""
