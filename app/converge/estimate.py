"""The limit of a sequence of values on finer and finer meshes, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

SLOWEST, FASTEST = 0.5, 6.0  # powers of the mesh size that an error is believed to fall with
SAFETY = 1.25  # on the distance between the finest value and the limit (Roache, 1994)


class Estimate(NamedTuple):
    """A limit, its uncertainty, and the power of the mesh size found; power None: not regular, the finest value."""

    value: float
    uncertainty: float
    power: float | None


def limit(sizes: Sequence[float], values: Sequence[float]) -> Estimate:
    """The limit of values (n,) on meshes of these sizes, the coarsest first.

    Richardson's extrapolation of the three finest where a + b h^p goes through them with p between 0.5 and 6. Else the
    finest value. Its uncertainty is then the last change where p is larger, and the spread of the three finest where
    they do not approach anything; infinite with fewer than two.
    """
    h, v = np.asarray(sizes, float)[-3:], np.asarray(values, float)[-3:]
    if len(v) < 2:
        return Estimate(float(v[-1]) if len(v) else float("nan"), float("inf"), None)
    spread = float(np.ptp(v))
    if len(v) < 3:
        return Estimate(float(v[-1]), spread, None)
    first, last = v[0] - v[1], v[1] - v[2]
    if last == 0.0 or first * last <= 0.0:
        return Estimate(float(v[-1]), spread, None)

    def mismatch(power: float) -> float:
        return (h[0] ** power - h[1] ** power) / (h[1] ** power - h[2] ** power) - first / last

    if mismatch(FASTEST) < 0.0:  # falls faster still: the coarsest mesh shows nothing of the power
        return Estimate(float(v[-1]), SAFETY * abs(float(last)), None)
    if mismatch(SLOWEST) > 0.0:
        return Estimate(float(v[-1]), spread, None)
    power = float(brentq(mismatch, SLOWEST, FASTEST))
    change = last * h[2] ** power / (h[1] ** power - h[2] ** power)
    return Estimate(float(v[-1] - change), SAFETY * abs(float(change)), power)


def best(estimates: Sequence[Estimate]) -> Estimate:
    """The estimate of several series that is least uncertain, with what another that is as certain is off added.

    Series that disagree by more than their uncertainties make the limit that much more uncertain.
    """
    chosen = min(estimates, key=lambda estimate: estimate.uncertainty)
    uncertainty = chosen.uncertainty
    for other in estimates:
        apart = abs(other.value - chosen.value) - other.uncertainty
        if np.isfinite(apart) and apart > uncertainty:
            uncertainty = apart
    return Estimate(chosen.value, float(uncertainty), chosen.power)
