# ---
# jupyter:
#   jupytext:
#     formats: py:light
# ---

# # Why do model and test disagree? The story of two bolted plates
#
# Two aluminium plates, lapped and held together by four M10 bolts, hang on ropes and are struck
# with a hammer. Tian et al. 2021 (Appl. Sci. 11, 9134) measured four bending frequencies in this
# way, at eleven bolt torques from 2 to 22 N·m. A simple finite-element model of the plates does not
# have these frequencies. What is wrong with it?
#
# This page asks the questions of an experienced test engineer, in this order. What can the test
# tell at all? How large is the error of the model, and is it more than chance? Where in the
# structure is the model wrong? Which effect causes the error? How much smaller does the error
# become on held-out data? What should be measured next?
#
# Run it as a script, `./with-fenicsx python3 demos/lap_plates/demo_diagnosis.py [PICTURE]`, on as
# many ranks as you like, or make a page of it (`README.md`, "As a page"). To be quick it has
# elements of 20 mm, four times as long as those of the case, and five effects of the library.
# `fenics-joints diagnose demos/lap_plates` uses the finer mesh and the whole library.

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
# The reduced model is made once and kept for both steps, plan and diagnosis.
folder = tempfile.TemporaryDirectory() if comm.rank == 0 else None
keep = Path(comm.bcast(folder.name if folder else None))


def say(*lines: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(*lines, sep="\n", flush=True)


def show(draw, *arguments) -> None:
    """Show a picture in a notebook; do nothing in a script."""
    if comm.rank == 0 and "get_ipython" in globals():
        from IPython.display import HTML, display

        display(HTML(draw(*arguments)))


# -

# ## What this test can tell, before any data are read
#
# The baseline model is two plates bonded over the whole lap, with nothing attached. Each effect is
# put into it at its expected size. Every other effect is then fitted to the data that the test
# would measure. The remaining difference, in standard deviations, is D. If D is below 2.33, the two
# effects are mistaken for each other in more than one test of a hundred. This step uses only the
# layout of the test (four modes, eleven torques, their noise) and no measured frequency.

planned = plan(case, comm, keep=keep)
say(*planned.sentences())
show(matrix_picture, planned)

# Frames enclose the effects that this test cannot tell apart. If you know them beforehand, you will
# not take one of them for the cause when the answer names them together.

# ## How large the error is
#
# Now the data are read, and the diagnosis runs. Each effect is fitted alone and in pairs, together
# with the quantities that are always uncertain (moduli, densities, thickness, torques). The output
# calls the error "gap", and the bonded plates "the plates as one".

found = diagnose(case, comm, keep=keep)
words = explain(found)
answers = words.points
say(
    "",
    f"gap of the plates as one: {found.before.rms:.1%} (noise of the test {found.noise:.1%})",
    answers["Is there more than chance?"],
)

# The bonded plates are too stiff in every mode, by far more than the noise of the test, and their
# frequencies do not depend on the torque.

show(
    lambda: frequency_panels(
        found.before,
        found.after,
        found.condition,
        labels=("plates as one", "with the cause"),
        validation=found.validation,
    )
)

# ## Where the model is wrong
#
# This step assumes no cause. Each region of the model, and each patch of its mesh, is allowed to
# become softer or heavier on its own. Which share of the misfit does the change explain, and could
# this share be chance? The answer is a p-value, corrected for the number of places that were tried.

say("", f"Where. {words.where}", answers["In which part?"])
if comm.rank == 0:
    show(patch_map, found.location.patches)

# The model is wrong in the lap: there the plates are not bonded. Four frequencies at eleven torques
# are enough to show it.

first = found.location.ranked[0]
assert first.region in case.joints and first.p_adjusted < 1e-6

# ## Which effect causes the error
#
# The evidence of a hypothesis is the probability of the measured data, averaged over the prior of
# its parameters. A good fit raises it; parameters that the data do not need lower it.

say("", f"Which. {words.which}")
for effect in found.effects[:4]:
    say(f"  {effect.probability:7.1%}  {effect.name}")
say(answers.get("What can these data not tell?", ""))

# The joint is compliant, and mass is missing in the lap: that of the bolts and nuts, which the
# paper's model leaves out. With both in the model the second mode agrees with the test, which no
# stiffness of the joint alone can achieve.

assert found.verdict == "cause"
assert "compliance" in words.which

# ## How much of the error the cause removes
#
# A fit that reduces the error proves little, because any free parameter reduces it. So parts of the
# data are held out: each mode in turn, the highest modes together, and blocks of torques. For each
# part, cause and parameters are found again without it, the held-out data are predicted with an
# interval, and only then are the two compared. The best alternative effect (in the output: "best
# wrong effect") is fitted and tested in the same way.

say("", f"How far. {words.how_far}")
show(forecasts, found.shrinkage)

# One torque was never used in any fit: 28 N·m, above all others, from the legend of a figure in the
# paper.

before, after = found.validation
say(
    "measured at 28 N·m, Hz    " + "".join(f"{f:10.2f}" for f in after.test_hz[0]),
    "predicted, Hz             " + "".join(f"{f:10.2f}" for f in after.model_hz[0]),
    "plates as one, Hz         " + "".join(f"{f:10.2f}" for f in before.model_hz[0]),
)
assert after.rms < 0.02 < 0.1 < before.rms
assert found.shrinkage.shrink > 0.5 and found.shrinkage.excess > 0

# ## What to measure next, and what to doubt
#
# Which measurement would decide between the effects that these data cannot tell apart, and what
# makes the answer doubtful:

for separation in found.separations:
    say(f"to tell apart {separation.class_name}: {separation.measurement}")
say(*(f"but: {doubt}" for doubt in words.doubts))

# This command writes the whole answer on one page, from the finer mesh and the whole library:
# `./with-fenicsx fenics-joints diagnose demos/lap_plates --report diagnosis.html`.


def picture(path: str) -> None:
    """Draw held-out errors as predicted and as found, and the probabilities."""
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
