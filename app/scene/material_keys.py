"""[materials.NAME]: the constants of a material of the scene."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, create_model, model_validator

from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import VACUUM_PERMITTIVITY, Material, permittivity_matrix, piezo_matrix
from piezomat.scene.errors import SceneError, named, shown, unknown_name
from piezomat.scene.keys import Direction, Keys, Positive, Vector3, Vector6

# pC/(V um). A number in another unit, or one that is nothing beside the stiffness, would make charges out of rounding.
LEAST_PERMITTIVITY = 1e-9


class PiezoKeys(Keys):
    """Piezoelectric stress constants by name, pC/um2."""

    e31: float = Field(description="stress along axis 1 for a field along axis 3, the poling")
    e32: float = Field(description="along axis 2")
    e33: float = Field(description="along axis 3")
    e15: float = Field(0.0, description="shear in the plane of axes 1 and 3 for a field along axis 1")
    e24: float = Field(0.0, description="shear in the plane of axes 2 and 3 for a field along axis 2")


class MaterialKeys(Keys):
    """[materials.NAME]: a material of the scene, from nothing or from a built-in one."""

    like: str | None = Field(None, description=f"built-in material to start from: {named(list(BUILT_IN))}")
    young: Positive | None = Field(None, description="Young's modulus, MPa")
    poisson: Annotated[float, Field(gt=-1, lt=0.5)] | None = Field(None, description="Poisson's ratio")
    stiffness: Annotated[list[Vector6], Field(min_length=6, max_length=6)] | None = Field(
        None, description="6x6 at constant field, MPa, Voigt order 11 22 33 23 13 12"
    )
    piezo: PiezoKeys | Annotated[list[Vector6], Field(min_length=3, max_length=3)] | None = Field(
        None, description="constants by name or 3x6, pC/um2; absent: not piezoelectric"
    )
    permittivity: Positive | Vector3 | Annotated[list[Vector3], Field(min_length=3, max_length=3)] | None = Field(
        None,
        description="at constant strain, pC/(V um): number, 3 or 3x3; absent: no potential in the body",
    )
    poling: Direction | Literal["across"] | None = Field(
        None,
        description="direction of material axis 3; default where piezoelectric: up (y in 2D, z in 3D); "
        '"across": normal to the centre line of each fiber, upward at its start',
    )
    axis1: Direction | Literal["along"] | None = Field(
        None,
        description='direction of material axis 1, made perpendicular to poling; "along": of the centre line of each '
        "fiber, and poling is made perpendicular to it",
    )
    conductor: bool | None = Field(
        None, description="true: a metal, of which each body has one potential; it has no permittivity"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        linear = [name for name, law in BUILT_IN.items() if isinstance(law, Material)]
        if self.like is not None and self.like not in linear:
            raise unknown_name("like", self.like, "a built-in material", linear)
        if self.stiffness is not None and (self.young is not None or self.poisson is not None):
            raise SceneError(
                "stiffness", "both stiffness and young or poisson", "either stiffness or young and poisson"
            )
        if self.like is None and self.stiffness is None:
            for key, other in (("young", "poisson"), ("poisson", "young")):
                if getattr(self, key) is None:
                    what = f"no {key}, though {other} is given" if getattr(self, other) is not None else "no elasticity"
                    raise SceneError(key, what, "young and poisson, or stiffness, or like = a built-in material")
        for key in ("poling", "axis1"):
            vector = getattr(self, key)
            if vector is not None and not any(vector):
                raise SceneError(key, vector, "a direction: not the zero vector")
        if self.poling == "across" and isinstance(self.axis1, list):
            raise SceneError("axis1", self.axis1, '"along", or nothing, where poling is "across"')
        self.unrotated()
        return self

    @property
    def follows_line(self) -> bool:
        """Whether the axes follow the centre line of each body."""
        return self.poling == "across" or self.axis1 == "along"

    def unrotated(self) -> Material:
        """The material in its own axes. Raises SceneError for constants that no stable material has."""
        base = BUILT_IN[self.like] if self.like is not None else None
        piezo = base.piezo if base is not None else np.zeros((3, 6))
        if self.piezo is not None:
            by_name = isinstance(self.piezo, PiezoKeys)
            piezo = piezo_matrix(self.piezo.model_dump()) if by_name else np.array(self.piezo, float)
        permittivity = base.permittivity if base is not None else None
        if self.conductor:
            for key in ("permittivity", "piezo"):
                if getattr(self, key) is not None:
                    raise SceneError(key, shown(getattr(self, key)), "nothing with conductor = true: a metal has none")
            if permittivity is not None:
                allowed = 'a material without permittivity, such as "elastic", with conductor = true'
                raise SceneError("like", shown(self.like), allowed)
            permittivity = VACUUM_PERMITTIVITY * np.eye(3)  # of which nothing is asked
        if self.permittivity is not None:
            permittivity = permittivity_matrix(self.permittivity)
        if permittivity is None and self.piezo is not None:
            raise SceneError("permittivity", "none, though piezo is given", "a permittivity wherever there is piezo")
        source = f"the scene, from {self.like}" if base is not None else "the scene"
        material = Material(self._stiffness(base), piezo, permittivity, source, bool(self.conductor))
        try:
            material.check()
        except ValueError as error:
            part, _, reason = str(error).partition(" ")
            raise SceneError(part, f"a matrix that {reason}", "a symmetric positive definite matrix") from None
        if self.permittivity is not None and np.linalg.eigvalsh(permittivity).min(initial=1.0) < LEAST_PERMITTIVITY:
            allowed = f"{LEAST_PERMITTIVITY:g} or more, in pC/(V um): that of vacuum is 8.854e-6"
            raise SceneError("permittivity", shown(self.permittivity), allowed)
        return material

    def _stiffness(self, base: Material | None) -> NDArray[np.float64]:
        """The stiffness as given, or of young and poisson, one of which an isotropic `base` may give."""
        if self.stiffness is not None:
            return np.array(self.stiffness, float)
        if self.young is not None and self.poisson is not None:
            return Material.isotropic(self.young, self.poisson).stiffness
        if self.young is None and self.poisson is None:
            return base.stiffness
        ratio = base.stiffness[0, 1] / (base.stiffness[0, 0] + base.stiffness[0, 1])
        modulus = 2 * (1 + ratio) * base.stiffness[5, 5]
        if not np.allclose(Material.isotropic(modulus, ratio).stiffness, base.stiffness, rtol=1e-10):
            missing = "poisson" if self.poisson is None else "young"
            raise SceneError(missing, f"none, and {self.like} is not isotropic", "young and poisson together")
        return Material.isotropic(self.young or modulus, ratio if self.poisson is None else self.poisson).stiffness


# A name that Python keeps for itself, so that it cannot stand in the class above.
MaterialKeys = create_model(
    "MaterialKeys",
    __base__=MaterialKeys,
    __doc__=MaterialKeys.__doc__,
    **{"yield": (Positive | None, Field(None, description="yield stress, MPa: a run warns where stresses are beyond"))},
)
