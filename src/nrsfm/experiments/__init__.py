"""The experiments of the paper: each a table or figure that one command computes, draws and judges."""
