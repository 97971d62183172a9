"""Defaults in PETSc's option database, for as long as an object reads them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["petsc_defaults"]


@contextmanager
def petsc_defaults(prefix: str, ours: Mapping[str, object]):
    """Options under ``prefix`` for a while; those of the command line stand above them."""
    options = PETSc.Options(prefix)
    new = {k: v for k, v in ours.items() if not options.hasName(k)}
    for key, value in new.items():
        options.setValue(key, value)
    try:
        yield
    finally:
        for key in new:
            options.delValue(key)
