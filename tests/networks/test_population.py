"""Networks that train together end as they do alone."""

import copy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from snntorch import surrogate

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import population
from neurotact.networks.training.training import Course, Examples, Training, alone, course

RATE_Hz = 400.0


def touches(n: int, seed: int) -> Examples:
    """Three classes, each loud on an afferent of its own."""
    labels = torch.arange(n) % 3
    rates = 0.15 + 0.5 * (torch.arange(4) == labels[:, None])
    drawn = torch.rand(n, 8, 4, generator=torch.Generator().manual_seed(seed))
    return Examples((drawn < rates[:, None]).to(torch.uint8), labels)


TRAINING, VALIDATION = touches(10, 0), touches(6, 1)


def network(table: dict, seed: int, dtype: torch.dtype = torch.float64) -> RSNN:
    """In float64, where rounding moves no spike."""
    spec = RSNNSpec.model_validate({"forward_weight_scale": 4.0, "recurrent_weight_scale": 0.4, **table})
    generator = torch.Generator().manual_seed(seed)
    return RSNN(4, 3, spec, RATE_Hz, backend="reference", generator=generator, dtype=dtype)


def course_of(net: RSNN, seed: int, **more) -> Course[Training]:
    return course(net, TRAINING, VALIDATION, generator=torch.Generator().manual_seed(seed), **more)


def check_alike(networks: list[RSNN], rtol: float = 1e-9) -> list[Training]:
    """Train them together and, as copies, alone: same epochs, same best one, same weights; what they have learned."""
    before, lonely = copy.deepcopy(networks), copy.deepcopy(networks)
    found = population.run([course_of(net, seed) for seed, net in enumerate(networks)])
    wanted = [alone(course_of(net, seed)) for seed, net in enumerate(lonely)]
    for net, other, first, mine, theirs in zip(networks, lonely, before, found, wanted, strict=True):
        assert mine.best.epoch == theirs.best.epoch
        for one, same in zip(mine.epochs, theirs.epochs, strict=True):
            assert one == pytest.approx(same, rel=rtol, abs=rtol)
        assert any(not torch.equal(p, q) for p, q in zip(net.parameters(), first.parameters(), strict=True))
        for (name, mine_), theirs_ in zip(net.named_parameters(), other.parameters(), strict=True):
            torch.testing.assert_close(mine_, theirs_, rtol=100 * rtol, atol=100 * rtol, msg=name)
    return found


SHAPES = st.fixed_dictionaries(
    {
        "model": st.sampled_from(["rsnn", "snn"]),
        "membrane": st.sampled_from(["eq4", "delayed", "immediate"]),
        "reset": st.sampled_from(["zero", "subtract", "hard"]),
        "recurrent_delay_steps": st.sampled_from([0, 1]),
        "readout": st.sampled_from(["count", "integrator", "max"]),
        "learn": st.sampled_from([(), ("alpha", "beta", "threshold")]),
    }
)
TRAININGS = st.fixed_dictionaries(
    {
        "batch": st.sampled_from([4, 5, 16]),
        "epochs": st.integers(1, 3),
        "patience": st.sampled_from([1, 7]),
        "learning_rate": st.sampled_from([0.01, 0.2]),
        "rate_penalty": st.sampled_from([0.0, 0.01]),
        "population_penalty": st.sampled_from([0.0, 0.001]),
    },
    optional={
        "optimiser": st.sampled_from(["Adamax", "AdamW", "SGD"]),
        "temperature": st.just(0.3),
        "relative_learning_rate": st.just(0.05),
        "schedule": st.just("cosine"),
        "keep": st.sampled_from(["accuracy", "both"]),
        "input_dropout": st.just(0.2),
        "input_jitter_ms": st.just(3.0),
        "readout_dropout": st.just(0.3),
    },
)
MEMBERS = st.fixed_dictionaries(
    {"hidden": st.integers(1, 9), "tau_mem_ms": st.sampled_from([8.0, 30.0]), "training": TRAININGS},
    optional={
        "threshold_adaptation": st.sampled_from([0.2, 1.0]),
        "surrogate": st.just("arctan"),
        "surrogate_scale": st.just(20.0),
        "readout_surrogate_scale": st.just(5.0),
    },
)


@examples(12)
@given(SHAPES, st.lists(MEMBERS, min_size=2, max_size=4), st.sampled_from([None, 12.0]))
def test_every_network_trains_as_it_does_alone(shape, members, readout_tau_ms):
    leak = {} if shape["readout"] == "count" else {"readout_tau_ms": readout_tau_ms}
    check_alike([network({**shape, **leak, **member}, seed) for seed, member in enumerate(members)])


SHORT = {"training": {"batch": 4, "learning_rate": 0.02, "epochs": 2}}
KEPT_SHORT = {"training": {"batch": 10, "learning_rate": 0.5, "epochs": 6, "patience": 1}}


def test_in_float32_they_agree_to_its_rounding():
    found = check_alike(
        [network({"hidden": hidden, **SHORT}, hidden, torch.float32) for hidden in (5, 6, 8)], rtol=1e-4
    )
    assert [len(each.epochs) for each in found] == [2, 2, 2]


def test_each_ends_at_an_epoch_of_its_own():
    found = check_alike([network({"hidden": 6, **SHORT}, 0), network({"hidden": 9, **KEPT_SHORT}, 1)])
    assert len(found[0].epochs) == 2
    assert found[1].best.epoch < len(found[1].epochs) < 6


def test_a_surrogate_of_another_library_is_used():
    networks = [network({"hidden": 4, **SHORT}, seed) for seed in (0, 1)]
    spike = surrogate.atan()
    for net in networks:
        net.spike = spike
    check_alike(networks)


def test_readouts_of_other_slopes_are_not_joined():
    keys = {"hidden": 4, "surrogate": "arctan", **SHORT}
    check_alike([network({**keys, "readout_surrogate_scale": scale}, 0) for scale in (0.1, 30.0)])


def test_networks_of_one_shape_run_as_one_and_as_many_at_once_as_fit_in_memory(monkeypatch):
    batches = [next(course_of(network({"hidden": hidden, **SHORT}, 0), 0)) for hidden in (5, 7, 9, 8)]
    waiting = dict(enumerate(batches))
    assert population._together(waiting) == [[0, 1, 3], [2]]  # pyright: ignore
    size = population._width(batches[0].network) + 4 + 3  # pyright: ignore
    monkeypatch.setattr(population, "CPU_BYTES", 2 * population.BYTES * 4 * 8 * size)
    assert population._together(waiting) == [[0, 1], [3], [2]]  # pyright: ignore


def test_one_that_fails_or_is_stopped_moves_no_other():
    def guarded(net: RSNN, seed: int, stop: int | None = None):
        def watch(epoch):
            if epoch.epoch == stop:
                raise InterruptedError

        try:
            return (yield from course_of(net, seed, progress=watch))
        except (InputError, InterruptedError) as error:
            return error

    lost = {"training": {"batch": 3, "learning_rate": 1e308, "epochs": 5}}
    whole, lonely = network({"hidden": 6, **SHORT}, 0), network({"hidden": 6, **SHORT}, 0)
    ends = population.run(
        [
            guarded(network({"hidden": 6, **lost}, 1), 1),
            guarded(whole, 0),
            guarded(network({"hidden": 6, **SHORT}, 2), 2, stop=1),
        ]
    )
    assert "not finite after epoch" in str(ends[0])
    assert isinstance(ends[2], InterruptedError)
    alone(course_of(lonely, 0))
    torch.testing.assert_close(whole.w_in, lonely.w_in, rtol=1e-7, atol=1e-7)


def test_an_error_that_a_course_does_not_expect_is_raised():
    lost = network({"hidden": 6, "training": {"batch": 3, "learning_rate": 1e308}}, 1)
    with pytest.raises(InputError, match="not finite"):
        population.run([course_of(network({"hidden": 6, **SHORT}, 0), 0), course_of(lost, 1)])


@pytest.mark.parametrize(("name", "kind"), [("cpu", "cpu"), ("cuda:1", "cuda"), ("mps", "mps"), ("cpu:0", "cpu:0")])
def test_a_search_records_the_kind_of_its_device(name, kind):
    assert population.kind_of(name) == kind


@pytest.mark.parametrize("name", ["cuda:99", "tpuu", "meta"])
def test_a_device_that_torch_cannot_use_is_refused_in_a_line(name):
    with pytest.raises(InputError, match=f"`device={name!r}`: torch cannot use it here") as caught:
        population.device_of(name)
    assert "\n" not in str(caught.value)
