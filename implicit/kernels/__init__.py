"""Warp kernels of the implicit step, one file per idea."""
