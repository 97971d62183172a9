"""``fenics-joints update``: fits what a case names to what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.beams import BeamStructure
from fenics_joints.case import Case, build_structure, model_damping, test_notes
from fenics_joints.case.dimensions import refuse_unfit
from fenics_joints.commands.cutoff import run_cutoff
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.update.conditions import FollowedModel, sweep_conditions
from fenics_joints.commands.update.data import UpdateData, update_data
from fenics_joints.commands.update.document import update_document, updated_shapes
from fenics_joints.commands.update.partners import (
    WithoutPartner,
    explains_nothing,
    more_or_fewer,
    other_partners,
    without,
)
from fenics_joints.commands.update.result import (
    Compared,
    Functions,
    ModeTable,
    UpdateReport,
    parameter_records,
)
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.files import plain
from fenics_joints.formatting import percent, quantity
from fenics_joints.measurements import Pairing, Target, mac, pair_modes
from fenics_joints.measurements.gap import TooFewModes, partnered
from fenics_joints.modal.modes import Modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.basis import weak_greedy
from fenics_joints.reduction.frf_basis import CombinedModel, ModelError, paired
from fenics_joints.reduction.surrogate import tested_models
from fenics_joints.response.frf import solve_frf
from fenics_joints.structure import Damping, Sensors, Structure
from fenics_joints.updating import Update, update, update_weighted
from fenics_joints.updating.result import bound_notes, fit_notes, too_far
from fenics_joints.updating.weighted import noise_tolerances

#: Modes beyond the rigid-body ones and those of the test: partners may lie among higher ones.
_SPARE = 4
#: How often the reduced model is made better at what was found; what is off after that is noted.
_ROUNDS = 4
#: Share of a fit's sum of squares below which one from another start is taken instead; chosen.
_BETTER = 0.95
#: chi^2 per degree of freedom, three standard deviations of the noise, above which a model has not
#: the test's resonances: lines are then compared at the same place relative to them.
_MISFIT = 9.0


def run_update(case: Case, comm: MPI.Intracomm, progress: Progress | None = None) -> Outcome:
    """The ``update`` command: parameters, or the cut-off pressure of contacts. Collective.

    A fit that does not converge is an answer too: its best values, said to be no more.

    Raises:
        InputError: If the case does not ask for it.
        ConvergenceError: If the model is not solved at the start.
    """
    progress = progress or Progress(silent=True)
    if case.update is not None and case.update.cutoff is not None:
        return run_cutoff(case, comm, progress)
    found = update_case(case, comm, progress)
    return Outcome(found, update_document(found), found.failure)


def update_case(case: Case, comm: MPI.Intracomm, progress: Progress | None = None) -> UpdateReport:
    """Update a case's model at one condition, and on frequencies alone at all, then as curves.

    Collective.

    Raises:
        InputError: If the case does not ask for it, or has no test.
        ConvergenceError: If the model is not solved at the start.
    """
    if case.update is None or case.update.cutoff is not None:
        raise InputError(f"{case.path}: update is missing, expected a section [update]")
    # Matrices of this size are too small for a second BLAS thread to be worth waking.
    progress, notes, names = progress or Progress(silent=True), [], []
    # A third of the modes may be left out: a fit to too few modes always succeeds.
    spare = 0 if case.measured is None else len(case.measured.mode_names) // 3
    with threadpool_limits(1):
        while True:
            try:
                found = _CaseUpdate(case, comm, progress, notes, spare).report()
                return replace(found, without_partner=tuple(names))
            except TooFewModes as error:
                there = case.measurements().mode_names
                case, note = more_or_fewer(case, error)
                notes += [] if note is None else [note]
                names += [n for n in there if n not in case.measurements().mode_names]
            except WithoutPartner as error:
                case, note = without(case, error)
                notes.append(note)
                spare -= len(error.names)
                names += error.names


class _CaseUpdate:
    def __init__(
        self, case: Case, comm, progress: Progress, notes: Sequence[str] = (), spare: int = 0
    ):
        self.spare = spare
        self.case, self.progress, self.section = case, progress, case.update
        self.data: UpdateData = update_data(case)
        progress.step("building the model")
        damped = bool({"damping", "frfs"} & set(self.data.kinds))
        self.full: Structure | BeamStructure = build_structure(case, comm, damping=damped)
        refuse_unfit(case, self.full, self.section.parameters)
        self.damping = model_damping(case, self.full) if damped else Damping()
        self.parameters = [self.full.parameters[n] for n in self.section.parameters]
        self.start = {**case.nominal(damping=damped), **case.start()}
        self.notes: list[str] = [*test_notes(case, self.full), *notes]
        self.n_modes: int | None = None
        self.model = self._model()

    def _model(self) -> CombinedModel | FollowedModel:
        """The small model in the loop; that of all conditions follows modes by MAC."""
        case, target, n_modes = self.case, self.data.target, self.case.diagnose.n_modes
        if not case.combined():
            given = self.full, target, self.parameters, self.start, case.measurements(), n_modes
            model = FollowedModel(*given, self.progress)
            self.n_modes = model.n_modes
            if target.shape_sensors is not None:
                self.data = replace(self.data, target=replace(target, shapes=model.reference))
            return model
        self._check_start()
        least = 6 + len(target) + _SPARE
        given = "n_modes" in case.diagnose.model_fields_set
        n_modes = max(n_modes, least) if given else least
        model = tested_models(self.full).combined(self.full, target, self.damping, n_modes)
        # Damping hardly changes what a basis needs.
        own = {} if case.damping is None else case.damping.nominal()
        moved = [p for p in self.parameters if p.name not in own]
        model.sample(moved, self.start, self.progress)
        return model

    def _check_start(self) -> None:
        for p in self.parameters:
            value = self.start[p.name]
            if not p.lower <= value <= p.upper:
                given = f"update.start.{p.name}" if p.name in self.section.start else p.name
                raise InputError(
                    f"{self.case.path}: {given} = {quantity(value, p.unit)}: expected a start from "
                    f"{quantity(p.lower, p.unit)} to {quantity(p.upper, p.unit)}, its bounds"
                )

    # -- the loop ------------------------------------------------------------------------------

    def report(self) -> UpdateReport:
        """Fit, check, better the reduced model, fit again; then hold out, and compare."""
        found, modes, error = self._checked()
        self.notes += bound_notes(self.parameters, found)
        first = self.model.modes(self.start)
        alone = self._alone(first, modes)
        self.model.ratios(self.start, first)  # before the solver has solved anything else
        held = self._held(first)
        self.progress.step("comparing test and model, before and after")
        values = self._values(found)
        functions = self._functions(values)
        facts, sweep = self._facts(error, functions), None
        if not self.case.combined():
            given = self.case, self.data.target, self.model, self.parameters, self.start
            sweep, lost = sweep_conditions(*given, {self._row(): found}, self.progress)
            facts |= {**self.model.facts(), "not_converged": lost}
        table = self._modes(first, modes, found)
        failure = explains_nothing(table, alone, self.spare, self._in_order(first), found.excess)
        if failure is not None:
            self.notes.append(f"THIS FIT EXPLAINS NOTHING: {failure}; do not use its values")
            failure = f"{self.case.path}: the fit explains nothing: {failure}"
        single = len(self.data.held_modes) == 1
        for j in self.data.held_modes:
            held.append(self._held_record(j, first, modes, found, single))
        return UpdateReport(
            title=self.case.name,
            condition=self.data.condition,
            kinds=self.data.kinds,
            parameters=parameter_records(
                found, [p.unit for p in self.parameters], [self.start[n] for n in found.names]
            ),
            update=found,
            modes=table,
            functions=functions,
            held=held,
            model=facts,
            sweep=sweep,
            notes=self.notes,
            pull=None if found.method == "weighted" else self.section.regularisation,
            published=self._published(),
            shapes=updated_shapes(self.case, self.full, self.data.target, modes, table),
            failure=failure,
        )

    def _alone(self, first: Modes, modes: Modes) -> np.ndarray:
        """Mask of the test's modes without a partner, both before the fit and after, (m,).

        Raises:
            WithoutPartner: If at most a third have none, and none of these is held out by name.
        """
        if not len(self.data.target):
            return np.zeros(0, dtype=bool)
        hz, shapes = self._measured_hz(), self.case.measurements().shapes
        alone = ~np.any(
            [partnered(self._pair(m), m.frequencies_hz, hz, shapes) for m in (first, modes)], axis=0
        )
        if 0 < alone.sum() <= self.spare and not alone[list(self.data.held_modes)].any():
            index = np.flatnonzero(alone).tolist()
            raise WithoutPartner([self.data.mode_names[i] for i in index], index)
        return alone

    def _checked(self) -> tuple[Update, Modes, ModelError]:
        """The fit, where the reduced model holds; else with a better one."""
        found, rounds = None, 0

        def fitted() -> list[dict[str, float]]:
            nonlocal found, rounds
            again, rounds = " again, on a better reduced model" if rounds else "", rounds + 1
            self.progress.step(f"fitting {len(self.parameters)} parameters{again}")
            found = self._again(self._fit(self.data.target), found)
            return [self._values(found)]

        weak_greedy(self.model, fitted, 1.0, _ROUNDS)
        error, off = self.model.error, too_far(self.model.error, self.model.limits)
        self.notes += fit_notes(found, self.data.mode_names)
        if found.method == "log" and found.history[-1].moved:
            self.notes.append(
                "no values were found that bring the model within the noise of the test, so the "
                "FRFs were compared at the same position between resonances, not at the same "
                "frequency"
            )
        if off:
            self.notes.append(
                f"the reduced model is inaccurate at the identified values: {', '.join(off)}; the "
                "parameters may be off by more than their standard deviations"
            )
        modes = self.model.modes(self._values(found))
        self.notes += other_partners(self.data, found, modes)
        return found, modes, error

    def _again(self, found: Update, before: Update | None) -> Update:
        """A fit, or one from where that on the model before ended, if that is clearly better."""
        if before is None or found.method == "weighted" or found.history[-1].moved:
            return found
        other = self._fit(self.data.target, before.mapping())
        return other if other.history[-1].cost < _BETTER * found.history[-1].cost else found

    def _fit(self, target: Target, near: Mapping[str, float] | None = None) -> Update:
        """A fit to a target, from the case's start or from values ``near`` the answer."""
        start = {**self.start, **(near or {})}
        model, common = self.model.arrays, {"damping": self.damping, "strict": False}
        if self.section.method == "weighted":
            common |= {"step_limit": self.section.step_limit, **noise_tolerances(target)}
            return update_weighted(model, self.parameters, target, self.start, **common)
        common |= {"regularisation": self.section.regularisation, "n_modes": self.n_modes}
        common["centre"] = self.start
        found = update(model, self.parameters, target, start, **common)
        both = {"frequencies", "frfs"} <= set(target.kinds)
        misfit = found.chi2 / max(found.degrees_of_freedom, 1)
        if not both or misfit <= _MISFIT:
            return found
        return update(model, self.parameters, target, start, moves="always", **common)

    def _values(self, found: Update) -> dict[str, float]:
        return {**self.start, **found.mapping()}

    # -- held out ------------------------------------------------------------------------------

    def _held(self, first: Modes) -> list[dict]:
        """Every mode in turn, if the case asks for it: fitted anew to all else, from the start."""
        if not self.data.each:
            return []
        target = self.data.target
        fitted = target.frequencies_hz if "frequencies" in target.kinds else target.damping_ratios
        measured = np.flatnonzero(np.isfinite(fitted) & np.isfinite(self._measured_hz()))
        self.progress.step("holding out each mode in turn", len(measured))
        rows = []
        for j in measured:
            name = self.data.mode_names[j]
            try:
                other = self._fit(self.data.without(int(j)))
            except ConvergenceError as error:
                self.notes.append(f"{name} was not held out: {error}")
            else:
                if not other.converged:
                    self.notes.append(f"the fit without {name} is {other.message}")
                # The full model's frequency, so that the reduced one's error is none of the test's.
                modes = self.model.modes(self._values(other))
                rows.append(self._held_record(int(j), first, modes, other, True))
            self.progress.advance()
        return rows

    def _held_record(self, j: int, first: Modes, modes: Modes, found: Update, alone: bool) -> dict:
        """A mode that a fit did not see, for `UpdateReport.held`."""

        def sd(slopes: np.ndarray) -> float:
            return float(np.sqrt(max(slopes @ found.covariance @ slopes, 0.0)))

        row, own = self._modes(first, modes, found).records()[j], found.prediction

        def predicted(prefix: str, unit: str, by_values: float) -> dict:
            keys = {"test": "test", "before": "before", "after": "predicted"}
            made = {f"{prefix}{to}{unit}": row[f"{prefix}{key}{unit}"] for key, to in keys.items()}
            made[f"{prefix}error_percent"] = row[f"{prefix}error_after_percent"]
            return made | {f"{prefix}standard_deviation_percent": plain(100 * by_values)}

        made = {"name": row["name"], **predicted("", "_hz", sd(own.frequency_slopes[j]))}
        made |= {"alone": alone, "parameters": found.mapping()}
        if "damping_test" in row:
            ratios = own.damping_ratios
            by_values = np.nan if ratios is None else sd(own.damping_slopes[j] / ratios[j])
            made |= predicted("damping_", "", by_values)
        return made

    # -- before and after ----------------------------------------------------------------------

    def _pair(self, modes: Modes) -> Pairing:
        return paired(modes, self.data.target)

    def _in_order(self, modes: Modes) -> np.ndarray:
        """Frequencies of the lowest modes that the test sees, Hz, one for each of its own."""
        target = self.data.target
        if not len(target):  # functions alone
            return np.zeros(0)
        seen = pair_modes(modes, len(target), target.shape_sensors).index
        return modes.frequencies_hz[seen]

    def _measured_hz(self) -> np.ndarray:
        """Measured frequencies, also those held out."""
        return self.case.measurements().frequencies_hz[self._row()]

    def _row(self) -> int:
        return self.case.measurements().row(self.section.at)

    def _modes(self, first: Modes, modes: Modes, found: Update) -> ModeTable | None:
        target, values = self.data.target, self._values(found)
        if not len(target):
            return None
        fitted = np.isfinite(target.frequencies_hz)
        fitted[list(found.widths.without)] = False
        before, after = self._pair(first), self._pair(modes)
        shapes = None if self.case.measurements().shapes is None else target.shapes
        macs, damping = (None, None), None
        if shapes is not None:
            macs = tuple(mac(shapes, pairing.shapes) for pairing in (before, after))
        ratios = self.model.ratios(self.start, first)
        if ratios is not None:
            measured = self.case.measurements().damping[self._row()]
            seen = np.isfinite(target.damping_ratios)
            damping = Compared(measured, ratios, self.model.ratios(values, modes), seen)
        return ModeTable(
            self._measured_hz(),
            first.frequencies_hz[before.index],
            modes.frequencies_hz[after.index],
            fitted,
            self.data.mode_names,
            *macs,
            damping,
        )

    def _functions(self, values: Mapping[str, float]) -> Functions | None:
        """The full model's functions at all measured lines, at the start and updated."""
        frfs = self.data.frfs
        if frfs is None:
            return None
        there = frfs.frequencies_hz > 0
        found, errors = [], []
        how = {
            "frequencies_hz": frfs.frequencies_hz[there],
            "excitation": Sensors(frfs.reference_points, frfs.reference_directions),
            "sensors": frfs.sensors(),
            "damping": self.damping,
            "kind": frfs.kind,
            "method": "modal",
            "check": 2,
        }
        for given in (self.start, values):
            frf = solve_frf(self.full, given, **how)
            found.append(frf.values)
            errors.append(0.0 if frf.error is None else float(np.max(frf.error)))
        lines = np.zeros(len(there), dtype=bool)
        lines[self.data.lines] = True
        return Functions(
            frfs.frequencies_hz[there],
            frfs.values[there],
            *found,
            lines[there],
            self.data.held[there],
            frfs.unit,
            (frfs.response_names, frfs.reference_names),
            max(errors),
        )

    def _published(self) -> dict | None:
        published = self.section.published
        if published is None:
            return None
        given = self.case.published()
        modes = self.model.modes({**self.start, **given})
        model = modes.frequencies_hz[self._pair(modes).index]
        theirs = np.array(published.frequencies or [np.nan] * len(model))
        return {
            "source": published.source,
            "parameters": given,
            "frequencies_hz": plain(theirs),
            "model_hz": model.tolist(),
            "errors_percent": plain(100 * (model / theirs - 1)),
        }

    def _facts(self, error: ModelError, functions: Functions | None) -> dict:
        facts = {"dofs": self.full.n_dofs}
        if self.model.samples or not self.case.combined():
            facts |= {
                "basis": self.model.arrays.n_dofs,
                "samples": self.model.samples,
                "frequency_error": error.frequencies,
            }
            if error.damping is not None:
                facts["damping_error"] = percent(error.damping, 4)
        if functions is not None:
            frfs = self.data.target.frfs
            facts |= {
                "lines_fitted": int(functions.lines.sum()),
                "lines_measured": len(functions.frequencies_hz),
                "functions": int(np.isfinite(functions.measured[0]).sum()),
                "function_error": percent(error.frfs, 4),
                "function_noise": percent(float(np.median(frfs.relative_sd[frfs.used])), 2),
                "solution_error": percent(functions.solution, 2),
            }
        return facts
