"""CITATION.cff has the keys of the Citation File Format 1.2.0, and says what the package says."""

import re
import tomllib
from datetime import date
from pathlib import Path

import neurotact as nt

ROOT = Path(__file__).parents[1]
KEYS = {
    "abstract", "authors", "cff-version", "commit", "contact", "date-released", "doi", "identifiers", "keywords",
    "license", "license-url", "message", "preferred-citation", "references", "repository", "repository-artifact",
    "repository-code", "title", "type", "url", "version",
}  # fmt: skip
ENTITY = {
    "address", "alias", "city", "country", "date-end", "date-start", "email", "fax", "location", "name", "orcid",
    "post-code", "region", "tel", "website",
}  # fmt: skip
PERSON = {
    "address", "affiliation", "alias", "city", "country", "email", "family-names", "fax", "given-names",
    "name-particle", "name-suffix", "orcid", "post-code", "region", "tel", "website",
}  # fmt: skip


def test_the_citation_is_one_of_the_format_and_of_this_package():
    text = (ROOT / "CITATION.cff").read_text()
    found = dict(re.findall(r"^([\w-]+):[ ]*(.*)$", text, re.MULTILINE))
    assert {*found} <= KEYS
    assert {"authors", "cff-version", "message", "title", "version", "license", "date-released"} <= {*found}
    assert found["cff-version"] == "1.2.0"
    assert found["version"] == nt.__version__
    assert date.fromisoformat(found["date-released"])
    assert found["license"] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"]


def test_each_author_is_a_person_or_an_entity():
    block = re.search(r"^authors:\n((?:[ -].*\n)+)", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert block is not None
    for author in re.split(r"^  - ", block[1], flags=re.MULTILINE)[1:]:
        keys = set(re.findall(r"^ *([\w-]+):", author, re.MULTILINE))
        assert keys <= (ENTITY if "name" in keys else PERSON)
        assert keys & {"name", "family-names", "given-names", "alias"}
