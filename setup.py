"""Finds the packages, two of them beside the others' folder; all else is in pyproject.toml."""

from setuptools import find_packages, setup

#: Packages whose folders stand beside ``fenics_joints/``.
BESIDE = {"fenics_joints.forms": "forms", "fenics_joints.meshes": "meshes"}

packages = find_packages(include=["fenics_joints", "fenics_joints.*"])
for package, folder in BESIDE.items():
    packages += [package, *(f"{package}.{inner}" for inner in find_packages(folder))]

setup(packages=packages, package_dir=BESIDE)
