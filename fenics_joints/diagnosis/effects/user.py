"""Effects of a user's own, written for joints, on a model that has them in zones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.errors import InputError


def check_parameters(
    effect: Effect,
    baseline: Mapping[str, float],
    condition: float,
    zones: Mapping[str, tuple[str, ...]],
) -> None:
    """Refuse an effect that speaks of parameters which it, or the model, does not have.

    Args:
        effect: The effect.
        baseline: Parameter values of the nominal model.
        condition: One of the test's.
        zones: Names of each joint's zones.

    Raises:
        InputError: With the name, and those there are.
    """
    try:
        effect.touches(baseline, (condition,))
    except KeyError as error:
        joint = {zone: name for name, own in zones.items() for zone in own}
        split = (name.rpartition(".") for name in baseline)
        known = dict.fromkeys(f"{joint.get(owner, owner)}.{key}" for owner, _, key in split)
        raise InputError(
            f"effect {effect.key}: {error.args[0]!r} is neither a parameter of its own "
            f"({', '.join(p.name for p in effect.priors)}) nor of the model: expected one of "
            f"{', '.join(known)}"
        ) from error


def for_zones(effect: Effect, zones: Mapping[str, tuple[str, ...]]) -> Effect:
    """An effect on joints as the same effect on each of their zones.

    Where ``effect.apply`` reads or writes ``JOINT.E`` it is given that of the joint's zones, one
    after another, each once. It may speak of several joints and of parts at a time; parts are
    changed once. One that names zones itself, or takes its values as a whole, stays as it is.

    Args:
        effect: The effect.
        zones: Names of each joint's zones.
    """
    split = {name: own for name, own in zones.items() if own != (name,)}
    if effect.apply is None or not split:
        return effect
    most = max(len(own) for own in split.values())

    def apply(values, theta, condition):
        for i in range(most):
            present = {name: own[i] for name, own in split.items() if i < len(own)}
            # A joint with fewer zones shows its last one, and what is done to that is dropped.
            shown = {name: present.get(name, own[-1]) for name, own in split.items()}
            local = _Local(values, shown)
            effect.apply(local, theta, condition)
            local.write_back(present, others=i == 0)
            if not local.spoken_of:
                return

    return replace(effect, apply=apply)


class _Local(dict):
    """Values with one zone of each joint under the joint's own name.

    Attributes:
        spoken_of: Whether a joint was asked for by its own name.
    """

    def __init__(self, values: dict[str, float], shown: Mapping[str, str]):
        super().__init__(values)
        self._values, self._shown = values, shown
        self.spoken_of = False

    def _zone(self, key: str) -> str:
        joint, _, name = key.rpartition(".")
        if joint not in self._shown:
            return key
        self.spoken_of = True
        return f"{self._shown[joint]}.{name}"

    def __getitem__(self, key: str) -> float:
        return super().__getitem__(self._zone(key))

    def __setitem__(self, key: str, value: float) -> None:
        super().__setitem__(self._zone(key), value)

    def __contains__(self, key: object) -> bool:
        return super().__contains__(self._zone(str(key)))

    def write_back(self, present: Mapping[str, str], others: bool) -> None:
        """Put what was changed into the values: of the zones that are present, and, if asked for,
        of everything that is no zone shown."""
        shown, own = set(self._shown.values()), set(present.values())
        for key, value in self.items():
            owner = key.rpartition(".")[0]
            if owner in own or (others and owner not in shown):
                self._values[key] = value
