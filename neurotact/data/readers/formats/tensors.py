"""Tensors that torch.save wrote: a tensor, or a dict or a list of them. Anything else there is never loaded."""

import zipfile
from pathlib import Path

import numpy as np

from neurotact.data.readers.formats.contents import TORCH, check_content
from neurotact.errors import InputError
from neurotact.files import check_size, existing

FIX = "save a tensor, or a dict of tensors, with torch.save"


def read_tensors(path: str | Path) -> dict[str, np.ndarray]:
    """The tensors of a .pt file as arrays by their keys; one alone, or those of a list, have the name of the file.

    Raises InputError for a file that is damaged or too large, or holds anything but tensors, which could run code.

    >>> import tempfile, torch
    >>> path = Path(tempfile.mkdtemp()) / "touch.pt"
    >>> torch.save({"press": torch.ones(4, 2)}, path)
    >>> read_tensors(path)["press"].shape
    (4, 2)
    """
    import torch

    path = existing(path)
    check_content(path, TORCH, wanted="a file of tensors", fix=FIX)
    check_size(path, path.stat().st_size)
    try:
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(member.file_size for member in archive.infolist()))
        held = torch.load(path, map_location="cpu", weights_only=True)
    except InputError:
        raise
    except Exception as error:  # damaged bytes make zipfile and torch raise nearly anything
        why = "damaged, or holds more than tensors, which is never loaded because it can run any code"
        raise InputError(f"{path}: is {why}; {FIX}") from error
    if isinstance(held, (list, tuple)):
        held = {f"{path.stem}{number}": value for number, value in enumerate(held, 1)}
    tensors = held if isinstance(held, dict) else {path.stem: held}
    wrong = [str(key) for key, value in tensors.items() if not isinstance(value, torch.Tensor) or value.is_sparse]
    if wrong or not tensors:
        raise InputError(f"{path}: {wrong[0][:40] if wrong else 'it'} holds no dense tensor; {FIX}")
    return {
        str(key): (value.float() if value.dtype == torch.bfloat16 else value).detach().numpy()
        for key, value in tensors.items()
    }
