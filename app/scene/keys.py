"""What the tables of a scene file have in common: strict keys, and the kinds of their values."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Direction = Annotated[list[float], Field(min_length=2, max_length=3)]
Name = Annotated[str, Field(min_length=1)]


_PREFIXES = {"f": 1e-3, "p": 1.0, "n": 1e3, "u": 1e6, "m": 1e9, "": 1e12}  # of the farad, in pF


def _picofarads(value: Any) -> Any:
    """The number of pF that a text such as "10 pF" stands for; anything else as it is, for pydantic to judge."""
    found = re.fullmatch(r"([0-9.]+(?:[eE][+-]?[0-9]+)?) *([fpnum]?)F", value) if isinstance(value, str) else None
    try:
        return float(found[1]) * _PREFIXES[found[2]] if found else value
    except ValueError:
        return value


# A capacitance, pC/V.
Capacitance = Annotated[
    float,
    Field(gt=0),
    BeforeValidator(_picofarads),
    WithJsonSchema({"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "string"}]}),
]


class Keys(BaseModel):
    """A table of the scene file: exactly the known keys, exactly their types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
