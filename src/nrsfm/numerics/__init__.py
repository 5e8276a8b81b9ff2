"""Linear algebra that the solvers share: thresholds through Gram matrices, truncated factors, thread control."""
