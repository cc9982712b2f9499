"""A file is whole or as it was before, whatever happens while it is written."""

import os
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.errors import InputError
from neurotact.files import existing, read_json, whole, write_json, write_text

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


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_text_is_written_as_it_is(tmp_path, text):
    write_text(tmp_path / "text", text)
    assert (tmp_path / "text").read_bytes().decode() == text


@given(JSON)
def test_json_comes_back_equal(tmp_path, value):
    write_json(tmp_path / "value.json", value)
    assert read_json(tmp_path / "value.json") == value


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
    for path, what in ((tmp_path / "x", "file"), (tmp_path, "file"), (tmp_path / "file", "folder")):
        with pytest.raises(InputError, match=f"{path.name}: there is no such {what}"):
            existing(path, what)
