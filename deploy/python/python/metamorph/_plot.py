"""Plots with matplotlib, which is needed only here."""

from __future__ import annotations

from typing import Any, Optional

from ._table import Table


#: Characters of labels that fit side by side below axes of the usual width.
_ACROSS = 60


def _axes(ax: Optional[Any]) -> Any:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]


def boxes(runs: Table, column: str, by: Optional[str], ax: Optional[Any]) -> Any:
    """A box of a column for each value of another one."""
    for name in (column, *([by] if by is not None else [])):
        if name not in runs.columns:
            raise ValueError(f"there is no column `{name}`; the columns are {', '.join(runs.columns)}")
    columns = runs.to_dict()
    groups: dict[str, list[float]] = {}
    for i, value in enumerate(columns[column]):
        # A run that was not built has no makespan.
        if value is not None:
            groups.setdefault("all" if by is None else str(columns[by][i]), []).append(value)
    if not groups:
        raise ValueError(f"no run has a value in `{column}`")
    ax = _axes(ax)
    ax.boxplot(list(groups.values()))
    labels = [f"{name}\nn = {len(values)}" for name, values in groups.items()]
    # Side by side they would overlap.
    is_wide = sum(len(name) + 2 for name in groups) > _ACROSS
    turned = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"} if is_wide else {}
    ax.set_xticks(range(1, len(groups) + 1), labels, **turned)
    ax.set_xlabel(by or "")
    ax.set_ylabel(column)
    return ax


def bars(messages: Table, ax: Optional[Any]) -> Any:
    """A bar for each class of messages that were sent."""
    counts = [(name, n) for name, n in zip(messages["class"], messages["sent"]) if n > 0]
    ax = _axes(ax)
    ax.barh([name for name, _ in counts], [n for _, n in counts])
    ax.invert_yaxis()
    ax.set_xlabel("messages sent")
    return ax
