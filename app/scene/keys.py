"""What the tables of a scene file have in common: strict keys, and the kinds of their values."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Direction = Annotated[list[float], Field(min_length=2, max_length=3)]
Name = Annotated[str, Field(min_length=1)]


class Keys(BaseModel):
    """A table of the scene file: exactly the known keys, exactly their types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
