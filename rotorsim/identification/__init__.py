"""From recordings to parameters: regression, maximum likelihood, intervals, verdicts, the next experiment."""
