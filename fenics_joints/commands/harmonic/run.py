"""The ``harmonic`` command: nonlinear responses at the force levels of a case."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from fenics_joints.case import Case
from fenics_joints.case.harmonic import Hysteretic, IdentifySection
from fenics_joints.commands.harmonic.document import harmonic_document
from fenics_joints.commands.harmonic.model import (
    FORCE,
    SENSOR,
    HarmonicModel,
    harmonic_model,
    level_power,
    load_name,
)
from fenics_joints.commands.harmonic.result import HarmonicReport, LevelFacts
from fenics_joints.commands.harmonic.stability import level_stability
from fenics_joints.commands.outcome import Outcome
from fenics_joints.files import writable_folder
from fenics_joints.harmonic import (
    HarmonicResult,
    Load,
    StaticBackbone,
    fitted_sliders,
    slider_ranges,
    solve_backbone,
    solve_harmonic,
    solve_static_backbone,
)
from fenics_joints.harmonic.identify import IdentificationResult, identify, predict
from fenics_joints.harmonic.kept import kept_model
from fenics_joints.harmonic.measured_mode import read_loops
from fenics_joints.measurements.curves import MeasuredCurves
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress

#: The backbone reaches down to this share of the smallest response at resonance, and up to this
#: multiple of the largest; chosen, to show the mode beyond the levels too.
_BELOW, _ABOVE = 0.1, 1.2
#: Most times that sliders are moved to the amplitudes of the responses, which change with them;
#: chosen. A note names the laws whose sliders are still off after that.
_PLACED = 3
#: Static steps of half a hysteresis loop of a contact, whose pressure changes; chosen.
_LOOP_STEPS = 24


#: Stages of the command, of which some are for some cases only.
_BUILD, _IDENTIFY = "build and reduce the model", "identify the joint's parameters"
_RESPOND, _BACKBONE = "responses at all levels", "the mode over its amplitude"
_STABILITY = "stability of the responses"


def _stages(case: Case) -> list[str]:
    h = case.harmonic
    there = {
        _BUILD: True,
        _IDENTIFY: h.identify is not None,
        _RESPOND: True,
        _BACKBONE: h.backbone or h.quasi_static != "no",
        _STABILITY: h.bifurcations != "no",
    }
    return [name for name, wanted in there.items() if wanted]


def run_harmonic(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, branches: Path | None = None
) -> Outcome[HarmonicReport]:
    """Responses at all levels, and the backbone if the case wants it. Collective.

    Args:
        case: The case.
        comm: Communicator; the joints' points are shared out over its ranks.
        progress: Told what is being done, point by point.
        branches: Folder in which every branch is saved as it grows and from which it is resumed,
            with the reduced model in whose basis the branches are.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    if branches is not None:
        on_root(comm, lambda: writable_folder(branches, "--branches"))
    if case.harmonic is not None:
        progress.outline(_stages(case))
        progress.stage(_BUILD)
    built = harmonic_model(case, comm, progress)
    if branches is not None:
        band = case.harmonic.band
        built = replace(built, model=kept_model(built.model, branches, band, comm, progress))
    # The matrices are small: more threads only make it slower.
    with threadpool_limits(1):
        found = _solved(case, built, comm, progress, branches)
    return Outcome(found, harmonic_document(found))


def _solved(case: Case, built: HarmonicModel, comm, progress, branches) -> HarmonicReport:
    h, curves = case.harmonic, case.curves()
    started = time.perf_counter()
    equations = {"harmonics": h.harmonics, "samples": h.samples, "sensor": SENSOR, "comm": comm}
    progress.stage(_IDENTIFY)
    identified = _identify(case, built, equations, progress)
    if identified:
        built = replace(built, model=identified[-1].model)
    common = {**equations, "progress": progress}
    progress.stage(_RESPOND)
    built, responses = _responses(case, built, branches, common)
    facts = tuple(_facts(r, h.response, curves) for r in responses)
    reach = [f.peak_displacement_m for f in facts]
    span, near = (_BELOW * min(reach), _ABOVE * max(reach)), float(built.frequencies_hz[built.mode])
    backbone, predictions = None, ()
    progress.stage(_BACKBONE)
    if h.backbone:
        kept = _kept(branches, "backbone")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the report says where it ends
            backbone = solve_backbone(built.model, span, near=near, **common, **kept)
    static = _static_backbone(case, built, span, near, progress)
    if curves is not None:
        progress.step("responses at the measured frequencies", len(curves.levels))
        points = h.identify.points if h.identify else IdentifySection.model_fields["points"].default
        predictions = predict(built.model, curves, force=FORCE, points=points, **equations)
    progress.stage(_STABILITY)
    stability = level_stability(h.bifurcations, responses, progress)
    seconds = time.perf_counter() - started
    return HarmonicReport(
        case,
        built,
        responses,
        facts,
        backbone,
        curves,
        seconds,
        comm.rank,
        identified,
        predictions,
        static,
        stability,
    )


def _responses(
    case: Case, built: HarmonicModel, branches: Path | None, common: dict
) -> tuple[HarmonicModel, tuple[HarmonicResult, ...]]:
    """The model with the sliders that were used, and its response at every level.

    Sliders of a law represent a range of amplitudes. Where the case does not give that range, and
    their dissipation is off in the responses at the highest and the lowest level, they are moved to
    the amplitudes of these responses first.
    """
    h, free, levels = case.harmonic, _free_sliders(case), sorted(case.harmonic.levels)
    solved: dict[float, HarmonicResult] = {}

    def response(level: float, name: str) -> HarmonicResult:
        return solve_harmonic(
            built.model,
            FORCE,
            level,
            h.band,
            power=level_power(case),
            more=_more(case, level),
            **common,
            **_kept(branches, f"{level:g}{name}"),
        )

    trial, name = 0, "N"
    while free and trial < _PLACED:
        solved = {level: response(level, name) for level in dict.fromkeys([levels[-1], levels[0]])}
        off = {
            found.interface for one in solved.values() for found in slider_ranges(one) if found.note
        }
        if not off & free:
            break
        trial, name = trial + 1, f"N-sliders{trial + 1}"
        common["progress"].step(
            f"the sliders of {', '.join(sorted(off & free))} do not cover the responses: moving "
            f"them, and solving again ({trial} of at most {_PLACED} times)"
        )
        built = replace(built, model=fitted_sliders(*solved.values(), interfaces=free))
        solved = {}
    return built, tuple(solved.get(level) or response(level, name) for level in levels)


def _free_sliders(case: Case) -> set[str]:
    """Laws whose sliders may be moved: without ``amplitudes``; none if the case identifies any."""
    if case.harmonic.identify is not None:
        return set()
    return {
        name
        for name, section in case.nonlinear.items()
        if isinstance(section, Hysteretic) and section.amplitudes is None
    }


def _more(case: Case, level: float) -> list[Load]:
    """Loads that act beside the main one at a level."""
    return [
        Load(load_name(i), load.share * level, load.harmonic, float(np.radians(load.phase_degrees)))
        for i, load in enumerate(case.harmonic.loads)
    ]


def _static_backbone(
    case: Case, built: HarmonicModel, span: tuple[float, float], near: float, progress: Progress
) -> StaticBackbone | None:
    """Frequency and damping over amplitude from static loads, if the case asks. Collective."""
    kind = case.harmonic.quasi_static
    if kind == "no":
        return None
    progress.step(f"quasi-static modal analysis of the {kind} model")
    coupled = any(points.law.coupled for points in built.model.interfaces)
    found = solve_static_backbone(
        built.full or built.model,
        span,
        near=near,
        sensor=SENSOR,
        per_decade=10,
        loop_steps=_LOOP_STEPS if coupled and built.full is None else 0,
    )
    if built.full is None:
        return found
    # The full model has no viscous damping: add that of the mode in the reduced one.
    damping = case.harmonic.damping
    viscous = damping[min(built.mode, len(damping) - 1)] * near / found.frequencies_hz
    return replace(found, damping_ratios=found.damping_ratios + viscous)


def _identify(
    case: Case, built: HarmonicModel, equations: dict, progress: Progress
) -> tuple[IdentificationResult, ...]:
    """Parameters of the laws, identified by each method that the case asks for."""
    wanted = case.harmonic.identify
    if wanted is None:
        return ()
    loops, backbone = (), None
    if wanted.loops is not None:
        loops = read_loops(case.folder / wanted.loops, case.harmonic.response)
    if wanted.by_amplitude:
        there = case.backbones()
        backbone = there[wanted.mode or next(iter(there))]
    curves, found = None if wanted.level is None else case.curves(), []
    for method in wanted.methods:
        progress.step(f"identifying {', '.join(wanted.parameters)}, {method}")
        found.append(
            identify(
                built.model.with_parameters,
                curves,
                wanted.level,
                wanted.values(case.nonlinear),
                method=method,
                points=wanted.points,
                noise=wanted.noise,
                loops=loops,
                backbone=backbone,
                rest=wanted.rest,
                rest_damping=wanted.rest_damping,
                force=FORCE,
                **equations,
            )
        )
    return tuple(found)


def _kept(folder: Path | None, name: str) -> dict:
    """Arguments of the solvers that save a branch and resume it; none without a folder."""
    if folder is None:
        return {}
    return {"checkpoint": folder / f"{name}.h5", "resume": True}


def _facts(r: HarmonicResult, kind: str, curves: MeasuredCurves | None) -> LevelFacts:
    """Facts on the peak of a response, beside the measured one of the same level."""
    peak, level = r.peak, float(r.force_amplitudes[0])
    i = peak.index
    turns = np.diff(np.sign(np.diff(r.frequencies_hz)))
    measured_hz = measured = None
    if curves is not None and level in curves.levels:
        hz, amplitude = curves.at(level)
        top = int(np.argmax(amplitude))
        measured_hz, measured = float(hz[top]), float(amplitude[top])
    return LevelFacts(
        level,
        peak.frequency_hz,
        float(r.amplitude(SENSOR, kind)[i]),
        peak.amplitude,
        _damping(r, i),
        {name: float(e[0]) for name, e in r.dissipation([i]).items()},
        int(np.sum(turns != 0)),
        r.closure(i),
        measured_hz,
        measured,
    )


def _damping(r: HarmonicResult, i: int) -> float:
    """Damping ratio: work per cycle over 4 pi times the kinetic energy of the first harmonic."""
    cosine, sine = r.coefficients[i, :, 1], r.coefficients[i, :, 2]
    M = r.model.M
    kinetic = 0.5 * r.omegas[i] ** 2 * (cosine @ M @ cosine + sine @ M @ sine)
    return float(r.force_work()[i] / (4 * np.pi * kinetic))
