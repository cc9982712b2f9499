"""The text of a file, in the encodings that programs write, and nothing that is not text."""

import re
from pathlib import Path

from neurotact import files
from neurotact.data.readers.formats.contents import LVM, check_content
from neurotact.errors import InputError

MARKS = {b"\xff\xfe\0\0": "utf-32", b"\0\0\xfe\xff": "utf-32", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
"""Encodings by the byte-order mark that a text begins with."""
WESTERN = "cp1252"
"""The encoding of Western European Windows, in which latin-1 text reads the same."""
CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f\ufffd]")
"""Characters that no text holds, and the one for bytes that are none."""
HEAD_BYTES = 4096
MOST_NULS, FEWEST_NULS = 0.6, 0.1
"""Shares of zeros among every other byte of UTF-16 text: at least this of high bytes, at most that of low ones."""


def read_text(path: str | Path) -> str:
    """The text of a file, its lines ended by `\\n`, without a byte-order mark.

    InputError if it is text in no encoding of Unicode, or if the file holds another kind of data (`contents`).
    """
    return _decoded(path, _content(path))


def read_any_text(path: str | Path) -> tuple[str, str]:
    """As `read_text`, but Windows-1252 and latin-1 too; and what is to be said of the encoding, often nothing."""
    content = _content(path)
    try:
        return _decoded(path, content), ""
    except InputError:
        text = content.decode(WESTERN, errors="replace")
        if CONTROL.search(text):
            raise
    return with_line_ends(text), "not UTF-8, so read as Windows-1252 (latin-1)"


def split_header(text: str, path: str | Path) -> tuple[str, str]:
    """The first line and the rest of a published file, in which every line ends with a line break.

    InputError when the last line does not end: the file was cut off, and its last number may be too.
    """
    if not text.endswith("\n"):
        raise InputError(f"{path}: the last line does not end, so the file was cut off; copy or download it again")
    head, _, body = text.partition("\n")
    return head, body


def with_line_ends(text: str) -> str:
    """The text with `\\n` at the end of each line: for Windows' ends, old Macs', and those that were doubled.

    >>> with_line_ends("1\\r\\n2\\r\\r\\n3\\r4\\n")
    '1\\n2\\n3\\n4\\n'
    """
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")


def _content(path: str | Path) -> bytes:
    check_content(path, LVM)
    return files.read_bytes(path)


def _decoded(path: str | Path, content: bytes) -> str:
    encoding = _encoding(content)
    try:
        return with_line_ends(content.decode(encoding).removeprefix("\ufeff"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start} is not {encoding.upper()} text; save the file as UTF-8 text again"
        ) from error


def _encoding(content: bytes) -> str:
    marked = next((encoding for mark, encoding in MARKS.items() if content.startswith(mark)), None)
    if marked is not None:
        return marked
    head = content[:HEAD_BYTES]
    even, odd = (head[start::2].count(0) / max(1, len(head[start::2])) for start in (0, 1))
    if odd > MOST_NULS and even < FEWEST_NULS:
        return "utf-16-le"
    return "utf-16-be" if even > MOST_NULS and odd < FEWEST_NULS else "utf-8"
