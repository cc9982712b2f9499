"""NeuroBench's columns of a run, as a table (`neurobench_columns`)."""

from pathlib import Path

from neurotact import files
from neurotact.lazily import lazily
from neurotact.networks.use.exporters import Exporter
from neurotact.progress import Tell, untold
from neurotact.tables import write_table

with lazily():
    import pandas as pd
    from neurotact_parts.exporters import neurobench_columns

    from neurotact.metrics import synops
    from neurotact.networks.definition import rsnn
    from neurotact.networks.training import run_folder, tasks
    from neurotact.networks.use import fitted, inference


def neurobench(
    run: "fitted.Fitted", out: str | Path, *, spikes: str | Path | None = None, force: bool = False, tell: Tell = untold
) -> "pd.DataFrame":
    """Write NeuroBench's columns of a run on its test windows to `out` (.csv, .json, .md, .tex); returns the row.

    run: a folder that `train` wrote. spikes: that it was trained on, where they moved since. force: replace a file.
    Columns: windows, accuracy_test and sops_total, our own, of whole windows; footprint_bytes, connection_sparsity,
    activation_sparsity, effective_acs, effective_macs and membrane_updates, NeuroBench's. Operations and updates are
    means of a window.
    Raises InputError for a network that snnTorch cannot hold (`nt.to_snntorch`).
    """
    fitted.check_folder(run, "neurobench", "whose test windows it counts")
    restored = fitted.restore(run, spikes=spikes).of_classes("neurobench")
    files.check_new(out, force=force, inputs=[*run_folder.files_of(str(run)), restored.spikes_path])
    network = rsnn.rsnn_of("snntorch", restored.network)
    trains = run_folder.trained_spikes_of(restored)
    windows = tasks.sides_of(trains, restored.task).test.spikes
    counted = neurobench_columns.columns(network, windows)
    own = synops.summary(inference.infer(restored, trains, early_exit=False, test_only=True)).iloc[-1]
    row = {"windows": len(windows), "accuracy_test": own["accuracy"], **counted, "sops_total": own["sops_total"]}
    table = pd.DataFrame([row])
    write_table(table, out)
    tell(table)
    if network.w_rec is not None and network.spec.reset == "zero":
        tell("effective_acs: snnTorch computes recurrence twice a step with reset 'zero', and NeuroBench counts both")
    return table


EXPORTER = Exporter("NeuroBench's columns of the test windows: a table (.csv, .json, .md, .tex)", neurobench)
