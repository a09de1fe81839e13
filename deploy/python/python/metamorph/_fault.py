"""Faults as objects."""

from __future__ import annotations

from typing import Iterable, Optional

from ._time import Duration, nanoseconds


class Fault(str):
    """A fault, as text: `Fault.kill(7, at="2s") == "kill 7@2000000000ns"`.

    With a time it is planned, for :func:`run`, :class:`Simulation` and :meth:`Scenario.with_fault`; without one it is
    injected now, by :meth:`Simulation.inject`. Text may be written instead.
    """

    __slots__ = ()

    @staticmethod
    def _number(module: int) -> int:
        if isinstance(module, bool) or int(module) != module or module < 0:
            raise ValueError(f"{module!r} is no module; they are numbered from 0")
        return int(module)

    @classmethod
    def _of(cls, verb: str, module: int, at: Optional[Duration] = None, until: Optional[Duration] = None) -> Fault:
        text = f"{verb} {cls._number(module)}"
        if at is not None:
            text += f"@{nanoseconds(at)}ns"
        if until is not None:
            text += f"..{nanoseconds(until)}ns"
        return cls(text)

    @classmethod
    def kill(cls, module: int, at: Optional[Duration] = None) -> Fault:
        """The process of the module dies."""
        return cls._of("kill", module, at)

    @classmethod
    def restart(cls, module: int, at: Optional[Duration] = None) -> Fault:
        """A dead module starts again, without its memory."""
        return cls._of("restart", module, at)

    @classmethod
    def pause(cls, module: int, at: Optional[Duration] = None, until: Optional[Duration] = None) -> Fault:
        """The process of the module is stopped; a planned pause needs its end."""
        if (at is None) != (until is None):
            raise ValueError("a planned pause needs `at` and `until`; one that is injected has neither")
        return cls._of("pause", module, at, until)

    @classmethod
    def partition_of(cls, modules: Iterable[int], at: Duration, until: Duration) -> Fault:
        """The modules are cut off from all others for a while. Text has a method `partition` of its own."""
        numbers = [cls._number(module) for module in modules]
        if not numbers:
            raise ValueError("a partition needs at least one module")
        listed = ",".join(str(number) for number in numbers)
        return cls(f"partition {listed}@{nanoseconds(at)}ns..{nanoseconds(until)}ns")

    @classmethod
    def resume(cls, module: int) -> Fault:
        """A stopped process goes on."""
        return cls._of("resume", module)

    @classmethod
    def stick(cls, module: int) -> Fault:
        """The body of the module can no longer move."""
        return cls._of("stick", module)

    @classmethod
    def unstick(cls, module: int) -> Fault:
        """The body can move again."""
        return cls._of("unstick", module)

    def __repr__(self) -> str:
        return f"<Fault {str(self)}>"


__all__ = ["Fault"]
