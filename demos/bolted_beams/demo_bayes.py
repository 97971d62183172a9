# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Two bolted beams: how sure are k1 and k2, and how much do specimens scatter?
#
# The paper behind this demo (Jalali et al. 2019, see `README.md`) tests 25 nominally equal pairs of
# beams and identifies the distribution of the joint's normal stiffness k1 ("slap") and tangential
# stiffness k2 ("slip"). It fits a distribution to each measured frequency over the specimens. Its
# likelihood is the product of these densities at the model's frequencies (eq. 8), and it samples
# with Metropolis-Hastings.
#
# The paper shows its raw data only in figures. Here 25 specimens are simulated from a known truth,
# which shows which method finds it: the paper's likelihood, by three samplers, or a hierarchical
# model, in which every specimen has its own k1 and k2.
#
# Run it with `./with-fenicsx python3 demos/bolted_beams/demo_bayes.py [PICTURE]`, on as many ranks
# as you like.

# +
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy import stats
from threadpoolctl import threadpool_limits

from fenics_joints.bayes import (
    FittedLikelihood,
    Gibbs,
    Level,
    Posterior,
    Settings,
    Specimens,
    calibrate,
    check_predictive,
    rank,
    replicate,
    sample,
    sample_hierarchy,
)
from fenics_joints.bayes.gibbs import curvature
from fenics_joints.bayes.simulated import FIGURE_7, anchored, simulate
from fenics_joints.bayes.walks import generator
from fenics_joints.case import load_case
from fenics_joints.case.bayes import specimens
from fenics_joints.commands.bayes.model import case_model

comm = MPI.COMM_WORLD
here = Path(__file__).parent
threadpool_limits(1)


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


case = load_case(here)
model = case_model(case, comm)
prior, frequencies = model.prior, model.frequencies
modes = tuple(f"mode {i}" for i in range(1, 6))
say(
    f"model: {model.n_basis} of {model.n_dofs} degrees of freedom, frequencies within "
    f"{100 * model.check.error:.0e} % at {model.check.n_points} points of the prior",
    *(f"prior: {line}" for line in prior.describe()),
)
# -

# ## Specimens from a known truth
#
# The medians are those of the paper's Table 2 at 23 N m. k1 and k2 scatter equally and
# independently, by the amount that gives mode 1 the standard deviation of Figure 7, 0.625 Hz.

# +
median, noise = np.array([1763.2, 37402.0]), 2e-4
mode, figure_7 = FIGURE_7[23]
slope = frequencies.log_slope(median)
truth = anchored(slope, median, mode - 1, figure_7.std() / figure_7.mean(), noise=noise)
table = simulate(frequencies, truth, 25, seed=2019)
scatter = np.sqrt(np.diag(truth.covariance))
say("", f"truth: k1 {median[0]} N m, k2 {median[1]:.0f} N m, scatter {100 * scatter[0]:.2f} %")
# The case's table, which `fenics-joints update --bayes` reads, has the same specimens.
assert np.allclose(table, specimens(case), atol=2e-3)
# -

# ## The paper's likelihood, by three samplers
#
# The first sampler is the paper's: Metropolis-Hastings with proposals from the prior, with 20,000
# samples of which 5,000 are discarded. The second is a random walk with adapted steps, the third is
# emcee with its ensembles.

# +
likelihood = FittedLikelihood.from_specimens(modes, table)
say("", *likelihood.describe())
posterior = Posterior(prior, frequencies, likelihood)
runs = {
    kind: sample(posterior, Settings(kind, samples, samples // 4), comm)
    for kind, samples in (("prior_metropolis", 20000), ("metropolis", 8000), ("emcee", 24000))
}


def show(title: str, rows: list[dict]) -> None:
    """A line for each quantity: ratios in per cent, but for correlations."""
    heading = f"{'mean':>10s}{'s.d.':>9s}{'5 %':>10s}{'95 %':>10s}{'R-hat':>8s}{'ESS':>7s}"
    say("", title, " " * 28 + heading)
    for r in rows:
        ratio = "." not in r["name"].partition(" ")[0] and not r["name"].startswith("correlation")
        factor, digits = (100, 3) if ratio else (1, 1 if r["mean"] > 10 else 2)
        numbers = "".join(
            f"{factor * r[key]:{width}.{digits}f}"
            for key, width in (("mean", 10), ("sd", 9), ("low", 10), ("high", 10))
        )
        ess = min(r["ess_bulk"], r["ess_tail"])
        say(f"{r['name'] + (', %' if ratio else ''):28s}{numbers}{r['rhat']:8.3f}{ess:7.0f}")


for kind, chains in runs.items():
    accepted = 100 * np.mean(chains.acceptance)
    show(f"{chains.sampler} ({kind}): {accepted:.0f} % accepted", chains.table())
    chains.require_converged()

means, sds = (
    np.array([getattr(chains.draws(), moment)(axis=0) for chains in runs.values()])
    for moment in ("mean", "std")
)
apart = np.ptp(means, axis=0) / sds.mean(axis=0)
say(
    "",
    f"means of the samplers differ by {apart[0]:.3f} and {apart[1]:.3f} standard deviations, "
    f"these by {100 * np.ptp(sds[:, 0]) / sds[0, 0]:.1f} and "
    f"{100 * np.ptp(sds[:, 1]) / sds[0, 1]:.1f} %",
    f"correlation of k1 and k2: {runs['metropolis'].correlation()[0, 1]:.2f}",
)
assert np.all(apart < 0.15)
# -

# ## The hierarchical model
#
# Each specimen has its own parameters. This separates the scatter of the specimens from the
# uncertainty of the mean. More specimens reduce the uncertainty, but not the scatter.

# +
data = Specimens(modes, table, noise=noise)
hierarchy = sample_hierarchy(data, prior, frequencies, Settings(samples=1200, burn_in=300), comm)
rows = {row["name"]: row for row in hierarchy.chains.require_converged().table()}
show("hierarchical", list(rows.values()))
stated = dict(zip(rows, [*median, *scatter, 0.0, noise], strict=True))
z = {name: (rows[name]["mean"] - value) / rows[name]["sd"] for name, value in stated.items()}
say(
    "from the truth, in standard deviations: "
    + ", ".join(f"{name} {value:+.1f}" for name, value in z.items())
)
assert max(abs(value) for value in z.values()) < 3
# -

# ## New specimens, beside the data
#
# The paper takes its posterior as the distribution of the specimens. New specimens drawn from it
# should then scatter and correlate like the data.

# +
checks = {
    "independent frequencies": check_predictive(
        modes, table, replicate(runs["metropolis"], frequencies, len(table))
    ),
    "hierarchical": check_predictive(modes, table, hierarchy.replicate(frequencies)),
}
for name, check in checks.items():
    say("", name, *check.words())
    first, last = check.correlation_low[0, 4], check.correlation_high[0, 4]
    say(
        f"correlation of modes 1 and 5: {check.correlation_median[0, 4]:.2f} "
        f"({first:.2f} to {last:.2f}); measured {check.correlation[0, 4]:.2f}"
    )
assert checks["independent frequencies"].p_sd < 0.025 < checks["hierarchical"].p_sd
# -

# ## Is it chance?
#
# The comparison is repeated with other sets of 25 specimens. They come from a closed-form model
# with the same sensitivities as the beams. It is linear in the flexibilities, as the beams nearly
# are. In half of the sets k1 and k2 have a correlation of 0.8.


# +
def flexible(x: np.ndarray) -> np.ndarray:
    """ln f minus a constant, at the logarithms of k1 and k2 over their medians."""
    return -np.expm1(-x) @ slope.T


def closed_form(values: np.ndarray) -> np.ndarray:
    """ln f at k1 and k2."""
    return np.log(table.mean(axis=0)) + flexible(np.log(values / median))


SETS = 6
say("", f"independent frequencies, {SETS} sets each: mean correlation of two modes, and scatter")
for together in (0.0, 0.8):
    covariance = truth.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = together * covariance[0, 0]
    others = []
    for seed in range(SETS):
        own = simulate(closed_form, replace(truth, covariance=covariance), 25, seed=seed)
        fits = FittedLikelihood.from_specimens(modes, own, ["normal"], accept_misfit=True)
        chains = sample(
            Posterior(prior, closed_form, fits), Settings(samples=4000, burn_in=1000), comm
        )
        others.append(check_predictive(modes, own, replicate(chains, closed_form, 25)))
    measured, new = np.mean([check.mean_correlation for check in others], axis=0)
    under = sum(check.p_correlation < 0.025 for check in others)
    ratio = np.mean([check.sd_median / check.sd for check in others])
    say(
        f"k1 and k2 correlate by {together}: measured {measured:.2f}, new specimens {new:.2f}, "
        f"under-stated in {under} of {SETS}; new specimens scatter {ratio:.2f} times as much"
    )
    assert new < measured and ratio < 0.6
# -

# ## Are the intervals calibrated?
#
# Truths are drawn from the priors, and data are simulated from each. The rank of the truth among
# draws of the posterior must be uniform, and intervals must contain the truth as often as stated.
# All data sets are sampled at once, with the closed-form model, and shared among the MPI ranks.

# +
N, S, SCATTER, NOISE, OFFSET, SD = 120, 8, 0.03, 1e-3, 1e-3, 0.05


def calibration_set() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Data, shape (N, S, 5), and the truths from which they were simulated."""
    rng = np.random.default_rng(12)
    mu = rng.normal(0, SD, (N, 2))
    aux = stats.invgamma(0.5, scale=1 / SCATTER**2).rvs((N, 2), random_state=rng)
    sigma = np.array([stats.invwishart(3, 4 * np.diag(1 / a)).rvs(random_state=rng) for a in aux])
    tau, b = np.abs(NOISE * rng.standard_cauchy(N)), rng.normal(0, OFFSET, (N, 5))
    x = mu[:, None] + np.einsum(
        "npq,nsq->nsp", np.linalg.cholesky(sigma), rng.standard_normal((N, S, 2))
    )
    log_f = flexible(x) + b[:, None] + tau[:, None, None] * rng.standard_normal((N, S, 5))
    sd = np.sqrt(np.diagonal(sigma, axis1=1, axis2=2))
    rho = sigma[:, 0, 1] / sd.prod(axis=1)
    return log_f, {
        "k1": mu[:, 0],
        "k2": mu[:, 1],
        "scatter k1": sd[:, 0],
        "scatter k2": sd[:, 1],
        "correlation": rho,
        "noise": tau,
        "offset mode 5": b[:, 4],
    }


log_f, truths = calibration_set()
zero, spread = np.zeros(2), np.full(2, SD)
level = Level(
    lambda mu: -0.5 * np.sum(mu**2, axis=1) / SD**2,
    flexible,
    zero,
    slope,
    np.zeros(5),
    zero,
    spread,
    SCATTER,
    NOISE,
    False,
    OFFSET,
    curvature(flexible, zero),
)
mine = range(comm.rank, N, comm.size)
walk = Gibbs(level, log_f[list(mine)], [generator(4, c) for c in mine])
walk.advance(200)
points = walk.advance(800)[0]
sd1, sd2 = np.sqrt(points[:, :, 2]), np.sqrt(points[:, :, 4])
draws = [
    points[:, :, 0],
    points[:, :, 1],
    sd1,
    sd2,
    points[:, :, 3] / (sd1 * sd2),
    points[:, :, 5],
    points[:, :, 10],
]
say("", f"{N} sets of {S} specimens" + f"{'50 %':>18s}{'90 %':>8s}   ranks, from low to high")
evenness = []
for (name, values), chain in zip(truths.items(), draws, strict=True):
    own = [rank(values[c], chain[k], 39) for k, c in enumerate(mine)]
    found = calibrate(np.concatenate(comm.allgather(own)), 39)
    evenness.append(found.p_value)
    counts = " ".join(f"{c:2d}" for c in found.counts)
    say(
        f"{name:28s}{100 * found.covered_half:10.0f}{100 * found.covered:8.0f}   {counts}"
        f"   p = {found.p_value:.2f}"
    )
# The smallest p-value of seven tests is below 0.002 once in seventy times.
assert min(evenness) > 0.002
# -

# ## A picture

if comm.rank == 0 and len(sys.argv) > 1:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    new = hierarchy.new_specimens(800, 1)[0][:, 0]
    some = runs["metropolis"].draws()[::30]
    mean = hierarchy.chains.draws()[::6, :2]
    rng = np.random.default_rng(0)
    made = np.exp(rng.multivariate_normal(np.log(median), truth.covariance, 800))
    for values, colour, label in (
        (made, "0.75", "specimens, as simulated"),
        (new, "C0", "new specimens, hierarchical"),
        (some, "C1", "independent frequencies"),
        (mean, "C3", "mean of the specimens"),
    ):
        left.plot(values[:, 0], values[:, 1] / 1e3, ".", color=colour, ms=3, alpha=0.5, label=label)
    left.set(xlabel="k1, N m", ylabel="k2, kN m")
    left.plot(*median / [1, 1e3], "k+", ms=12, label="truth: median")
    left.legend(markerscale=1.5, loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2)
    pairs = np.triu_indices(5, 1)
    names = [f"{i + 1}, {j + 1}" for i, j in zip(*pairs, strict=True)]
    places = np.arange(len(names))
    own = checks["hierarchical"].correlation[pairs]
    right.plot(places, own, "_", color="0.5", ms=16, mew=2.5, label="measured (simulated)")
    for k, (name, check) in enumerate(checks.items()):
        low, mid, high = (
            getattr(check, f"correlation_{key}")[pairs] for key in ("low", "median", "high")
        )
        at, colour = places + 0.3 * (0.5 - k), f"C{1 - k}"
        right.vlines(at, low, high, color=colour, label=f"{name}, 90 %")
        right.plot(at, mid, "o", color=colour, ms=4)
    right.set(xlabel="modes", ylabel="correlation of frequencies", xticks=places)
    right.set_xticklabels(names)
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3)
    figure.savefig(sys.argv[1], dpi=120)
