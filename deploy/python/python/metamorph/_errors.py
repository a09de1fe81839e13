"""The errors of the package. No outcome of a run is an error: a deadlock is a result."""

from __future__ import annotations

from typing import NamedTuple, Optional, Sequence


class MetamorphError(Exception):
    """What every error of this package derives from."""


class Problem(NamedTuple):
    """One problem of a scenario."""

    #: Where it is: a line, a setting, or the file.
    place: str
    #: The line in the text, from 1, if it is there.
    line: Optional[int]
    #: The column, from 1.
    column: Optional[int]
    #: What is wrong.
    what: str
    #: What to do.
    fix: str


class ScenarioError(MetamorphError, ValueError):
    """A scenario that cannot be run. The text is that of the command; `problems` has each problem by itself."""

    def __init__(self, text: str, problems: Sequence[tuple[str, Optional[int], Optional[int], str, str]] = ()) -> None:
        super().__init__(text)
        self.problems = [Problem(*problem) for problem in problems]

    def __reduce__(self) -> tuple[type[ScenarioError], tuple[str, list[Problem]]]:
        return type(self), (self.args[0], self.problems)


class JournalError(MetamorphError):
    """A journal that cannot be written."""


class ProtocolError(MetamorphError):
    """An error in the code of a protocol; the error itself is the `__cause__`."""

    def __init__(self, text: str, module: Optional[int], now_ns: int, input: str) -> None:
        super().__init__(text)
        #: The module; None for `until` and `invariants`.
        self.module = module
        #: The scenario time in nanoseconds.
        self.now_ns = now_ns
        #: The call that raised it, such as `"message on port 2"`.
        self.input = input

    def __reduce__(self) -> tuple[type[ProtocolError], tuple[str, Optional[int], int, str]]:
        return type(self), (self.args[0], self.module, self.now_ns, self.input)


class SweepError(MetamorphError):
    """A sweep that cannot be run."""


class ProgramError(MetamorphError):
    """The program `metamorph` is missing, or failed."""
