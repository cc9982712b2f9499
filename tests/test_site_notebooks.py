"""Notebooks of the gallery get what their page shows, once however often it is built: text, and pictures as PNG."""

import importlib.util
import json
import zipfile
from base64 import b64decode
from pathlib import Path

import pytest

SITE = Path(__file__).parents[1] / "docs" / "site"
PAGE = """
.. code-block:: Python

    print("one")

.. rst-class:: sphx-glr-script-out

 .. code-block:: none

    one
      two

.. GENERATED FROM PYTHON SOURCE LINES 3-4

.. code-block:: Python

    draw()

.. image-sg:: /gallery/images/a_001.png
   :alt: a drawing

.. image-sg:: /gallery/images/a_002.png
"""


@pytest.fixture
def notebooks():
    spec = importlib.util.spec_from_file_location("site_notebooks", SITE / "notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def gallery(tmp_path):
    (tmp_path / "images").mkdir()
    for number in (1, 2):
        (tmp_path / "images" / f"a_00{number}.png").write_bytes(bytes([number]))
    cells = [{"cell_type": kind, "source": [], "outputs": []} for kind in ("markdown", "code", "code")]
    (tmp_path / "a.ipynb").write_text(json.dumps({"cells": cells}))
    (tmp_path / "a.rst").write_text(PAGE)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.ipynb", "{}")
        archive.writestr("a.py", "print")
    return tmp_path


def test_a_notebook_holds_what_its_page_shows(notebooks, gallery):
    for _ in range(2):
        notebooks.fill(gallery)
        first, second = [cell["outputs"] for cell in json.loads((gallery / "a.ipynb").read_text())["cells"][1:]]
        assert first == [{"output_type": "stream", "name": "stdout", "text": "one\n  two\n"}]
        assert [b64decode(one["data"]["image/png"]) for one in second] == [b"\1", b"\2"]
        with zipfile.ZipFile(gallery / "a.zip") as archive:
            assert archive.read("a.ipynb") == (gallery / "a.ipynb").read_bytes()
            assert archive.read("a.py") == b"print"


def test_a_notebook_of_another_page_is_refused(notebooks, gallery):
    (gallery / "a.rst").write_text(PAGE + ".. code-block:: Python\n")
    with pytest.raises(ValueError, match="has 2 cells of code, its page 3"):
        notebooks.fill(gallery)


def test_the_site_fills_them_after_the_gallery_has_made_them(notebooks):
    assert '"notebooks"' in (SITE / "conf.py").read_text()
    called = []

    class App:
        def connect(self, event, function, priority):
            called.append((event, function, priority))

    notebooks.setup(App())
    assert called == [("builder-inited", notebooks._fill_all, 900)]  # 500 is that of sphinx-gallery
