"""Comparisons of every family of classifiers, with its cost, on the same windows of one task."""
