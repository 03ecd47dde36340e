"""Which faults are detectable and isolable with which sensors, before anything is measured."""
