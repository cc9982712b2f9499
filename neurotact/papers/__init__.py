"""One folder per paper: simulator, features, protocol, published numbers, figures; found by name, never imported."""
