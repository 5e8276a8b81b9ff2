"""Grassmann manifolds: points, distances, self-expression, and the map to a lower dimension."""
