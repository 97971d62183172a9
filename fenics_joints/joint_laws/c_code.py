"""C statements for scalar UFL expressions of constants.

FFCx compiles expressions on cells of a mesh; a law at the points of a reduced model has no mesh.
Only what laws are written with is known here: arithmetic, functions of one number, conditionals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import ufl
from ufl.algorithms import expand_indices, strip_variables
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Condition, Conj, Constant, Indexed, Real, ScalarValue, Variable, Zero

from fenics_joints.errors import InputError

#: C of UFL's operators, by the name of their class.
_OPERATORS = {
    "Sum": "{0} + {1}",
    "Product": "{0} * {1}",
    "Division": "{0} / {1}",
    "Power": "pow({0}, {1})",
    "Abs": "fabs({0})",
    "Sign": "({0} > 0.0) - ({0} < 0.0)",
    "Atan2": "atan2({0}, {1})",
    # Not fmin and fmax, which are calls because of what they do with nan.
    "MinValue": "{0} < {1} ? {0} : {1}",
    "MaxValue": "{0} > {1} ? {0} : {1}",
    "Conditional": "{0} ? {1} : {2}",
    "NotCondition": "!{0}",
    "AndCondition": "{0} && {1}",
    "OrCondition": "{0} || {1}",
    "LT": "{0} < {1}",
    "GT": "{0} > {1}",
    "LE": "{0} <= {1}",
    "GE": "{0} >= {1}",
    "EQ": "{0} == {1}",
    "NE": "{0} != {1}",
    "Sqrt": "sqrt({0})",
    "Exp": "exp({0})",
    "Ln": "log({0})",
    "Erf": "erf({0})",
    "Cos": "cos({0})",
    "Sin": "sin({0})",
    "Tan": "tan({0})",
    "Cosh": "cosh({0})",
    "Sinh": "sinh({0})",
    "Tanh": "tanh({0})",
    "Acos": "acos({0})",
    "Asin": "asin({0})",
    "Atan": "atan({0})",
}


def scalar(expression) -> object:
    """A scalar expression with derivatives carried out and indices gone."""
    expression = ufl.as_ufl(expression)
    # A variable keeps the first index it is expanded with, so none may be left.
    return expand_indices(strip_variables(apply_derivatives(apply_algebra_lowering(expression))))


def assignments(results: Sequence[tuple[str, object]], names: Mapping) -> str:
    """C statements that assign scalar expressions; what they share is computed once.

    Args:
        results: (C target, expression from `scalar`), in order.
        names: C name of every constant: of a scalar ``c``, or of a vector's array.

    Raises:
        InputError: If an expression holds something else than constants and functions of them.
    """
    writer = _Writer(names)
    lines = [f"{target} = {writer.name(expression)};" for target, expression in results]
    # Results last: a target may be an input of a later expression.
    return "\n  ".join(["", *writer.lines, *lines])


class _Writer:
    def __init__(self, names: Mapping):
        self.names, self.lines, self.known = names, [], {}

    def name(self, expression) -> str:
        """Name or number of an expression's value; writes the statements that it needs."""
        while isinstance(expression, Variable | Real | Conj):
            expression = expression.ufl_operands[0]
        if expression not in self.known:
            self.known[expression] = self._write(expression)
        return self.known[expression]

    def _write(self, e) -> str:
        if isinstance(e, Zero):
            return "0.0"
        if isinstance(e, ScalarValue):
            return f"({float(e)!r})"
        if isinstance(e, Constant):
            return self._constant(e, None)
        if isinstance(e, Indexed):
            vector, index = e.ufl_operands
            while isinstance(vector, Variable):
                vector = vector.ufl_operands[0]
            return self._constant(vector, int(index[0]))
        operator = type(e).__name__
        if operator not in _OPERATORS:
            raise InputError(
                f"a joint law holds {operator}, which a kernel cannot compute; expected "
                "arithmetic, conditionals and functions of scalars."
            )
        text = _OPERATORS[operator].format(*(self.name(o) for o in e.ufl_operands))
        temporary = f"t{len(self.lines)}"
        kind = "int" if isinstance(e, Condition) else "double"
        self.lines.append(f"const {kind} {temporary} = {text};")
        return temporary

    def _constant(self, constant, i) -> str:
        if constant not in self.names:
            raise InputError(
                f"a joint law depends on {constant}: expected only strain, state and parameters."
            )
        name = self.names[constant]
        return name if i is None else f"{name}[{i}]"
