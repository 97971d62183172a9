"""Zones: parts of joints that can change independently, of layers, contacts and laps alike.

K is proportional to a zone's parameters, and M does not depend on them. The zones of a case are
made in `zones.joints` (layers around bolts), `zones.contacts` (layers by pressure) and
`zones.laps` (joint elements of beams).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.case import Case, parameters
from fenics_joints.case.build_beams import ZonedLap
from fenics_joints.errors import InputError
from fenics_joints.forms import lame_from_moduli, lame_parameters
from fenics_joints.meshes import TaggedMesh
from fenics_joints.structure.structure import Structure

#: Distances closer than this, relative to the largest, are equal by symmetry. [numerical:
#: round-off]
SAME = 1e-6


@dataclass(frozen=True)
class ZoneInterface:
    """The stiffness of one kind of zones, and how an interface in them enters K.

    Attributes:
        name: Its kind.
        keys: The zone's parameter by what it resists: ``n`` and ``t``, across a layer's plane and
            along it; ``slap`` and ``slip`` of a lap.
        per_area: Whether an interface's stiffness is one per area, Pa/m, which times the layer's
            thickness is a modulus; else it is relative to the zone's own.
        series: Whether it is in series with what the model has; else it is a factor on that.
        slipping: What falls when the faces slip.
        damped: What dissipates.
    """

    name: str
    keys: Mapping[str, str]
    per_area: bool
    series: bool
    slipping: tuple[str, ...]
    damped: tuple[str, ...]


LAYER = ZoneInterface("layer", {"n": "E", "t": "G"}, True, True, ("t",), ("n", "t"))
#: Slip alone is damped, as in eq. 3 of Jalali et al. 2019.
LAP = ZoneInterface("lap", {"slap": "k1", "slip": "k2"}, False, True, ("slip",), ("slip",))
#: A lap with the k1 and k2 of the case in place of those of one piece.
GIVEN_LAP = replace(LAP, name="given lap", series=False)


@dataclass(frozen=True)
class Zone:
    """A part of a joint that can change independently of the others.

    Attributes:
        name: The prefix of its parameters in the model.
        interface: Its kind of stiffness.
        thickness: Of its layer, m; nan for a lap.
        joint: The case's joint or contact that it is a part of.
        shown: Name under which several zones are shown together.
        held: The joints, or faces of one, that it is a part of: those that share a bolt.
        label: Its name in those of an effect's parameters.
        bolt: Name of the bolt that presses it, such as ``bolt 2``; ``""`` without.
        ring: Number of its ring about that bolt, 1 the innermost; 0 without.
        distance: Least and largest distance of its cells' middles from that bolt's axis, m.
        pressure: Least and largest contact pressure in it, Pa.
        area: Its area, m2.
    """

    name: str
    interface: ZoneInterface = LAYER
    thickness: float = np.nan
    joint: str = ""
    shown: str = ""
    held: str = ""
    label: str = ""
    bolt: str = ""
    ring: int = 0
    distance: tuple[float, float] = (np.nan, np.nan)
    pressure: tuple[float, float] = (np.nan, np.nan)
    area: float = np.nan

    def parameters(self, kinds: Sequence[str] | None = None) -> list[str]:
        """Names of its parameters in the model.

        Args:
            kinds: Keys of `ZoneInterface.keys`; all by default.
        """
        keys = self.interface.keys
        return [f"{self.name}.{keys[kind]}" for kind in (keys if kinds is None else kinds)]

    def amount(self, k: float, value: float) -> float:
        """An interface of stiffness ``k`` as a value of the parameter that is ``value`` now."""
        return k * (self.thickness if self.interface.per_area else value)

    def give_way(self, values: dict[str, float], kind: str, k: float) -> None:
        """Put an interface of stiffness ``k`` into the model's parameter values, in place."""
        (name,) = self.parameters([kind])
        amount = self.amount(k, values[name])
        values[name] = 1 / (1 / values[name] + 1 / amount) if self.interface.series else amount


@dataclass(frozen=True)
class Zones:
    """A case with its joints in zones; a sequence of them.

    Attributes:
        case: The case, with a joint section for each zone.
        all: The zones.
        tagged: Its mesh with the cells tagged by zone; None for beams, and without zones.
        laps: Its laps, by which zone each of their elements is in; None for solids.
        places: Names of the zones at each single place, by the kind of place and by its name, where
            there are several: ``{"bolt": {"bolt 1": (...), ...}}``.
        away: Names of the zones away from the bolts.
        gradings: Names of the zones that have one stiffness, by the way in which the stiffness of a
            joint may differ from zone to zone, in words, and by the name of the group.
        bolts: Places of the bolts of laps, m, (n_bolts, 3).
    """

    case: Case
    all: tuple[Zone, ...] = ()
    tagged: TaggedMesh | None = field(default=None, repr=False)
    laps: tuple[ZonedLap, ...] | None = None
    places: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict, repr=False)
    away: tuple[str, ...] = ()
    gradings: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict, repr=False)
    bolts: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), repr=False)

    def __iter__(self) -> Iterator[Zone]:
        return iter(self.all)

    def __len__(self) -> int:
        return len(self.all)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(zone.name for zone in self.all)

    @property
    def by_pressure(self) -> bool:
        """Whether they are zones of a contact whose pressure was solved for."""
        return any(np.isfinite(zone.pressure).all() for zone in self.all)

    def pick(self, names: Sequence[str]) -> tuple[Zone, ...]:
        """Zones by their names."""
        return tuple(zone for zone in self.all if zone.name in names)

    def by(self, attribute: str) -> dict[str, tuple[str, ...]]:
        """Names of the zones by an attribute, such as ``bolt``; those without it left out."""
        found: dict[str, tuple[str, ...]] = {}
        for zone in self.all:
            label = getattr(zone, attribute)
            if label:
                found[label] = (*found.get(label, ()), zone.name)
        return found

    @property
    def shown(self) -> dict[str, str]:
        """Name under which each zone, and each lap along the beams, is shown with others."""
        along = {lap.along: lap.name for lap in self.laps or ()}
        return {zone.name: zone.shown for zone in self.all} | along

    def with_thickness(self, thickness: Mapping[str, float]) -> Zones:
        """The same with the thickness, m, of each zone's layer by its name."""
        return replace(
            self, all=tuple(replace(zone, thickness=thickness[zone.name]) for zone in self.all)
        )


def distinct_places(
    kinds: Mapping[str, Mapping[str, tuple[str, ...]]], away: Sequence[str] = ()
) -> dict[str, dict[str, tuple[str, ...]]]:
    """Zones of each distinct location, see `Zones.places`.

    Args:
        kinds: Zones by the kind of place and by its name, all of them.
        away: Zones that are a location already.
    """
    seen, found = {frozenset(away)}, {}
    for kind, places in kinds.items():
        new = {k: zones for k, zones in places.items() if frozenset(zones) not in seen}
        if len(places) > 1 and new:
            found[kind] = new
            seen |= {frozenset(zones) for zones in new.values()}
    return found


def equal_shares(values: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Group of each of some values, (n,), from 0 at the least value on.

    Groups have equal weights, as nearly as can be, and equal values are in one group.

    Args:
        values: The values, none negative.
        weights: Of each.
        count: Groups at most.
    """
    order = np.argsort(values, kind="stable")
    level = np.empty(len(values), dtype=int)
    new = np.diff(values[order]) > SAME * values.max()
    level[order] = np.concatenate([[0], np.cumsum(new)])
    weight = np.bincount(level, weights)
    share = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    group = np.minimum((count * share).astype(int), count - 1)
    return np.unique(group, return_inverse=True)[1][level]


def check_names(case: Case, zones: Sequence[str], what: str) -> None:
    """Raise if a zone's name is another section's, or another zone's.

    Args:
        case: The case.
        zones: Names of the zones.
        what: A word for their joints: ``a joint``, ``a lap``.

    Raises:
        InputError: With the name.
    """
    tables = ("parts", "contacts", "bolts", "masses", "springs", "attached", "supports")
    taken = {name for table in tables for name in getattr(case, table)}
    for zone in zones:
        if zone in taken or list(zones).count(zone) > 1:
            raise InputError(
                f"{case.path}: the name {zone!r} is needed for a zone of {what}; expected no "
                "other section of that name"
            )


def layer_thickness(structure: Structure) -> dict[str, float]:
    """Thickness, m, of every joint's layer by the joint's name. Collective."""
    return {
        region.name: structure.extent(number)
        for number, region in enumerate(structure.regions)
        if region.is_joint
    }


def bonded_moduli(case: Case) -> tuple[float, float]:
    """Constrained modulus and shear modulus, Pa, of the stiffest part."""
    stiffest = max((part.nominal() for part in case.parts.values()), key=lambda part: part["E"])
    lmbda, mu = lame_parameters(stiffest["E"], stiffest["nu"])
    return lmbda + 2 * mu, mu


def bonded_values(case: Case) -> dict[str, float]:
    """Parameter values of the nominal model, with widths and elastic supports, next to rigid.

    By default the parts are bonded, nothing of the joint assumed: the layers, with the uncoupled
    law, get the constrained modulus and the shear modulus of the stiffest part. With ``[diagnose]
    joints = "given"`` they keep the case's own stiffness, as moduli of that law.
    """
    values = {
        p.name: p.value for p in parameters(case, attached=True, width=True, elastic_supports=True)
    }
    for name, section in case.joints.items():
        if section.law == "generic" or section.own_law is not None:
            continue  # no moduli: see `fenics_joints.diagnosis.zones.laps.lap_as_one`
        moduli = bonded_moduli(case)
        if case.diagnose.joints == "given":
            if section.law == "uncoupled":
                continue
            lmbda, mu = lame_from_moduli(section.E, section.G)
            moduli = lmbda + 2 * mu, mu
        values[f"{name}.E"], values[f"{name}.G"] = moduli
    return values
