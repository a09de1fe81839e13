"""The program within the interpreter, for runs whose protocol is written in Python: it shows their records, and is controller and agents
of their processes. `python -m metamorph --protocol CLASS UNTIL view run.journal`."""

from __future__ import annotations

import importlib
import os
import sys
from functools import reduce
from typing import Any, Callable, Optional

from . import _metamorph as _native
from ._program import Program
from ._protocol import Protocol, Until, _given

#: Names class and `until`, as `module:name`, before the command.
OPTION = "--protocol"
#: Stands for what cannot be imported: a record is shown without the names of its messages then.
NONE = "-"


def name_of(given: Optional[Callable[..., Any]]) -> str:
    """The name by which another process imports a class or a function."""
    module, qualified = getattr(given, "__module__", None), getattr(given, "__qualname__", "<")
    if module is None or "<" in qualified:
        return NONE
    if module == "__main__":
        # A script is imported by the name of its file, which is beside others on the path of a script.
        file = getattr(sys.modules["__main__"], "__file__", None)
        module = os.path.splitext(os.path.basename(file))[0] if file is not None else ""
    return f"{module}:{qualified}" if module.isidentifier() or "." in module else NONE


def within(protocol: Optional[type[Protocol]], until: Optional[Until]) -> Program:
    """The program within an interpreter."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    return Program([sys.executable, "-m", "metamorph", OPTION, name_of(protocol), name_of(until)], environment)


def _imported(name: str) -> Any:
    if name == NONE:
        return None
    module, _, attributes = name.partition(":")
    return reduce(getattr, attributes.split("."), importlib.import_module(module))


def main(protocol: str, until: str, words: list[str]) -> None:
    """Carries out a command."""
    given = None if protocol == NONE else _given(_imported(protocol), _imported(until), (), None)
    leading = ["-m", "metamorph", OPTION, protocol, until]
    sys.exit(0 if _native.program(leading, ["metamorph", *words], given) else 1)
