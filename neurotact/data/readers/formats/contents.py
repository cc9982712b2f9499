"""What a file holds. Its first bytes decide, not its name, so that a refusal says what is there and what to do."""

import json
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from neurotact.errors import InputError
from neurotact.files import read_head

HEAD_BYTES = 1 << 16
"""The first bytes of a file, which tell what it is."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048, 4096, 8192, 16384, 32768)
"""Where the signature of an HDF5 file may lie within its first bytes: other programs write before it."""
BEGIN_OF_LVM = "LabVIEW Measurement"
MARK = b"\xef\xbb\xbf"
"""The byte-order mark that some programs write before UTF-8 text."""


class Content(NamedTuple):
    """A kind of file. what: as in "the file is ..."; fix: what its user can do, as in "do ...".

    hides: whether the file stands for another one, or wraps it: then the fix helps whatever that one should be.
    """

    what: str
    fix: str
    hides: bool = False

    def refusal(self, where: str | Path, wanted: str = "", fix: str = "") -> InputError:
        """The error that says of a file, `where`, what it is and what to do.

        wanted, fix: what is read there, and how to get it; by default a table of samples.

        >>> LFS_POINTER.refusal("felt/1.csv")
        InputError('felt/1.csv: is a Git LFS pointer, not the file itself; fetch the file with git lfs pull')
        >>> PARQUET.refusal("felt/1.npz", "an .npz archive", "save it with numpy.savez")
        InputError('felt/1.npz: is not an .npz archive, but a Parquet table; save it with numpy.savez')
        """
        if self.hides or not wanted:
            return InputError(f"{where}: is {self.what}; {self.fix}")
        return InputError(f"{where}: is not {wanted}, but {self.what}; {fix}")


_KNOWN: list[tuple[re.Pattern[bytes], Content]] = []
"""What files of a kind begin with, in the order in which it is tried."""


def _begins(pattern: bytes, what: str, fix: str, *, hides: bool = False) -> Content:
    """A kind of file that begins with a pattern, in which a point is any byte if it is counted."""
    kind = Content(what, fix, hides)
    _KNOWN.append((re.compile(pattern, re.DOTALL if b".{" in pattern else 0), kind))
    return kind


def _table_of(reader: str) -> str:
    return f"save it as CSV, in Python with pandas.{reader}(...).to_csv(..., index=False)"


def _import(commands: str, suffix: str) -> str:
    return f"neurotact {commands}, with the suffix {suffix}"


SHEET = "save the sheet as CSV"
SAMPLES = "give the samples as numbers, a row per sample and a column per taxel"
EVENTS = "convert its events to CSV or NPZ with x, y, t and p, which neurotact import events reads"
PICKLED = "a Python pickle, which is never loaded, because loading it can run any code"
IN_ROWS = "write them as rows: rostopic echo -p TOPIC > touch.csv, or ros2 topic echo --csv TOPIC > touch.csv"

LFS_POINTER = _begins(
    rb"version https?://(git-lfs|hawser)\.github\.com/spec/",
    "a Git LFS pointer, not the file itself", "fetch the file with git lfs pull", hides=True,
)  # fmt: skip
ANNEX_POINTER = _begins(
    rb"/annex/objects/", "a git-annex pointer, not the file itself", "fetch the file with git annex get", hides=True
)
HTML = _begins(
    rb"(?i)\s*(<!--.{,1000}?-->\s*)?<(!doctype html|html)\b",
    "a web page (HTML), not the file itself", "download the file by its own link; it may need a login", hides=True,
)  # fmt: skip
XML = _begins(rb"\s*<\?xml\b", "an XML document", "export the samples as CSV")
RTF = _begins(rb"\{\\rtf", "a formatted document (RTF)", "save it as plain text")
PDF = _begins(rb"%PDF-", "a PDF document", SAMPLES)
NPY = _begins(rb"\x93NUMPY", "a NumPy array", _import("import folder reads it as a trial", ".npy"))
MATLAB = _begins(
    rb"MATLAB (5\.0|7\.3) MAT-file", "a MATLAB file", _import("import folder and import arrays read it", ".mat")
)
TDMS = _begins(rb"TDSm", "a LabVIEW TDMS file", _import("import folder reads it", ".tdms"))
TDMS_INDEX = _begins(rb"TDSh", "the index of a LabVIEW TDMS file", "give the .tdms file itself")
LVM = _begins(
    rb"\s*" + BEGIN_OF_LVM.encode() + rb"\b",
    "a LabVIEW measurement", _import("import folder and import table read it", ".lvm or .txt"),
)  # fmt: skip
PARQUET = _begins(rb"PAR1", "a Parquet table", _import("import folder and import table read it", ".parquet"))
FEATHER = _begins(rb"ARROW1\0|FEA1", "an Arrow table (Feather)", _table_of("read_feather"))
ORC = _begins(rb"ORC[\x08\x0a\x12]", "an ORC table", _table_of("read_orc"))
OLE = _begins(
    rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
    "an old Excel workbook (.xls) or another document of Microsoft Office", SHEET,
)  # fmt: skip
PICKLE = _begins(
    rb"\x80[\x02\x03][\](}\[cKXGN)]|\x80[\x04\x05]\x95|"
    rb"\([ld]p\d+\n|c(__builtin__|builtins|copy_?reg|collections|numpy|pandas|torch)[\w.]*\n\w+\n",
    PICKLED, "save arrays with numpy.savez, or a table with to_csv",
)  # fmt: skip
GZIP = _begins(rb"\x1f\x8b", "compressed by gzip", "unpack it with gunzip", hides=True)
BZIP2 = _begins(rb"BZh\d1AY&SY", "compressed by bzip2", "unpack it with bunzip2", hides=True)
XZ = _begins(rb"\xfd7zXZ\0", "compressed by xz", "unpack it with unxz", hides=True)
ZSTD = _begins(rb"\x28\xb5\x2f\xfd", "compressed by Zstandard", "unpack it with unzstd", hides=True)
TAR = _begins(rb".{257}ustar", "a tar archive", "unpack it with tar -xf and give the folder", hides=True)
SEVEN_ZIP = _begins(rb"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", "unpack it and give the folder", hides=True)
RAR = _begins(rb"Rar!\x1a\x07", "a RAR archive", "unpack it and give the folder", hides=True)
AEDAT4 = _begins(rb"#!AER-DAT4", "a file of events (AEDAT 4)", EVENTS)
AEDAT = _begins(rb"#!AER-DAT", "a file of events in an old AEDAT format", EVENTS)
PROPHESEE = _begins(
    rb"(% [^\n]{,200}\r?\n){,20}% (evt \d|camera_integrator_name|Data file containing (CD|TD) events)",
    "a file of events of a Prophesee camera", EVENTS,
)  # fmt: skip
ROS_BAG = _begins(rb"#ROSBAG V", "a ROS bag", _import("import folder reads it", ".bag"))
MCAP = _begins(rb"\x89MCAP0\r\n", "a bag of ROS 2 (MCAP)", _import("import folder reads it", ".mcap"))
SQLITE = _begins(
    rb"SQLite format 3\0", "an SQLite database",
    f"if it is a bag of ROS 2, {_import('import folder reads it', '.db3')}; else export a CSV",
)  # fmt: skip
ROS_YAML = _begins(rb"([a-z_]\w*:.*\n([ -].*\n)*)+---\n", "the messages of a ROS topic as YAML", IN_ROWS)
IMAGE = _begins(rb"\x89PNG\r\n|\xff\xd8\xff|GIF8[79]a|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF.{4}WEBP", "an image", SAMPLES)
SOUND = _begins(rb"RIFF.{4}WAVE", "a sound file (WAV)", _import("import folder reads it", ".wav"))
FLAC = _begins(rb"fLaC", "a sound file (FLAC)", _import("import folder reads it", ".flac"))
VIDEO = _begins(rb"RIFF.{4}AVI |.{4}ftyp|\x1a\x45\xdf\xa3", "a video", SAMPLES)
HDF5 = Content(
    "an HDF5 file",
    "neurotact import arrays reads one with the signals of all trials (suffix .h5), neurotact import nwb one of NWB",
)
JSON = Content("a JSON document", _table_of("read_json"))
JSON_LINES = Content("a file of JSON lines", "save it as CSV, in Python with pandas.read_json(..., lines=True).to_csv")
NPZ = Content("an archive of NumPy arrays", _import("import folder, arrays and events read it", ".npz"))
TORCH = Content("a PyTorch file", _import("import folder and import arrays read its tensors", ".pt"))
XLSX = Content("an Excel workbook", SHEET)
ODS = Content("a spreadsheet of LibreOffice", SHEET)
OFFICE = Content("a document of an office program", "save the table in it as CSV")
ZIP = Content("a zip archive", "unpack it and give the folder", hides=True)

JSON_BEGIN = re.compile(rb"\s*(\{\s*[\"}]|(\[\s*)+(\{\s*[\"}]|\"|-?\d[\d.eE+-]*\s*[,\]]|\]))")


@contextmanager
def damaged_as(path: str | Path, what: str, fix: str) -> Iterator[None]:
    """An InputError in place of whatever a library raises for damaged bytes, which may be nearly anything."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        why = (str(error).strip().splitlines() or [""])[0][:80] or type(error).__name__
        raise InputError(f"{path}: {what} ({why}); {fix}") from error


def content_of(path: str | Path) -> Content | None:
    """What a file holds; None for text of another kind, and for bytes that are of no known kind.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "felt.csv"
    >>> _ = path.write_text('{"t": 0, "left": 1}\\n{"t": 1, "left": 2}\\n')
    >>> content_of(path) is JSON_LINES
    True
    """
    head = read_head(path, HEAD_BYTES)
    return _of_zip(Path(path)) if head.startswith((b"PK\x03\x04", b"PK\x05\x06")) else content_of_bytes(head)


def check_content(path: str | Path, *kinds: Content, wanted: str = "", fix: str = "") -> None:
    """Refuse a file that is known to be of another kind than these. wanted, fix: as of `Content.refusal`."""
    kind = content_of(path)
    if kind is not None and kind not in kinds:
        raise kind.refusal(path, wanted, fix)


def content_of_bytes(head: bytes) -> Content | None:
    """What begins with these bytes, as by `content_of`; of a zip archive nothing more than that it is one.

    >>> content_of_bytes(b"1.0,2.0\\n3.0,4.0\\n"), content_of_bytes(b"PAR1\\x15\\x04").what
    (None, 'a Parquet table')
    """
    if any(head.startswith(HDF5_SIGNATURE, offset) for offset in HDF5_OFFSETS) and not head.startswith(b"MATLAB"):
        return HDF5
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return ZIP
    head = head.removeprefix(MARK)
    known = next((kind for pattern, kind in _KNOWN if pattern.match(head)), None)
    return known or _of_json(head)


def _of_json(head: bytes) -> Content | None:
    if not JSON_BEGIN.match(head):
        return None
    lines = [line for line in head.split(b"\n")[:-1] if line.strip()]
    with suppress(ValueError, RecursionError):
        if len(lines) > 1 and {type(json.loads(line)) for line in lines[:2]} <= {dict, list}:
            return JSON_LINES
    return JSON


def _of_zip(path: Path) -> Content:
    """What a zip archive is, by the names of its members."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except Exception:  # damaged bytes make zipfile raise nearly anything
        return ZIP
    if names and all(name.endswith(".npy") for name in names):
        return NPZ
    if any(name.endswith("/data.pkl") for name in names):
        return TORCH
    folders = {name.partition("/")[0] for name in names}
    if "xl" in folders:
        return XLSX
    if {"mimetype", "content.xml"} <= folders:
        return ODS
    return OFFICE if "[Content_Types].xml" in folders else ZIP
