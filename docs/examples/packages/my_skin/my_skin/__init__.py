"""Parts of my own for neurotact; `pyproject.toml` names them."""
