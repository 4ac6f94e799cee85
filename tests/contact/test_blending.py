"""Blending of facets near edges: derivatives, balance, symmetry, and answers that depend on the state alone."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.forms.contact.blending import (
    WIDTH,
    BlendedTerms,
    FacetShare,
    blended_changes,
    blended_vectors,
    mean_values,
)
from piezomat.forms.contact.facets import FacetKind, facet_kind
from piezomat.forms.contact.gap import Projection, project
from piezomat.forms.contact.integrals import FacetPairs, PointForces
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.forms.contact.laws.response import Response
from tests.derivative import slope
from tests.facets import KINDS, warped_facets

each_kind = pytest.mark.parametrize("name", KINDS)
POINTS = 20


def near_the_rim(kind: FacetKind, rng: np.random.Generator, count: int) -> Array:
    """Random points (count, t) less than `WIDTH` inside or outside one side or two."""
    xi = rng.uniform(0.2, 0.5, (count, kind.dim))
    xi[:, 0] = rng.uniform(-0.9, 0.9, count) * WIDTH[kind.order]
    corner = np.arange(count) % 3 == 0
    xi[corner, -1] = rng.uniform(-0.9, 0.9, corner.sum()) * WIDTH[kind.order]
    return xi


class Fans:
    """Points of warped slave facets, each with one to three warped master facets, near a side of each of them.

    The enthalpy of the points is a function of the unknowns of their slave facets (b, n, c) and of their masters'
    (k, n, c).
    """

    def __init__(self, name: str, rng: np.random.Generator, electric: bool) -> None:
        self.kind = kind = facet_kind(name)
        self.dim, self.components = kind.dim + 1, kind.dim + 1 + electric
        count = np.arange(POINTS) % 3 + 1
        self.point = np.repeat(np.arange(POINTS), count)
        self.xi = near_the_rim(kind, rng, len(self.point))
        self.orientation = np.where(np.arange(len(self.point)) % 2, 1.0, -1.0)
        self.width = WIDTH[kind.order] * rng.uniform(0.9, 1.0, (len(self.point), len(kind.sides[0])))
        xi = rng.uniform(0.1, 0.4, (POINTS, kind.dim))
        self.shape = kind.shape(xi)
        self.slave = warped_facets(kind, rng, POINTS)
        self.master = warped_facets(kind, rng, len(self.point))
        at = np.einsum("mk,mkd->md", self.shape, self.slave)[self.point]
        there = np.einsum("mk,mkd->md", kind.shape(self.xi), self.master)
        start = project(kind, there, self.master, self.orientation, self.xi)
        gap = rng.uniform(-0.15, 0.05, len(self.point))
        self.master += (at - there - gap[:, None] * start.normal)[:, None]
        if electric:
            self.slave = np.concatenate([self.slave, rng.uniform(-1, 1, (*self.slave.shape[:2], 1))], axis=2)
            self.master = np.concatenate([self.master, rng.uniform(-1, 1, (*self.master.shape[:2], 1))], axis=2)
        equal = EqualPotential(rng.uniform(1.0, 2.0, POINTS), np.full(POINTS, 0.08))
        penalty = NormalPenalty(rng.uniform(50.0, 100.0, POINTS))
        self.law = penalty + equal if electric else penalty
        self.weight = rng.uniform(0.5, 1.5, POINTS)

    def project(self, slave: Array, master: Array) -> tuple[Projection, FacetShare]:
        d = self.dim
        points = np.einsum("mk,mkd->md", self.shape, slave[..., :d])[self.point]
        projection = project(self.kind, points, master[..., :d], self.orientation, self.xi)
        return projection, FacetShare.at(self.kind, projection.xi, self.width)

    def pairs(self, projection: Projection, master: Array) -> FacetPairs:
        potentials = master[..., -1] if master.shape[2] > self.dim else None
        return FacetPairs(self.kind, projection, self.shape[self.point], master.shape[2], potentials)

    def means(self, slave: Array, master: Array) -> Array:
        projection, share = self.project(slave, master)
        gap = mean_values(self.point, share.value, projection.gap)
        if self.components == self.dim:
            return gap[:, None]
        there = np.einsum("mk,mk->m", self.kind.shape(projection.xi), master[..., -1])
        here = np.einsum("mk,mk->m", self.shape, slave[..., -1])
        return np.column_stack([gap, here - mean_values(self.point, share.value, there)])

    def respond(self, slave: Array, master: Array) -> Response:
        return self.law.respond(self.means(slave, master), self.law.virgin(POINTS))

    def energy(self, slave: Array, master: Array) -> float:
        return float(self.weight @ self.respond(slave, master).enthalpy)

    def terms(self, slave: Array, master: Array, *, tangent: bool) -> BlendedTerms:
        projection, share = self.project(slave, master)
        r = self.respond(slave, master)
        forces = PointForces(self.weight, r.gradient, r.gradient, r.hessian)
        return blended_vectors(self.pairs(projection, master), share, self.point, forces, tangent=tangent)

    def residual(self, slave: Array, master: Array) -> tuple[Array, Array]:
        """Derivatives of the energy by the unknowns of slave and master facets."""
        vectors, n = self.terms(slave, master, tangent=False).vectors, self.slave.shape[1]
        on_slave = np.zeros_like(self.slave)
        np.add.at(on_slave, self.point, vectors[:, :n])
        return on_slave, vectors[:, n:]


@each_kind
@pytest.mark.parametrize("electric", [False, True])
def test_terms_are_derivatives_of_the_energy(name: str, electric: bool, rng: np.random.Generator) -> None:
    fans = Fans(name, rng, electric)
    slave, master, point = fans.slave, fans.master, fans.point
    terms = fans.terms(slave, master, tangent=True)
    residual = fans.residual(slave, master)
    several = np.bincount(point) > 1
    assert (fans.respond(slave, master).traction[several] < 0.0).sum() > 5
    n, c = slave.shape[1:]
    for _ in range(3):
        ds, dm = rng.uniform(-1.0, 1.0, slave.shape), rng.uniform(-1.0, 1.0, master.shape)
        work = slope(lambda h, ds=ds, dm=dm: fans.energy(slave + h * ds, master + h * dm), 1e-6)
        assert work == pytest.approx((residual[0] * ds).sum() + (residual[1] * dm).sum(), rel=1e-6)
        change = np.concatenate([ds[point], dm], axis=1).reshape(len(point), -1)
        turn = np.einsum("kij,kj->ki", terms.matrices, change).reshape(len(point), 2 * n, c)
        on_slave, on_master = np.zeros_like(slave), turn[:, n:].copy()
        np.add.at(on_slave, point, turn[:, :n])
        between = np.concatenate([dm[terms.one], dm[terms.other]], axis=1).reshape(len(terms.one), -1)
        between = np.einsum("kij,kj->ki", terms.coupling, between).reshape(len(terms.one), 2 * n, c)
        np.add.at(on_master, terms.one, between[:, :n])
        np.add.at(on_master, terms.other, between[:, n:])
        for k, found in enumerate((on_slave, on_master)):
            expected = slope(lambda h, ds=ds, dm=dm, k=k: fans.residual(slave + h * ds, master + h * dm)[k], 1e-6)
            assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    for matrices in (terms.matrices, terms.coupling):
        assert np.abs(matrices - np.swapaxes(matrices, 1, 2)).max() < 1e-11 * np.abs(matrices).max()


@each_kind
def test_first_changes_are_derivatives_of_the_means(name: str, rng: np.random.Generator) -> None:
    fans = Fans(name, rng, True)
    ds, dm = rng.uniform(-1.0, 1.0, fans.slave.shape), rng.uniform(-1.0, 1.0, fans.master.shape)
    projection, share = fans.project(fans.slave, fans.master)
    change = np.concatenate([ds[fans.point], dm], axis=1)
    found = blended_changes(fans.pairs(projection, fans.master), share, fans.point, change)
    expected = slope(lambda h: fans.means(fans.slave + h * ds, fans.master + h * dm), 1e-6)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    pairs = fans.pairs(projection, fans.master[..., : fans.dim])
    mechanical = blended_changes(pairs, share, fans.point, change[..., : fans.dim])
    np.testing.assert_allclose(mechanical, expected[:, :1], rtol=1e-6, atol=1e-7)


@each_kind
def test_forces_and_moments_are_balanced(name: str, rng: np.random.Generator) -> None:
    fans = Fans(name, rng, True)
    d = fans.dim
    on_slave, on_master = fans.residual(fans.slave, fans.master)
    force, moment = on_slave[..., :d].sum(axis=1), np.einsum("mnd,mne->mde", on_slave[..., :d], fans.slave[..., :d])
    np.add.at(force, fans.point, on_master[..., :d].sum(axis=1))
    np.add.at(moment, fans.point, np.einsum("mnd,mne->mde", on_master[..., :d], fans.master[..., :d]))
    scale = np.abs(on_slave).max()
    assert np.abs(force).max() < 1e-11 * scale
    assert np.abs(moment - np.swapaxes(moment, 1, 2)).max() < 1e-11 * scale


@each_kind
def test_a_share_is_one_inside_and_nothing_outside(name: str) -> None:
    kind = facet_kind(name)
    width = np.full((1, len(kind.sides[0])), WIDTH[kind.order])
    inside = FacetShare.at(kind, kind.middle[None], width)
    assert inside.value[0] == 1.0 and not inside.first.any() and not inside.second.any()
    beyond = kind.middle.copy()
    beyond[0] = -1.001 * WIDTH[kind.order]
    outside = FacetShare.at(kind, beyond[None], width)
    assert outside.value[0] == 0.0 and not outside.first.any() and not outside.second.any()
    beyond[0] = 0.0
    assert FacetShare.at(kind, beyond[None], width).value[0] == pytest.approx(0.5, rel=1e-15)
