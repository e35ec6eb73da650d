"""Explicit MPM on Warp: uGIMP, FLIP, double mapping, local damping; one CPU core or a CUDA GPU."""
