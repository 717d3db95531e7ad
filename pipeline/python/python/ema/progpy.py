"""Prognoses in the form that predictors of progpy give: samples of the time of an event."""

from __future__ import annotations

import math
import random
from typing import Any, Mapping, Sequence


def time_of_event(told: Mapping[str, Any] | Sequence[Mapping[str, Any]], left: bool = False) -> Any:
    """Samples of when thresholds are passed, as the ``time_of_event`` of a prediction of progpy.

    Args:
        told: what `ema.prognosis` gave with ``samples=True``, of one actuator: one dict, or those of several thresholds. Samples
            of several thresholds are independent of each other.
        left: count from the last test instead of from the clock's zero.

    Returns:
        ``progpy.uncertain_data.UnweightedSamples`` where progpy is there, else a list of dicts: an event (``fsj``, ``zeta``) and
        its time [units of ``clock``] each; None where it is not passed within the horizon, as in progpy.
    """
    all_told = [told] if isinstance(told, Mapping) else list(told)
    # the joint threshold is the first of the others
    events = {t["fault"]: t for t in all_told if t["fault"] != "joint" and t.get("samples")}
    rows = min((len(t["samples"]) for t in events.values()), default=0)
    columns: dict[str, list[float | None]] = {}
    for k, (event, t) in enumerate(events.items()):
        # every so many of the longer ones
        times = [t["samples"][i * len(t["samples"]) // rows] for i in range(rows)]
        # they are in order: beside each other they would say that early goes with early
        random.Random(k).shuffle(times)
        start = 0.0 if left else t["at"]
        columns[event] = [None if x == math.inf else start + x for x in times]
    samples = [{event: column[i] for event, column in columns.items()} for i in range(rows)]
    try:
        from progpy.uncertain_data import UnweightedSamples
    except ImportError:
        return samples
    return UnweightedSamples(samples)
