"""A member of a population trains as it would alone, whatever the others are."""

import pytest
import torch

from neurotact.errors import InputError
from neurotact.networks.population import training as together
from neurotact.networks.population.training import Member
from neurotact.networks.rsnn import RSNN
from neurotact.networks.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import Examples, train

pytest.importorskip("triton", reason="Triton is not installed: pip install 'neurotact[gpu]'")

CPU = torch.device("cpu")
MATRICES = ("w_in", "w_rec", "w_out")


def examples(n: int, seed: int) -> Examples:
    """Three classes, each loud on an afferent of its own."""
    labels = torch.arange(n) % 3
    rates = 0.15 + 0.5 * (torch.arange(4) == labels[:, None])
    drawn = torch.rand(n, 8, 4, generator=torch.Generator().manual_seed(seed))
    return Examples((drawn < rates[:, None]).to(torch.uint8), labels)


TRAINING, VALIDATION, OTHER = examples(10, 0), examples(6, 1), examples(7, 2)
DIFFERENT = (
    {"hidden": 6, "training": {"batch": 4, "learning_rate": 0.02, "epochs": 2}},
    {"hidden": 9, "tau_mem_ms": 8.0, "training": {"batch": 10, "learning_rate": 0.5, "epochs": 6, "patience": 1}},
    {
        "hidden": 5,
        "surrogate_scale": 20.0,
        "training": {
            "batch": 5, "relative_learning_rate": 0.05, "schedule": "cosine", "keep": "accuracy", "epochs": 3,
            "temperature": 0.3, "population_penalty": 0.01,
        },
    },
    {"hidden": 6, "model": "snn", "training": {"batch": 10, "learning_rate": 0.02, "epochs": 1}},
)  # fmt: skip


def member(number: int, **more) -> Member:
    table = {"forward_weight_scale": 6.0, "recurrent_weight_scale": 0.3, **DIFFERENT[number], **more}
    weights = torch.Generator().manual_seed(number)
    net = RSNN(4, 3, RSNNSpec.model_validate(table), 400.0, backend="reference", generator=weights)
    side = OTHER if number == 2 else TRAINING
    return Member(net, side, VALIDATION, torch.Generator().manual_seed(10 + number))


@pytest.fixture(scope="module")
def all_at_once():
    members = [member(number) for number in range(len(DIFFERENT))]
    return members, together.train(members, CPU)


@pytest.mark.parametrize("number", range(len(DIFFERENT)))
def test_every_member_trains_as_it_would_alone(all_at_once, number):
    members, ended = all_at_once
    alone = member(number)
    before = {name: getattr(alone.network, name) for name in MATRICES}
    before = {name: own.detach().clone() for name, own in before.items() if own is not None}
    wanted = train(alone.network, alone.training, alone.validation, generator=alone.generator)
    found = ended[number].training
    assert len(found.epochs) == len(wanted.epochs)
    assert found.best.epoch == wanted.best.epoch
    for mine, theirs in zip(found.epochs, wanted.epochs, strict=True):
        assert mine == pytest.approx(theirs, rel=1e-4, abs=1e-6)
    for name, start in before.items():
        moved = (getattr(alone.network, name) - start).abs().max()
        assert moved > 0
        assert (getattr(members[number].network, name) - getattr(alone.network, name)).abs().max() <= 1e-3 * moved


def test_the_members_stop_at_epochs_of_their_own(all_at_once):
    _, ended = all_at_once
    assert {len(end.training.epochs) for end in ended} >= {1, 2, 3}
    assert ended[1].training.best.epoch < len(ended[1].training.epochs) < 6


@pytest.mark.parametrize("number", [0, 2])
def test_the_others_do_not_move_a_bit_of_a_member(all_at_once, number, monkeypatch):
    """Nor does how many members' membranes fit in memory."""
    monkeypatch.setattr(together, "TAPE_BYTES", 1)
    members, ended = all_at_once
    alone = member(number)
    assert together.train([alone], CPU)[0] == ended[number]
    for name in MATRICES:
        assert torch.equal(getattr(alone.network, name), getattr(members[number].network, name))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # the interpreter is NumPy, which warns of an overflow
def test_a_stopped_member_has_the_weights_of_its_last_epoch_and_one_that_overflows_says_so():
    stopped, whole, lost = member(0), member(0), member(1, training={"batch": 3, "learning_rate": 3e38})
    seen = []

    def watch(place, epoch):
        seen.append((place, epoch.epoch))
        return place == 0

    ends = together.train([stopped, whole, lost], CPU, watch)
    assert [end.stopped for end in ends] == [True, False, False]
    assert seen == [(0, 1), (1, 1), (1, 2)]
    assert len(ends[0].training.epochs) == 1
    assert "not finite after epoch 1" in str(ends[2].error)
    assert ends[0].error is ends[1].error is None
    once = member(0, training={**DIFFERENT[0]["training"], "epochs": 1})
    together.train([once], CPU)
    assert torch.equal(stopped.network.w_in, once.network.w_in)
    assert torch.equal(lost.network.w_in, member(1).network.w_in)


@pytest.mark.parametrize(("key", "value"), [("optimiser", "adamax"), ("input_dropout", 0.1), ("input_jitter_ms", 2.0)])
def test_a_training_that_is_not_done_here_is_refused_in_a_line(key, value):
    net = RSNN(4, 3, RSNNSpec(hidden=6, training=TrainingSpec.model_validate({key: value})), 400.0)
    with pytest.raises(InputError, match=f"training.{key} = {value}") as caught:
        together.check(net, 10)
    assert "\n" not in str(caught.value)
