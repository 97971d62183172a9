"""How far the gap shrinks on data that were neither fitted nor used to choose: the results.

The measure is S* = (E_before - E_after) / (E_before - E_noise): 1 if the hypothesis chosen and
fitted without the held-out data predicts them as well as noise lets anything, 0 if it is no better
than the nominal model. `held_out` finds it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from fenics_joints.files import plain

#: Limits of S*: the whole gap is closed; the gap is doubled. [decision: symmetry]
_LEAST, _MOST = -1.0, 1.0
#: Error of the nominal model, relative to noise, below which a cause cannot show. [decision:
#: chosen]
_VISIBLE = 2.0

Interval = tuple[float, float]


@dataclass(frozen=True, repr=False)
class Forecast:
    """Forecast of a fold, stated without its held-out data.

    Attributes:
        after: Interval (90 %) of the relative RMS error that is left.
        shrink: Interval (90 %) of S*.
        low: Lower ends of the intervals (90 %) of each held-out ln f, shape (k,).
        high: Upper ends.
        weights: Share of each hypothesis in the mixture, by label.
    """

    after: Interval
    shrink: Interval
    low: np.ndarray
    high: np.ndarray
    weights: dict[str, float]

    def __repr__(self) -> str:
        return f"Forecast(after={self.after}, shrink={self.shrink})"


@dataclass(frozen=True)
class Fold:
    """One fold: its forecast, and the result with its held-out frequencies.

    Attributes:
        name: What was held out.
        n: Number of held-out frequencies.
        chosen: Hypothesis chosen without them.
        placebo_chosen: Best wrong one, chosen likewise; "" if there is none.
        before: Relative RMS error of the nominal model.
        after: That of the chosen hypothesis.
        placebo: That of the placebo; as before if there is none.
        noise: What noise, and scatter of the preload that the fit cannot know, allow.
        shrink: S*; nan if the nominal model is as good as noise allows.
        shrink_interval: Its interval (90 %) by bootstrap over the entries.
        placebo_shrink: S* of the placebo.
        predicted_after: Interval (90 %) stated of ``after``.
        predicted_shrink: Interval (90 %) stated of ``shrink``.
        covered: Whether ``after`` lies in the stated interval.
        better: Whether it ended below it, better than stated.
        shrink_covered: Whether ``shrink`` lies in its interval or above; None if it is nan.
        entries_covered: Share of the held-out frequencies in their own stated intervals.
        weights: Shares of the hypotheses in the mixture behind the stated intervals.
    """

    name: str
    n: int
    chosen: str
    placebo_chosen: str
    before: float
    after: float
    placebo: float
    noise: float
    shrink: float
    shrink_interval: Interval
    placebo_shrink: float
    predicted_after: Interval
    predicted_shrink: Interval
    covered: bool
    shrink_covered: bool | None
    entries_covered: float
    weights: dict[str, float]
    better: bool = False

    @property
    def held(self) -> bool:
        """Whether it ended as well as stated, or better."""
        return self.covered or self.better

    @property
    def won(self) -> bool:
        """Whether the cause predicted it better than the nominal model and the best wrong one."""
        return bool(self.after < np.fmin(self.before, self.placebo))

    @property
    def tells(self) -> bool:
        """Whether the nominal model errs in it by more than noise does, so that a cause can show;
        true if the nominal model has none of its modes."""
        return not self.before < _VISIBLE * self.noise


@dataclass(frozen=True, repr=False)
class Shrinkage:
    """How far the gap shrinks, pooled over folds; and each fold.

    Errors are relative RMS errors of held-out frequencies. Folds overlap (a mode at a torque is
    held out with its mode and with its torque), so that the bootstrap, which takes them as
    independent, is a guide; intervals are of 90 %.

    Attributes:
        before: Of the nominal model.
        after: Of what was chosen and fitted without the held-out data.
        placebo: Of the best wrong effect, chosen and fitted likewise.
        noise: What noise, and scatter of the preload that the fit cannot know, allow.
        shrink: S*, pooled; nan if the nominal model is as good as noise allows.
        shrink_interval: Its interval by bootstrap over folds and entries in them.
        placebo_shrink: S* of the placebo.
        placebo_interval: Its interval.
        excess: S* less that of the placebo.
        excess_interval: Its interval; both are of the same resampled data.
        claimed: Whether the excess is above zero with 95 %: the lower end of its interval is, by
            half a point or more.
        coverage: Share of folds whose ``after`` lay in the interval stated before, or was better.
        better: Share of folds that ended better than stated.
        shrink_coverage: Share of folds whose S* lay in its interval, or was better.
        entries_coverage: Share of all held-out frequencies in their own stated intervals.
        folds: The folds.
        gains: ln of how much more probable the held-out data, frequencies and damping, are with
            each cause than without it, over all folds, each of the data counted once; by the
            cause's name.
    """

    before: float = np.nan
    after: float = np.nan
    placebo: float = np.nan
    noise: float = np.nan
    shrink: float = np.nan
    shrink_interval: Interval = (np.nan, np.nan)
    placebo_shrink: float = np.nan
    placebo_interval: Interval = (np.nan, np.nan)
    excess: float = np.nan
    excess_interval: Interval = (np.nan, np.nan)
    claimed: bool = False
    coverage: float = np.nan
    shrink_coverage: float = np.nan
    entries_coverage: float = np.nan
    folds: list[Fold] = field(default_factory=list)
    better: float = np.nan
    gains: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Shrinkage({self.before:.2%} to {self.after:.2%} in {len(self.folds)} folds)"

    def to_json(self) -> dict:
        """All of it for `json.dumps`; what is not a number is None."""
        return plain(asdict(self))


def shrink(before, after, noise):
    """S* = (before - after) / (before - noise), between -1 and 1; nan if nothing could shrink.

    Args:
        before: Error of the nominal model; a number or an array, as the others.
        after: Error of what was chosen.
        noise: Error that noise allows.
    """
    room = np.subtract(before, noise)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.clip(np.subtract(before, after) / room, _LEAST, _MOST)
    return np.where(room > 0, found, np.nan)[()]
