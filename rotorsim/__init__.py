"""Block diagrams, FMUs and diagnosis for rotors in active magnetic bearings.

import rotorsim
diagram = rotorsim.load("jeffcott")
result = rotorsim.simulate(diagram, parameters={"speed": "1500 rpm"})
result.plot().savefig("jeffcott.png")
"""

from __future__ import annotations

from rotorsim._lazy import lazy

_HOME = {
    "Block": "block",
    "Channel": "recordings.recording",
    "Diagnosis": "diagnosis.conclude.result",
    "Diagram": "diagram.diagram",
    "Identification": "identification.result",
    "NewRun": "recordings.writing",
    "Recording": "recordings.recording",
    "Result": "simulation.result",
    "RotorsimError": "errors",
    "Run": "recordings.recording",
    "accept": "acceptance.acceptance",
    "amplitudes": "report.amplitudes",
    "campbell": "linear.modes.campbell",
    "check_signals": "measure.checks",
    "compile_diagram": "model.compiled",
    "cosimulate": "cosim.cosimulation",
    "critical_speed_map": "linear.modes.critical_speed_map",
    "critical_speeds": "signals.orders.critical_speeds",
    "design_state_feedback": "linear.control.design",
    "diagnose": "diagnosis.diagnosis",
    "envelope": "signals.envelopes",
    "equilibrium": "linear.linearisation",
    "export_fmu": "fmi.export.export",
    "frequency_response": "linear.control.frequency",
    "full_spectrum": "signals.spectrum",
    "harmonics": "signals.spectrum",
    "identify": "identification.identification",
    "linearise": "linear.linearisation",
    "load": "model.load",
    "load_injection": "recordings.injection",
    "load_orders": "recordings.orders",
    "load_recording": "recordings.loading",
    "load_result": "simulation.files",
    "margins": "linear.control.margins",
    "measured_margins": "signals.injection.measured_margins",
    "modes": "linear.modes.eigenmodes",
    "open_fmu": "fmi.runtime.slave",
    "periodic": "settled.periodic",
    "reconstruction_error": "signals.spectrum",
    "resonance_peaks": "signals.envelopes",
    "root_locus": "linear.control.root_locus",
    "run_up": "signals.envelopes",
    "save": "simulation.files",
    "save_diagnosis": "diagnosis.files",
    "save_ensemble": "simulation.ensemble.files",
    "save_identification": "identification.files",
    "save_orders": "recordings.order_writing",
    "save_recording": "recordings.writing",
    "separation_margin": "signals.orders.resonance",
    "settled_start": "settled.periodic",
    "simulate": "simulation.run",
    "simulate_as_recorded": "identification.as_recorded",
    "simulate_many": "simulation.ensemble.many",
    "step_response": "linear.control.step_response",
    "tracked_recording": "signals.orders.extraction",
}
__all__ = ["__version__", *_HOME]
__version__ = "0.1.0"
__getattr__, __dir__ = lazy(__name__, _HOME)
