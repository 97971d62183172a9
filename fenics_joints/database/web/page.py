"""The page as a function of what was typed: the question, the answer in words, the picture."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from http import HTTPStatus
from importlib import resources
from urllib.parse import urlencode

import jinja2

from fenics_joints import __version__
from fenics_joints.database.query import Answer, JointSurfaces, TorqueToForce, in_words, query
from fenics_joints.database.web.pictures import Pictures
from fenics_joints.database.web.server import Refused, Reply
from fenics_joints.errors import InputError
from fenics_joints.formatting import quantity
from fenics_joints.preload.threads import thread_names


@dataclass(frozen=True)
class _Number:
    """A field for a number.

    Attributes:
        label: Above the field.
        name: In messages.
        unit: Beside the field.
        factor: To SI.
        low: Least that a joint could have, in the field's unit.
        high: Most.
        ways: From torque to force, for which it is asked.
    """

    label: str
    name: str
    unit: str
    factor: float
    low: float
    high: float
    ways: tuple[str, ...] = ("K", "motosh", "force")


#: In the page's order; the way from torque to force stands in front of K.
_NUMBERS = {
    "torque": _Number("Tightening torque", "torque", "N·m", 1, 1e-3, 1e5, ("K", "motosh")),
    "force": _Number("Bolt force", "bolt force", "kN", 1e3, 1e-3, 1e5, ("force",)),
    "thickness": _Number("Thickness of a plate", "thickness", "mm", 1e-3, 1e-2, 1e4),
    "roughness": _Number("Roughness Ra", "roughness", "µm", 1e-6, 1e-3, 1e3),
    "K": _Number("Nut factor K", "nut factor", "", 1, 1e-2, 10, ("K",)),
    "friction": _Number("Friction", "friction", "", 1, 1e-3, 10, ("motosh",)),
}
#: Ways from torque to force: value and what the page calls it.
_WAYS = {
    "K": "T = K d F (nut factor)",
    "motosh": "Motosh (friction in thread and head)",
    "force": "the force is known",
}
_OUTPUTS = {"radius": "Contact radius", "pressure": "Mean pressure"}
_FIGURE = re.compile(r"[-+]?(\d{1,15}([.,]\d{0,15})?|[.,]\d{1,15})([eE][-+]?\d{1,2})?", re.ASCII)
#: Most characters of a field, as the page's inputs allow.
_LONGEST = 40


@dataclass(frozen=True)
class _Question:
    """Typed and chosen values, as text; a ticked box is "on"."""

    bolt: str = "M12"
    torque: str = "120"
    force: str = "50"
    thickness: str = "25"
    roughness: str = "1.6"
    way: str = "K"
    K: str = "0.2"
    friction: str = "0.12"
    extrapolate: str = ""
    output: str = "radius"


class Page:
    """Replies to requests, one at a time: neither matplotlib's fonts nor the database's connection
    allow two threads at once. Keeps nothing of the requests.

    Args:
        surfaces: Fitted.
    """

    def __init__(self, surfaces: JointSurfaces):
        self._surfaces, self._pictures = surfaces, Pictures(surfaces)
        own = [j.bolt for j in surfaces.rows if j.bolt]
        self._bolts = tuple(dict.fromkeys([*thread_names(), *own]))
        self._first = _Question(bolt=(*own, "M12")[0], output=next(iter(surfaces.kriging)))
        self._choices = {
            "bolt": self._bolts,
            "way": tuple(_WAYS),
            "output": tuple(surfaces.kriging),
            "extrapolate": ("", "on"),
        }

    def reply(self, path: str, typed: Mapping[str, str]) -> Reply:
        """Reply to a request.

        Args:
            path: "" for the page, ``picture.svg``, or a file of the page.
            typed: What is typed and chosen by name; what is missing is as at first.

        Raises:
            Refused: For what the page does not have, or would never send.
        """
        if path in ("page.css", "page.js"):
            kind = "text/css" if path.endswith("css") else "text/javascript"
            return Reply(_file(path).encode(), f"{kind}; charset=utf-8")
        if path not in ("", "picture.svg"):
            raise Refused(HTTPStatus.NOT_FOUND)
        question = self._question(typed)
        answer, error = self._answered(question)
        if path:
            svg = self._pictures.svg(question.output, answer)
            return Reply(svg.encode(), "image/svg+xml; charset=utf-8")
        return Reply(self._html(question, answer, error).encode(), "text/html; charset=utf-8")

    def _question(self, typed: Mapping[str, str]) -> _Question:
        """The values of the form's fields; raises `Refused` for fields or choices that it lacks."""
        names = {f.name for f in fields(_Question)}
        for name, text in typed.items():
            if name not in names or len(text) > _LONGEST:
                raise Refused(HTTPStatus.BAD_REQUEST)
            if name in self._choices and text not in self._choices[name]:
                raise Refused(HTTPStatus.BAD_REQUEST)
        return replace(self._first, **typed)

    def _shown(self, question: _Question) -> list[str]:
        """Names of the numbers that the question needs."""
        return [
            name
            for name, number in _NUMBERS.items()
            if question.way in number.ways
            and (name != "roughness" or "roughness" in self._surfaces.inputs)
        ]

    def _answered(self, question: _Question) -> tuple[Answer | None, str]:
        """The answer, or what is wrong with the question."""
        try:
            values = {name: _value(name, question) for name in self._shown(question)}
            how = TorqueToForce(values.pop("K", 0.2), values.pop("friction", None))
            answer = query(
                self._surfaces,
                bolt=question.bolt,
                torque_to_force=how,
                extrapolate=bool(question.extrapolate),
                **values,
            )
        except InputError as problem:
            return None, str(problem)
        return answer, ""

    def _html(self, question: _Question, answer: Answer | None, error: str) -> str:
        shown = self._shown(question)
        return _template().render(
            version=__version__,
            about=_about(self._surfaces),
            q=question,
            error=error,
            said=_said(answer),
            notes=() if answer is None else answer.notes,
            extrapolated=answer is not None and answer.extrapolated,
            numbers=_NUMBERS,
            shown=shown,
            ways=list(_WAYS.items()),
            bolts=[(bolt, bolt) for bolt in self._bolts],
            outputs={name: _OUTPUTS[name] for name in self._choices["output"]},
            picture=urlencode(asdict(question)),
        )


@lru_cache(maxsize=2)
def _file(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _template() -> jinja2.Template:
    env = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    return env.from_string(_file("page.html"))


def _value(name: str, question: _Question) -> float:
    """A typed number in SI units; raises InputError unless a joint can have it."""
    number, text = _NUMBERS[name], getattr(question, name).strip()
    if not _FIGURE.fullmatch(text):
        raise InputError(f"{number.name}: expected a number")
    value = float(text.replace(",", "."))
    if not number.low <= value <= number.high:
        allowed = f"{number.low:g} to {number.high:g} {number.unit}".rstrip()
        raise InputError(f"{number.name} = {text}: expected a number from {allowed}")
    return value * number.factor


def _said(answer: Answer | None) -> dict[str, tuple[str, str]]:
    """An answer in the page's words, each figure and what there is to know of it."""
    if answer is None:
        return dict.fromkeys(("radius", "pressure", "force", "interface"), ("–", "–"))
    row = answer.identified
    found = (
        "–"
        if row is None
        else (f"E {quantity(row.E, 'Pa')}, ν {quantity(row.nu)}, h {quantity(row.h, 'm')}")
    )
    return {
        "radius": _split(in_words(answer.radius, "m")),
        "pressure": _split(in_words(answer.pressure, "Pa")),
        "force": (quantity(answer.force, "N"), answer.force_from),
        "interface": (found, answer.identified_note),
    }


def _split(words: str) -> tuple[str, str]:
    """``51.4 ± 0.4 mm (95 %: ...)`` in front of and inside the brackets."""
    value, _, rest = words.partition(" (")
    return value, rest.rstrip(")")


def _about(surfaces: JointSurfaces) -> str:
    sources = dict.fromkeys(j.source for j in surfaces.rows if j.source)
    return f"{len(surfaces.rows)} rows: {surfaces.model or 'no model named'}. " + "; ".join(sources)
