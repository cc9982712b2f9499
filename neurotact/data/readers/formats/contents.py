"""What a file holds, by its first bytes and not by its name: a refusal then names what is there and what to do."""

import json
import re
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from neurotact.errors import InputError
from neurotact.files import read_head

HEAD_BYTES = 1 << 16
"""The first bytes of a file, which tell what it is."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048, 4096, 8192, 16384, 32768)
"""Where the signature of an HDF5 file may lie within its first bytes: other programs write before it."""
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


def _table_of(reader: str) -> str:
    return f"save it as CSV, in Python with pandas.{reader}(...).to_csv(..., index=False)"


SHEET = "save the sheet as CSV"
SAMPLES = "give the samples as numbers, a row per sample and a column per taxel"
EVENTS = "convert its events to CSV or NPZ with x, y, t and p, which neurotact import events reads"
PICKLED = "which is never loaded, because loading it can run any code"

LFS_POINTER = Content("a Git LFS pointer, not the file itself", "fetch the file with git lfs pull", hides=True)
ANNEX_POINTER = Content("a git-annex pointer, not the file itself", "fetch the file with git annex get", hides=True)
HTML = Content(
    "a web page (HTML), not the file itself", "download the file by its own link; it may need a login", hides=True
)
XML = Content("an XML document", "export the samples as CSV")
RTF = Content("a formatted document (RTF)", "save it as plain text")
PDF = Content("a PDF document", SAMPLES)
NPY = Content("a NumPy array", "neurotact import folder reads it as a trial, with the suffix .npy")
NPZ = Content("an archive of NumPy arrays", "neurotact import folder, arrays and events read it, with the suffix .npz")
MATLAB = Content("a MATLAB file", "neurotact import folder and import arrays read it, with the suffix .mat")
HDF5 = Content(
    "an HDF5 file",
    "neurotact import arrays reads one with the signals of all trials (suffix .h5), neurotact import nwb one of NWB",
)
TDMS = Content("a LabVIEW TDMS file", "neurotact import folder reads it, with the suffix .tdms")
TDMS_INDEX = Content("the index of a LabVIEW TDMS file", "give the .tdms file itself")
LVM = Content("a LabVIEW measurement", "neurotact import folder and import table read it, with the suffix .lvm or .txt")
JSON = Content("a JSON document", _table_of("read_json"))
JSON_LINES = Content("a file of JSON lines", "save it as CSV, in Python with pandas.read_json(..., lines=True).to_csv")
XLSX = Content("an Excel workbook", SHEET)
OLE = Content("an old Excel workbook (.xls) or another document of Microsoft Office", SHEET)
ODS = Content("a spreadsheet of LibreOffice", SHEET)
OFFICE = Content("a document of an office program", "save the table in it as CSV")
PARQUET = Content("a Parquet table", "neurotact import folder and import table read it, with the suffix .parquet")
FEATHER = Content("an Arrow table (Feather)", _table_of("read_feather"))
ORC = Content("an ORC table", _table_of("read_orc"))
PICKLE = Content(f"a Python pickle, {PICKLED}", "save arrays with numpy.savez, or a table with to_csv")
TORCH = Content("a PyTorch file", "neurotact import folder and import arrays read its tensors, with the suffix .pt")
ZIP = Content("a zip archive", "unpack it and give the folder", hides=True)
GZIP = Content("compressed by gzip", "unpack it with gunzip", hides=True)
BZIP2 = Content("compressed by bzip2", "unpack it with bunzip2", hides=True)
XZ = Content("compressed by xz", "unpack it with unxz", hides=True)
ZSTD = Content("compressed by Zstandard", "unpack it with unzstd", hides=True)
TAR = Content("a tar archive", "unpack it with tar -xf and give the folder", hides=True)
SEVEN_ZIP = Content("a 7-Zip archive", "unpack it and give the folder", hides=True)
RAR = Content("a RAR archive", "unpack it and give the folder", hides=True)
AEDAT = Content("a file of events in an old AEDAT format", EVENTS)
AEDAT4 = Content("a file of events (AEDAT 4)", EVENTS)
PROPHESEE = Content("a file of events of a Prophesee camera", EVENTS)
ROS_BAG = Content("a ROS bag", "neurotact import folder reads it, with the suffix .bag")
ROS_YAML = Content(
    "the messages of a ROS topic as YAML",
    "write them as rows: rostopic echo -p TOPIC > touch.csv, or ros2 topic echo --csv TOPIC > touch.csv",
)
MCAP = Content("a bag of ROS 2 (MCAP)", "neurotact import folder reads it, with the suffix .mcap")
SQLITE = Content(
    "an SQLite database",
    "if it is a bag of ROS 2, neurotact import folder reads it, with the suffix .db3; else export a CSV",
)
IMAGE = Content("an image", SAMPLES)
SOUND = Content("a sound file (WAV)", "neurotact import folder reads it, with the suffix .wav")
FLAC = Content("a sound file (FLAC)", "neurotact import folder reads it, with the suffix .flac")
VIDEO = Content("a video", SAMPLES)

FIRST_BYTES: tuple[tuple[bytes, Content], ...] = (
    (rb"version https?://(git-lfs|hawser)\.github\.com/spec/", LFS_POINTER),
    (rb"/annex/objects/", ANNEX_POINTER),
    (rb"(?i)\s*(<!--.{,1000}?-->\s*)?<(!doctype html|html)\b", HTML),
    (rb"\s*<\?xml\b", XML),
    (rb"\{\\rtf", RTF),
    (rb"%PDF-", PDF),
    (rb"\x93NUMPY", NPY),
    (rb"MATLAB (5\.0|7\.3) MAT-file", MATLAB),
    (rb"TDSm", TDMS),
    (rb"TDSh", TDMS_INDEX),
    (rb"\s*LabVIEW Measurement\b", LVM),
    (rb"PAR1", PARQUET),
    (rb"ARROW1\0|FEA1", FEATHER),
    (rb"ORC[\x08\x0a\x12]", ORC),
    (rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", OLE),
    (rb"\x80[\x02\x03][\](}\[cKXGN)]|\x80[\x04\x05]\x95", PICKLE),
    (rb"\([ld]p\d+\n|c(__builtin__|builtins|copy_?reg|collections|numpy|pandas|torch)[\w.]*\n\w+\n", PICKLE),
    (rb"\x1f\x8b", GZIP),
    (rb"BZh\d1AY&SY", BZIP2),
    (rb"\xfd7zXZ\0", XZ),
    (rb"\x28\xb5\x2f\xfd", ZSTD),
    (rb".{257}ustar", TAR),
    (rb"7z\xbc\xaf\x27\x1c", SEVEN_ZIP),
    (rb"Rar!\x1a\x07", RAR),
    (rb"#!AER-DAT4", AEDAT4),
    (rb"#!AER-DAT", AEDAT),
    (rb"(% [^\n]{,200}\r?\n){,20}% (evt \d|camera_integrator_name|Data file containing (CD|TD) events)", PROPHESEE),
    (rb"#ROSBAG V", ROS_BAG),
    (rb"\x89MCAP0\r\n", MCAP),
    (rb"SQLite format 3\0", SQLITE),
    (rb"([a-z_]\w*:.*\n([ -].*\n)*)+---\n", ROS_YAML),
    (rb"\x89PNG\r\n|\xff\xd8\xff|GIF8[79]a|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF.{4}WEBP", IMAGE),
    (rb"RIFF.{4}WAVE", SOUND),
    (rb"fLaC", FLAC),
    (rb"RIFF.{4}AVI |.{4}ftyp|\x1a\x45\xdf\xa3", VIDEO),
)
"""What files of a kind begin with, as regular expressions."""
_FIRST_BYTES = tuple((re.compile(pattern, re.DOTALL if b".{" in pattern else 0), kind) for pattern, kind in FIRST_BYTES)
JSON_BEGIN = re.compile(rb"\s*(\{\s*[\"}]|(\[\s*)+(\{\s*[\"}]|\"|-?\d[\d.eE+-]*\s*[,\]]|\]))")


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
    known = next((kind for pattern, kind in _FIRST_BYTES if pattern.match(head)), None)
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
