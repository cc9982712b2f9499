"""The published touch-modality set: files written in its layout are read exactly, and damaged ones refused."""

import numpy as np
import pytest
from neurotact_parts.studies.touch_modality import reader as touch_modality

from neurotact.errors import InputError

ROWS = np.random.default_rng(5).normal(1.65, 0.02, (60, 16)).round(6)
"""Repeated to 10 s, since only the length of a file matters to the reader."""


def lvm(n_rows=30000, shift=0.0):
    lines = ["\t".join([f"{i / 3000:.6f}", *(f"{v:.6f}" for v in row + shift)]) for i, row in enumerate(ROWS)]
    return "\n".join((lines * (n_rows // len(lines) + 1))[:n_rows]) + "\n"


@pytest.fixture
def published(tmp_path):
    for number, label in enumerate(touch_modality.CLASSES):
        (tmp_path / label).mkdir()
        for name in ("b.lvm", "a.lvm"):
            (tmp_path / label / name).write_text(lvm(shift=number + (0.5 if name == "b.lvm" else 0.0)))
    return tmp_path


def refused(folder, message):
    with pytest.raises(InputError) as refusal:
        touch_modality.read(folder)
    assert message in str(refusal.value), str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_published_layout_is_read(published):
    (published / "sliding" / "a.lvm").write_text(lvm(30100, shift=2.0))
    (published / "notes.txt").write_text("mine")
    (published / "rolling" / "readme.txt").write_text("theirs")
    touch = touch_modality.read(published)
    assert np.asarray(touch.signals).shape == (6, 30000, 16)
    assert (touch.unit, touch.sampling_rate_Hz, touch.channels[0]) == ("V", 3000.0, "taxel1")
    assert touch.conditions.to_dict("list") == {
        "label": ["brushing", "brushing", "rolling", "rolling", "sliding", "sliding"],
        "file": [f"{c}/{f}.lvm" for c in touch_modality.CLASSES for f in "ab"],
    }
    for trial, shift in enumerate((0, 0.5, 1, 1.5, 2, 2.5)):
        np.testing.assert_allclose(touch.signals[trial][:60], ROWS + shift, rtol=0, atol=5e-7)


def test_other_folders_are_refused(published, tmp_path_factory):
    refused(published / "absent", "there is no such folder")
    (published / "rolling").rename(published / "roling")
    refused(published, f"{published}: holds no folder 'rolling'; give the folder that holds brushing, rolling and")
    (published / "roling").rename(published / "Rolling")  # the archive was unpacked on another system
    for name in "ab":
        (published / "Rolling" / f"{name}.lvm").unlink()
    refused(published, "Rolling: holds no .lvm file")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lvm(29999), "holds 29999 rows where 10 s at 3 kHz have 30000"),
        (lvm()[:-3], "the last line does not end, so the file was cut off"),
        ("LabVIEW Measurement\t\n" + lvm(), "line 1 holds 'LabVIEW Measurement' instead of a number"),
        (lvm().replace(".", ","), "line 1 holds '0,000000' instead of a number"),
        (lvm().replace("0.000000\t", "0.000000\tnan\t", 1), "line 1 has 18 columns where 17"),
        (lvm(2) + "1.0\t2.0\n" + lvm(), "line 3 has 2 columns where 17 are expected"),
        (
            lvm(3) + "\t".join(["1.0"] * 16 + ["nan"]) + "\n" + lvm(),
            "line 4, column 17 (taxel16) is nan; repair the gap",
        ),
        ("", "holds no row of numbers"),
    ],
)
def test_damaged_files_are_refused(published, text, message):
    (published / "brushing" / "a.lvm").write_text(text)
    refused(published, message)
    refused(published, "a.lvm: ")
