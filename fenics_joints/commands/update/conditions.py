"""An update on frequencies at all conditions of a test, and as curves over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.beams import BeamStructure
from fenics_joints.case.case import Case
from fenics_joints.commands.update.data import positive
from fenics_joints.commands.update.result import Sweep
from fenics_joints.files import plain
from fenics_joints.measurements import Gap, Target, TestData
from fenics_joints.modal.modes import Modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import Points
from fenics_joints.reduction.frf_basis import ModelError, error_limits, sample_values
from fenics_joints.reduction.surrogate import tested_models
from fenics_joints.structure import Parameter, Structure
from fenics_joints.updating import Curves, Predictor, Update, fit_curves, update_all

#: Samples of the parameters, and their range about the start, as factors down and up: a torque
#: changes stiffnesses by far more than a fit at one of them does.
_SAMPLES, _RANGE = 16, (300.0, 10.0)
#: Conditions at which a curve is drawn.
_DRAWN = 40


class FollowedModel:
    """The small model of an update over conditions, with the calls of a `CombinedModel`.

    Its modes are followed by MAC from those at the start, or from measured shapes.

    Args:
        full: The full model.
        target: Frequencies at the first condition.
        parameters: What is identified.
        start: Values at the start.
        data: The test.
        n_modes: Modes of the full model at a sample.
        progress: Told after each sample.

    Attributes:
        reference: Shapes that modes are paired by.
        n_modes: Modes of the small model that are looked through.
        limits: Largest accepted error.
        error: Of the small model at the last of the points that it was looked at.
    """

    error: ModelError

    def __init__(
        self,
        full: Structure | BeamStructure,
        target: Target,
        parameters: Sequence[Parameter],
        start: Mapping[str, float],
        data: TestData,
        n_modes: int,
        progress: Progress,
    ):
        self.names, self.limits = data.mode_names, error_limits(target)
        self._seen = tested_models(full).seen(
            full,
            start,
            sensors=data.sensors,
            n_test=len(data.mode_names),
            n_modes=n_modes,
            shapes=data.shapes,
            progress=progress,
            samples=lambda: sample_values(full, parameters, start, _SAMPLES, _RANGE),
        )
        self.reference, self.n_modes = self._seen.reference, self._seen.forward.n_modes

    @property
    def arrays(self) -> ArrayModel:
        """The small model as it is now."""
        return self._seen.model

    @property
    def samples(self) -> int:
        """How many samples it was made from."""
        return self._seen.n_samples

    def modes(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model."""
        return self._seen.solve(values)

    def ratios(self, values: Mapping[str, float], modes: Modes) -> None:
        """Damping ratios: no data of a sweep."""

    def errors(self, points: Points) -> np.ndarray:
        """Share of the limit that the error takes at each point, (n,)."""
        found = self._seen.errors(points)
        self.error = ModelError(float(found[-1]), None)
        return found / self.limits.frequencies

    def extend(self, points: Points) -> None:
        """Become better at points."""
        self._seen.extend(points)

    def facts(self) -> dict[str, object]:
        """Which of the test's modes change places."""
        return {"crossing_modes": self._seen.crossing_names(self.names)}


def sweep_conditions(
    case: Case,
    target: Target,
    model: FollowedModel,
    parameters: Sequence[Parameter],
    start: Mapping[str, float],
    first: Mapping[int, Update],
    progress: Progress,
) -> tuple[Sweep, list[str]]:
    """Fit all conditions of a case's test and curves over them.

    Args:
        case: The case.
        target: Frequencies at the first condition.
        model: The model, good at that condition.
        parameters: What is identified.
        start: Values of all the model's parameters at the start.
        first: Number of the first condition, and what was found there.
        progress: Told after each condition.

    Returns:
        What was found, and the conditions at which the fit did not converge, in words: left out.
    """
    data = case.measurements()
    ((_, known),) = first.items()
    progress.step("updating at all conditions", len(data) - 1)
    common = {"regularisation": case.update.regularisation, "n_modes": model.n_modes}
    follow, reference = data.shapes is None, data.shapes
    if follow and data.sensors is not None:
        reference = known.prediction.shapes
    targets = [
        replace(target, frequencies_hz=f, log_sd=positive(log_sd), shapes=reference)
        for f, log_sd in zip(data.frequencies_hz, data.log_sd(), strict=True)
    ]
    fits = update_all(
        model.arrays,
        parameters,
        targets,
        start,
        first,
        follow=follow,
        done=progress.advance,
        **common,
    )
    held = [data.row(c) for c in case.update.hold_out]
    progress.step("fitting curves")
    kept = [row for row in fits if row not in held]
    table, frequencies, validation = [], None, case.validation()
    if len(kept) >= 3 and np.all(data.conditions > 0):
        curves = fit_curves(
            model.arrays,
            [targets[row] for row in kept],
            data.conditions[kept],
            [fits[row] for row in kept],
            start,
            **common,
        )
        predict = Predictor(model.arrays, targets[0], (), start, n_modes=model.n_modes)
        frequencies = _gap(curves, data, predict)
        known = np.concatenate([d.conditions for d in (data, validation) if d is not None])
        validation = None if validation is None else _gap(curves, validation, predict)
        table = curves.table(np.linspace(known.min(), known.max(), _DRAWN))
    found = Sweep(
        [_row(data, row, update, row in held) for row, update in fits.items()],
        table,
        frequencies,
        None if frequencies is None else validation,
        data.log_sd(),
    )
    lost = [data.conditions[row] for row in range(len(data)) if row not in fits]
    return found, [f"{c:g} {data.condition_unit}".strip() for c in lost]


def _row(data: TestData, row: int, found: Update, held_out: bool) -> dict[str, object]:
    """A condition's row in the table of fits."""
    frequencies = found.prediction.frequencies_hz
    return {
        "condition": float(data.conditions[row]),
        "parameters": found.mapping(),
        "sd": dict(zip(found.names, found.relative_sd.tolist(), strict=True)),
        "frequencies_hz": frequencies.tolist(),
        "errors_percent": plain(100 * (frequencies / data.frequencies_hz[row] - 1)),
        "held_out": held_out,
    }


def _gap(curves: Curves, data: TestData, predict: Predictor) -> Gap:
    """Test against the model with its parameters on the curves."""
    model = [predict(curves.values(float(c))).frequencies_hz for c in data.conditions]
    return Gap(data.conditions, data.mode_names, data.frequencies_hz, np.array(model))
