"""The program `metamorph`: the one in the wheel, else the one on the path."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NamedTuple, Optional

from ._errors import ProgramError


def find() -> str:
    """The path of the program."""
    bundled = Path(__file__).parent / "bin" / "metamorph"
    if bundled.exists():
        return str(bundled)
    here = Path(sys.argv[0]).resolve()
    found = shutil.which("metamorph")
    if found is None or Path(found).resolve() == here:
        raise ProgramError(
            "the program `metamorph` is not in this installation and not on the path\n"
            "  fix: install the package with `pip install ./deploy/python`, which builds it"
        )
    return found


class Program(NamedTuple):
    """What carries out a command line."""

    #: The words before the command.
    command: list[str]
    #: Its environment; that of this process if there is none.
    environment: Optional[dict[str, str]] = None


def own() -> Program:
    """The program of :func:`find`."""
    return Program([find()])


def main() -> None:
    """The command `metamorph` of the package."""
    try:
        program = find()
    except ProgramError as error:
        sys.exit(f"metamorph: {error}")
    os.execv(program, [program, *sys.argv[1:]])
