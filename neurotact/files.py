"""Files are written whole and then renamed, outputs never replace inputs, and the size of an input is limited."""

import errno
import hashlib
import json
import math
import os
import secrets
import shutil
import socket
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from neurotact.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: folders are not locked there
    fcntl = None

DRAFT = ".draft-"
"""Prefix of a file that is being written; one that is left shows a process that was killed."""
LOCK = ".lock"
"""The lock file in a run folder, held by the process that works there."""
MAX_MB = "NEUROTACT_MAX_MB"
"""The environment variable that sets how large one input may be once it is in memory."""
DEFAULT_MAX_MB = 512
PLACE_IS_TO_BLAME = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM}
"""Write errors that another place, or more free space, fixes."""


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block ends well.

    If the block raises, `path` is as it was before and the temporary file is gone. If the process is killed, the next
    one that writes into the folder removes the file.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with whole(folder / "a.txt") as draft:
    ...     _ = draft.write_text("done")
    >>> (folder / "a.txt").read_text()
    'done'
    """
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(f"{path}: cannot be written, it is a folder; name a file")
    if os.path.exists(path) and not os.path.isfile(path):  # a rename would put a file in its place
        raise InputError(f"{path}: cannot be written, it is a pipe, a socket or a device; name a file")
    # The draft is named before it exists, so that an interrupt at any point finds the file to remove. It keeps the
    # suffix: matplotlib and others choose the format by it.
    draft = path.parent / f"{DRAFT}{_here()}-{os.getpid()}-{secrets.token_hex(8)}{path.suffix}"
    try:
        with _writable(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_drafts_of_killed(path.parent)
            draft.touch(exist_ok=False)
        with _writable(path, draft):
            yield draft
            draft.replace(path)
    finally:
        with suppress(OSError):  # the folder may have become read-only; the block's own error says so
            draft.unlink(missing_ok=True)


@cache
def _here() -> str:
    """Identifies the numbers of the processes that this one sees, those since the machine has started; or "any"."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
        return hashlib.sha256(f"{boot} {os.readlink('/proc/self/ns/pid')}".encode()).hexdigest()[:8]
    except (OSError, ValueError):  # not Linux
        return "any"


def _remove_drafts_of_killed(folder: Path) -> None:
    """Remove the drafts of processes that have ended; those of other machines, which cannot be asked, stay."""
    if _here() == "any":
        return
    for draft in folder.glob(f"{DRAFT}{_here()}-*-*"):
        number = draft.name.split("-")[2]
        if number.isdigit() and len(number) < 10 and _has_ended(int(number)):
            with suppress(OSError):
                draft.unlink()


def _has_ended(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:  # it runs for another user
        return False
    return False


@contextmanager
def _writable(path: Path, draft: Path | None = None) -> Iterator[None]:
    """Name `path` in an OSError; with `draft`, only in those that writing the draft can cause."""
    try:
        yield
    except OSError as error:
        is_ours = draft is None or error.errno in PLACE_IS_TO_BLAME or error.filename == str(draft)
        if not is_ours:
            raise
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be written ({reason}); free space there or choose another place") from error


def check_new(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path | None] = ()) -> None:
    """Refuse an output that exists, unless `force` is set; always refuse an output that is also an input.

    Call it before any work is done. Two paths to one file, by a link for instance, count as one file.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "spikes.h5"
    >>> check_new(path)
    >>> write_text(path, "")
    >>> check_new(path, force=True)
    """
    path = Path(path)
    with _writable(path), suppress(FileNotFoundError, NotADirectoryError):
        path.stat()  # a name that is too long is refused now, not after the work
    if not os.path.exists(path):
        return
    for given in inputs:
        if given is not None and os.path.exists(given) and path.samefile(given):
            raise InputError(f"{path}: is an input of this command; choose another output")
    if not force:
        raise InputError(f"{path}: already exists; choose another output or pass `force=True` to replace it")


def sweep(folder: str | Path) -> None:
    """Remove the drafts that a killed process left in `folder` and below; call it while holding the folder's lock."""
    for draft in Path(folder).rglob(f"{DRAFT}*"):
        if draft.is_file():
            with suppress(OSError):
                draft.unlink(missing_ok=True)


@contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """Lock `folder` (created if absent) for this process; InputError names the process that has locked it already.

    The operating system releases the lock when the process ends, however it ends. The lock file is removed, and so are
    the folders that this call created and nothing was written to. Where the operating system or the file system has no
    such locks, every process may work.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with locked(folder):
    ...     sorted(path.name for path in folder.iterdir())
    ['.lock']
    >>> list(folder.iterdir())
    []
    """
    folder = Path(folder)
    path = folder / LOCK
    with _writable(path):  # `exists` raises, too, for a name that is too long
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file; name a folder")
        made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _take(path)
    if descriptor is None:
        raise InputError(f"{folder}: {_holder(path)} is working here; wait for it to end, or stop it")
    try:
        who = {"pid": os.getpid(), "host": socket.gethostname(), "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}
        with _writable(path):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, json.dumps(who).encode())
        yield
    finally:
        # Removed while it is locked: afterwards it may be the lock of another process.
        with suppress(OSError):  # the folder may have become read-only; a released lock file may stay
            path.unlink(missing_ok=True)
        os.close(descriptor)
        for parent in made:
            with suppress(OSError):  # something was written to it
                parent.rmdir()


def _take(path: Path) -> int | None:
    """The descriptor of the locked file `path`; None if another process has locked it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)  # no process that this one starts inherits it
        if fcntl is None:
            return descriptor
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError:  # a file system without locks: work there is not refused
            return descriptor
        # The previous holder may have removed the file between the two calls above: then lock the new one.
        if _is_at(descriptor, path):
            return descriptor
        os.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _holder(path: Path) -> str:
    try:
        who = json.loads(path.read_text(encoding="utf-8"))
        return f"another neurotact (process {who['pid']} on {who['host']}, since {who['since']})"
    except (OSError, ValueError, TypeError, LookupError):
        return "another neurotact"


def write_text(path: str | Path, text: str) -> None:
    """Write `text` (UTF-8, newlines as given) to `path`, whole or not at all."""
    with whole(path) as draft:
        draft.write_bytes(text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as readable JSON; NaN and infinity are refused, since JSON has none."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def without_nan(value: Any) -> Any:
    """A value for JSON, in which what is not counted is null.

    >>> without_nan({"sops": float("nan"), "accuracies": [0.5, 1.0]})
    {'sops': None, 'accuracies': [0.5, 1.0]}
    """
    if isinstance(value, Mapping):
        return {key: without_nan(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def append(path: str | Path, text: str) -> None:
    """Append `text` to a file: after the return it is on the disk; after an exception nothing was added."""
    path = Path(path)
    if os.path.exists(path):
        existing(path)  # opening a pipe that nobody reads never returns
    with _writable(path), path.open("ab", buffering=0) as file:
        before = file.tell()
        try:
            if file.write(text.encode()) < len(text.encode()):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            raise


def read_json(path: str | Path) -> Any:
    """Read a JSON file; InputError names the file when it is absent or not JSON."""
    content = read_bytes(path)
    try:
        return json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON ({error}); restore the file or remove it") from error


def read_text(path: str | Path) -> str:
    """The text of a UTF-8 file; InputError as in `read_bytes`, and when it is not UTF-8."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8 text; save the file as UTF-8 text again") from error


def read_bytes(path: str | Path) -> bytes:
    """The content of a file; InputError when there is no such file, it cannot be read, or it is too large."""
    path = existing(path)
    with _readable(path):
        check_size(path, path.stat().st_size)
        return path.read_bytes()


def read_head(path: str | Path, n_bytes: int) -> bytes:
    """The first bytes of a file of any size; InputError as in `read_bytes`.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touch.csv"
    >>> write_text(path, "left,right")
    >>> read_head(path, 4)
    b'left'
    """
    path = existing(path)
    with _readable(path), path.open("rb") as file:
        return file.read(n_bytes)


def sha256(path: str | Path) -> str:
    """The SHA-256 of a file's content, read piece by piece; InputError as in `read_bytes`.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "empty"
    >>> write_text(path, "")
    >>> sha256(path)[:12]
    'e3b0c44298fc'
    """
    path = existing(path)
    with _readable(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be read ({reason}); check the file and its permissions") from error


def check_size(path: str | Path, n_bytes: int, limit: int | None = None) -> None:
    """Refuse an input that would exceed the memory limit, by its declared size, before it is read.

    limit: of `max_bytes` if absent.

    >>> check_size("touch.npz", 10**13)
    Traceback (most recent call last):
    neurotact.errors.InputError: touch.npz: holds 10,000,000 MB, more than the limit of 512 MB; set NEUROTACT_MAX_MB=...
    """
    limit = max_bytes() if limit is None else limit
    if n_bytes > limit:
        raise InputError(
            f"{path}: holds {n_bytes / 1e6:,.0f} MB, more than the limit of {limit / 1e6:,.0f} MB; "
            f"set {MAX_MB}=... to raise the limit"
        )


def max_bytes() -> int:
    """How many bytes one input may take in memory: `$NEUROTACT_MAX_MB`, by default 512 MB."""
    text = os.environ.get(MAX_MB, str(DEFAULT_MAX_MB))
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) >= 1):
        raise InputError(f"{MAX_MB}: must be a whole number of megabytes >= 1; got '{text[:40]}'")
    return int(text) * 1_000_000


def room_bytes() -> int:
    """How many bytes an array that is computed may take: `$NEUROTACT_MAX_MB`, or a quarter of the machine's memory.

    What a file declares may be damaged; what is computed has the size of recordings that were read.
    """
    if MAX_MB in os.environ:
        return max_bytes()
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not on every system
        memory = 0
    return max(max_bytes(), memory // 4)


@contextmanager
def scratch() -> Iterator[Path]:
    """Yield an empty folder for temporary files, which is removed when the block ends."""
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(TemporaryDirectory(prefix="neurotact-", ignore_cleanup_errors=True))
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(f"temporary files cannot be written ({reason}); set TMPDIR to another folder") from error
        yield Path(folder)


def is_free(folder: str | Path) -> bool:
    """Whether `folder` is absent or empty; a lock and drafts are ignored."""
    folder = Path(folder)
    if not os.path.isdir(folder):
        return not os.path.exists(folder)
    return all(path.name == LOCK or path.name.startswith(DRAFT) for path in folder.iterdir())


def empty(folder: str | Path) -> None:
    """Remove everything in a folder except its lock; for a folder that was free when this process locked it.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> write_text(folder / "study.toml", "a draft")
    >>> empty(folder)
    >>> is_free(folder)
    True
    """
    for entry in Path(folder).iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        elif entry.name != LOCK:
            entry.unlink()


def existing(path: str | Path, what: str = "file") -> Path:
    """`path` as a Path; InputError when there is no such file (with `what`: "folder", or "file or folder").

    Anything else, such as a pipe or a device, is never opened: reading it may not end. A name that is not UTF-8 is
    refused, since it becomes a label or a source, which files store as UTF-8.
    """
    path = Path(path)
    check_text(str(path))
    # os.path and not Path: a name that is too long, or in a folder without permission, counts as absent.
    is_there = {"file": os.path.isfile, "folder": os.path.isdir}
    if any(is_there[kind](path) for kind in what.split(" or ")):
        return path
    if "file" in what and os.path.exists(path) and not os.path.isdir(path):
        raise InputError(f"{path}: is not a regular file (a pipe, a socket or a device); give a file on disk")
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder; name a file")
    if os.path.exists(path):
        raise InputError(f"{path}: is a file; name a folder")
    raise InputError(f"{path}: there is no such {what}; check the path")


def named_by(holder: str | Path, name: str | Path) -> list[Path]:
    """Where a file that the file `holder` names may be: beside `holder`, then in the current folder; each place once.

    >>> [str(place) for place in named_by("runs/spikes.h5", "touch.h5")]
    ['runs/touch.h5', 'touch.h5']
    >>> [str(place) for place in named_by("runs/spikes.h5", "/data/touch.h5")]
    ['/data/touch.h5']
    """
    places = [Path(holder).parent / name, Path(name)]
    return places[:1] if places[0].absolute() == places[1].absolute() else places


def place_of(holder: str | Path, name: str | Path) -> Path | None:
    """The file or folder that the file `holder` names: the first of its places (`named_by`) where there is one."""
    return next((path for path in named_by(holder, name) if os.path.exists(path)), None)


def check_text(word: str) -> None:
    """Refuse an external text, such as a file name, that is not UTF-8."""
    try:
        word.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{word!a}: is not UTF-8 text; rename it") from error


def below(folder: str | Path) -> list[Path]:
    """The files in `folder` and its sub-folders, sorted by path; a hidden sub-folder is listed itself.

    Links to folders are followed; InputError when one leads to a folder that is read already, which could loop.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> write_text(folder / "felt" / "day1" / "a.csv", "")
    >>> [path.relative_to(folder).as_posix() for path in below(folder)]
    ['felt/day1/a.csv']
    """
    paths: list[Path] = []
    seen: dict[tuple[int, int], Path] = {}
    waiting = [existing(folder, "folder")]
    while waiting:
        here = waiting.pop()
        with _readable(here):
            stat = here.stat()
            names = sorted(os.listdir(here))
        first = seen.setdefault((stat.st_dev, stat.st_ino), here)
        if first is not here:
            raise InputError(f"{here}: leads to {first}, which is read already; remove the link")
        for name in names:
            enters = os.path.isdir(here / name) and not is_hidden(name)
            (waiting if enters else paths).append(here / name)
    return sorted(paths)


def is_hidden(name: str) -> bool:
    """Whether a file or folder is hidden or belongs to a program, such as `.DS_Store` or `__MACOSX`."""
    return name.startswith((".", "__"))
