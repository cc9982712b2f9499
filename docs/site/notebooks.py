"""Notebooks of the gallery hold what their cells print and draw: whoever opens one sees it before running it.

The gallery runs each example and writes its page, and a notebook without outputs; here the outputs of the page become
those of the notebook, and of the notebook in the archive beside it.
"""

import json
import re
import textwrap
import zipfile
from base64 import b64encode
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

CODE = ".. code-block:: Python\n"
"""Begins each block of code on a page of the gallery, what it printed and drew comes after it."""
PICTURE = re.compile(r"^ *\.\. image-sg:: /\w+/(\S+)$", re.MULTILINE)
PRINTED = re.compile(r"^\.\. rst-class:: sphx-glr-script-out\n\n \.\. code-block:: none\n\n((?: {4}.*\n|\n)+)", re.M)
AFTER_THE_GALLERY = 900


def fill(folder: Path) -> None:
    """Write outputs into every notebook in the folder of a gallery; ValueError where page and notebook differ."""
    for path in sorted(folder.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        blocks = path.with_suffix(".rst").read_text(encoding="utf-8").split(CODE)[1:]
        cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        if len(cells) != len(blocks):
            raise ValueError(f"{path}: has {len(cells)} cells of code, its page {len(blocks)}")
        for cell, block in zip(cells, blocks, strict=True):
            cell["outputs"] = outputs(block, folder)
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False), encoding="utf-8")
        archive = path.with_suffix(".zip")
        if archive.exists():
            with zipfile.ZipFile(archive) as held:
                others = {name: held.read(name) for name in held.namelist()}
            with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as new:
                for name, content in others.items():
                    new.writestr(name, path.read_bytes() if name.endswith(path.name) else content)


def outputs(block: str, folder: Path) -> list[dict[str, Any]]:
    """What a block of a page printed, and its pictures, as a notebook holds them."""
    printed = [
        {"output_type": "stream", "name": "stdout", "text": textwrap.dedent(text).strip("\n") + "\n"}
        for text in PRINTED.findall(block)
    ]
    drawn = [
        {
            "output_type": "display_data",
            "data": {"image/png": b64encode((folder / picture).read_bytes()).decode("ascii"), "text/plain": picture},
            "metadata": {},
        }
        for picture in PICTURE.findall(block)
    ]
    return [*printed, *drawn]


def _fill_all(app: "Sphinx") -> None:
    fill(Path(app.srcdir, app.config.sphinx_gallery_conf["gallery_dirs"]))


def setup(app: "Sphinx") -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", _fill_all, priority=AFTER_THE_GALLERY)
    return {"parallel_read_safe": True}
