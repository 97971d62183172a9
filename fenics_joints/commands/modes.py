"""The ``modes`` command: natural frequencies and modes of a case's nominal model, beside a test."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten

import numpy as np
from mpi4py import MPI

import fenics_joints
from fenics_joints.case import Case, build_preload, build_structure, labelled, test_notes
from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.outcome import Outcome
from fenics_joints.errors import InputError
from fenics_joints.files import plain, shown_path
from fenics_joints.formatting import MISSING, extents, hertz, length_mm, percent
from fenics_joints.measurements.gap import UNLIKE, VISIBLE, mac, pair_modes, partnered, rms
from fenics_joints.meshes import Ring
from fenics_joints.modal.modes import Modes, check_meshed, solve_modes, write_shapes
from fenics_joints.preload import LinearJoint, solve_preload, status_conditions, stuck_conditions
from fenics_joints.progress import Progress
from fenics_joints.report import document as doc
from fenics_joints.report.mesh_pictures import (
    MeasuredModes,
    Shape,
    largest_axis,
    sensor_shapes,
    shapes_view,
)
from fenics_joints.report.tables import mac_table
from fenics_joints.structure.grids import check_fields_path
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

#: Modes of the model in the view, at most: those of the test first. Chosen for the page's size.
_VIEWED = 16
#: MAC by which another mode is clearly more like a shape. Chosen: only a note depends on it.
_CLEARLY = 0.2
#: Rows of each table on the terminal, so that the document fits on a screen.
_MODES, _RINGS, _PAIRS = 20, 12, 20


@dataclass(frozen=True, eq=False)
class ComparedModes:
    """Pairs of a test's and a model's modes, m of them.

    Attributes:
        condition: Name, value and unit of where the test was, such as ``torque``, 20, ``N·m``;
            None if it has one condition without a unit.
        names: Names of the test's modes.
        test_hz: Their frequencies, Hz, shape (m,); nan where not measured.
        model_hz: Those of the model's modes, Hz, shape (m,).
        index: Which modes of the model these are, shape (m,).
        partnered: Mask of the test's modes that have a partner, (m,); a mode that matches none of
            the model's has a row, but no partner (`measurements.gap.partnered`).
        candidates: Modes of the model that the test could see, shape (k,).
        matrix: MAC of each measured shape with each candidate, shape (m, k); None without shapes.
        sensors: Where and in which direction shapes were measured, n of them; or None.
        test_shapes: Measured shapes, (n, m), nan where a sensor was missing; or None.
        model_shapes: The partners' shapes in the scale of the measured ones, (n, m); or None.
    """

    condition: tuple[str, float, str] | None
    names: tuple[str, ...]
    test_hz: np.ndarray
    model_hz: np.ndarray
    index: np.ndarray
    partnered: np.ndarray
    candidates: np.ndarray
    matrix: np.ndarray | None = None
    sensors: Sensors | None = None
    test_shapes: np.ndarray | None = None
    model_shapes: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"ComparedModes({int(self.partnered.sum())} pairs of modes, {100 * self.rms:.3g} %)"

    @property
    def relative(self) -> np.ndarray:
        """Model over test minus one, shape (m,); nan where not measured, or without a partner."""
        return np.where(self.partnered, self.model_hz / self.test_hz - 1.0, np.nan)

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors; nan without a pair."""
        return rms(self.relative) if np.isfinite(self.relative).any() else float("nan")

    @property
    def alone(self) -> tuple[str, ...]:
        """Names of the test's modes without a partner."""
        return tuple(n for n, has in zip(self.names, self.partnered, strict=True) if not has)

    @property
    def mac(self) -> np.ndarray | None:
        """MAC of each pair, shape (m,); None without measured shapes."""
        if self.matrix is None:
            return None
        columns = [int(np.flatnonzero(self.candidates == i)[0]) for i in self.index]
        return self.matrix[np.arange(len(columns)), columns]

    def doubtful(self) -> list[str]:
        """A sentence for each pair of which another mode of the model has a clearly higher MAC."""
        if self.matrix is None:
            return []
        best = np.argmax(self.matrix, axis=1)
        return [
            f"{OF_MODEL}{name} is paired with mode {i + 1} at a MAC of {mac:.2f}, although mode "
            f"{self.candidates[k] + 1} has {row[k]:.2f}: another mode of the test has that one"
            for name, i, mac, k, row, has in zip(
                self.names, self.index, self.mac, best, self.matrix, self.partnered, strict=True
            )
            if has and row[k] > mac + _CLEARLY
        ]

    def pairs(self) -> list[dict[str, object]]:
        """A record for each of the test's modes: name, test_hz, mode (from 1), model_hz,
        error_percent, mac; None without a partner."""
        rows = doc.records(
            name=self.names,
            test_hz=self.test_hz,
            mode=self.index + 1,
            model_hz=self.model_hz,
            error_percent=100 * self.relative,
            mac=np.full(len(self.names), np.nan) if self.mac is None else self.mac,
        )
        for row, has in zip(rows, self.partnered, strict=True):
            if not has:
                row |= dict.fromkeys(("mode", "model_hz", "error_percent", "mac"))
        return rows

    def to_json(self) -> dict[str, object]:
        """Keys: condition, `pairs`, gap (root mean square error of the pairs, relative),
        without_partner (names), and mac_matrix with its columns, modes from 1."""
        return plain(
            {
                "condition": self.condition,
                "pairs": self.pairs(),
                "gap": self.rms,
                "without_partner": self.alone,
                "mac_matrix": self.matrix,
                "mac_modes": self.candidates + 1,
            }
        )


def compare(case: Case, modes: Modes) -> ComparedModes | str | None:
    """A model's modes beside the case's test; why not, in words; or None without a test.

    With measured shapes modes are paired by MAC, else in order. Collective.
    """
    data = case.measured
    if data is None or not np.isfinite(data.frequencies_hz).any():
        return None
    if data.shapes is not None:
        row = data.shape_row
    else:
        row = len(data) - 1 if case.row() is None else case.row()
    try:
        pairing = pair_modes(modes, len(data.mode_names), data.sensors, reference=data.shapes)
    except InputError as error:
        return f"not compared with the test: {error}"
    has = partnered(pairing, modes.frequencies_hz, data.frequencies_hz[row], data.shapes)
    has_condition = len(data) > 1 or bool(data.condition_unit)
    condition = (data.condition_name, float(data.conditions[row]), data.condition_unit)
    more = {}
    if data.shapes is not None:
        seen = modes.at(data.sensors)[:, pairing.visible]
        more = {
            "matrix": mac(data.shapes, seen),
            "sensors": data.sensors,
            "test_shapes": data.shapes,
            "model_shapes": _scaled(pairing.shapes, data.shapes),
        }
    return ComparedModes(
        condition if has_condition else None,
        tuple(data.mode_names),
        data.frequencies_hz[row],
        modes.frequencies_hz[pairing.index],
        pairing.index,
        has,
        pairing.visible,
        **more,
    )


def _scaled(model: np.ndarray, test: np.ndarray) -> np.ndarray:
    """The model's shapes times the factor that brings each nearest to the test's (n, m)."""
    known = np.where(np.isnan(test), 0.0, test)
    there = np.where(np.isnan(test), 0.0, model)
    return model * np.sum(known * there, axis=0) / np.sum(there**2, axis=0)


@dataclass(frozen=True, eq=False)
class ModeList:
    """Modes of a case.

    Attributes:
        case: The case.
        modes: The modes.
        visibility: How much of each mode the test's sensors see, shape (n,), see
            `Modes.visibility`; None if the case does not say what the test saw.
        size_m: Extents along the axes, m, shape (gdim,); empty if not measured.
        rings: The bolts' rings ``ring_1``, ... of the mesh, those that are flat layers.
        notes: Remarks on the test's data, see `fenics_joints.case.test_notes`.
        beside: The modes beside those of the test; None if the case has no data.
        written: Files of the shapes for ParaView.
    """

    case: Case
    modes: Modes
    visibility: np.ndarray | None
    size_m: np.ndarray = field(default_factory=lambda: np.empty(0))
    rings: tuple[Ring, ...] = ()
    notes: tuple[str, ...] = ()
    beside: ComparedModes | None = None
    written: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        highest = f"to {self.frequencies_hz[-1]:.5g} Hz" if len(self.modes) else "none"
        return f"ModeList({shorten(self.case.name, 60)!r}, {len(self.modes)} modes, {highest})"

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Natural frequencies, Hz, shape (n,); 0 for rigid-body modes, whose value is round-off."""
        frequencies = self.modes.frequencies_hz.copy()
        frequencies[: self.modes.n_rigid] = 0.0
        return frequencies

    @property
    def visible(self) -> np.ndarray | None:
        """Mask of the modes that the test could see, (n,), with all partners of its modes and
        without rigid-body modes."""
        if self.visibility is None:
            return None
        seen = (self.visibility >= VISIBLE) & (np.arange(len(self.modes)) >= self.modes.n_rigid)
        if self.beside is not None:
            seen[self.beside.index[self.beside.partnered]] = True
        return seen

    def to_json(self) -> dict[str, object]:
        """The content of ``--json``.

        Keys: ``version``, ``title``; ``dofs``, the number of degrees of freedom;
        ``frequencies_hz``, ascending, 0 for rigid-body modes; ``rigid_body_modes``, their number;
        ``visible``, whether the test could see each mode, or null if the case does not say;
        ``size_m``, extents of the mesh; ``rings``, for each bolt's ring its name, centre_m,
        thickness_m, r_nei_m, r_wai_m, and parts, those below and above; ``notes``, sentences on the
        test's data; ``test``, the modes beside the test's, see `ComparedModes.to_json`, or null.
        """
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.case.title,
                "dofs": self.modes.model.n_dofs,
                "frequencies_hz": self.frequencies_hz,
                "rigid_body_modes": self.modes.n_rigid,
                "visible": self.visible,
                "size_m": self.size_m,
                "rings": self.ring_records(),
                "notes": self.notes,
                "test": None if self.beside is None else self.beside.to_json(),
            }
        )

    def ring_records(self) -> list[dict[str, object]]:
        """The bolts' rings as they are in the mesh."""
        return [
            {
                "name": ring.name,
                "centre_m": ring.centre.tolist(),
                "thickness_m": ring.thickness,
                "r_nei_m": ring.r_nei,
                "r_wai_m": ring.r_wai,
                "parts": [*ring.lower, *ring.upper],
            }
            for ring in self.rings
        ]

    def kinds(self) -> list[str]:
        """Kind of each mode, in words."""
        n_rigid, visible = self.modes.n_rigid, self.visible
        if visible is None:
            elastic = ["elastic"] * (len(self.modes) - n_rigid)
        else:
            elastic = [f"{'' if s else 'not '}visible to the test" for s in visible[n_rigid:]]
        return ["rigid body"] * n_rigid + elastic


def run_modes(
    case: Case,
    comm: MPI.Intracomm,
    progress: Progress,
    *,
    n_modes: int | None = None,
    state: str = "stuck",
    method: str = "direct",
    draw_all: bool = False,
    fields: Path | None = None,
) -> Outcome[ModeList]:
    """Modes of a case's nominal model. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        n_modes: Number of modes, rigid-body modes included; the case's ``diagnose.n_modes`` by
            default.
        state: What contacts are: ``"stuck"``, obstacles where the preload presses on them, or as
            the ``"preload"`` leaves them.
        method: ``"direct"`` or ``"iterative"``, see `solve_modes`; contacts need the direct one.
        draw_all: Whether the page draws all modes, also those that the test does not see.
        fields: A file to write all elastic modes to, ``.bp`` or ``.xdmf``.

    Raises:
        JointsError: If the case, the mesh or the solution fails.
    """
    n_modes = case.diagnose.n_modes if n_modes is None else n_modes
    if fields is not None:
        check_fields_path(comm, fields)
    progress.step("building the model")
    touches = bool(case.contacts or case.obstacles)
    if state != "stuck" and not touches:
        raise InputError(
            f"contacts = {state!r}: expected sections [contacts.NAME] or [obstacles.NAME] in the "
            "case"
        )
    if touches:
        model = _preloaded(case, comm, progress, state)
    else:
        model = build_structure(case, comm)
    if fields is not None:
        check_meshed(model, fields)
    progress.step(f"solving {n_modes} modes of {model.n_dofs} degrees of freedom")
    modes = solve_modes(model, n_modes=n_modes, method=method)
    sensors = case.sensors()
    visibility = None if sensors is None else modes.visibility(sensors)
    notes, beside = (*test_notes(case, model), *_unused(case, state)), compare(case, modes)
    if isinstance(beside, str):
        notes, beside = (*notes, beside), None
    elif beside is not None and beside.alone:
        why = "frequency" if beside.mac is None else "shape"
        note = f"left out of the error: no mode of the model has this {why}; {UNLIKE}"
        notes = (*notes, f"{', '.join(beside.alone)}: {note}")
    written = ()
    if fields is not None:
        progress.step(f"writing {fields}")
        written = tuple(write_shapes(modes, fields))
    notes = (*notes, *(beside.doubtful() if isinstance(beside, ComparedModes) else ()))
    found = ModeList(case, modes, visibility, model.size_m, model.rings(), notes, beside, written)
    return Outcome(found, modes_document(found, None if draw_all else 6))


def _preloaded(case: Case, comm: MPI.Intracomm, progress: Progress, state: str) -> LinearJoint:
    """The bodies of a case with linear contacts and its bolts."""
    if state not in ("stuck", "preload"):
        raise InputError(f"contacts = {state!r}: expected 'stuck' or 'preload'.")
    stuck = state == "stuck" and not case.obstacles
    model = build_preload(case, comm, at_rest=stuck)
    if stuck:
        return LinearJoint(model)
    progress.step("contact under preload")
    conditions = stuck_conditions if state == "stuck" else status_conditions
    return LinearJoint(model, conditions(solve_preload(model)))


def _unused(case: Case, state: str) -> list[str]:
    """A sentence on loads and displacements without effect while contacts are stuck everywhere."""
    if state != "stuck" or case.obstacles or not (case.loads or case.displacements):
        return []
    given = " and ".join(f"[{t}]" for t in ("loads", "displacements") if getattr(case, t))
    return [
        f"{OF_MODEL}contacts are stuck everywhere and {given} have no effect, except that "
        "displaced faces are held; --contacts preload takes displacements and forces into account"
    ]


# -- the document ----------------------------------------------------------------------------------


def modes_document(result: ModeList, n_shapes: int | None = 6) -> doc.Document:
    """The document of the modes of a case.

    Args:
        result: The modes.
        n_shapes: How many shapes the page shows: partners of the test's modes, then the lowest that
            the test could see, or the lowest elastic ones if the case does not say what it saw;
            None for all elastic modes.
    """
    n_rigid, visible, kinds = result.modes.n_rigid, result.visible, result.kinds()
    keys: list[tuple[str, object, str]] = []
    if result.beside is not None and result.beside.partnered.any():
        keys.append(("error", percent(result.beside.rms), "RMS error against the test"))
    keys.append(("dofs", result.modes.model.n_dofs, "degrees of freedom"))
    if len(result.size_m):
        keys.append(("size", extents(result.size_m), "extents of the mesh"))
    keys += [
        ("rigid", n_rigid, "rigid-body modes"),
        ("elastic", len(kinds) - n_rigid, "elastic modes"),
    ]
    if visible is not None:
        keys.append(("visible", int(np.sum(visible)), "of them visible to the test"))
    if result.rings:
        keys.append(("rings", len(result.rings), "bolts' rings"))
    modes = doc.Table.of(
        doc.records(mode=range(1, len(kinds) + 1), frequency_hz=result.frequencies_hz, kind=kinds),
        "mode: >mode | frequency_hz: >frequency, Hz | kind: type",
        style=lambda row: "dim" if row["kind"] in ("rigid body", "not visible to the test") else "",
        caption="Modes visible to the test move its sensors in their directions of measurement"
        if visible is not None
        else "In ascending order",
        id="modes",
        most=_MODES,
    )
    return doc.Document(
        result.case.name,
        "modes of the baseline model",
        "Natural frequencies and mode shapes of the baseline model",
        [
            doc.Keys(keys),
            doc.Remarks("Notes", [labelled(note) for note in result.notes]),
            *([] if result.beside is None else _pairs(result.beside)),
            doc.OnPage(lambda: _shapes(result, n_shapes)),
            doc.Heading("All modes"),
            modes,
            *([doc.Heading("Bolts' rings"), _rings(result)] if result.rings else []),
            doc.OnTerminal([doc.Text(f"wrote {shown_path(path)}") for path in result.written]),
        ],
        result.to_json,
    )


def _rings(result: ModeList) -> doc.Table:
    """The bolts' rings as they are in the mesh."""
    rows = [
        {
            **row,
            "centre_mm": ", ".join(length_mm(c, max(result.size_m)) for c in row["centre_m"]),
            "thickness_mm": 1e3 * row["thickness_m"],
            "radii_mm": f"{1e3 * row['r_nei_m']:.3g} to {1e3 * row['r_wai_m']:.3g}",
            "between": ", ".join(row["parts"]),
        }
        for row in result.ring_records()
    ]
    return doc.Table.of(
        rows,
        "name: ring | centre_mm: >centre, mm | thickness_mm: >thick, mm | radii_mm: >radii, mm | "
        "between: between",
        caption="As they are in the mesh",
        id="ring-list",
        most=_RINGS,
    )


def _written(key: str, value) -> str:
    """A number of a pair of modes by its key."""
    if key == "mac":
        return MISSING if value is None else f"{value:.3f}"
    return "none" if key == "mode" and value is None else doc.by_unit(key, value)


def _pairs(beside: ComparedModes) -> list:
    """The test's modes with their partners."""
    at, error, rows = "", "no pair", beside.pairs()
    if beside.condition is not None:
        name, value, unit = beside.condition
        at = f" at {name} {value:g} {unit}".rstrip()
    if beside.partnered.any():
        error = f"error {percent(beside.rms)} (root mean square)"
    columns = "name: test | test_hz: >Hz | mode: >mode | model_hz: >model, Hz | "
    columns += "error_percent: >error" + " | mac: >MAC" * (beside.mac is not None)
    table = doc.Table.of(rows, columns, write=_written, id="pairs", most=_PAIRS)
    blocks = [
        doc.Heading("Comparison with the test", "test"),
        doc.Text(f"Test{at}: {error}.", "bold"),
        table,
    ]
    return blocks


def _shapes(result: ModeList, n_shapes: int | None) -> list | None:
    """The MAC, and shapes of some modes with the measured ones. Collective."""
    modes, visible, beside = result.modes, result.visible, result.beside
    elastic = np.arange(len(modes)) >= modes.n_rigid
    partners = {}
    if beside is not None:
        partners = {int(beside.index[j]): int(j) for j in np.flatnonzero(beside.partnered)}
    shown = elastic if visible is None or n_shapes is None else visible
    order = list(dict.fromkeys([*partners, *np.flatnonzero(shown).tolist()]))
    stills = sorted(order[:n_shapes])
    viewed = stills + sorted(order[len(stills) : _VIEWED])
    vertices, motions = modes.model.corner_motion([modes.vector(i) for i in viewed])
    sensors, parts = result.case.sensors(), _parts(modes.model)
    measured = beside is not None and beside.sensors is not None
    measured = measured and beside.sensors.points.shape[1] == 3
    seen = modes.at(beside.sensors) if measured else None
    blocks: list = []
    if beside is not None and beside.matrix is not None:
        caption = "Modal assurance criterion: modes of the test by visible modes of the model"
        columns, drawn = (beside.candidates + 1).tolist(), [i + 1 for i in viewed if measured]
        blocks.append(mac_table(beside.matrix, beside.names, columns, caption, "mac", drawn))
    if not len(vertices):
        return None
    if not viewed:
        return blocks
    shapes = [
        Shape(
            f"mode {i + 1}, {hertz(float(result.frequencies_hz[i]))} Hz",
            motion,
            _mean_direction(sensors, motion),
            None if seen is None else seen[:, i],
            partners.get(i),
        )
        for i, motion in zip(viewed, motions, strict=True)
    ]
    along = "axis of the largest motion" if sensors is None else "test's direction of measurement"
    more: list = [
        doc.Text(
            f"Colour: motion along the {along}, red one way, blue the other, white none. Motion is "
            "enlarged; its scale is arbitrary.",
            "note",
        )
    ]
    tests = None
    if measured:
        tests = MeasuredModes(beside.names, beside.sensors, beside.test_shapes)
        more += _measured_stills(result, vertices, [i for i in stills if i in partners], partners)
    view = shapes_view(vertices, shapes, len(stills), more, measured=tests, parts=parts)
    return [*blocks, doc.Heading("Mode shapes"), view]


def _measured_stills(
    result: ModeList, vertices: np.ndarray, wanted: list[int], partners: dict[int, int]
) -> list:
    """Pictures of measured shapes beside the model's."""
    beside, own = result.beside, result.case.shapes()
    lines = () if own is None else own.lines
    pairs = []
    for i in wanted:
        j = partners[i]
        test, model = beside.test_shapes[:, j], beside.model_shapes[:, j]
        alt = f"Arrows of {beside.names[j]} of the test and of mode {i + 1} at the sensors."
        drawn = sensor_shapes(vertices, beside.sensors, test, model, f"pair{i}", alt, lines)
        caption = f"{beside.names[j]} beside mode {i + 1}, MAC {beside.mac[j]:.3f}"
        pairs.append(doc.Figure(drawn, caption))
    if not pairs:
        return []
    words = (
        "Arrows at the sensors: thin and blue the test, thick and orange the model, scaled to fit "
        "best."
    )
    heading = doc.Heading("Measured and computed shapes", level=3)
    return [heading, doc.Beside("shapes", pairs), doc.Text(words, "note")]


def _parts(model) -> tuple[list[str], np.ndarray] | None:
    """Names of a structure's parts, and the part of each cell as of `corner_motion`. Collective.

    None on ranks other than 0, and where the model has no cells or one part.
    """
    structure = model.structure if isinstance(model, LinearJoint) else model
    if not isinstance(structure, Structure):
        return None
    number = structure.cell_regions()
    if number is None:
        return None
    there, level = np.unique(number, return_inverse=True)
    names = [structure.regions[k].name if k >= 0 else "rest" for k in there]
    return (names, level) if len(names) > 1 else None


def _mean_direction(sensors: Sensors | None, motion: np.ndarray) -> np.ndarray:
    """Direction along which the sensors measure; the axis of the largest motion without any."""
    if sensors is not None:
        way = np.zeros(3)
        mean = np.mean(sensors.directions, axis=0)
        way[: len(mean)] = mean
        if np.linalg.norm(way) > 0.5:
            return np.round(way / np.linalg.norm(way), 6)
    return largest_axis(motion)
