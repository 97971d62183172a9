"""Evidence by cells of the prior against a sampler that knows nothing of them, on two structures;
`test_beam_diagnosis` has beams, by importance sampling.

The sampler is sequential Monte Carlo by tempering (Del Moral, Doucet and Jasra, J. R. Stat. Soc. B
68, 2006): it starts from the whole prior and moves its points by the predictions alone, without a
derivative, a cell or a fit.
"""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr, ndtri
from scipy.stats import multivariate_normal
from virtual_lap import loose, virtual_lap, write_virtual_lap
from virtual_strip import measured, strip, write_strip

from fenics_joints.case import load_case
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.diagnosis.search import Search
from fenics_joints.progress import Progress

QUIET = Progress(silent=True)
#: Points of the sampler, moves between two temperatures, and the share of points that count.
POINTS, MOVES, SHARE = 500, 10, 0.5


def sampled(log_likelihood, limits: np.ndarray, seed: int = 0) -> float:
    """ln of the mean of a likelihood over standard normal numbers within limits, (d, 2)."""
    rng, low = np.random.default_rng(seed), ndtr(limits[:, 0])
    wide = ndtr(limits[:, 1]) - low
    u = rng.uniform(size=(POINTS, len(limits)))

    def at(u):
        return log_likelihood(np.clip(ndtri(low + wide * u), *limits.T))

    value, power, found, size = at(u), 0.0, 0.0, 1.0
    while power < 1.0:

        def lost(step, value=value):
            weight = step * value
            return np.exp(2 * logsumexp(weight) - logsumexp(2 * weight)) - SHARE * POINTS

        step = 1.0 - power if lost(1.0 - power) > 0 else brentq(lost, 1e-12, 1.0 - power)
        weight = step * value
        found += logsumexp(weight) - np.log(POINTS)
        power += step
        index = rng.choice(POINTS, POINTS, p=np.exp(weight - logsumexp(weight)))
        u, value = u[index], value[index]
        spread = np.cov(ndtri(np.clip(u, 1e-9, 1 - 1e-9)).T)
        root = np.linalg.cholesky(spread.reshape(2 * (len(limits),)))
        for _ in range(MOVES):
            # A walk in normal numbers of the same rank, whose prior is standard normal.
            x = ndtri(np.clip(u, 1e-12, 1 - 1e-12))
            y = x + size * 2.4 / np.sqrt(len(limits)) * rng.standard_normal(x.shape) @ root.T
            new = at(ndtr(y))
            ratio = power * (new - value) + 0.5 * np.sum(x**2 - y**2, axis=1)
            taken = np.log(rng.uniform(size=POINTS)) < ratio
            u[taken], value[taken] = ndtr(y[taken]), new[taken]
            size *= np.exp(taken.mean() - 0.25)
    return float(found)


def a_strip(folder):
    listed = '"modulus error", "density error", "added mass"'
    return write_strip(folder, *measured(strip()), f"effects = [{listed}]")


def a_lap(folder):
    listed = '"loose bolt", "joint normal and tangential compliance", "shear modulus error"'
    data = virtual_lap(factor=loose(1))
    return write_virtual_lap(folder, *data, f"effects = [{listed}]")


@pytest.mark.slow
@pytest.mark.parametrize("make", [a_strip, a_lap])
def test_evidence_is_what_a_sampler_finds(make, tmp_path):
    """Of no gap, of the effects that lead and of the first two at once, to 0.2 and the sampler's
    own scatter."""
    model = prepare(load_case(make(tmp_path)), MPI.COMM_SELF, QUIET)
    model.reduce(QUIET)
    library, test = Search(model, QUIET).library, model.evidence
    nothing = library.single(model.hypothesis(()), test)
    found = [library.single(model.hypothesis((e,)), test) for e in model.effects if not e.holds]
    found.sort(key=lambda f: -f.fit.log_evidence)
    other = next(f for f in found if f.fit.hypothesis.label != found[0].fit.hypothesis.label)
    both = found[0].fit.hypothesis.effects + other.fit.hypothesis.effects
    pair = library.add_effect(model.hypothesis(both), found[0], test)
    for first in (nothing, *found[:3], pair):
        h, at = first.fit.hypothesis, test.at(first.fit.scales)
        more = library.sampled(first, test).fit.log_evidence - first.fit.log_evidence
        ours = logsumexp(first.log_evidence) + more
        used, density = test.fitted, multivariate_normal(cov=at.covariance())

        def log_likelihood(z, h=h, used=used, density=density):
            data = library.predict(h, z)[0][:, used]
            good, value = np.isfinite(data).all(1), np.full(len(z), -1e9)
            value[good] = density.logpdf(data[good] - test.data[used])
            return value

        theirs = [sampled(log_likelihood, h.limits, seed) for seed in range(2)]
        scatter, off = abs(theirs[1] - theirs[0]), abs(ours - np.mean(theirs))
        assert scatter < 0.5 and off < 0.2 + scatter, (h.label, ours, theirs)
