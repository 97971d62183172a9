"""Updating on any mix of frequencies, shapes, damping ratios and FRFs, by maximum likelihood.

Residuals are in standard deviations: of ln f, of shapes, of ln zeta, and of the complex ln H, whose
real part is a difference of levels and whose imaginary part one of phases, so that a peak weighs no
more than a valley (Arruda, AIAA J. 30, 1992, on fits of curves to FRFs). A trust region with bounds
works in the logarithms of the parameters. It first fits with the lines moved along with the
resonances (`fenics_joints.updating.prediction`); from there the fit at the lines themselves starts.
On frequencies alone it is the bounded, weighted least squares of Tian et al. 2021, eqs. 17 and 18.

Where a fit of frequencies alone leaves residuals far above the noise, other starts are tried
(`fenics_joints.updating.starts`). Where a fit does not converge, stops although a step could still
be taken, or leaves residuals of shapes or damping far above the noise, data without FRFs are fitted
again in rounds (`fenics_joints.updating.rounds`).

The same in Machines 2022's way is `fenics_joints.updating.weighted`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import OptimizeResult

from fenics_joints.errors import ConvergenceError, flag, mapping, member, real, whole
from fenics_joints.formatting import number
from fenics_joints.measurements.gap import Pairing, partnered
from fenics_joints.measurements.least_squares import information_root
from fenics_joints.measurements.target import Target
from fenics_joints.structure import Damping, Parameter
from fenics_joints.updating.equations import condition_number
from fenics_joints.updating.identification import Identification
from fenics_joints.updating.residuals import raw_rows
from fenics_joints.updating.result import Update
from fenics_joints.updating.rounds import OUT_OF_EVALUATIONS, in_rounds, is_stuck
from fenics_joints.updating.starts import AS_GOOD, exchanged, other_starts
from fenics_joints.updating.target_fit import TargetFit

#: When FRF lines are moved along with the resonances: for the first of two fits, or throughout.
MOVES = ("first", "always", "never")
#: Accuracy, in coordinates, at which the first fit, with moved lines, ends; chosen: it only starts
#: the second one.
_ROUGH = 1e-3
#: In that fit, standard deviation of ln H beside the noise: over moved lines FRFs differ by their
#: shape, by a factor of about e where the model is far off, and until then the frequencies lead.
_SHAPE = 1.0


def update(
    model,
    parameters: Sequence[Parameter],
    target: Target,
    start: Mapping[str, float],
    *,
    damping: Damping | None = None,
    moves: str = "first",
    regularisation: float | None = None,
    centre: Mapping[str, float] | None = None,
    max_evaluations: int = 100,
    n_modes: int | None = None,
    strict: bool = True,
    elsewhere: bool = True,
) -> Update:
    """Fit parameters to any mix of data. Collective for a full model.

    Args:
        model: A `Structure`, or a reduced one that was made for the target's sensors.
        parameters: What is identified, within its bounds.
        target: The data and their standard deviations.
        start: Values at the start, of the parameters (beyond their bounds: the fit starts just
            inside) and of any other of the model's that differs from its nominal value.
        damping: The model's damping; its numbers may be names of parameters.
        moves: When the FRFs' lines are moved with the resonances: ``"first"``, for a first fit from
            whose end a second one at the lines themselves starts; ``"always"``, for a model that
            will never have the test's frequencies, with lines that count less where an error of the
            frequencies would change them; ``"never"``.
        regularisation: Standard deviation about ``centre`` of each parameter, of its logarithm if
            it is a ``log`` one, else of its value over its size at the start; None for none, unless
            the fit needs one: then a quarter of the room between the bounds, at most ln 10.
        centre: Values about which it holds the parameters; the start by default.
        max_evaluations: Sets of values before giving up, in each of the fits.
        n_modes: Modes to compute; by default enough for the target.
        strict: Whether an iteration that does not converge, or rival minima that leave the
            parameters unidentified, raise an exception; otherwise they are part of the result.
        elsewhere: Whether a fit that leaves frequencies far off is tried from other starts.

    Raises:
        InputError: For a parameter, start or data that cannot be.
        ConvergenceError: If the iteration does not converge, or the model is not solved at the
            start; or if modes exchange places between two minima of similar cost, both far from the
            data: which of the test's modes is which is then open; or if no mode of the model
            matches a measured shape.
    """
    member("moves", moves, MOVES)
    whole("max_evaluations", max_evaluations)
    flag("strict", strict)
    flag("elsewhere", elsewhere)
    if regularisation is not None:
        real("regularisation", regularisation, above=0.0)
    for name, value in mapping("centre", centre, "values by the parameters' names").items():
        real(f"centre[{name!r}]", value)
    fit = _Fit(regularisation, centre, model, parameters, target, start, damping, n_modes)
    problem, x = fit.problem, fit.start
    can_move = target.frfs is not None and fit.predictor.moves.any()
    moved = moves == "always" and can_move
    if moves != "never" and can_move:
        fit.residuals.weaken(_SHAPE)
        x = problem.solve(x, max_evaluations, moved=True, accuracy=_ROUGH).x
        fit.residuals.weaken(0.0)
    if moved:
        fit.residuals.inflate(problem.predict(0, x, True), fit.predictor.moves)
    done, rivals = problem.solve(x, max_evaluations, moved=moved), []
    if elsewhere and set(target.kinds) == {"frequencies"}:
        done, rivals = fit.best_end(done, max_evaluations)
    x, converged, message = done.x, done.status > 0, _WORDS.get(done.status, done.message)
    if target.frfs is None and fit.needs_rounds(done):
        x, converged, message = fit.in_rounds(done.x, max_evaluations)
    elif converged and (rival := fit.unidentified(done, rivals)):
        if strict:
            raise ConvergenceError(f"updating {', '.join(fit.names)}: {rival}")
        converged, message = False, rival
    lost = fit.without_partner(x) if strict else ""
    if lost:
        lost = (
            f"no mode of the model matches {lost} of the test, before the fit or after: expected "
            "shapes visible to the sensors, or the test without this mode"
        )
    if strict and not converged:
        raise ConvergenceError(
            f"updating {', '.join(fit.names)} did not converge in {max_evaluations} "
            "evaluations; start nearer, or identify fewer parameters",
            f"{message}; {lost}" if lost else message,
        )
    if lost:
        raise ConvergenceError(f"updating {', '.join(fit.names)}: {lost}")
    return fit.finish(x, moved, converged, message)


#: Root mean square of residuals, in standard deviations, above which the message mentions them, and
#: above which the data's standard deviations are widened; chosen.
_MISFIT, _FAR = 2.0, 3.0
#: Difference of coordinates, and relative one of sums of squares, below which two minima are the
#: same; chosen.
_SAME_END = 1e-2
#: Standard deviation of a parameter that needs a prior and has none, at most: a factor of 10.
_WEAK = np.log(10.0)
#: The end of rounds, in words.
_SETTLED = "converged: in rounds, with the data's standard deviations widened to the residuals"
#: What scipy's status says, in words.
_WORDS = {
    0: f"not converged: {OUT_OF_EVALUATIONS}",
    1: "converged: the gradient vanishes",
    2: "converged: the sum of squares no longer falls",
    3: "converged: the parameters no longer change",
    4: "converged: neither the sum of squares nor the parameters change any more",
}


class _Fit(Identification):
    """The least squares' problem of one target, and its result."""

    method = "log"

    def __init__(self, regularisation, centre, model, parameters, target, start, *args):
        super().__init__(model, parameters, target, start, *args)
        self.weight = np.zeros(len(self.names))
        if regularisation is not None:
            self.weight += 1 / regularisation
        for name in centre or ():
            member("centre", name, start)
        about = [{**start, **(centre or {})}[n] for n in self.names]
        self.centre = self._working(np.array(about))
        self.problem = TargetFit([self.predictor], self.coordinates, self._pull, self._record)
        (self.residuals,) = self.problem.residuals
        self.start = self.problem.inside(self.coordinates.inverse(self.first))

    def _working(self, values) -> np.ndarray:
        """Logarithms, or values over their size, to which the regularisation belongs."""
        log, unit = self.coordinates.log, self.coordinates.unit
        return np.where(log, np.log(np.where(log, values, 1.0)), values / unit)

    def _pull(self, x) -> tuple[np.ndarray, np.ndarray]:
        """The regularisation's residuals at coordinates, and their derivatives; none without."""
        if not self.weight.any():
            return np.empty(0), np.empty((0, len(x)))
        values, by_x = self.coordinates.at(0, x)
        slope = by_x / self.coordinates.working(values)[:, None]
        return self.weight * (self._working(values) - self.centre), self.weight[:, None] * slope

    def _record(self, x, moved: bool) -> None:
        values, prediction = self.coordinates.values(x), self.problem.predict(0, x, moved)
        A, _, _ = raw_rows(self.target, prediction, "parts")
        conditions = condition_number(A), condition_number(self.whitened(values, prediction))
        residuals = self.residuals.values(prediction, widened=False), self._pull(x)[0]
        cost = 0.5 * sum(float(part @ part) for part in residuals)
        self.record(values, prediction, conditions, moved=moved, cost=cost)

    def is_far(self, x: np.ndarray) -> bool:
        """Whether the residuals at these coordinates are far above the noise."""
        off = np.sum(self.residuals.values(self.problem.predict(0, x)) ** 2)
        return bool(off > _FAR**2 * max(self.residuals.count - len(self.names), 1))

    def best_end(self, done: OptimizeResult, max_evaluations: int):
        """The best minimum of fits of frequencies from one start or, where this converges far from
        the data, from others too; and the other minima. The history is the path to the best."""
        if done.status <= 0 or not self.is_far(done.x):
            return done, []
        ends, ways = [done], [self.history]
        for x in other_starts(self.problem, self.start, done.x):
            self.history = self.history[:1]
            ends.append(self.problem.solve(x, max_evaluations))
            ways.append(self.history)
        # Among equal minima, the one of the given start.
        least = min(end.cost for end in ends)
        best = next(i for i, end in enumerate(ends) if end.cost <= (1 + _SAME_END) * least)
        self.history, at = ways[best], ends[best].x
        return ends[best], [end for end in ends if np.abs(end.x - at).max() > _SAME_END]

    def unidentified(self, best: OptimizeResult, rivals: Sequence[OptimizeResult]) -> str:
        """A sentence if modes exchange places between minima of similar cost; or ""."""
        rivals = [end for end in rivals if end.cost < AS_GOOD * best.cost]
        if not rivals or not self.is_far(best.x):
            return ""
        names = [
            dict(zip(self.names, self.coordinates.values(end.x).tolist(), strict=True))
            for end in (best, *rivals)
        ]
        for other in names[1:]:
            pairs = exchanged(self.predictor, names[0], other)
            if pairs:
                i, j = pairs[0]
                at = ", ".join(f"{name} = {value:.4g}" for name, value in other.items())
                return (
                    f"not identified: modes {i + 1} and {j + 1} exchange places between these "
                    f"values and {at}, which fit about as well; expected shapes or another start"
                )
        return ""

    def without_partner(self, x: np.ndarray) -> str:
        """Modes of the test with shapes that match none of the model's, at the start and at these
        coordinates; or ""."""
        if self.target.shapes is None or not len(self.target):
            return ""
        alone, hz = np.ones(len(self.target), dtype=bool), self.target.frequencies_hz
        for at in (self.start, x):
            p = self.problem.predict(0, at)
            pairing = Pairing(np.arange(len(hz)), np.arange(len(hz)), p.shapes, p.mac)
            alone &= ~partnered(pairing, p.frequencies_hz, hz, self.target.shapes)
        return ", ".join(f"mode {i + 1} ({hz[i]:.4g} Hz)" for i in np.flatnonzero(alone))

    def needs_rounds(self, done) -> bool:
        """Whether a fit has to be made again in rounds: see the module."""
        many = {"shapes", "damping"} & set(self.target.kinds)
        far = many and self.is_far(done.x)
        return bool(done.status <= 0 or far or is_stuck(self.problem, done.x))

    def in_rounds(self, x: np.ndarray, max_evaluations: int) -> tuple[np.ndarray, bool, str]:
        """The same from the start and from where a fit has ended: coordinates, whether the rounds
        have settled, and why they ended."""
        if not self.weight.any():
            low, high = self.coordinates.bounds()
            self.weight += 1 / np.minimum((high - low) / 4, _WEAK)
        end = in_rounds(self.problem, [self.start, x], max_evaluations)
        return end.x, end.settled, _SETTLED if end.settled else f"not converged: {end.why}"

    def finish(self, x: np.ndarray, moved: bool, converged: bool, message: str) -> Update:
        """The result at the end of a fit."""
        values, by_x = self.coordinates.at(0, x)
        prediction = self.problem.predict(0, x, moved)
        pull, noise = self._pull(x)[1], None
        of_data = self.residuals.slopes(prediction) @ by_x
        # The data's misfit does not change how well priors and bounds are known.
        excess = self.excess(prediction, _taken(of_data, pull))
        slope = np.concatenate([of_data / np.sqrt(excess), pull])
        if moved:
            noise = self.residuals.noise(prediction, self.predictor.moves)
            noise = block_diag(noise, np.eye(len(pull)))
        covariance = _covariance(slope, noise, by_x)
        found = self.result(values, prediction, covariance, excess, converged, message)
        off = found.chi2 / max(found.degrees_of_freedom, 1)
        if off <= _MISFIT**2:
            return found
        words = f"test and model still differ by {number(np.sqrt(off), 2)} standard deviations"
        return replace(found, message=f"{message}; {words}")


def _taken(of_data: np.ndarray, pull: np.ndarray) -> float:
    """Effective number of parameters that the data, not the regularisation, determine: the trace
    of the data's share of the information (MacKay, Neural Comput. 4, 1992).

    Args:
        of_data: Derivatives of the data's residuals by the coordinates, (r, p).
        pull: Derivatives of the regularisation's residuals, (k, p).
    """
    own = of_data.T @ of_data
    return float(np.trace(np.linalg.pinv(own + pull.T @ pull, hermitian=True) @ own))


def _covariance(slope: np.ndarray, noise: np.ndarray | None, by_x: np.ndarray) -> np.ndarray:
    """Covariance of the values, very large where the data leave them open.

    Args:
        slope: Derivatives of the residuals by the coordinates, (r, p).
        noise: What the data's errors do to the residuals where one error does to several, (r, k).
        by_x: Derivatives of the values by the coordinates, (p, p).
    """
    inverse, known = information_root(slope)
    root = by_x @ inverse
    if noise is None:
        return root @ root.T
    change = root[:, known] @ inverse[:, known].T @ slope.T @ noise
    return change @ change.T + root[:, ~known] @ root[:, ~known].T


# -- all conditions of a test ----------------------------------------------------------------------


def update_all(
    model,
    parameters: Sequence[Parameter],
    targets: Sequence[Target],
    start: Mapping[str, float],
    first: Mapping[int, Update],
    *,
    follow: bool = True,
    regularisation: float | None = None,
    n_modes: int | None = None,
    done: Callable[[], None] = lambda: None,
) -> dict[int, Update]:
    """Fit all conditions, each started from its neighbour, from one that is known outwards.

    Args:
        model: As for `update`.
        parameters: What is identified.
        targets: The data at each condition.
        start: Values at the start, about which the regularisation holds the parameters.
        first: Number of the known condition, and what was found there.
        follow: Whether modes are paired by the neighbour's shapes, in place of the targets'.
        regularisation: As for `update`.
        n_modes: As for `update`.
        done: Called after each condition.

    Returns:
        What was found at each condition, ascending; those where the fit does not converge are left
        out.
    """
    ((at, known),) = first.items()
    found = {at: known}
    for rows in (range(at + 1, len(targets)), range(at - 1, -1, -1)):
        last = known
        for row in rows:
            target = targets[row]
            if follow and last.prediction.shapes is not None:
                target = replace(target, shapes=last.prediction.shapes)
            try:
                last = found[row] = update(
                    model,
                    parameters,
                    target,
                    {**start, **last.mapping()},
                    centre=start,
                    regularisation=regularisation,
                    n_modes=n_modes,
                    elsewhere=False,
                )
            except ConvergenceError:
                pass  # the next starts from the last that did
            done()
    return dict(sorted(found.items()))
