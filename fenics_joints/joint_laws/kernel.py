"""A joint law as compiled code, for harmonic balance and time integration.

The law's UFL is differentiated by UFL and written as C, which runs whole histories of all points
and elements in one call. Compiled laws are kept in the user's cache folder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, JointsError
from fenics_joints.joint_laws.law import JointLaw, is_rated
from fenics_joints.joint_laws.source import law_source
from fenics_joints.machine.c_code import compiled

_DECLARATIONS = """
int law_step(int P, int E, const double *e, const double *s, const double *p, double *f,
             double *sn, double *tangent);
int law_history(int P, int T, int E, const double *e, double *s, const double *p, double *f);
int law_slopes(int P, int T, int E, const double *e, double *s, const double *p, double *fe,
               double *fs, double *ne, double *ns);
int law_switch_count(void);
int law_events(int P, int E, int K, int T, int panels, int order, const double *Z, const double *Zd,
               const double *synthesis, const double *p, const double *nodes,
               const double *weights, double *F, double *J);
int law_harmonic(int P, int E, int K, int T, int cycles, int exact, int order,
                 const double *X, const double *Xd, const double *synthesis, const double *rules,
                 const double *p, double *s, double *begun, double *F, double *J);
"""
#: Samples that a panel of Gauss's rule replaces, and nodes in it: at 8 H samples or more, what a
#: Jacobian integrates, up to twice the highest harmonic, goes through 2 pi in a panel.
_PANEL, _GAUSS = 4, np.polynomial.legendre.leggauss(8)
#: Gauss's rules, from 0 to 1, of 1 to 6 nodes between two steps of a law with memory; `cycles.c`
#: takes as many nodes as the harmonics of a piece need.
_CYCLE_ORDER = 6
_CYCLE_RULES = np.concatenate(
    [
        np.concatenate([0.5 * (nodes + 1), 0.5 * weights])
        for nodes, weights in map(np.polynomial.legendre.leggauss, range(1, _CYCLE_ORDER + 1))
    ]
)
_kernels: dict[str, LawKernel] = {}


@dataclass(frozen=True)
class HarmonicStress:
    """Stress of interface points whose strain is a Fourier series.

    Attributes:
        coefficients: Harmonics of the last cycle's stress, (P, d, K).
        jacobian: Their derivative by those of the strain, (P, d, K, d, K); None if not asked for.
        strain: Strain at the samples of a cycle, (P, T, d); None if not asked for.
        stress: Stress at the samples of the last cycle, (P, T, d), likewise.
        state: States at its end, (P, E, m).
        closure: Change of the states over the last cycle, relative to the largest of them: zero
            when the cycle is closed.
        by_omega: Derivative of the coefficients by the frequency of the motion, (P, d, K), of a law
            with the rate of strain; else None.
    """

    coefficients: np.ndarray
    jacobian: np.ndarray | None
    strain: np.ndarray | None
    stress: np.ndarray | None
    state: np.ndarray
    closure: float
    by_omega: np.ndarray | None = None


class LawKernel:
    """The compiled elements of a law; make one with `LawKernel.of`.

    Values of the law's parameters are given to every call, from `JointLaw.values`; strains are
    ordered normal component (if any) first, then the tangential ones.

    Args:
        law: The law; only its UFL and the names of its parameters matter here.
        n_slip: Number of tangential components, 1 or 2.
        normal: Whether the strain has a normal component.
        source: The law's C source, if it has been written already, which takes a second.

    Attributes:
        d: Components of strain.
        m: Numbers of state per element.
        n_parameters: Number of parameters of an element.
        rated: Whether the law asks for the rate of strain; then ``strain`` is (strain, rate) side
            by side in all calls, and tangents are by both.
        n_switches: Numbers of an element whose signs choose between branches of the law.
    """

    def __init__(self, law: JointLaw, n_slip: int, normal: bool, source: str | None = None):
        self.d, self.m = n_slip + normal, law.state_size(n_slip)
        self.exact = n_slip == 1 and law.exact_steps
        self.n_parameters = len(law.parameters)
        self.rated = is_rated(law)
        self.inputs = self.d * (1 + self.rated)
        self._library = compiled(source or law_source(law, n_slip, normal), _DECLARATIONS, "law")
        self.n_switches = int(self._library.lib.law_switch_count())

    @staticmethod
    def of(law: JointLaw, n_slip: int, normal: bool) -> LawKernel:
        """The kernel of a law; compiled once for all laws of the same form.

        Raises:
            InputError: If the law cannot be compiled: not a function of strain and state alone, or
                a result of the wrong shape.
        """
        kernel = law.__dict__.get(_key(n_slip, normal))
        if kernel is None:
            source = law_source(law, n_slip, normal)
            if source not in _kernels:
                _kernels[source] = LawKernel(law, n_slip, normal, source)
            kernel = law.__dict__[_key(n_slip, normal)] = _kernels[source]
        return kernel

    def _begin(self, strain, ndim: int, state, values):
        """Checked, contiguous copies of strain, state and values."""
        strain = np.ascontiguousarray(strain, dtype=float)
        values = np.ascontiguousarray(values, dtype=float)
        P = len(strain)
        if strain.ndim != ndim:
            raise InputError(f"strain has shape {strain.shape}: expected {ndim} axes.")
        if values.ndim != 3 or values.shape[::2] != (P, self.n_parameters):
            raise InputError(
                f"values has shape {values.shape}: expected ({P}, elements, {self.n_parameters})."
            )
        shape = (P, values.shape[1], self.m)
        state = np.zeros(shape) if state is None else np.array(state, dtype=float, order="C")
        if state.shape != shape:
            raise InputError(f"state has shape {state.shape}: expected {shape}.")
        return strain, state, values

    def _expect(self, strain, shape) -> None:
        if strain.shape != shape:
            raise InputError(f"strain has shape {strain.shape}: expected {shape}.")

    def step(self, strain, state, values):
        """Stress after one step of strain.

        Args:
            strain: (P, d), or (P, 2 d) with the rate.
            state: States before it, (P, E, m); None for an interface that never moved.
            values: Parameters, (P, E, n_parameters).

        Returns:
            (stress (P, d), new states (P, E, m), algorithmic tangent (P, d, d or 2 d)).

        Raises:
            InputError: For an array of the wrong shape.
        """
        strain, state, values = self._begin(strain, 2, state, values)
        P = len(strain)
        self._expect(strain, (P, self.inputs))
        stress, new = np.empty((P, self.d)), np.empty_like(state)
        tangent = np.empty((P, self.d, self.inputs))
        self._run("law_step", (P, values.shape[1]), strain, state, values, stress, new, tangent)
        return stress, new, tangent

    def history(self, strain, state, values):
        """Stress (P, T, d) over a history of strain (P, T, d), and the states after it.

        Arguments and errors as `step`.
        """
        strain, state, values = self._begin(strain, 3, state, values)
        P, T, _ = strain.shape
        self._expect(strain, (P, T, self.inputs))
        stress = np.empty((P, T, self.d))
        self._run("law_history", (P, T, values.shape[1]), strain, state, values, stress)
        return stress, state

    def slopes(self, strain, state, values):
        """Derivatives of every step of a history of strain.

        Args:
            strain: (P, T, d), or (P, T, 2 d) with the rate.
            state: States before it, (P, E, m).
            values: Parameters, (P, E, n_parameters).

        Returns:
            (of stress by strain, (P, T, d, d or 2 d), and by the elements' states before the step,
            (P, T, E, d, m); of the states after it by strain, (P, T, E, m, d or 2 d), and by those
            before it, (P, T, E, m, m)).

        Raises:
            InputError: For an array of the wrong shape.
        """
        strain, state, values = self._begin(strain, 3, state, values)
        (P, T, _), E, d, m, n = strain.shape, values.shape[1], self.d, self.m, self.inputs
        self._expect(strain, (P, T, n))
        shapes = (P, T, d, n), (P, T, E, d, m), (P, T, E, m, n), (P, T, E, m, m)
        found = tuple(np.empty(shape) for shape in shapes)
        self._run("law_slopes", (P, T, E), strain, state, values, *found)
        return found

    def memoryless(self, Z, changes, synthesis, values, *, jacobian=True):
        """Harmonics of stress by those of the input, of a law without memory.

        By Gauss's rule between the phases at which a switch of the law changes its sign.

        Args:
            Z: Harmonics of strain, (P, d, K), or of (strain, rate), (P, 2 d, K).
            changes: Those of their derivative by the phase, alike.
            synthesis: From harmonics to samples of one period, (T, K), between which a switch turns
                once at most.
            values: Parameters, (P, E, n_parameters).
            jacobian: Whether the derivative is wanted.

        Returns:
            (harmonics (P, d, K); their derivative by Z, (P, d, K, d or 2 d, K), or None).

        Raises:
            InputError: For an array of the wrong shape, or a law with memory.
        """
        Z, _, values = self._begin(Z, 3, None, values)
        (P, _, K), T = Z.shape, len(synthesis)
        if self.m:
            raise InputError("memoryless: expected a law without memory.")
        self._expect(Z, (P, self.inputs, K))
        changes, synthesis = (np.ascontiguousarray(a, dtype=float) for a in (changes, synthesis))
        F = np.empty((P, self.d, K))
        J = np.empty((P, self.d, K, self.inputs, K)) if jacobian else None
        sizes = P, values.shape[1], K, T, -(-T // _PANEL), len(_GAUSS[0])
        self._run("law_events", sizes, Z, changes, synthesis, values, *_GAUSS, F, J)
        return F, J

    def harmonic(
        self,
        coefficients,
        changes,
        synthesis,
        values,
        state=None,
        *,
        cycles=2,
        jacobian=True,
        sampled=False,
        exact=None,
    ) -> HarmonicStress:
        """Harmonics of stress from harmonics of strain, for a law with memory and without rate.

        In one direction of slip the stress of a law with `JointLaw.exact_steps` is integrated
        exactly: the states step to each reversal of the strain, under a varying pressure also from
        sample to sample, and Gauss's rule integrates the stress in between, in pieces that end
        where a switch changes its sign. The stress of other laws, and in two directions, where
        sliders turn without such an instant, is summed over the samples.

        Args:
            coefficients: Harmonics of strain, (P, d, K).
            changes: Harmonics of strain's derivative by the phase, (P, d, K).
            synthesis: Matrix from harmonics to samples of one period, (T, K), between which the
                strain reverses at most once.
            values: Parameters, (P, E, n_parameters).
            state: States before the first cycle, (P, E, m); None for one that never moved.
            cycles: How often the cycle is run through; the last one counts.
            jacobian: Whether the derivative is wanted; it goes through all cycles.
            sampled: Whether strain and stress at the samples are wanted.
            exact: Whether the stress is integrated, not summed over the samples; by default as
                above.

        Raises:
            InputError: For an array of the wrong shape, or a law without memory or with rate.
        """
        X, state, values = self._begin(coefficients, 3, state, values)
        (P, d, K), T = X.shape, len(synthesis)
        if self.rated or not self.m:
            raise InputError("harmonic: expected a law with memory and without the rate of strain.")
        changes, synthesis = (np.ascontiguousarray(a, dtype=float) for a in (changes, synthesis))
        self._expect(X, (P, self.d, K))
        self._expect(changes, X.shape)
        if synthesis.shape != (T, K):
            raise InputError(f"synthesis has shape {synthesis.shape}: expected (samples, {K}).")
        exact = self.exact if exact is None else exact
        begun, F = np.empty_like(state), np.empty((P, d, K))
        J = np.empty((P, d, K, d, K)) if jacobian else None
        sizes = P, values.shape[1], K, T, cycles, exact, _CYCLE_ORDER
        arrays = X, changes, synthesis, _CYCLE_RULES, values, state, begun, F, J
        self._run("law_harmonic", sizes, *arrays)
        strain = stress = None
        if sampled:
            strain = np.ascontiguousarray((X @ synthesis.T).transpose(0, 2, 1))
            stress, _ = self.history(strain, begun, values)
        largest = max(float(np.abs(state).max(initial=0.0)), np.finfo(float).tiny)
        closure = float(np.abs(state - begun).max(initial=0.0)) / largest
        return HarmonicStress(F, J, strain, stress, state, closure)

    def _run(self, name: str, sizes: tuple[int, ...], *arrays: np.ndarray | None) -> None:
        """Call a function of the library; None is an array that is not asked for."""
        ffi = self._library.ffi
        pointers = [ffi.NULL if a is None else ffi.cast("double *", a.ctypes.data) for a in arrays]
        if getattr(self._library.lib, name)(*sizes, *pointers):
            raise JointsError("out of memory in a joint law")


def _key(n_slip: int, normal: bool) -> str:
    return f"_kernel_{n_slip}_{int(normal)}"
