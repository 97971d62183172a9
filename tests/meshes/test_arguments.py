"""Functions that build meshes say what they take."""

import inspect
from dataclasses import fields

import pytest

import fenics_joints.meshes as meshes

BUILDERS = [
    meshes.CBeams,
    meshes.Dumbbell,
    meshes.EngravingMachine,
    meshes.HalfLapBeam,
    meshes.HalfLapBeamSection,
    meshes.LapBeam,
    meshes.LapBeamSection,
    meshes.LapPlates,
    meshes.RoundPlates,
    meshes.RoundPlatesSection,
    meshes.StepAssembly,
]


@pytest.mark.parametrize("builder", BUILDERS)
def test_a_function_has_the_arguments_of_its_builder(builder):
    function = getattr(meshes, builder.function)
    given = inspect.signature(function).parameters
    own = {name: p for name, p in given.items() if name not in ("path", "comm")}
    assert own.keys() == {f.name for f in fields(builder)}
    defaults = {f.name: f.default for f in fields(builder)}
    assert all(p.default == defaults[name] for name, p in own.items() if p.default is not p.empty)
    assert "comm" in given and function.__name__ == builder.function


def test_help_says_what_a_length_is():
    text = inspect.getdoc(meshes.lap_plates)
    assert "Args:" in text and "lap: Length of the overlap, in metres." in text
    assert "element_size: float = 0.005" in str(inspect.signature(meshes.lap_plates))
