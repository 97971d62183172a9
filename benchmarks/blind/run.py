"""The diagnosis of every case, from its data alone, one process each."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from benchmarks.blind import seal
from benchmarks.blind.seal import SealError
from fenics_joints.files import json_text, write_text


def diagnose_cases(
    folder: Path,
    *,
    jobs: int = 2,
    seconds: float = 3600.0,
    retry: bool = False,
    say: Callable[[str], None] = print,
) -> int:
    """Diagnose what is not diagnosed yet, into ``diagnoses/ID.json``, each file whole or not there.

    A diagnosis that fails or takes too long is kept as such: it counts as an answer that is wrong.

    Args:
        folder: The folder of the check.
        jobs: Processes at a time.
        seconds: Time that a case may take.
        retry: Do those again that failed; not after unsealing.
        say: Told what is done.

    Returns:
        How many failed, all calls together.

    Raises:
        SealError: If the answers are open already, the data were changed, or a final check's
            diagnosis is not the one that was frozen when it was sealed.
    """
    sealed = seal.read_json(folder / seal.SEALED)
    source = seal.source_digest(*seal.DIAGNOSIS)
    if sealed["final"] and source != sealed["diagnosis_sha256"]:
        raise SealError(f"{folder}: the diagnosis was changed after this final check was sealed")
    out = folder / "diagnoses"
    out.mkdir(exist_ok=True)
    opened = folder / seal.UNSEALED
    known = seal.read_json(opened)["answers"] if opened.exists() else {}
    todo = []
    for case in sealed["cases"]:
        place = out / f"{case['id']}.json"
        again = retry and place.exists() and "error" in seal.read_json(place)
        if not place.exists() or again:
            todo.append(case)
    if already := [case["id"] for case in todo if case["id"] in known]:
        raise SealError(f"{folder}: answers are open already of: {', '.join(already)}")
    stamp = {"commit": seal.commit(), "diagnosis_sha256": source}
    started = time.monotonic()
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(_diagnose, folder, case, seconds): case["id"] for case in todo}
        for count, future in enumerate(as_completed(running), 1):
            name, result = running[future], future.result()
            write_text(out / f"{name}.json", json_text({"id": name, **stamp, **result}))
            left = (time.monotonic() - started) / count * (len(todo) - count) / 60
            words = "failed" if "error" in result else f"in {result['seconds']:.0f} s"
            say(f"{count} of {len(todo)}: case {name} {words}; about {left:.0f} min left")
    done = [seal.read_json(out / f"{case['id']}.json") for case in sealed["cases"]]
    return sum("error" in d for d in done)


def _diagnose(folder: Path, case: dict, seconds: float) -> dict:
    """One case through the command that everybody uses."""
    place = folder / "cases" / case["id"]
    if seal.files_digest(place) != case["data_sha256"]:
        raise SealError(f"{folder}: the data of case {case['id']} are not those sealed")
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        # A copy, for a diagnosis may leave files beside its case.
        copy, out = Path(scratch) / "case", Path(scratch) / "diagnosis.json"
        shutil.copytree(place, copy)
        # The reduced models depend on no data: one for each geometry serves all its cases.
        models = folder / "models"
        command = [sys.executable, "-m", "fenics_joints", "diagnose", str(copy)]
        command += ["--keep", str(models.resolve())]
        try:
            done = subprocess.run(
                [*command, "--json", str(out)],
                cwd=scratch,
                capture_output=True,
                text=True,
                timeout=seconds,
                env=os.environ | {"OMP_NUM_THREADS": "1", "FENICS_JOINTS_RANKS": "1"},
            )
            error = done.stderr[-4000:] if done.returncode or not out.exists() else None
        except subprocess.TimeoutExpired:
            error = f"stopped after {seconds:g} s"
        spent = time.monotonic() - started
        if error is not None:
            return {"seconds": spent, "error": error}
        return {"seconds": spent, "diagnosis": seal.read_json(out)}
