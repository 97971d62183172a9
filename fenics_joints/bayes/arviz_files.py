"""ArviZ, old (0.17 on) and new (1 on): convergence numbers and NetCDF files of chains.

The one module that knows of both: version 1 needs Python 3.12 and has other calls.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.files import sealed, unsealed

_GROUPS = ("posterior", "sample_stats")


def arviz():
    """The library.

    Raises:
        InputError: If it is not installed.
    """
    try:
        import arviz
        import h5netcdf  # noqa: F401  (what writes the files)
    except ImportError as error:
        raise InputError(
            f"Bayesian identification needs ArviZ and h5netcdf, and {error.name} is not installed: "
            "expected pip install 'fenics-joints[bayes]'."
        ) from error
    return arviz


def convergence(draws: np.ndarray) -> dict[str, float]:
    """Rank-normalised split R-hat and effective sample sizes (Vehtari et al., Bayesian Anal. 2021).

    Args:
        draws: Of one quantity, (n_chains, n_draws).

    Returns:
        rhat, ess_bulk, ess_tail; nan where they are not defined.
    """
    if draws.shape[1] < 4:
        return dict.fromkeys(("rhat", "ess_bulk", "ess_tail"), float("nan"))
    az = arviz()
    return {
        "rhat": float(az.rhat(draws)),
        "ess_bulk": float(az.ess(draws)),
        "ess_tail": float(az.ess(draws, method="tail", prob=(0.05, 0.95))),
    }


def data_tree(draws: Mapping[str, np.ndarray], statistics: Mapping[str, np.ndarray]):
    """What ArviZ writes: draws and the sampler's statistics by name, (n_chains, n_draws)."""
    az, groups = arviz(), {"posterior": dict(draws)}
    if statistics:
        groups["sample_stats"] = dict(statistics)
    is_old = int(az.__version__.split(".")[0]) < 1
    return az.from_dict(**groups) if is_old else az.from_dict(groups)


def quantile_ess(draws: np.ndarray, quantiles: np.ndarray) -> np.ndarray:
    """Effective sample sizes of one quantity, (n_chains, n_draws), at each quantile."""
    az = arviz()
    return np.array([float(az.ess(draws, method="quantile", prob=q)) for q in quantiles])


def write_chains(
    path: Path,
    draws: Mapping[str, np.ndarray],
    statistics: Mapping[str, np.ndarray],
    resume: Mapping[str, object],
) -> None:
    """Write chains, whole or not at all.

    Args:
        path: The file.
        draws: By name, (n_chains, n_draws); none yet in the burn-in.
        statistics: Of the sampler, likewise.
        resume: What the chains go on from, for JSON.

    Raises:
        InputError: If it cannot be written.
    """
    import h5py

    with sealed(path) as part:
        if draws:
            data_tree(draws, statistics).to_netcdf(str(part), engine="h5netcdf")
        with h5py.File(part, "a") as file:
            file.create_dataset("resume/state", data=json.dumps(resume))


def read_chains(path: Path) -> tuple[dict, dict, dict]:
    """Draws, the sampler's statistics and what to go on from, as `write_chains` has written them.

    In the burn-in there are no draws yet.

    Raises:
        InputError: If the file is not one of these chains.
    """
    import h5py
    import xarray

    try:
        with unsealed(path) as content:
            with h5py.File(content, "r") as file:
                resume = json.loads(file["resume/state"].asstr()[()])
                there = [group for group in _GROUPS if group in file]
            found = []
            for group in there:
                with xarray.open_dataset(content, group=group, engine="h5netcdf") as data:
                    found.append({str(k): np.array(v.values) for k, v in data.data_vars.items()})
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise InputError(
            f"{path}: is not a file of chains that can go on ({error}); expected one that "
            "--keep wrote, or a new name"
        ) from error
    return (found[0], found[1], resume) if found else ({}, {}, resume)
