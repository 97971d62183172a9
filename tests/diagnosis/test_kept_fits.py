"""Fits kept in a file: taken up again, and never those of other data."""

from __future__ import annotations

import grp
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.kept_fits import KeptFits
from fenics_joints.errors import InputError

TEST = Evidence(np.ones(1), np.array([[5.0, np.nan]]), np.full((1, 2), 0.01), 0.01)
BASELINE = {"a.E": 1e9}


def test_a_stopped_run_goes_on(tmp_path):
    kept = KeptFits(tmp_path, TEST, BASELINE, writes=True)
    assert kept.start("a", 2) == []
    kept.add({"a": np.array([0.1, -1 / 3])})
    kept.add({"a": np.array([9.0, 9.0]), "none": np.zeros(0), "b": np.ones(3)})
    again = KeptFits(tmp_path, TEST, BASELINE, writes=False)
    assert np.array_equal(again.start("a", 2)[0], [9.0, 9.0])  # a better fit of it, later
    assert len(again.start("none", 0)) == 1
    # A hypothesis that has other parameters by now starts anew.
    assert again.start("b", 4) == [] and again.start("c", 3) == []
    again.add({"d": np.zeros(1)})
    (file,) = tmp_path.iterdir()
    lines = filter(None, file.read_text().splitlines())
    assert [json.loads(line)["label"] for line in lines] == ["a", "a", "none", "b"]


def test_a_line_that_was_cut_off_is_passed_over(tmp_path):
    """Wherever the run was stopped: all whole lines count."""
    KeptFits(tmp_path, TEST, BASELINE, writes=True).add({"a": np.ones(2), "b": np.ones(2)})
    (file,) = tmp_path.iterdir()
    whole = file.read_text().strip()
    for cut in range(len(whole.splitlines()[0]), len(whole)):
        file.write_text(whole[:cut])
        kept = KeptFits(tmp_path, TEST, BASELINE, writes=True)
        assert len(kept.start("a", 2)) == 1 and kept.start("b", 2) == []


def test_what_is_written_after_a_cut_off_line_counts(tmp_path):
    KeptFits(tmp_path, TEST, BASELINE, writes=True).add({"a": np.ones(2), "b": np.ones(2)})
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:-9])
    kept = KeptFits(tmp_path, TEST, BASELINE, writes=True)
    kept.add({"c": np.zeros(2), "d": np.zeros(2)})
    again = KeptFits(tmp_path, TEST, BASELINE, writes=False)
    assert again.start("a", 2) and again.start("d", 2) and again.start("c", 2)


def test_fits_are_taken_whatever_the_mask_unless_others_could_write_them(tmp_path, monkeypatch):
    """As where all users have one primary group."""
    shared = SimpleNamespace(gr_name="users", gr_mem=[])
    monkeypatch.setattr(grp, "getgrgid", lambda gid: shared)
    before = os.umask(0o002)
    try:
        KeptFits(tmp_path, TEST, BASELINE, writes=True).add({"a": np.ones(2)})
    finally:
        os.umask(before)
    kept = KeptFits(tmp_path, TEST, BASELINE, writes=True)
    assert len(kept.start("a", 2)) == 1 and kept.reason == ""
    (file,) = tmp_path.iterdir()
    other, size = tmp_path / "other", file.stat().st_size
    for change in (
        lambda: file.chmod(0o664),
        lambda: file.rename(other).chmod(0o644) or file.symlink_to(other),  # even to one's own
    ):
        change()
        refused = KeptFits(tmp_path, TEST, BASELINE, writes=True)
        refused.add({"b": np.ones(2)})
        assert refused.start("a", 2) == [] and str(file) in refused.reason
        assert file.stat().st_size == size


@pytest.mark.parametrize(
    "other",
    [
        (replace(TEST, log_f=TEST.log_f + 1e-9), BASELINE),
        (replace(TEST, conditions=np.array([2.0])), BASELINE),
        (replace(TEST, discrepancy=0.02), BASELINE),
        (TEST, {"a.E": 1.1e9}),
    ],
)
def test_other_data_or_another_model_start_anew(tmp_path, other):
    KeptFits(tmp_path, TEST, BASELINE, writes=True).add({"a": np.ones(2)})
    assert KeptFits(tmp_path, *other, writes=True).start("a", 2) == []


def test_nothing_is_kept_without_a_folder_and_a_bad_one_is_named(tmp_path):
    nowhere = KeptFits(None, TEST, BASELINE, writes=True)
    nowhere.add({"a": np.ones(2)})
    assert nowhere.start("a", 2) and not list(tmp_path.iterdir())
    lost = KeptFits(tmp_path / "gone", TEST, BASELINE, writes=True)
    with pytest.raises(InputError, match="fits-.*cannot be written"):
        lost.add({"a": np.ones(2)})
