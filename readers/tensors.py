"""Tensors that torch.save wrote: a tensor, or a dict or a list of them. Anything else there is never loaded."""

import zipfile
from pathlib import Path

from neurotact.data.readers.formats import Arrays, Format
from neurotact.data.readers.formats.contents import TORCH, damaged_as
from neurotact.errors import InputError
from neurotact.files import check_size

FIX = "save a tensor, or a dict of tensors, with torch.save"
NEVER = "is damaged, or holds more than tensors, which is never loaded because it can run any code"


def _read(path: Path) -> Arrays:
    """The tensors of a file by their keys; one alone, or those of a list, have the name of the file."""
    import torch

    with damaged_as(path, NEVER, FIX):
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(member.file_size for member in archive.infolist()))
        held = torch.load(path, map_location="cpu", weights_only=True)
    if isinstance(held, (list, tuple)):
        held = {f"{path.stem}{number}": value for number, value in enumerate(held, 1)}
    tensors = held if isinstance(held, dict) else {path.stem: held}
    wrong = [str(key) for key, value in tensors.items() if not isinstance(value, torch.Tensor) or value.is_sparse]
    if wrong or not tensors:
        raise InputError(f"{path}: {wrong[0][:40] if wrong else 'it'} holds no dense tensor; {FIX}")
    plain = {str(key): value.float() if value.dtype == torch.bfloat16 else value for key, value in tensors.items()}
    return Arrays({key: value.detach().numpy() for key, value in plain.items()})


FORMAT = Format("a file of tensors", FIX, _read, "arrays", (TORCH,))
