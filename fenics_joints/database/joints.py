"""One row of the database: the conditions of a bolted joint, its parameters, and who found them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from fenics_joints.errors import InputError, real
from fenics_joints.formatting import control_character

#: Most diameters of the bolt in a contact radius: the pressure cone of plates a hundred bolts thick
#: ends there, and the papers' radii are below five.
_WIDEST = 100.0
#: Conditions and results of a joint, in the order of the columns.
CONDITIONS = ("diameter", "force", "torque", "thickness", "roughness")
RESULTS = ("radius", "pressure", "E", "nu", "h")
NUMBERS = CONDITIONS + RESULTS
TEXTS = ("bolt", "author", "model", "settings", "version", "date", "source")
UNITS = {
    "diameter": "m",
    "force": "N",
    "torque": "N·m",
    "thickness": "m",
    "roughness": "m",
    "radius": "m",
    "pressure": "Pa",
    "E": "Pa",
    "nu": "",
    "h": "m",
}


@dataclass(frozen=True)
class JointRow:
    """A bolted joint and its parameters, SI units; None for what is not known.

    Attributes:
        diameter: Nominal diameter of the bolt.
        force: Of the tightened bolt.
        torque: That tightened it, where that is what is known.
        thickness: Of one connected plate.
        roughness: Ra of the surfaces.
        radius: Contact radius R_wai, the largest at P_lim (Machines 2022, eq. 10).
        pressure: Mean inside that radius.
        E: Young's modulus of the transition interface material.
        nu: Its Poisson ratio.
        h: Its thickness.
        bolt: Name of the thread.
        author: Who computed or measured it.
        model: Name of the model.
        settings: The model's settings as JSON; see `settings_text`.
        version: Of the model or program.
        date: When, as ISO 8601.
        source: Where it is published.

    Raises:
        InputError: If a number is not finite and above 0, the radius within the bolt or beyond any
            plate, there is no result, or a text is empty.
    """

    diameter: float
    force: float | None = None
    torque: float | None = None
    thickness: float | None = None
    roughness: float | None = None
    radius: float | None = None
    pressure: float | None = None
    E: float | None = None
    nu: float | None = None
    h: float | None = None
    bolt: str | None = None
    author: str | None = None
    model: str | None = None
    settings: str | None = None
    version: str | None = None
    date: str | None = None
    source: str | None = None

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value = getattr(self, name)
            if value is None and name != "diameter":
                continue
            self._check_number(name, value)
        self._check_radius()
        for name in TEXTS:
            value = getattr(self, name)
            if value is not None and (not isinstance(value, str) or not value.strip()):
                raise InputError(f"{name} = {value!r}: expected text, or nothing")
            if value is not None and control_character(value):
                expected = f"expected text without the control character {control_character(value)}"
                raise InputError(f"{name} = {value[:40]!r}: {expected}")
        if self.settings is not None:
            try:
                json.loads(self.settings)
            except (ValueError, RecursionError) as error:
                raise InputError(f"settings = {self.settings[:80]!r}: expected JSON") from error
        if all(getattr(self, name) is None for name in RESULTS):
            raise InputError(f"row has no result, expected one of {', '.join(RESULTS)}")

    def _check_number(self, name: str, value) -> None:
        bounds = {} if name == "nu" else {"above": 0.0}
        number = real(name, value, UNITS[name], **bounds)
        if name == "nu" and not -1 < number < 0.5:
            raise InputError(f"nu = {value!r}: expected a number between -1 and 0.5")
        object.__setattr__(self, name, number)

    def _check_radius(self) -> None:
        """A contact radius is outside the bolt's shank, and not beyond any plate."""
        low, high = self.diameter / 2, _WIDEST * self.diameter
        if self.radius is not None and not low < self.radius <= high:
            raise InputError(
                f"radius = {self.radius:g} m: expected the contact radius of a bolt of "
                f"{1e3 * self.diameter:g} mm, above its shank's {1e3 * low:g} mm and at most "
                f"{high:g} m"
            )

    @property
    def task(self) -> str:
        """Key of the computation: the conditions, the model and its settings, as text.

        The version is not part of it: a sweep of a new version belongs in a new file.
        """
        given = [getattr(self, name) for name in CONDITIONS]
        return json.dumps([*given, self.model, self.settings])


def settings_text(settings: Mapping[str, object]) -> str:
    """A model's settings as JSON in one spelling, so that equal settings are equal text.

    Raises:
        InputError: If they are nothing that JSON has.
    """
    try:
        return json.dumps(dict(settings), sort_keys=True, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"settings {settings!r}: expected what JSON can hold ({error})") from error
