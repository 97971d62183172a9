"""The page of the ``modes`` command."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from markupsafe import Markup

from fenics_joints.commands.modes.compared import Compared, condition_words
from fenics_joints.commands.modes.result import ModeList, ring_row
from fenics_joints.commands.modes.view import measured_arrows, modes_view
from fenics_joints.formatting import extents, hertz
from fenics_joints.report.html import mac_cells, render, svg
from fenics_joints.report.mesh_pictures import mode_shape
from fenics_joints.report.sensor_pictures import sensor_shapes


def modes_html(
    result: ModeList,
    shapes: Mapping[int, Markup] = MappingProxyType({}),
    pairs: Mapping[int, Markup] = MappingProxyType({}),
    view: Markup | None = None,
) -> str:
    """Modes as a page, with pictures of some of them, by index.

    Args:
        result: The modes.
        shapes: Pictures from `mesh_pictures.mode_shape`.
        pairs: Pictures from `sensor_pictures.sensor_shapes`: measured shapes beside the model's.
        view: Shapes to turn and to play, from `modes_view`.
    """
    visible, frequencies = result.visible, result.frequencies_hz
    return render(
        "modes.html",
        title=result.case.title,
        n_rigid=result.modes.n_rigid,
        rows=list(zip(frequencies, result.kinds(), strict=True)),
        dofs=result.modes.model.n_dofs,
        shapes=shapes,
        sensors=visible is not None,
        n_visible=0 if visible is None else int(np.sum(visible)),
        size=extents(result.size_m) if len(result.size_m) else "",
        rings=[ring_row(ring) for ring in result.rings],
        notes=result.notes,
        pairs=pairs,
        view=view,
        beside=_beside(result),
        at="" if result.beside is None else condition_words(result.beside),
    )


def _beside(result: ModeList) -> dict | None:
    """Pairs, their gap, and the matrix of MAC as coloured cells."""
    if result.beside is None:
        return None
    found = result.beside.to_json()
    matrix = result.beside.matrix
    cells = [] if matrix is None else mac_cells(matrix)
    return {**found, "cells": cells}


def modes_page(result: ModeList, *, n_shapes: int | None = 6) -> str:
    """The page of the ``modes`` command. Collective; empty on all ranks but the first.

    Args:
        result: The modes of a case.
        n_shapes: How many shapes to show: partners of the test's modes, then the lowest that the
            test could see, or the lowest elastic ones if the case does not say what it saw; None
            for all elastic modes.
    """
    modes, visible = result.modes, result.visible
    elastic = np.arange(len(modes)) >= modes.n_rigid
    partners = () if result.beside is None else [i for _, i in _partners(result.beside)]
    shown = elastic if visible is None or n_shapes is None else visible
    lowest = np.flatnonzero(shown).tolist()
    wanted = sorted(list(dict.fromkeys([*partners, *lowest]))[:n_shapes])
    vertices, motions = modes.model.corner_motion([modes.vector(int(i)) for i in wanted])
    beside = result.beside
    seen = None if beside is None or beside.sensors is None else modes.at(beside.sensors)
    if not len(vertices):
        return ""
    sensors = result.case.sensors()
    ways = [_mean_direction(sensors, motion) for motion in motions]
    shapes = {}
    for i, motion, way in zip(wanted, motions, ways, strict=True):
        hz = float(result.frequencies_hz[i])
        alt = f"Mode shape {i + 1} at {hz:.2f} Hz, coloured by its motion along {way.tolist()}."
        shapes[int(i)] = svg(mode_shape(vertices, motion, way, f"mode{i + 1}", alt))
    view = None
    if wanted:
        names = [f"mode {i + 1}, {hertz(float(result.frequencies_hz[i]))} Hz" for i in wanted]
        view = modes_view(vertices, motions, names, ways, *_measured(result, seen, wanted))
    return modes_html(result, shapes, _pairs(result, vertices, wanted), view)


def _measured(result: ModeList, seen: np.ndarray | None, wanted) -> tuple[dict, dict]:
    """Arrows of the test beside the modes that it measured, and what is said of them."""
    beside = result.beside
    if seen is None or beside.sensors.points.shape[1] != 3:
        return {}, {}
    arrows, notes = {}, {}
    for j, i in _partners(beside):
        if i not in wanted:
            continue
        own, scaled = seen[:, i], beside.model_shapes[:, j]
        factor = float(scaled @ own) / max(float(own @ own), 1e-300)
        if factor:
            k = wanted.index(i)
            arrows[k] = measured_arrows(beside.sensors, beside.test_shapes[:, j] / factor, own)
            notes[k] = (
                f"{beside.names[j]} of the test beside it, in the scale that brings both nearest; "
                f"MAC {beside.mac[j]:.3f}."
            )
    return arrows, notes


def _pairs(result: ModeList, vertices: np.ndarray, wanted) -> dict[int, Markup]:
    """Pictures of measured shapes beside the model's, by the index of the model's mode."""
    beside, own = result.beside, result.case.shapes()
    if beside is None or beside.sensors is None or beside.sensors.points.shape[1] != 3:
        return {}
    found = {}
    for j, i in _partners(beside):
        if i in wanted:
            alt = f"Arrows of {beside.names[j]} of the test and of mode {i + 1} at the sensors."
            picture = sensor_shapes(
                vertices,
                beside.sensors,
                beside.test_shapes[:, j],
                beside.model_shapes[:, j],
                f"pair{i + 1}",
                alt,
                () if own is None else own.lines,
            )
            found[i] = svg(picture)
    return found


def _partners(beside: Compared) -> list[tuple[int, int]]:
    """Numbers of the test's modes and of their partners in the model."""
    return [(int(j), int(beside.index[j])) for j in np.flatnonzero(beside.partnered)]


def _mean_direction(sensors, motion: np.ndarray) -> np.ndarray:
    """Direction along which the sensors measure; the axis of the largest motion without any."""
    if sensors is not None:
        way = np.zeros(3)
        mean = np.mean(sensors.directions, axis=0)
        way[: len(mean)] = mean
        if np.linalg.norm(way) > 0.5:
            return np.round(way / np.linalg.norm(way), 6)
    return np.eye(3)[int(np.argmax(np.sum(motion**2, axis=(0, 1))))]
