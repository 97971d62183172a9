"""The jointed structure, linear about a preload state: stuck, sliding or open, or springs.

Vibration of small amplitude neither opens a pressed contact nor makes it slide much, so about a
preload state each pair is stuck, slides freely or is open (Fronk et al. 2019, section 2.2), or has
springs that stiffen with the pressure (Tian et al. 2021, eqs. 22-25). In the unknowns of
`fenics_joints.structure.jumps` that holds entries of x at zero, or adds to the diagonal.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.preload.components import Obstacle
from fenics_joints.preload.conditions import OPEN, SLIP, STICK
from fenics_joints.preload.contact_state import PRESSES, ContactState
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.solve import PreloadResult
from fenics_joints.structure.faces import Interface
from fenics_joints.structure.points import Sensors


def status_conditions(result: PreloadResult) -> dict[str, np.ndarray]:
    """Condition of every pair of every contact as the preload left it, by contact, (n,).

    OPEN, SLIP (closed and free to slide: slipping, or without friction) or STICK.
    """
    return {name: state.status.copy() for name, state in result.contacts.items()}


def stuck_conditions(result: PreloadResult) -> dict[str, np.ndarray]:
    """Conditions of obstacles, (n,) each, for contacts that are stuck all over.

    Obstacles are held where the preload presses on them; the rest of the face does not touch them.
    """
    names = [c.name for c in result.model.contacts if isinstance(c, Obstacle)]
    return {name: np.where(result[name].closed, STICK, OPEN) for name in names}


def cutoff_conditions(state: ContactState, cutoff: float, scheme: str = "two") -> np.ndarray:
    """Condition of every facet by pressure and cut-off (Fronk et al. 2019, eqs. 1-5), (n_facets,).

    Args:
        state: A contact in a preload state.
        cutoff: Cut-off pressure p_i, Pa; a facet with that pressure or more is stuck.
        scheme: ``"three"``: below it a pressed facet slides and one without pressure is open;
            ``"two"``: below it all are open.

    Raises:
        InputError: For another scheme.
    """
    if scheme not in ("two", "three"):
        raise InputError(f"scheme = {scheme!r}: expected 'two' or 'three'.")
    p = state.facet_pressure
    below = OPEN if scheme == "two" else SLIP
    pressed = p > PRESSES * p.max(initial=0.0)
    # A facet without pressure is open at any cut-off, zero too.
    return np.where(pressed, np.where(p >= cutoff, STICK, below), OPEN)


def pair_conditions(interface: Interface, facets: np.ndarray) -> np.ndarray:
    """Condition of every pair, (n,): the strongest of its facets'."""
    found = np.full(len(interface), OPEN)
    np.maximum.at(found, interface.facets, np.asarray(facets)[:, None])
    return found


def pressure_stiffness(
    state: ContactState, normal: tuple[float, float], tangential: tuple[float, float]
) -> np.ndarray:
    """Springs at every pair from its pressure, K = alpha P^beta (Tian et al. 2021, eqs. 22-25).

    Args:
        state: A contact in a preload state.
        normal: alpha_n, (Pa/m)/Pa^beta_n, and beta_n.
        tangential: alpha_t and beta_t.

    Returns:
        Normal and tangential stiffness of each pair, N/m, (n, 2); zero without pressure.
    """
    p, areas = np.maximum(state.pressure, 0.0), state.interface.areas
    columns = []
    for name, (alpha, beta) in (("normal", normal), ("tangential", tangential)):
        if not (alpha >= 0 and beta > 0):
            raise InputError(f"{name} = {(alpha, beta)}: expected alpha >= 0 and beta > 0.")
        columns.append(alpha * p**beta * areas)
    return np.column_stack(columns)


class LinearJoint:
    """A preloaded structure whose contacts are linear; a `fenics_joints.structure.model.Pictured`.

    Args:
        model: Bodies, contacts and bolts; beams resist stretching here and have mass.
        conditions: OPEN, SLIP or STICK at every pair, (n,), by contact; all stuck if None, and
            contacts that are left out.
        springs: Stiffness of every pair, N/m, (n, 2), by contact: normal and tangential. Such a
            contact is free but for them.

    Raises:
        InputError: For an unknown contact or an array of the wrong shape.

    Attributes:
        parameters: The structure's parameters.
    """

    #: See `fenics_joints.structure.model.Model`.
    is_dense, is_meshed = False, False

    def __init__(
        self,
        model: PreloadModel,
        conditions: Mapping[str, np.ndarray] | None = None,
        springs: Mapping[str, np.ndarray] | None = None,
    ):
        self.model, self.structure = model, model.structure
        self.jumps = model.jumps
        self.parameters, self.values = self.structure.parameters, self.structure.values
        self.rings, self.gdim = self.structure.rings, self.structure.gdim
        self.springs = self._checked("springs", springs, 2)
        given = self._checked("conditions", conditions, 1)
        self.conditions = {
            c.name: given.get(c.name, np.full(len(c), STICK)) for c in self.jumps.contacts
        }
        for name in self.springs:
            self.conditions[name] = np.full(len(self.springs[name]), OPEN)
        self._cache: dict[tuple, tuple[PETSc.Mat, PETSc.Mat]] = {}

    def _checked(self, what: str, given, ndim: int) -> dict[str, np.ndarray]:
        sizes = {c.name: len(c) for c in self.jumps.contacts}
        found = {}
        for name, array in (given or {}).items():
            array = np.asarray(array)
            if name not in sizes:
                raise InputError(
                    f"{what}: there is no contact {name!r}; expected: {', '.join(sizes)}."
                )
            shape = (sizes[name],) if ndim == 1 else (sizes[name], 2)
            if array.shape != shape:
                raise InputError(f"{what}[{name!r}] has shape {array.shape}: expected {shape}.")
            found[name] = array
        return found

    def change(self, conditions=None, springs=None) -> LinearJoint:
        """The same model in another state; assembled matrices are shared."""
        other = LinearJoint(self.model, conditions, springs)
        other._cache = self._cache
        return other

    # -- matrices ----------------------------------------------------------------------------

    def free_matrices(self, given: Mapping[str, float] | None = None):
        """(K, M) in x with every jump free; kept, and not to be changed. Collective."""
        key = tuple(sorted((given or {}).items()))
        if key not in self._cache:
            for pair in self._cache.values():
                for A in pair:
                    A.destroy()
            self._cache.clear()
            K, M = self.model.stiffness(given, axial=True), self.model.mass(given)
            for A in (K, M):
                A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            self._cache[key] = (K, M)
        return self._cache[key]

    def held(self, conditions: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
        """Global numbers in x that conditions hold at zero, the same on all ranks."""
        conditions = self.conditions if conditions is None else conditions
        numbers = [np.empty(0, dtype=np.int64)]
        for c in self.jumps.contacts:
            at, pairs = conditions[c.name], self.jumps.numbers(c)
            numbers.append(pairs[at >= SLIP, 0])
            numbers.append(pairs[at == STICK, 1:].ravel())
            if c.name in self.springs:
                # Springs act on vertices; between two of them the jump is linear.
                at = np.where((self.springs[c.name] > 0).any(axis=1), STICK, OPEN)
            ends = at[c.edges].min(axis=1) if len(c.edges) else np.empty(0, int)
            bubbles = self.jumps.bubbles(c)
            numbers.append(bubbles[ends >= SLIP, 0])
            numbers.append(bubbles[ends == STICK, 1:].ravel())
        return np.concatenate(numbers)

    def stiffness(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """Stiffness in x; rows of held entries are the identity's."""
        K = self.free_matrices(given)[0].copy()
        K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        for c in self.jumps.contacts:
            if c.name in self.springs:
                self._add_springs(K, c, self.springs[c.name])
        self._hold(K, 1.0)
        return K

    def mass(self, given: Mapping[str, float] | None = None) -> PETSc.Mat:
        """Mass in x; rows of held entries are zero."""
        M = self.free_matrices(given)[1].copy()
        M.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._hold(M, 0.0)
        return M

    def _hold(self, A: PETSc.Mat, diagonal: float) -> None:
        numbers = self.held()
        mine = np.union1d(numbers[self.jumps.owned(numbers)], self.model.supported)
        mine = mine.astype(np.int32)
        A.zeroRowsColumns(mine, diag=diagonal)

    def _add_springs(self, K: PETSc.Mat, c: Interface, springs: np.ndarray) -> None:
        diagonal = K.createVecRight()
        diagonal.set(0.0)
        values = springs[:, [0, *[1] * (self.gdim - 1)]]
        self.jumps.put(diagonal.array, self.jumps.numbers(c), values)
        K.setDiagonal(diagonal, addv=PETSc.InsertMode.ADD_VALUES)
        diagonal.destroy()

    # -- the calls of a structure --------------------------------------------------------------

    @property
    def size_m(self) -> np.ndarray:
        """Extents of the mesh, m. Collective."""
        return self.structure.size_m

    @property
    def n_dofs(self) -> int:
        """Size of x, held entries included."""
        return self.jumps.n

    def dilation_frequency(self, given: Mapping[str, float] | None = None) -> float:
        """See `Structure.dilation_frequency`; of the parts alone."""
        return self.structure.dilation_frequency(given)

    def total_mass(self, given: Mapping[str, float] | None = None) -> float:
        """Mass, kg, of parts, point masses, and bolts that are beams."""
        return self.structure.total_mass(given) + sum(map(self.model.bolt_mass, self.model.beams))

    def displacements(self, shapes) -> list[PETSc.Vec]:
        """Displacements u = T x of vectors x. Collective."""
        return [self.jumps.T * x for x in shapes]

    def corner_motion(self, shapes) -> tuple[np.ndarray, np.ndarray]:
        """See `Structure.corner_motion`. Collective."""
        return self.structure.corner_motion(self.displacements(shapes))

    def displacement(self, x: PETSc.Vec) -> fem.Function:
        """Displacement u = T x as a function."""
        return self.jumps.displacement(x)

    def observe(self, shapes, sensors: Sensors) -> np.ndarray:
        """Displacements at sensors, shape (n_sensors, n_shapes), equal on all ranks."""
        return self.structure.observe(self.displacements(shapes), sensors)

    def pencil_gradients(self, shapes, eigenvalues, given=None) -> np.ndarray:
        """See `Structure.pencil_gradients`; springs and bolts do not depend on the parameters."""
        return self.structure.pencil_gradients(self.displacements(shapes), eigenvalues, given)
