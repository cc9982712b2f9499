"""`neurotact save`: the network of a run, or of recordings, with as little energy as its accuracy allows."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import neurotact as nt
from neurotact import files
from neurotact.data import hdf5
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.metrics.prices import DEFAULT, PriceList, names, price_list
from neurotact.progress import Tell, track, untold
from neurotact.tables import write_table

with lazily():
    from neurotact_parts.networks.saving import choice, figure, proposals
    from neurotact_parts.networks.saving import folder as points
    from neurotact_parts.networks.saving import search as searching
    from neurotact_parts.networks.saving import start as starting
    from neurotact_parts.networks.saving import trial as trying
    from neurotact_parts.networks.saving import ways as known_ways
    from neurotact_parts.streams import chain

    from neurotact.figures import style
    from neurotact.networks.definition import executors
    from neurotact.networks.training import resumable, run_folder
    from neurotact.networks.use import fitted


ANSWER, FRONT, FIGURE = "answer.json", "front.csv", "front.png"
STUDY = "study.toml"
FIRST, SPIKES, ENCODER = "run", "spikes.h5", "encoder.toml"
"""What is made of recordings, in the folder: the default network, its spikes, the calibrated encoder."""


def save_energy(
    run: str | Path,
    folder: str | Path,
    *,
    trials: int = 40,
    at_most_points: float = 1.0,
    prices: str | Path | PriceList = DEFAULT,
    seed: int = 0,
    recordings: str | Path | None = None,
    spikes: str | Path | None = None,
    workers: int | None = None,
    tell: Tell = untold,
) -> dict[str, Any]:
    """Search all ways to save together, from a run folder, recordings or a study: `neurotact save`.

    Refractory periods, the encoder's clock and its moving average, the network's clock, hidden neurons, recurrence,
    pruned weights, spikes, the window and early exit are tried alone and together. Validation windows alone choose.
    `folder` gets the points of the front as run folders `1`, `2`, ..., the first of which is the answer; `front.csv`
    with every trial, `front.png`, and `answer.json`, whose content is returned. Of recordings, or of events, the
    default network is trained first, in `folder/run`; of a study such as own-recordings its best network is taken.

    trials: trainings in all. at_most_points: of accuracy on validation windows that may be lost. prices: the name of
        the price list whose energy is saved. seed: of the search and of weights.
    recordings, spikes: those of the run, where they moved since. workers: processes that train (2; 1 trains in this
        one); they change no number. tell: called with what the command prints.
    A search that was interrupted goes on in its folder with the same call.
    Raises InputError for a folder with anything else, for recordings that are not found, and for networks of other
    kinds than one hidden layer.

    >>> found = nt.save_energy("run", "small", trials=2, workers=1)
    >>> sorted(found)[:2], Path("small/front.csv").is_file()
    (['answer', 'at_most_points'], True)
    """
    fitted.check_folder(run, "save_energy", "or a file of recordings, from which it trains")
    if trials < 1:
        raise InputError(f"trials: must be 1 or more; got {trials}")
    if not 0 <= at_most_points <= 100:
        raise InputError(f"at_most_points: must be from 0 to 100; got {at_most_points:g}")
    listed, source, out = price_list(prices), Path(run), Path(folder)
    _refuse_moved(source, recordings=recordings, spikes=spikes)
    chosen = listed.name
    if chosen not in names() or price_list(chosen) != listed:
        raise InputError(f"prices: a search knows the lists that are installed; name one of {', '.join(names())}")
    with files.locked(out):
        _check_place(out)
        files.sweep(out)
        if (source / STUDY).is_file():
            source = best_of_study(source, tell)
        elif source.is_file():
            source = _trained_on(source, out, seed, tell)
        where = trying.Source(source, _path(spikes), _path(recordings), seed)
        start, asked = where.start(), proposals.Asked(trials, at_most_points / 100, chosen, seed)
        searching.claim(out, _problem(source, start, asked))
        ways = known_ways.ways_of(start)
        if not ways:
            raise InputError(f"{run}: there is nothing to save; each of its ways is at its least already")
        with track("save", 1 + trials) as advance:
            tried = searching.search(start, where, ways, asked, out, workers or 2, advance)
        if len(tried) > 1 and all(trial.error for trial in tried if trial.point):
            raise InputError(f"{run}: no setting could be trained; the first one says: {tried[1].error}")
        found = choice.found(tried, asked)
        table = choice.table(tried, ways, names())
        points.clear(out, (ANSWER, FRONT, FIGURE))
        rows = points.write(found, start, asked, out)
        write_table(table, out / FRONT)
        style.save(figure.draw_front(table, rows, chosen), out / FIGURE)
        answer = _answer(found, rows, asked, source, start)
        files.write_json(out / ANSWER, files.without_nan(answer))
    for line in ([] if found.answer else [answer["answer"]]) + _lines(rows, asked, out):
        tell(line)
    return answer


def _refuse_moved(source: Path, **moved: Any) -> None:
    for name in (name for name, given in moved.items() if given is not None and source.is_file()):
        raise InputError(f"`{name}`: has no effect with a file, which is read itself; leave it out")


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)


def _check_place(out: Path) -> None:
    """Refuse a folder that holds anything but a search for savings."""
    held = {path.name for path in out.iterdir()} - {files.LOCK}
    if held and not held & {"search.json", ENCODER, SPIKES}:
        raise InputError(f"{out}: is not empty and holds no search for savings; choose another folder")


def _trained_on(path: Path, out: Path, seed: int, tell: Tell) -> Path:
    """The default network of a file of recordings, or of spikes; it goes on where an earlier call was interrupted."""
    if hdf5.kind_of(path) == "recordings":
        spikes = out / SPIKES
        if not spikes.is_file():
            nt.calibrate(path, out=out / ENCODER, force=True, tell=tell)
            nt.encode_file(path, spikes, out / ENCODER, tell=tell)
    else:
        spikes = path
    if not (out / FIRST / resumable.RESULT).is_file():
        nt.train(spikes, out / FIRST, seed=seed, resume=True, tell=tell)
    return out / FIRST


def best_of_study(folder: Path, tell: Tell) -> Path:
    """The run folder of the best network of a study on validation trials, as its report names it."""
    report = folder / ANSWER
    answers = files.read_json(report).get("answers", []) if report.is_file() else []
    names = [one["leader"] for one in answers if one.get("leader")]
    if not names:
        resuming = f"neurotact study resume {shlex.quote(str(folder))}"
        raise InputError(f"{folder}: its report names no network; {resuming} goes on to its end")
    best = folder / "cells" / names[0]
    if not (best / run_folder.NETWORK).is_file():
        raise InputError(f"{best}: holds no network; give the folder of a study that holds its cells")
    tell(f"{best}: the best network of {folder} on validation trials, from which the search starts")
    return best


def _problem(source: Path, start: "starting.Start", asked: "proposals.Asked") -> dict[str, Any]:
    """What decides the journal, without the paths of files."""
    return {
        "weights_sha256": files.sha256(source / run_folder.WEIGHTS),
        "encoder": start.base.trains.encoder,
        "task": start.bench.task.model_dump(mode="json"),
        **asked._asdict(),
    }


def _next(start: "starting.Start") -> str:
    """The command for the best point: C in integers, where it runs the encoder and the network of the run."""
    table = start.base.trains.encoder
    encoder = chain.encoder_of(table, "spikes of the run") if table else None
    subject = executors.Subject(encoder, start.base.network)
    return "export" if executors.lacking("c-integer", subject) is None else "infer"


def _answer(
    found: "choice.Found", rows: list[dict[str, Any]], asked: "proposals.Asked", source: Path, start: "starting.Start"
) -> dict[str, Any]:
    """The content of `answer.json`."""
    first = rows[0] if found.answer is not None else None
    return {
        "answer": _sentence(first, asked),
        "run": str(source),
        "at_most_points": 100 * asked.loss,
        "prices": asked.prices,
        "best": None if first is None else first["folder"],
        "next": "" if first is None else _next(start),
        "points": rows,
        "cautions": [*_cautions(found, start)],
    }


def _cautions(found: "choice.Found", start: "starting.Start") -> Iterator[str]:
    """What limits the answer, one line each."""
    if start.bench.task.split.test_where:
        yield (
            "validation trials are of the conditions of training, and those of the test are not: what an untrained "
            "condition loses did not choose; look at `lost_test`"
        )
    if not found.was_judged:
        yield "no point was trained again, so that the luckiest of all may have been chosen; give more `trials`"


def _sentence(row: dict[str, Any] | None, asked: "proposals.Asked") -> str:
    if row is None:
        return f"No setting that was tried saves energy and loses at most {100 * asked.loss:g} points of accuracy"
    lost, low, high = (100 * row[name] for name in ("lost_test", "lost_test_low", "lost_test_high"))
    word = "less" if lost >= 0 else "more"
    ends = (low, high) if lost >= 0 else (-high, -low)
    saved = {name: 100 * (1 - row["left"][name]) for name in ("sops_total", asked.prices)}
    sops = _fewer(saved["sops_total"], "fewer", "more")
    return (
        f"{abs(lost):.1f} points {word} ({ends[0]:.1f} to {ends[1]:.1f}), {sops} SOPs, "
        f"{_fewer(saved[asked.prices], 'less', 'more')} energy by {asked.prices}: {row['setting']}"
    )


def _fewer(saved: float, less: str, more: str) -> str:
    """
    >>> _fewer(61.2, "less", "more"), _fewer(-3.0, "less", "more")
    ('61 % less', '3 % more')
    """
    return f"{abs(saved):.0f} % {less if saved >= 0 else more}"


def _lines(rows: list[dict[str, Any]], asked: "proposals.Asked", out: Path) -> list[str]:
    """What was found, a line per run folder."""
    return [
        f"{out / row['folder']}: {_sentence(row, asked)}; validation accuracy {100 * row['accuracy_validation']:.1f} % "
        f"(the run {100 * row['accuracy_validation_run']:.1f} %)"
        for row in rows
    ] + [f"every trial: {out / FRONT}; figure: {out / FIGURE}"]
