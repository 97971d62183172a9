"""What a diagnosis works on: the model of a case, its effects, its test and a reduced model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.stats import qmc

from fenics_joints.case import Case
from fenics_joints.case.dimensions import unfit
from fenics_joints.case.fingerprint import fingerprint
from fenics_joints.case.notes import OF_MODEL
from fenics_joints.diagnosis.effects.effect import Effect, Setting, Silent, by_preload
from fenics_joints.diagnosis.effects.joint import interfaces, parameter_tolerances
from fenics_joints.diagnosis.effects.library import (
    case_effects,
    case_nuisances,
    check_parameters,
    for_zones,
)
from fenics_joints.diagnosis.effects.samples import sample_ranges, sample_values
from fenics_joints.diagnosis.effects.sited import sited_effects
from fenics_joints.diagnosis.evidence.cells import prior_points
from fenics_joints.diagnosis.evidence.entries import FUNCTION, Neighbours
from fenics_joints.diagnosis.evidence.evidence import Evidence, evidence_of
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.merging import distinct
from fenics_joints.diagnosis.evidence.observations import Observation, case_masses
from fenics_joints.diagnosis.evidence.scales import ERRORS, WITH_FUNCTIONS
from fenics_joints.diagnosis.model.at_points import by_patches, measured_at_points
from fenics_joints.diagnosis.model.bonded import joint_errors
from fenics_joints.diagnosis.model.found_sites import found_sites
from fenics_joints.diagnosis.model.of_forms import FormCase
from fenics_joints.diagnosis.model.resolution import MeshErrors, mesh_errors
from fenics_joints.diagnosis.model.subject import Subject, mesh_ranks, subject_of, with_places
from fenics_joints.diagnosis.where.patches import PATCHES, Patches, patches, signatures
from fenics_joints.diagnosis.where.zone_sensitivity import with_compliant_joints
from fenics_joints.diagnosis.zones.sites import placed
from fenics_joints.errors import InputError
from fenics_joints.formatting import percent
from fenics_joints.machine.memory import give_back
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.gap import ALIKE, CONTRADICTED, UNLIKE, Pairing, partnered, skipped
from fenics_joints.modal.modes import Modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.matched import MatchedModes
from fenics_joints.reduction.prediction import ModalPrediction
from fenics_joints.reduction.surrogate import LACKING, tested_models

#: Share of a mode's energy that the reduced model may lack where it was sampled, over the square of
#: the discrepancy, and at most. Half of it bounds the error in frequency there: 3 % of a
#: discrepancy of 0.5 %, where small effects count, 15 % of one of 2.5 %. In the median over the
#: effects of the blind check's T the error is 0.06 % at a share of 0.5 %, of its box 0.01 % at 1 %.
#: [numerical: measured on T and box of benchmarks/blind]
_LACKING, _MOST_LACKING = 12.0, 1e-2
#: How models are sampled: a part of their key, so that one kept by another version is not used.
_SAMPLED = "every place where a joint can give way, and all rigid"
#: Stiffness of a joint as good as rigid, over its nominal one. [numerical: chosen]
_RIGID = 100.0
#: Places of each effect at which partners are sought. [numerical: chosen for time]
_TRIED = 48


@dataclass(repr=False, kw_only=True)
class Prepared(Subject):
    """A case ready to be diagnosed: its nominal model with a test.

    Attributes:
        comm: Communicator.
        data: The test.
        effects: The effects that the case can hold.
        silent: Those that its test cannot speak of.
        nuisances: What is uncertain in any case.
        scatter: Standard deviation of ln(preload / torque).
        evidence: The test as the inference sees it.
        surrogate: The reduced model; None until `reduce`.
        unresolved: Modes of the test that are no modes of the same mesh one degree higher.
        without_partner: Modes of the test that match none of the model's, nominal or with any
            effect at any sampled place of its prior; left out.
        left_out: Mask of modes without a partner and unresolved modes, (m,); if most of the test is
            unresolved, these modes stay. None without any.
        not_nominal: Mask of the modes that have a partner only with an effect, (m,): they are
            data, but have no part in the nominal model's gap.
        notes: Notes on the test's modes and on single numbers.
    """

    comm: MPI.Intracomm
    data: TestData
    effects: tuple[Effect, ...]
    silent: tuple[Silent, ...]
    nuisances: tuple[Effect, ...]
    scatter: float
    evidence: Evidence
    surrogate: MatchedModes | None = None
    unresolved: tuple[str, ...] = ()
    without_partner: tuple[str, ...] = ()
    left_out: np.ndarray | None = None
    not_nominal: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)
    _yielding: tuple[Modes, Pairing] | None = None

    def __repr__(self) -> str:
        return f"Prepared({self.case.title!r}, {len(self.effects)} effects, {self.evidence})"

    @property
    def ranks(self) -> MPI.Intracomm:
        """Ranks that share solutions out: all where each has the whole mesh, this one alone where
        they share it, or there is none."""
        apart = self.full.is_dense or self.full.comm.size > 1
        return MPI.COMM_SELF if apart else self.comm

    @property
    def forward(self) -> ModalPrediction:
        """Frequencies and shapes from the reduced model."""
        return self.surrogate.forward

    @property
    def condition(self) -> tuple[str, str]:
        """Name and unit of the conditions."""
        return self.data.condition_name, self.data.condition_unit

    def hypothesis(
        self, effects: Sequence[Effect], evidence: Evidence | None = None, **changes
    ) -> Hypothesis:
        """These effects, with what is uncertain in any case.

        Args:
            effects: The effects.
            evidence: The test's layout; that of the case's own by default.
            changes: Of the `Hypothesis`.
        """
        evidence = self.evidence if evidence is None else evidence
        known = {
            "scatter": self.scatter,
            "conditions": tuple(float(c) for c in evidence.conditions),
            "modes": tuple(self.data.mode_names),
            "damped": evidence.log_damping is not None,
            "driven": evidence.driven,
            "known": evidence.known,
            "as_row": evidence.as_row if any(evidence.known) else (),
        }
        return Hypothesis(tuple(effects), self.nuisances, **(known | changes))

    def nominal_log_f(self) -> np.ndarray:
        """ln f of the nominal model at each row of the test, (n, m); nan for modes that have no
        partner in it."""
        bare = Hypothesis((), known=self.evidence.known)
        rows = range(len(self.evidence.conditions))
        found = np.array(
            [self.forward(bare.values(np.zeros(0), 1.0, self.baseline, row))[0] for row in rows]
        )
        return found if self.not_nominal is None else np.where(self.not_nominal, np.nan, found)

    def reduce(self, progress: Progress, keep: Path | None = None) -> None:
        """Make the reduced model, or read it from a folder if it is kept there; and measure the
        error of the full one's mesh. Collective.

        Args:
            progress: Told after each sample.
            keep: Folder of the reduced models, named by a hash of all that makes them; None keeps
                nothing.
        """
        models, cache = tested_models(self.full), None
        if keep is not None and models.kept:
            cache = Cache(keep, self.fingerprint(), self.comm, side_by_side=True)
        self.surrogate = models.seen(
            self.full,
            self.baseline,
            sensors=self.data.sensors,
            n_test=len(self.data.mode_names),
            n_modes=self.case.diagnose.n_modes,
            shapes=self.data.shapes,
            by_order=True,
            samples=lambda: self.samples(self.case.diagnose.samples),
            travel=self.travel,
            keep=cache,
            progress=progress,
            still=self._unfit(),
            lacking=self._share,
            ranks=self.ranks,
        )
        if self.case.measured is not None:  # frequencies of a planned test are placeholders
            self._look_for_partners()
        if self.evidence.shapes is not None:
            self.evidence = replace(self.evidence, neighbours=self._neighbours())
        if self.case.diagnose.mesh_error:
            errors = mesh_errors(self.surrogate, self.baseline, progress, cache, self.ranks)
            if errors is not None:
                self.on_mesh(errors)
            elif getattr(self.full, "ties", None) is not None and self.full.degree > 1:
                self.notes.append(
                    f"{OF_MODEL}the discretisation error is not known: it cannot be computed for "
                    "parts whose meshes do not match"
                )
        self._take(measured_at_points(self, progress))
        give_back()
        self._share_joints()

    def _look_for_partners(self) -> None:
        """Leave out modes of the test that match none of the model's (`partnered`).

        An effect may give a mode the partner that the nominal model lacks, for example if a joint
        is much weaker than in the nominal model. So a mode is left out only if no effect gives it
        one, and all hypotheses are judged by the same data.

        Raises:
            InputError: If most modes have no partner: then the test is of another structure.
        """
        nominal = self._partnered(self.surrogate.nominal, self.surrogate.pairing)
        # The reduced model, which predicts, may have more modes to choose from.
        nominal &= self._partnered(*self.forward.solve(self.baseline))
        found, tried = nominal.copy(), self._partners_at()
        while not found.all() and (values := next(tried, None)) is not None:
            try:
                found |= self._partnered(*self.forward.solve(values), ALIKE)
            except (InputError, np.linalg.LinAlgError):
                continue  # too few modes there, or beyond the laws' limits
        names = np.array(self.data.mode_names)
        if np.sum(~found) > len(found) / 2:
            raise InputError(
                f"{self.case.path}: test: {', '.join(names[~found])}: expected modes that the "
                f"baseline model has, or the model with one of its effects; {UNLIKE}"
            )
        if not found.all():
            self.without_partner = tuple(names[~found].tolist())
            self._leave_out(~found)
            self.notes.append(
                f"{self._with_hz(~found)}: left out: no mode of the model matches, with or without "
                f"an effect; {UNLIKE}"
            )
        if (found & ~nominal).any():
            self.not_nominal = found & ~nominal
            self.notes.append(
                f"{self._with_hz(self.not_nominal)}: matched only by the model with an effect; "
                "fitted and held out, but not counted in the error of the baseline model"
            )

    def _partners_at(self) -> Iterator[dict[str, float]]:
        """Parameter values at which partners are sought that the nominal model lacks: all joints
        compliant, samples of every effect's prior, and effects with a place at many places."""
        yield with_compliant_joints(self.baseline, interfaces(self.zones, self.baseline))
        yield from self.samples(self.case.diagnose.samples)
        for effect in self.effects:
            if any(prior.even for prior in effect.priors):
                h = self.hypothesis((effect,))
                for own in prior_points(effect.priors, _TRIED):
                    z = h.at(own).clip(*h.limits.T)
                    yield h.values(z, self.data.conditions[0], self.baseline, 0)

    def _partnered(self, modes: Modes, pairing: Pairing, least: float = CONTRADICTED) -> np.ndarray:
        """Mask of the test's modes with a partner, (m,), at the condition of the shapes, or at any
        condition without shapes. See `partnered`."""
        test = self.data.as_it_is
        hz = test.frequencies_hz if test.shapes is None else test.frequencies_hz[[test.shape_row]]
        found = [
            partnered(pairing, modes.frequencies_hz, row, test.shapes, least=least) for row in hz
        ]
        there = np.isfinite(hz)
        silent = ~there.any(axis=0)
        return np.any(np.array(found) & (there | silent), axis=0)

    def _with_hz(self, which: np.ndarray) -> str:
        """Names of modes, each with its frequency."""
        log_f = np.ma.masked_invalid(self.evidence.log_f)
        hz = np.exp(log_f.mean(axis=0).filled(np.nan))
        return ", ".join(
            f"{self.data.mode_names[i]} ({hz[i]:.4g} Hz)"
            if np.isfinite(hz[i])
            else self.data.mode_names[i]
            for i in np.flatnonzero(which)
        )

    def _leave_out(self, lost: np.ndarray) -> None:
        """Remove modes, given by mask (m,), from all data."""
        self.left_out = lost if self.left_out is None else self.left_out | lost
        self.data = self.without_lost(self.data)
        self.evidence = self.evidence.without(np.broadcast_to(lost, self.evidence.shape))
        if self.surrogate is not None and self.data.shapes is not None:
            self.surrogate.untell(lost)

    def _take(self, measured: Sequence[Observation]) -> None:
        """Single numbers as data."""
        scales = self.evidence.scales
        functions = any(scalar.kind == FUNCTION for scalar in measured)
        if functions and scales is not None and scales.kind == ERRORS:
            scales = WITH_FUNCTIONS.expected(len(scales.values) + 1)
        scalars = (*self.evidence.scalars, *measured)
        self.evidence = replace(self.evidence, scalars=scalars, scales=scales)

    def _share_joints(self) -> None:
        """Add the error of bonded joints, which all modes share, to the evidence."""
        found = joint_errors(
            self.forward, self.evidence, self.baseline, interfaces(self.zones, self.baseline)
        )
        if found is not None:
            self.evidence = replace(self.evidence, joint_f=found[0], joint_shapes=found[1])

    def yielding(self) -> tuple[Modes, Pairing] | None:
        """The full model's modes with all joints compliant, and which of them the test saw; None
        without joints. Collective."""
        if not len(self.zones):
            return None
        if self._yielding is None:
            seen = self.surrogate
            values = with_compliant_joints(self.baseline, interfaces(self.zones, self.baseline))
            modes = seen.modes("yielding", values)
            self._yielding = modes, seen.forward.paired(modes)
        return self._yielding

    def place_unknown(self) -> None:
        """Let an unknown cause have a place. Collective; after `reduce`."""
        self.evidence = self.with_signatures(patches(self.cells, PATCHES, self.zones.shown))

    def find_sites(self) -> None:
        """Put the sites of what may be attached where the test speaks for it. Collective; after
        `reduce`."""
        if not len(self.sites.points):
            return
        sites = found_sites(self)
        self.surrogate.exchange(placed(sites))
        self.sites, mass = sites, self.full.total_mass(self.baseline)
        setting = Setting(self.case, self.data.as_it_is, self.zones, sites=sites, mass=mass)
        new = {e.key: e for e in sited_effects(setting) if isinstance(e, Effect)}
        self.effects = tuple(new.get(e.key, e) for e in self.effects)

    def with_signatures(self, split: Patches) -> Evidence:
        """The test with what a change in each of some patches would do. Collective; after
        `reduce`."""
        seen = self.surrogate
        found = signatures(
            self.cells,
            seen.nominal,
            seen.pairing,
            self.evidence,
            split,
            self.data.sensors,
            self.yielding(),
        )
        soft = with_compliant_joints(self.baseline, interfaces(self.zones, self.baseline))
        scalars = by_patches(self.evidence.scalars, self.cells, split, self.baseline, soft)
        return replace(self.evidence, signatures=found, scalars=scalars)

    def _unfit(self) -> list[str]:
        """Thicknesses and widths that the model cannot represent, which no effect changes."""
        sizes = [n for n in self.full.parameters if n.endswith((".thickness", ".width"))]
        return [name for name in sizes if unfit(self.dimensions, [name]) is not None]

    @property
    def _share(self) -> float:
        share = _LACKING * self.evidence.discrepancy**2
        return float(f"{np.clip(share, LACKING, _MOST_LACKING):.2g}")

    def fingerprint(self) -> str:
        """The key of a model that serves every test of the structure with this discrepancy, see
        `fenics_joints.case.fingerprint`. Collective."""
        more = sorted(self.full.parameters), self._share, _SAMPLED
        return fingerprint(self.case, self.full, None, *more)

    def on_mesh(self, errors: MeshErrors) -> None:
        """Take the mesh's errors off, and leave out modes that it does not resolve."""
        self.evidence, lost = self.evidence.on_mesh(*errors), np.isnan(errors.frequencies)
        if self.left_out is not None:
            lost &= ~self.left_out
        names = zip(self.data.mode_names, lost, strict=True)
        self.unresolved = tuple(name for name, gone in names if gone)
        if 0 < lost.sum() <= len(lost) / 2:
            self._leave_out(lost)

    def without_lost(self, data: TestData) -> TestData:
        """A test without the frequencies of modes that are left out."""
        if self.left_out is None:
            return data
        return replace(data, frequencies_hz=np.where(self.left_out, np.nan, data.frequencies_hz))

    def _neighbours(self) -> Neighbours:
        """The nominal model's modes, with which the test's modes may mix. Collective."""
        modes, first = self.surrogate.nominal, self.surrogate.nominal.n_rigid
        return Neighbours(
            np.log(modes.frequencies_hz[first:]),
            modes.at(self.data.sensors)[:, first:],
            self.surrogate.pairing.index - first,
        )

    def mesh_error(self) -> dict[str, float]:
        """How much too high the mesh makes each mode that it resolves, by name; empty where the
        mesh's error was not measured."""
        shift = self.evidence.mesh_shift
        if shift is None:
            return {}
        errors = zip(self.data.mode_names, np.expm1(shift).tolist(), strict=True)
        out = {*self.unresolved, *self.without_partner}
        return {name: error for name, error in errors if name not in out}

    def order_note(self) -> str:
        """That modes paired by order fit others better, as when a test lacks the lowest; or ""."""
        seen, names = self.surrogate, self.data.mode_names
        if seen.pairing.mac is not None:
            return ""
        own = np.exp(np.nanmean(self.evidence.off_mesh(self.evidence.log_f), axis=0))
        model = seen.nominal.frequencies_hz[seen.pairing.visible]
        count = skipped(own, model)
        if not count:
            return ""
        return (
            f"Modes are paired by their order: {names[0]}, {own[0]:.4g} Hz, with the model's "
            f"lowest visible mode, {model[0]:.4g} Hz, though {model[count]:.4g} Hz is nearer. "
            "If the test missed lower modes, give their frequencies too, or mode shapes."
        )

    def mesh_notes(self) -> list[str]:
        """A sentence where the mesh's own error is larger than the discrepancy of the case, and one
        where it does not resolve modes."""
        asked, errors, notes = self.evidence.discrepancy, self.mesh_error(), []
        if self.unresolved:
            so = (
                "left out (finer cells resolve more)"
                if len(self.unresolved) <= len(self.data.mode_names) / 2
                else "as they are most of the test they are kept, but the result is not reliable "
                "without finer cells"
            )
            notes.append(
                f"{OF_MODEL}the mesh does not resolve {', '.join(self.unresolved)}: the same mesh "
                f"one degree higher has no mode of that shape; {so}"
            )
        worst = max(errors, key=lambda name: abs(errors[name]), default=None)
        if worst is None or abs(errors[worst]) <= asked:
            return notes
        left = int(np.sum(self.evidence.mesh_error > asked))
        more = f", more than diagnose.discrepancy in {left} of {len(errors)} modes" if left else ""
        return [
            *notes,
            f"{OF_MODEL}the discretisation error is {percent(errors[worst])} in {worst}, by the "
            "same mesh one degree higher; it is subtracted from every frequency of the model, and "
            f"a part of it remains as an uncertainty{more}",
        ]

    def travel(self) -> dict[str, tuple[float, float]]:
        """Range, m, in which each point mass may move, by its name."""
        pointed = {**self.case.masses, **self.case.attached}
        moving = {
            name: section.shift()
            for name, section in pointed.items()
            if getattr(section, "travel", None) is not None
        }
        return {
            mass.name: moving[owner]
            for mass in self.full.masses
            if (owner := str(mass.travel).removesuffix(".travel")) in moving
        }

    def samples(self, count: int) -> list[dict[str, float]]:
        """The baseline, one with rigid joints, ends of some parameters' ranges, a Sobol sequence of
        the parameters that are no joint's, and every effect at places of its prior."""
        ranges, samples = self._ranges(), [self.baseline]
        joints = [f"{z.name}.{key}" for z in self.zones for key in z.interface.keys.values()]
        if joints:
            samples.append(self.baseline | {name: _RIGID * self.baseline[name] for name in joints})
        for name in ranges:
            if name.endswith(".thickness"):
                # A section turns by its thickness times the slope of the plate: modes of one
                # thickness cannot bend another without shear, and it would seem far too stiff.
                samples += [{**self.baseline, name: end} for end in ranges[name][:2]]
            if name.endswith(".travel"):
                # A mass at an edge bends it locally: a basis from inner places would miss that.
                mass = name.replace(".travel", ".mass")
                for end in (0.0, 1.0):
                    samples.append(self._sample(ranges, {name: end, mass: 1.0}))
        unit = qmc.Sobol(len(ranges), seed=1).random_base2(int(np.ceil(np.log2(count))))[:count]
        places = [dict(zip(ranges, row, strict=True)) for row in unit]
        samples += [self._sample(ranges, place) for place in places]
        conditions = self.evidence.conditions
        samples += sample_values(self.effects, self.baseline, conditions, count, 2, ranges)
        return samples + self._cutoffs()

    def to_span(self) -> tuple[list[dict[str, float]], dict[str, tuple[float, float]] | None]:
        """Samples and ranges of moving masses of one more reduced model; none of beams, which need
        none."""
        if self.full.is_dense:
            return [], None
        return self.samples(self.case.diagnose.samples), self.travel()

    def _ranges(self) -> dict[str, tuple[float, float, bool]]:
        """`sample_ranges` of what the model can represent."""
        ranges = sample_ranges(self.case)
        return {name: r for name, r in ranges.items() if unfit(self.dimensions, [name]) is None}

    def _cutoffs(self) -> list[dict[str, float]]:
        """The cut-off between every two zones of a contact once."""
        lost = next((e for e in self.effects if [p.name for p in e.priors] == ["cutoff"]), None)
        found = []
        for zone in self.zones.all[1:] if lost is not None and self.zones.by_pressure else ():
            values = dict(self.baseline)
            lost.apply(values, {"cutoff": zone.pressure[0]}, self.data.conditions[0])
            found.append(values)
        return found

    def _sample(self, ranges: dict, place: dict[str, float]) -> dict[str, float]:
        """Values at a place in the unit cube of the ranges; in their middle where not given."""
        values = dict(self.baseline)
        for name, (low, high, log) in ranges.items():
            u = place.get(name, 0.5)
            values[name] = float(low ** (1 - u) * high**u if log else low + u * (high - low))
        return values


def prepare(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    extra: Sequence[Effect] = (),
    data: TestData | None = None,
) -> Prepared:
    """The full model of a case in zones, with effects and evidence; `Prepared.reduce` comes next.

    Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        extra: Effects of the user's own, beside the library's.
        data: The test, if not the case's.

    Raises:
        InputError: If the case has no test, or names effects that do not exist.
    """
    data = case.diagnosed_test() if data is None else data
    case = case.diagnosed()
    subject = with_places(subject_of(case, mesh_ranks(case, comm), progress), data.sensors)
    case, zones = subject.case, subject.zones
    mass = subject.full.total_mass(subject.baseline)
    own = data.as_it_is
    by_forms = isinstance(case, FormCase)
    known = case.known_parameters if by_forms else {}
    unknown = case.unknown_parameters if by_forms else {}
    effects, silent = case_effects(
        Setting(case, own, zones, subject.dimensions, subject.sites, mass, unknown)
    )
    extra = [for_zones(effect, zones.by("joint")) for effect in extra]
    for name in {name for row in data.known for name in row} - subject.baseline.keys():
        raise InputError(
            f"{case.path}: test.known: {name!r}: expected one of the model's parameters: "
            f"{', '.join(subject.baseline)}"
        )
    for effect in (*effects, *extra):
        check_parameters(effect, subject.baseline, float(own.conditions[-1]), zones.by("joint"))
    effects = distinct((*effects, *extra), subject.baseline, own.conditions)
    return Prepared(
        **vars(subject),
        comm=comm,
        data=data,
        effects=effects,
        silent=silent,
        nuisances=case_nuisances(case, zones, subject.dimensions) + parameter_tolerances(known),
        scatter=case.diagnose.preload_scatter if by_preload(own) else 0.0,
        evidence=evidence_of(
            data,
            case.diagnose.discrepancy,
            case.diagnose.shape_discrepancy,
            case_masses(case, subject.full, subject.baseline),
        ),
    )
