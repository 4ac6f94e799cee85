"""Line search: how much of a Newton step is taken, by the slope of the enthalpy along it.

Points that come into contact make the enthalpy Pi much steeper than the tangent knew. With the step s from x to
x - s, and R = dPi/du the displacements' part of the residual, the slope along the step at the length l is

    d/dl Pi(x - l s) = -R(x - l s) . s.

Pi is convex in the displacements where adhesion does not soften. So the slope grows along the step, with kinks where
points begin to touch, and the length where it vanishes is found by secants in turns with bisection: until the slope is
at most `SLOPE_REDUCTION` of the first one, either way.

- A step at whose end the enthalpy still falls is taken whole.
- A step that leads uphill from its start, where the tangent is not positive, is halved until the residual has grown by
  no more than `UPHILL_GROWTH`.
- Near the solution slopes are rounding: a whole step that leaves at most `CONVERGING` of the residual is taken.

Without it an array of twelve fibers fails in 1/256 of a step, and half discs under a traction take 123 iterations
instead of 20.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.solver.linear import LinearSolver

SLOPE_REDUCTION = 0.5  # largest slope where a search ends, share of the first slope
CONVERGING = 0.1  # share of the residual that a whole step leaves at most if it is taken without a look at the slope
LONGEST_SEARCH = 30  # trials
UPHILL_GROWTH = 10.0  # largest growth of the residual along a step that leads uphill
SHORTEST_STEP = 1e-3
JUMP = 1e-2  # share of a step: width of the bracket within which the slope is taken to jump


class LineSearch:
    """Line search of the steps x - s of PETSc's SNES. Every method is collective.

    The residual of the last trial is kept: SNES asks for it next if it takes the whole step.
    """

    def __init__(self, problem: Problem, linear: LinearSolver) -> None:
        self.problem = problem
        self.linear = linear
        self._point = problem.state.duplicate()  # of the last trial
        self._residual = problem.state.duplicate()  # at that point
        self._is_whole_step = False
        self._mode = COMPLETE

    def start(self) -> None:
        """Begin a solve: forget the trials of the last one."""
        self._is_whole_step = False

    def residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode) -> None:
        """Residual at x, which SNES has chosen."""
        is_trial, self._is_whole_step = self._is_whole_step and x.equal(self._point), False
        if is_trial:
            self._residual.copy(result)
        else:
            self.linear.equations.residual(x, result, mode)

    def search(self, x: PETSc.Vec, step: PETSc.Vec, residual: PETSc.Vec, mode: EvaluationMode) -> float:
        """Shorten the step from x, where the residual is given; the share of its norm that the whole step leaves."""
        self._mode, here = mode, residual.norm()
        self._trial_residual(x, step, 1.0)
        left = self._residual.norm() / here
        if left <= CONVERGING:
            return left
        slope_here, slope = -self._product(residual, step), -self._product(self._residual, step)
        if slope_here >= 0.0:
            step.scale(self._uphill_length(x, step, UPHILL_GROWTH * here))
        elif slope > SLOPE_REDUCTION * -slope_here:
            step.scale(self._length_of_least_enthalpy(x, step, slope_here, slope))
        return left

    def _uphill_length(self, x: PETSc.Vec, step: PETSc.Vec, bound: float) -> float:
        """The longest of 1, 1/2, 1/4, ... with a residual below the bound."""
        length = 1.0
        while self._residual.norm() > bound and length > SHORTEST_STEP:
            length *= 0.5
            self._trial_residual(x, step, length)
        return length

    def _length_of_least_enthalpy(self, x: PETSc.Vec, step: PETSc.Vec, slope_here: float, slope_at_end: float) -> float:
        """Length in (0, 1) with a small slope, given the negative one at 0 and the positive one at 1."""
        low, high = (0.0, slope_here), (1.0, slope_at_end)
        for trial in range(LONGEST_SEARCH):
            # The slope is monotonic with kinks: secants in turns with bisection.
            share = low[1] / (low[1] - high[1]) if trial % 2 == 0 else 0.5
            length = low[0] + share * (high[0] - low[0])
            self._trial_residual(x, step, length)
            slope = -self._product(self._residual, step)
            if abs(slope) <= SLOPE_REDUCTION * -slope_here:
                return length
            low, high = (low, (length, slope)) if slope > 0.0 else ((length, slope), high)
            length = high[0]
            if high[0] - low[0] < JUMP:
                return length
        return length

    def _trial_residual(self, x: PETSc.Vec, step: PETSc.Vec, length: float) -> None:
        """Evaluate the residual at x - length * step.

        Points that meet nothing are searched for a facet at the whole step alone: on the way there the slope must not
        jump where they find one.
        """
        step.copy(self._point)
        self._point.aypx(-length, x)
        self._is_whole_step = length == 1.0
        mode = replace(self._mode, search=self._is_whole_step)
        self.linear.equations.residual(self._point, self._residual, mode)

    def _product(self, residual: PETSc.Vec, step: PETSc.Vec) -> float:
        """Displacements' part of residual . step."""
        d = self.problem.model.unknowns.all_displacements
        return self.problem.comm.allreduce(float(np.vdot(d(residual), d(step))), op=MPI.SUM)
