"""One task, all ways: every family of classifiers on the same windows, with its cost."""
