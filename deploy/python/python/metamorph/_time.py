"""Durations."""

from __future__ import annotations

from datetime import timedelta
from typing import Union

from . import _metamorph as _native

#: Text as in scenarios ("200ms"), or seconds of scenario time.
Duration = Union[str, float, int, timedelta]


def nanoseconds(duration: Duration) -> int:
    """A duration in nanoseconds."""
    if isinstance(duration, timedelta):
        whole: int = duration // timedelta(microseconds=1)
        return whole * 1000
    if isinstance(duration, str):
        return _native.nanoseconds(duration)
    if not duration >= 0:
        raise ValueError(f"{duration} is no duration; it must not be negative")
    return round(float(duration) * 1_000_000_000)
