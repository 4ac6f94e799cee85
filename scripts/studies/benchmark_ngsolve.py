"""The benchmark's two fibers in NGSolve: python benchmark_ngsolve.py MESH.msh (ASCII MSH 2.2), one JSON line.

At its best setting: the bulk is assembled once, pairing and normals are frozen after five iterations of a step, each
step starts from an extrapolation, and GMRES takes a factorization as its preconditioner that is kept until it serves no
longer: NGSolve's sparse Cholesky. PARDISO, which 6.2.2602 with mkl before 2026 is the last to have by pip, is slower at
77,000 unknowns in 3D to factorize (30 s against 25 s) and to solve, as the tangent is not stored as a symmetric one;
where it is, the second factorization of a changed contact ends the program. GMRES's tolerance and the iterations until
it factorizes anew are among the fastest of ten pairs in 2D at 57,000 unknowns (some faster ones fail on other meshes),
and in 3D of two at 77,000. The law of the contact is piezomat's: the same penalties, the same fading of the electric
contact over RANGE, the master's normal. Not equal: derivatives of the closest point are left out.
"""

# Runs in a Python without piezomat's packages.
from __future__ import annotations

import argparse
import json
import sys
from math import sqrt

import numpy as np
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
from ngsolve.la import GMRESSolver, SparseMatrixd

YOUNG, POISSON, PERMITTIVITY = 2500.0, 0.3, 12 * 8.8541878128e-6
E31, E32, E33 = 0.0307692, -0.0057692, -0.075
RANGE, APPROACH, STEPS = 0.002, 0.05, 5
TOLERANCE, FROZEN = 1e-8, 5

given = argparse.ArgumentParser()
given.add_argument("mesh")
given.add_argument("--normal", type=float, default=1e5)
given.add_argument("--electric", type=float, default=0.1)
given = given.parse_args()
SetNumThreads(1)
sys.stdout, stdout = sys.stderr, sys.stdout  # ReadGmsh prints
mesh = Mesh(ReadGmsh(given.mesh))
dim = mesh.dim
scale = sqrt(YOUNG / PERMITTIVITY)
# Tolerance of GMRES; iterations beyond which the next one factorizes anew, which costs more in 3D.
KRYLOV, STALE = (1e-3, 6) if dim == 2 else (1e-4, 30)
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
bulk = BilinearForm(enthalpy * dx).Assemble()

touch = BilinearForm(space, check_unused=False)
contact = ContactBoundary(mesh.Boundaries("lower_contact"), mesh.Boundaries("upper_contact"))
position = CoefficientFunction((x, y) if dim == 2 else (x, y, z))
gap = (position + u - position.Other() - u.Other()) * contact.normal.Other()
jump = scale * (p - p.Other())
away = gap / RANGE
fading = IfPos(away, IfPos(1 - away, 1 - away * away * (3 - 2 * away), 0), 1)
contact.AddEnergy(IfPos(gap, 0, 0.5 * given.normal * gap * gap) - 0.5 * given.electric * fading * jump * jump)


def factorized():
    """The inverse of the whole tangent."""
    rows, columns, values = (
        np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in zip(bulk.mat.COO(), touch.mat.COO(), strict=True)
    )
    whole = SparseMatrixd.CreateFromCOO(rows, columns, values, space.ndof, space.ndof)
    return whole.Inverse(space.FreeDofs(), inverse="sparsecholesky")


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
    last.data = before
    down = CoefficientFunction((0,) * (dim - 1) + (-APPROACH * step / STEPS,))
    state.components[0].Set(down, definedon=top)
    for iteration in range(25):
        if iteration < FROZEN:
            paired.vec.data = state.components[0].vec
            contact.Update(paired, touch, intorder=2, maxdist=APPROACH)
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
