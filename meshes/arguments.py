"""Arguments of the mesh builders: their units, the conditions on them, and the checks."""

from __future__ import annotations

import inspect
import itertools
import math
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Concatenate, Literal, ParamSpec

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import MOST, MOST_OF, MeshError
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

P = ParamSpec("P")
#: Largest number of cells of a mesh. Chosen: some hundred times what one machine can hold, so that
#: only mistaken units are refused.
MOST_CELLS = 1e9
#: Least distance of two bolts, m. Chosen: no thread is thinner, so that nearer ones are one bolt.
ONE_BOLT = 1e-3


def holds(test: Callable[[Any], bool], value: Any) -> bool:
    """Whether a value passes a test; False where the test itself fails, as on a text."""
    try:
        return bool(test(value))
    except (TypeError, ValueError, OverflowError):
        return False


def is_finite(value: Any) -> bool:
    """Whether ``value`` is a finite number of a size that mechanics has."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return number and holds(lambda v: abs(float(v)) <= MOST, value)


def is_positive(value: Any) -> bool:
    """Whether ``value`` is a finite number above 0."""
    return is_finite(value) and value > 0


def is_count(value: Any) -> bool:
    """Whether ``value`` is a whole number of at least 1."""
    number = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return number and 1 <= value <= MOST_OF


def lengths(values: Any, n: int) -> bool:
    """Whether ``values`` are n finite numbers above 0."""
    return holds(lambda v: np.shape(v) == (n,) and all(map(is_positive, v)), values)


def requirement(builder: str) -> Callable[[bool, str, object, str], None]:
    """A function that raises MeshError, in the builder's name, unless something holds."""

    def require(holds: bool, name: str, value: object, expected: str) -> None:
        if not holds:
            raise MeshError(f"{builder}: {name} is {value!r}, expected {expected}")

    return require


@dataclass(frozen=True)
class Demand:
    """A condition on an argument, for the annotation of its type.

    Attributes:
        holds: Whether a value meets it.
        expected: The condition in words.
        unit: The SI unit of a quantity; None for other arguments.
    """

    holds: Callable[[Any], bool]
    expected: str
    unit: str | None = None


#: Types: a length, a thickness that may be zero, a coordinate, a number of elements, a cell shape.
Size = Annotated[
    float,
    Demand(is_positive, "a length above 0 m, from 1e-12 to 1e9 m", "m"),
    Demand(lambda v: 1e-12 <= v <= 1e9, "a length from 1e-12 to 1e9 m"),
]
Gap = Annotated[
    float, Demand(lambda v: is_finite(v) and v >= 0, "0 m or a thickness above it", "m")
]
Coordinate = Annotated[float, Demand(is_finite, "a coordinate in metres", "m")]
Count = Annotated[int, Demand(is_count, "a whole number of at least 1")]
Solid = Literal["hexahedron", "tetrahedron"]
#: Most bolts in a plan. Chosen: the builders compare each with each, which takes a second then.
MOST_PLACES = 1000
Places = Annotated[
    Sequence[tuple[Coordinate, Coordinate]],
    Demand(lambda v: len(v) <= MOST_PLACES, f"at most {MOST_PLACES} bolts"),
    Demand(
        lambda v: all(np.shape(b) == (2,) and all(map(is_finite, b)) for b in v),
        "a pair (x, y) in metres for each bolt",
    ),
    Demand(
        lambda v: all(math.dist(a, b) >= ONE_BOLT for a, b in itertools.combinations(v, 2)),
        f"each bolt once, {1e3 * ONE_BOLT:g} mm or more from the others",
    ),
]


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """The arguments of a function that makes a mesh, each with its type, default and unit.

    The types are annotated with a `Demand`.

    Raises:
        MeshError: An argument is impossible; names it, its value and what was expected.
    """

    #: The function that makes the mesh.
    function: ClassVar[str]

    def __post_init__(self) -> None:
        kinds = typing.get_type_hints(type(self), include_extras=True)
        for field in fields(self):
            value = getattr(self, field.name)
            for holds, expected in _demands(kinds[field.name], value):
                self.require(holds, field.name, expected)
        self.check()

    def require(self, holds: bool, name: str, expected: str, *value: object) -> None:
        """Raise MeshError unless something holds of an argument, or of a value of that name."""
        shown = value[0] if value else getattr(self, name)
        requirement(self.function)(holds, name, shown, expected)

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""


@dataclass(frozen=True, kw_only=True)
class Builder(Arguments):
    """The arguments of a mesh builder, of which a further one is a subclass.

    One line registers it: ``name = made_by(Name, in_cases=True)`` makes the ``function``, and the
    section ``[mesh]`` of case files with the same arguments.
    """

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        raise NotImplementedError

    def bricks(self) -> list[tuple[float, float, float]]:
        """Estimated number of cells along the three axes of each block that the mesh is made of.

        Of hexahedra, each of which may be six tetrahedra. Nothing is built for it. Empty where
        there is no estimate.
        """
        return []

    def lists(self) -> MeshLists:
        """The whole mesh on one rank."""
        raise NotImplementedError

    def build(self, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh. Collective; its lists are made on rank 0 only.

        Raises:
            MeshError: It would have more than `MOST_CELLS` cells.
        """
        cells = sum(math.prod(map(float, brick)) for brick in self.bricks())
        if not cells <= MOST_CELLS:
            raise MeshError(
                f"{self.function}: the mesh would have about {cells:.2g} cells, expected at most "
                f"{MOST_CELLS:.0e}: are the sizes of its elements given in metres?"
            )
        return distribute(comm, on_root(comm, self.lists))


def check_squares(builder: Arguments, key: str, side: float, spans, *, apart: bool) -> None:
    """Refuse squares round bolts that leave a rectangle, or overlap.

    Args:
        builder: The arguments, with ``centres`` of the bolts, shape (n, 2), m.
        key: Name of the bolts among them.
        side: Side of the squares, the argument ``zone``, m.
        spans: Where the rectangle begins and ends along x, and along y, m.
        apart: Whether overlapping squares are refused.
    """
    for number, centre in enumerate(builder.centres):
        own = f"{key}[{number}]"
        for axis, value, (low, high) in zip("xy", centre.tolist(), spans, strict=True):
            room, span = min(value - low, high - value), f"{low:g} to {high:g} m along {axis}"
            builder.require(room > 0, f"{own} {axis}", f"a position within {span}", value)
            expected = f"at most {2 * room:g} m, so that the square of {own} stays within {span}"
            builder.require(side / 2 <= room + 1e-9 * (high - low), "zone", expected, side)
        for other in range(number if apart else 0):
            gap = np.abs(centre - builder.centres[other]).max()
            expected = f"at most the distance of {key}[{other}] and {own}, {gap:g} m"
            builder.require(side <= gap * (1 + 1e-9), "zone", expected, side)


#: Builders that a case file can name, by their functions; see `made_by`.
CASE_BUILDERS: dict[str, type[Builder]] = {}


def made_by(
    builder: Callable[P, Builder], *, in_cases: bool = False
) -> Callable[Concatenate[MPI.Intracomm, P], TaggedMesh]:
    """The function of a communicator and a builder's arguments that builds the mesh.

    Args:
        builder: The builder, a class.
        in_cases: Whether ``builder = "NAME"`` in a case file means it; it then has `Builder.groups`
            and `Builder.bricks`.
    """
    if in_cases:
        CASE_BUILDERS[builder.function] = builder

    def make(comm, **arguments):
        return builder(**arguments).build(comm)

    return described(make, builder)


def described(make: Callable[..., TaggedMesh], arguments: type[Arguments]):
    """A function with the name, the signature and the docstring of its keyword arguments' class."""
    kinds = typing.get_type_hints(arguments)
    first = [p for p in inspect.signature(make).parameters.values() if p.kind is not p.VAR_KEYWORD]
    given = inspect.signature(arguments).parameters.values()
    given = [p.replace(annotation=kinds[p.name]) for p in given]
    make.__signature__ = inspect.Signature([*first, *given], return_annotation=TaggedMesh)
    make.__name__ = make.__qualname__ = arguments.function
    make.__module__ = arguments.__module__
    more = "Args:\n    comm: Communicator; the call is collective.\n"
    make.__doc__ = inspect.cleandoc(arguments.__doc__).replace("Attributes:\n", more)
    return make


def _demands(kind: Any, value: Any):
    """The conditions of a type: whether a value meets each, and the condition in words."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        options = [k for k in typing.get_args(kind) if k is not type(None)]
        # Of a list in place of one value, such as radii, the class checks the items.
        if value is not None and (len(options) == 1 or np.ndim(value) == 0):
            yield from _demands(options[0], value)
    elif typing.get_origin(kind) is Literal:
        words = typing.get_args(kind)
        yield isinstance(value, str) and value in words, " or ".join(map(repr, words))
    elif typing.get_origin(kind) is Annotated:
        for demand in kind.__metadata__:
            yield holds(demand.holds, value), demand.expected
    elif kind is bool:
        yield isinstance(value, bool | np.bool_), "True or False"
    elif kind is float:
        yield is_finite(value), "a finite number"
    elif kind is int:
        yield is_count(value), "a whole number of at least 1"
