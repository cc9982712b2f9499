"""Processes that a command has started, as Linux lists them in /proc."""

from pathlib import Path


def descendants(pid: int) -> list[int]:
    """The children of a process, their children and so on; empty if it has ended."""
    try:
        children = [int(one) for task in Path(f"/proc/{pid}/task").iterdir() for one in _words(task / "children")]
    except OSError:
        return []
    return [one for child in children for one in (child, *descendants(child))]


def workers_of(pid: int) -> list[int]:
    """The worker processes of a command and the server that forks them, without the one that tracks resources."""
    return [one for one in descendants(pid) if b"resource_tracker" not in _command(one)]


def _words(path: Path) -> list[str]:
    return path.read_text().split()


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""
