"""Whether the sliders of Iwan's model stand where a response needs them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from fenics_joints.formatting import percent
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.joint_laws import Iwan

#: Error of the dissipation above which a note says that sliders stand in the wrong place; chosen.
_OFF = 0.05
#: Share of the dissipation that is left out at either end of the amplitudes met; chosen.
_TAIL = 0.02


@dataclass(frozen=True)
class SliderRange:
    """Amplitudes of one interface against the sliders of its law.

    Attributes:
        interface: Its name.
        met: Least and largest amplitude of strain where it dissipates, all but 2 % at each end.
        fitted: Those that the sliders are for.
        error: Of the dissipation per cycle, relative, against the backbone's by Masing's rule.
    """

    interface: str
    met: tuple[float, float]
    fitted: tuple[float, float]
    error: float

    @property
    def note(self) -> str | None:
        """What to know of it; None if the sliders do."""
        if abs(self.error) < _OFF:
            return None
        (low, high), (least, most) = self.met, self.fitted
        return (
            f"{self.interface}: amplitudes of {low:.3g} to {high:.3g} against sliders for "
            f"{least:.3g} to {most:.3g}, whose dissipation is {percent(self.error, sign=True)} off "
            f"the backbone's; expected amplitudes = [{0.9 * low:.2g}, {1.1 * high:.2g}] "
            "of the law, or more sliders"
        )


def slider_ranges(result: HarmonicResult, index: int | None = None) -> tuple[SliderRange, ...]:
    """Every interface with Iwan's sliders in shear, at one response; the highest by default.

    Args:
        result: The responses.
        index: Which of them.
    """
    loops, found = result.loops(result.peak.index if index is None else index), []
    for points in result.model.interfaces:
        law = points.law
        if not isinstance(law, Iwan) or law.coupled:
            continue
        a = loops[points.name].slip_amplitude / law.thickness
        backbone = law.backbone
        exact = points.weights * backbone.dissipation(a)
        if not exact.sum() > 0:
            continue
        strength, stiffness = (law.parameters[key] for key in ("strength", "stiffness"))
        begins = strength / (stiffness * law.thickness)
        made = 4 * np.sum(strength * np.maximum(a[:, None] - begins, 0.0), axis=1)
        error = float(points.weights @ made / exact.sum() - 1)
        order = np.argsort(a)
        share = np.cumsum(exact[order]) / exact.sum()
        ends = [a[order][np.searchsorted(share, s)] for s in (_TAIL, 1 - _TAIL)]
        edges = law.edges * backbone.reference
        fitted = float(edges[min(1, len(edges) - 1)]), float(edges[-1])
        found.append(SliderRange(points.name, (float(ends[0]), float(ends[1])), fitted, error))
    return tuple(found)


def fitted_sliders(
    result: HarmonicResult, *others: HarmonicResult, interfaces: Collection[str] | None = None
) -> InterfaceModel:
    """The model with its sliders where the highest of some responses met their amplitudes.

    Args:
        result: Responses of the model.
        others: More of them, as at other forces.
        interfaces: Names of the interfaces whose sliders may move; all by default.
    """
    met: dict[str, list[float]] = {}
    for one in (result, *others):
        for found in slider_ranges(one):
            if interfaces is not None and found.interface not in interfaces:
                continue
            met.setdefault(found.interface, []).extend(found.met)
    laws = {p.name: p.law for p in result.model.interfaces}
    changed = {}
    for name, ends in met.items():
        law, high = laws[name], 1.1 * max(ends)
        low = min(0.9 * min(ends), 0.5 * min(high, law.backbone.limit))
        changed[name] = law.with_amplitudes((low, high))
    return result.model.with_laws(**changed)
