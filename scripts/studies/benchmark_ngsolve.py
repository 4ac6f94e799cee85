"""The benchmark's two fibers in NGSolve: python benchmark_ngsolve.py MESH.msh (ASCII MSH 2.2), one JSON line.

NGSolve runs with the fastest settings found (processor seconds measured on 20,032 unknowns in 3D):

- All forms are declared symmetric, so that half of each matrix is stored and PARDISO (of the package mkl) factorizes
  a symmetric one: a factorization takes 0.6 instead of 1.1 s, a Krylov iteration 0.018 instead of 0.08 s. NGSolve's
  own sparse Cholesky takes 0.036 s for one.
- The contact energy is compiled: assembly takes a third of the time.
- The bulk is assembled once. Contact points are sought no farther than REACH apart, and in 3D only on facets that lie
  within NEAR of the other surface. Pairing and normals are frozen after FROZEN iterations of a step.
- A step starts from the extrapolation of the last two, the first from a translation of the upper body.
- GMRES is preconditioned by a factorization that is kept until a solve takes more than STALE iterations.

The law of the contact is that of piezomat: the same penalties, the same fading of the electric contact over RANGE, and
the normal of the master. Derivatives of the closest point are left out of the tangent.
"""

# Runs in a Python without piezomat's packages.
from __future__ import annotations

import argparse
import json
import sys
from math import sqrt

import numpy as np
from netgen.meshing import FaceDescriptor
from netgen.read_gmsh import ReadGmsh
from ngsolve import (
    BND,
    H1,
    BilinearForm,
    CoefficientFunction,
    ContactBoundary,
    Grad,
    GridFunction,
    IfPos,
    InnerProduct,
    Integrate,
    Mesh,
    Norm,
    Projector,
    SetNumThreads,
    Sym,
    Trace,
    VectorH1,
    dx,
    grad,
    x,
    y,
    z,
)
from ngsolve.krylovspace import GMRESSolver
from scipy.spatial import cKDTree

YOUNG, POISSON, PERMITTIVITY = 2500.0, 0.3, 12 * 8.8541878128e-6
E31, E32, E33 = 0.0307692, -0.0057692, -0.075
RANGE, APPROACH, STEPS = 0.002, 0.05, 5
TOLERANCE, KRYLOV = 1e-8, 1e-2  # of the residual over the reactions; of GMRES
REACH, NEAR = 0.0125, 2 * APPROACH


def set_far_facets_aside(read, surfaces):
    """Move facets of the contact surfaces that are farther than NEAR from the other's nodes to new groups."""
    place = np.array([list(point.p) for point in read.Points()])
    facets = [[f for f in read.Elements2D() if read.GetBCName(f.index - 1) == name] for name in surfaces]
    nodes = [np.array([[vertex.nr - 1 for vertex in f.vertices] for f in group]) for group in facets]
    index = len(read.FaceDescriptors()) + 1
    for i in (0, 1):
        read.Add(FaceDescriptor(bc=index + i))
        read.SetBCName(index + i - 1, f"far_{surfaces[i]}")
        corners = place[nodes[i]]
        centre = corners.mean(axis=1)
        size = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        apart, _ = cKDTree(place[np.unique(nodes[1 - i])]).query(centre)
        for j in np.flatnonzero(apart > NEAR + size):
            facets[i][j].index = index + i


given = argparse.ArgumentParser()
given.add_argument("mesh")
given.add_argument("--normal", type=float, default=1e5)
given.add_argument("--electric", type=float, default=0.1)
given.add_argument("--surfaces", nargs=2, default=["lower_contact", "upper_contact"], help="slave and master")
given = given.parse_args()
SetNumThreads(1)
sys.stdout, stdout = sys.stderr, sys.stdout  # ReadGmsh prints
read = ReadGmsh(given.mesh)
if read.dim == 3:
    set_far_facets_aside(read, given.surfaces)
mesh = Mesh(read)
dim = mesh.dim
scale = sqrt(YOUNG / PERMITTIVITY)
# Iterations of a step after which pairing is frozen: in 2D 3 change potentials by 1 %. Iterations of GMRES beyond which
# the next solve factorizes anew: a factorization costs as much as 10 (2D) or 35 (3D) of them.
FROZEN, STALE = (5, 6) if dim == 2 else (4, 18)
space = VectorH1(mesh, order=1, dirichlet="bottom|top") * H1(mesh, order=1, dirichlet="bottom")
(u, p), (v, q) = space.TnT()


def polarization(strain):
    """Along the axis of poling, of a strain."""
    axes = ((0, E31), (1, E33)) if dim == 2 else ((0, E31), (1, E32), (2, E33))
    return sum(e * strain[i, i] for i, e in axes)


lame, shear = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
strain, field, strain_v, field_v = Sym(Grad(u)), -scale * grad(p), Sym(Grad(v)), -scale * grad(q)
enthalpy = lame * Trace(strain) * Trace(strain_v) + 2 * shear * InnerProduct(strain, strain_v)
enthalpy -= field[dim - 1] * polarization(strain_v) + field_v[dim - 1] * polarization(strain)
enthalpy -= PERMITTIVITY * InnerProduct(field, field_v)
bulk = BilinearForm(space, symmetric=True)
bulk += enthalpy.Compile() * dx
bulk.Assemble()

touch = BilinearForm(space, symmetric=True, check_unused=False)
contact = ContactBoundary(*(mesh.Boundaries(name) for name in given.surfaces))
position = CoefficientFunction((x, y) if dim == 2 else (x, y, z))
gap = (position + u - position.Other() - u.Other()) * contact.normal.Other()
jump = scale * (p - p.Other())
away = gap / RANGE
fading = IfPos(away, IfPos(1 - away, 1 - away * away * (3 - 2 * away), 0), 1)
energy = IfPos(gap, 0, 0.5 * given.normal * gap * gap) - 0.5 * given.electric * fading * jump * jump
contact.AddEnergy(energy.Compile())


def factorized():
    """The inverse of the whole tangent."""
    whole = (bulk.mat + touch.mat).CreateSparseMatrix()
    return whole.Inverse(space.FreeDofs(), inverse="pardiso", flags={"symmetric": True, "refinement": 0})


state = GridFunction(space)
paired = GridFunction(space.components[0])  # where pairing and normals are
residual, change, last, before = (state.vec.CreateVector() for _ in range(4))
last[:] = 0
top = mesh.Boundaries("top")
free = Projector(space.FreeDofs(), True)
iterations, krylov, factorizations, inverse = [], 0, 0, None
for step in range(1, STEPS + 1):
    before.data = state.vec
    if step > 1:
        state.vec.data = 2 * state.vec - last
    else:  # Set makes zero what it does not set
        down = CoefficientFunction((0,) * (dim - 1) + (-APPROACH / STEPS,))
        state.components[0].Set(down, definedon=mesh.Materials("upper"))
    last.data = before
    for iteration in range(25):
        if iteration < FROZEN:
            paired.vec.data = state.components[0].vec
            contact.Update(paired, touch, intorder=2, maxdist=REACH)
        touch.Apply(state.vec, residual)
        residual.data += bulk.mat * state.vec
        change.data = residual
        free.Project(change)
        reactions = Norm(residual - change)
        if iteration > 0 and Norm(change) <= TOLERANCE * reactions:
            break
        touch.AssembleLinearization(state.vec)
        if inverse is None:
            inverse = factorized()
            factorizations += 1
        solver = GMRESSolver(mat=bulk.mat + touch.mat, pre=inverse, printrates=False, tol=KRYLOV, maxiter=200)
        residual.data = change
        change.data = solver * residual
        krylov += solver.GetSteps()
        if solver.GetSteps() > STALE:
            inverse = None
        state.vec.data -= change
    else:
        sys.exit(f"step {step} did not converge")
    iterations.append(iteration)
touch.Apply(state.vec, residual)
residual.data += bulk.mat * state.vec
unit = GridFunction(space)
unit.components[0].Set(CoefficientFunction((0,) * (dim - 1) + (1,)), definedon=top)
area = Integrate(CoefficientFunction(1), mesh, BND, definedon=top)
answer = {
    "unknowns": space.ndof,
    "newton": iterations,
    "krylov": krylov,
    "factorizations": factorizations,
    "force": InnerProduct(residual, unit.vec),
    "potential": scale * Integrate(state.components[1], mesh, BND, definedon=top) / area,
}
print(json.dumps(answer), file=stdout)
