"""Folders of one user alone, and what libraries would read of a stranger's folder."""

from __future__ import annotations

import logging
import os
import subprocess
import sys

import pytest
from mpi4py import MPI

from fenics_joints.machine.private import cache_folder, private_folder

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")


@serial
@pytest.mark.parametrize("how", ["written by all", "by another user", "above", "linked"])
def test_code_is_loaded_from_ones_own_folder_only(tmp_path, how, caplog):
    """What others could write to is not used, nor where they could put another in its place."""
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
        fresh = cache_folder(folder)
    assert fresh.stat().st_mode & 0o777 == 0o700 and fresh != folder.resolve()
    assert str(folder) in caplog.text
    if how == "above":
        above.chmod(0o1777)  # as /tmp is: what is in it stays its owner's
        assert private_folder(folder) == folder


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
from fenics_joints import _compat
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
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, text=True, capture_output=True,
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = done.stdout.partition("settings: ")[2].splitlines()[0].split()
    assert found == [*[str(not command)] * 3, str(tmp_path)]
