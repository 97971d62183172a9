"""How far contact opens: twice as far as it pulls.

Near the edge of a contact that reaches a distance e too far, the pressure at a distance s inside is
B (s - e/2) / sqrt(s) with some B (of Hertz's line contact, held to a half-width a:
p ~ (a*^2 + a^2 - 2 x^2) / sqrt(a^2 - x^2); Johnson, Contact Mechanics, 1985, section 4.2; at other
edges of elastic bodies the singular parts are the same). Newton's method on the conditions opens
what pulls, s < e/2, and so halves e in each step: the more steps, the finer the mesh. Twice that is
right at once, up to higher powers of e. In Hertz's contact it is at most 0.42 of the half-width
that presses, however large a is; what pulls further than half of that is not near an edge.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fenics_joints.structure.faces import Interface


def beyond(interface: Interface, was: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Pairs that press but are to open like those next to them that pull, as a mask, (n,).

    Args:
        interface: The pairs.
        was: Which were closed in the solution, (n,).
        closed: Which of them press in it, (n,).
    """
    points, facets = interface.points, interface.facets
    found, kept, pull = np.zeros(len(points), dtype=bool), was & closed, was & ~closed
    if was.all() or not (kept.any() and pull.any()):
        return found
    # The edge is half a spacing from the open pair that is nearest.
    spacing = cKDTree(points).query(points[pull], 2)[0][:, 1]
    reach = cKDTree(points[~was]).query(points[pull])[0] - 0.5 * spacing
    corners = np.repeat(np.arange(len(facets)), facets.shape[1]), facets.ravel()
    links = scipy.sparse.csr_array((np.ones(facets.size), corners), (len(facets), len(points)))
    links, pressed = links[:, kept], cKDTree(points[kept])
    n, island = connected_components(links.T @ links)
    depth = np.zeros(n)
    np.maximum.at(depth, island, cKDTree(points[pull]).query(points[kept])[0])
    near = reach < 0.5 * depth[island[pressed.query(points[pull])[1]]]
    for at in pressed.query_ball_point(points[pull][near], reach[near]):
        found[np.flatnonzero(kept)[at]] = True
    return found
