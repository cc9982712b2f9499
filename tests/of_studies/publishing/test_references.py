"""What parts cite is in the references, complete; each part declares its source itself."""

import re
import shutil
import subprocess
from types import SimpleNamespace

import pytest
from neurotact_parts.studies.publishing import methods, references

from neurotact import plugins
from neurotact.data import augmentation
from neurotact.data.fetch import SETS
from neurotact.encoders import specs as encoders
from neurotact.networks.training import balancing
from neurotact.spec import shipped
from neurotact.studies import loading


def test_every_source_that_a_part_cites_has_a_complete_entry(monkeypatch):
    ours = [
        (group, name)
        for group in ("encoders", "networks", "opponents", "ways")
        for name in plugins.names(group)
        if plugins.is_ours(group, name)
    ]
    ours += [("prices", path.stem) for path in shipped("prices")]
    monkeypatch.setattr(references, "used", lambda study: ours)
    told = [*references.texts(SimpleNamespace()), augmentation.__doc__ or "", balancing.__doc__ or ""]
    numbers = {number for text in told for number in references.numbers_in(text)}
    assert len(numbers) > 15
    assert numbers - {*references.known()} == set()


def test_entries_have_keys_of_their_own_and_what_a_reference_needs():
    entries = [*dict.fromkeys(references.known().values())]
    keys = [re.match(r"@\w+\{(\w+),", entry)[1] for entry in entries]
    assert len(keys) == len({*keys})
    for entry in entries:
        fields = dict(references.FIELD.findall(entry))
        assert {"author", "title"} <= {*fields}
        assert "year" in fields or "of" in fields
        assert all(value.count("{") == value.count("}") for value in fields.values())


@pytest.mark.parametrize("name", SETS)
def test_the_citation_of_a_public_set_becomes_an_entry(name):
    fields = dict(references.FIELD.findall(references._of_citation(name)))
    first = re.split(r",| et al", SETS[name].citation)[0].split()[-1]
    assert first in fields["author"].replace(r"M{\"u}ller", "Müller")
    assert "et al" not in fields["author"]
    assert fields.get("doi") or fields.get("url") or fields.get("eprint")


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("bibtex") is None, reason="needs bibtex")
def test_bibtex_takes_every_entry_without_a_warning(tmp_path):
    """The plain style, which knows neither `@software` nor entries without an author or a key."""
    ours = [*dict.fromkeys([*references.known().values(), *map(references._of_citation, SETS)])]
    ours += map(references._by_number, ("10.1234/a_b(1)", "2501.00001"))
    (tmp_path / "r.bib").write_text("\n".join(ours), encoding="utf-8")
    (tmp_path / "t.aux").write_text("\\citation{*}\n\\bibstyle{plain}\n\\bibdata{r}\n")
    done = subprocess.run(["bibtex", "t"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, [line for line in done.stdout.splitlines() if "arning" in line]) == (0, [])
    assert (tmp_path / "t.bbl").read_text().count("bibitem") == len(ours)


def test_software_has_its_version_and_what_did_not_run_is_not_cited():
    study = loading.resolve("refractory-period")
    entries = references.bibtex(study, {"torch": "2.1", "nni": "3.0", "snntorch": "1.0"})
    assert "note = {Version 2.1}" in entries
    assert "nni" not in entries
    assert "snntorch" not in entries
    assert "of = " not in entries


@pytest.mark.parametrize(
    ("changes", "has"),
    [
        ({}, False),
        ({"augmentation.kind": "time+gain"}, True),
        ({"augmentation.kind": "auto"}, False),
        ({"augmentation.kind": "none"}, False),
        ({"augmentation.kind": "auto", "split.test_where": {"force_N": [3.0]}}, True),
    ],
)
def test_varied_copies_are_cited_where_networks_train_on_them(changes, has):
    study = loading.resolve("refractory-period", changes)
    assert references.has_copies(study) is has
    assert ("10.1145/3136755.3136817" in references.bibtex(study, {})) is has


def test_an_opponent_cites_what_its_module_does():
    assert "10.1145/3447548.3467231" in references.bibtex(
        loading.resolve("refractory-period", {"baselines": "quick"}), {}
    )


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("(Saal 2017, doi 10.1073/pnas.1704856114): it", ["10.1073/pnas.1704856114"]),
        (
            "doi\n# 10.1016/S0893-6080(01)00078-8). And arXiv\n# 2210.13107.",
            ["10.1016/S0893-6080(01)00078-8", "2210.13107"],
        ),
        ("(doi 10.1000/a(1)).", ["10.1000/a(1)"]),
        ("doi 10.1145/1; doi 10.1145/1, 3.10 and 10.5", ["10.1145/1"]),
    ],
)
def test_numbers_end_where_their_sentence_does(text, found):
    assert references.numbers_in(text) == found


def test_a_price_list_cites_what_it_is_like(monkeypatch):
    monkeypatch.setattr(references, "used", lambda study: [("prices", "loihi")])
    numbers = {number for text in references.texts(SimpleNamespace()) for number in references.numbers_in(text)}
    assert numbers == {"10.1109/MM.2018.112130359", "10.1109/ISSCC.2014.6757323"}


def test_the_source_of_another_package_is_cited_by_its_number():
    assert "doi = {10.1234/abc}" in references._by_number("10.1234/abc")
    assert "eprint = {2501.00001}" in references._by_number("2501.00001")


NETWORK_STUDIES = ("refractory-period", "minimal-duration", "early-exit")
CHANGED = {
    "window.length_ms": 123.0,
    "window.start_ms": 321.0,
    "split.validation": 0.23,
    "split.test": 0.17,
    "split.seed": 4711,
    "encoder.tau_mem_ms": 17.5,
    "encoder.conditioning.ema_cutoff_Hz": 29.5,
    "network.tau_syn_ms": 7.25,
    "network.training.batch": 77,
    "network.training.learning_rate": 0.00123,
    "early_exit.tolerance": 0.0345,
}


@pytest.mark.parametrize("key", CHANGED)
def test_the_methods_tell_each_number_of_the_spec(key):
    value = CHANGED[key]
    shown = f"{100 * value:g} %" if key in ("split.validation", "split.test", "early_exit.tolerance") else f"{value:g}"
    before, after = (methods.in_words(loading.resolve("refractory-period", change)) for change in ({}, {key: value}))
    assert shown not in before
    assert shown in after


def test_the_methods_tell_of_what_is_swept_in_its_sweep_alone():
    study = loading.resolve("refractory-period")
    text = methods.in_words(study)
    assert "hidden neurons (20, 30, 40 and 50)" in text
    assert "hidden neurons 30" not in text
    assert "refractory period 1 ms" not in text
    alone = methods.in_words(study.model_copy(update={"sweep": {"seed": [0]}}))
    assert "hidden neurons 30" in alone
    assert "refractory period 1 ms" in alone


def test_every_model_of_an_encoder_can_be_told():
    for path in shipped("encoders"):
        study = loading.resolve("refractory-period").model_copy(update={"encoder": encoders.load(path)})
        assert f"by the model `{study.encoder.model}`" in methods.in_words(study)
