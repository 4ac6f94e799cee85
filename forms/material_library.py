"""Built-in materials, each with its source."""

from __future__ import annotations

import numpy as np

from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.forms.materials import VACUUM_PERMITTIVITY, Material, piezo_matrix

_GPA = 1e3  # in MPa


def transversely_isotropic(
    stiffness: tuple[float, float, float, float, float],
    piezo: tuple[float, float, float],
    permittivity: tuple[float, float],
    source: str,
) -> Material:
    """Poled ceramic (symmetry 6mm about axis 3).

    stiffness (c11, c12, c13, c33, c44) in MPa with c66 = (c11 - c12)/2; piezo (e31, e33, e15) in pC/um2;
    permittivity (eps11, eps33) at constant strain in pC/(V um).
    """
    c11, c12, c13, c33, c44 = stiffness
    e31, e33, e15 = piezo
    matrix = np.diag([c11, c11, c33, c44, c44, (c11 - c12) / 2])
    matrix[0, 1] = matrix[1, 0] = c12
    matrix[2, :2] = matrix[:2, 2] = c13
    constants = piezo_matrix({"e31": e31, "e32": e31, "e33": e33, "e15": e15, "e24": e15})
    eps11, eps33 = permittivity
    return Material(matrix, constants, np.diag([eps11, eps11, eps33]), source)


# A material of another law is one more entry; its keys in a scene are its name alone.
BUILT_IN: dict[str, ConstitutiveLaw] = {
    "pvdf": Material.isotropic(
        2500.0,
        0.3,
        piezo_matrix({"e31": 0.0307692, "e32": -0.0057692, "e33": -0.075}),
        12 * VACUUM_PERMITTIVITY,
        "PVDF fibers: Maruccio and De Lorenzis, Frattura ed Integrita Strutturale 29 (2014) 49-60 "
        "(isotropic elasticity, no shear constants, relative permittivity 12)",
    ),
    "pvdf_tzou": Material.isotropic(
        2000.0,
        0.29,
        piezo_matrix({"e31": 0.046}),
        0.1062e-3,
        "PVDF bimorph: Tzou, J. Dyn. Syst. Meas. Control 111 (1989); Hwang and Park, AIAA J. 31 (1993) "
        "930-937 (e31 alone, isotropic elasticity)",
    ),
    "pzt4": transversely_isotropic(
        (139 * _GPA, 77.8 * _GPA, 74.3 * _GPA, 115 * _GPA, 25.6 * _GPA),
        (-5.2, 15.1, 12.7),
        (730 * VACUUM_PERMITTIVITY, 635 * VACUUM_PERMITTIVITY),
        "PZT-4: Auld, Acoustic Fields and Waves in Solids, vol. 1 (1973), appendix 2, "
        "after Jaffe and Berlincourt, Proc. IEEE 53 (1965) 1372-1386",
    ),
    "pzt5h": transversely_isotropic(
        (126 * _GPA, 79.5 * _GPA, 84.1 * _GPA, 117 * _GPA, 23.0 * _GPA),
        (-6.5, 23.3, 17.0),
        (1700 * VACUUM_PERMITTIVITY, 1470 * VACUUM_PERMITTIVITY),
        "PZT-5H: Auld, Acoustic Fields and Waves in Solids, vol. 1 (1973), appendix 2, "
        "after Jaffe and Berlincourt, Proc. IEEE 53 (1965) 1372-1386",
    ),
    "batio3": transversely_isotropic(
        (166 * _GPA, 77 * _GPA, 78 * _GPA, 162 * _GPA, 43 * _GPA),
        (-4.4, 18.6, 11.6),
        (11.2e-3, 12.6e-3),
        "BaTiO3: Pan, J. Appl. Mech. 68 (2001) 608-618, table 1",
    ),
    "elastic": Material.isotropic(2500.0, 0.3, source="the elasticity of pvdf alone: no potential in the body"),
    "dielectric": Material.isotropic(
        2500.0,
        0.3,
        permittivity=12 * VACUUM_PERMITTIVITY,
        source="the elasticity and permittivity of pvdf, not piezoelectric",
    ),
}
