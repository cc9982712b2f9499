"""Specs: text and tables are one thing in two forms, and whatever is wrong is named by key and file."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.encoders.afferents import AfferentSpec
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import (
    LARGEST,
    SMALLEST,
    Spec,
    build,
    digest,
    find,
    keys_of,
    leaves,
    load,
    override,
    parse_assignments,
    read,
    saved,
    shipped,
    to_toml,
    unsaved,
)
from neurotact.studies import study
from neurotact.studies.study import StudySpec

WORDS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
KEYS = (
    st.sampled_from(["a", "t_ref_ms", "v1 mix", "a.b", "é", "\N{GRINNING FACE}", "", "\x7f", '"', "\\", "\n"]) | WORDS
)
MAGNITUDES = st.floats(SMALLEST, LARGEST)
NUMBERS = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.just(0.0) | MAGNITUDES | MAGNITUDES.map(lambda x: -x)
TABLES = st.dictionaries(
    KEYS,
    st.recursive(
        NUMBERS | WORDS,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
        max_leaves=8,
    ),
    max_size=4,
)
ENCODER = load(AfferentSpec, "sa1-ra1-lif").model_dump(mode="json", exclude_none=True)


def refusal(model, table, source="my.toml") -> str:
    with pytest.raises(InputError) as error:
        build(model, table, source)
    message = str(error.value)
    assert "\n" not in message
    assert message.endswith(f"({source})")
    return message


def test_a_spec_made_in_python_complains_as_its_file_does():
    table = load(AfferentSpec, "sa1-ra1-lif").model_dump()
    with pytest.raises(InputError, match=r"^sa1\.t_reff_ms: unknown key; did you mean 't_ref_ms'\? \(AfferentSpec\)$"):
        AfferentSpec(**{**table, "sa1": {"gain": 1.0, "t_reff_ms": 5}})
    with pytest.raises(InputError, match=r"^hidden: must be >= 0; got -1 \(RSNNSpec\)$"):
        RSNNSpec(hidden=-1)


@given(TABLES)
def test_a_table_written_as_toml_is_read_back_equal(tmp_path, table):
    path = tmp_path / "table.toml"
    path.write_bytes(to_toml(table).encode())
    again = read(path)
    assert again == table
    assert _types(again) == _types(table)


def _types(value):
    """The type of each leaf: 1, 1.0 and true are equal in Python and not in TOML."""
    if isinstance(value, dict):
        return {key: _types(inner) for key, inner in value.items()}
    return [_types(inner) for inner in value] if isinstance(value, list) else type(value)


EXTREME = {
    "a = 1e999": "a: must be a finite number; got inf",
    "a = [{b = -inf}]": "a.0.b: must be a finite number; got -inf",
    "a = nan": "a: must be a finite number; got nan",
    "a = 1e16": "a: must be between 1e-100 and 1e+15 in size; got 1e+16",
    "a = -1e-200": "a: must be between 1e-100 and 1e+15 in size; got -1e-200",
    f"a = {2**63}": "a: must be a number within 64 bits; got one of 64 bits",
    f"a = -{10**400}": "a: must be a number within 64 bits",
    f"a = 0x1{'0' * 5000}": "a: must be a number within 64 bits",
    f"a = {'1' * 5000}": "",
    f"a = {'[' * 40}{']' * 40}": "is nested more than 32 tables or lists deep",
    f"a = {'[' * 5000}{']' * 5000}": "",
    f"a = {'{a = ' * 5000}1{'}' * 5000}": "",
}
"""What a spec may hold by TOML's grammar, but by no other rule."""


@pytest.mark.parametrize("text", EXTREME, ids=range(len(EXTREME)))
def test_numbers_and_nestings_that_nothing_can_take_are_refused(tmp_path, text):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError) as refusal:
        read(tmp_path / "mine.toml")
    assert EXTREME[text] in str(refusal.value)
    assert "mine.toml" in str(refusal.value)
    with pytest.raises(InputError, match=r"^(a[.:]|`settings` a=)") as refusal:
        parse_assignments([text.replace(" ", "", 2)])
    assert len(str(refusal.value)) < 300


def test_a_key_of_many_tables_and_a_long_file_are_refused(tmp_path):
    deep = ".".join("a" * 5000)
    (tmp_path / "mine.toml").write_text(f"{deep} = 1")
    for attempt in (lambda: read(tmp_path / "mine.toml"), lambda: override({}, parse_assignments([f"{deep}=1"]))):
        with pytest.raises(InputError, match="more than 32"):
            attempt()
    (tmp_path / "mine.toml").write_text("#" * 2_000_001)
    with pytest.raises(InputError, match=r"mine\.toml: is longer than 2,000,000 bytes"):
        read(tmp_path / "mine.toml")


def test_a_date_is_text(tmp_path):
    (tmp_path / "mine.toml").write_text("a = [2026-01-02, 03:04:05]")
    assert read(tmp_path / "mine.toml") == {"a": ["2026-01-02", "03:04:05"]}


def test_none_is_left_out():
    assert to_toml({"a": None, "b": {"c": None, "d": 1}}) == "[b]\nd = 1\n"


@given(TABLES)
def test_the_digest_does_not_depend_on_the_order_of_keys(table):
    def reverse(value):
        return {k: reverse(v) for k, v in reversed(value.items())} if isinstance(value, dict) else value

    assert digest(reverse(table)) == digest(table)


def test_the_digest_of_a_spec_changes_with_any_value():
    base = build(AfferentSpec, ENCODER, "a")
    others = [{"tau_mem_ms": 11.0}, {"sa1.gain": 3.3}, {"conditioning.rectify": True}, {"conditioning.offset": [1.0]}]
    digests = {build(AfferentSpec, override(ENCODER, other), "b").digest() for other in others}
    assert len(digests | {base.digest()}) == len(others) + 1
    assert build(AfferentSpec, override(ENCODER, {"tau_mem_ms": 10}), "c").digest() == base.digest()


def test_an_override_changes_a_copy_and_nothing_else():
    table = {"sa1": {"gain": 1.0, "t_ref_ms": 1.0}, "unit": "mV"}
    assert override(table, {"sa1.t_ref_ms": 5, "ra1.gain": 2}) == {
        "sa1": {"gain": 1.0, "t_ref_ms": 5}, "unit": "mV", "ra1": {"gain": 2}
    }  # fmt: skip
    assert table == {"sa1": {"gain": 1.0, "t_ref_ms": 1.0}, "unit": "mV"}


def test_an_override_below_a_value_is_refused():
    with pytest.raises(InputError, match=r"unit\.name: 'unit' is a value, not a table"):
        override({"unit": "mV"}, {"unit.name": 1})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("5", 5), ("5.0", 5.0), ("-1e3", -1000.0), ("true", True), ("[20, 30]", [20, 30]), ("eq4", "eq4"),
        ('"5"', "5"), ("a=b", "a=b"), ("", ""), (" 7 ", 7), ("v1 mix", "v1 mix"), ("{a = 1}", {"a": 1}),
    ],
)  # fmt: skip
def test_an_assignment_is_read_as_toml_else_as_text(text, value):
    assert parse_assignments([f"key={text}"]) == {"key": value}


@pytest.mark.parametrize("assignment", ["", "hidden", "=5", " =5", "hidden:5"])
def test_an_assignment_without_key_or_value_is_refused(assignment):
    with pytest.raises(InputError, match="must read KEY=VALUE"):
        parse_assignments([assignment])


def test_the_last_of_two_assignments_holds():
    assert parse_assignments(["hidden=20", "hidden=30"]) == {"hidden": 30}


@pytest.mark.parametrize(
    ("model", "key", "meant"),
    [
        (AfferentSpec, "sa1.t_ref", "t_ref_ms"),
        (AfferentSpec, "tau_mem", "tau_mem_ms"),
        (AfferentSpec, "conditioning.ema_cutof_Hz", "ema_cutoff_Hz"),
        (AfferentSpec, "sa2", "sa1"),
        (RSNNSpec, "training.epoch", "epochs"),
        (RSNNSpec, "hiden", "hidden"),
    ],
)
def test_an_unknown_key_names_the_nearest(model, key, meant):
    table = override(ENCODER if model is AfferentSpec else {}, {key: 1})
    assert refusal(model, table).startswith(f"{key}: unknown key; did you mean '{meant}'?")


@pytest.mark.parametrize(
    ("model", "key", "meant"),
    [
        (AfferentSpec, "t_ref_ms", "'sa1.t_ref_ms' or 'ra1.t_ref_ms'"),
        (AfferentSpec, "sa1.tau_mem_ms", "'tau_mem_ms'"),
        (AfferentSpec, "ema_cutof_Hz", "'conditioning.ema_cutoff_Hz'"),
        (AfferentSpec, "encoder.sa1", "'sa1'"),
        (RSNNSpec, "epoch", "'training.epochs'"),
        (RSNNSpec, "learning_rate", "'training.learning_rate'"),
        (RSNNSpec, "network.hidden", "'hidden'"),
        (RSNNSpec, "training.hidden", "'hidden'"),
        (StudySpec, "hidden", "'network.hidden'"),
        (StudySpec, "sa1.t_ref_ms", "'encoder.sa1'"),
        (StudySpec, "tau_syn_ms", "'network.tau_syn_ms'"),
        (StudySpec, "epoch", "'network.training.epochs'"),
    ],
)
def test_a_key_of_another_table_is_named_with_its_tables(model, key, meant):
    whole = study.resolve("refractory-period").model_dump(mode="json", exclude_none=True)
    table = {AfferentSpec: ENCODER, RSNNSpec: {}, StudySpec: whole}[model]
    message = refusal(model, override(table, {key: 1} if "sa1" not in key else {key: {"t_ref_ms": 1}}))
    assert f": unknown key; did you mean {meant}? (" in message


@pytest.mark.parametrize("name", ["encoders/sa1-ra1-lif", "networks/rsnn"])
def test_the_keys_of_a_spec_are_those_that_it_is_written_with(name):
    model = AfferentSpec if name.startswith("encoders") else RSNNSpec
    assert {*leaves(load(model, name.partition("/")[2]).model_dump())} <= {*keys_of(model)}


def test_an_unknown_key_far_from_any_lists_them_all():
    assert "sa1.zzzzz: unknown key; known: gain, t_ref_ms" in refusal(AfferentSpec, override(ENCODER, {"sa1.zzzzz": 1}))


def test_a_missing_key_is_named():
    table = {key: value for key, value in ENCODER.items() if key != "sa1"}
    assert refusal(AfferentSpec, table) == "sa1: is missing; add it (my.toml)"


BAD_NUMBERS = st.sampled_from([math.nan, math.inf, -math.inf]) | st.floats(max_value=-1e-300)
NO_NUMBERS = st.sampled_from(["fast", "", [], [1.0], {}, {"ms": 1}])


@pytest.mark.parametrize("key", ["sa1.t_ref_ms", "ra1.gain", "tau_mem_ms", "conditioning.resample_Hz"])
@given(value=BAD_NUMBERS | NO_NUMBERS)
def test_a_value_that_is_no_positive_number_is_refused_by_key_and_file(key, value):
    assert refusal(AfferentSpec, override(ENCODER, {key: value})).startswith(key)


@pytest.mark.parametrize("key", ["hidden", "training.epochs", "training.batch"])
@given(value=BAD_NUMBERS | NO_NUMBERS | st.sampled_from([0, -1, 1.5]))
def test_a_value_that_is_no_count_is_refused_by_key_and_file(key, value):
    if (key, value) != ("hidden", [1.0]):  # a list of layers
        assert refusal(RSNNSpec, override({}, {key: value})).startswith((key, "spec: hidden = 0 needs"))


@pytest.mark.parametrize("key", ["membrane", "reset"])
@given(value=NUMBERS | WORDS | NO_NUMBERS)
def test_a_choice_names_what_it_may_be(key, value):
    if value not in ("eq4", "delayed", "immediate", "zero", "subtract", "hard", "rsnn", "snn"):
        assert refusal(RSNNSpec, {key: value}).startswith(f"{key}: must be '")


@given(value=BAD_NUMBERS | NO_NUMBERS | st.sampled_from([2, -1, 0.5, True, False, "0"]))
def test_a_recurrent_delay_is_no_step_or_one(value):
    assert refusal(RSNNSpec, {"recurrent_delay_steps": value}).startswith("recurrent_delay_steps: must be ")


@pytest.mark.parametrize("spec", [RSNNSpec(), RSNNSpec(recurrent_delay_steps=1), RSNNSpec(threshold_adaptation=0.5)])
def test_a_spec_is_written_whole_and_read_back_equal(spec):
    written = spec.model_dump(mode="json")
    # Neither may be named in a spec without adaptation, without a recipe, or without what hears afferents.
    assert {*RSNNSpec.model_fields} - {*written} <= {"tau_adaptation_ms", "effort", "direct"}
    assert build(RSNNSpec, written, "my.toml") == spec


def test_a_folder_of_another_form_is_refused_by_its_name():
    table = {"hidden": 20}
    assert unsaved(saved(table), "run: holds a training", "start again") == table
    for other in (table, {"schema": 99, **table}):
        with pytest.raises(InputError, match=r"^run: holds a training of another neurotact \(.*\); start again$"):
            unsaved(other, "run: holds a training", "start again")


@pytest.mark.parametrize("value", [5, "sa1", [], True])
def test_a_value_where_a_table_belongs_is_refused(value):
    assert refusal(AfferentSpec, override(ENCODER, {"sa1": value})).startswith("sa1: must be a table; got")


@pytest.mark.parametrize(
    ("message", "key", "value"),
    [
        ("sa1.t_ref_ms: must be >= 0; got -1", "sa1.t_ref_ms", -1),
        ("sa1.gain: must be > 0; got 0", "sa1.gain", 0),
        ("tau_mem_ms: must be a finite number; got inf", "tau_mem_ms", math.inf),
        ("v_threshold_mV must be above v_rest_mV", "v_threshold_mV", -70.0),
        (
            "conditioning.baseline: must be 'none', 'mean', 'start' or 'high-pass'; got 'max'",
            "conditioning.baseline",
            "max",
        ),
        ("conditioning.scale.1: must not be 0; got 0", "conditioning.scale", [1.0, 0.0]),
    ],
)
def test_a_refusal_says_what_a_value_must_be(message, key, value):
    assert message in refusal(AfferentSpec, override(ENCODER, {key: value}))


class Switch(Spec):
    on: bool = False
    count: int = 0
    shares: tuple[float, ...] = ()


@pytest.mark.parametrize(
    ("model", "key", "value", "wanted"),
    [
        (RSNNSpec, "hidden", "20", "hidden: must be a number; got '20'"),
        (RSNNSpec, "hidden", True, "hidden: must be a number; got True"),
        (RSNNSpec, "training.learning_rate", "1e-3", "training.learning_rate: must be a number; got '1e-3'"),
        (Switch, "count", 2**63, f"count: must be a number within 64 bits; got {2**63}"),
        (Switch, "on", 1, "on: must be true or false; got 1"),
        (Switch, "on", "yes", "on: must be true or false; got 'yes'"),
        (Switch, "on", [], "on: must be true or false; got []"),
        (Switch, "shares", 3, "shares: must be a list; got 3"),
        (RSNNSpec, "hidden", 0.5, "hidden: must be a whole number; got 0.5"),
        (RSNNSpec, "hidden", "many", "hidden: must be a whole number; got 'many'"),
        (RSNNSpec, "model", [], "model: must be text; got []"),
        (Switch, "shares", [0.5, "0.5"], "shares.1: must be a number; got '0.5'"),
    ],
)
def test_a_number_in_quotes_and_1_for_true_are_refused(model, key, value, wanted):
    assert refusal(model, override({}, {key: value})) == f"{wanted} (my.toml)"


def test_a_whole_number_written_with_a_point_is_taken():
    assert build(RSNNSpec, {"hidden": 20.0, "tau_mem_ms": 5}, "my.toml").hidden == 20


def test_a_spec_is_found_by_name_and_by_path(tmp_path):
    path = find("encoders", "sa1-ra1-lif")
    copy = tmp_path / "mine.toml"
    copy.write_bytes(path.read_bytes())
    assert path in shipped("encoders")
    assert load(AfferentSpec, copy) == load(AfferentSpec, "sa1-ra1-lif") == load(AfferentSpec, path)


def test_a_spec_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="sa1-ra1-lf: there is no such spec in encoders; did you mean 'sa1-ra1-lif'"):
        find("encoders", "sa1-ra1-lf")
    with pytest.raises(InputError, match="there is no such spec in encoders"):
        find("encoders", "x" * 5000)
    with pytest.raises(InputError) as refusal:
        find("encoders", "zzz", ["poisson", "mine"])
    known = str(refusal.value).partition("known: ")[2].split(", ")
    assert "mine" in known
    assert len(set(known)) == len(known)
    with pytest.raises(InputError, match=r"mine\.toml: there is no such file"):
        find("encoders", tmp_path / "mine.toml")


@pytest.mark.parametrize("content", [b"a = ", b"[a", b"a = 1\na = 2", b"\xff", b"{}"])
def test_text_that_is_no_toml_is_named(tmp_path, content):
    (tmp_path / "mine.toml").write_bytes(content)
    with pytest.raises(InputError, match=r"mine\.toml: (is not valid TOML|byte 0 is not UTF-8)"):
        load(AfferentSpec, tmp_path / "mine.toml")


def test_a_wrong_value_in_a_file_is_named_with_the_file(tmp_path):
    (tmp_path / "mine.toml").write_text(to_toml(override(ENCODER, {"sa1.t_ref_ms": -1})))
    with pytest.raises(InputError, match=r"sa1\.t_ref_ms: must be >= 0; got -1 \(.*mine\.toml\)"):
        load(AfferentSpec, tmp_path / "mine.toml")


def test_a_spec_cannot_be_changed():
    spec = load(AfferentSpec, "sa1-ra1-lif")
    with pytest.raises(ValueError, match="frozen"):
        spec.tau_mem_ms = 1.0
