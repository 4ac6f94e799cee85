"""Push-forward from referential to current fields: identities for any deformation."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from piezomat.forms.kinematics import deformation_gradient, push_forward


def test_a_rigid_rotation_turns_everything_with_the_body(rng: np.random.Generator) -> None:
    rotation = Rotation.random(random_state=3).as_matrix()
    gradient = (rotation - np.eye(3))[None]
    stress, field, displacement = rng.standard_normal((1, 6)), rng.standard_normal((1, 3)), rng.standard_normal((1, 3))
    f = deformation_gradient(gradient, np.zeros(1))
    cauchy, e, d = push_forward(f, stress, field, displacement)
    t = stress[0]
    matrix = np.array([[t[0], t[5], t[4]], [t[5], t[1], t[3]], [t[4], t[3], t[2]]])
    turned = rotation @ matrix @ rotation.T
    expected = [turned[0, 0], turned[1, 1], turned[2, 2], turned[1, 2], turned[0, 2], turned[0, 1]]
    assert np.allclose(cauchy[0], expected, atol=1e-13)
    assert np.allclose(e[0], rotation @ field[0], atol=1e-13)
    assert np.allclose(d[0], rotation @ displacement[0], atol=1e-13)


def test_uniaxial_stretch_gives_force_over_the_current_area() -> None:
    stretch, piola = 1.3, 10.0
    f = deformation_gradient(np.array([[[stretch - 1.0, 0.0], [0.0, 0.0]]]), np.zeros(1))
    cauchy, e, d = push_forward(f, np.eye(6)[:1] * piola, np.array([[2.0, 0.0, 0.0]]), np.array([[3.0, 0.0, 0.0]]))
    assert np.allclose(cauchy[0], [stretch * piola, 0, 0, 0, 0, 0])  # sideways nothing moves: the area is the old one
    assert np.allclose(e[0], [2.0 / stretch, 0, 0])  # the same voltage over a longer way
    assert np.allclose(d[0], [3.0, 0, 0])  # the same charge on the same area


def test_the_thickness_follows_from_its_strain() -> None:
    f = deformation_gradient(np.zeros((1, 2, 2)), np.array([0.5 * (0.9**2 - 1.0)]))
    assert np.isclose(f[0, 2, 2], 0.9)
