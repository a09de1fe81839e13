"""Swarms of self-reconfigurable modular robots: runs, sweeps, simulations in steps, and protocols of your own.

    >>> import metamorph as mm
    >>> mm.run("swarm", seed=1).outcome
    'built'
"""

from ._api import Progress, Report, Scenario, Simulation, Sweep, run, scenarios, sweep
from ._commands import Diff, Figure, Page, diff, doctor, export, render, view
from ._determinism import check_determinism
from ._errors import JournalError, MetamorphError, Problem, ProgramError, ProtocolError, ScenarioError, SweepError
from ._fault import Fault
from ._journal import Journal
from ._metamorph import VERSION as __version__
from ._metamorph import Context
from ._protocol import Param, Percept, Protocol, cell, i8, i16, i32, i64, message, u8, u16, u32, u64
from ._table import Table

__all__ = [
    "Context",
    "Diff",
    "Fault",
    "Figure",
    "Journal",
    "JournalError",
    "MetamorphError",
    "Page",
    "Param",
    "Percept",
    "Problem",
    "Progress",
    "ProgramError",
    "Protocol",
    "ProtocolError",
    "Report",
    "Scenario",
    "ScenarioError",
    "Simulation",
    "Sweep",
    "SweepError",
    "Table",
    "__version__",
    "cell",
    "check_determinism",
    "diff",
    "doctor",
    "export",
    "i16",
    "i32",
    "i64",
    "i8",
    "message",
    "render",
    "run",
    "scenarios",
    "sweep",
    "u16",
    "u32",
    "u64",
    "u8",
    "view",
]
