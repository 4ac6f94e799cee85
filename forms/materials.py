"""Linear piezoelectric materials: stiffness C, piezoelectric stress constants e, permittivity eps.

Voigt order 11 22 33 23 13 12 with engineering shears; E = -grad(phi); T = C S - e^T E, D = e S + eps E
(IEEE Std 176-1987, stress-charge form). Both follow from one enthalpy H = 1/2 s.M.s of s = (S, E) with

    M = [[C, -e^T], [-e, -eps]],   T = dH/dS,   D = -dH/dE.

Units: MPa, pC/um2 (= C/m2), pC/(V um) (= 1e-6 F/m).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
import ufl
from numpy.typing import ArrayLike

from piezomat.forms.arrays import Array
from piezomat.forms.constitutive import ConstitutiveLaw, Plane

VACUUM_PERMITTIVITY = 8.8541878128e-6  # pC/(V um), CODATA 2018
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # tensor indices of each Voigt entry
IN_PLANE = (0, 1, 5, 6, 7)  # of the nine entries of (S, E): S11, S22, 2 S12, E1, E2
OUT_OF_PLANE = (2, 3, 4)  # S33, 2 S23, 2 S13
AT_ONCE = 20_000  # rotations of a matrix at a time: 40 MB


class Response(NamedTuple):
    """Full state: strain (..., 6), stress (..., 6) in MPa, electric displacement (..., 3) in pC/um2."""

    strain: Array
    stress: Array
    electric_displacement: Array


@dataclass(frozen=True, eq=False)
class Material(ConstitutiveLaw):
    """A linear piezoelectric (or dielectric, or elastic) material; built-in ones are poled along axis 3.

    stiffness (6, 6) at constant electric field, MPa; piezo (3, 6), pC/um2; permittivity (3, 3) at constant
    strain, pC/(V um), or None: the material carries no potential. `source`: reference of the numbers. conductor:
    whether it is a metal, in which there is no field: nothing but the scale of penalties depends on its permittivity.
    """

    stiffness: Array
    piezo: Array
    permittivity: Array | None
    source: str = ""
    conductor: bool = False
    is_linear: ClassVar[bool] = True
    has_plane_stress: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("stiffness", "piezo", "permittivity"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    @classmethod
    def isotropic(
        cls,
        young: float,
        poisson: float,
        piezo: ArrayLike | None = None,
        permittivity: ArrayLike | None = None,
        source: str = "",
    ) -> Material:
        """Isotropic elasticity with any piezo (3, 6) and permittivity (a number, three or (3, 3)).

        Raises ValueError for a modulus that is not positive or a ratio outside (-1, 0.5).
        """
        if not (np.isfinite(young) and young > 0):
            raise ValueError(f"Young's modulus must be positive, not {young:g}")
        if not -1 < poisson < 0.5:
            raise ValueError(f"Poisson's ratio must lie between -1 and 0.5, not {poisson:g}")
        shear = young / (2 * (1 + poisson))
        stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
        stiffness[:3, :3] += young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        return cls(
            stiffness,
            np.zeros((3, 6)) if piezo is None else np.asarray(piezo, float),
            None if permittivity is None else permittivity_matrix(permittivity),
            source,
        )

    @property
    def electric(self) -> bool:
        """Whether the material carries a potential."""
        return self.permittivity is not None

    @property
    def is_piezoelectric(self) -> bool:
        """Whether the material has piezoelectric constants."""
        return bool(self.piezo.any())

    @property
    def mean_stiffness(self) -> float:
        """Mean over all directions of the stiffness at uniaxial strain, MPa; no rotation changes it.

        (C_iijj + 2 C_ijij) / 15, which of an isotropic material is C_11; of `pzt4` it is 0.3 % below the mean of
        C_11, C_22 and C_33.
        """
        normal, shear = self.stiffness[:3, :3], np.diag(self.stiffness)[3:]
        return float((normal.sum() + 2.0 * (np.trace(normal) + 2.0 * shear.sum())) / 15.0)

    @property
    def mean_permittivity(self) -> float:
        """Mean of the permittivities along the axes, pC/(V um), the same for all axes; 0 without potential."""
        return 0.0 if self.permittivity is None else float(np.diag(self.permittivity).mean())

    @property
    def poisson_ratio(self) -> float:
        """That of the isotropic material with the same resistance to change of volume and, in the mean, of shape."""
        normal, shear = self.stiffness[:3, :3], np.diag(self.stiffness)[3:]
        bulk = normal.sum() / 9.0
        shape = (3.0 * (np.trace(normal) + 2.0 * shear.sum()) - normal.sum()) / 30.0
        return float((3.0 * bulk - 2.0 * shape) / (2.0 * (3.0 * bulk + shape)))

    def check(self) -> None:
        """Raise ValueError, with the reason, if the material is not stable.

        A stable material has arrays of the right shapes, finite numbers, a symmetric and positive definite stiffness
        and permittivity, and a permittivity if it has a piezoelectric constant.
        """
        _check_definite("stiffness", self.stiffness, 6)
        _check_numbers("piezo", self.piezo, (3, 6))
        if self.permittivity is not None:
            _check_definite("permittivity", self.permittivity, 3)
        elif self.piezo.any():
            raise ValueError("piezo is given but permittivity is not: a piezoelectric material needs both")

    def rotated(self, poling: ArrayLike, axis1: ArrayLike | None = None) -> Material:
        """The same material with its axis 3 along `poling` and its axis 1 along `axis1` made normal to it.

        Default axis1: the global x axis, or y where x is parallel to poling. Both are 3-vectors of any
        length. Raises ValueError if one is zero or the two are parallel. C' = K C K^T, e' = R e K^T and
        eps' = R eps R^T with R's columns the material axes and K the Bond matrix of stresses (Auld, Acoustic
        Fields and Waves in Solids, vol. 1 (1973), sec. 3.D).
        """
        rotation = material_axes(poling, axis1)
        bond = stress_rotation(rotation)
        permittivity = self.permittivity
        return Material(
            _symmetric(bond @ self.stiffness @ bond.T),
            rotation @ self.piezo @ bond.T,
            None if permittivity is None else _symmetric(rotation @ permittivity @ rotation.T),
            self.source,
            self.conductor,
        )

    def beside(self, permittivity: float) -> Material:
        """The material in a model whose largest mean permittivity is this, pC/(V um): that of a conductor then."""
        return replace(self, permittivity=permittivity * np.eye(3)) if self.conductor else self

    def constitutive_matrix(self, dim: int, plane: Plane = "strain") -> Array:
        """Symmetric enthalpy matrix M, H = 1/2 s.M.s in pJ/um3: (9, 9) in 3D, (5, 5) in 2D.

        s = (strain, electric field), in 2D (S11, S22, 2 S12, E1, E2). plane "strain": S33 = S23 = S13 = 0;
        "stress": T33 = T23 = T13 = 0, condensed from the coupled law; E3 = 0 in both. A material without
        permittivity has zeros for the electric field.
        """
        full = np.zeros((9, 9))
        full[:6, :6] = self.stiffness
        full[6:, :6] = -self.piezo
        full[:6, 6:] = -self.piezo.T
        if self.permittivity is not None:
            full[6:, 6:] = -self.permittivity
        if dim == 3:
            return full
        if dim != 2:
            raise ValueError(f"the dimension is 2 or 3, not {dim}")
        kept = full[np.ix_(IN_PLANE, IN_PLANE)]
        if plane == "strain":
            return kept
        if plane != "stress":
            raise ValueError(f'plane must be "strain" or "stress", not "{plane}"')
        return _symmetric(kept + full[np.ix_(IN_PLANE, OUT_OF_PLANE)] @ self._condensation())

    def numbers(self, dim: int, plane: Plane, potential_scale: float | None) -> Array:
        """Upper triangle of the `constitutive_matrix`, row by row: 15 numbers in 2D, 45 in 3D.

        Rows and columns of the field are multiplied by the potential's scale. Without it the elastic block: 6 or 21.
        """
        matrix = self.constitutive_matrix(dim, plane)
        return _upper_triangle(matrix, len(matrix) - dim, potential_scale)

    def numbers_in(self, axes: Array, potential_scale: float | None) -> Array:
        """The `numbers` (k, 45 or 21) in 3D of the material with its axes along the columns of rotations (k, 3, 3).

        M' = Q M Q^T with Q = [[K, 0], [0, R]], see `rotated`.
        """
        matrix = self.constitutive_matrix(3)
        found = np.empty((len(axes), 21 if potential_scale is None else 45))
        for start in range(0, len(axes), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            turn = np.zeros((len(axes[some]), 9, 9))
            turn[:, :6, :6], turn[:, 6:, 6:] = stress_rotation(axes[some]), axes[some]
            found[some] = _upper_triangle(turn @ matrix @ np.swapaxes(turn, 1, 2), 6, potential_scale)
        return found

    def density(self, s: Any, numbers: Any) -> Any:
        """UFL density 1/2 s.M.s, pJ/um3. Raises ValueError if the numbers are not as many as s needs."""
        return 0.5 * ufl.inner(s, self.gradient(s, numbers))

    def gradient(self, s: Any, numbers: Any) -> Any:
        """UFL vector M s.

        Equal to ufl.diff of the density, but the C code of its tangent is half as long and compiles four times as fast.
        """
        return _symmetric_matrix(numbers, len(s)) * s

    def stored_energies(self, s: Any, numbers: Any) -> tuple[Any, Any | None]:
        """UFL densities 1/2 S.C.S and 1/2 E.eps.E: the piezoelectric terms of T.S and D.E cancel."""
        matrix = _symmetric_matrix(numbers, len(s))
        strains = 3 if len(s) in (3, 5) else 6

        def half_square(indices: range) -> Any:
            return 0.5 * sum(matrix[i, j] * s[i] * s[j] for i in indices for j in indices)

        if len(s) == strains:
            return half_square(range(strains)), None
        return half_square(range(strains)), -half_square(range(strains, len(s)))

    def response(
        self, strain: ArrayLike, field: ArrayLike | None = None, dim: int = 3, plane: Plane = "strain"
    ) -> Response:
        """Full strain, stress and electric displacement at points.

        strain (..., 6) and field (..., 3), V/um, in 3D; (..., 3) and (..., 2) in 2D, in-plane. Default field: zero.
        In 2D the components out of the plane follow from `plane` as in `constitutive_matrix`.
        """
        strain = np.asarray(strain, float)
        components = 6 if dim == 3 else 3
        if strain.shape[-1] != components:
            raise ValueError(f"strain in {dim}D has {components} components, not {strain.shape[-1]}")
        field = np.zeros((*strain.shape[:-1], dim)) if field is None else np.asarray(field, float)
        state = np.zeros((*strain.shape[:-1], 9))
        if dim == 3:
            state[..., :6], state[..., 6:] = strain, field
        else:
            in_plane = np.concatenate([strain, field], axis=-1)
            state[..., IN_PLANE] = in_plane
            if plane == "stress":
                state[..., OUT_OF_PLANE] = in_plane @ self._condensation().T
        gradient = state @ self.constitutive_matrix(3)
        return Response(state[..., :6], gradient[..., :6], -gradient[..., 6:])

    def response_in(self, axes: Array, strain: Array, field: Array) -> Response:
        """The `response` at points (k,) in 3D with the material axes along the columns of rotations (k, 3, 3)."""
        bond = stress_rotation(axes)
        own = self.response(np.einsum("kji,kj->ki", bond, strain), np.einsum("kji,kj->ki", axes, field))
        stress = np.einsum("kij,kj->ki", bond, own.stress)
        return Response(strain, stress, np.einsum("kij,kj->ki", axes, own.electric_displacement))

    def _condensation(self) -> Array:
        """Matrix (3, 5) from the in-plane state to (S33, 2 S23, 2 S13) with T33 = T23 = T13 = 0 and E3 = 0."""
        full = self.constitutive_matrix(3)
        return -np.linalg.solve(full[np.ix_(OUT_OF_PLANE, OUT_OF_PLANE)], full[np.ix_(OUT_OF_PLANE, IN_PLANE)])


def _upper_triangle(matrix: Array, strains: int, potential_scale: float | None) -> Array:
    """Upper triangle (..., n), row by row, of matrices (..., m, m) of strains and the field over its scale."""
    size = strains if potential_scale is None else matrix.shape[-1]
    scale = np.ones(size)
    scale[strains:] = potential_scale or 1.0
    rows, columns = np.triu_indices(size)
    return scale[rows] * matrix[..., rows, columns] * scale[columns]


def _symmetric_matrix(numbers: Any, size: int) -> Any:
    """UFL matrix M (size, size) of its upper triangle. Raises ValueError if its size differs."""
    if numbers.ufl_shape != (size * (size + 1) // 2,):
        raise ValueError(f"a matrix of {numbers.ufl_shape[0]} entries does not fit a state of {size} components")
    entry = {pair: numbers[number] for number, pair in enumerate(zip(*np.triu_indices(size), strict=True))}
    return ufl.as_matrix([[entry[min(i, j), max(i, j)] for j in range(size)] for i in range(size)])


def material_axes(poling: ArrayLike, axis1: ArrayLike | None = None) -> Array:
    """Rotation (3, 3) whose columns are the material axes 1, 2, 3 = poling in global components.

    Raises ValueError if a vector is zero or not finite, or if the two are parallel.
    """
    axis3 = _unit("poling", poling)
    if axis1 is None:
        along_x = abs(axis3[0]) > 1 - 1e-12
        first = np.array([0.0, 1.0, 0.0] if along_x else [1.0, 0.0, 0.0])
    else:
        first = _unit("axis1", axis1)
    first = first - (first @ axis3) * axis3
    if np.linalg.norm(first) < 1e-8:
        raise ValueError("axis1 is parallel to poling: it must point in another direction")
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis3, first), axis3])


def stress_rotation(rotation: ArrayLike) -> Array:
    """Bond matrices K (..., 6, 6) of R (..., 3, 3): T' = K T for the Voigt stress of R T R^T; strains take K^-T."""
    r = np.asarray(rotation, float)
    bond = np.empty((*r.shape[:-2], 6, 6))
    for row, (i, j) in enumerate(VOIGT):
        for column, (k, m) in enumerate(VOIGT):
            crossed = r[..., i, m] * r[..., j, k] if k != m else 0.0
            bond[..., row, column] = r[..., i, k] * r[..., j, m] + crossed
    return bond


def piezo_matrix(constants: Mapping[str, float]) -> Array:
    """Piezoelectric matrix (3, 6) of named constants {"e31": ..., "e15": ...}; those not named are zero.

    Raises ValueError for a name that is not e11 .. e36.
    """
    matrix = np.zeros((3, 6))
    for name, value in constants.items():
        if len(name) != 3 or name[0] != "e" or name[1] not in "123" or name[2] not in "123456":
            raise ValueError(f'"{name}" is not a piezoelectric constant: the names are e11 to e36')
        matrix[int(name[1]) - 1, int(name[2]) - 1] = value
    return matrix


def permittivity_matrix(value: ArrayLike) -> Array:
    """Permittivity (3, 3) from a number, three principal values or the matrix. Raises ValueError for others."""
    array = np.asarray(value, float)
    if array.ndim == 0:
        return float(array) * np.eye(3)
    if array.shape == (3,):
        return np.diag(array)
    if array.shape == (3, 3):
        return array
    raise ValueError("permittivity must be a number, three numbers or a 3x3 matrix")


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def _unit(name: str, vector: ArrayLike) -> Array:
    array = np.asarray(vector, float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be a vector of three numbers")
    length = np.linalg.norm(array)
    if length == 0:
        raise ValueError(f"{name} must not be the zero vector")
    return array / length


def _check_numbers(name: str, matrix: Array, shape: tuple[int, int]) -> None:
    if matrix.shape != shape:
        raise ValueError(f"{name} must be a {shape[0]}x{shape[1]} matrix")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} holds a number that is not finite")


def _check_definite(name: str, matrix: Array, size: int) -> None:
    _check_numbers(name, matrix, (size, size))
    asymmetry = np.abs(matrix - matrix.T)
    if asymmetry.max() > 1e-8 * np.abs(matrix).max():
        i, j = np.unravel_index(np.argmax(asymmetry), asymmetry.shape)
        raise ValueError(
            f"{name} is not symmetric: entry {i + 1},{j + 1} is {matrix[i, j]:g} "
            f"but entry {j + 1},{i + 1} is {matrix[j, i]:g}"
        )
    smallest = np.linalg.eigvalsh(_symmetric(matrix))[0]
    if smallest <= 1e-12 * np.abs(matrix).max():
        raise ValueError(f"{name} is not positive definite: its smallest eigenvalue is {smallest:g}")
