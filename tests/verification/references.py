"""Closed-form solutions that the verification tests compare with; test_references.py tests each of them.

Only NumPy and SciPy: nothing of the program is used here. Units: um, uN, MPa, V, pC, pJ; forces in the plane
are per um of depth. Voigt order 11 22 33 23 13 12, engineering shears. Tension and open gaps are positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

VACUUM_PERMITTIVITY = 8.8541878128e-6  # pC/(V um); CODATA 2018

# --- Materials and uniform states -----------------------------------------------------------------


@dataclass(frozen=True)
class Piezoelectric:
    """Isotropic stiffness (MPa), e31, e32, e33 (pC/um2), one permittivity (pC/(V um)); poled along axis 3."""

    young: float
    poisson: float
    e31: float = 0.0
    e32: float = 0.0
    e33: float = 0.0
    permittivity: float = 1.0

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """(6, 6) MPa."""
        shear = self.young / (2 * (1 + self.poisson))
        lame = 2 * shear * self.poisson / (1 - 2 * self.poisson)
        matrix = np.diag([2 * shear] * 3 + [shear] * 3)
        matrix[:3, :3] += lame
        return matrix

    @property
    def piezo(self) -> NDArray[np.float64]:
        """(3, 6) pC/um2."""
        matrix = np.zeros((3, 6))
        matrix[2, :3] = self.e31, self.e32, self.e33
        return matrix

    @property
    def contact_modulus(self) -> float:
        """E* (MPa) of two bodies of this material, without coupling."""
        return contact_modulus((self.young, self.poisson), (self.young, self.poisson))


# Maruccio and De Lorenzis, Frattura ed Integrita Strutturale 29 (2014) 49-60.
PVDF = Piezoelectric(2500.0, 0.3, 0.0307692, -0.0057692, -0.075, 12 * VACUUM_PERMITTIVITY)
# Tzou 1989, Hwang and Park 1993 (the bimorph).
PVDF_TZOU = Piezoelectric(2000.0, 0.29, 0.046, 0.0, 0.0, 0.1062e-3)


@dataclass(frozen=True)
class UniformState:
    strain: NDArray[np.float64]  # (6,)
    stress: NDArray[np.float64]  # (6,) MPa
    field: NDArray[np.float64]  # (3,) V/um
    displacement: NDArray[np.float64]  # (3,) pC/um2


def uniform_state(
    material: Piezoelectric, lateral: Literal["free", "fixed"], circuit: Literal["short", "open"], t33: float
) -> UniformState:
    """The state of a block under the stress T33 = t33 on its faces 3, E = 0 (short) or D = 0 (open) in it.

    "fixed": S11 = S22 = 0, "free": T11 = T22 = 0. Solves T = C S - e^T E, D = e S + eps E for the strain and
    the field.
    """
    c, e, eps = material.stiffness, material.piezo, material.permittivity * np.eye(3)
    law = np.block([[c, -e.T], [e, eps]])
    # Either the strain or the stress is given, and either the field or D: all zero but T33.
    strain_or_field_given = np.zeros(9, dtype=bool)
    strain_or_field_given[:2] = lateral == "fixed"
    strain_or_field_given[6:] = circuit == "short"
    given = np.zeros(9)
    given[2] = t33
    state = np.linalg.solve(np.where(strain_or_field_given[:, None], np.eye(9), law), given)
    response = law @ state
    return UniformState(state[:6], response[:6], state[6:], response[6:])


# --- Layers in contact ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Layer:
    thickness: float
    stiffness: float  # C33
    piezo: float  # e33
    permittivity: float  # eps33

    @classmethod
    def of(cls, material: Piezoelectric, thickness: float, poling: float = 1.0) -> Layer:
        """A laterally fixed layer poled upwards (poling 1) or downwards (-1)."""
        return cls(thickness, material.stiffness[2, 2], poling * material.e33, material.permittivity)


@dataclass(frozen=True)
class StackState:
    stress: float  # T33, the same in all layers
    displacement: float  # D3, likewise
    gap: float  # at each interface, negative when they press on each other
    jump: float  # potential above the interface minus below


def layer_stack(
    layers: Sequence[Layer],
    lengthening: float,
    voltage: float,
    normal_penalty: float = math.inf,
    electric_penalty: float = math.inf,
    electric_sign: float = -1.0,
) -> StackState:
    """Laterally fixed layers in contact, one above the other: bottom held at 0 V, top moved and at `voltage`.

    Each interface adds 1/2 kN g^2 + electric_sign 1/2 kphi jump^2 to the enthalpy, so T = kN g and, with the
    sign -1 of the dielectric term, D = -kphi jump. Infinite penalties: bonded. With
    (T, D) = [[C, -e], [e, eps]] (S, E) in each layer, sum(S H) + gaps = lengthening and
    -sum(E H) + jumps = voltage are two equations for T and D. Raises LinAlgError where they are singular.
    Holds while T <= 0.
    """
    interfaces = len(layers) - 1
    flexibility = np.diag([interfaces / normal_penalty, -electric_sign * interfaces / electric_penalty])
    for layer in layers:
        law = np.array([[layer.stiffness, -layer.piezo], [layer.piezo, layer.permittivity]])
        flexibility += layer.thickness * np.linalg.inv(law)
    stress, displacement = np.linalg.solve(flexibility, [lengthening, -voltage])
    return StackState(stress, displacement, stress / normal_penalty, electric_sign * displacement / electric_penalty)


def contact_patch_stress(young: float, heights: Sequence[float], shortening: float, penalty: float) -> float:
    """Normal stress of blocks (nu = 0) pressed together, a penalty per area between them; Crisfield 2000."""
    return -shortening / (sum(heights) / young + (len(heights) - 1) / penalty)


# Crisfield's patch of two 1 x 0.5 blocks: greatest relative stress error of one-pass node-to-segment contact
# with these numbers of elements along the lower and the upper side.
NODE_PATCH_ERRORS = {(3, 2): 0.205, (2, 3): 0.052, (3, 4): 0.047, (4, 3): 0.070}


# --- Bimorph --------------------------------------------------------------------------------------


def bimorph_deflection(material: Piezoelectric, x: float, thickness: float, voltage: float, coupled: bool) -> float:
    """Deflection at x of a cantilever of two oppositely poled layers, `voltage` across its whole thickness.

    Beam theory, plane stress (Tzou 1989): 1.5 e31 V x^2/(h^2 E). Coupled: the field in a layer follows the
    bending strain, D3 being constant across it, which stiffens the beam: E + e31^2/(4 eps) in place of E.
    """
    young = material.young
    if coupled:
        young += material.e31**2 / (4 * material.permittivity)
    return 1.5 * material.e31 * voltage * (x / thickness) ** 2 / young


# --- Hertz ----------------------------------------------------------------------------------------


def contact_modulus(first: tuple[float, float], second: tuple[float, float]) -> float:
    """E* of two bodies given as (Young's modulus, Poisson's ratio): 1/E* = sum of (1 - nu^2)/E."""
    return 1 / sum((1 - poisson**2) / young for young, poisson in (first, second))


def relative_radius(first: float, second: float) -> float:
    """R of two curved surfaces: 1/R = 1/R1 + 1/R2; math.inf for a plane."""
    return 1 / (1 / first + 1 / second)


@dataclass(frozen=True)
class Hertz:
    load: float  # uN; of a line contact uN/um
    size: float  # half-width or radius of the contact
    peak: float  # greatest pressure


def hertz_line(load: float, radius: float, modulus: float) -> Hertz:
    """Cylinders along each other; Johnson, Contact Mechanics (1985), section 4.2(c)."""
    size = 2 * math.sqrt(load * radius / (math.pi * modulus))
    return Hertz(load, size, math.sqrt(load * modulus / (math.pi * radius)))


def hertz_point(approach: float, radius: float, modulus: float) -> Hertz:
    """Sphere on a plane, or two cylinders of its radius at a right angle; Johnson, section 4.2(a)."""
    load = 4 / 3 * modulus * math.sqrt(radius) * approach**1.5
    size = math.sqrt(radius * approach)
    return Hertz(load, size, 3 * load / (2 * math.pi * size**2))


# --- Adhesion of cylinders ------------------------------------------------------------------------


def jkr_load(half_width: float, energy: float, radius: float, modulus: float) -> float:
    """Load per length (pressing: positive) at a contact half-width, JKR in the plane; Barquins 1988."""
    return math.pi * modulus * half_width**2 / (4 * radius) - math.sqrt(2 * math.pi * modulus * energy * half_width)


def jkr_pull_off(energy: float, radius: float, modulus: float) -> float:
    """Greatest pull per length, 3 (pi E* W^2 R/16)^(1/3)."""
    return 3 * (math.pi * modulus * energy**2 * radius / 16) ** (1 / 3)


def maugis_strength(parameter: float, energy: float, radius: float, modulus: float) -> float:
    """The cohesive stress s0 at which lambda = 4 s0/(pi^2 E*^2 W/R)^(1/3) has this value."""
    return parameter * (math.pi**2 * modulus**2 * energy / radius) ** (1 / 3) / 4


def maugis_state(parameter: float, ratio: float) -> tuple[float, float]:
    """Half-width and load of the Maugis-Dugdale cylinder for ratio m = b/a > 1; Baney and Hui 1997.

    Lengths in 2 (W R^2/(pi E*))^(1/3), load (pressing: positive) in (pi E* W^2 R)^(1/3). That the gap at the
    edge of the cohesive zone is W/s0 is a quadratic equation for a.
    """
    mu = math.sqrt(ratio**2 - 1)
    log = math.acosh(ratio)  # ln(m + mu)
    p = parameter / 2 * (ratio * mu - log)
    q = parameter**2 / 2 * (mu * log - ratio * math.log(ratio))
    half_width = 2 / (q + math.sqrt(q**2 + 4 * p))
    return half_width, half_width**2 - parameter * half_width * mu


def maugis_pull_off(parameter: float) -> float:
    """Greatest pull of the Maugis-Dugdale cylinder in (pi E* W^2 R)^(1/3); grows to JKR's 3/16^(1/3)."""
    # Over ln(m - 1); the minimum is a single, smooth one.
    result = minimize_scalar(
        lambda t: maugis_state(parameter, 1 + math.exp(t))[1], bounds=(-20, 20), options={"xatol": 1e-10}
    )
    return -result.fun


@dataclass(frozen=True)
class SeriesBilinear:
    """A bilinear cohesive interface in series with layers of compliance c = sum(H/E).

    The stress rises with `stiffness` (MPa/um) to `strength` (MPa) and falls to zero at the gap
    2 energy/strength. With the far end's displacement prescribed it snaps off right at the peak unless
    c < (gc - g0)/strength.
    """

    stiffness: float
    strength: float
    energy: float
    compliance: float

    @property
    def onset(self) -> float:
        """Gap g0 at the strength."""
        return self.strength / self.stiffness

    @property
    def final(self) -> float:
        """Gap gc at which nothing holds any more."""
        return 2 * self.energy / self.strength

    @property
    def stable(self) -> bool:
        return self.compliance < (self.final - self.onset) / self.strength

    @property
    def peak(self) -> float:
        """Far displacement at which the stress is the strength."""
        return self.strength * (self.compliance + 1 / self.stiffness)

    @property
    def release(self) -> float:
        """Far displacement from which the stress is zero."""
        return max(self.peak, self.final)

    @property
    def work(self) -> float:
        """External work per area until release: the energy of the interface, and more where it snaps off."""
        return self.strength * self.release / 2

    def stress(self, displacement: float) -> float:
        """Stress at a far displacement on the first pull."""
        if displacement <= self.peak:
            return displacement / (self.compliance + 1 / self.stiffness)
        if displacement >= self.release:
            return 0.0
        # On the falling branch: g = gc - t (gc - g0)/t0, and c t + g = displacement.
        return (self.final - displacement) / ((self.final - self.onset) / self.strength - self.compliance)


@dataclass(frozen=True)
class LennardJones:
    """Pressure A/(2 pi r0^3) [(r0/g)^9/45 - (r0/g)^3/3] between half spaces (pull: negative); A in pJ."""

    hamaker: float
    distance: float

    def pressure(self, gap: float) -> float:
        s = self.distance / gap
        return self.hamaker / (2 * math.pi * self.distance**3) * (s**9 / 45 - s**3 / 3)

    @property
    def equilibrium(self) -> float:
        """Gap without pressure."""
        return self.distance / 15 ** (1 / 6)

    @property
    def pull_gap(self) -> float:
        """Gap of the strongest pull."""
        return self.distance / 5 ** (1 / 6)

    @property
    def pull(self) -> float:
        """Strongest pull (positive)."""
        return math.sqrt(5) * self.hamaker / (9 * math.pi * self.distance**3)

    @property
    def work(self) -> float:
        """Work per area from equilibrium to infinity."""
        return 15 ** (1 / 3) * self.hamaker / (16 * math.pi * self.distance**2)
