"""C on an emulated Cortex-M says what its twin says, and takes what the paper's network may take."""

import pytest
import torch
from compiled import chosen, compare_on, kinds_of, pressed, spikes_of
from made_chains import make_chain, make_signal
from neurotact_parts.exporters.c import c_export, proof
from neurotact_parts.exporters.c.boards import BOARDS
from neurotact_parts.exporters.c.formats import choose
from neurotact_parts.exporters.c.proving import expected_in_float, expected_in_integers

from neurotact.networks.training.ranges import Ranges

ABSENT = proof.missing("arm-none-eabi-gcc", "qemu-system-arm")
pytestmark = pytest.mark.skipif(ABSENT is not None, reason=str(ABSENT))


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_processor_says_what_the_twin_says(board, variant, tmp_path):
    chain = make_chain({"ema_cutoff_Hz": 30.0, "baseline": "start", "scale": (2.0, 0.5)}, patience=5)
    signals = [make_signal(120, seed=k) for k in range(2)]
    formats = None if variant == "float" else chosen(chain, signals)
    c_export.write(chain, tmp_path, formats, parts=c_export.HARNESS)
    if formats is None:
        trials, expected = signals, [expected_in_float(chain, signal) for signal in signals]
    else:
        trials = [formats.raw.samples(signal) for signal in signals]
        expected = expected_in_integers(chain, formats, trials)
    said, _ = proof.on_board(tmp_path, "touch", trials, BOARDS[board])
    assert proof.first_difference(list(proof.cut_off(said, expected)), expected) is None
    assert all(n > 0 for n in spikes_of(expected))


@pytest.mark.thorough
@pytest.mark.parametrize("variant", ["float", "integer"])
def test_a_processor_feels_the_press_and_the_release_of_a_real_press(variant, data_folder, tmp_path):
    chain, presses = pressed(data_folder)
    formats = chosen(chain, presses) if variant == "integer" else None
    difference, expected = compare_on(presses, chain, tmp_path, formats, board=BOARDS["cortex-m0"])
    assert difference is None
    assert kinds_of(expected, chain) == {0, 1, 2}


def test_instructions_are_counted_and_repeat(tmp_path):
    chain = make_chain({})
    signal = make_signal(60)
    formats = chosen(chain, [signal])
    c_export.write(chain, tmp_path, formats, parts=c_export.HARNESS)
    once, twice = (
        proof.on_board(tmp_path, "touch", [formats.raw.samples(signal)] * n, BOARDS["cortex-m0"], counting=True)[1]
        for n in (1, 2)
    )
    assert once.samples == 60
    assert twice.total == pytest.approx(2 * once.total, rel=0.01)
    assert 200 < once.total / 60 < once.most < 20_000


@pytest.mark.parametrize("board", BOARDS)
def test_the_papers_network_fits_a_small_processor(board, tmp_path):
    conditioning = {"ema_cutoff_Hz": 30.0, "baseline": "start", "scale": (1.0,) * 8}
    chain = make_chain(conditioning, rate_Hz=2000.0, n_taxels=8, hidden=30, patience=180, windows={"length_ms": 150})
    with torch.no_grad():  # 8 classes, as the gratings have
        chain.network.w_out = torch.nn.Parameter(torch.randn(30, 8, generator=torch.Generator().manual_seed(0)))
    chain = chain._replace(classes=tuple(f"P{k}" for k in range(8)))
    formats = choose(chain, Ranges(-26.0, 27.0, 16.0, 19.0))
    c_export.write(chain, tmp_path, formats)
    used = proof.footprint(tmp_path, "touch", BOARDS[board])
    assert 1620 < used.flash < 8192
    assert 300 < used.ram < 1024 - used.stack
