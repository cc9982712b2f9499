"""One folder a paper: simulator, features, protocol, published numbers, figures; found by name, never imported."""
