"""What goes wrong with an FMU at work, as an error with everything that is known about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rotorsim.errors import Place, Problem, RotorsimError

_SHOWN = 5  # messages of the FMU in an error: the first, which may be the cause, and the last


class FmuError(RotorsimError):
    """An FMU failed at work.

    kind: "discard" (a step was refused: a shorter one may work), "error", "fatal", "crash" (its process died), "hang"
    (no answer within the time limit), "given up" (it hung so often in a fit that it is not asked any more), "value" (an
    output is not finite), "ended" (it asks for the end of the simulation), "endless" (its events accumulate), "load"
    (its library cannot be loaded), "refused" (by rotorsim, before the FMU was asked). function: FMI function, "" if not
    known; time: of the call [s]. last: time to which a refused step came [s]. log: (status, category, message) of the
    FMU.
    """

    exit_code = 1

    def __init__(
        self,
        what: str,
        *,
        kind: str,
        name: str,
        place: Place,
        function: str = "",
        time: float | None = None,
        last: float | None = None,
        log: Sequence[tuple[str, str, str]] = (),
        printed: Sequence[str] = (),
        hint: str = "",
    ) -> None:
        self.kind, self.function, self.time, self.last, self.log = kind, function, time, last, tuple(log)
        text = what + (f" (t = {time:.9g} s)" if time is not None else "")
        said = [f"{status}: {message}" for status, _, message in self.log if message and status != "OK"]
        said = said or [message for _, _, message in self.log if message]
        for line in _ends([*dict.fromkeys(said)]):
            text += f"\n  it said: {line[:500]}"
        for line in _ends(printed):
            text += f"\n  it printed: {line[:300]}"
        super().__init__(Problem(text, name, place, hint))

    def add_values(self, values: str) -> None:
        """Say with which values of its parameters the FMU failed."""
        problem = self.problems[0]
        first, line, rest = problem.what.partition("\n")
        RotorsimError.__init__(self, replace(problem, what=f"{first} with {values}{line}{rest}"))


def _ends(lines: Sequence[str]) -> list[str]:
    """Return the first of many lines, how many are left out, and the last."""
    if len(lines) <= _SHOWN:
        return [*lines]
    return [lines[0], f"({len(lines) - _SHOWN} more)", *lines[1 - _SHOWN :]]
