"""The page in a real browser: what it shows is what was decided, and its hands reach the stream."""

import tomllib
from collections.abc import Iterator

import numpy as np
import pytest
from browser import Browser, browser
from levels import thinned
from live_pages import Given, cut, serving, session_of
from made_chains import make_chain, make_signal, offline
from neurotact_parts.exporters.live.feeds import ByHand
from neurotact_parts.exporters.live.server import Server
from neurotact_parts.streams.sources import Arrived

from neurotact.data.dataset import simulator

ROWS = """[...document.querySelectorAll('#decisions tbody tr')].map(
    row => ['start', 'index', 'steps', 'spikes', 'hidden'].map(key => Number(row.dataset[key])))"""
INKED = """(id, colour) => {
    const at = document.getElementById(id), wanted = [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16));
    const dots = at.getContext('2d').getImageData(0, 0, at.width, at.height).data;
    let n = 0;
    for (let i = 0; i < dots.length; i += 4)
        n += dots[i + 3] > 200 && wanted.every((value, k) => Math.abs(dots[i + k] - value) < 12);
    return n; }"""
"""How many dots of a canvas have a colour."""
DRAWN = (("signals", "--ink"), ("raster", "--sa"), ("raster", "--ra"), ("activity", "--hidden"))
AT_ITS_END = "document.getElementById('status').textContent === 'source ended'"


@pytest.fixture(scope="module")
def window(tmp_path_factory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened


def look(window: Browser, server: Server, width: int = 1000, **options: str) -> None:
    window.open("about:blank", width)  # else the page of the last test, whose server has gone, would complain
    window.complaints.clear()
    window.requests.clear()
    window.open(server.address, width, **options)
    window.wait_for("hello && state && frame")


def test_the_page_shows_every_decision_of_the_whole_trial(window):
    chain, signal = make_chain({}, patience=5), make_signal(2000)
    _, expected = offline(chain, signal)
    with serving(session_of(chain, Given(cut(signal, 8)))) as server:
        look(window, server)
        window.wait_for(AT_ITS_END)
        window.wait_for(f"{ROWS}.length === {len(expected)}")
        assert [tuple(row) for row in reversed(window.evaluate(ROWS))] == expected
        assert len(expected) == 50
        last = chain.classes[expected[-1][1]] if server.session.scores.recent[-1].decision.heard else "nothing"
        assert window.evaluate("document.getElementById('label').textContent") == last
        window.wait_for("document.getElementById('counts').textContent.includes('decisions50')")
        own = [url for url in window.requests if not url.startswith("data:")]
        assert all(url.startswith(server.address) for url in own)
        assert not window.complaints


def test_a_second_look_shows_the_same(window):
    chain, signal = make_chain({}), make_signal(800)
    with serving(session_of(chain, Given(cut(signal)))) as server:
        look(window, server)
        window.wait_for(AT_ITS_END)
        window.wait_for(f"{ROWS}.length === 20")
        first = window.evaluate(ROWS)
        look(window, server)  # the page is loaded anew, as a second one would be
        window.wait_for(f"{ROWS}.length === 20")
        assert window.evaluate(ROWS) == first
        assert not window.complaints


def test_sliders_reach_the_running_stream_by_keyboard(window, tmp_path):
    chain, signal = make_chain({}, patience=5), make_signal(1200)
    feed = Given([*cut(signal[:600]), None, *cut(signal[600:])], ["0"] * 121)
    with serving(session_of(chain, feed, save_to=tmp_path)) as server:
        look(window, server)
        window.wait_for(f"{ROWS}.length === 15")
        window.evaluate("document.getElementById('set-sa1.t_ref_ms').focus()")
        for _ in range(3):
            window.press("ArrowUp")
        window.wait_for("state.settings['sa1.t_ref_ms'] === 5")
        feed.go.set()
        window.wait_for(AT_ITS_END)
        window.wait_for(f"{ROWS}.length === 30")
        assert server.session.stream.chain.encoder.sa1.t_ref_ms == 5.0
        assert window.evaluate("document.getElementById('changes').textContent") == "sa1.t_ref_ms 2 → 5"
        cells = window.evaluate(
            "[...document.querySelectorAll('#compared tbody tr:first-child td')].map(c => c.textContent)"
        )
        assert cells == ["15", "15"]
        window.evaluate("document.getElementById('save').click()")
        window.wait_for("document.getElementById('words').textContent.startsWith('Saved as')")
        assert tomllib.loads((tmp_path / "my-encoder.toml").read_text())["sa1"]["t_ref_ms"] == 5
        window.evaluate("document.getElementById('save').click()")
        window.wait_for("document.getElementById('words').textContent.includes('already exists')")
        window.evaluate("document.getElementById('reset').click()")
        window.wait_for("state.settings['sa1.t_ref_ms'] === 2")
        assert not window.complaints


def test_between_windows_the_bars_are_those_of_the_last_decision(window):
    chain, signal = make_chain({}, patience=2), make_signal(400)
    cut_at = next(
        at for at in range(300, 400)
        if (given := session_of(chain, Given([signal]))).take(Arrived(signal[:at])) and given._race() is None
    )  # fmt: skip
    feed = Given([*cut(signal[:cut_at]), None, *cut(signal[cut_at:])], ["0"] * 100)
    with serving(session_of(chain, feed)) as server:
        look(window, server)
        window.wait_for("document.getElementById('patience-words').textContent.startsWith('Decided: ')")
        window.wait_for("frame.race === null && decisions.length > 0")
        led = "[...document.querySelectorAll('#race .bar')].map((bar) => bar.classList.contains('leads'))"
        index = window.evaluate("decisions[decisions.length - 1].index")
        window.wait_for(f"{led}[{index}]")
        assert window.evaluate(led).count(True) == 1
        name = window.evaluate(f"hello.classes[{index}]")
        assert f"Decided: {name};" in window.evaluate("document.getElementById('patience-words').textContent")
        assert not window.complaints


def test_the_finger_moves(window):
    feed = ByHand("gratings", simulator("gratings"), {"duration_s": 0.4}, 4.0)
    chain = make_chain({}, rate_Hz=2000.0, n_taxels=8)
    with serving(session_of(chain, feed)) as server:
        look(window, server)
        window.evaluate(
            "{const choice = document.getElementById('touch-grating'); choice.value = 'P0.5';"
            "choice.dispatchEvent(new Event('change'))}"
        )
        window.wait_for("state.values.grating === 'P0.5' && state.label === 'P0.5'")
        assert window.evaluate("document.getElementById('status').textContent").startswith("touching P0.5")
        assert not window.complaints


def test_freezing_stops_the_drawing_and_not_the_stream(window):
    feed = Given([*cut(make_signal(400)), None, *cut(make_signal(400))])
    with serving(session_of(make_chain({}), feed)) as server:
        look(window, server)
        window.evaluate("document.getElementById('freeze').focus()")
        window.press("Enter")
        assert window.evaluate("document.getElementById('freeze').getAttribute('aria-pressed')") == "true"
        drawn = "document.getElementById('raster').toDataURL()"
        before = window.evaluate(drawn)
        feed.go.set()
        window.wait_for(AT_ITS_END)
        assert window.evaluate(drawn) == before
        window.press("Enter")
        window.wait_for(f"{drawn} !== {before!r}")


@thinned("scheme", ["light", "dark"])
def test_the_page_fits_and_draws_with_sixteen_taxels(window, scheme):
    chain, signal = make_chain({}, n_taxels=16, hidden=60), make_signal(3000, 16)
    with serving(session_of(chain, Given(cut(signal), ["1"] * 300))) as server:
        look(window, server, scheme=scheme)
        window.wait_for(AT_ITS_END)
        for width in (400, 1000, 1600):
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            window.call("Emulation.setDeviceMetricsOverride", **size)
            window.wait_for(f"innerWidth === {width}")
            assert window.evaluate("document.documentElement.scrollWidth") == width
            for name, colour in DRAWN:
                window.wait_for(f"({INKED})('{name}', colours['{colour}']) > 10")
        before = window.evaluate("colours['--ink']")
        other = {"name": "prefers-color-scheme", "value": "dark" if scheme == "light" else "light"}
        window.call("Emulation.setEmulatedMedia", features=[other])
        window.wait_for(f"colours['--ink'] !== '{before}' && ({INKED})('signals', colours['--ink']) > 10")
        window.wait_for("Number(document.documentElement.dataset.perSecond) > 0")
        assert not [
            each for each in window.complaints if "getImageData" not in each
        ]  # this test reads, the page does not


def test_everything_has_a_name(window):
    feed = ByHand("gratings", simulator("gratings"), {"duration_s": 0.4}, 1.0)
    with serving(session_of(make_chain({}, rate_Hz=2000.0, n_taxels=8), feed)) as server:
        look(window, server)
        ids = window.evaluate("[...document.querySelectorAll('[id]')].map(each => each.id)")
        tree = window.call("Accessibility.getFullAXTree")["nodes"]
    assert len(ids) == len(set(ids))
    named: dict[str, list[str]] = {}
    for node in tree:
        if not node.get("ignored"):
            named.setdefault(node["role"]["value"], []).append(node.get("name", {}).get("value", ""))
    assert len(named["slider"]) == 8
    for role in ("slider", "button", "combobox", "textbox", "spinbutton", "image", "region"):
        assert all(named.get(role, [])), (role, named.get(role))


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_accessible(window, scheme):
    chain, signal = make_chain({}, n_taxels=16, hidden=60), make_signal(3000, 16)
    with serving(session_of(chain, Given(cut(signal), ["1"] * 300))) as server:
        look(window, server, scheme=scheme)
        window.wait_for(AT_ITS_END)
        window.assert_accessible()


def test_a_page_that_lost_its_server_says_so_and_comes_back(window):
    chain = make_chain({})
    with serving(session_of(chain, Given(cut(make_signal(100))))) as server:
        look(window, server)
        window.wait_for(AT_ITS_END)
        window.evaluate("socket.close()")
        window.wait_for("document.getElementById('status').textContent === 'not connected'")
        window.wait_for(AT_ITS_END)
    window.wait_for("document.getElementById('status').textContent === 'not connected'")
    assert np.isfinite(window.evaluate("latest"))
