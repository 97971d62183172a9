"""Folders of one user alone, and what libraries would read of a stranger's folder."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from mpi4py import MPI

from fenics_joints.machine.private import cache_folder, changed_by_others, private_folder

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")


@serial
@pytest.mark.parametrize("how", ["written by all", "by another user", "above", "linked"])
def test_code_is_loaded_from_ones_own_folder_only(tmp_path, how, caplog, monkeypatch):
    """What others could write to is not used, nor where they could put another in its place."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    temporary.chmod(0o1777)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    above = tmp_path / "above"
    folder = above / "cache"
    assert private_folder(folder) == folder and folder.stat().st_mode & 0o777 == 0o700
    assert above.stat().st_mode & 0o777 == 0o700
    if how == "by another user":
        if os.geteuid():
            pytest.skip("only root can give folders away")
        os.chown(folder, 1234, -1)
    elif how == "linked":
        (above / "to").symlink_to(folder)
        folder = above / "to"
        assert private_folder(folder) == above / "cache"  # of one's own, and used as such
        (above / "cache").chmod(0o777)
    else:
        (folder if how == "written by all" else above).chmod(0o777)
    with pytest.raises(PermissionError):
        private_folder(folder)
    with caplog.at_level(logging.WARNING):
        lasting = cache_folder(folder)
        assert lasting == private_folder(temporary / f"fenics_joints_{os.geteuid()}" / folder.name)
        cache_folder.cache_clear()
        assert (cache_folder(folder), caplog.text) == (lasting, "")  # the next run's, too
        cache_folder.cache_clear()
        lasting.parent.chmod(0o777)  # as if another user had been there first
        fresh = cache_folder(folder)
    assert fresh.stat().st_mode & 0o777 == 0o700
    assert fresh not in (folder.resolve(), lasting) and str(folder) in caplog.text
    if how == "above":
        above.chmod(0o1777)  # as /tmp is: what is in it stays its owner's
        assert private_folder(folder) == folder


def test_an_unknown_owner_is_trusted_in_a_container_only():
    """Elsewhere the number may be somebody's, as of "nobody"."""
    status = SimpleNamespace(st_uid=65534, st_gid=65534, st_mode=0o40755)
    users = Path("/proc/self/uid_map")
    contained = users.exists() and int(users.read_text().split()[2]) < 2**32 - 1
    assert bool(changed_by_others(status, above=True)) is not contained
    assert changed_by_others(status)


@serial
@pytest.mark.parametrize("command", [True, False], ids=["command", "script"])
def test_only_scripts_take_settings_from_the_working_folder(tmp_path, command):
    """PETSc would load a library, the compiler of forms run a program, matplotlib change."""
    (tmp_path / "petscrc").write_text("-from_petscrc 1\n")
    (tmp_path / "matplotlibrc").write_text("figure.dpi: 7\n")
    libraries = '{"cffi_libraries": ["from_strangers"]}'
    (tmp_path / "dolfinx_jit_options.json").write_text(libraries)
    code = f"""
import os, sys
import fenics_joints
if {command}:
    from fenics_joints.cli import main
    sys.argv = ["fenics-joints", "schema"]
    try:
        main()
    except SystemExit:
        pass
from fenics_joints.machine import form_cache
form_cache.install()
import matplotlib, dolfinx, ufl
from mpi4py import MPI
from petsc4py import PETSc
mesh = dolfinx.mesh.create_unit_interval(MPI.COMM_SELF, 2)
try:
    one = dolfinx.fem.form(dolfinx.fem.Constant(mesh, 1.0) * ufl.dx)
    made = dolfinx.fem.assemble_scalar(one) == 1
except Exception:
    made = False
print("settings:", not made, matplotlib.rcParams["figure.dpi"] == 7,
      any("petscrc" in name for name in PETSc.Options().getAll()), os.getcwd())
"""
    env, line = {**os.environ, "XDG_CACHE_HOME": f"{tmp_path}/cache"}, [sys.executable, "-c", code]
    done = subprocess.run(line, cwd=tmp_path, text=True, capture_output=True, env=env)
    assert done.returncode == 0, done.stderr
    found = done.stdout.partition("settings: ")[2].splitlines()[0].split()
    assert found == [*[str(not command)] * 3, str(tmp_path)]
