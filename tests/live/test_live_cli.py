"""`neurotact live` as it is typed: what it refuses, and a whole visit."""

import io
import signal
import subprocess
import sys
from types import SimpleNamespace

import neurotact_parts.exporters.live
import numpy as np
import pytest
from live_pages import has_ended, page_of
from made_chains import make_run, make_signal, told
from neurotact_parts.exporters.live import show as live_api
from neurotact_parts.exporters.live.feeds import Replay

import neurotact as nt
from neurotact import cli
from neurotact.encoders.afferents import AfferentSpec
from neurotact.networks.training import run_folder


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A network of an epoch, and its recordings."""
    return make_run(tmp_path_factory.mktemp("live"), channels=("left", "right"))


@pytest.fixture
def refused(monkeypatch, capsys):
    def call(*words: object) -> str:
        monkeypatch.setattr(sys, "argv", ["neurotact", "live", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        said = capsys.readouterr()
        assert end.value.code == 2, said
        assert said.err.count("\n") == 1
        return said.err

    return call


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--from", "{made}/skin.h5", "--set", "seed=1"], "--set: has no effect without a simulated finger"),
        (["--from", "stiffness"], "has no finger to control"),
        (["--from", "gratings"], "samples come at 2000 Hz but the chain was trained at 1000 Hz"),
        (["--from", "gratings", "--set", "sed=1"], "sed: unknown key; did you mean 'seed'"),
        (["--from", "-", "--format", "wav"], "Invalid value for '--format'"),
        (["--from", "-", "--unit", "count"], "'count' but 'mV'"),
        (["--from", "/no/such.h5"], "/no/such.h5: there is no such file"),
        (["--from", "-", "--speed", "1000"], "--speed"),
        ([], "--from"),
    ],
)
def test_what_cannot_be_used_is_one_line(made, refused, words, message):
    assert message in refused(made / "run", *(word.format(made=made) for word in words))


def test_a_device_that_is_not_there_is_refused(made, refused):
    assert "/no/such/device: cannot be read" in refused(made / "run", "--from", "/no/such/device")


def test_input_without_a_sample_is_refused(made, refused, tmp_path):
    (tmp_path / "rows.csv").write_text("1,2,3\n")
    assert "line 1 has 3 values" in refused(made / "run", "--from", tmp_path / "rows.csv")


def test_without_its_packages_it_says_what_to_install(made, refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "neurotact_parts.exporters.live.server", raising=False)
    monkeypatch.delattr(neurotact_parts.exporters.live, "server", raising=False)
    assert "pip install 'neurotact[live]'" in refused(made / "run", "--from", "gratings")


def visit(words: list[str], given: bytes | None = None) -> tuple[list[tuple], dict, dict, str]:
    """Open the page of a live session until its source ends: decisions, state, hello, what was said."""
    command = [sys.executable, "-m", "neurotact", "live", *words]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        try:
            assert process.stdout
            address = process.stdout.readline().decode().split()[0]
            port, token = address.removeprefix("http://127.0.0.1:").strip("/").split("/")
            with page_of(SimpleNamespace(port=int(port), token=token)) as me:
                me.until(lambda me: me.hello)
                assert process.stdin
                process.stdin.write(given or b"")
                process.stdin.close()
                process.stdin = None
                me.until(has_ended)
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=60)[1].decode()
            assert process.returncode == 0, said
        finally:
            process.kill()
    return me.told(), me.state, me.hello, said


def test_a_visit_to_recordings(made, tmp_path):
    found, state, hello, said = visit([
        str(made / "run"), "--from", str(made / "skin.h5"), "--speed", "20", "--save-to", str(tmp_path)
    ])  # fmt: skip
    stream, expected = nt.Stream(made / "run"), []
    for k in range(12):
        expected += told([*stream.push(make_signal(130, seed=k)), *stream.finish()])
    assert found == expected
    assert (hello["source"]["taxels"], hello["classes"]) == (["left", "right"], ["felt", "silk"])
    assert [each["name"] for each in hello["populations"]] == ["SA-I", "RA-I"]
    assert state["labelled"] == len(expected)
    assert sum(map(sum, state["confusion"])) == len(expected)
    assert f"{12 * 130} samples, {len(expected)} decisions; " in said
    assert "skin.h5: 8 training, 2 validation, 2 test trials of the network; the page shows" in said
    assert [one["side"] for one in state["sides"]] == ["test", "validation", "training"]
    assert sum(one["labelled"] for one in state["sides"]) == len(expected)


def test_trials_are_known_by_their_content_as_infer_knows_them(made, tmp_path, caplog):
    """In another file, in another order and beside new trials, each trial has the side that `infer` gives it."""
    skin = nt.load(made / "skin.h5")
    signals = [*skin.signals[::-1], make_signal(130, seed=99)]
    labels = [*skin.conditions["label"][::-1], "felt"]
    other = nt.Recordings(signals, 1000.0, "mV", labels, channels=("left", "right"))
    nt.save(other, tmp_path / "renamed.h5")
    sides = live_api.sides_of(made / "run", Replay(str(tmp_path / "renamed.h5"), 1.0, loops=False))
    trains = nt.encode(other, AfferentSpec.model_validate(run_folder.restore(made / "run").encoder))
    assert sides == nt.infer(made / "run", trains).groupby("trial")["side"].first().tolist()
    assert sides[-1] == "unseen"
    assert "8 training, 2 validation, 2 test, 1 unseen trials" in caplog.text


@pytest.mark.thorough
def test_a_visit_to_standard_input(made):
    text = io.StringIO()
    np.savetxt(text, make_signal(200, seed=3), delimiter=",", fmt="%.9g")
    found, state, *_ = visit([str(made / "run"), "--from", "-"], text.getvalue().encode())
    stream = nt.Stream(made / "run")
    assert found == told([*stream.push(make_signal(200, seed=3)), *stream.finish()])
    assert state["labelled"] == 0
