"""Proof of the C export on a processor: `make device`.

Gratings are simulated, an encoder calibrated and the paper's network (16-30-8) trained; its export is compiled here and
for Cortex-M0 and M4, run here, under the sanitizers and in QEMU, and compared with its twin spike by spike. What each
costs is printed. Steps whose tools are absent are skipped, with the reason.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from neurotact_parts.exporters.c import proving

import neurotact as nt
from neurotact import files, spec
from neurotact.data import hdf5
from neurotact.encoders.encoding import encode_file
from neurotact.progress import say


def trained_run(folder: Path, trials: int) -> Path:
    """A run folder with its recordings and spikes beside it; an existing one is used again."""
    run, touches, spikes = folder / "run", folder / "gratings.h5", folder / "spikes.h5"
    if (run / "network.json").is_file():
        return run
    recordings = nt.simulate("gratings", trials=trials)
    nt.save(recordings, touches, force=True)
    encoder = nt.calibrate(recordings)
    files.write_text(folder / "encoder.toml", spec.to_toml(encoder.model_dump(mode="json", exclude_none=True)))
    with hdf5.open_recordings(touches) as stored:
        encode_file(stored, encoder, spikes)
    settings = {"hidden": 30, "training.batch": 32}
    nt.train(spikes, run, "rsnn", settings, force=True, window=nt.Window(length_ms=150, start_ms=250, per_trial=1))
    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=25, help="slides for each grating, force and speed")
    parser.add_argument("--windows", type=int, default=1000, help="windows to compare, six a slide")
    parser.add_argument("--folder", type=Path, help="where the run is kept; a scratch folder when absent")
    given = parser.parse_args()
    with TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        run = trained_run(folder, given.trials)
        for variant in ("integer", "float"):
            found = nt.export_c(run, folder / variant, variant=variant, force=True)
            table = proving.prove(run, found.chain, found.formats, -(-given.windows // 6), say=say)
            print(f"\n{variant}")
            for row in table.itertuples(index=False):
                print(f"  {row.what}: {row.value}")


if __name__ == "__main__":
    main()
