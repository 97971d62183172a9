"""Answers that can neither be read before the diagnosis nor changed after it.

The published list holds the SHA-256 of every answer with 32 random bytes before it: a promise that
gives nothing away. The answers themselves are encrypted (Fernet: AES-128 in CBC mode, HMAC-SHA256)
with a key that stays outside the folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fenics_joints.errors import JointsError
from fenics_joints.files import json_text, write_text

ROOT = Path(__file__).resolve().parents[2]
SEALED, ANSWERS, UNSEALED = "sealed.json", "answers.sealed", "answers.json"
#: Sources that the diagnosis consists of, frozen with the seal of a final check.
DIAGNOSIS = ("fenics_joints", "forms", "meshes")
#: What decides on right and wrong.
RULES = tuple(
    f"benchmarks/blind/{name}.py"
    for name in (
        "forecast",
        "matching",
        "oracle",
        "rates",
        "reckoning",
        "score",
        "targets",
        "worlds",
        "signatures",
        "calculix/effects",
        "calculix/sheets",
        "world/effects",
    )
)
_SALT = 32  # bytes


class SealError(JointsError):
    """A seal that is broken, or one that may not be broken yet."""


# -- answers ---------------------------------------------------------------------------------------


def canonical(answer: Mapping) -> bytes:
    """The answer as JSON that is the same on every machine: sorted keys, no spaces, ASCII.

    Raises:
        ValueError: If a number is nan or infinite.
    """
    return json.dumps(
        answer,
        sort_keys=True,
        separators=(",", ":"),
        ensure_ascii=True,
        allow_nan=False,
        default=plain,
    ).encode()


def plain(value):
    """NumPy's numbers and arrays as JSON's, for ``json.dumps``."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r} cannot be part of an answer")


def digest(answer: Mapping, salt: bytes) -> str:
    """SHA-256 of the salt and the canonical answer, in hexadecimal digits."""
    return hashlib.sha256(salt + canonical(answer)).hexdigest()


def promise(answer: Mapping) -> tuple[str, dict]:
    """What is published of an answer, and what is kept.

    Returns:
        Its salted digest; and the answer with its salt, to be encrypted.
    """
    salt = secrets.token_bytes(_SALT)
    kept = json.loads(canonical(answer))
    return digest(kept, salt), {"answer": kept, "salt": salt.hex()}


def new_ids(n: int) -> list[str]:
    """Names of cases from the system's randomness, sorted: they say nothing of what is in them."""
    found: set[str] = set()
    while len(found) < n:
        found.add(secrets.token_hex(4))
    return sorted(found)


# -- keys ------------------------------------------------------------------------------------------


def _fernet():
    try:
        from cryptography import fernet
    except ImportError as error:
        raise SealError(
            "sealing needs the package 'cryptography': pip install 'fenics-joints[blind]', or "
            "python3-cryptography of Debian"
        ) from error
    return fernet


def make_key(path: Path, folder: Path) -> bytes:
    """A key in a file of its own that only its owner may read; the one that is there, if any.

    Raises:
        SealError: If it would lie inside the folder that the diagnosis works in.
    """
    if path.resolve().is_relative_to(folder.resolve()):
        raise SealError(f"--key {path}: lies in {folder}; expected a place outside of it")
    if path.exists():
        return read_key(path)
    key = _fernet().Fernet.generate_key()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(descriptor, "wb") as stream:
        stream.write(key)
    return key


def read_key(path: Path) -> bytes:
    """The key in a file.

    Raises:
        SealError: If it cannot be read.
    """
    try:
        return path.read_bytes().strip()
    except OSError as error:
        raise SealError(f"--key {path}: cannot be read ({error.strerror})") from error


def encrypt(content: object, key: bytes) -> str:
    """JSON content under a key, as text."""
    text = json.dumps(content, allow_nan=False, default=plain)
    return _cipher(key).encrypt(text.encode()).decode()


def decrypt(text: str, key: bytes) -> object:
    """The content again.

    Raises:
        SealError: If the key is another, or the text was changed.
    """
    try:
        return json.loads(_cipher(key).decrypt(text.strip().encode()))
    except _fernet().InvalidToken as error:
        raise SealError("the key is another than the answers', or they were changed") from error


def _cipher(key: bytes):
    try:
        return _fernet().Fernet(key)
    except ValueError as error:
        raise SealError("the key is none: expected 32 bytes in URL-safe base64") from error


# -- what was sealed -------------------------------------------------------------------------------


def commit() -> str:
    """The commit that is checked out, with a ``+`` if files differ from it; empty without git."""
    command = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT)]
    try:
        rev = subprocess.run(
            [*command, "rev-parse", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
        changed = subprocess.run(
            [*command, "status", "--porcelain", "-uno"], capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return _head()
    return rev + ("+" if changed else "")


def _head() -> str:
    """The commit by git's own files, where there is no git; it cannot say what differs."""
    try:
        head = (ROOT / ".git" / "HEAD").read_text().strip()
        name = head.removeprefix("ref: ")
        return head if name == head else (ROOT / ".git" / name).read_text().strip()
    except OSError:
        return ""


def source_digest(*folders: str) -> str:
    """SHA-256 over the names and contents of Python and C sources: files, and all in folders."""
    places = [ROOT / folder for folder in folders]
    inside = [p for place in places for p in place.rglob("*") if p.suffix in (".py", ".c")]
    return _digest_of(sorted({*inside, *(p for p in places if p.is_file())}), ROOT)


def files_digest(folder: Path) -> str:
    """SHA-256 over the names and contents of all files in a folder."""
    return _digest_of(sorted(p for p in folder.rglob("*") if p.is_file()), folder)


def file_digest(path: Path) -> str:
    """SHA-256 of one file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digest_of(paths: Sequence[Path], base: Path) -> str:
    total = hashlib.sha256()
    for path in paths:
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        total.update(f"{path.relative_to(base).as_posix()}\0{content}\n".encode())
    return total.hexdigest()


def read_json(path: Path) -> dict:
    """Content of a file of JSON.

    Raises:
        SealError: If it is not there or broken.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SealError(f"{path}: cannot be read ({error})") from error


# -- unsealing -------------------------------------------------------------------------------------


def answers_of(folder: Path, key: bytes) -> dict[str, dict]:
    """Every answer of the list by its case's id, each checked against the published digest.

    Raises:
        SealError: If the key is wrong, an answer is missing, too many, or not the promised one.
    """
    listed = {case["id"]: case["sha256"] for case in read_json(folder / SEALED)["cases"]}
    try:
        text = (folder / ANSWERS).read_text(encoding="ascii")
    except (OSError, ValueError) as error:
        raise SealError(f"{folder / ANSWERS}: cannot be read ({error})") from error
    kept = decrypt(text, key)["cases"]
    if set(kept) != set(listed):
        raise SealError(f"{folder}: the answers are not those of the cases in {SEALED}")
    broken = [
        name
        for name, content in kept.items()
        if digest(content["answer"], bytes.fromhex(content["salt"])) != listed[name]
    ]
    if broken:
        raise SealError(f"{folder}: answers that differ from their seals: {', '.join(broken)}")
    return {name: content["answer"] for name, content in kept.items()}


def unseal(folder: Path, key: bytes, *, partial: bool = False) -> dict[str, dict]:
    """Open the answers once all diagnoses are there, and note what was diagnosed until then.

    Writes ``answers.json``: the answers, and the digest of each diagnosis, by which `score` knows
    that none was made afterwards.

    Args:
        folder: The folder of the check.
        key: The answers' key.
        partial: Open those of the cases that were diagnosed, and leave the others sealed.

    Raises:
        SealError: If a diagnosis is missing, the data are not those that were sealed, a diagnosis
            was changed after an earlier call, or as `answers_of`.
    """
    sealed = read_json(folder / SEALED)
    done = {p.stem: p for p in sorted((folder / "diagnoses").glob("*.json"))}
    missing = [case["id"] for case in sealed["cases"] if case["id"] not in done]
    if missing and not partial:
        raise SealError(
            f"{folder}: {len(missing)} of {len(sealed['cases'])} cases are not diagnosed; answers "
            "stay sealed until they are (or --partial, for those that are)"
        )
    for case in sealed["cases"]:
        if files_digest(folder / "cases" / case["id"]) != case["data_sha256"]:
            raise SealError(f"{folder}: the data of case {case['id']} are not those sealed")
    answers = {name: a for name, a in answers_of(folder, key).items() if name in done}
    digests = {name: file_digest(done[name]) for name in answers}
    if (folder / UNSEALED).exists():
        before = read_json(folder / UNSEALED)["diagnoses_sha256"]
        if changed := [name for name, value in before.items() if digests.get(name) != value]:
            raise SealError(f"{folder}: diagnosed again after unsealing: {', '.join(changed)}")
    opened = {"answers": answers, "diagnoses_sha256": digests, "partial": bool(missing)}
    write_text(folder / UNSEALED, json_text(opened))
    return answers
