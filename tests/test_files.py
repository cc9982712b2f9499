"""A file is whole or as it was before, whatever happens while it is written."""

import errno
import importlib.util
import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact import files
from neurotact.errors import InputError
from neurotact.files import (
    MAX_MB,
    append,
    check_new,
    check_size,
    existing,
    locked,
    read_bytes,
    read_json,
    sweep,
    whole,
    write_json,
    write_text,
)

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


def test_a_crash_leaves_the_old_file_and_no_draft(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")

    def crash() -> None:
        with whole(path) as draft:
            draft.write_text("half of the n")
            raise RuntimeError("the disk is on fire")

    with pytest.raises(RuntimeError, match="on fire"):
        crash()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["result.txt"]


KILLED = """
import os, sys
from neurotact.files import whole
with whole(sys.argv[1]) as draft:
    draft.write_text("half of the n")
    os.kill(os.getpid(), 9)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="drafts name their process on Linux alone")
def test_the_draft_of_a_killed_process_goes_with_the_next_file(tmp_path):
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "a.txt")], env=ENVIRONMENT, check=False)
    assert killed.returncode == -9
    (left,) = tmp_path.iterdir()
    _, here, process, _ = left.name.split("-")
    others = [f".draft-{here}-{os.getpid()}-ab.txt", f".draft-0-{process}-ab.txt", ".draft-ab.txt", ".draft-thesis"]
    for name in others:
        (tmp_path / name).write_text("of another, or still being written")
    write_text(tmp_path / "b.txt", "whole")
    assert sorted(os.listdir(tmp_path)) == sorted([*others, "b.txt"])


@pytest.mark.parametrize("call", [Path.touch, Path.replace], ids=["begins", "ends"])
def test_an_interrupt_as_a_draft_begins_or_ends_leaves_none(tmp_path, monkeypatch, call):
    def interrupted(draft: Path, *args, **kwargs) -> None:
        call(draft, *args, **kwargs) if call is Path.touch else None
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, call.__name__, interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "result.txt", "new")
    assert os.listdir(tmp_path) == []


def test_the_old_file_stands_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with whole(path) as draft:
        draft.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["result.txt"]


def test_folders_on_the_way_are_made_and_the_draft_keeps_the_suffix(tmp_path):
    with whole(tmp_path / "a" / "b" / "figure.svg") as draft:
        assert draft.suffix == ".svg"
        draft.write_text("<svg/>")
    assert (tmp_path / "a" / "b" / "figure.svg").read_text() == "<svg/>"


def test_a_new_file_has_the_rights_of_any_other(tmp_path):
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "whole", "")
    rights = {name: stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "whole")}
    assert rights["plain"] == rights["whole"]


def test_a_place_that_cannot_be_written_is_named_before_any_work(tmp_path):
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "below.txt", tmp_path):
        with pytest.raises(InputError, match="cannot be written"), whole(place):
            pytest.fail("the block ran")
    assert sorted(os.listdir(tmp_path)) == ["file"]


def test_a_pipe_is_never_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(InputError, match=r"pipe\.csv: cannot be written, it is a pipe, a socket or a device"):
        write_text(tmp_path / "pipe.csv", "new")
    assert stat.S_ISFIFO((tmp_path / "pipe.csv").stat().st_mode)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_text_is_written_as_it_is(tmp_path, text):
    write_text(tmp_path / "text", text)
    assert (tmp_path / "text").read_bytes().decode() == text


@given(JSON)
def test_json_comes_back_equal(tmp_path, value):
    write_json(tmp_path / "value.json", value)
    assert read_json(tmp_path / "value.json") == value
    (tmp_path / "value.json").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "value.json").read_bytes())
    assert read_json(tmp_path / "value.json") == value, "an editor may write a byte-order mark"


def test_json_has_no_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "value.json", {"accuracy": float("nan")})
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("content", [b"", b"{", b'{"a": 1,}', b"\xff\xfe"])
def test_damaged_json_is_named(tmp_path, content):
    (tmp_path / "value.json").write_bytes(content)
    with pytest.raises(InputError, match=r"value\.json: is not valid JSON"):
        read_json(tmp_path / "value.json")


def test_what_is_not_there_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    kinds = (
        (tmp_path / "x", "file", "there is no such file"),
        (tmp_path / "x", "file or folder", "there is no such file or folder"),
        (tmp_path, "file", "is a folder; name a file"),
        (tmp_path / "file", "folder", "is a file; name a folder"),
    )
    for path, what, said in kinds:
        with pytest.raises(InputError, match=f"{path.name}: {said}"):
            existing(path, what)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_a_disk_that_fills_while_a_file_is_written_is_one_sentence(tmp_path, number):
    (tmp_path / "result.txt").write_text("old")

    def fill() -> None:
        with whole(tmp_path / "result.txt") as draft:
            draft.write_text("half")
            raise OSError(number, os.strerror(number))

    with pytest.raises(InputError, match=r"result\.txt: cannot be written \(.*free space"):
        fill()
    assert (tmp_path / "result.txt").read_text() == "old"
    assert os.listdir(tmp_path) == ["result.txt"]


def test_a_rename_that_fails_is_one_sentence(tmp_path, monkeypatch):
    def refused(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "replace", refused)
    with pytest.raises(InputError, match="cannot be written"):
        write_text(tmp_path / "result.txt", "new")
    assert os.listdir(tmp_path) == []


def test_an_input_that_cannot_be_read_is_not_blamed_on_the_output(tmp_path):
    with pytest.raises(FileNotFoundError), whole(tmp_path / "out.txt"):
        (tmp_path / "input.txt").read_text()


@pytest.mark.parametrize("what", ["file", "folder", "file or folder"])
@pytest.mark.parametrize("name", ["away", "x/" * 3000, "x" * 300])
def test_a_name_of_any_length_that_is_not_there_is_named(what, name):
    with pytest.raises(InputError, match=f"there is no such {what}; check the path"):
        existing(name, what)


def test_a_file_or_a_folder_is_either(tmp_path):
    (tmp_path / "file").touch()
    assert existing(tmp_path, "file or folder") == tmp_path
    assert existing(tmp_path / "file", "file or folder") == tmp_path / "file"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="is not a regular file"):
        existing(tmp_path / "pipe", "file or folder")


def test_an_output_that_exists_is_refused_and_force_replaces_it(tmp_path):
    write_text(tmp_path / "a.h5", "")
    with pytest.raises(InputError, match=r"a\.h5: already exists; .*`force=True`"):
        check_new(tmp_path / "a.h5")
    check_new(tmp_path / "a.h5", force=True)
    check_new(tmp_path / "b.h5")


@pytest.mark.parametrize("name", ["a.h5", "sub/../a.h5", "soft.h5", "hard.h5"])
def test_an_output_that_is_an_input_is_refused_by_any_name(tmp_path, name):
    (tmp_path / "sub").mkdir()
    write_text(tmp_path / "a.h5", "")
    (tmp_path / "soft.h5").symlink_to(tmp_path / "a.h5")
    (tmp_path / "hard.h5").hardlink_to(tmp_path / "a.h5")
    with pytest.raises(InputError, match="is an input of this command"):
        check_new(tmp_path / name, force=True, inputs=[None, "absent", tmp_path / "a.h5"])


def test_a_sweep_removes_drafts_alone(tmp_path):
    for name in (".draft-1.csv", "deep/.draft-2", "deep/result.json", "draft"):
        write_text(tmp_path / name, "")
    sweep(tmp_path)
    left = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["deep/result.json", "draft"]


HOLD = """
import sys, time
from neurotact.files import locked
with locked(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_lock_says_who_holds_it_and_is_let_go_by_a_kill(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {holder.pid} on .* is working here"), locked(tmp_path):
            pytest.fail("two at once")
        holder.kill()
        holder.wait()
    with locked(tmp_path):
        assert os.listdir(tmp_path) == [".lock"]
    assert os.listdir(tmp_path) == []


def test_a_lock_ends_with_its_block_however_that_ends(tmp_path):
    with pytest.raises(RuntimeError), locked(tmp_path):
        raise RuntimeError
    with locked(tmp_path):
        pass


def test_without_locks_of_the_system_a_folder_is_used_all_the_same(tmp_path, monkeypatch):
    """As on Windows, which has no fcntl."""
    monkeypatch.setitem(sys.modules, "fcntl", None)
    there = importlib.util.spec_from_file_location("files_there", files.__file__)
    assert there is not None
    assert there.loader is not None
    module = importlib.util.module_from_spec(there)
    there.loader.exec_module(module)
    with module.locked(tmp_path), module.locked(tmp_path):
        assert json.loads((tmp_path / ".lock").read_text())["pid"] == os.getpid()
    assert os.listdir(tmp_path) == []


def test_the_size_of_an_input_is_bounded_before_it_is_read(tmp_path, monkeypatch):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(3_000_000)
    assert len(read_bytes(tmp_path / "large")) == 3_000_000
    monkeypatch.setenv(MAX_MB, "2")
    with pytest.raises(InputError, match=f"large: holds 3 MB, more than the limit of 2 MB; .*{MAX_MB}"):
        read_bytes(tmp_path / "large")
    check_size("large", 2_000_000)


@pytest.mark.parametrize("limit", ["", "0", "-1", "1.5", "many", "1" * 5000, "\u00b2"])
def test_a_limit_that_is_no_number_is_refused(monkeypatch, limit):
    monkeypatch.setenv(MAX_MB, limit)
    with pytest.raises(InputError, match=f"{MAX_MB}: must be a whole number"):
        check_size("x", 1)


def test_nothing_is_appended_to_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "journal.jsonl")
    with pytest.raises(InputError, match="is not a regular file"):
        append(tmp_path / "journal.jsonl", "{}\n")
