# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Why do model and test disagree? The story of two bolted plates
#
# Two aluminium plates, lapped and held together by four M10 bolts, hang on ropes and are struck
# with a hammer. Tian et al. 2021 (Appl. Sci. 11, 9134) measured four bending frequencies so, at
# eleven bolt torques from 2 to 22 N·m. A finite-element model of the plates is easily made. It does
# not give these frequencies. What is wrong with it?
#
# This page asks in the order of an experienced test engineer: how large is the gap, and is it more
# than chance? What could this test tell at all? Where is the gap? Which effect causes it? How far
# does it go away, on data that nobody has looked at? And what should be measured next?
#
# Run it as a script, `./with-fenicsx python3 demos/lap_plates/demo_diagnosis.py [PICTURE]`, on as
# many ranks as you like, or make a page of it (`README.md`, "As a page"). To be quick it has
# elements of 20 mm, four times the case's, and a few effects of the library; `fenics-joints
# diagnose demos/lap_plates` has all of both.

# +
import sys
import tempfile
from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.pictures import forecasts
from fenics_joints.commands.plan import matrix_picture
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.plan.planned import plan
from fenics_joints.report import patch_map
from fenics_joints.report.panels import frequency_panels

comm = MPI.COMM_WORLD
here = Path(globals().get("__file__", "demo_diagnosis.py")).resolve().parent
case = load_case(here)
few = [
    "joint normal compliance",
    "joint normal and tangential compliance",
    "compliance away from the bolts only",
    "modulus error",
    "bolts and nuts mass",
]
quick = {"effects": few, "samples": 4, "nested": 0}
case = case.model_copy(
    update={
        "mesh": case.mesh.model_copy(update={"element_size": 0.02}),
        "diagnose": case.diagnose.model_copy(update=quick),
    }
)
# The reduced model is made once, and kept for what follows.
folder = tempfile.TemporaryDirectory() if comm.rank == 0 else None
keep = Path(comm.bcast(folder.name if folder else None))


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def show(draw, *arguments) -> None:
    """On a notebook's page, a picture; in a script, nothing."""
    if comm.rank == 0 and "get_ipython" in globals():
        from IPython.display import HTML, display

        display(HTML(draw(*arguments)))


# -

# ## What could this test tell? Asked before any data
#
# The model starts from as little as can be: two plates that are as one over the whole lap, nothing
# attached. Each effect is put into it at its expected size, every other one is fitted to what the
# test would then measure, and what is left is D, in standard deviations. Below 2.33 the two would
# be taken for one another in more than one test of a hundred. Only the layout of the test goes in
# here: four modes, eleven torques, their noise. No measured frequency does.

planned = plan(case, comm, keep=keep)
say(*planned.sentences())
show(matrix_picture, planned)

# Frames hold what this test cannot tell apart. That is no failure: knowing it beforehand is what
# keeps one from believing the wrong half of an answer later.

# ## The gap
#
# Now the data are read, and the diagnosis runs: each effect alone, and in pairs, fitted with all
# that is uncertain in any case (moduli, densities, thickness, torques).

found = diagnose(case, comm, keep=keep)
words = explain(found)
answers = words.points
say(
    "",
    f"gap of the plates as one: {found.before.rms:.1%} (noise of the test {found.noise:.1%})",
    answers["Is there more than chance?"],
)

# The plates as one are too stiff in every mode, by far more than the test's noise, and they know
# nothing of the torque.

show(
    lambda: frequency_panels(
        found.before,
        found.after,
        found.condition,
        labels=("plates as one", "with the cause"),
        validation=found.validation,
    )
)

# ## Where
#
# Before any cause is assumed: each region of the model, and each patch of its mesh, is allowed to
# be softer or heavier, by itself. What part of the misfit would that explain, and is what it leaves
# no more than chance? The answer is a p-value, corrected for the number of places that were tried.

say("", f"Where. {words.where}", answers["In which part?"])
if comm.rank == 0:
    show(patch_map, found.location.patches)

# The lap is where the plates are not as one. The test knows that from four frequencies alone.

first = found.location.ranked[0]
assert first.region in case.joints and first.p_adjusted < 1e-6

# ## Which
#
# The evidence of a hypothesis is the probability of the measured data, averaged over all that its
# parameters may be: a good fit raises it, freedom that was not needed lowers it. Here it is
# approximated (Laplace), to be quick; the command samples that of the leading ones.

say("", f"Which. {words.which}")
for effect in found.effects[:4]:
    say(f"  {effect.probability:7.1%}  {effect.name}")
say(answers.get("What can these data not tell?", ""))

# The joint gives way, and mass is missing in the lap: the bolts and nuts, which the paper's model
# leaves out. With both in, the second mode falls into place, which no stiffness of the joint could
# do for it.

assert found.verdict == "cause"
assert "compliance" in words.which

# ## How far
#
# A fit that shrinks the gap proves little: any freedom shrinks it. So each mode in turn, the top
# band, and blocks of torques are put aside; cause and parameters are found anew without them; what
# they will show is stated, as an interval; and only then are they looked at. The best wrong effect
# has the same chance.

say("", f"How far. {words.how_far}")
show(forecasts, found.shrinkage)

# One torque was never used for anything: 28 N·m, beyond all others, from a figure's legend in the
# paper.

before, after = found.validation
say(
    "measured at 28 N·m, Hz    " + "".join(f"{f:10.2f}" for f in after.test_hz[0]),
    "predicted, Hz             " + "".join(f"{f:10.2f}" for f in after.model_hz[0]),
    "plates as one, Hz         " + "".join(f"{f:10.2f}" for f in before.model_hz[0]),
)
assert after.rms < 0.02 < 0.1 < before.rms
assert found.shrinkage.shrink > 0.5 and found.shrinkage.excess > 0

# ## What next, and what to doubt
#
# What would decide what these data leave open, and what speaks against taking the answer at its
# word:

for separation in found.separations:
    say(f"to tell apart {separation.class_name}: {separation.measurement}")
say(*(f"but: {doubt}" for doubt in words.doubts))

# And the whole answer on one page, with every number of this one:
# `./with-fenicsx fenics-joints diagnose demos/lap_plates --report diagnosis.html`.


def picture(path: str) -> None:
    """Held-out errors as stated before and as found, and the probabilities."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    effects = found.effects[::-1]
    left.barh([e.name for e in effects], [100 * e.probability for e in effects])
    left.set_xlabel("probability, %")
    for y, fold in enumerate(found.shrinkage.folds):
        right.plot([100 * x for x in fold.predicted_after], [y, y], "C0", lw=7, alpha=0.35)
        right.plot(100 * fold.before, y, "s", color="0.6")
        right.plot(100 * fold.after, y, "oC0")
    right.set_yticks(range(len(found.shrinkage.folds)), [f.name for f in found.shrinkage.folds])
    right.set(xlabel="error of held-out data, %", xscale="log")
    right.set_title("square: before, disc: after, bar: as stated", fontsize=10, loc="right")
    figure.savefig(path, dpi=130)


if comm.rank == 0 and sys.argv[1:] and sys.argv[1].endswith(".png"):
    picture(sys.argv[1])
