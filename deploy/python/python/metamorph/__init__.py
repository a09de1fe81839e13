"""Swarms of self-reconfigurable modular robots: runs, sweeps, and simulations in steps.

    >>> import metamorph as mm
    >>> mm.run("swarm", seed=1).outcome
    'built'
"""

from ._api import Progress, Report, Scenario, Simulation, Sweep, run, scenarios, sweep
from ._errors import JournalError, MetamorphError, Problem, ProgramError, ScenarioError, SweepError
from ._metamorph import VERSION as __version__
from ._table import Table

__all__ = [
    "JournalError",
    "MetamorphError",
    "Problem",
    "Progress",
    "ProgramError",
    "Report",
    "Scenario",
    "ScenarioError",
    "Simulation",
    "Sweep",
    "SweepError",
    "Table",
    "__version__",
    "run",
    "scenarios",
    "sweep",
]
