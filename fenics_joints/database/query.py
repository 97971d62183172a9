"""The answer to an engineer's question: torque, bolt and plates to the joint's parameters.

As in Machines 2022, section 3.2: the tightening force follows from torque and bolt, contact radius
and mean pressure from Kriging over force and thickness. E, nu and h are never interpolated: the
nearest joint for which they were identified is given, with what differs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from fenics_joints import __version__
from fenics_joints.database.joints import UNITS, JointRow
from fenics_joints.database.kriging import Interpolation, Kriging
from fenics_joints.database.store import Store
from fenics_joints.errors import InputError, real
from fenics_joints.files import plain
from fenics_joints.formatting import MISSING, interval, number, prefixed, quantity
from fenics_joints.preload import Thread, motosh_force, nut_factor_force, thread

#: Conditions closer than this are the same.
_SAME = 0.01
#: A condition of which nothing is known counts as if it differed by a factor of 2.
_UNKNOWN = math.log(2)


@dataclass(frozen=True)
class TorqueToForce:
    """How a torque becomes a bolt force.

    Attributes:
        K: Nut factor of T = K d F; used when there is no friction.
        friction: Coefficient of friction of Motosh's equation, in the thread; None for T = K d F.
        friction_head: The same under the head; that of the thread by default.
    """

    K: float = 0.2
    friction: float | None = None
    friction_head: float | None = None

    def __post_init__(self) -> None:
        real("K", self.K, above=0)
        for key in ("friction", "friction_head"):
            if getattr(self, key) is not None:
                real(key, getattr(self, key), least=0)
        if self.friction_head is None:
            object.__setattr__(self, "friction_head", self.friction)

    def force(self, torque: float, t: Thread) -> float:
        """Bolt force, N; raises InputError for what is not positive."""
        if self.friction is None:
            return nut_factor_force(torque, t.diameter, self.K)
        return motosh_force(torque, t, self.friction, self.friction_head)

    def in_words(self, torque: float, t: Thread) -> str:
        """Which equation, with its numbers."""
        if self.friction is None:
            return f"T = K d F with T = {torque:g} N·m, K = {self.K:g}, d = {t.diameter * 1e3:g} mm"
        frictions = (
            f"friction {self.friction:g} in the thread, {self.friction_head:g} under the head"
        )
        return f"Motosh's equation with T = {torque:g} N·m, {frictions}, {t.name}"


@dataclass(frozen=True)
class Answer:
    """Parameters of a joint from the database.

    Attributes:
        thread: The bolt.
        force: N.
        force_from: How the force was found, in words.
        thickness: m.
        radius: Contact radius, m; None if the database has none.
        pressure: Mean inside it, Pa; None if the database has none.
        identified: Nearest row that has E, nu or h; None if there is none.
        identified_note: For which conditions that is, and how they differ from what was asked.
        notes: What else there is to know.
    """

    thread: Thread
    force: float
    force_from: str
    thickness: float
    radius: Interpolation | None
    pressure: Interpolation | None
    identified: JointRow | None
    identified_note: str
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        radius = "" if self.radius is None else f", radius {quantity(self.radius.value, 'm')}"
        return f"Answer({self.thread.name}, {quantity(self.force, 'N')}{radius})"

    @property
    def extrapolated(self) -> bool:
        """Whether radius or pressure lie outside the data."""
        return any(e is not None and e.extrapolated for e in (self.radius, self.pressure))

    def json(self) -> dict[str, object]:
        """For the JSON file; null for what is infinite, far outside the data."""
        return plain(
            {
                "version": __version__,
                "bolt": self.thread.name,
                "diameter_m": self.thread.diameter,
                "force_N": self.force,
                "force_from": self.force_from,
                "thickness_m": self.thickness,
                "radius_m": self.radius and asdict(self.radius),
                "pressure_Pa": self.pressure and asdict(self.pressure),
                "identified": self.identified and asdict(self.identified),
                "identified_note": self.identified_note,
                "notes": self.notes,
            }
        )


def in_words(estimate: Interpolation | None, unit: str) -> str:
    """An estimate with its deviation and interval: ``51.4 ± 0.4 mm (95 %: 50.6 to 52.2 mm)``."""
    if estimate is None:
        return MISSING
    factor, shown = prefixed(estimate.value, unit)
    value, sd = number(estimate.value * factor), number(estimate.sd * factor, 2)
    mark = ", extrapolated" if estimate.extrapolated else ""
    return f"{value} ± {sd} {shown} (95 %: {interval(estimate.low, estimate.high, unit)}{mark})"


@dataclass
class JointSurfaces:
    """Kriging of radius and pressure over the conditions, from one model's rows.

    Attributes:
        store: The database.
        model: Name of the model whose rows these are.
        inputs: Names of the conditions.
        rows: The rows.
        kriging: By output: ``radius``, ``pressure``.
        notes: What was left out.
    """

    store: Store
    model: str | None
    inputs: tuple[str, ...]
    rows: list[JointRow]
    kriging: dict[str, Kriging] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"JointSurfaces({', '.join(self.kriging)} of {len(self.rows)} rows)"

    @classmethod
    def fit(
        cls, store: Store, model: str | None = None, outputs: Sequence[str] = ("radius", "pressure")
    ) -> JointSurfaces:
        """Fit the rows of one model.

        Args:
            store: The database.
            model: Name of the model; needed if rows of several have a radius or pressure.
            outputs: Which of the two to fit; an answer has no other.

        Raises:
            InputError: If it is needed or unknown, or rows are too few.
        """
        rows = [
            j
            for j in store.joints()
            if (j.radius or j.pressure) and None not in (j.force, j.thickness)
        ]
        models = list(dict.fromkeys(j.model for j in rows))
        if model is None and len(models) > 1:
            said = "; ".join(f"{m or 'without a name'}" for m in models)
            raise InputError(
                f"--model: {store.path} has rows of several models, expected one: {said}"
            )
        if model is not None and model not in models:
            raise InputError(
                f"--model {model}: expected one of: {'; '.join(m for m in models if m) or 'none'}"
            )
        rows = [j for j in rows if model in (None, j.model)]
        if not rows:
            raise InputError(f"{store.path}: has no rows with a force, thickness, and a radius")
        inputs, notes = ["diameter", "force", "thickness"], []
        given = {j.roughness for j in rows}
        if None not in given and len(given) > 1:
            inputs.append("roughness")
        elif len(given) > 1:
            notes.append("roughness is no input: some rows have none")
        surfaces = cls(store, models[0] if model is None else model, tuple(inputs), rows)
        for output in outputs:
            known = [j for j in rows if getattr(j, output) is not None]
            if known:
                x = np.array([[getattr(j, name) for name in inputs] for j in known])
                y = np.array([getattr(j, output) for j in known])
                surfaces.kriging[output] = Kriging(x, y, inputs, output)
            else:
                notes.append(f"no row has a {output}")
        surfaces.notes = tuple(notes)
        return surfaces


def query(
    surfaces: JointSurfaces | Store,
    *,
    bolt: str | Thread,
    thickness: float,
    torque: float | None = None,
    force: float | None = None,
    torque_to_force: TorqueToForce | None = None,
    roughness: float | None = None,
    extrapolate: bool = False,
) -> Answer:
    """Parameters of a joint.

    Args:
        surfaces: Fitted, or the database itself, which is then fitted.
        bolt: Name of the thread.
        thickness: Of one plate, m.
        torque: N·m; this or ``force``.
        force: N.
        torque_to_force: T = K d F with K = 0.2 by default.
        roughness: Ra, m.
        extrapolate: Answer outside the data too, and say so.

    Raises:
        InputError: For an unknown bolt, neither or both of torque and force, what is not positive,
            or an answer that would be extrapolated.
    """
    if isinstance(surfaces, Store):
        surfaces = JointSurfaces.fit(surfaces)
    t = thread(bolt)
    how = TorqueToForce() if torque_to_force is None else torque_to_force
    if (torque is None) == (force is None):
        raise InputError("expected a torque or a force, one of the two")
    for name, value in (
        ("torque", torque),
        ("force", force),
        ("thickness", thickness),
        ("roughness", roughness),
    ):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} = {value:g}: expected a number above 0")
    words = "given" if torque is None else how.in_words(torque, t)
    force = how.force(torque, t) if force is None else force
    point = {"diameter": t.diameter, "force": force, "thickness": thickness, "roughness": roughness}
    estimates = {
        output: _estimate(kriging, point, extrapolate)
        for output, kriging in surfaces.kriging.items()
    }
    row, note = _identified(surfaces.store.joints(), point, how)
    source = surfaces.model or "a model without a name"
    notes = [f"radius and pressure from {len(surfaces.rows)} rows of {source}", *surfaces.notes]
    if any(e.extrapolated for e in estimates.values()):
        notes.insert(0, "extrapolated: outside the data, where the uncertainty itself is uncertain")
        notes += _one_value_only(surfaces, point)
    return Answer(
        t,
        force,
        words,
        thickness,
        estimates.get("radius"),
        estimates.get("pressure"),
        row,
        note,
        tuple(notes),
    )


def _one_value_only(surfaces: JointSurfaces, point: dict) -> list[str]:
    """Conditions of which the data have one value, and another was asked for."""
    notes = []
    for name in surfaces.inputs:
        values = {getattr(j, name) for j in surfaces.rows}
        only = min(values)
        if len(values) == 1 and not math.isclose(only, point[name], rel_tol=1e-9):
            notes.append(
                f"all rows have {name} {quantity(only, UNITS[name])}: no effect of it is in the "
                "answer, nor in its uncertainty"
            )
    return notes


def _estimate(kriging: Kriging, point: dict, extrapolate: bool) -> Interpolation:
    values = [point[name] for name in kriging.inputs]
    if None in values:
        raise InputError("roughness: expected a number, since the database depends on it")
    return kriging.predict(np.array(values), extrapolate=extrapolate)


def _identified(
    joints: list[JointRow], point: dict, how: TorqueToForce
) -> tuple[JointRow | None, str]:
    """The nearest row with E, nu or h: least sum of squares of the conditions' log ratios."""
    rows = [j for j in joints if any(v is not None for v in (j.E, j.nu, j.h))]
    if not rows:
        return None, "no row has E, nu or h"
    ratios = [_log_ratios(j, point, how) for j in rows]
    asked = sum(value is not None for value in point.values())

    def distance(i: int) -> float:
        unknown = asked - len(ratios[i])
        return sum(r * r for r in ratios[i].values()) + unknown * _UNKNOWN**2

    best = min(range(len(rows)), key=distance)
    row, differing = rows[best], [n for n, r in ratios[best].items() if abs(r) > _SAME]
    unknown = [n for n, value in point.items() if value is not None and n not in ratios[best]]
    note = f"identified for {_conditions(row)}"
    if differing:
        note += f"; not what was asked: {', '.join(differing)} differ" + "s" * (len(differing) == 1)
    if unknown:
        note += f"; its {' and '.join(unknown)} {'is' if len(unknown) == 1 else 'are'} not known"
    if not differing and not unknown:
        note += ", the conditions that were asked"
    return row, note


def _log_ratios(row: JointRow, point: dict, how: TorqueToForce) -> dict[str, float]:
    """Logarithms of the ratios of conditions that are known of both joints."""
    known = {name: getattr(row, name) for name in point}
    if row.force is None and row.torque is not None and (row.bolt or how.friction is None):
        if row.bolt:
            known["force"] = how.force(row.torque, thread(row.bolt))
        else:
            known["force"] = nut_factor_force(row.torque, row.diameter, how.K)
    return {
        name: math.log(known[name] / value)
        for name, value in point.items()
        if value is not None and known[name] is not None
    }


def _conditions(row: JointRow) -> str:
    parts = [row.bolt or f"d {quantity(row.diameter, 'm')}"]
    if row.torque is not None:
        parts.append(f"{row.torque:g} N·m")
    elif row.force is not None:
        parts.append(quantity(row.force, "N"))
    if row.thickness is not None:
        parts.append(f"plates of {row.thickness * 1e3:g} mm")
    if row.roughness is not None:
        parts.append(f"Ra {row.roughness * 1e6:g} µm")
    return ", ".join(parts)
