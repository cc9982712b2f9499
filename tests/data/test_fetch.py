"""Public sets: downloaded whole with their hashes, or said what to do; never half a file, never another one."""

import gzip
import hashlib
import json
import threading
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from neurotact import plugins
from neurotact.data import fetch
from neurotact.errors import InputError

CONTENT = {"a.csv": b"1,2\n", "b.csv": b"3,4\n"}


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        """Say nothing."""


@pytest.fixture
def served(tmp_path, monkeypatch):
    """A server of two files, whose hashes stand in the registry of fabricslide; its address and its folder."""
    place = tmp_path / "served"
    place.mkdir()
    for name, content in CONTENT.items():
        (place / name).write_bytes(content)
    known = {name: f"sha256:{hashlib.sha256(content).hexdigest()}" for name, content in CONTENT.items()}
    monkeypatch.setattr(fetch, "registry_of", lambda name: known)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(place))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/", place
        server.shutdown()


def test_what_is_missing_is_downloaded_and_nothing_else(served, tmp_path):
    pytest.importorskip("pooch")
    url, _ = served
    into = tmp_path / "fabricslide"
    (into / "fabric").mkdir(parents=True)
    (into / "fabric/a.csv").write_bytes(b"1,")  # cut off
    assert fetch.missing("fabricslide", into) == ["a.csv", "b.csv"]
    told = []
    assert fetch.fetch("fabricslide", into, lambda n, name: told.append(name), base_url=url) == 2
    assert told == ["a.csv", "b.csv"]
    assert {path.name: path.read_bytes() for path in (into / "fabric").iterdir()} == CONTENT
    assert fetch.fetch("fabricslide", into, base_url=url) == 0


def test_another_file_than_the_published_one_is_refused(served, tmp_path):
    pytest.importorskip("pooch")
    url, place = served
    (place / "b.csv").write_bytes(b"5,6\n")
    with pytest.raises(InputError, match=r"b\.csv is not the published file .*copy the CSV files"):
        fetch.fetch("fabricslide", tmp_path / "into", base_url=url)
    assert not (tmp_path / "into/fabric/b.csv").exists()


def test_where_nothing_is_reached_the_way_by_hand_is_said(served, tmp_path):
    pytest.importorskip("pooch")
    with pytest.raises(InputError, match=r"cannot be downloaded .*from https://github\.com/wngfra/FabricSlide to .*"):
        fetch.fetch("fabricslide", tmp_path, base_url="http://127.0.0.1:9/")


@pytest.mark.parametrize("name", [name for name, about in fetch.SETS.items() if about.base_url is None])
def test_sets_by_hand_say_what_and_where(name, tmp_path):
    with pytest.raises(InputError, match=r"(download|fill in)") as refusal:
        fetch.fetch(name, tmp_path / name)
    assert str(tmp_path / name) in str(refusal.value)
    assert fetch.SETS[name].page in str(refusal.value)


def test_every_set_says_its_licence_size_and_citation():
    for about in fetch.SETS.values():
        assert all((about.about, about.licence, about.size, about.citation, about.page.startswith("https://")))


def test_the_registry_holds_the_published_files():
    known = fetch.registry_of("fabricslide")
    assert len(known) == 644
    assert all(name.endswith(".csv") and len(digest) == 71 for name, digest in known.items())


def test_an_unknown_set_names_the_nearest():
    with pytest.raises(InputError, match="no set 'fabric-slide'; did you mean 'fabricslide'"):
        fetch.public_set("fabric-slide")


@pytest.fixture
def published(tmp_path, monkeypatch):
    """A record at Zenodo with two archives and their hashes, served here: its folder, and the entry of each file."""
    pooch = pytest.importorskip("pooch")
    place = tmp_path / "served"
    (place / "api").mkdir(parents=True)
    with zipfile.ZipFile(place / "a set.zip", "w") as archive:
        archive.writestr("a set/one.h5", b"1")
    (place / "two.h5.gz").write_bytes(gzip.compress(b"2"))
    names = ("a set.zip", "two.h5.gz")
    known = {name: f"md5:{hashlib.md5((place / name).read_bytes()).hexdigest()}" for name in names}
    monkeypatch.setattr(fetch, "registry_of", lambda name: known)
    monkeypatch.setattr(pooch.downloaders, "doi_to_url", lambda doi, **_: f"https://zenodo.org/records/{doi[-8:]}")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(place))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/"
        monkeypatch.setattr(pooch.downloaders.ZenodoRepository, "base_api_url", f"{url}api")
        entries = [{"key": name, "checksum": known[name], "links": {"self": url + name}} for name in names]
        (place / "api/19469535").write_text(json.dumps({"files": entries}))
        yield place
        server.shutdown()


def test_a_doi_is_followed_and_what_it_leads_to_is_unpacked(published, tmp_path):
    into = tmp_path / "stemnist"
    assert fetch.fetch("stemnist", into) == 2
    assert (into / "a set/a set/one.h5").read_bytes() == b"1"
    assert (into / "two.h5").read_bytes() == b"2"
    assert sorted(path.name for path in into.iterdir()) == ["a set", "a set.zip", "two.h5", "two.h5.gz"]
    assert fetch.fetch("stemnist", into) == 0
    (into / "two.h5").unlink()
    assert fetch.missing("stemnist", into) == ["two.h5.gz"]
    (into / "a set.zip").write_bytes(b"cut")
    assert fetch.fetch("stemnist", into) == 2
    assert (into / "two.h5").read_bytes() == b"2"


def test_an_archive_whose_hash_differs_is_not_unpacked(published, tmp_path):
    (published / "two.h5.gz").write_bytes(gzip.compress(b"3"))
    with pytest.raises(InputError, match=r"two\.h5\.gz is not the published file \(its hash differs\); download"):
        fetch.fetch("stemnist", tmp_path / "into")
    assert not [*(tmp_path / "into").glob("two*")]


@pytest.mark.parametrize("record", ['{"files": []}', '{"message": "it is gone"}', "no record"])
def test_a_record_that_lacks_the_file_is_said(published, tmp_path, record):
    (published / "api/19469535").write_text(record)
    with pytest.raises(InputError, match=r"a set\.zip cannot be downloaded .*; download 'STEMNIST Dataset\.zip'"):
        fetch.fetch("stemnist", tmp_path / "into")


@pytest.mark.parametrize("name", ["stemnist", "shd"])
def test_the_hashes_of_archives_are_known(name):
    known = fetch.registry_of(name)
    assert all(file.endswith((".zip", ".gz")) and len(digest) == 36 for file, digest in known.items())
    assert all(digest.startswith("md5:") for digest in known.values())


def test_every_set_is_read_by_a_reader_that_exists():
    assert {about.reader for about in fetch.SETS.values()} <= {"", *plugins.names("readers")}
