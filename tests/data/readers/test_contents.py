"""What a file holds is told by its content: each kind as the programs write it, and no table of numbers is one."""

import bz2
import gzip
import io
import json
import lzma
import pickle
import sqlite3
import tarfile
import wave
import zipfile
from collections.abc import Callable

import h5py
import numpy as np
import pytest
import scipy.io
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from neurotact.data.readers.formats import contents
from neurotact.data.readers.formats.contents import Content, content_of, content_of_bytes

SIGNAL = np.arange(6.0).reshape(3, 2)
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 28644058\n"
ROWS = [{"t": 0, "left": 1.5}, {"t": 1, "left": 2.5}]


def zipped(*names: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in names:
            archive.writestr(name, "content")
    return stream.getvalue()


def written(write: Callable[[io.BytesIO], object]) -> bytes:
    stream = io.BytesIO()
    write(stream)
    return stream.getvalue()


def sound(stream: io.BytesIO) -> None:
    with wave.open(stream, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(20))


def tarred(stream: io.BytesIO) -> None:
    with tarfile.open(fileobj=stream, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("felt/1.csv"))


def hdf5(user_block: int) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=user_block) as file:
        file["touch"] = SIGNAL
    return stream.getvalue()


def image(kind: str) -> bytes:
    return written(lambda stream: Image.new("RGB", (4, 4)).save(stream, kind))


KINDS: list[tuple[Content, bytes]] = [
    (contents.LFS_POINTER, LFS),
    (contents.LFS_POINTER, contents.MARK + LFS),
    (contents.ANNEX_POINTER, b"/annex/objects/SHA256E-s28644058--0123.csv\n"),
    (contents.HTML, b"\n<!DOCTYPE html>\n<html><body>Sign in</body></html>"),
    (contents.HTML, b"<!-- saved -->\n<HTML lang='en'>"),
    (contents.XML, b'<?xml version="1.0"?>\n<TDM/>'),
    (contents.RTF, b"{\\rtf1\\ansi 1,2\\par}"),
    (contents.PDF, b"%PDF-1.7\n"),
    (contents.NPY, written(lambda stream: np.save(stream, SIGNAL))),
    (contents.NPZ, written(lambda stream: np.savez(stream, touch=SIGNAL))),
    (contents.MATLAB, written(lambda stream: scipy.io.savemat(stream, {"touch": SIGNAL}))),
    (contents.MATLAB, b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + hdf5(0)),
    (contents.HDF5, hdf5(0)),
    (contents.HDF5, hdf5(1024)),
    (contents.TDMS, b"TDSm\x0e\0\0\0\x69\x12\0\0"),
    (contents.TDMS_INDEX, b"TDSh\x0e\0\0\0"),
    (contents.LVM, b"LabVIEW Measurement\t\r\nWriter_Version\t2\r\n"),
    (contents.JSON, json.dumps(ROWS).encode()),
    (contents.JSON, json.dumps({"signals": SIGNAL.tolist()}, indent=2).encode()),
    (contents.JSON, json.dumps(SIGNAL.tolist()).encode()),
    (contents.JSON, b"[1.5, 2.5]\n"),
    (contents.JSON_LINES, "\n".join(map(json.dumps, ROWS)).encode() + b"\n"),
    (contents.JSON_LINES, b"[0, 1.5]\n\n[1, 2.5]\n"),
    (contents.XLSX, zipped("[Content_Types].xml", "xl/workbook.xml")),
    (contents.ODS, zipped("mimetype", "content.xml")),
    (contents.OFFICE, zipped("[Content_Types].xml", "word/document.xml")),
    (contents.OLE, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"),
    (contents.PARQUET, b"PAR1\x15\x04"),
    (contents.FEATHER, b"ARROW1\0\0"),
    (contents.ORC, b"ORC\x08\x03"),
    *((contents.PICKLE, pickle.dumps(each, protocol)) for each in (ROWS, [1, 2], SIGNAL) for protocol in (0, 2, 4)),
    (contents.TORCH, written(lambda stream: torch.save(torch.ones(3), stream))),
    (contents.ZIP, zipped("felt/1.csv")),
    (contents.ZIP, zipped()),
    (contents.ZIP, zipped("felt/1.csv")[:-9]),
    (contents.GZIP, gzip.compress(b"1,2\n")),
    (contents.BZIP2, bz2.compress(b"1,2\n")),
    (contents.XZ, lzma.compress(b"1,2\n")),
    (contents.ZSTD, b"\x28\xb5\x2f\xfd\x04"),
    (contents.TAR, written(tarred)),
    (contents.SEVEN_ZIP, b"7z\xbc\xaf\x27\x1c\0"),
    (contents.RAR, b"Rar!\x1a\x07\x01"),
    (contents.AEDAT, b"#!AER-DAT2.0\r\n# This is a raw AE data file"),
    (contents.AEDAT4, b"#!AER-DAT4.0\r\n\x10\0\0\0"),
    (contents.PROPHESEE, b"% date 2024-01-31\n% evt 3.0\n\0\x80"),
    (contents.PROPHESEE, b"% Data file containing CD events.\n% Version 2\n"),
    (contents.ROS_BAG, b"#ROSBAG V2.0\nE\0\0\0"),
    (contents.MCAP, b"\x89MCAP0\r\n\x01"),
    (contents.SQLITE, b"SQLite format 3\0"),
    (contents.ROS_YAML, b"header: \n  seq: 1\n  stamp: \n    secs: 1\ndata: [1, 2]\n---\nheader: \n  seq: 2\n"),
    (contents.ROS_YAML, b"data:\n- 1.5\n- 2.5\n---\n"),
    *((contents.IMAGE, image(kind)) for kind in ("PNG", "JPEG", "GIF", "BMP", "TIFF", "WEBP")),
    (contents.SOUND, written(sound)),
    (contents.FLAC, b"fLaC\0\0\0\x22"),
    (contents.VIDEO, b"\0\0\0\x20ftypisom"),
]


@pytest.mark.parametrize(("kind", "content"), KINDS, ids=[f"{n} {kind.what[:24]}" for n, (kind, _) in enumerate(KINDS)])
def test_a_kind_is_known_by_its_content(tmp_path, kind, content):
    (tmp_path / "1.csv").write_bytes(content)
    assert content_of(tmp_path / "1.csv") is kind
    is_archive = content.startswith(b"PK")
    assert content_of_bytes(content) is (contents.ZIP if is_archive else kind)
    message = str(kind.refusal(tmp_path / "1.csv"))
    assert message == f"{tmp_path / '1.csv'}: is {kind.what}; {kind.fix}"


def test_an_sqlite_file_is_one(tmp_path):
    path = tmp_path / "bag.db3"
    with sqlite3.connect(path) as base:
        base.execute("create table messages (data)")
    base.close()
    assert content_of(path) is contents.SQLITE


def test_every_kind_is_tried():
    declared = {each for each in vars(contents).values() if isinstance(each, Content)}
    assert declared == {kind for kind, _ in KINDS}


@pytest.mark.parametrize(
    "text",
    [
        "", "\n", "1.0 2.0\n3.0 4.0\n", "channel\n12\n13\n", "left,right\n1,2\n", "0       1\n1       2\n",
        "% time left\n0 1\n", "%time,field.data\n1,2\n", "# made by hand\n1\t2\n", "BM,a\n1,2\n", "c1\nx\n",
        "PARTS\n1\n", "sep=;\n1;2\n", "[N];[s]\n1;2\n", "time: 12\nleft,right\n1,2\n", "version 1\n1,2\n",
        "ORC,b\n1,2\n", "(lp,b)\n1,2\n",
    ],
)  # fmt: skip
def test_text_is_of_no_other_kind(text):
    assert content_of_bytes(text.encode()) is None


@given(
    st.lists(st.text(st.characters(codec="ascii", categories=["L", "N"]), min_size=1), min_size=1, max_size=4),
    st.lists(st.lists(st.floats(), min_size=1, max_size=4), max_size=4),
    st.sampled_from(",;\t "),
)
def test_no_table_is_of_another_kind(names, rows, separator):
    lines = [separator.join(names), *(separator.join(map(repr, row)) for row in rows)]
    assert content_of_bytes("\n".join(lines).encode()) is None


@given(st.binary(max_size=40))
def test_any_bytes_are_of_one_kind_or_none(head):
    assert isinstance(content_of_bytes(head), Content | None)


def test_the_search_for_a_kind_takes_linear_time():
    """A pattern that tries every way to divide lines would not end."""
    for line in (b"a: b\n", b" x\n", b"- x\n", b"% x\n", b"<!-- ", b"\n", b"[", b'{"'):
        assert content_of_bytes(line * 10_000) in (None, contents.JSON)
