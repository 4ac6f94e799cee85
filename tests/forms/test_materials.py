"""Materials: constants, stability, rotation, the plane laws, and the uniform states of a poled block."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.forms import materials
from piezomat.forms.arrays import Array
from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import (
    VACUUM_PERMITTIVITY,
    VOIGT,
    Material,
    material_axes,
    permittivity_matrix,
    piezo_matrix,
    stress_rotation,
)

PVDF = BUILT_IN["pvdf"]
POLINGS = ([0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1], [1, 2, 3], [-0.3, 0.2, -0.9], [1, 1e-9, 0])


def turn(axis: int, degrees: float) -> Array:
    """Right-handed rotation (3, 3) about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation[[i, j], [i, j]] = c
    rotation[i, j], rotation[j, i] = -s, s
    return rotation


def tensor(stress: Array) -> Array:
    """Symmetric (3, 3) of a Voigt stress."""
    matrix = np.empty((3, 3))
    for value, (i, j) in zip(stress, VOIGT, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def voigt_strain(matrix: Array) -> Array:
    """Voigt strain with engineering shears."""
    return np.array([matrix[i, j] * (1 if i == j else 2) for i, j in VOIGT])


def uniform_state(material: Material, free: list[int], t33: float) -> tuple[Array, Array]:
    """s and its conjugate M s where T33 = t33, the other conjugates of `free` and the rest of s are zero."""
    law = material.constitutive_matrix(3)
    load = np.zeros(9)
    load[2] = t33
    state = np.zeros(9)
    state[free] = np.linalg.solve(law[np.ix_(free, free)], load[free])
    return state, law @ state


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_materials_are_stable_and_say_where_they_come_from(name: str) -> None:
    material = BUILT_IN[name]
    material.check()
    assert len(material.source) > 20
    assert material.electric == (name != "elastic")
    assert material.piezo.any() == (name not in ("elastic", "dielectric"))
    # 6mm and isotropic alike: no direction normal to the poling axis is special in the elasticity.
    spin = stress_rotation(turn(2, 37.0))
    np.testing.assert_allclose(
        spin @ material.stiffness @ spin.T, material.stiffness, atol=1e-9 * material.stiffness.max()
    )


def test_pvdf_has_the_published_constants() -> None:
    assert PVDF.permittivity == pytest.approx(1.0625025e-4 * np.eye(3), rel=1e-7)
    compliance = np.linalg.inv(PVDF.stiffness)
    assert 1 / compliance[0, 0] == pytest.approx(2500)
    assert -compliance[0, 1] / compliance[0, 0] == pytest.approx(0.3)
    assert 1 / compliance[3, 3] == pytest.approx(2500 / 2.6)
    assert PVDF.piezo[2, 2] ** 2 / (PVDF.stiffness[2, 2] * PVDF.permittivity[2, 2]) == pytest.approx(0.0157, abs=5e-5)
    # d = e s: the printed e belongs to d = (22, 3, -33) pm/V, that is 1e-6 um/V each.
    np.testing.assert_allclose((PVDF.piezo @ compliance)[2, :3] * 1e6, [22, 3, -33], rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "k33", "d33", "relative"),
    [("pzt4", 0.70, 289, 1300), ("pzt5h", 0.75, 593, 3400), ("batio3", 0.50, 190, 1700)],
)
def test_ceramics_have_the_coupling_their_makers_measure(name: str, k33: float, d33: float, relative: float) -> None:
    """d33 (pm/V), k33 and the free permittivity that follow from C, e and eps at constant strain.

    Against the figures of Jaffe, Cook and Jaffe, Piezoelectric Ceramics (1971), which are of other batches.
    """
    material = BUILT_IN[name]
    compliance = np.linalg.inv(material.stiffness)
    d = material.piezo @ compliance
    free = material.permittivity + d @ material.piezo.T
    assert d[2, 2] * 1e6 == pytest.approx(d33, rel=0.1)
    assert free[2, 2] / VACUUM_PERMITTIVITY == pytest.approx(relative, rel=0.15)
    assert d[2, 2] / np.sqrt(compliance[2, 2] * free[2, 2]) == pytest.approx(k33, rel=0.06)


# REFERENCES: T33 = -1, exact for every element.
@pytest.mark.parametrize(
    ("free", "strain", "field", "displacement"),
    [
        ([0, 1, 2, 3, 4, 5], [1.2e-4, 1.2e-4, -4e-4], 0.0, 3.3e-5),
        ([0, 1, 2, 3, 4, 5, 6, 7, 8], [1.1336e-4, 1.1909e-4, -3.9004e-4], -0.3016871, 0.0),
        ([2], [0, 0, -2.971429e-4], 0.0, 2.228571e-5),
        ([2, 8], [0, 0, -2.925409e-4], -0.2064990, 0.0),
    ],
    ids=["free-short", "free-open", "fixed-short", "fixed-open"],
)
def test_uniform_states_of_pvdf(free: list[int], strain: list[float], field: float, displacement: float) -> None:
    state, conjugate = uniform_state(PVDF, free, -1.0)
    np.testing.assert_allclose(state[:3], strain, atol=0.5001e-8 if len(free) > 6 else 0.5001e-10)
    np.testing.assert_allclose(state[3:6], 0, atol=1e-18)
    np.testing.assert_allclose(state[6:], [0, 0, field], atol=0.5e-7)
    np.testing.assert_allclose(-conjugate[6:], [0, 0, displacement], atol=0.5001e-11)
    response = PVDF.response(state[:6], state[6:])
    np.testing.assert_allclose(response.stress[2], -1, rtol=1e-12)
    np.testing.assert_allclose(response.electric_displacement, -conjugate[6:], atol=1e-18)


def test_response_is_the_constitutive_law_at_any_number_of_points(rng: np.random.Generator) -> None:
    material = BUILT_IN["pzt5h"].rotated([1, -2, 0.5], [0, 0, 1])
    strain, field = rng.normal(size=(4, 7, 6)), rng.normal(size=(4, 7, 3))
    response = material.response(strain, field)
    stress = np.einsum("ij,abj->abi", material.stiffness, strain) - np.einsum("ij,abi->abj", material.piezo, field)
    displacement = np.einsum("ij,abj->abi", material.piezo, strain) + field @ material.permittivity
    np.testing.assert_allclose(response.stress, stress, rtol=1e-10, atol=1e-6)
    np.testing.assert_allclose(response.electric_displacement, displacement, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(response.strain, strain)
    np.testing.assert_allclose(material.response(strain).stress, strain @ material.stiffness, rtol=1e-10, atol=1e-6)


@pytest.mark.parametrize("poling", POLINGS)
def test_rotation_turns_material_axes_and_keeps_the_energy(poling: list[float], rng: np.random.Generator) -> None:
    material = BUILT_IN["batio3"]
    axes = material_axes(poling)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes[:, 2], np.array(poling) / np.linalg.norm(poling), atol=1e-15)
    small, field = rng.normal(size=(3, 3)), rng.normal(size=3)
    small = small + small.T
    turned = material.rotated(poling)
    turned.check()
    state = np.concatenate([voigt_strain(small), field])
    turned_state = np.concatenate([voigt_strain(axes @ small @ axes.T), axes @ field])
    energy = state @ material.constitutive_matrix(3) @ state
    assert turned_state @ turned.constitutive_matrix(3) @ turned_state == pytest.approx(energy, rel=1e-12)
    before, after = (
        material.response(state[:6], state[6:]),
        turned.response(turned_state[:6], turned_state[6:]),
    )
    np.testing.assert_allclose(tensor(after.stress), axes @ tensor(before.stress) @ axes.T, atol=1e-8)
    np.testing.assert_allclose(after.electric_displacement, axes @ before.electric_displacement, atol=1e-11)


def test_quarter_and_half_turns() -> None:
    material = Material(  # without symmetry, so that all entries differ
        np.diag([10.0, 20, 30, 4, 5, 6]) + np.fromfunction(lambda i, j: 0.1 * (i + j) + 0.01 * i * j, (6, 6)),
        np.arange(1.0, 19).reshape(3, 6),
        np.diag([1.0, 2, 3]),
    )
    c, e = material.stiffness, material.piezo
    # Poled along x with axis 1 = y: material axes (1, 2, 3) lie along global (y, z, x).
    turned = material.rotated([1, 0, 0])
    cyclic = [2, 0, 1, 5, 3, 4]  # global Voigt entry -> that of the material
    np.testing.assert_allclose(turned.stiffness, c[np.ix_(cyclic, cyclic)], atol=1e-12)
    np.testing.assert_allclose(turned.piezo, e[np.ix_([2, 0, 1], cyclic)], atol=1e-12)
    np.testing.assert_allclose(turned.permittivity, np.diag([3.0, 1, 2]), atol=1e-12)
    # Poled along -z: a half turn about x.
    turned = material.rotated([0, 0, -1])
    signs = np.array([1, 1, 1, 1, -1, -1])
    np.testing.assert_allclose(turned.stiffness, c * np.outer(signs, signs), atol=1e-12)
    np.testing.assert_allclose(turned.piezo, np.outer([1, -1, -1], signs) * e, atol=1e-12)
    # axis1 alone: a quarter turn about z; and what does nothing does nothing.
    assert material_axes([0, 0, 2], [0, 5, 3]) == pytest.approx(turn(2, 90), abs=1e-15)
    np.testing.assert_array_equal(material.rotated([0, 0, 4]).piezo, e)


def test_a_rotation_and_its_inverse_come_home() -> None:
    material = BUILT_IN["pzt4"]
    axes = material_axes([1, -2, 0.7], [0.2, 1, 1])
    there = material.rotated(axes[:, 2], axes[:, 0])
    home = there.rotated(axes[2], axes[0])  # columns of the inverse rotation
    np.testing.assert_allclose(home.stiffness, material.stiffness, atol=1e-9)
    np.testing.assert_allclose(home.piezo, material.piezo, atol=1e-13)
    np.testing.assert_allclose(home.permittivity, material.permittivity, atol=1e-16)


def test_pvdf_poled_in_the_plane_couples_in_the_plane() -> None:
    law = PVDF.rotated([0, 1, 0]).constitutive_matrix(2)
    np.testing.assert_allclose(law[4, :3], [-0.0307692, 0.075, 0], atol=1e-16)  # -e: e31 along x, e33 along y
    np.testing.assert_allclose(law[3, :3], 0, atol=1e-16)
    law = PVDF.constitutive_matrix(2)  # poled out of the plane: no coupling left in it
    np.testing.assert_allclose(law[:3, 3:], 0, atol=1e-16)


@pytest.mark.parametrize("poling", POLINGS)
@pytest.mark.parametrize("name", ["pvdf", "pzt5h"])
def test_plane_stress_is_the_three_dimensional_law_with_free_faces(
    name: str, poling: list[float], rng: np.random.Generator
) -> None:
    material = BUILT_IN[name].rotated(poling)
    law = material.constitutive_matrix(2, "stress")
    np.testing.assert_array_equal(law, law.T)
    strain, field = rng.normal(size=(6, 3)), rng.normal(size=(6, 2))
    response = material.response(strain, field, dim=2, plane="stress")
    scale = np.abs(response.stress).max()
    np.testing.assert_allclose(response.stress[:, 2:5], 0, atol=1e-12 * scale)  # T33, T23, T13
    np.testing.assert_array_equal(response.strain[:, [0, 1, 5]], strain)
    full = material.response(response.strain, np.column_stack([field, np.zeros(6)]))
    np.testing.assert_allclose(full.stress, response.stress, atol=1e-12 * scale)
    gradient = np.column_stack([strain, field]) @ law
    np.testing.assert_allclose(gradient[:, :3], response.stress[:, [0, 1, 5]], atol=1e-11 * scale)
    np.testing.assert_allclose(
        -gradient[:, 3:], response.electric_displacement[:, :2], atol=1e-11 * np.abs(gradient).max()
    )


def test_plane_stress_of_an_isotropic_sheet() -> None:
    law = BUILT_IN["elastic"].constitutive_matrix(2, "stress")
    young, poisson = 2500.0, 0.3
    stiff = young / (1 - poisson**2)
    expected = [[stiff, poisson * stiff, 0], [poisson * stiff, stiff, 0], [0, 0, young / (2 * (1 + poisson))]]
    np.testing.assert_allclose(law[:3, :3], expected, rtol=1e-13, atol=1e-10)
    assert not law[3:].any()


def test_plane_strain_keeps_the_stress_out_of_the_plane() -> None:
    material = PVDF.rotated([0, 1, 0])
    response = material.response([1e-3, 0, 0], [0, 2.0], dim=2)
    lame = 2500 * 0.3 / (1.3 * 0.4)
    np.testing.assert_allclose(response.strain, [1e-3, 0, 0, 0, 0, 0])
    # x is material axis 1, y axis 3, so z is axis 2 and takes e32.
    np.testing.assert_allclose(response.stress[2], lame * 1e-3 + 0.0057692 * 2)


def test_bimorph_layer_bends_with_its_modulus_alone() -> None:
    """Tzou's layer, plane stress and T_yy = 0: T_xx = E S_xx - e31 E_y and D_y = e31 S_xx + eps E_y."""
    law = BUILT_IN["pvdf_tzou"].rotated([0, 1, 0]).constitutive_matrix(2, "stress")
    kept, gone = [0, 4], [1, 2]
    beam = law[np.ix_(kept, kept)] - law[np.ix_(kept, gone)] @ np.linalg.solve(
        law[np.ix_(gone, gone)], law[np.ix_(gone, kept)]
    )
    assert beam[0, 0] == pytest.approx(2000, rel=1e-12)
    assert beam[0, 1] == pytest.approx(-0.046, rel=1e-12)
    assert -beam[1, 1] == pytest.approx(0.1062e-3, rel=1e-12)


def test_helpers_refuse_what_they_cannot_read() -> None:
    with pytest.raises(ValueError, match="e41"):
        piezo_matrix({"e41": 1.0})
    with pytest.raises(ValueError, match="d33"):
        piezo_matrix({"d33": 1.0})
    with pytest.raises(ValueError, match="3x3"):
        permittivity_matrix([1.0, 2.0])
    np.testing.assert_array_equal(permittivity_matrix([1, 2, 3]), np.diag([1.0, 2, 3]))
    with pytest.raises(ValueError, match="parallel"):
        material_axes([0, 0, 1], [0, 0, -3])
    with pytest.raises(ValueError, match="poling must not be the zero vector"):
        material_axes([0, 0, 0])
    with pytest.raises(ValueError, match="axis1 must be a vector of three numbers"):
        material_axes([0, 0, 1], [1, 0])
    with pytest.raises(ValueError, match="Young's modulus must be positive, not -3"):
        Material.isotropic(-3.0, 0.3)
    with pytest.raises(ValueError, match=r"Poisson's ratio must lie between -1 and 0\.5, not 0\.5"):
        Material.isotropic(1.0, 0.5)
    with pytest.raises(ValueError, match="not 4"):
        PVDF.constitutive_matrix(4)
    with pytest.raises(ValueError, match='plane must be "strain" or "stress"'):
        PVDF.constitutive_matrix(2, "axial")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="strain in 2D has 3 components, not 6"):
        PVDF.response(np.zeros(6), dim=2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stiffness": np.eye(5)}, "stiffness must be a 6x6 matrix"),
        ({"stiffness": np.diag([1.0, 1, 1, 1, 1, np.nan])}, "stiffness holds a number that is not finite"),
        (
            {"stiffness": np.eye(6) + 0.1 * np.eye(6, k=1)},
            "stiffness is not symmetric: entry 1,2 is 0.1 but entry 2,1 is 0",
        ),
        ({"stiffness": np.diag([1.0, 1, 1, 1, 1, -2])}, "stiffness is not positive definite"),
        ({"stiffness": np.diag([1.0, 1, 1, 1, 1, 0])}, "stiffness is not positive definite"),
        ({"permittivity": np.diag([1.0, 1, -1])}, "permittivity is not positive definite"),
        ({"permittivity": np.eye(3) + np.eye(3, k=2)}, "permittivity is not symmetric"),
        ({"permittivity": None}, "piezo is given but permittivity is not"),
        ({"piezo": np.zeros((6, 3))}, "piezo must be a 3x6 matrix"),
    ],
)
def test_check_says_in_words_what_is_wrong(change: dict[str, Array | None], words: str) -> None:
    whole = {"stiffness": PVDF.stiffness, "piezo": PVDF.piezo, "permittivity": PVDF.permittivity}
    with pytest.raises(ValueError, match=words):
        Material(**{**whole, **change}).check()


def test_a_material_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        PVDF.stiffness[0, 0] = 1.0


@pytest.mark.parametrize("name", BUILT_IN)
def test_means_do_not_depend_on_the_axes(name: str) -> None:
    material = BUILT_IN[name]
    for poling in POLINGS:
        rotated = material.rotated(poling)
        assert rotated.mean_stiffness == pytest.approx(material.mean_stiffness, rel=1e-12)
        assert rotated.mean_permittivity == pytest.approx(material.mean_permittivity, rel=1e-12)


def test_the_mean_stiffness_is_that_of_uniaxial_strain_in_any_direction(rng: np.random.Generator) -> None:
    """Against the definition: the mean of C'_33 over directions, of a material without symmetry."""
    factor = rng.normal(size=(6, 6))
    material = Material(factor @ factor.T + np.eye(6), np.zeros((3, 6)), None)
    found = [material.rotated(*axes).stiffness[2, 2] for axes in rng.normal(size=(5000, 2, 3))]
    error = np.std(found) / np.sqrt(len(found))
    assert abs(np.mean(found) - material.mean_stiffness) < 4.0 * error
    assert Material.isotropic(2500.0, 0.3).mean_stiffness == pytest.approx(2500.0 * 0.7 / (1.3 * 0.4), rel=1e-14)


def rotations(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Rotations (count, 3, 3), and directions (count, 3) of axes 3 and 1 that lead to them."""
    polings, firsts = rng.normal(size=(2, count, 3))
    return np.array([material_axes(p, a) for p, a in zip(polings, firsts, strict=True)]), polings, firsts


@pytest.mark.parametrize("scale", [None, 1e4])
def test_numbers_along_many_axes_are_those_of_the_rotated_materials(
    scale: float | None, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a material without symmetry, also where the rotations do not all fit into memory at a time."""
    material = without_symmetry(rng)
    axes, polings, firsts = rotations(rng, 25)
    found = material.numbers_in(axes, scale)
    expected = [material.rotated(*pair).numbers(3, "strain", scale) for pair in zip(polings, firsts, strict=True)]
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / size, expected / size, atol=1e-14)
    monkeypatch.setattr(materials, "AT_ONCE", 10)
    np.testing.assert_array_equal(material.numbers_in(axes, scale), found)
    assert material.numbers_in(axes[:0], scale).shape == (0, found.shape[1])


def test_the_response_along_many_axes_is_that_of_the_rotated_materials(rng: np.random.Generator) -> None:
    material = without_symmetry(rng)
    axes, polings, firsts = rotations(rng, 25)
    strain, field = rng.normal(size=(25, 6)), rng.normal(size=(25, 3))
    found = material.response_in(axes, strain, field)
    for i in range(len(axes)):
        expected = material.rotated(polings[i], firsts[i]).response(strain[i], field[i])
        np.testing.assert_allclose(found.stress[i], expected.stress, atol=1e-12)
        np.testing.assert_allclose(found.electric_displacement[i], expected.electric_displacement, atol=1e-12)


def without_symmetry(rng: np.random.Generator) -> Material:
    """A stable material all of whose constants differ."""
    elastic, electric = rng.normal(size=(6, 6)), rng.normal(size=(3, 3))
    return Material(elastic @ elastic.T + np.eye(6), rng.normal(size=(3, 6)), electric @ electric.T + np.eye(3))
