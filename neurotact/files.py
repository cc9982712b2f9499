"""Files are written whole and then renamed, so that an interrupted run leaves no half of one."""

import json
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from neurotact.errors import InputError

DRAFT = ".draft-"
"""Begins the name of a file that is being written; one that is left shows a process that was killed."""


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends well.

    If the block raises, `path` is as it was before and the temporary file is gone.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with whole(folder / "a.txt") as draft:
    ...     _ = draft.write_text("done")
    >>> (folder / "a.txt").read_text()
    'done'
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: cannot be written, it is a folder; name a file")
    # Named before it is there, so that an interrupt at any point finds what to remove. The draft keeps the suffix:
    # matplotlib and others choose the format by it.
    draft = path.parent / f"{DRAFT}{secrets.token_hex(8)}{path.suffix}"
    with _writable(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with _writable(path):
            draft.touch(exist_ok=False)
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def _writable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from error


def write_text(path: str | Path, text: str) -> None:
    """Write `text` (UTF-8, newlines as given) to `path`, whole or not at all."""
    with whole(path) as draft:
        draft.write_bytes(text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as readable JSON; NaN and infinity are refused, since JSON has none."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_json(path: str | Path) -> Any:
    """Read a JSON file; InputError names the file when it is absent or not JSON."""
    try:
        return json.loads(existing(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: is not valid JSON ({error}); restore the file or remove it") from error


def is_free(folder: str | Path) -> bool:
    """Whether a run may be written there: nothing is there, or an empty folder."""
    folder = Path(folder)
    return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))


def existing(path: str | Path, what: str = "file") -> Path:
    """`path` as a Path; InputError when there is no such file (or folder, with `what='folder'`)."""
    path = Path(path)
    if what == "folder" and not path.is_dir():
        raise InputError(f"{path}: there is no such folder; check the path")
    if what == "file" and not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path")
    return path
