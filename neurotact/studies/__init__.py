"""The engine: what a study is, its cells, who computes them, its tables and claims."""
