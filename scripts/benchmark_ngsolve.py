"""The benchmark's two fibers in NGSolve: python benchmark_ngsolve.py MESH.msh (ASCII MSH 2.2), one JSON line.

Written as its documentation teaches contact, plus what it needs to be quick here: the pairing is frozen after three
iterations and each step starts from an extrapolation. The whole tangent is assembled and factorized in every
iteration (sparse Cholesky); keeping a factorization as preconditioner, and PARDISO in 3D, would make it faster.
"""

# Runs in a Python without piezomat's packages.
from __future__ import annotations

import json
import sys
from math import sqrt

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
    Variation,
    VectorH1,
    dx,
    grad,
    x,
    y,
    z,
)

YOUNG, POISSON, PERMITTIVITY = 2500.0, 0.3, 12 * 8.8541878128e-6
E31, E32, E33 = 0.0307692, -0.0057692, -0.075
NORMAL, ELECTRIC, APPROACH, STEPS = 1e5, 0.1, 0.05, 5
TOLERANCE, FROZEN = 1e-8, 3

SetNumThreads(1)
sys.stdout, stdout = sys.stderr, sys.stdout  # ReadGmsh prints
mesh = Mesh(ReadGmsh(sys.argv[1]))
dim = mesh.dim
scale = sqrt(YOUNG / PERMITTIVITY)
space = VectorH1(mesh, order=1, dirichlet="bottom|top") * H1(mesh, order=1, dirichlet="bottom")
u, p = space.TrialFunction()
strain, field = Sym(Grad(u)), -scale * grad(p)
lame, shear = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
axes = ((0, E31), (1, E33)) if dim == 2 else ((0, E31), (1, E32), (2, E33))
polarization = sum(e * strain[i, i] for i, e in axes)
enthalpy = 0.5 * lame * Trace(strain) ** 2 + shear * InnerProduct(strain, strain)
enthalpy += -field[dim - 1] * polarization - 0.5 * PERMITTIVITY * InnerProduct(field, field)
form = BilinearForm(space, symmetric=True)
form += Variation(enthalpy * dx)
contact = ContactBoundary(mesh.Boundaries("lower_contact"), mesh.Boundaries("upper_contact"))
position = CoefficientFunction((x, y) if dim == 2 else (x, y, z))
overlap = (position + u - position.Other() - u.Other()) * contact.normal
jump = scale * (p - p.Other())
contact.AddEnergy(IfPos(overlap, 0.5 * NORMAL * overlap * overlap - 0.5 * ELECTRIC * jump * jump, 0))

state = GridFunction(space)
residual, change, last, before = (state.vec.CreateVector() for _ in range(4))
last[:] = 0
top = mesh.Boundaries("top")
free = Projector(space.FreeDofs(), True)
iterations = []
for step in range(1, STEPS + 1):
    before.data = state.vec
    if step > 1:
        state.vec.data = 2 * state.vec - last
    last.data = before
    down = CoefficientFunction((0,) * (dim - 1) + (-APPROACH * step / STEPS,))
    state.components[0].Set(down, definedon=top)
    for iteration in range(25):
        if iteration < FROZEN:
            contact.Update(state.components[0], form, intorder=2, maxdist=2 * APPROACH)
        form.Apply(state.vec, residual)
        change.data = residual
        free.Project(change)
        reactions = Norm(residual - change)
        if iteration > 0 and Norm(change) <= TOLERANCE * reactions:
            break
        form.AssembleLinearization(state.vec)
        inverse = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
        change.data = inverse * residual
        state.vec.data -= change
    else:
        sys.exit(f"step {step} did not converge")
    iterations.append(iteration)
form.Apply(state.vec, residual)
unit = GridFunction(space)
unit.components[0].Set(CoefficientFunction((0,) * (dim - 1) + (1,)), definedon=top)
area = Integrate(CoefficientFunction(1), mesh, BND, definedon=top)
answer = {
    "unknowns": space.ndof,
    "newton": iterations,
    "force": InnerProduct(residual, unit.vec),
    "potential": scale * Integrate(state.components[1], mesh, BND, definedon=top) / area,
}
print(json.dumps(answer), file=stdout)
