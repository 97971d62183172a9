"""Cases from the world, sealed as they are made.

Each case is made by a process of its own, which is told what to make through a pipe and tells the
truth through another: no argument, file or environment variable ever holds an answer in clear.
"""

from __future__ import annotations

import json
import secrets
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import datetime, timezone
from pathlib import Path

from benchmarks.blind import seal, worlds
from benchmarks.blind.seal import SealError
from fenics_joints.files import json_text, write_text

#: What was made so far, encrypted: the seed, what each id is to hold, answers with their salts.
_MAKING = "making.sealed"
_MARK = "truth of the case: "
_SECONDS = 3600


def make_cases(
    folder: Path,
    key: bytes,
    n: int,
    seed: int | None,
    *,
    final: bool = False,
    jobs: int = 2,
    world: str = "first",
    only: str | None = None,
    so_far: bool = False,
    say: Callable[[str], None] = print,
) -> dict:
    """Make and seal ``n`` cases; what is there of an earlier call is kept.

    Args:
        folder: Gets ``cases/ID/``, ``sealed.json`` (to be published) and ``answers.sealed``.
        key: The answers' key.
        n: Number of cases.
        seed: Of the plan; None draws one that nobody has seen, as a final check asks for.
        final: Whether the geometry and effects that are for scoring only are among them.
        jobs: Processes at a time.
        world: Name of the world that makes them.
        only: Its geometry that they shall be of; all of them by default.
        so_far: Whether to seal what an earlier call made, and make no more: they are in no order.
        say: Told what is done.

    Returns:
        The published list.

    Raises:
        SealError: If the folder holds another check, or no case at all could be made.
    """
    if (folder / seal.SEALED).exists():
        raise SealError(f"{folder}: is sealed already; expected a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    state = _state(folder, key, n, seed, final, world, only)
    if so_far:
        for half in {place.name for place in (folder / "cases").glob("*")} - set(state["done"]):
            shutil.rmtree(folder / "cases" / half)
        return _publish(folder, key, state)
    state["failed"] = {}
    todo = [name for name in state["items"] if name not in state["done"]]
    secrets.SystemRandom().shuffle(todo)  # times of files shall not tell the plan's order
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(_make, state["items"][i], folder / "cases" / i): i for i in todo}
        for count, future in enumerate(as_completed(running), 1):
            name = running[future]
            try:
                state["done"][name] = seal.promise(future.result())[1]
                say(f"{count} of {len(todo)}: case {name} made")
            except SealError as error:
                # A contact that does not converge, say. It is counted, not replaced by another.
                state["failed"][name] = str(error)
                say(f"{count} of {len(todo)}: case {name} could not be made")
            write_text(folder / _MAKING, seal.encrypt(state, key))
    return _publish(folder, key, state)


def _state(
    folder: Path, key: bytes, n: int, seed: int | None, final: bool, world: str, only: str | None
) -> dict:
    """What an earlier call left, else a new plan under random ids."""
    own = worlds.folder_of(world)
    asked = {
        "n": n,
        "seed": seed,
        "final": final,
        "world": seal.source_digest(own),
        "of": world,
        "only": only,
    }
    if (folder / _MAKING).exists():
        state = seal.decrypt((folder / _MAKING).read_text(encoding="ascii"), key)
        if state["asked"] != asked:
            raise SealError(f"{folder}: was begun with another seed, number, kind or generator")
        return state
    drawn = secrets.randbits(62) if seed is None else seed
    plan = [list(item) for item in _plan(worlds.world_named(world), n, drawn, final, only)]
    secrets.SystemRandom().shuffle(plan)
    items = dict(zip(seal.new_ids(len(plan)), plan, strict=True))
    state = {"asked": asked, "plan_seed": drawn, "items": items, "done": {}, "failed": {}}
    write_text(folder / _MAKING, seal.encrypt(state, key))
    return state


def _plan(world, n: int, seed: int, final: bool, only: str | None) -> list:
    if only is None:
        return world.plan(n, seed, final)
    if only not in world.GEOMETRIES:
        raise SealError(f"--only {only}: expected one of {', '.join(world.GEOMETRIES)}")
    many = world.plan(n * len(world.GEOMETRIES), seed, final)
    return [item for item in many if item[0] == only][:n]


def _make(item: list, folder: Path) -> dict:
    """One case in a process of its own; its answer."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    asked = json.dumps({"item": item, "folder": str(folder)}, default=seal.plain)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.blind.make"],
            input=asked,
            cwd=seal.ROOT,
            capture_output=True,
            text=True,
            timeout=_SECONDS,
        )
    except subprocess.TimeoutExpired as error:
        shutil.rmtree(folder)
        raise SealError(f"stopped after {_SECONDS} s") from error
    lines = [line for line in done.stdout.splitlines() if line.startswith(_MARK)]
    if done.returncode or not lines:
        shutil.rmtree(folder)
        raise SealError(f"exit code {done.returncode}: {done.stderr[-2000:]}")
    _check_files(folder)
    return json.loads(lines[-1].removeprefix(_MARK))


def _check_files(folder: Path) -> None:
    """Nothing may lie beside the case but what it names: a file too many could hold the answer."""
    case = folder / "case.toml"
    text = case.read_text(encoding="utf-8") if case.exists() else ""
    if not text:
        raise SealError("the generator wrote no case.toml")
    spare = [
        p.name
        for p in folder.rglob("*")
        if p.is_file() and p != case and p.relative_to(folder).as_posix() not in text
    ]
    if spare:
        raise SealError(f"the generator left files that the case does not name: {spare}")


def _publish(folder: Path, key: bytes, state: dict) -> dict:
    """Write the answers, encrypted, and the list with their digests."""
    if not state["done"]:
        reasons = "; ".join(sorted(set(state["failed"].values())))[:2000]
        raise SealError(f"{folder}: no case could be made: {reasons}")
    cases = []
    for name, kept in sorted(state["done"].items()):
        answer, salt = kept["answer"], bytes.fromhex(kept["salt"])
        data = seal.files_digest(folder / "cases" / name)
        cases.append({"id": name, "sha256": seal.digest(answer, salt), "data_sha256": data})
    answers = {"cases": state["done"], "seed": state["plan_seed"], "failed": state["failed"]}
    write_text(folder / seal.ANSWERS, seal.encrypt(answers, key) + "\n")
    listed = {
        "final": state["asked"]["final"],
        "world": state["asked"]["of"],
        "sealed": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": seal.commit(),
        "generator_sha256": seal.source_digest(worlds.folder_of(state["asked"]["of"])),
        "rules_sha256": seal.source_digest(*seal.RULES),
        "diagnosis_sha256": seal.source_digest(*seal.DIAGNOSIS),
        "answers_sha256": seal.file_digest(folder / seal.ANSWERS),
        "planned": len(state["items"]),
        "not_made": len(state["failed"]),
        "cases": cases,
    }
    write_text(folder / seal.SEALED, json_text(listed))
    (folder / _MAKING).unlink()
    return listed


def _worker() -> None:
    """Make the case that standard input asks for."""
    asked = json.load(sys.stdin)
    geometry, kind, effects, seed, *flags = asked["item"]
    world, folder = worlds.world_of(geometry), Path(asked["folder"])
    truth = world.generate(geometry, kind, effects, seed, folder, *flags)
    print("\n" + _MARK + seal.canonical(truth).decode(), flush=True)


if __name__ == "__main__":
    _worker()
