"""Fits that are kept beside the database: taken for the very rows they are of, else made anew."""

from __future__ import annotations

import dataclasses
import grp
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.database import Joint, Kriging, Store, Surfaces, query, seed_database

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")
ROW = Joint(diameter=0.012, bolt="M12", force=7e4, thickness=0.02, radius=0.05)


@pytest.fixture
def fits(monkeypatch) -> list[str]:
    """What was fitted, in order."""
    done, fit = [], Kriging.fit

    def counted(*arguments, **options):
        done.append(options["output"])
        return fit(*arguments, **options)

    monkeypatch.setattr(Kriging, "fit", counted)
    return done


@pytest.fixture
def path(tmp_path):
    """A small database of one line of forces."""
    with Store(tmp_path / "own.db", create=True) as store:
        store.add(
            dataclasses.replace(ROW, force=1e4 * i, radius=0.03 + 2e-3 * i) for i in range(1, 7)
        )
    return tmp_path / "own.db"


def value(path) -> float:
    with Store(path, readonly=True) as store:
        surfaces = Surfaces.fit(store)
        return query(surfaces, bolt="M12", force=3.5e4, thickness=0.02).radius.value


def test_the_second_query_does_not_fit_and_says_the_same_until_a_row_comes(path, fits):
    first = value(path)
    assert (value(path), fits) == (first, ["radius"])
    assert sorted(p.name for p in path.parent.iterdir()) == ["own.db", "own.db.fits.json"]
    with Store(path) as store:
        store.add([ROW])
    assert value(path) != first and fits == ["radius"] * 2


def _changed(content: dict, **values) -> str:
    kept = next(iter(content["fits"].values()))
    (kept if "x" in values or "facets" in values else kept["members"][0]).update(values)
    return json.dumps(content)


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: "[" * 100_000,
        lambda text: text.replace("fenics-joints fits", "something else"),
        lambda text: text.replace('"version": 2', '"version": 1'),
        lambda text: _changed(json.loads(text), theta=[float("nan")] * 3),
        lambda text: _changed(json.loads(text), theta=[1.0]),
        lambda text: _changed(json.loads(text), kernel="other"),
        lambda text: _changed(json.loads(text), x=[[0.012, 1e4 * i, 0.03] for i in range(1, 7)]),
        lambda text: _changed(json.loads(text), facets=[[1.0]]),
        lambda text: _changed(json.loads(text), weight=0.123),  # by its checksum alone
    ],
)
def test_what_is_no_fit_of_these_rows_is_made_anew(path, fits, damage):
    first, file = value(path), path.with_name("own.db.fits.json")
    whole = file.read_text()
    file.write_text(damage(whole))
    assert value(path) == first and len(fits) == 2
    assert file.read_text() == whole


def test_fits_are_taken_whatever_the_mask_unless_others_could_write_them(
    path, fits, monkeypatch, caplog
):
    """As where all users have one primary group."""
    shared = SimpleNamespace(gr_name="users", gr_mem=[])
    monkeypatch.setattr(grp, "getgrgid", lambda gid: shared)
    before = os.umask(0o002)
    try:
        first = value(path)
    finally:
        os.umask(before)
    assert (value(path), len(fits)) == (first, 1)
    path.with_name("own.db.fits.json").chmod(0o664)
    assert (value(path), len(fits)) == (first, 2) and "own.db.fits.json" in caplog.text
    assert (value(path), len(fits)) == (first, 2)  # it was written anew


def test_where_nothing_can_be_kept_there_is_an_answer_all_the_same(path, fits):
    path.with_name("own.db.fits.json").mkdir()
    assert value(path) == value(path) and len(fits) == 2
    assert sorted(p.name for p in path.parent.iterdir()) == ["own.db", "own.db.fits.json"]


def test_the_published_tables_come_with_their_fit(fits):
    """If it is stale: write ``fits_text`` of new ones to ``seed000.fits.json``."""
    surfaces = Surfaces.fit(seed_database())
    assert fits == []
    for output, kept in surfaces.kriging.items():
        new = Kriging.fit(kept.x, kept.y, inputs=kept.inputs, output=output)
        found, expected = kept.predict(kept.x), new.predict(kept.x)
        assert np.abs(found.value - expected.value).max() < 0.1 * expected.sd.min()
        np.testing.assert_allclose(found.sd, expected.sd, rtol=0.1)
