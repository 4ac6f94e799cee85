"""How far the histories of two runs of one scene are apart."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np

Rows = list[dict[str, Any]]

EQUAL = 1e-8


def scales(rows: Rows) -> dict[str, float]:
    """The natural scale of every column but `seconds`: of forces, displacements, charges, potentials the largest."""
    own = {name: max(abs(row[name]) for row in rows) for name in rows[0]}
    for kinds in (("force_", "contact_force_"), ("displacement_",), ("charge@",), ("mean_potential@",)):
        alike = [name for name in own if name.startswith(kinds)]
        own |= dict.fromkeys(alike, max((own[name] for name in alike), default=0.0))
    for name in own:
        if name.startswith("force_"):
            # What bends freely has no reactions but rounding: the energy over a micrometre says what is none.
            own[name] = max(own[name], own["elastic"])
    potential = max((own[name] for name in own if name.startswith("mean_potential@")), default=0.0)
    for name in own:
        if name.startswith("charge@") and potential > 0.0:
            # Where only one boundary has a potential the charge is zero; the energy says what is not.
            own[name] = max(own[name], own["electric"] / potential)
    del own["seconds"]
    return own


def assert_equal(rows: Rows, reference: Rows, leave_out: Container[str] = ()) -> None:
    """The same columns and steps, and every number the same within 1e-8 of its scale, but those left out."""
    assert [set(row) for row in rows] == [set(row) for row in reference]
    found = {}
    for name, scale in scales(reference).items():
        ours, theirs = (np.array([row[name] for row in history], float) for history in (rows, reference))
        found[name] = float(np.nan_to_num(np.abs(ours - theirs).max() / (scale or 1.0), nan=np.inf))
    worst = max((name for name in found if name not in leave_out), key=found.__getitem__)
    assert found[worst] <= EQUAL, f"{worst} differs by {found[worst]:.1e} of its scale"
