"""Files that users name: odd names, odd text, and what stands there already."""

from __future__ import annotations

import os

import pytest

from fenics_joints.errors import InputError
from fenics_joints.files import check_writable, read_text, read_toml, sealed, unsealed, write_text


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = " + b"[" * 20_000 + b"]" * 20_000, "nested more than"),
        (b"a = " + b"[" * 60 + b"]" * 60, "nested more than"),
        (b"a" + b".a" * 60 + b" = 1", "nested more than"),
        (b"a = {a" + b'."a"' * 200_000 + b" = 1}", "nested more than"),  # at once
        (b"a = " + b"1" * 400, "64 bits"),
        (b"a = 0x" + b"f" * 5000, "64 bits"),
        (b'a = "\\u001b[31mred"', "U[+]001B"),
        (b'a = ["\\u202e"]', "U[+]202E"),
        (b'"\\u0007" = 1', "U[+]0007"),
        ("a = 1".encode("utf-16"), "UTF-16"),
        (b"a = '\xff'", "expected text in UTF-8"),
        (b"a = ", "cannot be read as TOML"),
    ],
)
def test_toml_that_is_refused(tmp_path, content, said):
    file = tmp_path / "odd.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=said) as error:
        read_toml(file, "a case")
    assert len(str(error.value)) < 400 and "\x1b" not in str(error.value)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    file = tmp_path / "windows.toml"
    file.write_bytes(b"\xef\xbb\xbfa = 'line\\nbreak'\r\nb = \"tab\\t\"\r\n")
    assert read_toml(file, "a case") == {"a": "line\\nbreak", "b": "tab\t"}


@pytest.mark.parametrize("name", ["a" * 5000, "a/" * 2500 + "a", "nul\0byte", "loop"])
def test_names_that_no_file_can_have(tmp_path, name):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match="no such file") as error:
        read_text(tmp_path / name, "a case")
    assert len(str(error.value)) < 500
    if name.startswith("a"):
        with pytest.raises(InputError, match=r"--json .*(no folder|a name of 5000)") as error:
            check_writable(tmp_path / name, "--json")
        assert len(str(error.value)) < 900


def test_messages_hold_nothing_that_a_terminal_obeys():
    assert str(InputError("title \x1b[2J\x9b\r\u202e: expected\n  text")) == (
        "title \\x1b[2J\\x9b\\r\\u202e: expected\n  text"
    )


@pytest.mark.parametrize("mask", [0o000, 0o002, 0o022, 0o077])
def test_files_have_the_modes_of_the_mask_and_kept_ones_are_nobody_elses(tmp_path, mask):
    before = os.umask(mask)
    try:
        write_text(tmp_path / "text", "")
        write_text(tmp_path / "own", "", own=True)
        with sealed(tmp_path / "kept.h5") as part:
            part.write_bytes(b"content")
    finally:
        os.umask(before)
    modes = {p.name: p.stat().st_mode & 0o777 for p in tmp_path.iterdir()}
    own = 0o644 & ~mask
    assert modes == {"text": 0o666 & ~mask, "own": own, "kept.h5": own}
    with unsealed(tmp_path / "kept.h5") as file:
        assert file.read(7) == b"content"


def test_no_file_is_written_through_a_link_beside_it(tmp_path):
    """Whoever can write to the folder may guess names of temporary files."""
    (tmp_path / "other").write_text("other")
    (tmp_path / f".text.{os.getpid()}.part").symlink_to("other")
    write_text(tmp_path / "text", "new")
    assert (tmp_path / "other").read_text() == "other" and not (tmp_path / "text").is_symlink()
