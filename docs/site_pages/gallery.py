"""The demos: their pages, their scripts as stories, what they print, and their pictures."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from site_pages.pages import places, relinked

#: Of the processor, for a demo that is run while the site is built; and at most so many times as
#: long on a busy machine. Those in LONG take more, and keep their picture.
SECONDS, BUSY = 60, 5
LONG = frozenset(
    {
        "demo_bayes",
        "demo_c_beam",
        "demo_diagnosis",
        "demo_dumbbell",
        "demo_engraving_machine",
        "demo_lap_plates",
    }
)
#: What each picture shows, for those who do not see it.
SHOWN = {
    "barc": "Mesh of a box with a slot across its roof, two feet, a beam and the masses of screws",
    "demo_bayes": "k2 over k1 of the specimens, simulated and sampled, and the correlations of "
    "measured frequencies beside those of two models",
    "demo_bolted_beams": "Five mode shapes, the frequency errors of two fits mode by mode, and the "
    "accelerance at three torques",
    "demo_bolted_plates": "Contact radius over bolt force for seven plate thicknesses, printed and "
    "computed, with rigid and with soft contact",
    "demo_c_beam": "Frequencies of six modes over the cut-off pressure, computed and measured, "
    "without and with sliding contact",
    "demo_cad_bracket": "Sensitivities of five frequencies to the modulus of four bolts' rings",
    "demo_diagnosis": "Probabilities of seven hypotheses, and the errors of held-out data before "
    "and after the correction",
    "demo_dumbbell": "Frequency errors of three fits mode by mode, and a frequency response "
    "function of the test, before and after updating",
    "demo_engraving_machine": "The frame, five mode shapes, the bolts that matter to each mode, "
    "frequencies over the rings' E and h, and the effect of each loose bolt",
    "demo_half_lap_beam": "Damping and frequency of the first mode over its acceleration, measured "
    "and with a lap that slips",
    "demo_lap_beam": "Sensitivities of a frequency over the layer's Poisson's ratio, and the "
    "frequency errors without and with the masses of bolt and sensor",
    "demo_lap_plates": "Frequencies of four bending modes over the torque: measured, with bonded "
    "plates, and with joint and masses",
    "demo_nonlinear": "Tip acceleration over frequency at three forces, measured and computed, and "
    "the objective over the steps of the search",
    "demo_random_field": "Stiffness along the lap for three correlation lengths, the scatter of "
    "eight frequencies, and their correlations",
    "jim_beam": "Mesh of three plates that form a U, with eight sensors",
}
HEAD = """# Gallery

Each demo is a structure with its own page, and one or more scripts that read as a story: run as
they are, or turned into notebooks by jupytext. Each asserts a published number.
The scripts draw the pictures{when}; a demo without a script shows its mesh.

"""


def write(repository: Path, source: Path, run: bool, long: bool = False) -> None:
    """Write `gallery/index.md`, and a page for each demo and for each of its scripts.

    Args:
        repository: Where `demos/` is.
        source: The site's folder of sources.
        run: Run the demos that take less than a minute; the others keep the pictures in
            `docs/gallery`.
        long: Run the others, too.
    """
    folder = source / "gallery"
    folder.mkdir()
    text = HEAD.format(when=", here while the site was built" if run else "")
    names = []
    for readme in sorted(repository.glob("demos/*/README.md")):
        name = readme.parent.name
        names.append(name)
        page = relinked(
            readme.read_text("utf-8"), f"demos/{name}/README.md", places(repository), source
        )
        scripts = sorted(readme.parent.glob("demo_*.py"))
        stories = [_story(script, folder, run, long) for script in scripts]
        text += _card(name, page, stories)
        if name in SHOWN:
            shutil.copy(repository / "docs" / "gallery" / f"{name}.png", folder)
            page = page.replace("\n", f"\n\n{_picture(name)}\n", 1)
        (folder / f"{name}.md").write_text(page + _scripts(stories), encoding="utf-8")
    text += "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    (folder / "index.md").write_text(text, encoding="utf-8")


def _story(script: Path, folder: Path, run: bool, long: bool) -> tuple[str, str]:
    """Write a script's page; its name and title."""
    name = script.stem
    picture = folder / f"{name}.png"
    printed = _run(script, picture, long) if run and (long or name not in LONG) else None
    if not picture.exists():
        shutil.copyfile(script.parents[2] / "docs" / "gallery" / f"{name}.png", picture)
    text = _markdown(script)
    title, _, rest = text.partition("\n")
    if printed:
        rest += f"\n## What it prints\n\n```text\n{printed.strip()}\n```\n"
    (folder / f"{name}.md").write_text(f"{title}\n\n{_picture(name)}\n{rest}", encoding="utf-8")
    return name, title.strip("# ")


def _picture(name: str) -> str:
    return f"![{SHOWN[name]}]({name}.png)"


def _run(script: Path, picture: Path, long: bool) -> str | None:
    """What a script prints, or None if it takes too long; if it fails, so does the site."""
    command = [sys.executable, str(script), str(picture)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    limits = {} if long else {"timeout": BUSY * SECONDS, "preexec_fn": _limited}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, **limits)
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        picture.unlink(missing_ok=True)
        print(f"{script.name} takes more than {SECONDS} s here: the picture is the committed one")
        return None
    if done.returncode:
        raise SystemExit(f"{script} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))


def _markdown(script: Path) -> str:
    """A script in jupytext's light format as Markdown."""
    import jupytext

    text = jupytext.writes(jupytext.read(script, fmt="py:light"), fmt="md")
    text = re.sub(r"\A---\n.*?\n---\n+", "", text, flags=re.DOTALL)
    return re.sub(r"^<!-- #(end)?region.*-->\n", "", text, flags=re.MULTILINE)


def _scripts(stories: list[tuple[str, str]]) -> str:
    if not stories:
        return ""
    text = "\n## The scripts\n\n"
    for name, title in stories:
        text += f"[{title}]({name}.md)\n\n[{_picture(name)}]({name}.md)\n\n"
    listed = "\n".join(name for name, _ in stories)
    return f"{text}```{{toctree}}\n:hidden:\n\n{listed}\n```\n"


def _card(name: str, page: str, stories: list[tuple[str, str]]) -> str:
    """The demo's title, first picture and first paragraph."""
    title, words, *_ = page.split("\n\n")
    picture = _picture(stories[0][0] if stories else name)
    return f"## [{title[2:]}]({name}.md)\n\n[{picture}]({name}.md)\n\n{words}\n\n"
